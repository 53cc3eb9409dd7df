"""The grid of diffraction images (`render.tracing.wave_grid`) for one state of a lens, made and judged.

Nothing is taken on trust: a grid is made finer until images and means of rays at places between its points, of light at
either end of a band and of that which its wavelengths follow worst, differ from exact ones by less than `TOLERANCE`. A
mixture of wavelengths is nearer still. Where the finest fails (apertures that start to cut the beam leave a kink in the
field) there is none, and every star is summed by itself.
"""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import product

import numpy as np
from numpy.typing import NDArray

from optics.arrays import FloatArray, IntArray
from optics.light.collimation import Collimation
from optics.rays.pupil import gauss_disk
from render.tracing.ideal_lens import IdealLens
from render.tracing.paths import at_rest
from render.tracing.plane_waves import PlaneWaves
from render.tracing.planning import PupilPlanner
from render.tracing.pupil_points import TablePoints
from render.tracing.wave_grid import WaveGrid, chebyshev
from render.tracing.wave_images import LARGEST_RADIUS_PX, WaveGroup, WaveImages
from render.tracing.wave_spectrum import picked_wavelengths
from render.tracing.wave_windows import COARSE_REACH_PX, coarser, window_samples

__all__ = ["TOLERANCE", "WING_PX", "build_grid", "worth_a_grid"]


TOLERANCE = 1e-4
"""Largest error of a pixel [share of the light], and of the centroid in a window of 13 x 13 px [px]."""
SIZES = (5, 7, 9, 11, 13, 15)
"""Points along either side that are tried."""
GAIN = 4.0
"""By how much the next size lowers the error, at least; sizes that would not do are passed over."""
LEAST_STARS = 12
"""Stars on the detector, of wavelengths as many as a grid needs, from which it costs less over a few frames."""
CENTROID_PX = 6
"""Half the side of the window whose centroid is compared."""
PROBES = 6
"""Places where a grid is judged, the last in a corner."""
COMPONENT = 5e-6
"""Error that principal components may leave in images of the coarsest grid, as a share of the light; finer grids weigh
their images with larger numbers of both signs."""
MOST_IMAGES = 1900
"""Images of a band that a grid is made of, whose matrix of products is still cheap."""
WING_PX = 30.0
"""How far beside the detector a star may be for its image to be rendered; so far the grid reaches."""
SYMMETRIC_PX = 1e-6
"""Difference of rays from mirrored ones below which a quarter of the field tells the rest."""


def worth_a_grid(wavelength_nm: FloatArray, stars: int) -> bool:
    """Whether so many stars on the detector, of wavelengths (b, k), cost less by a grid."""
    return stars * wavelength_nm.shape[1] >= LEAST_STARS * max(
        len(picked_wavelengths(band)[0]) for band in wavelength_nm
    )


def build_grid(
    planner: PupilPlanner,
    wavelength_nm: FloatArray,
    collimation: Collimation | None = None,
    least_radius_px: float = 0.0,
) -> WaveGrid | None:
    """The coarsest grid that is good enough; None where there is none.

    Parameters
    ----------
    planner : PupilPlanner
        Of the camera.
    wavelength_nm : (b, k)
        Wavelengths of the stars.
    collimation : Collimation, optional
        Error of the light of a collimator.
    least_radius_px : float
        Of the images.
    """
    field = _FieldImages(planner, wavelength_nm, collimation, least_radius_px)
    mirrored = field.symmetric()
    at, last = 0, len(SIZES) - 1
    while True:
        grid = field.grid(SIZES[at], mirrored)
        if grid is None:
            return None
        error = max(grid.error, grid.error_px) / TOLERANCE
        if error < 1.0 or at == last:
            return grid if error < 1.0 else None
        at = min(last, at + math.ceil(math.log(max(error, 1.01)) / math.log(GAIN)))


class _FieldImages:
    """Exact images at places of the field of a planner's camera."""

    def __init__(
        self, planner: PupilPlanner, wavelength_nm: FloatArray, collimation: Collimation | None, least_radius_px: float
    ) -> None:
        self.planner, self.camera, self.collimation = planner, planner.camera, collimation
        self.wavelength_nm, self.least_radius_px = wavelength_nm, least_radius_px
        self.focal_px = IdealLens.of(self.camera).focal_px
        self.middle, self.half = self._extent()

    def _direction(self, place: FloatArray) -> FloatArray:
        direction = np.column_stack([place, np.ones(len(place))])
        return np.asarray(direction / np.linalg.norm(direction, axis=1, keepdims=True))

    def _extent(self) -> tuple[FloatArray, FloatArray]:
        """Middle and half size of the field, as tangents, whose chief rays light the detector and what is near it."""
        camera = self.camera
        right, below = camera.width_px - 1.0, camera.height_px - 1.0
        x, y = np.array([(0, 0), (1, 0), (0, 1), (1, 1), (0.5, 0), (0.5, 1), (0, 0.5), (1, 0.5)]).T
        edge = np.stack([x * right + (2.0 * x - 1.0) * WING_PX, y * below + (2.0 * y - 1.0) * WING_PX], axis=-1)
        place = (edge - camera.centre_px) / self.focal_px
        for _ in range(3):
            seen = self.planner.seen(at_rest(self._direction(place)), self.wavelength_nm)
            chiefs = self.planner.chiefs(seen.mid, self.wavelength_nm)
            landed = np.stack([chiefs.x_px.mean(1), chiefs.y_px.mean(1)], axis=-1)
            place = place + np.nan_to_num((edge - landed) / self.focal_px)
        low, high = place.min(0), place.max(0)
        middle = np.where(np.abs(low + high) * self.focal_px < 0.1, 0.0, 0.5 * (low + high))
        return middle, np.maximum(high - middle, middle - low) * (1.0 + 1e-3)

    def symmetric(self) -> bool:
        """Whether rays of mirrored fields are mirrored ones."""
        if np.abs(self.middle).max() > 0.0 or self.collimation is not None:
            return False
        place = self.half * np.array([(0.8, 0.55), (-0.8, 0.55), (0.8, -0.55), (-0.8, -0.55)])
        ends = self.wavelength_nm[:, [0, -1]]
        disk = gauss_disk(4, 16)
        points = np.broadcast_to(np.column_stack([disk.x, disk.y]), (2, len(disk.x), 2))
        kernel = self.planner.kernel(self._direction(place))
        x, y, arrived = kernel.land(TablePoints(points, disk.weight), ends)
        centre = self.camera.centre_px
        weight = np.where(arrived, disk.weight, 0.0)
        offset = [np.where(arrived, v - c, 0.0) for v, c in zip((x, y), centre, strict=True)]
        sums = [(weight * offset[0] ** i * offset[1] ** j).sum(-1) for i, j in ((0, 0), (1, 0), (0, 1), (2, 0), (0, 2))]
        reach = [1.0, 1.0, 1.0, *(2.0 * np.abs(v).max() + 1.0 for v in offset)]
        for one, scale in zip(sums, reach, strict=True):
            if np.abs(np.abs(one) - np.abs(one[:1])).max() > SYMMETRIC_PX * scale:
                return False
        return True

    def exact(self, place: FloatArray, share: FloatArray) -> tuple[WaveImages, list[WaveGroup], FloatArray, FloatArray]:
        """Images of stars whose directions have these tangents (n, 2), their groups, chief rays and entrances."""
        paths = replace(at_rest(self._direction(place)), collimation=self.collimation)
        seen = self.planner.seen(paths, self.wavelength_nm)
        chiefs = self.planner.chiefs(seen.mid, self.wavelength_nm)
        images = WaveImages(self.camera, seen.mid, self.wavelength_nm, share)
        groups = self.planner.wave_groups(seen, self.wavelength_nm, chiefs, np.arange(len(place)))
        entrance = self.planner.shapes(seen, chiefs, np.empty(0, np.int64)).entrance(share.shape)
        chief = np.where(chiefs.blocked[..., None], np.nan, np.stack([chiefs.x_px, chiefs.y_px], axis=-1))
        return images, groups, chief, np.where(np.isnan(entrance), 1.0, entrance)

    def grid(self, size: int, mirrored: bool) -> WaveGrid | None:
        """A grid with its errors; None for a lens or field without one. Mirrored: from a quarter of the field."""
        points = chebyshev(size)
        first = size // 2 if mirrored else 0
        place = self.middle + self.half * np.stack(np.meshgrid(points[first:], points[first:]), axis=-1).reshape(-1, 2)
        bands, colours = self.wavelength_nm.shape
        images, groups, chief, entrance = self.exact(place, np.full((len(place), bands, colours), 1.0 / colours))
        probes = [probe for group in groups for probe in images.probes(group)]
        if any(probe.group.points is None for probe in probes) or not np.isfinite(chief).all():
            return None  # some beams have no smooth outline, or no light
        needs = images.common_needs(probes)
        radius, fine = max(needs[0], math.ceil(self.least_radius_px)), needs[1]
        field = fine.seen(self.camera.charge_diffusion_px)
        if radius > LARGEST_RADIUS_PX:
            return None
        pad, window = field.table(self.camera.charge_diffusion_px).pad_px, 2.0 * radius + 1.0
        samples = window_samples(field, window, pad) - 0.5 * window
        near = np.hypot(samples, samples[:, None]) <= radius + pad + 0.5
        down, margin = coarser(fine, field, window, pad), pad + COARSE_REACH_PX
        picked = [picked_wavelengths(band, size / SIZES[0]) for band in self.wavelength_nm]
        most = max(len(which) for which, _, _ in picked)
        if most * size**2 > MOST_IMAGES:
            return None
        count = len(samples)
        light = np.zeros((bands, len(place), most, count, count), np.float32)
        moment, origin = np.zeros((len(place), bands, most, 6)), np.zeros((len(place), bands, 2))
        for own in (one for probe in probes for one in images.summands(probe, radius)):
            if not (own.waves.weight.sum(-1) > 0.0).all():
                return None
            every = _ray_moments(own.waves, chief[own.stars], entrance[own.stars])
            for (s, star), (b, (which, _, _)) in product(enumerate(own.stars), enumerate(picked)):
                moment[star, b, : len(which)] = every[s, b, which]
                mean = own.waves.mean[s, b, which[len(which) // 2]]
                origin[star, b] = mean - chief[star, b]
                for q, k in enumerate(which):
                    one = np.zeros(colours)
                    one[k] = 1.0
                    image = replace(own, fields=(fine,) * bands).light((s, b), one, mean - 0.5 * window, window, margin)
                    light[b, star, q] = (down @ image @ down.T) * near
        if mirrored:
            light, moment, origin = _unfolded(light, moment, origin, size)
        kernel = field.pixel(1.0, self.camera.charge_diffusion_px)
        smoothing = (kernel(samples[:, None] - samples) * field.light_step).astype(np.float32)
        disk = np.hypot(samples, samples[:, None]) <= radius
        parts = [
            _components(
                light[b].reshape(-1, count, count),
                smoothing,
                disk,
                field.light_step,
                COMPONENT * (SIZES[0] / size) ** 2,
            )
            for b in range(bands)
        ]
        kept = max(len(component) for _, component in parts)
        coefficient = np.zeros((bands, size**2, most, kept), np.float32)
        component = np.zeros((bands, kept, count, count), np.float32)
        spectral = np.zeros((bands, colours, most))
        for b, (values, shapes) in enumerate(parts):
            coefficient[b, ..., : len(shapes)] = values.reshape(size**2, most, -1)
            component[b, : len(shapes)] = shapes
            spectral[b, :, : len(picked[b][0])] = picked[b][2]
        grid = WaveGrid(
            camera=self.camera,
            points=points,
            middle=self.middle,
            half=self.half,
            radius_px=radius,
            field=field,
            spectral=spectral,
            origin_px=origin,
            moment=moment,
            coefficient=coefficient,
            component=component,
        )
        return self._judged(grid, [judges for _, judges, _ in picked])

    def _judged(self, grid: WaveGrid, judges: list[IntArray]) -> WaveGrid | None:
        """The grid with its errors at places between its points, of single wavelengths."""
        golden = 0.6180339887498949
        steps = np.arange(1, PROBES)
        place = np.stack([2.0 * ((0.5 + golden * steps) % 1.0) - 1.0, 2.0 * (steps - 0.45) / (PROBES - 1) - 1.0], -1)
        place = np.concatenate([place, [[0.97, 0.96]]])
        kinds = max(len(one) for one in judges)
        share = np.zeros((kinds, *self.wavelength_nm.shape))
        for b, one in enumerate(judges):
            share[np.arange(kinds), b, np.resize(one, kinds)] = 1.0
        places, share = np.repeat(self.middle + self.half * place, kinds, axis=0), np.tile(share, (PROBES, 1, 1))
        images, groups, chief, _ = self.exact(places, share)
        direction = self._direction(places)
        worst = worst_px = 0.0
        for exact in (stamps for group in groups for stamps in images.stamps(group, float(grid.radius_px))):
            at = exact.stars
            if not np.isfinite(exact.mean_px).all():
                return None
            ours = grid.stamps(at, direction[at], share[at], chief[at])
            error = (ours.pixels - exact.pixels) / exact.light[..., None, None]
            worst = max(worst, float(np.abs(error).max(initial=0.0)), float(np.abs(ours.light - exact.light).max()))
            offset = np.arange(error.shape[-1]) - 0.5 * (error.shape[-1] - 1)
            error *= np.maximum(np.abs(offset), np.abs(offset[:, None])) <= CENTROID_PX
            first = np.stack([(error * offset).sum((2, 3)), (error * offset[:, None]).sum((2, 3))])
            mean = float(np.abs(ours.mean_px - exact.mean_px).max(initial=0.0))
            worst_px = max(worst_px, float(np.abs(first).max(initial=0.0)), mean)
        return replace(grid, error=worst, error_px=worst_px)


def _ray_moments(waves: PlaneWaves, chief_px: FloatArray, entrance: FloatArray) -> FloatArray:
    """`render.tracing.wave_grid.MOMENTS` (s, b, k, 6) of some waves."""
    x, y = (v - chief_px[:, :, None, None, i] for i, v in enumerate((waves.x, waves.y)))
    sums = [(waves.weight * v).sum(-1) for v in (x, y, x**2, y**2)]
    return np.stack([waves.weight.sum(-1), entrance, *sums], axis=-1)


def _unfolded(
    light: NDArray[np.float32], moment: FloatArray, origin: FloatArray, size: int
) -> tuple[NDArray[np.float32], FloatArray, FloatArray]:
    """Images, moments and origins at all points from those at points of the upper quarter."""
    middle, count = size // 2, size - size // 2
    row, column = (v.ravel() for v in np.indices((size, size)))
    source = np.abs(row - middle) * count + np.abs(column - middle)
    light, moment, origin = light[:, source], moment[source], origin[source]
    for axis, lower in ((0, column < middle), (1, row < middle)):
        moment[lower, ..., 2 + axis] *= -1.0
        origin[lower, ..., axis] *= -1.0
        light[:, lower] = np.flip(light[:, lower], axis=4 - axis)
    return light, moment, origin


def _components(
    images: NDArray[np.float32], smoothing: NDArray[np.float32], disk: NDArray[np.bool_], step_px: float, limit: float
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Coefficients (n, c) and components (c, m, m) of images (n, m, m).

    Principal components of what pixels see of them: of light on pixels at every third of a pixel, within the disk. They
    are so many that what is left out, the root of its squares summed over the pixels of a stamp, is below a limit in
    every image.
    """
    stride = max(1, round(1.0 / (3.0 * step_px)))
    few = smoothing[::stride]
    seen = ((few @ images @ few.T) * disk[::stride, ::stride]).reshape(len(images), -1).astype(np.float64)
    square, vectors = np.linalg.eigh(seen @ seen.T)
    left = np.cumsum(np.maximum(square, 0.0) * vectors**2, axis=1).max(0) * (stride * step_px) ** 2
    keep = vectors[:, left > limit**2].astype(np.float32)
    return keep, np.tensordot(keep, images, axes=(0, 0))
