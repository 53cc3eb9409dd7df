"""A body through the lens: its window, its image in electrons, its truth."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from optics.arrays import FloatArray
from optics.errors import ConfigError, DomainError
from optics.frames import perpendicular
from optics.light.band import Band, BandNodes, band_nodes
from optics.light.magnitudes import band_integral
from optics.records import freeze_all
from render.bodies.earth_air import rayleigh_thickness
from render.bodies.ray_maps import RayMaps
from render.bodies.solar_system import SolarSystem
from render.bodies.sphere_image import BodyExposure, Cover, DirectionalLight, SunlitSphere, sphere_image
from render.bodies.sunlit_body import SunlitBody, planet_body
from render.camera import Camera
from render.detector.diffusion import diffuse
from render.engine.random import Streams
from render.motion.trajectory import Trajectory
from render.records import ExpectedImage, checked_exposure
from render.sky.field import FieldOfView, field_of_view
from render.sky.sunlight import sun_spectrum, sunlight

NOISE_SHARE = 0.03
"""Square of the image's error over the variance of its photons: what frames show is photon noise."""
CEILING_E = 1e5
"""Charge that no pixel of a camera holds."""
MARGIN_PX = 24
"""Room around a body's outline for the spot of the lens."""
STEPS = 257
"""Attitudes over the exposure of a moving camera; between them the path is an arc."""
AIR_HEIGHTS = 12.0
"""Rendered height of a body's air [scale heights]."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BodyImage:
    """Expected electrons of a body, and what is known of them."""

    image: ExpectedImage  # Of the whole detector, charge diffusion included, without truth of stars
    electrons: FloatArray  # (b,) Sum over the detector
    photon_px: FloatArray  # (b, 2) Centroid (column, row) of that light; NaN where there is none
    # Square of the image's error over the variance of its photons in the worst pixel; 0 without light
    noise_share: float

    def __post_init__(self) -> None:
        freeze_all(self, electrons=("b",), photon_px=("b", 2), finite=False)

    def dimmed(self, fraction: float) -> BodyImage:
        """The image of which a fraction of the light arrives."""
        image = replace(self.image, electrons=self.image.electrons * np.float32(fraction))
        return replace(self, image=image, electrons=self.electrons * fraction)


class BodyRenderer:
    """Renders bodies through one camera; keeps the maps of its lens."""

    def __init__(
        self, camera: Camera, bands: Sequence[Band], *, nodes: int = 3, view: FieldOfView | None = None
    ) -> None:
        self.camera, self.bands = camera, tuple(bands)
        self.rule = band_nodes(self.bands, nodes)
        self.view = field_of_view(camera, margin_px=MARGIN_PX) if view is None else view
        self._maps = RayMaps(camera, self.rule.wavelength_nm.ravel())

    def render(
        self,
        body: SunlitBody,
        *,
        exposure_s: float,
        rotation_cam_from_icrs: FloatArray | None = None,
        trajectory: Trajectory | None = None,
        start_s: float = 0.0,
        line_time_s: float = 0.0,
        in_front: Sequence[SunlitBody] = (),
        noise_share: float = NOISE_SHARE,
        ceiling_e: float = CEILING_E,
        streams: Streams | None = None,
        frame: int = 0,
    ) -> BodyImage:
        """Expected electrons of a body, to be added to the stars'."""
        # rotation_cam_from_icrs (3, 3)
        _check(exposure_s, line_time_s, noise_share, in_front)
        camera = self.camera
        rotation = camera.rotation_cam_from_world if rotation_cam_from_icrs is None else rotation_cam_from_icrs
        duration_s = exposure_s + (camera.height_px - 1) * line_time_s
        attitudes = np.asarray(rotation, float)[None]
        if trajectory is not None:
            attitudes = trajectory.attitude(start_s + duration_s * np.linspace(0.0, 1.0, STEPS)).as_matrix()
        window = _window(camera, self.view, body, attitudes)
        electrons = np.zeros((camera.height_px, camera.width_px, len(self.bands)), np.float32)
        worst_share = 0.0
        if window is not None:
            columns, rows = window
            exposed = BodyExposure(
                _quaternions(attitudes), exposure_s, duration_s, line_time_s, self._path_px(body, attitudes)
            )
            quiet: dict[str, Any] = {"noise_share": noise_share, "ceiling_e": ceiling_e}
            light = _light(camera, body, self.bands, self.rule)
            if body.mesh is None:
                mean, error = sphere_image(
                    self._maps, _sphere(body, in_front, self.rule), exposed, light, window, **quiet
                )
            else:
                sequence = (streams or Streams(0)).child("body", body.name).sequence("rays", frame)
                mean, error = self._mesh(body, attitudes, exposed, light, window, quiet | {"sequence": sequence})
            lit = (mean > 0.0) & (mean < ceiling_e)
            worst_share = float((error[lit] ** 2 / mean[lit]).max(initial=0.0))
            for band in range(len(self.bands)):
                electrons[rows, columns, band] = diffuse(mean[..., band], camera.blur_px)
            if camera.sensitive_columns is not None:
                electrons[:, ~camera.sensitive_columns] = 0.0
        return _finished(electrons, self.rule.name, exposure_s, worst_share)

    def render_system(
        self, system: SolarSystem, rotation_cam_from_icrs: FloatArray, *, turn_rad: float = 0.0, **settings: Any
    ) -> list[tuple[int, BodyImage]]:
        """The Moon, planets and Earth that an attitude sees, the nearest first: row of the body, its image."""
        reach = self.view.radius_rad + 0.5 * system.angular_diameter_rad + turn_rad
        visible = np.flatnonzero(system.direction @ rotation_cam_from_icrs[2] > np.cos(np.minimum(reach, np.pi)))
        order = visible[np.argsort(system.distance_au[visible])]
        bodies = [planet_body(system, system.name[i]) for i in order]
        settings["rotation_cam_from_icrs"] = rotation_cam_from_icrs
        return [
            (int(i), self.render(body, in_front=bodies[:k], **settings))
            for k, (i, body) in enumerate(zip(order, bodies, strict=True))
        ]

    def _path_px(self, body: SunlitBody, attitudes: FloatArray) -> float:
        """Approximate path of the body over the detector [px] in the table of attitudes."""
        v = attitudes @ body.direction
        steps = np.arccos(np.clip(np.einsum("ij,ij->i", v[1:], v[:-1]), -1.0, 1.0)).sum()
        spin = np.abs(Rotation.from_matrix(attitudes[1:] @ attitudes[:-1].transpose(0, 2, 1)).magnitude()).sum()
        scale = 0.5 * self.camera.width_px / math.atan(float(self.view.half_width[0]))
        return float(max(steps, spin * math.sin(body.angular_radius_rad)) * scale) if len(v) > 1 else 0.0

    def _mesh(
        self,
        body: SunlitBody,
        attitudes: FloatArray,
        exposed: BodyExposure,
        light: FloatArray,
        window: tuple[slice, slice],
        quiet: dict[str, Any],
    ) -> tuple[FloatArray, FloatArray]:
        from render.bodies.mesh_image import mesh_image

        columns, rows = window
        moving = len(attitudes) > 1
        part = replace(
            self.camera,
            width_px=columns.stop - columns.start,
            height_px=rows.stop - rows.start,
            centre_px=self.camera.centre_px - [columns.start, rows.start],
            blind_columns_px=(),
            rotation_cam_from_world=self.camera.rotation_cam_from_world if moving else attitudes[0],
        )
        motion = (attitudes, exposed.duration_s, exposed.line_time_s) if moving else None
        return mesh_image(part, body, self.rule, light, exposed.exposure_s, motion, rows.start, **quiet)


def render_body(
    camera: Camera, body: SunlitBody, bands: Sequence[Band], *, nodes: int = 3, **settings: Any
) -> BodyImage:
    """One body through one camera; settings as of `BodyRenderer.render`. `BodyRenderer` makes many images."""
    return BodyRenderer(camera, bands, nodes=nodes).render(body, **settings)


def _check(exposure_s: float, line_time_s: float, noise_share: float, in_front: Sequence[SunlitBody]) -> None:
    checked_exposure(exposure_s)
    if not 0.0 <= line_time_s < math.inf:
        raise DomainError(f"line_time_s = {line_time_s:g} s; it must not be negative")
    if not noise_share > 0.0:
        raise DomainError(f"noise_share = {noise_share:g}; it must be positive")
    if any(body.mesh is not None for body in in_front):
        raise ConfigError("a body in front is a mesh; only spheres can hide other bodies")


def _sphere(body: SunlitBody, in_front: Sequence[SunlitBody], rule: BandNodes) -> SunlitSphere:
    lights = [DirectionalLight(body.to_sun)] + ([] if body.second_light is None else [body.second_light])
    return SunlitSphere(
        direction=body.direction,
        sine=body.radius_km / body.distance_km,
        law=body.law,
        lights=tuple(lights),
        albedo_map=body.albedo_map,
        rotation_icrs_from_body=body.rotation_icrs_from_body,
        covers=tuple(Cover(other.direction, other.radius_km / other.distance_km) for other in in_front),
        air=body.air,
        thickness=rayleigh_thickness(rule.wavelength_nm.ravel()),
        air_unit=1.0 / np.maximum(body.albedo_at(rule.wavelength_nm.ravel()), 1e-12),
    )


def _quaternions(attitudes: FloatArray) -> FloatArray:
    """Quaternions (m, 4) of matrices, neighbours on the same side."""
    quaternion = np.asarray(Rotation.from_matrix(attitudes).as_quat())
    side = np.where(np.einsum("ij,ij->i", quaternion[1:], quaternion[:-1]) < 0.0, -1.0, 1.0)
    quaternion[1:] *= np.cumprod(side)[:, None]
    return quaternion


def _finished(
    electrons: NDArray[np.float32], band: tuple[str, ...], exposure_s: float, noise_share: float
) -> BodyImage:
    light = electrons.astype(float)
    total = light.sum((0, 1))
    row, column = (np.arange(size) for size in light.shape[:2])
    with np.errstate(invalid="ignore", divide="ignore"):
        x, y = np.einsum("hwb,w->b", light, column) / total, np.einsum("hwb,h->b", light, row) / total
    image = ExpectedImage(electrons=electrons, band=band, exposure_s=exposure_s, diffused=True)
    return BodyImage(image=image, electrons=total, photon_px=np.stack([x, y], axis=-1), noise_share=noise_share)


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
    reach = view.radius_rad + float(np.arccos(np.clip(_limb(body)[0] @ body.direction, -1.0, 1.0)))
    near = centre[:, 2] > math.cos(min(reach, math.pi))
    if not near.any():
        return None
    limb = _limb(body)
    limb_cam = np.concatenate([limb @ attitude.T for attitude in attitudes[near][:: max(1, len(attitudes) // 64)]])
    if (limb_cam[:, 2] <= 0.1).any():  # round the camera
        return slice(0, camera.width_px), slice(0, camera.height_px)
    pixel = view.pixel_of(limb_cam)
    beyond = np.isnan(pixel[:, 0])  # the field: about where it would be
    half_px = 0.5 * np.array([camera.width_px, camera.height_px]) + view.margin_px
    pixel[beyond] = camera.centre_px + limb_cam[beyond, :2] / limb_cam[beyond, 2:] / view.half_width * half_px
    low = np.floor(pixel.min(0)).astype(int) - MARGIN_PX
    high = np.ceil(pixel.max(0)).astype(int) + MARGIN_PX + 1
    columns = slice(max(low[0], 0), min(high[0], camera.width_px))
    rows = slice(max(low[1], 0), min(high[1], camera.height_px))
    return None if columns.start >= columns.stop or rows.start >= rows.stop else (columns, rows)


def _limb(body: SunlitBody, count: int = 32) -> FloatArray:
    """Unit vectors (n, 3) along icrs of the outline of the body's sphere."""
    first, second = perpendicular(body.direction)
    turn = 2.0 * np.pi * np.arange(count) / count
    a = body.angular_radius_rad
    if body.air is not None:
        a = math.asin(min(math.sin(a) * (1.0 + AIR_HEIGHTS * body.air.height), 1.0))
    around = np.outer(np.cos(turn), first) + np.outer(np.sin(turn), second)
    return np.asarray(math.cos(a) * body.direction + math.sin(a) * around)
