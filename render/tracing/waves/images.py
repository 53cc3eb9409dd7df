"""Diffraction images of a star field: stars interpolated on a grid over the field, and stars summed individually."""

from __future__ import annotations

import math
import pickle
from dataclasses import replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from optics.arrays import FloatArray, IntArray
from optics.light.collimation import Collimation
from render.tracing.motion.exposure import IdealLens
from render.tracing.motion.paths import NodeLight
from render.tracing.pupil.planning import Bounds, PlannedExposure, PupilPlanner
from render.tracing.pupil.points import OutlinePoints
from render.tracing.pupil.quadrature_order import whole_disk
from render.tracing.rays.images import RayImages
from render.tracing.truth import Sampling, TruthSums, WaveStamps, add_stamps, check_lit
from render.tracing.waves.diffraction_spikes import add_far_images
from render.tracing.waves.direct_sums import DirectSums, LightCache, Trail
from render.tracing.waves.field_grid import WaveGrid
from render.tracing.waves.field_grid_build import LEAST_STARS, WING_PX, GridPlan, build_grid, plan_grid
from render.tracing.waves.wavelength_interpolation import condensed_light

GRIDS, GRID_BATCH = 4, 256
"""Grids of images (of other cameras or wavelengths) that are cached; stars that are interpolated at a time."""
SPREAD = 0.25
"""Fraction of the detector that stars must spread over for a grid over all of it."""

GridKey = tuple[bytes, bytes, bytes, float]
_grids: dict[GridKey, WaveGrid | None] = {}
_plans: dict[GridKey, GridPlan] = {}


def _state(wavelength_nm: FloatArray, collimation: Collimation | None) -> tuple[bytes, bytes]:
    """Parameters of images other than the camera, the directions and the spectra."""
    return wavelength_nm.tobytes(), b"" if collimation is None else collimation.at(wavelength_nm).tobytes()


def _cached(cache: dict[GridKey, Any], key: GridKey, value: Any) -> None:
    """Add a value to a cache of `GRIDS` entries."""
    while len(cache) >= GRIDS:
        cache.pop(next(iter(cache)))
    cache[key] = value


class WaveImages:
    """Makes diffraction images of the stars of one camera (`render.tracing.tracer.ImageMaker`).

    Rays give the truth of stars that are summed individually. Grids of images are cached between star fields, and
    shared by all tracers of equal cameras, for frames and for PSFs. The light of the stars of the last field is cached
    for their PSFs. With ``by_grid`` few stars are taken from a grid too, as where many more fields follow.
    """

    def __init__(self, planner: PupilPlanner, *, by_grid: bool = False) -> None:
        self.planner, self.camera, self.rays = planner, planner.camera, RayImages(planner)
        self.by_grid = by_grid
        self._last: tuple[tuple[bytes, bytes], LightCache] = (b"", b""), {}

    def add(self, light: NodeLight, exposure: PlannedExposure, image: NDArray[np.float32], sums: TruthSums) -> Sampling:
        """Add stars to the image and their truth to the sums; how they were sampled."""
        if not image.size:
            return self.rays.add(light, exposure, image, sums)
        sampling = Sampling()
        by_grid = self._add_by_grid(light, exposure, image, sums, sampling)
        single = np.setdiff1d(np.arange(exposure.mid.count), by_grid)
        if not len(by_grid):
            self._add_summed(light, exposure, image, sums, sampling)
        elif len(single):
            others = TruthSums.empty(len(single), light.electrons.shape[1])
            others.chief[...] = sums.chief[single]
            chiefs, length_px = exposure.chiefs.take(single), exposure.length_px
            some = self.planner.exposure(exposure.paths.take(single), exposure.wavelength_nm, length_px, chiefs=chiefs)
            self._add_summed(light.take(single), some, image, others, sampling)
            sums.put(single, others)
        return sampling

    def _add_by_grid(
        self,
        light: NodeLight,
        exposure: PlannedExposure,
        image: NDArray[np.float32],
        sums: TruthSums,
        sampling: Sampling,
    ) -> IntArray:
        """Add stars by a grid of images, if they are many enough for it; which."""
        nobody, chief = np.empty(0, np.int64), sums.chief
        if self.camera.diffraction != "waves" or exposure.shade is not None:
            return nobody
        stars = np.flatnonzero(((chief > -0.5 - WING_PX) & (chief < self._far_edge)).all((1, 2)))
        state = light.wavelength_nm, exposure.paths.collimation
        if not len(stars) or not self._pays(chief[stars], *state):
            return nobody
        grid = self._grid(*state, 0.0)
        if grid is None:
            return nobody
        direction = exposure.paths.mid
        stars = stars[grid.holds(direction[stars])]
        spectrum, trail = self._moving(light, exposure)
        for part in (stars[i : i + GRID_BATCH] for i in range(0, len(stars), GRID_BATCH)):
            stamps = grid.stamps(part, direction[part], spectrum[part], chief[part], trail)
            self._add_stamps(stamps, light, image, sums, sampling)
            add_far_images(self.planner, stamps, grid.radius_px, light, image, sums, trail)
        return stars

    def _add_summed(
        self,
        light: NodeLight,
        exposure: PlannedExposure,
        image: NDArray[np.float32],
        sums: TruthSums,
        sampling: Sampling,
    ) -> None:
        """Add diffraction images of all stars whose light may meet the detector, after the truth of their rays."""
        no_image = np.zeros((0, 0, image.shape[2]), np.float32)
        near = self.near(self.rays.traced(light, exposure, no_image, sums)[0].bounds)
        if not len(near):
            return
        condensed, images = self.summed(light, exposure)
        state = _state(condensed.wavelength_nm, exposure.paths.collimation)
        self._last = state, images.cache if exposure.shade is None else {}
        for group in self.planner.sampled_by_waves(images.still, near).groups:
            for stamps in images.stamps(group):
                self._add_stamps(stamps, light, image, sums, sampling)
                if exposure.shade is None:  # an obstacle in a beam diffracts at edges of its own
                    radius_px = 0.5 * (stamps.pixels.shape[-1] - 1 - images.room_px(stamps.stars))
                    add_far_images(self.planner, stamps, radius_px, light, image, sums, images.trail)

    @property
    def _far_edge(self) -> FloatArray:
        """Largest column and row of stars whose images are rendered."""
        return np.array([self.camera.width_px, self.camera.height_px]) - 0.5 + WING_PX

    def near(self, bounds: Bounds) -> IntArray:
        """Stars whose images may reach the detector."""
        inside = np.all((bounds.high > -0.5 - WING_PX) & (bounds.low < self._far_edge), axis=2)
        return np.flatnonzero(np.any(inside, axis=1))

    def summed(self, light: NodeLight, exposure: PlannedExposure) -> tuple[NodeLight, DirectSums]:
        """Light of the wavelengths that have images, and these images of the stars."""
        condensed = self.condensed(light, exposure)
        spectrum, trail = self._moving(condensed, exposure)
        still = self.planner.still(exposure, condensed.wavelength_nm)
        return condensed, DirectSums(self.planner, still, spectrum, trail)

    def cells(self, light: NodeLight, exposure: PlannedExposure, half_size_px: int, cells_per_px: int) -> FloatArray:
        """Light per cell (n, b, m, m) of squares about the centroids, as fractions of what arrives.

        By a grid, corners of the square are dark where its stamps have ended.
        """
        radius_px, chiefs = math.ceil(half_size_px + 0.5), exposure.chiefs
        chief, state = chiefs.position_px, (light.wavelength_nm, exposure.paths.collimation)
        if self.camera.diffraction == "waves" and self._pays(chief, *state):
            grid = self._grid(*state, 0.0)  # that of the images serves, if it is as large
            if grid is not None and grid.radius_px < radius_px:  # no frame would use a larger one
                grid = self._grid(*state, float(radius_px)) if self.by_grid else None
            if grid is not None and grid.holds(exposure.paths.mid).all() and not chiefs.blocked.any():
                return grid.cells(exposure.paths.mid, light.weight, chief, half_size_px, cells_per_px)
        condensed, images = self.summed(light, exposure)
        if self._last[0] == _state(condensed.wavelength_nm, exposure.paths.collimation):
            images.cache = self._last[1]
        side = (2 * half_size_px + 1) * cells_per_px
        result = np.empty((*light.electrons.shape, side, side))
        for group in self.planner.sampled_by_waves(images.still, np.arange(len(result))).groups:
            for stars, cells in images.cells(group, half_size_px, cells_per_px):
                result[stars] = cells
        check_lit(result[:, :, 0, :2])
        return result

    def _pays(self, position_px: FloatArray, wavelength_nm: FloatArray, collimation: Collimation | None) -> bool:
        """Whether a grid over all of the detector costs less for stars at positions (n, b, 2)."""
        if self.by_grid:
            return True
        if len(position_px) < LEAST_STARS or self.camera.diffraction != "waves":
            return False
        if np.ptp(position_px, axis=(0, 1)).prod() <= SPREAD * self.camera.width_px * self.camera.height_px:
            return False
        key = self._camera_state, *_state(wavelength_nm, collimation), 0.0
        if key not in _plans:
            _cached(_plans, key, plan_grid(self.planner, wavelength_nm, collimation))
        return _plans[key].pays(len(position_px))

    def _grid(self, wavelength_nm: FloatArray, collimation: Collimation | None, radius_px: float) -> WaveGrid | None:
        """The grid of images at these wavelengths, at least as large as a radius; None if there is none."""
        key = self._camera_state, *_state(wavelength_nm, collimation), radius_px
        if key not in _grids:
            _cached(_grids, key, build_grid(self.planner, wavelength_nm, collimation, radius_px))
        return _grids[key]

    @cached_property
    def _camera_state(self) -> bytes:
        """Parameters of the camera that images depend on."""
        return pickle.dumps(
            replace(self.camera, rotation_cam_from_world=np.eye(3), response=None, far=None, scatter=None)
        )

    def condensed(self, light: NodeLight, exposure: PlannedExposure) -> NodeLight:
        """Light of the fewest wavelengths that represent the images of all, unless none may be interpolated."""
        if self.camera.diffraction == "exact_waves":
            return light
        middle_nm = light.wavelength_nm.mean(1, keepdims=True)
        x, y, arrived = exposure.mid.land(whole_disk((4, 8), 1), middle_nm)
        extent = [np.where(arrived, v, -np.inf).max(-1) - np.where(arrived, v, np.inf).min(-1) for v in (x, y)]
        spot_px = 0.5 * max(float(v.max(initial=0.0, where=np.isfinite(v))) for v in extent)
        focal_px, radius_mm = IdealLens.of(self.camera).focal_px, self.planner.pupil.radius_mm
        turns = spot_px * radius_mm / (focal_px * 1e-6 * float(middle_nm.min()))
        waves, weight = condensed_light(light.wavelength_nm, light.weight, 2.0 * math.pi * turns)
        return NodeLight(waves, weight, light.electrons)

    def _add_stamps(
        self, stamps: WaveStamps, light: NodeLight, image: NDArray[np.float32], sums: TruthSums, sampling: Sampling
    ) -> None:
        electrons = light.electrons[stamps.stars]
        on_image = add_stamps(image, stamps.pixels, stamps.corner_px, electrons, self.camera.sensitive_columns)
        sums.store_waves(stamps, electrons, on_image)
        stars, rays = sampling.get(stamps.mode, (0, 0))
        sampling[stamps.mode] = (stars + len(stamps.stars), max(rays, stamps.rays * light.wavelength_nm.shape[1]))

    @staticmethod
    def _moving(light: NodeLight, exposure: PlannedExposure) -> tuple[FloatArray, Trail | None]:
        """Weights of wavelengths (n, b, k) of an exposure, and the motion of images; None for a camera at rest."""
        bands, colours = light.wavelength_nm.shape
        weight = light.weight.reshape(*light.weight.shape[:2], -1, colours)
        if exposure.nodes is exposure.mid:
            return weight.sum(2), None
        times, chiefs = exposure.nodes.times, exposure.chiefs
        points = np.nan_to_num(chiefs.points)
        ray = OutlinePoints(
            centre=points,
            azimuth=np.zeros((times, 1)),
            radius=np.zeros((len(points), bands, times, 1)),
            area=np.ones((len(points), bands, times, 1)),
            arm=np.zeros(1, np.uint32),
            ring=np.zeros(1),
            ring_weight=np.ones(1),
        )
        x, y, _ = exposure.nodes.land(ray, light.wavelength_nm.mean(1, keepdims=True))
        offset = np.stack([x[..., 0], y[..., 0]], axis=-1) - chiefs.position_px[:, :, None]
        return weight.sum(2), Trail(np.nan_to_num(offset), weight.sum(3))
