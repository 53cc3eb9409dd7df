r"""A body lit by the Sun, seen through the lens: the Moon, a planet, or a mesh of the user, in expected electrons.

Mitsuba's own ``path`` integrator renders it backwards through ``lens_camera``, single scattering, the Sun a point. The
image is the irradiance E on each pixel for a Sun of unit irradiance and a surface of unit albedo; at every wavelength
node of the band

.. math:: N = E\, a(\lambda)\, F_\odot(\lambda) r^{-2}\, w\, A_{pixel}\, t

with the albedo a, the Sun's photons at 1 au, its distance r in au, the weights w of filter, quadrature and the camera's
response, pixel area and exposure. The total of a sphere is known in closed form: with its radius R at distance D,
geometric albedo p (2/3 a for Lambert, a for Lommel and Seeliger) and phase function Phi it sends
:math:`F_\odot r^{-2} p\, \Phi(\alpha) (R/D)^2` (`sphere_photons`) as long as R is small against D, to about R/D.

Interreflections, a penumbra, and the gradient of sunlight over the body are left out.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import constants

from optics.arrays import FloatArray
from optics.errors import ConfigError, DomainError
from optics.light.band import Band, BandNodes, band_nodes
from optics.light.photometry import band_integral, photon_rate
from optics.records import freeze
from render.bodies.brightness import ALBEDO, ALBEDO_NM, planet_spectrum
from render.bodies.solar_system import SolarSystem
from render.camera import Camera
from render.detector.diffusion import diffuse
from render.engine import Engine
from render.motion.trajectory import Trajectory
from render.plugins.camera_properties import lens_camera_properties
from render.plugins.lunar_surface import lommel_seeliger_phase
from render.plugins.register import register_plugins
from render.records import ExpectedImage
from render.sky.field import FieldOfView, field_of_view
from render.sky.sunlight import sun_spectrum, sunlight

__all__ = ["SunlitBody", "added", "covers", "planet_body", "render_body", "sphere_photons"]


MARGIN_PX = 24
"""Room around a body's outline for the spot of the lens."""
PASS_SAMPLES = 1 << 23
STEPS = 257
"""Attitudes over the exposure of a moving camera; between them the path is an arc."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SunlitBody:
    """A body far away, and the Sun that lights it; directions along icrs.

    Attributes
    ----------
    direction : (3,)
        Where its centre is seen, unit vector.
    distance_km : float
        From the camera to its centre.
    to_sun : (3,)
        From the body to the Sun, unit vector.
    sun_distance_au : float
        Distance of the two.
    radius_km : float
        Radius of a sphere; of a mesh, the sphere around its origin that holds it.
    albedo_nm, albedo : (k,)
        Albedo over wavelength, linear between and constant beyond: reflectance of a Lambertian surface, normal
        reflectance of a lunar one.
    law : {"lambert", "lunar"}
        How its surface scatters (`render.plugins.lunar_surface`).
    mesh : path or None
        PLY or OBJ file; None is a sphere.
    mesh_unit_km : float
        Length of its unit.
    rotation_icrs_from_body : (3, 3)
        Attitude of the mesh.

    Raises
    ------
    DomainError
        Lengths that are not positive, directions that are no unit vectors, a camera inside the body.
    ConfigError
        Unknown law, a mesh file that does not exist or is neither PLY nor OBJ.
    """

    direction: FloatArray
    distance_km: float
    to_sun: FloatArray
    sun_distance_au: float = 1.0
    radius_km: float
    albedo_nm: FloatArray = field(default_factory=lambda: np.array([550.0]))
    albedo: FloatArray
    law: Literal["lambert", "lunar"] = "lambert"
    mesh: Path | str | None = None
    mesh_unit_km: float = 1.0
    rotation_icrs_from_body: FloatArray = field(default_factory=lambda: np.eye(3))

    def __post_init__(self) -> None:
        for name in ("direction", "to_sun"):
            vector = freeze(self, name, shape=(3,))
            if abs(np.linalg.norm(vector) - 1.0) > 1e-9:
                raise DomainError(f"SunlitBody.{name} has length {np.linalg.norm(vector):.9g}; a unit vector is needed")
        for name in ("distance_km", "sun_distance_au", "radius_km", "mesh_unit_km"):
            if not 0.0 < getattr(self, name) < math.inf:
                raise DomainError(f"SunlitBody.{name} = {getattr(self, name)}; it must be positive and finite")
        if self.distance_km <= self.radius_km:
            raise DomainError(
                f"SunlitBody: the camera is {self.distance_km:g} km from the centre of a body of {self.radius_km:g} km "
                "radius; it must be outside"
            )
        sizes: dict[str, int] = {}
        freeze(self, "albedo_nm", shape=("k",), sizes=sizes)
        if (freeze(self, "albedo", shape=("k",), sizes=sizes) < 0.0).any():
            raise DomainError(f"SunlitBody.albedo contains {self.albedo.min():g}; it must not be negative")
        freeze(self, "rotation_icrs_from_body", shape=(3, 3))
        if self.law not in ("lambert", "lunar"):
            raise ConfigError(f"SunlitBody.law = {self.law!r}; 'lambert' or 'lunar' is needed")
        if self.mesh is not None and not (
            Path(self.mesh).is_file() and Path(self.mesh).suffix.lower() in (".ply", ".obj")
        ):
            raise ConfigError(f"SunlitBody.mesh = {str(self.mesh)!r}: no such file, or neither .ply nor .obj")

    @property
    def phase_rad(self) -> float:
        """Angle Sun - body - camera."""
        cross = float(np.linalg.norm(np.cross(self.to_sun, -self.direction)))
        return math.atan2(cross, float(-self.to_sun @ self.direction))

    @property
    def angular_radius_rad(self) -> float:
        """Half angle of the cone around it."""
        return math.asin(self.radius_km / self.distance_km)

    def albedo_at(self, wavelength_nm: ArrayLike) -> FloatArray:
        """Albedo at wavelengths [nm]."""
        return np.asarray(np.interp(np.asarray(wavelength_nm, float), self.albedo_nm, self.albedo))


def _disk_factor(body: SunlitBody) -> float:
    """Geometric albedo of a sphere of unit albedo times its phase function."""
    a = body.phase_rad
    if body.law == "lunar":
        return lommel_seeliger_phase(a)
    return (
        2.0 / 3.0 * (math.sin(a) + (math.pi - a) * math.cos(a)) / math.pi
    )  # Lambert 1760; Russell, ApJ 43, 173 (1916)


def sphere_photons(body: SunlitBody, wavelength_nm: ArrayLike) -> FloatArray:
    """Photons s^-1 mm^-2 nm^-1 that arrive from a whole sphere, in closed form.

    Raises
    ------
    DomainError
        A mesh; a wavelength at which sunlight is not known.
    """
    if body.mesh is not None:
        raise DomainError("the light of a mesh has no closed form; render it")
    light = sunlight(wavelength_nm, distance_au=body.sun_distance_au) * body.albedo_at(wavelength_nm)
    return np.asarray(light * (_disk_factor(body) * (body.radius_km / body.distance_km) ** 2))


def planet_body(system: SolarSystem, name: str, *, law: Literal["lambert", "lunar"] | None = None) -> SunlitBody:
    """The Moon or a planet as a smooth sphere that has its published magnitude and colour.

    Parameters
    ----------
    system : SolarSystem
        From `render.bodies.solar_system.solar_system`.
    name : str
        Which of its bodies.
    law : {"lambert", "lunar"}, optional
        How light falls off towards limb and terminator; lunar for the Moon and Mercury, Lambert for the others.

    Returns
    -------
    SunlitBody
        Its albedo is scaled so that the whole sphere has the magnitude of ``system``; where that is NaN, the geometric
        albedo stands with the phase function of the law.

    Raises
    ------
    ConfigError
        The body is not in ``system``.
    """
    if name not in system.name:
        raise ConfigError(f"{name!r} is not among the bodies that were looked up: {', '.join(system.name)}")
    i = system.name.index(name)
    law = law or ("lunar" if name in ("moon", "mercury") else "lambert")
    shape = np.interp(sun_spectrum().wavelength_nm, ALBEDO_NM, ALBEDO[name])
    body = SunlitBody(
        direction=system.direction[i] / np.linalg.norm(system.direction[i]),
        distance_km=float(system.distance_au[i]) * constants.au / 1e3,
        to_sun=system.to_sun_au[i] / system.sun_distance_au[i],
        sun_distance_au=float(system.sun_distance_au[i]),
        radius_km=float(system.radius_km[i]),
        albedo_nm=sun_spectrum().wavelength_nm,
        albedo=shape if law == "lunar" else 1.5 * shape,
        law=law,
    )
    if math.isnan(system.magnitude_v[i]):
        return body
    at = np.array([550.0])
    wanted = photon_rate(planet_spectrum(name), float(system.magnitude_v[i]), wavelength_nm=at)
    return replace(body, albedo=body.albedo * float((wanted / sphere_photons(body, at))[0]))


def covers(body: SunlitBody, direction: ArrayLike) -> NDArray[np.bool_]:
    """Which directions (n, 3) along icrs lie behind the body's sphere: stars to leave out."""
    return np.asarray(np.asarray(direction, float) @ body.direction > math.cos(body.angular_radius_rad))


def render_body(
    camera: Camera,
    body: SunlitBody,
    bands: Sequence[Band],
    *,
    exposure_s: float,
    samples: int = 64,
    nodes: int = 3,
    seed: int = 0,
    trajectory: Trajectory | None = None,
    start_s: float = 0.0,
    line_time_s: float = 0.0,
    view: FieldOfView | None = None,
) -> ExpectedImage:
    """Expected electrons of a body, to be added to those of the stars (`added`).

    Parameters
    ----------
    camera : Camera
        Its attitude is cam from icrs.
    body : SunlitBody
        The body.
    bands : sequence of Band
        b filters.
    exposure_s : float
        Exposure time.
    samples : int
        Rays per pixel, wavelength node and band.
    nodes : int
        Wavelength nodes per band: each is a rendering, for the colours of the lens.
    seed : int
        Of the Monte Carlo rays.
    trajectory : Trajectory, optional
        Motion of the camera, cam from icrs, in place of its attitude.
    start_s : float
        Time of the trajectory at which the first row's exposure starts.
    line_time_s : float
        How much later each row starts: a rolling shutter.
    view : FieldOfView, optional
        Of the camera, if it is at hand.

    Returns
    -------
    ExpectedImage
        Without truth; charge diffusion included. Where the body is out of sight there are no electrons.

    Raises
    ------
    DomainError
        Exposure, samples or line time out of range; a trajectory that ends too early.
    """
    if not 0.0 < exposure_s < math.inf or samples < 1 or not 0.0 <= line_time_s < math.inf:
        raise DomainError(
            f"exposure {exposure_s:g} s, {samples} samples, line time {line_time_s:g} s; exposure and samples must be "
            "positive, the line time not negative"
        )
    view = field_of_view(camera, margin_px=MARGIN_PX) if view is None else view
    rule = band_nodes(bands, nodes)
    electrons = np.zeros((camera.height_px, camera.width_px, len(bands)), np.float32)
    duration_s = exposure_s + (camera.height_px - 1) * line_time_s
    attitudes = camera.rotation_cam_from_world[None]
    if trajectory is not None:
        attitudes = trajectory.attitude(start_s + duration_s * np.linspace(0.0, 1.0, STEPS)).as_matrix()
    window = _window(camera, view, body, attitudes)
    if window is not None:
        columns, rows = window
        motion = None
        if trajectory is not None:
            motion = (attitudes, duration_s, line_time_s)
        part = replace(
            camera,
            width_px=columns.stop - columns.start,
            height_px=rows.stop - rows.start,
            centre_px=camera.centre_px - [columns.start, rows.start],
        )
        light = _light(camera, body, bands, rule) * (camera.pixel_pitch_mm**2 * exposure_s)
        image = _rendered(part, body, rule, light, samples, seed, exposure_s, motion, rows.start)
        for band in range(len(bands)):
            electrons[rows, columns, band] = diffuse(image[..., band], camera.charge_diffusion_px)
    return ExpectedImage(electrons=electrons, band=rule.name, exposure_s=exposure_s, diffused=True)


def _light(camera: Camera, body: SunlitBody, bands: Sequence[Band], rule: BandNodes) -> FloatArray:
    """Electrons s^-1 mm^-2 (b, k) that sunlight at the body gives with its albedo; each band's sum is exact.

    A few nodes miss some 0.1 % of a spectrum as rough as the Sun's, so they share the integral over all its pieces.
    """

    def electrons(wavelength_nm: FloatArray) -> FloatArray:
        sun = sunlight(wavelength_nm, distance_au=body.sun_distance_au)
        return np.asarray(sun * body.albedo_at(wavelength_nm) * camera.response_at(wavelength_nm))

    light = electrons(rule.wavelength_nm) * rule.weight_nm * rule.transmission
    knots = sun_spectrum().wavelength_nm
    exact = np.array([band_integral(band, electrons, breakpoints_nm=knots) for band in bands])
    return np.asarray(light * (exact / light.sum(1))[:, None])


def _window(camera: Camera, view: FieldOfView, body: SunlitBody, attitudes: FloatArray) -> tuple[slice, slice] | None:
    """Columns and rows that may see the body; None where none does."""
    centre = attitudes @ body.direction
    reach = view.radius_rad + body.angular_radius_rad
    near = centre[:, 2] > math.cos(min(reach, math.pi))
    if not near.any():
        return None
    limb = _limb(body)
    seen = np.concatenate([limb @ attitude.T for attitude in attitudes[near][:: max(1, len(attitudes) // 64)]])
    if (seen[:, 2] <= 0.1).any():  # round the camera
        return slice(0, camera.width_px), slice(0, camera.height_px)
    pixel = view.pixel_of(seen)
    beyond = np.isnan(pixel[:, 0])  # the field: about where it would be
    half_px = 0.5 * np.array([camera.width_px, camera.height_px]) + view.margin_px
    pixel[beyond] = camera.centre_px + seen[beyond, :2] / seen[beyond, 2:] / view.half_width * half_px
    low = np.floor(pixel.min(0)).astype(int) - MARGIN_PX
    high = np.ceil(pixel.max(0)).astype(int) + MARGIN_PX + 1
    columns = slice(max(low[0], 0), min(high[0], camera.width_px))
    rows = slice(max(low[1], 0), min(high[1], camera.height_px))
    return None if columns.start >= columns.stop or rows.start >= rows.stop else (columns, rows)


def _limb(body: SunlitBody, count: int = 32) -> FloatArray:
    """Unit vectors (n, 3) along icrs of the outline of the body's sphere."""
    helper = np.eye(3)[int(np.argmin(np.abs(body.direction)))]
    first = np.cross(body.direction, helper)
    first /= np.linalg.norm(first)
    second = np.cross(body.direction, first)
    turn = 2.0 * np.pi * np.arange(count) / count
    a = body.angular_radius_rad
    around = np.outer(np.cos(turn), first) + np.outer(np.sin(turn), second)
    return np.asarray(math.cos(a) * body.direction + math.sin(a) * around)


def _rendered(
    camera: Camera,
    body: SunlitBody,
    rule: BandNodes,
    light: FloatArray,
    samples: int,
    seed: int,
    exposure_s: float,
    motion: tuple[FloatArray, float, float] | None,
    first_row: int,
) -> FloatArray:
    """Electrons (h, w, b) of a window."""
    register_plugins()
    mi = Engine.active().mitsuba
    sensor = mi.load_dict(_sensor(camera, body, exposure_s, motion, first_row))
    scene = mi.load_dict({"type": "scene", **_scene(body)})
    integrator = mi.load_dict({"type": "path", "max_depth": 2})
    image = np.zeros((camera.height_px, camera.width_px, len(rule.name)))
    per_pass = max(1, min(samples, PASS_SAMPLES // (camera.width_px * camera.height_px)))
    passes = math.ceil(samples / per_pass)
    for band, node in np.ndindex(*rule.wavelength_nm.shape):
        sensor.wavelength_nm = float(rule.wavelength_nm[band, node])
        number = (band * rule.wavelength_nm.shape[1] + node) * passes
        for step in range(passes):
            taken = mi.render(
                scene, sensor=sensor, integrator=integrator, spp=per_pass, seed=(seed << 16) + number + step
            )
            image[..., band] += np.array(taken, dtype=float)[..., 0] * (light[band, node] / passes)
    return image


def _sensor(
    camera: Camera,
    body: SunlitBody,
    exposure_s: float,
    motion: tuple[FloatArray, float, float] | None,
    first_row: int,
) -> dict[str, Any]:
    """The camera in a scene whose origin is the body and whose unit is the body's radius."""
    mi = Engine.active().mitsuba
    position = -body.distance_km / body.radius_km * body.direction
    sensor = lens_camera_properties(
        camera,
        to_world=mi.ScalarTransform4f().translate(position.tolist()),
        scene_unit_mm=body.radius_km * 1e6,
        shutter_close=exposure_s,
    )
    if motion is not None:
        attitudes, duration_s, line_time_s = motion
        sensor |= {
            "motion_rotation": mi.TensorXf64(attitudes[None]),
            "motion_duration_s": duration_s,
            "line_time_s": line_time_s,
            "first_row": first_row,
        }
    return sensor


def _scene(body: SunlitBody) -> dict[str, Any]:
    """The body of unit albedo around the origin, and a Sun of unit irradiance."""
    mi = Engine.active().mitsuba
    kind = "diffuse" if body.law == "lambert" else "lunar_surface"
    bsdf = {"type": kind, "reflectance" if kind == "diffuse" else "albedo": {"type": "uniform", "value": 1.0}}
    shape: dict[str, Any] = {"type": "sphere", "radius": 1.0}
    if body.mesh is not None:
        matrix = np.eye(4)
        matrix[:3, :3] = body.rotation_icrs_from_body * (body.mesh_unit_km / body.radius_km)
        shape = {
            "type": Path(body.mesh).suffix.lower()[1:],
            "filename": str(body.mesh),
            "to_world": mi.ScalarTransform4f(matrix),
        }
    sun = {"type": "directional", "direction": (-body.to_sun).tolist(), "irradiance": 1.0}
    return {"body": {**shape, "bsdf": bsdf}, "sun": sun}


def added(image: ExpectedImage, *others: ExpectedImage) -> ExpectedImage:
    """Sum of images of one exposure; the truth of the first stays.

    Raises
    ------
    ConfigError
        Bands, sizes, exposures or diffusion that differ.
    """
    for other in others:
        same = (image.band, image.electrons.shape, image.exposure_s, image.diffused)
        if (other.band, other.electrons.shape, other.exposure_s, other.diffused) != same:
            raise ConfigError(
                f"images of {other.electrons.shape} in {', '.join(other.band)}, {other.exposure_s:g} s, and of "
                f"{image.electrons.shape} in {', '.join(image.band)}, {image.exposure_s:g} s, do not add up"
            )
    total = image.electrons.copy()
    for other in others:
        total += other.electrons
    return replace(image, electrons=total)
