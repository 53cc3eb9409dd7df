"""Diffraction images of a star field: stars served by a grid over the field, and stars summed individually."""

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
from render.tracing.motion.paths import Light
from render.tracing.pupil.planning import Bounds, Exposure, PupilPlanner
from render.tracing.pupil.points import OutlinePoints
from render.tracing.pupil.sampling import whole_disk
from render.tracing.rays.images import RayImages
from render.tracing.truth import Sampling, TruthSums, WaveStamps, add_stamps, check_lit
from render.tracing.waves.far import add_far_images
from render.tracing.waves.grid import LEAST_STARS, WING_PX, GridPlan, WaveGrid, build_grid, plan_grid
from render.tracing.waves.spectrum import condensed_light
from render.tracing.waves.summed import KeptLight, SummedImages, Trail

GRIDS, GRID_BATCH = 4, 256
"""Grids of images (of other cameras or wavelengths) that are kept; stars that are interpolated at a time."""
SPREAD = 0.25
"""Part of the detector that stars must spread over for a grid over all of it."""

GridKey = tuple[bytes, bytes, bytes, float]
_grids: dict[GridKey, WaveGrid | None] = {}
_plans: dict[GridKey, GridPlan] = {}


def _state(wavelength_nm: FloatArray, collimation: Collimation | None) -> tuple[bytes, bytes]:
    """Parameters of images at some places other than the camera and the shares of wavelengths."""
    return wavelength_nm.tobytes(), b"" if collimation is None else collimation.at(wavelength_nm).tobytes()


def _kept(known: dict[GridKey, Any], key: GridKey, value: Any) -> None:
    """Keep a value, and few others."""
    while len(known) >= GRIDS:
        known.pop(next(iter(known)))
    known[key] = value


class WaveImages:
    """Makes diffraction images of the stars of one camera (`render.tracing.tracer.ImageMaker`).

    Rays tell the truth of stars that are summed one by one. Grids of images are kept between star fields, and shared by
    all tracers of equal cameras, for frames and for PSFs. The light of the stars of the last field is kept for their
    PSFs. With ``by_grid`` few stars are taken from a grid too, as where many more fields follow.
    """

    def __init__(self, planner: PupilPlanner, *, by_grid: bool = False) -> None:
        self.planner, self.camera, self.rays = planner, planner.camera, RayImages(planner)
        self.by_grid = by_grid
        self._known: tuple[tuple[bytes, bytes], KeptLight] = (b"", b""), {}

    def add(self, light: Light, exposure: Exposure, image: NDArray[np.float32], sums: TruthSums) -> Sampling:
        """Add stars to the image and what is known of them to the sums; how they were sampled."""
        if not image.size:
            return self.rays.add(light, exposure, image, sums)
        sampling = Sampling()
        by_grid = self._add_by_grid(light, exposure, image, sums, sampling)
        left = np.setdiff1d(np.arange(exposure.mid.count), by_grid)
        if not len(by_grid):
            self._add_summed(light, exposure, image, sums, sampling)
        elif len(left):
            others = TruthSums.empty(len(left), light.electrons.shape[1])
            others.chief[...] = sums.chief[left]
            chiefs, length_px = exposure.chiefs.take(left), exposure.length_px
            some = self.planner.exposure(exposure.paths.take(left), exposure.wavelength_nm, length_px, chiefs=chiefs)
            self._add_summed(light.take(left), some, image, others, sampling)
            sums.put(left, others)
        return sampling

    def _add_by_grid(
        self, light: Light, exposure: Exposure, image: NDArray[np.float32], sums: TruthSums, sampling: Sampling
    ) -> IntArray:
        """Add stars by a grid of images, if they are many enough for it; which."""
        camera, nobody, chief = self.camera, np.empty(0, np.int64), sums.chief
        if camera.diffraction != "waves" or exposure.shade is not None:
            return nobody
        edge = np.array([camera.width_px, camera.height_px]) - 0.5 + WING_PX
        stars = np.flatnonzero(((chief > -0.5 - WING_PX) & (chief < edge)).all((1, 2)))
        by = light.wavelength_nm, exposure.paths.collimation
        if not len(stars) or not self._pays(chief[stars], *by):
            return nobody
        grid = self._grid(*by, 0.0)
        if grid is None:
            return nobody
        direction = exposure.paths.mid
        stars = stars[grid.holds(direction[stars])]
        share, trail = self._moving(light, exposure)
        for part in (stars[i : i + GRID_BATCH] for i in range(0, len(stars), GRID_BATCH)):
            stamps = grid.stamps(part, direction[part], share[part], chief[part], trail)
            self._add_stamps(stamps, light, image, sums, sampling)
            add_far_images(self.planner, stamps, grid.radius_px, light, image, sums, trail)
        return stars

    def _add_summed(
        self, light: Light, exposure: Exposure, image: NDArray[np.float32], sums: TruthSums, sampling: Sampling
    ) -> None:
        """Add diffraction images of all stars whose light may meet the detector, after the truth of their rays."""
        nothing = np.zeros((0, 0, image.shape[2]), np.float32)
        near = self.near(self.rays.traced(light, exposure, nothing, sums)[0].bounds)
        if not len(near):
            return
        few, images = self.summed(light, exposure)
        self._known = (
            _state(few.wavelength_nm, exposure.paths.collimation),
            images.kept if exposure.shade is None else {},
        )
        for group in self.planner.sampled_by_waves(images.still, near).groups:
            for stamps in images.stamps(group):
                self._add_stamps(stamps, light, image, sums, sampling)
                if exposure.shade is None:  # what stands in a beam makes edges of its own
                    radius_px = 0.5 * (stamps.pixels.shape[-1] - 1 - images.room_px(stamps.stars))
                    add_far_images(self.planner, stamps, radius_px, light, image, sums, images.trail)

    def near(self, bounds: Bounds) -> IntArray:
        """Stars whose images may reach the detector."""
        edge = np.array([self.camera.width_px, self.camera.height_px]) - 0.5 + WING_PX
        inside = np.all((bounds.high > -0.5 - WING_PX) & (bounds.low < edge), axis=2)
        return np.flatnonzero(np.any(inside, axis=1))

    def summed(self, light: Light, exposure: Exposure) -> tuple[Light, SummedImages]:
        """Light of the wavelengths that have images, and these images of the stars."""
        few = self.condensed(light, exposure)
        share, trail = self._moving(few, exposure)
        return few, SummedImages(self.planner, self.planner.still(exposure, few.wavelength_nm), share, trail)

    def cells(self, light: Light, exposure: Exposure, half_size_px: int, cells_per_px: int) -> FloatArray:
        """Light per cell (n, b, m, m) of squares about the centroids, in shares of what arrives.

        By a grid, corners of the square are dark where its stamps have ended.
        """
        radius_px, chiefs = math.ceil(half_size_px + 0.5), exposure.chiefs
        chief, by = chiefs.place_px, (light.wavelength_nm, exposure.paths.collimation)
        if self.camera.diffraction == "waves" and self._pays(chief, *by):
            grid = self._grid(*by, 0.0)  # that of the images serves, if it is as large
            if grid is not None and grid.radius_px < radius_px:
                grid = self._grid(*by, float(radius_px)) if self.by_grid else None  # which no frame would share
            if grid is not None and grid.holds(exposure.paths.mid).all() and not chiefs.blocked.any():
                return grid.cells(exposure.paths.mid, light.share, chief, half_size_px, cells_per_px)
        few, images = self.summed(light, exposure)
        if self._known[0] == _state(few.wavelength_nm, exposure.paths.collimation):
            images.kept = self._known[1]
        side = (2 * half_size_px + 1) * cells_per_px
        result = np.empty((*light.electrons.shape, side, side))
        for group in self.planner.sampled_by_waves(images.still, np.arange(len(result))).groups:
            for stars, cells, _ in images.cells(group, half_size_px, cells_per_px):
                result[stars] = cells
        check_lit(result[:, :, 0, :2])
        return result

    def _pays(self, place_px: FloatArray, wavelength_nm: FloatArray, collimation: Collimation | None) -> bool:
        """Whether a grid over all of the detector is of use to stars at places (n, b, 2)."""
        if self.by_grid:
            return True
        if len(place_px) < LEAST_STARS or self.camera.diffraction != "waves":
            return False
        if np.ptp(place_px, axis=(0, 1)).prod() <= SPREAD * self.camera.width_px * self.camera.height_px:
            return False
        key = self._camera_state, *_state(wavelength_nm, collimation), 0.0
        if key not in _plans:
            _kept(_plans, key, plan_grid(self.planner, wavelength_nm, collimation))
        return _plans[key].pays(len(place_px))

    def _grid(self, wavelength_nm: FloatArray, collimation: Collimation | None, radius_px: float) -> WaveGrid | None:
        """The grid of images at these wavelengths, at least as large as a radius; None if there is none."""
        key = self._camera_state, *_state(wavelength_nm, collimation), radius_px
        if key not in _grids:
            _kept(_grids, key, build_grid(self.planner, wavelength_nm, collimation, radius_px))
        return _grids[key]

    @cached_property
    def _camera_state(self) -> bytes:
        """What images depend on of a camera."""
        return pickle.dumps(
            replace(self.camera, rotation_cam_from_world=np.eye(3), response=None, far=None, scatter=None)
        )

    def condensed(self, light: Light, exposure: Exposure) -> Light:
        """Light of as few wavelengths as tell the images of all, unless none may be interpolated."""
        if self.camera.diffraction == "exact_waves":
            return light
        middle_nm = light.wavelength_nm.mean(1, keepdims=True)
        x, y, arrived = exposure.mid.land(whole_disk((4, 8), 1), middle_nm)
        extent = [np.where(arrived, v, -np.inf).max(-1) - np.where(arrived, v, np.inf).min(-1) for v in (x, y)]
        spot_px = 0.5 * max(float(v.max(initial=0.0, where=np.isfinite(v))) for v in extent)
        focal_px, radius_mm = IdealLens.of(self.camera).focal_px, self.planner.pupil.radius_mm
        turns = spot_px * radius_mm / (focal_px * 1e-6 * float(middle_nm.min()))
        waves, share = condensed_light(light.wavelength_nm, light.share, 2.0 * math.pi * turns)
        return Light(waves, share, light.electrons)

    def _add_stamps(
        self, stamps: WaveStamps, light: Light, image: NDArray[np.float32], sums: TruthSums, sampling: Sampling
    ) -> None:
        electrons = light.electrons[stamps.stars]
        columns = self.camera.sensitive_columns
        on_image = add_stamps(image, stamps.pixels, stamps.corner_px, electrons, columns)
        sums.store_waves(stamps, electrons, on_image)
        stars, rays = sampling.get(stamps.mode, (0, 0))
        sampling[stamps.mode] = (stars + len(stamps.stars), max(rays, stamps.rays * light.wavelength_nm.shape[1]))

    @staticmethod
    def _moving(light: Light, exposure: Exposure) -> tuple[FloatArray, Trail | None]:
        """Shares of wavelengths (n, b, k) of an exposure, and how images move during it; None for a camera at rest."""
        bands, colours = light.wavelength_nm.shape
        share = light.share.reshape(*light.share.shape[:2], -1, colours)
        if exposure.nodes is exposure.mid:
            return share.sum(2), None
        times, chiefs = exposure.nodes.times, exposure.chiefs
        points = np.nan_to_num(chiefs.points)
        ray = OutlinePoints(
            centre=points,
            azimuth=np.zeros((times, 1)),
            radius=np.zeros((len(points), bands, times, 1)),
            share=np.ones((len(points), bands, times, 1)),
            arm=np.zeros(1, np.uint32),
            ring=np.zeros(1),
            ring_weight=np.ones(1),
        )
        x, y, _ = exposure.nodes.land(ray, light.wavelength_nm.mean(1, keepdims=True))
        offset = np.stack([x[..., 0], y[..., 0]], axis=-1) - chiefs.place_px[:, :, None]
        return share.sum(2), Trail(np.nan_to_num(offset), share.sum(3))
