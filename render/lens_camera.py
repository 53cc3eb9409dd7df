"""Mitsuba sensor ``lens_camera``: a lens prescription in front of a pixelated detector.

Properties
----------
lens : str
    Built-in name or path of a prescription; or
camera : str
    Handle of a `render.camera.Camera` (`share_camera`), which then sets everything below but film and shutter.
pixel_pitch_um : float
    Pixel pitch; the film gives the number of pixels.
defocus_mm, charge_diffusion_um : float, default 0
    Detector shift away from the lens; standard deviation of the charge diffusion.
to_world : Transform4f
    As for Mitsuba's ``perspective``: the camera looks along its local +Z, its local +Y is up in the image. Single
    precision (0.02"); for star fields rather give
rotation : TensorXf64 (3, 3)
    ``v_cam = rotation @ v_world`` in float64.
scene_unit_mm : float, default 1
    Length of a scene unit; where rays leave the first lens is placed accordingly.
wavelength_nm : float
    Wavelength of extended scenes in variants without spectra; default the lens's design wavelength. In spectral variants
    only the hero wavelength carries weight, because dispersion separates the others.
shutter_open, shutter_close : float
    Exposure time is their difference; 1 s if it is zero.

Stars are traced forward by ``star_tracer``. Extended bodies are rendered by any stock integrator: `sample_ray` starts on
the detector, aims at the exit pupil, and traces the lens backwards, so that a pixel's value is the irradiance of its
centre region: the integral of L cos(theta) over the exit pupil's solid angle (pi sin^2 for a uniform sky).
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from optics.errors import BackendError, ConfigError, unknown_name
from optics.paraxial import axial_paraxial
from optics.prescription import load_lens
from optics.program import compile_lens
from optics.trace import Rays, trace_program
from render.arrays import DrJitArrays
from render.camera import Camera

__all__ = ["define", "share_camera"]

EXIT_PUPIL_MARGIN = 1.3
"""The disk that backward rays aim at, in radii of the paraxial exit pupil: room for pupil aberration."""

_MITSUBA_FROM_CAM = np.diag([-1.0, -1.0, 1.0])
"""Mitsuba's local frame has +X to the left and +Y up in the image; cam has +X to the right and +Y down."""

_shared: dict[str, Camera] = {}


def share_camera(camera: Camera) -> str:
    """Handle by which ``load_dict`` takes a camera record (Mitsuba's properties hold no Python objects).

    Parameters
    ----------
    camera : Camera
        Kept alive until 64 others have been shared.
    """
    handle = f"camera-{id(camera):x}"
    _shared.pop(handle, None)
    _shared[handle] = camera
    while len(_shared) > 64:
        _shared.pop(next(iter(_shared)))
    return handle


def _rotation(props: Any) -> np.ndarray:
    """cam from world, float64, from ``rotation`` or ``to_world``."""
    if "rotation" in props:
        return np.array(props["rotation"], dtype=float)
    if "to_world" in props:
        matrix = np.array(props["to_world"].matrix, dtype=float)[:3, :3]
        u, _, vt = np.linalg.svd(matrix)
        return _MITSUBA_FROM_CAM @ (u @ vt).T
    return _MITSUBA_FROM_CAM


def _camera(props: Any, width: int, height: int) -> Camera:
    if "camera" in props:
        handle = str(props["camera"])
        if handle not in _shared:
            raise unknown_name("camera handle", handle, _shared)
        camera = _shared[handle]
        if (camera.width_px, camera.height_px) != (width, height):
            raise ConfigError(
                f"lens_camera: film of {width} x {height} px for a camera of {camera.width_px} x {camera.height_px} px"
            )
        return camera
    for name in ("lens", "pixel_pitch_um"):
        if name not in props:
            raise ConfigError(f"lens_camera: property {name!r} is missing")
    pitch_um = float(props["pixel_pitch_um"])
    return Camera(
        lens=load_lens(str(props["lens"])),
        width_px=width,
        height_px=height,
        pixel_pitch_mm=pitch_um * 1e-3,
        defocus_mm=float(props.get("defocus_mm", 0.0)),
        charge_diffusion_px=float(props.get("charge_diffusion_um", 0.0)) / pitch_um,
        rotation_cam_from_world=_rotation(props),
    )


def define(mi: Any, dr: Any) -> type:
    """The plugin class for Mitsuba's active variant."""

    class LensCamera(mi.Sensor):  # type: ignore[name-defined, misc]
        def __init__(self, props: Any) -> None:
            super().__init__(props)
            if not dr.is_jit_v(mi.Float):
                raise BackendError(f"lens_camera runs in llvm and cuda variants, not in {mi.variant()}")
            size = self.film().size()
            self.camera = _camera(props, int(size.x), int(size.y))
            self.m_needs_sample_3 = True
            self.scene_unit_mm = float(props.get("scene_unit_mm", 1.0))
            self.wavelength_nm = float(props.get("wavelength_nm", self.camera.lens.design_wavelength_nm))
            self.camera.lens.check_wavelength(self.wavelength_nm)
            transform = np.array(props["to_world"].matrix, dtype=float) if "to_world" in props else np.eye(4)
            self._position = transform[:3, 3]
            self._backward: tuple[Any, ...] | None = None

        @property
        def exposure_s(self) -> float:
            """Exposure time."""
            return float(self.shutter_open_time()) or 1.0

        def _reverse(self) -> tuple[Any, ...]:
            """Compiled reversed lens and the disk its rays aim at."""
            if self._backward is None:
                lens = self.camera.focused_lens
                from optics.reverse import reverse

                backward, image_z = reverse(lens), float(lens.image_position_mm[2])
                front = axial_paraxial(lens, self.wavelength_nm)
                xp = DrJitArrays(mi.Float64)
                program, theta = compile_lens(backward)
                reach = image_z - front.exit_pupil_z_mm
                radius = abs(front.exit_pupil_radius_mm) * EXIT_PUPIL_MARGIN
                if not math.isfinite(reach) or reach <= 0 or not math.isfinite(radius):
                    last = lens.surfaces[-1]
                    reach, radius = image_z - float(last.position_mm[2]), float(last.semi_diameter_mm)
                self._backward = (program, xp.parameters(theta.tolist()), xp, reach, radius)
            return self._backward

        def sample_ray(
            self, time: Any, sample1: Any, sample2: Any, sample3: Any, active: Any = True
        ) -> Any:  # (ray, weight)
            F = mi.Float64
            program, theta, xp, reach, radius = self._reverse()
            camera = self.camera
            column = F(sample2.x) * camera.width_px - 0.5
            row = F(sample2.y) * camera.height_px - 0.5
            x0 = (column - float(camera.centre_px[0])) * camera.pixel_pitch_mm
            y0 = (float(camera.centre_px[1]) - row) * camera.pixel_pitch_mm
            disk = mi.warp.square_to_uniform_disk_concentric(sample3)
            d = dr.normalize(mi.Vector3d(F(disk.x) * radius - x0, F(disk.y) * radius - y0, reach))
            weight = dr.square(dr.square(d.z)) * (math.pi * (radius / reach) ** 2)
            wavelengths, spectral = self._wavelengths(sample1, active)
            hero = F(wavelengths[0]) if dr.size_v(wavelengths) > 0 and mi.is_spectral else F(self.wavelength_nm)
            # the reversed lens has its object side at the detector: x keeps, y and z turn (half a turn about x)
            zero = dr.zeros(mi.Int32, dr.width(x0))
            out = trace_program(
                program,
                theta,
                Rays(
                    x=-x0, y=y0, z=F(0.0), dx=-d.x, dy=d.y, dz=d.z, wavelength_nm=hero, opl_mm=F(0.0), status=zero,
                    failed_at=zero - 1,
                ),
                xp,
            )  # fmt: skip
            return self._world_ray(out, time, wavelengths), spectral * mi.Float(weight) & (active & (out.status == 0))

        def to_string(self) -> str:
            return f"LensCamera[lens={self.camera.lens.name}, {self.camera.width_px} x {self.camera.height_px} px]"

        def sample_direction(self, it: Any, sample: Any, active: Any = True) -> Any:
            return dr.zeros(mi.DirectionSample3f), mi.Spectrum(0)

        def bbox(self) -> Any:
            return mi.ScalarBoundingBox3f()

    return LensCamera
