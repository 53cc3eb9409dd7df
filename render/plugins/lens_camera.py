"""Mitsuba sensor ``lens_camera``: a lens prescription in front of a pixelated detector.

Properties
----------
lens : str
    Built-in name or path of a prescription; or
camera : str
    Handle of a `render.camera.Camera` (`share_camera`) or a file of one (`optics.record_files`), which then sets lens,
    pixels, focus and attitude; ``to_world`` may only move it.
pixel_pitch_um : float
    Pixel pitch; the film gives the number of pixels.
defocus_mm, charge_diffusion_um : float, default 0
    Detector shift away from the lens; standard deviation of the charge diffusion.
diffraction : {"rays", "waves", "exact_waves"}, default "waves"
    How ``star_tracer`` makes the images of stars.
to_world : Transform4f
    As for Mitsuba's ``perspective``: the camera looks along its local +Z, its local +Y is up in the image. Single
    precision (0.02"); for star fields rather give
rotation : TensorXf64 (3, 3) or str of nine numbers
    ``v_cam = rotation @ v_world`` in float64.
scene_unit_mm : float, default 1
    Length of a scene unit; where rays leave the first lens is placed accordingly.
wavelength_nm : float
    Wavelength of extended scenes in variants without spectra; default the lens's design wavelength. In spectral
    variants only the hero wavelength carries weight, because dispersion separates the others.
shutter_open, shutter_close : float
    Exposure time is their difference; 1 s if it is zero.
motion_rotation : TensorXf64 (1, m, 3, 3)
    Attitude at m >= 2 equal steps from ``shutter_open`` over motion_duration_s, in place of ``rotation``: a ray takes
    the one at its time sample, between two steps along the shorter arc.
motion_duration_s : float
    Length of that table: the exposure, with a rolling shutter also the time from the first row's start to the last's.
line_time_s : float, default 0
    A row starts this much later than the one before it.
first_row : int, default 0
    Row of the detector that is row 0 of the film, where the film is a window.

exposure_motion : str
    Handle (`share_motion`) or file of a `render.tracing.motion.exposure.ExposureMotion`: attitudes for the
    stars of ``star_tracer``, in place of ``rotation``.

housing_cte_per_k : float, default 23.6e-6
    Expansion of the housing, for ``temperature_c`` as a parameter.

Parameters of the scene (``mi.traverse``) are ``rotation``, ``attitude_rad`` (a rotation vector in cam on top of it),
``rate_rad_per_s`` (angular velocity in cam, about that attitude in the middle of the exposure; it moves stars only),
``defocus_mm`` and the numbers of the lens, `optics.lens.parameters.LENS_PARAMETERS`; ``star_tracer`` differentiates
with respect to all of them.

The film may be cropped (``crop_width`` ...): its pixels are numbered as of the whole film.

Stars are traced forward by ``star_tracer``. Extended bodies are rendered by stock integrators: `sample_ray` starts
on the detector, aims at the exit pupil, and traces the lens backwards, so that a pixel's value is its mean irradiance:
the integral of L cos(theta) over the exit pupil's solid angle (pi sin^2 for a uniform sky). Charge diffusion, quantum
efficiency and the transmission of the lens are not in it. ``ptracer`` goes the other way and gives the same image:
`sample_direction` aims from a point of the scene at the entrance pupil and traces the lens forwards; it needs a camera
at rest. ``prb_projective`` and ``direct_projective`` render the same images and differentiate with respect to what is
not geometry; they move silhouettes by the projection of a pinhole, so that derivatives with respect to shapes are
refused (``prb`` has them, but for silhouettes).
"""

from __future__ import annotations

import math
from dataclasses import fields, replace
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np

from optics.errors import BackendError, ConfigError, ConvergenceError
from optics.frames import light_direction
from optics.rays.paraxial import axial_paraxial
from optics.rays.program import LensProgram, compile_lens
from optics.rays.reverse import retraced, reverse, reversed_turn
from optics.rays.trace import OK, Rays, trace, trace_program
from render.camera import Camera, launch_disk
from render.engine.arrays import DrJitArrays
from render.engine.jit import dr
from render.engine.upload import uploaded
from render.plugins.camera_parameters import ALUMINIUM_PER_K, CameraParameters
from render.plugins.camera_properties import camera_of, exposure_motion_of, motion_of, translation_of
from render.tracing.motion.exposure import ExposureMotion
from render.tracing.pupil.quadrature_order import probe_fields

EXIT_PUPIL_MARGIN = 1.03
"""Radius of the disk that backward rays aim at, over that of the disk of forward rays, which are few."""
EXIT_PUPIL_RAYS = 400


def exit_disk(camera: Camera) -> tuple[float, float, float, float]:
    """Centre and radius (x, y, z, radius) [mm] of a disk through which all light reaches the detector.

    In the frame of the reversed lens: origin on the detector, z towards the lens (`optics.rays.reverse`). It stands at
    the paraxial exit pupil, or at the last vertex where that is behind the detector or far away, and is sized by real
    rays from the whole field.
    """
    lens, pupil = camera.focused_lens, launch_disk(camera)
    along = lens.axis[-1]
    last = float((lens.image_position_mm - lens.surfaces[-1].position_mm) @ along)
    reach = float(along[2]) * (
        float(lens.image_position_mm[2]) - axial_paraxial(lens, lens.design_wavelength_nm).exit_pupil_z_mm
    )
    if not 0.2 * last < reach < 1e4 * last:
        reach = last
    i = np.arange(EXIT_PUPIL_RAYS)
    radius, azimuth = np.sqrt(i / (len(i) - 1)), i * math.pi * (3.0 - math.sqrt(5.0))
    low, high = lens.wavelength_range_nm
    rays = Rays.create(
        x_mm=pupil.x_mm + pupil.radius_mm * radius * np.cos(azimuth),
        y_mm=pupil.y_mm + pupil.radius_mm * radius * np.sin(azimuth),
        z_mm=pupil.z_mm,
        direction=light_direction(probe_fields(camera.field_reach_rad))[:, None, None],
        wavelength_nm=np.clip(lens.design_wavelength_nm * np.array([0.75, 1.0, 1.4]), low, high)[:, None],
    )
    arrived = trace(lens, rays)
    ok = arrived.ok
    if not ok.any():
        raise ConvergenceError(f"lens {lens.name!r}: no ray of any field reaches the image plane")
    exiting = retraced(lens, Rays(**{f.name: getattr(arrived, f.name)[ok] for f in fields(Rays)}))
    x, y = (p + d / exiting.dz * (reach - exiting.z) for p, d in ((exiting.x, exiting.dx), (exiting.y, exiting.dy)))
    centre_x, centre_y = 0.5 * (x.min() + x.max()), 0.5 * (y.min() + y.max())
    radius_mm = EXIT_PUPIL_MARGIN * float(np.hypot(x - centre_x, y - centre_y).max())
    return float(centre_x), float(centre_y), reach, radius_mm


class _Forward(NamedTuple):
    """The lens for light from points of the scene; numbers are Dr.Jit arrays of size one."""

    xp: DrJitArrays  # Array functions
    program: LensProgram
    theta: Any  # Parameters of the lens
    disk_mm: Any  # Centre and radius of `render.camera.launch_disk`
    # Column and row of the image plane's origin from the outer corner of the film's crop; pixels per mm; columns, rows
    # and area [mm^2] of the crop
    film: Any
    rotation: Any  # cam from world


class _Backward(NamedTuple):
    """The reversed lens for light from the detector; numbers are Dr.Jit arrays of size one."""

    xp: DrJitArrays  # Array functions
    program: LensProgram
    theta: Any  # Parameters of the lens
    film_mm: Any  # Width, left edge, height and top edge of the film's crop; rows run downwards
    turn: Any  # Reversed lens's frame from film, row by row
    exit_disk_mm: Any  # Centre and radius of `exit_disk`
    rotation: Any  # cam from world, row by row


def define(mi: Any) -> type:
    """The plugin class for Mitsuba's active variant."""

    class LensCamera(mi.Sensor):
        def __init__(self, props: Any) -> None:
            super().__init__(props)
            if not dr.is_jit_v(mi.Float):
                raise BackendError(f"lens_camera runs in llvm and cuda variants, not in {mi.variant()}")
            size = self.film().size()
            optics = camera_of(props, int(size.x), int(size.y))
            # a namespace: Dr.Jit walks through records that are attributes at every mi.render, 1 ms for a lens
            self._present = SimpleNamespace(optics=optics, camera=optics)
            self.parameters = CameraParameters(mi, self.optics, float(props.get("housing_cte_per_k", ALUMINIUM_PER_K)))
            self.m_needs_sample_3 = True
            self.scene_unit_mm = float(props.get("scene_unit_mm", 1.0))
            self.wavelength_nm = float(props.get("wavelength_nm", self.camera.lens.design_wavelength_nm))
            self.camera.lens.check_wavelength(self.wavelength_nm)
            self.position = tuple(translation_of(props)[:3, 3].tolist())
            self._position = mi.ScalarVector3d(self.position)
            exposure_s = float(props.get("shutter_close", 0.0)) - float(props.get("shutter_open", 0.0))
            self.exposure_s = exposure_s or 1.0
            self.exposure_motion = exposure_motion_of(props, self.exposure_s)
            self._turning: ExposureMotion | None = None
            self._motion = motion_of(props)
            if self._motion is not None and not exposure_s > 0:
                raise ConfigError("lens_camera: motion_rotation needs shutter_open and shutter_close")
            self._opened_s = float(props.get("shutter_open", 0.0))
            self._crop: tuple[int, int, int, int] | None = None
            self._backward: _Backward | None = None
            self._forward: _Forward | None = None
            self._attitudes: tuple[Any, ...] | None = None

        def traverse(self, callback: Any) -> None:
            for name, tensor in self.parameters.tensors.items():
                callback.put(name, tensor, mi.ParamFlags.Differentiable)

        def parameters_changed(self, keys: list[str]) -> None:
            """Take over numbers; ``optics`` stays the same record as long as only the attitude changes."""
            optics, turn = self.optics if keys == ["rotation"] else self.parameters.optics(), self.parameters.rotation()
            if optics is not self.optics or not np.array_equal(turn, self.camera.rotation_cam_from_world):
                self._present.optics, self._present.camera = optics, replace(optics, rotation_cam_from_world=turn)
                self._backward = self._forward = None
            self._turning = None

        @property
        def optics(self) -> Camera:
            """The present camera, with its first attitude."""
            optics: Camera = self._present.optics
            return optics

        @property
        def camera(self) -> Camera:
            """The present camera."""
            camera: Camera = self._present.camera
            return camera

        @property
        def star_motion(self) -> ExposureMotion | None:
            """Motion of the star images, given or from the rate; None at rest."""
            if self._turning is None:
                self._turning = self.parameters.motion(self.camera, self.exposure_s)
            if self._turning is not None and self.exposure_motion is not None:
                raise ConfigError("lens_camera: exposure_motion and rate_rad_per_s are given; leave one of them out")
            return self.exposure_motion if self._turning is None else self._turning

        def _window(self) -> tuple[int, int, int, int]:
            """Crop of the film (first column, first row, columns, rows); a new one resets what depends on it."""
            offset, size, full = self.film().crop_offset(), self.film().crop_size(), self.film().size()
            if (int(full.x), int(full.y)) != (self.camera.width_px, self.camera.height_px):
                raise ConfigError(
                    f"lens_camera: the film has become {int(full.x)} x {int(full.y)} px, the camera has "
                    f"{self.camera.width_px} x {self.camera.height_px} px; load the camera again or crop the film"
                )
            crop = (int(offset.x), int(offset.y), int(size.x), int(size.y))
            if crop != self._crop:
                self._crop, self._backward, self._forward, self._attitudes = crop, None, None, None
            return crop

        def _reversed(self) -> _Backward:
            """The reversed lens with film and attitude; no number is compiled into a kernel."""
            first_column, first_row, columns, rows = self._window()
            if self._backward is None:
                camera, xp = self.camera, DrJitArrays(mi.Float64)
                program, theta = compile_lens(reverse(camera.focused_lens))
                pitch, (cx, cy) = camera.pixel_pitch_mm, camera.centre_px
                turn = reversed_turn(camera.lens) @ camera.lens.image_rotation
                left, top = (first_column - 0.5 - cx) * pitch, (0.5 + cy - first_row) * pitch
                film = [columns * pitch, left, -rows * pitch, top]
                groups = (theta, film, turn.ravel(), exit_disk(camera), camera.rotation_cam_from_world.ravel())
                self._backward = _Backward(xp, program, *(xp.parameters(group) for group in groups))
            return self._backward

        def _start(self, sample2: Any, sample3: Any, backward: _Backward) -> tuple[Any, Any, Any]:
            """Point on the detector and direction towards the exit pupil in the reversed lens's frame; weight."""
            F, turn = mi.Float64, backward.turn
            width, left, height, top = backward.film_mm
            x, y, z, radius = backward.exit_disk_mm
            x0, y0 = F(sample2.x) * width + left, F(sample2.y) * height + top
            point = mi.Vector3d(*(turn[3 * row] * x0 + turn[3 * row + 1] * y0 for row in range(3)))
            on_disk = mi.warp.square_to_uniform_disk_concentric(sample3)
            d = mi.Vector3d(x + F(on_disk.x) * radius, y + F(on_disk.y) * radius, z) - point
            distance2 = dr.squared_norm(d)
            d = d / dr.sqrt(distance2)
            obliquity = dr.abs(turn[2] * d.x + turn[5] * d.y + turn[8] * d.z)
            return point, d, obliquity * d.z * (math.pi * dr.square(radius)) / distance2

        def sample_ray(
            self, time: Any, sample1: Any, sample2: Any, sample3: Any, active: Any = True
        ) -> tuple[Any, Any]:
            """Ray into the scene through a detector point (``sample2``) and an exit-pupil point (``sample3``)."""
            backward = self._reversed()
            point, d, weight = self._start(sample2, sample3, backward)
            wavelengths, spectrum, hero = self._wavelengths(sample1, active)
            rays = backward.xp.rays(point, d, hero, dr.width(point))
            out = trace_program(backward.program, backward.theta, rays, backward.xp)
            scale, rotation = 1.0 / self.scene_unit_mm, self._attitude(time, sample2, backward)
            origin = self._world(rotation, out.x * scale, out.y * scale, 0.0) + self._position
            direction = dr.normalize(mi.Vector3f(self._world(rotation, out.dx, out.dy, out.dz)))
            ok = active & (out.status == OK)  # failed rays have no valid numbers
            origin, direction = dr.select(ok, mi.Point3f(origin), 0.0), dr.select(ok, direction, mi.Vector3f(0, 0, 1))
            ray = mi.Ray3f(origin, direction, time, wavelengths)
            return ray, (spectrum * mi.Float(weight)) & ok

        def sample_ray_differential(
            self, time: Any, sample1: Any, sample2: Any, sample3: Any, active: Any = True
        ) -> tuple[Any, Any]:
            """As `sample_ray`, without differentials (textures are then not prefiltered)."""
            ray, weight = self.sample_ray(time, sample1, sample2, sample3, active)
            return mi.RayDifferential3f(ray), weight

        def _attitude(self, time: Any, sample2: Any, backward: _Backward) -> Any:
            """Nine numbers of cam from world, row by row: one attitude for all rays, or one per ray at its time."""
            if self._motion is None:
                return backward.rotation
            F, motion = mi.Float64, self._motion
            if self._attitudes is None:
                columns = tuple(uploaded(F, motion.quaternion[:, k]) for k in range(4))
                last = len(motion.quaternion) - 1
                first_row = motion.first_row + self._window()[1]
                values = (self._opened_s, last / motion.duration_s, motion.line_time_s, float(last), first_row)
                self._attitudes = (columns, tuple(dr.opaque(F, value) for value in values))
            columns, (opened, steps_per_s, line_time, last, first_row) = self._attitudes
            row = dr.floor(F(sample2.y) * self._window()[3]) + first_row
            step = dr.clip((F(time) - opened + row * line_time) * steps_per_s, 0.0, last)
            low = dr.minimum(dr.floor(step), last - 1.0)
            index, part = mi.UInt32(low), step - low
            x, y, z, w = (
                dr.lerp(dr.gather(F, column, index), dr.gather(F, column, index + 1), part) for column in columns
            )
            s = 2.0 / (x * x + y * y + z * z + w * w)
            return [
                1.0 - s * (y * y + z * z), s * (x * y - z * w), s * (x * z + y * w),
                s * (x * y + z * w), 1.0 - s * (x * x + z * z), s * (y * z - x * w),
                s * (x * z - y * w), s * (y * z + x * w), 1.0 - s * (x * x + y * y),
            ]  # fmt: skip

        @staticmethod
        def _world(rotation: Any, x: Any, y: Any, z: Any) -> Any:
            """Vector of the reversed lens's frame, whose axes are cam's, in the world."""
            return mi.Vector3d(*(rotation[k] * x + rotation[3 + k] * y + rotation[6 + k] * z for k in range(3)))

        def _wavelengths(self, sample1: Any, active: Any) -> tuple[Any, Any, Any]:
            """Wavelengths of the ray, its spectral weight, and the traced wavelength."""
            if not mi.is_spectral:
                return mi.Color0f(), mi.Spectrum(1.0), dr.opaque(mi.Float64, self.wavelength_nm)
            wavelengths, weight = self.sample_wavelengths(dr.zeros(mi.SurfaceInteraction3f), sample1, active)
            only_hero, hero = self._hero(wavelengths)
            return wavelengths, weight * only_hero, hero

        def _hero(self, wavelengths: Any) -> tuple[Any, Any]:
            """Weight that removes all but the hero wavelength (unpolarised), and that wavelength."""
            low, high = self.camera.lens.wavelength_range_nm
            only_hero = dr.zeros(mi.UnpolarizedSpectrum)
            only_hero[0] = float(dr.size_v(mi.UnpolarizedSpectrum))
            return mi.Spectrum(only_hero), mi.Float64(dr.clip(wavelengths[0], low, high))

        def to_string(self) -> str:
            return f"LensCamera[lens={self.camera.lens.name}, {self.camera.width_px} x {self.camera.height_px} px]"

        def _ahead(self) -> _Forward:
            """The lens for light from the scene, with film and attitude."""
            first_column, first_row, columns, rows = self._window()
            if self._forward is None:
                camera, xp, disk = self.camera, DrJitArrays(mi.Float64), launch_disk(self.camera)
                program, theta = compile_lens(camera.focused_lens)
                pitch, (cx, cy) = camera.pixel_pitch_mm, camera.centre_px
                at = [disk.x_mm, disk.y_mm, disk.z_mm, disk.radius_mm]
                film = [cx + 0.5 - first_column, cy + 0.5 - first_row, 1.0 / pitch]
                film += [columns, rows, columns * rows * pitch**2]
                groups = (theta, at, film, camera.rotation_cam_from_world.ravel())
                self._forward = _Forward(xp, program, *(xp.parameters(group) for group in groups))
            return self._forward

        def sample_direction(self, it: Any, sample: Any, active: Any = True) -> Any:
            """From a point of the scene through a point of the entrance pupil to the film; weight for ``ptracer``.

            The weight times the radiant intensity of the point is power over the area of the film, so that sums over
            a pixel are its irradiance.
            """
            if self._motion is not None:
                raise ConfigError("lens_camera: ptracer needs a camera at rest; use path, or leave motion_rotation out")
            F, ahead, scale = mi.Float64, self._ahead(), self.scene_unit_mm
            x, y, z, radius = ahead.disk_mm
            turn, offset = ahead.rotation, (mi.Vector3d(it.p) - mi.Vector3d(self._position)) * scale
            cam = [turn[3 * k] * offset.x + turn[3 * k + 1] * offset.y + turn[3 * k + 2] * offset.z for k in range(3)]
            on_disk = mi.warp.square_to_uniform_disk_concentric(sample)
            through = mi.Vector3d(x + F(on_disk.x) * radius, y + F(on_disk.y) * radius, z)
            d = through - mi.Vector3d(-cam[0], cam[1], -cam[2])
            distance2 = dr.squared_norm(d)
            d = d / dr.sqrt(distance2)
            spectrum, wavelength = mi.Spectrum(1.0), dr.opaque(F, self.wavelength_nm)
            if mi.is_spectral:
                spectrum, wavelength = self._hero(it.wavelengths)
            rays = ahead.xp.rays(through, d, wavelength, dr.width(d))
            out = trace_program(ahead.program, ahead.theta, rays, ahead.xp)
            across, down, per_mm, columns, rows, area_mm2 = ahead.film
            column, row = across + out.x * per_mm, down - out.y * per_mm
            ok = active & (out.status == OK) & (cam[2] > 0.0) & (d.z > 0.0)
            ok &= (column >= 0.0) & (column < columns) & (row >= 0.0) & (row < rows)
            enters = through - d * (z / d.z)
            weight = dr.square(scale * radius) * math.pi * d.z / (distance2 * area_mm2)
            ds = dr.zeros(mi.DirectionSample3f, dr.width(d))
            ds.p = mi.Point3f(self._world(turn, -enters.x / scale, enters.y / scale, 0.0) + self._position)
            ds.d = ds.p - it.p
            ds.dist = dr.norm(ds.d)
            ds.d = ds.d / ds.dist
            ds.n = mi.Normal3f(self._world(turn, 0.0, 0.0, 1.0))
            ds.uv = dr.select(ok, mi.Point2f(mi.Float(column), mi.Float(row)), 0.0)
            ds.time = it.time
            ds.pdf = dr.select(ok, mi.Float(1.0), 0.0)
            return ds, (spectrum * mi.Float(weight)) & ok

        def projection_transform(self) -> Any:
            """Projection for integrators that move silhouettes: a lens has none."""
            raise ConfigError(
                "lens_camera: prb_projective and direct_projective sample silhouettes by a pinhole projection, "
                "which does not apply to a lens; use prb, whose derivatives omit silhouettes"
            )

        def bbox(self) -> Any:
            return mi.ScalarBoundingBox3f()

    return LensCamera
