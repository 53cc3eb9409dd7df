"""Point-source transmittance (PST) of a sensor by cause: ghosts and scatter of its lens, walls and edges of its baffle.

A baffle that leaves a fraction of the entrance in the light passes that fraction of the scatter of the bare lens, and
scatters light to the lens, weighted with the PST of the lens at its angle of arrival.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import RectBivariateSpline

from optics.arrays import FloatArray
from optics.frames import polar_direction
from optics.light.pst import FLOOR, PointSourceTransmittance
from optics.rays.ghosts import entrance_radius_mm, ghost_irradiance
from optics.rays.surface_scatter import ScatterLaw, imaging_rays, scattered_irradiance
from render.baffle.light import BaffleScene, LensWeight, lens_weight
from render.camera import Camera

CAUSES = ("ghosts", "polish", "dust", "walls", "edges")
SMALLEST = 1e-12
"""PST whose error does not matter."""


def corner_field_deg(camera: Camera, focal_length_mm: float) -> float:
    """Half angle of the field to the corner of the detector."""
    x, y = camera.centre_px + 0.5 * np.array([camera.width_px, camera.height_px])
    return float(np.degrees(np.arccos(camera.nominal_direction(x, y, focal_length_mm)[2])))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LensTransmittance:
    """PST of a bare lens over z azimuths and a angles, and at p x p points of the detector."""

    angle_deg: FloatArray  # (a,)
    azimuth_deg: FloatArray  # (z,)
    value: Mapping[str, FloatArray]  # "ghosts" and the causes of scatter: (z, a)
    ghosts_error: FloatArray  # (z, a) Standard error of the ghosts; scatter is a sum without one
    points: Mapping[str, FloatArray]  # Causes of scatter: (z, a, p, p), rows and columns
    entrance_mm: float
    field_deg: float  # To the corner


def lens_transmittance(
    camera: Camera,
    focal_length_mm: float,
    laws: Mapping[str, Mapping[int, ScatterLaw]],
    angle_deg: ArrayLike,
    azimuth_deg: ArrayLike,
    *,
    points: int = 4,
    pupil: tuple[int, int] = (3, 8),
    ghost_rays: tuple[int, int] = (12, 32),
    detector_reflectance: float = 0.2,
    shade_deg: float = 90.0,
    each: Callable[[Callable[..., None], Iterable[tuple[int, ...]]], Iterable[None]] = map,
    advance: Callable[[], None] = lambda: None,
    **glass: Any,
) -> LensTransmittance:
    """PST of the bare lens of a camera.

    In the shade of a baffle, from ``shade_deg`` on, where only the mean over azimuths counts, that of the first one.

    Parameters
    ----------
    camera, focal_length_mm
        Focused lens and detector; the focal length gives the directions of its points.
    laws : mapping
        Cause -> number of a surface -> BSDF, as of `optics.rays.surface_scatter.scattered_irradiance`.
    angle_deg, azimuth_deg : (a,), (z,)
        Of the source from the boresight; none of the light of sources at 90 deg arrives.
    points : int
        Points along each side of the detector.
    pupil, ghost_rays : (rings, azimuths)
        Quadrature of the scatter over the pupil; ghost rays on the first surface.
    each : callable
        Runs the directions: `map`, or the ``map`` of a pool of threads.
    advance : callable
        Called after each direction.
    **glass
        ``coating``, ``absorption``: as of `optics.rays.surface_scatter.imaging_rays`.
    """
    lens, half = camera.focused_lens, 0.5 * np.array([camera.width_px, camera.height_px])
    across = (np.arange(points) + 0.5) / points * 2.0 - 1.0
    x, y = (grid.ravel() for grid in np.meshgrid(*(np.outer(half, across) + camera.centre_px[:, None])))
    directions = camera.nominal_direction(x, y, focal_length_mm)
    imaging = imaging_rays(lens, directions, rings=pupil[0], arms=pupil[1], **glass)
    angle, azimuth = np.asarray(angle_deg, float), np.asarray(azimuth_deg, float)
    shape, half_mm = (len(azimuth), len(angle)), tuple((half * camera.pixel_pitch_mm).tolist())
    scatter = {cause: np.zeros((*shape, points, points)) for cause in laws}
    ghosts, ghosts_error = np.zeros(shape), np.zeros(shape)

    def fill(at: tuple[int, ...]) -> None:
        if angle[at[1]] < 90.0 and (at[0] == 0 or angle[at[1]] < shade_deg):
            source = polar_direction(angle[at[1]], azimuth[at[0]])
            for cause, light in scattered_irradiance(imaging, source, laws).items():
                scatter[cause][at] = light.sum(axis=1).reshape(points, points)
            rays: dict[str, Any] = {
                "rings": ghost_rays[0],
                "arms": ghost_rays[1],
                "detector_reflectance": detector_reflectance,
            }
            value, error = np.array(list(ghost_irradiance(lens, source, half_mm, **rays, **glass).values())).T
            ghosts[at], ghosts_error[at] = value.sum(), np.sqrt((error**2).sum())
        advance()

    list(each(fill, np.ndindex(shape)))
    for light in (ghosts, ghosts_error, *scatter.values()):
        light[1:, angle >= shade_deg] = light[:1, angle >= shade_deg]
    mean = {cause: light.mean(axis=(2, 3)) for cause, light in scatter.items()}
    return LensTransmittance(
        angle_deg=angle,
        azimuth_deg=azimuth,
        value={"ghosts": ghosts} | mean,
        ghosts_error=ghosts_error,
        points=scatter,
        entrance_mm=entrance_radius_mm(lens),
        field_deg=corner_field_deg(camera, focal_length_mm),
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class SensorTransmittance:
    """PST of lens and baffle, or a table of it."""

    pst: PointSourceTransmittance
    direct: FloatArray  # (z, a) Fraction of the entrance in the light of the source
    lens: LensTransmittance | None = None
    scene: BaffleScene | None = None
    rays: int = 0
    weight: LensWeight | None = None  # PST of the bare lens against the angle [rad]

    @cached_property
    def worst_percent(self) -> float:
        """Largest relative error of the light by walls and vanes [%], where it matters; 0 without them."""
        if "walls" not in self.pst.causes:
            return 0.0
        row = self.pst.causes.index("walls")
        matters = self.pst.error[row] > SMALLEST
        return float(100.0 * (self.pst.error[row][matters] / self.pst.value[row][matters]).max(initial=0.0))

    def over_pixels(self, angle_deg: float, shape: tuple[int, int]) -> FloatArray:
        """PST over the pixels (h, w) for a source at an angle and the first azimuth.

        Scatter of the lens as it lies on the detector, everything else even.
        """
        mean = float(self.pst.at(polar_direction(angle_deg, self.pst.azimuth_deg[0])))
        if self.lens is None:
            return np.full(shape, mean)
        angle = np.log(self.pst.angle_deg)
        point = np.clip(np.log(angle_deg), angle[0], angle[-1])

        def between(values: FloatArray) -> FloatArray:
            log = np.log(np.maximum(values, FLOOR)).reshape(len(angle), -1)
            return np.exp([np.interp(point, angle, column) for column in log.T]).reshape(values.shape[1:])

        scattered = between(self.direct[0] * sum(self.lens.value[cause][0] for cause in ("polish", "dust")))
        if scattered <= 10.0 * FLOOR:
            return np.full(shape, mean)
        pattern = between(np.asarray(sum(self.lens.points[cause][0] for cause in ("polish", "dust"))))
        count = len(pattern)
        knots = [(np.arange(count) + 0.5) / count * size - 0.5 for size in shape]
        order = min(3, count - 1)
        spline = RectBivariateSpline(*knots, np.log(np.maximum(pattern, FLOOR)), kx=order, ky=order)
        rows, columns = (np.clip(np.arange(size), knot[0], knot[-1]) for size, knot in zip(shape, knots, strict=True))
        image = np.exp(spline(rows, columns))
        return np.asarray(max(mean - float(scattered), 0.0) + float(scattered) * image / image.mean())


def sensor_transmittance(
    lens: LensTransmittance,
    scene: BaffleScene | None,
    *,
    dust: str = "dust",
    chosen: Sequence[int] | None = None,
    error: float = 0.05,
    source: str = "",
    advance: Callable[[], None] = lambda: None,
) -> SensorTransmittance:
    """PST of a lens behind a baffle, by `CAUSES`.

    Parameters
    ----------
    lens : LensTransmittance
        The bare lens.
    scene : BaffleScene, optional
        Its baffle.
    dust : str
        Cause of ``lens`` that counts as dust.
    chosen : sequence of int, optional
        Numbers of the angles; all if left out.
    error : float
        Relative standard error of walls and vanes.
    source : str
        Origin, stated in the table.
    advance : callable
        Called after each direction.
    """
    at = np.arange(len(lens.angle_deg)) if chosen is None else np.asarray(chosen)
    bare = [lens.value[cause] for cause in ("ghosts", "polish", dust)]
    shape = (len(CAUSES), len(lens.azimuth_deg), len(at))
    value, spread, direct = np.zeros(shape), np.zeros(shape), np.ones(shape[1:])
    rays, weight = 0, None
    if scene is not None:
        total = np.asarray(sum(bare)).mean(axis=0)
        weight = lens_weight(lens.angle_deg[total > 0.0], total[total > 0.0])
        for z, a in np.ndindex(shape[1:]):
            if scene.baffle is not None and z:  # a tube looks the same from all sides
                value[3:, z, a], spread[3:, z, a], direct[z, a] = value[3:, 0, a], spread[3:, 0, a], direct[0, a]
            else:
                towards = polar_direction(lens.angle_deg[at[a]], lens.azimuth_deg[z])
                light = scene.light(towards, weight, error=error, number=1000 * z + int(at[a]), least=SMALLEST)
                direct[z, a], rays = light.direct, rays + light.rays
                value[3:, z, a], spread[3:, z, a] = (light.walls, light.edges), (light.walls_error, light.edges_error)
            advance()
    value[:3] = np.array(bare)[:, :, at] * direct
    spread[0] = lens.ghosts_error[:, at] * direct
    pst = PointSourceTransmittance(
        angle_deg=lens.angle_deg[at],
        azimuth_deg=lens.azimuth_deg,
        causes=CAUSES,
        value=value,
        error=spread,
        source=source,
    )
    return SensorTransmittance(pst=pst, direct=direct, lens=lens, scene=scene, rays=rays, weight=weight)
