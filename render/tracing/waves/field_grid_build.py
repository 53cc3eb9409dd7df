"""Construction of a grid of diffraction images over the field: cost, points, refinement, error.

The grid is refined until images and ray means between its points, for light at either end of a band and at its
worst-represented wavelength, differ from exact ones by less than `TOLERANCE`, and along a radius light and means of few
rays of all wavelengths at many points. A mixture of wavelengths is closer still. Where an aperture begins to cut the
beams the field has a kink, and a separate polynomial begins. If the finest grid fails, every star is summed
individually.
"""

from __future__ import annotations

import math
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from itertools import pairwise, product

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from optics.arrays import FloatArray, IntArray
from optics.light.collimation import Collimation
from optics.rays.pupil_sampling import gauss_disk
from render.engine.jit import dr
from render.tracing.motion.exposure import IdealLens
from render.tracing.motion.paths import at_rest
from render.tracing.pupil.outlines import GOLDEN, Arcs
from render.tracing.pupil.planning import Group, PupilPlanner
from render.tracing.pupil.points import TablePoints
from render.tracing.waves.azimuthal_modes import azimuthal_modes
from render.tracing.waves.direct_sums import LARGEST_RADIUS_PX, DirectSums, Summands
from render.tracing.waves.field_grid import WaveGrid, radial_weights
from render.tracing.waves.pixel_kernel import COARSE_REACH_PX, FieldSampling, coarser, pixel_table, window_samples
from render.tracing.waves.plane_waves import PlaneWaves
from render.tracing.waves.principal_components import Components, mirrored_field, principal_components
from render.tracing.waves.wavelength_interpolation import picked_wavelengths

TOLERANCE = 1e-4
"""Largest error of a pixel [fraction of the light], and of the centroid in a window of 13 x 13 px [px]."""
SIZES = (5, 7, 9, 11, 13, 15)
"""Points along either side that are tried."""
RADIAL_SIZES = (5, 7, 9, 11, 13, 16, 20)
"""Points along a radius of the field of a lens of revolution that are tried, up to the first cut by an aperture."""
BETWEEN_CUTS, DENSITY, MOST_BETWEEN = 3, 0.9, 40
"""Points between two cuts: the least offset and the factor of size times root of their distance, and the most."""
MOST_CUTS, CUT_STEPS, CUT_DISTANCE = 4, (128, 16), 0.01
"""Cuts that are used, the innermost; steps of the search for them, and of a second one in each of the steps with a cut;
their least distance, in fractions of the radius."""
FIRST_CUT, CUT_POINTS = 2, 45
"""Size tried first where apertures cut beams; points that such a grid is expected to need."""
GAIN = 4.0
"""Least reduction of the error by the next size; sizes that would not do are skipped."""
LEAST_GAIN = 0.7
"""Ratio of the errors of a radial grid and of a coarser one above which finer ones are given up."""
LEAST_STARS = 8
"""Stars on the detector below which no grid is built unasked."""
PAYS = ((2.0, math.inf), (4.0, 6.9e10), (10.0, 1.4e10))
"""Frames within which a grid must pay, and its largest cost, in products of complex numbers (5 s and 1 s of a core)."""
MODES_PRODUCTS = 4.2e9
"""Cost of azimuthal modes, in such products: 0.3 s (`render.tracing.waves.frequency_grid.PRODUCT_S`)."""
CENTROID_PX = 6
"""Half the side of the window whose centroid is compared."""
PROBES = 6
"""Field points at which the error is measured, the last in a corner."""
COMPONENT = 5e-6
"""Remainder of principal components in images of the coarsest grid [fraction of the light]; finer grids weigh their
images with larger numbers of both signs."""
MODE_REMAINDER = 4e-5
"""The same of azimuthal modes, which bound errors of centroids separately."""
PIXEL_BLUR_PX = 0.14
"""Standard deviation of a Gaussian that leaves at least as much of fine structure as a pixel does."""
MOST_IMAGES = 1900
"""Images of a band in a grid whose matrix of inner products is still cheap."""
WING_PX = 30.0
"""Distance from the detector up to which images of stars are rendered; the grid extends as far."""
RADII = 24
"""Points of each part of a radius at which light and means of rays are compared."""
CENTRED = 0.05
"""Distance of the middle of the field from the axis, over the field's size, below which it counts as 0."""
SYMMETRIC_PX = 1e-6
"""Difference of rays from mirrored ones below which a quarter of the field determines the rest."""
MOMENTS = 7
"""See `WaveGrid.moment`."""


def chebyshev(count: int) -> FloatArray:
    """Chebyshev points of the first kind in (-1, 1)."""
    return -np.cos(np.pi * (np.arange(count) + 0.5) / count)


@dataclass(frozen=True, slots=True, eq=False)
class GridPlan:
    """Cost of a grid, in products of complex numbers (`render.tracing.waves.frequency_grid.PRODUCT_S`)."""

    images: _FieldImages
    image_products: float  # Of an image of one star and wavelength by a direct sum
    grid_products: float  # Of the grid; infinite without one

    def pays(self, stars: int) -> bool:
        """Whether a number of stars on the detector costs less by a grid, over a few frames."""
        direct = stars * self.images.colours * self.image_products
        cheap = any(self.grid_products <= min(frames * direct, limit) for frames, limit in PAYS)
        return stars >= LEAST_STARS and cheap


def plan_grid(planner: PupilPlanner, wavelength_nm: FloatArray, collimation: Collimation | None = None) -> GridPlan:
    """Cost of a grid at wavelengths (b, k), from the rays and samples of a star in the middle and in a corner.

    The number of images is that of the grids that are tried first: few of any lens are good enough at once.
    """
    field = _FieldImages(planner, wavelength_nm, collimation)
    points = field.middle + np.outer([0.0, 0.97], field.half)
    images, groups, chief, _ = field.exact(points, np.full((2, *wavelength_nm.shape), 1.0 / wavelength_nm.shape[1]))
    probes = [probe for group in groups for probe in images.probes(group)]
    if not np.isfinite(chief).all() or any(probe.group.points is None for probe in probes):
        return GridPlan(field, math.inf, math.inf)
    image_products = float(np.mean([images.image_products(probe) for probe in probes]))
    first = 0.0 if field.cuts else 9.0 if field.mirrored else 25.0
    second = RADIAL_SIZES[1] if field.turned else 1.8 * (25.0 if field.mirrored else 81.0)
    count = (first + (CUT_POINTS if field.cuts else second)) * field.colours + 2 * PROBES * 3 * len(wavelength_nm)
    return GridPlan(field, image_products, count * image_products + (MODES_PRODUCTS if field.turned else 0.0))


def build_grid(
    planner: PupilPlanner,
    wavelength_nm: FloatArray,
    collimation: Collimation | None = None,
    least_radius_px: float = 0.0,
) -> WaveGrid | None:
    """The coarsest grid within tolerance; None without one."""
    field = _FieldImages(planner, wavelength_nm, collimation, least_radius_px)
    at, radial, last = (FIRST_CUT, True, math.inf) if field.cuts else (0, False, math.inf)
    while True:
        sizes = RADIAL_SIZES if radial else SIZES
        grid = field.radial(sizes[at]) if radial else field.grid(sizes[at])
        if grid is None:
            return None
        error = max(grid.error, grid.error_px) / TOLERANCE
        if error < 1.0 or at == len(sizes) - 1 or (radial and error > LEAST_GAIN * last):
            return grid if error < 1.0 else None
        last = error if radial else math.inf
        if field.turned and not radial:
            radial, at, sizes = True, -1, RADIAL_SIZES
        at = min(len(sizes) - 1, at + math.ceil(math.log(max(error, 1.01)) / math.log(GAIN)))


@dataclass(frozen=True, slots=True)
class _FieldPoints:
    """Images at f field points, of q wavelengths in b bands."""

    light: NDArray[np.float32]  # (b, f, q, i, i) On samples
    moment: FloatArray  # (f, b, q, 7) As `WaveGrid.moment`
    origin: FloatArray  # (f, b, 2) As `WaveGrid.origin_px`
    radius_px: int  # Of the stamps
    field: FieldSampling
    samples_px: FloatArray  # (i,) Samples about the middle
    spectral: FloatArray  # (b, k, q) As `WaveGrid.spectral`
    tested: list[IntArray]  # (j,) Wavelengths of each band at which the error is measured

    def on_pixels(self, diffusion_px: float) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
        """Matrix (i, i) from samples to the pixels about them, and which of these lie on the stamp."""
        kernel, samples = self.field.pixel(1.0, diffusion_px), self.samples_px
        smoothing = (kernel(samples[:, None] - samples) * self.field.light_step).astype(np.float32)
        return smoothing, np.hypot(samples, samples[:, None]) <= self.radius_px


_Task = tuple[tuple[int, int, int], Summands, tuple[int, int], int, FloatArray]
"""(band, point, wavelength) of an image; waves, their star and band, number of the wavelength, centre [px]."""


class _FieldImages:
    """Exact images at points of the field of a planner's camera; points are tangents of angles along X and Y of cam."""

    def __init__(
        self,
        planner: PupilPlanner,
        wavelength_nm: FloatArray,
        collimation: Collimation | None,
        least_radius_px: float = 0.0,
    ) -> None:
        self.planner, self.camera, self.collimation = planner, planner.camera, collimation
        self.wavelength_nm, self.least_radius_px = wavelength_nm, least_radius_px
        self.focal_px = IdealLens.of(self.camera).focal_px
        self.middle, self.half = self._extent()
        self.reach = float(np.hypot(*(np.abs(self.middle) + self.half)))
        self.mirrored, self.turned = self._symmetry()
        self.cuts = self._cuts() if self.turned else ()

    @property
    def colours(self) -> int:
        """Wavelengths of all bands that have images."""
        return sum(len(picked_wavelengths(band)[0]) for band in self.wavelength_nm)

    def _direction(self, points: FloatArray) -> FloatArray:
        direction = np.column_stack([points, np.ones(len(points))])
        return np.asarray(direction / np.linalg.norm(direction, axis=1, keepdims=True))

    def _along_radius(self, fraction: FloatArray) -> FloatArray:
        """Field points (n, 2) at fractions of the radius of the farthest corner."""
        return np.stack([self.reach * fraction, np.zeros_like(fraction)], axis=-1)

    def _extent(self) -> tuple[FloatArray, FloatArray]:
        """Middle and half size of the field whose chief rays land on the detector and within `WING_PX` of it."""
        size = np.array([self.camera.width_px, self.camera.height_px]) - 1.0
        corners = np.array([(0, 0), (1, 0), (0, 1), (1, 1), (0.5, 0), (0.5, 1), (0, 0.5), (1, 0.5)])
        edge = corners * size + (2.0 * corners - 1.0) * WING_PX
        points = (edge - self.camera.centre_px) / self.focal_px
        for _ in range(3):
            exposure = self.planner.exposure(at_rest(self._direction(points)), self.wavelength_nm)
            points = points + np.nan_to_num((edge - exposure.chiefs.position_px.mean(1)) / self.focal_px)
        low, high = points.min(0), points.max(0)
        middle = np.where(np.abs(low + high) < CENTRED * (high - low), 0.0, 0.5 * (low + high))
        return middle, np.maximum(high - middle, middle - low) * (1.0 + 1e-3)

    def _symmetry(self) -> tuple[bool, bool]:
        """Whether rays of mirrored fields are mirrored, and rays of turned fields turned."""
        if self.collimation is not None:
            return False, False
        angle = np.pi / 8.0 * np.array([1, 7, -1, -7, 0, 4])  # by which the points of the disk are turned onto others
        points = 0.8 * self.half.max() * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
        disk = gauss_disk(4, 16)
        launched = np.broadcast_to(np.column_stack([disk.x, disk.y]), (2, len(disk.x), 2))
        kernel = self.planner.kernel(self._direction(points))
        x, y, arrived = kernel.land(TablePoints(launched, disk.weight), self.wavelength_nm[:, [0, -1]])
        weight = np.where(arrived, disk.weight, 0.0)
        x, y = (np.where(arrived, v - c, 0.0) for v, c in zip((x, y), self.camera.centre_px, strict=True))
        cos, sin = (f(angle)[:, None, None, None] for f in (np.cos, np.sin))
        mirrored = not np.abs(self.middle).max() > 0.0 and _same_moments(weight[:4], x[:4], y[:4])
        return mirrored, _same_moments(weight, cos * x + sin * y, cos * y - sin * x)

    def _cuts(self) -> tuple[float, ...]:
        """Fractions of the radius of the farthest corner where an aperture begins or ceases to cut beams.

        There the number of arcs of the outlines changes, at either end of a band.
        """
        arcs, steps = self._arcs(np.linspace(0.0, 1.0, CUT_STEPS[0] + 1)), CUT_STEPS[1]
        cuts: list[float] = []
        for first in np.flatnonzero((arcs[1:] != arcs[:-1]).any((1, 2))).tolist():
            finer = (first + np.arange(steps + 1) / steps) / CUT_STEPS[0]
            finer_arcs = self._arcs(finer)
            cut = float(finer[int(np.argmax((finer_arcs[1:] != finer_arcs[:-1]).any((1, 2))))])
            if len(cuts) < MOST_CUTS and cut - (cuts[-1] if cuts else 0.0) > CUT_DISTANCE and cut < 1.0 - CUT_DISTANCE:
                cuts.append(cut)
        return tuple(cuts)

    def _arcs(self, fraction: FloatArray) -> IntArray:
        """Arcs (n, b, 2) of outlines at fractions of the radius, at either end of the bands; 0 without an outline."""
        exposure = self.planner.exposure(at_rest(self._direction(self._along_radius(fraction))), self.wavelength_nm)
        arcs = np.zeros((len(fraction), len(self.wavelength_nm), 2), np.int64)
        for group in self.planner.sampled_by_waves(exposure, np.arange(len(fraction))).groups:
            if isinstance(group.outlines, Arcs):
                at = np.searchsorted(group.outlines.stars, group.members)
                arcs[group.members] = (group.outlines.length[at][:, :, [0, -1]] > 0.0).sum(-1)
            elif group.mode == "quadrature":
                arcs[group.members] = 1
        return arcs

    def exact(
        self, points: FloatArray, spectrum: FloatArray, wavelength_nm: FloatArray | None = None
    ) -> tuple[DirectSums, list[Group], FloatArray, FloatArray]:
        """Images of stars at field points (n, 2), their groups, chief rays and entrances."""
        paths = replace(at_rest(self._direction(points)), collimation=self.collimation)
        exposure = self.planner.exposure(paths, self.wavelength_nm if wavelength_nm is None else wavelength_nm)
        sampled = self.planner.sampled_by_waves(exposure, np.arange(len(points)))
        chief = np.where(exposure.chiefs.blocked[..., None], np.nan, exposure.chiefs.position_px)
        entrance = np.where(np.isnan(sampled.entrance), 1.0, sampled.entrance)
        return DirectSums(self.planner, exposure, spectrum), sampled.groups, chief, entrance

    def grid(self, size: int) -> WaveGrid | None:
        """A grid with its errors; None for a lens or field without one. Mirrored: from a quarter of the field."""
        points = chebyshev(size)
        quarter = points[size // 2 if self.mirrored else 0 :]
        field_points = self.middle + self.half * np.stack(np.meshgrid(quarter, quarter), axis=-1).reshape(-1, 2)
        images = self._summed(field_points, size / SIZES[0], size**2)
        if images is None:
            return None
        smoothing, disk = images.on_pixels(self.camera.blur_px)
        limit = COMPONENT * (SIZES[0] / size) ** 2
        step, side = images.field.light_step, images.light.shape[-1]
        bands = [principal_components(v.reshape(-1, side, side), smoothing, disk, step, limit) for v in images.light]
        moment, origin = images.moment, images.origin
        if self.mirrored:
            bands, moment, origin = mirrored_field(bands, moment, origin, size)
        return self._tested(images, points, moment, origin, bands)

    def _radii(self, counts: IntArray) -> FloatArray:
        """Points of a grid along a radius: from the axis on, and mirrored ones before; between cuts."""
        ends = (*self.cuts, 1.0)
        parts = [ends[0] * chebyshev(2 * int(counts[0]))]
        for (low, high), count in zip(pairwise(ends), counts[1:].tolist(), strict=True):
            parts.append(low + (high - low) * 0.5 * (1.0 + chebyshev(count)))
        return np.concatenate(parts)

    def _counts(self, size: int) -> tuple[IntArray, float]:
        """Points, ``size`` within the first cut, beyond it enough for light and means [px] of rays; their error.

        No fewer than the ``size`` asks for: images may need more than rays.
        """
        least = DENSITY * size * np.sqrt(np.diff([*self.cuts, 1.0]))
        counts = np.array([size, *(BETWEEN_CUTS + np.ceil(least)).astype(int)])
        while True:
            error = self._ray_errors(counts)
            bad = error > TOLERANCE
            if not bad.any() or counts.max() > MOST_BETWEEN:
                return counts, float(error.max())
            counts[bad] += np.maximum(1, np.where(error > 3.0 * TOLERANCE, 0.4, 0.15)[bad] * counts[bad]).astype(int)

    def _ray_errors(self, counts: IntArray) -> FloatArray:
        """Largest errors between the cuts, at `RADII` points, of means [px] and light of few rays.

        Of the middle wavelength of every band and of either end.
        """
        points, first = self._radii(counts), int(counts[0])
        ends = (0.0, *self.cuts, 1.0)
        tested = np.concatenate([a + (b - a) * (np.arange(RADII) + 0.5) / RADII for a, b in pairwise(ends)])
        fractions = np.concatenate([points[first:], tested])
        last = self.wavelength_nm.shape[1] - 1
        waves = np.ascontiguousarray(self.wavelength_nm[:, np.unique([0, (last + 1) // 2, last])])
        images, groups, chief, _ = self.exact(
            self._along_radius(fractions), np.ones((len(fractions), *waves.shape)), waves
        )
        traced = np.full((len(fractions), 2, *waves.shape), np.nan)
        for probe in (probe for group in groups for probe in images.probes(group)):
            offset = probe.waves.mean[..., 0] - chief[probe.stars, :, :1]
            traced[probe.stars] = np.stack([offset, probe.waves.weight.sum(-1)], axis=1)
        nodes, expected = traced[: len(points) - first], traced[-len(tested) :]
        nodes = np.concatenate([nodes[:first][::-1] * np.array([-1.0, 1.0])[:, None, None], nodes])
        error = np.abs(np.tensordot(radial_weights(points, self.cuts, tested), nodes, axes=1) - expected)
        return np.asarray(np.where(np.isnan(error), np.inf, error).reshape(len(counts), -1).max(1))

    def radial(self, size: int) -> WaveGrid | None:
        """A grid of a lens of revolution, from points along a radius, ``size`` of them up to the first cut."""
        counts, ray_error = self._counts(size)
        if ray_error > TOLERANCE:
            return None  # images are nowhere more accurate than means of rays
        points = self._radii(counts)
        images = self._summed(self._along_radius(points[size:]), 1.0, len(points) - size)
        if images is None:
            return None
        _, count, most, side, _ = images.light.shape
        blur_px, half = math.hypot(PIXEL_BLUR_PX, self.camera.blur_px), -(-side // 2)
        bands: list[Components] = []
        orders: list[IntArray] = []
        for light in images.light:
            modes = azimuthal_modes(
                light.reshape(-1, side, side), images.samples_px, images.field, blur_px, MODE_REMAINDER
            )
            by_parity = np.argsort(modes.order % 2, kind="stable")
            order, odd = modes.order[by_parity], modes.order[by_parity] % 2
            coefficient = modes.coefficient[:, by_parity].reshape(count, most, -1)
            mirrored = coefficient[:size][::-1] * (-1.0) ** order
            quarter = modes.shape[:, by_parity, :half, :half].reshape(-1, half, half)
            parity = np.concatenate([odd, 3 - odd])  # cosines are even along rows, sines odd
            bands.append(Components(np.concatenate([mirrored, coefficient]).astype(np.float32), quarter, parity))
            orders.append(order)
        moment, origin = (np.concatenate([v[:size][::-1], v]) for v in (images.moment, images.origin))
        moment[:size, ..., 2] *= -1.0
        origin[:size, ..., 0] *= -1.0
        grid = self._tested(images, points, moment, origin, bands, tuple(orders))
        return None if grid is None else replace(grid, error_px=max(grid.error_px, ray_error))

    def _summed(self, field_points: FloatArray, finer: float, points: int) -> _FieldPoints | None:
        """Images at points of the field; None for a lens or field without a grid of this number of points."""
        bands, colours = self.wavelength_nm.shape
        picked = [picked_wavelengths(band, finer) for band in self.wavelength_nm]
        most = max(len(which) for which, _, _ in picked)
        if most * points > MOST_IMAGES:
            return None
        count = len(field_points)
        images, groups, chief, entrance = self.exact(field_points, np.full((count, bands, colours), 1.0 / colours))
        probes = [probe for group in groups for probe in images.probes(group)]
        if any(probe.group.points is None for probe in probes) or not np.isfinite(chief).all():
            return None  # some beams have no smooth outline, or no light
        radius, fine = images.common_needs(probes)
        radius = max(radius, math.ceil(self.least_radius_px))
        if radius > LARGEST_RADIUS_PX:
            return None
        field = fine.visible(self.camera.blur_px)
        pad, window = pixel_table(field, self.camera.blur_px).pad_px, 2.0 * radius + 1.0
        samples = window_samples(field, window, pad) - 0.5 * window
        disk = np.hypot(samples, samples[:, None]) <= radius + pad + 0.5
        down, margin = coarser(fine, field, window, pad), pad + COARSE_REACH_PX
        light = np.zeros((bands, count, most, len(samples), len(samples)), np.float32)
        moment, origin = np.zeros((count, bands, most, MOMENTS)), np.zeros((count, bands, 2))
        tasks: list[_Task] = []
        for summands in (part for probe in probes for part in images.summands(probe, radius)):
            if not (summands.waves.weight.sum(-1) > 0.0).all():
                return None
            ray_moments = _ray_moments(summands.waves, chief[summands.stars], entrance[summands.stars])
            sampled = replace(summands, fields=(fine,) * bands)
            for (s, star), (b, (which, _, _)) in product(enumerate(summands.stars), enumerate(picked)):
                moment[star, b, : len(which)] = ray_moments[s, b, which]
                mean = summands.waves.mean[s, b, which[len(which) // 2]]
                origin[star, b] = mean - chief[star, b]
                tasks += [((b, star, q), sampled, (s, b), k, mean) for q, k in enumerate(which)]

        def sum_waves(task: _Task) -> None:
            target, summands, at, k, mean = task
            image = summands.light(at, np.eye(colours)[k], mean - 0.5 * window, window, margin)
            light[target] = (down @ image @ down.T) * disk

        with ThreadPoolExecutor(dr.thread_count()) as pool, threadpool_limits(1, "blas"):
            list(pool.map(sum_waves, tasks))
        spectral = np.zeros((bands, colours, most))
        for b, (which, _, weight) in enumerate(picked):
            spectral[b, :, : len(which)] = weight
        tested = [wavelengths for _, wavelengths, _ in picked]
        return _FieldPoints(light, moment, origin, radius, field, samples, spectral, tested)

    def _tested(
        self,
        images: _FieldPoints,
        points: FloatArray,
        moment: FloatArray,
        origin: FloatArray,
        bands: list[Components],
        order: tuple[IntArray, ...] | None = None,
    ) -> WaveGrid | None:
        """The grid of components of every band, with its errors between its points, of single wavelengths."""
        shape = (len(moment), moment.shape[2], -1)
        grid = WaveGrid(
            camera=self.camera,
            points=points,
            middle=self.middle,
            half=self.half,
            radius_px=images.radius_px,
            field=images.field,
            spectral=images.spectral,
            origin_px=origin,
            moment=moment,
            components=tuple(replace(band, coefficient=band.coefficient.reshape(shape)) for band in bands),
            order=order,
            cuts=self.cuts,
        )
        steps = np.arange(1, PROBES)
        probes = np.stack([2.0 * ((0.5 + GOLDEN * steps) % 1.0) - 1.0, 2.0 * (steps - 0.45) / (PROBES - 1) - 1.0], -1)
        probes = np.concatenate([probes, [[0.97, 0.96]]])
        kinds = max(len(wavelengths) for wavelengths in images.tested)
        spectrum = np.zeros((kinds, *self.wavelength_nm.shape))
        for b, wavelengths in enumerate(images.tested):
            spectrum[np.arange(kinds), b, np.resize(wavelengths, kinds)] = 1.0
        field_points = np.repeat(self.middle + self.half * probes, kinds, axis=0)
        spectrum, direction = np.tile(spectrum, (PROBES, 1, 1)), self._direction(field_points)
        sums, groups, chief, _ = self.exact(field_points, spectrum)
        worst = worst_px = 0.0
        for exact in (stamps for group in groups for stamps in sums.stamps(group, float(grid.radius_px))):
            at = exact.stars
            if not np.isfinite(exact.mean_px).all():
                return None
            interpolated = grid.stamps(at, direction[at], spectrum[at], chief[at], None)
            error = (interpolated.pixels - exact.pixels) / exact.light[..., None, None]
            light_error = float(np.abs(interpolated.light - exact.light).max())
            worst = max(worst, float(np.abs(error).max(initial=0.0)), light_error)
            offset = np.arange(error.shape[-1]) - 0.5 * (error.shape[-1] - 1)
            error *= np.maximum(np.abs(offset), np.abs(offset[:, None])) <= CENTROID_PX
            first = np.stack([(error * offset).sum((2, 3)), (error * offset[:, None]).sum((2, 3))])
            mean = float(np.abs(interpolated.mean_px - exact.mean_px).max(initial=0.0))
            worst_px = max(worst_px, float(np.abs(first).max(initial=0.0)), mean)
        return replace(grid, error=worst, error_px=worst_px)


def _same_moments(weight: FloatArray, x_px: FloatArray, y_px: FloatArray) -> bool:
    """Whether moments of the rays (n, b, k, p) of n stars differ by no more than their signs."""
    reach = [2.0 * float(np.abs(v).max()) + 1.0 for v in (x_px, y_px)]
    scales = ((0, 0), 1.0), ((1, 0), 1.0), ((0, 1), 1.0), ((2, 0), reach[0]), ((0, 2), reach[1])
    sums = [(np.abs((weight * x_px**i * y_px**j).sum(-1)), scale) for (i, j), scale in scales]
    return all(np.abs(moment - moment[:1]).max() <= SYMMETRIC_PX * scale for moment, scale in sums)


def _ray_moments(waves: PlaneWaves, chief_px: FloatArray, entrance: FloatArray) -> FloatArray:
    """Moments (s, b, k, 7) of some waves, as `WaveGrid.moment`."""
    x, y = (v - chief_px[:, :, None, None, i] for i, v in enumerate((waves.x, waves.y)))
    sums = [(waves.weight * v).sum(-1) for v in (x, y, x**2, y**2)]
    return np.stack([waves.weight.sum(-1), entrance, *sums, waves.clear], axis=-1)
