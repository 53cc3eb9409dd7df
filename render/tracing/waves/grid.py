"""Diffraction images of many stars by interpolation: a grid of images over the field for one state of a lens.

At Chebyshev points of the detector's field, or of a radius of it, images of some wavelengths are summed as for single
stars and centred on the mean of the rays of a middle wavelength. A star's image is their interpolant at its place,
weighted by its spectrum, placed by its chief ray and the interpolated offset from the chief ray to that mean. The
images differ little: some tens of principal components represent them, and a frame is one product of matrices. Mean,
spread and losses of a star's rays are interpolated too, so that only the chief ray is traced.

The grid is refined until images and ray means at places between its points, for light at either end of a band and at
its worst-represented wavelength, differ from exact ones by less than `TOLERANCE`, and along a radius light and means of
few rays of all wavelengths at many places. A mixture of wavelengths is closer still. Where an aperture begins to cut
the beams the field has a kink, and a separate polynomial begins. If the finest grid fails, every star is summed
individually.
"""

from __future__ import annotations

import math
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from itertools import pairwise, product
from typing import Any

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from optics.arrays import FloatArray, IntArray
from optics.light.collimation import Collimation
from optics.rays.pupil_sampling import gauss_disk
from render.camera import Camera
from render.engine.jit import dr
from render.tracing.motion.exposure import IdealLens
from render.tracing.motion.paths import at_rest
from render.tracing.pupil.outlines import Arcs
from render.tracing.pupil.planning import Group, PupilPlanner
from render.tracing.pupil.points import TablePoints
from render.tracing.truth import RayMoments, WaveStamps
from render.tracing.waves.plane_waves import PlaneWaves
from render.tracing.waves.polar import turning_shapes
from render.tracing.waves.spectrum import lagrange, picked_wavelengths
from render.tracing.waves.summed import LARGEST_RADIUS_PX, Summands, SummedImages, Trail
from render.tracing.waves.windows import COARSE_REACH_PX, FieldSampling, PixelTable, coarser, window_samples

MOMENTS = 7
"""Light of a wavelength that gets through the lens, and that enters it; the former times the mean (column, row) of its
rays from the chief ray and times their mean squares; what apertures let through."""


def chebyshev(count: int) -> FloatArray:
    """Chebyshev points of the first kind in (-1, 1)."""
    return -np.cos(np.pi * (np.arange(count) + 0.5) / count)


def _along_radius(points: FloatArray, cuts: tuple[float, ...], at: FloatArray) -> FloatArray:
    """Weights (n, p) of points along a radius for places on it: polynomials between cuts."""
    weight = np.zeros((len(at), len(points)))
    for low, high in pairwise((-math.inf, *cuts, math.inf)):
        places, some = ((low <= v) & (v < high) for v in (at, points))
        weight[np.ix_(places, some)] = lagrange(points[some], at[places])
    return weight


@dataclass(frozen=True, slots=True, eq=False)
class WaveGrid:
    """Images over the field of one state of a lens, at some wavelengths."""

    camera: Camera
    points: FloatArray  # (p,) Points along either axis of the field, in (-1, 1)
    # middle, half: (2,) Place of the field's middle and its half size, as tangents of angles along X and Y of cam
    middle: FloatArray
    half: FloatArray
    radius_px: int  # Of the stamps
    field: FieldSampling  # Sampling of the images
    spectral: FloatArray  # (b, k, q) What makes of the q wavelengths that have images the k of stars
    # (f, b, 2) Mean of the rays of a middle wavelength from the chief ray, at the f = p^2 points: where images are
    # centred
    origin_px: FloatArray
    moment: FloatArray  # (f, b, q, 7) `MOMENTS`
    coefficient: tuple[NDArray[np.float32], ...]  # b of (f, q, c) Components of every image
    # b of (c, h, h) Principal components, light per px^2: a quarter of each, which is even or odd along rows and along
    # columns; and which: b of (c,), equal ones together, 2 where odd along rows plus 1 where odd along columns
    component: tuple[NDArray[np.float32], ...]
    parity: tuple[IntArray, ...]
    # b of (c,) Of a lens of revolution: azimuthal orders of the components, of which there are twice as many
    # (`render.tracing.waves.polar`). The f = p points then lie along a radius, in parts of that of the farthest
    # corner; images, means and moments are those of stars on the column axis
    order: tuple[IntArray, ...] | None = None
    cuts: tuple[float, ...] = ()  # Parts of that radius where apertures begin to cut the beam, ascending
    # error, error_px: Largest error found between the points, of a pixel and of a centroid
    error: float = math.nan
    error_px: float = math.nan

    def holds(self, direction: FloatArray) -> NDArray[np.bool_]:
        """Directions (n, 3) in cam that lie in the grid's field."""
        with np.errstate(divide="ignore", invalid="ignore"):
            place = (direction[:, :2] / direction[:, 2:] - self.middle) / self.half
        return np.asarray((np.abs(place).max(1) <= 1.0) & (direction[:, 2] > 0.0))

    def stamps(
        self,
        stars: IntArray,
        direction: FloatArray,
        share: FloatArray,
        chief_px: FloatArray,
        trail: Trail | None = None,
    ) -> WaveStamps:
        """Stamps of some stars."""
        # stars (s,), direction (s, 3), share (s, b, k), chief_px (s, b, 2)
        weight, shares, turn = self._weights(direction, share)
        light, moments, origin, clear = self._rays(weight, shares, turn, chief_px)
        size = 2 * self.radius_px + 1
        first, more = (0.0, 0) if trail is None else trail.room(stars)
        corner, stamp_px = np.rint(moments.mean_px) - 0.5 * size + first, size + more
        pixels = np.zeros((len(stars), share.shape[1], stamp_px, stamp_px), np.float32)
        for b in range(share.shape[1]):
            images = self._images(weight, shares[:, b], turn, b)
            shift = (origin - corner)[:, b] - 0.5 * size  # of the image's middle from where the window's would be
            if trail is None:
                pixels[:, b] = self._pixels(images, shift, stamp_px)
                continue
            images = [one * self._disk for one in images]
            for t in range(trail.weight.shape[2]):
                part = self._pixels(images, shift + trail.offset_px[stars, b, t], stamp_px)
                pixels[:, b] += trail.weight[stars, b, t].astype(np.float32)[:, None, None] * part
        if trail is None:
            steps = np.arange(size) - 0.5 * (size - 1)
            pixels *= np.hypot(steps, steps[:, None]) <= self.radius_px
        else:
            moments = trail.along(moments, stars)
        np.maximum(pixels, 0.0, out=pixels)
        return WaveStamps(stars, pixels, corner, moments.mean_px, light, len(self.points) ** 2, "grid", moments, clear)

    def cells(
        self, direction: FloatArray, share: FloatArray, chief_px: FloatArray, half_size_px: int, cells_per_px: int
    ) -> FloatArray:
        """Light per cell (s, b, m, m) of a square about the centroid, in shares of what gets through the lens.

        Parameters as `stamps`; light that lies beyond the radius of the grid is left out.
        """
        weight, shares, turn = self._weights(direction, share)
        light, moments, origin, _ = self._rays(weight, shares, turn, chief_px)
        count = (2 * half_size_px + 1) * cells_per_px
        centres = (np.arange(count) + 0.5) / cells_per_px - 0.5 * count / cells_per_px
        kernel = self.field.pixel(1.0 / cells_per_px, self.camera.blur_px)
        samples = window_samples(self.field, self._window, self._table.pad_px) - 0.5 * self._window
        result = np.empty((*light.shape, count, count))
        for b in range(light.shape[1]):
            images = self._images(weight, shares[:, b], turn, b)
            for s, shift in enumerate(moments.mean_px[:, b] - origin[:, b]):
                column, row = (kernel((centres + d)[:, None] - samples) * self.field.light_step for d in shift)
                result[s, b] = _projected(row, [one[s] for one in images], column) / light[s, b]
        return result

    def _weights(
        self, direction: FloatArray, share: FloatArray
    ) -> tuple[FloatArray, FloatArray, NDArray[np.complex128]]:
        """Weights of the points for stars (s, f), of the wavelengths that have images (s, b, q), and turns (s,)."""
        tangent = direction[:, :2] / direction[:, 2:]
        turn = np.ones(len(tangent), np.complex128)
        if self.order is None:
            place = (tangent - self.middle) / self.half
            column, row = (lagrange(self.points, place[:, i]) for i in (0, 1))
            weight = (row[:, :, None] * column[:, None, :]).reshape(len(place), -1)
        else:
            radius = np.hypot(*tangent.T)
            weight = _along_radius(self.points, self.cuts, radius / self.reach)
            off = radius > 0.0
            turn[off] = (tangent[off] @ np.array([1.0, 1j])) / radius[off]
        return weight, np.einsum("sbk,bkq->sbq", share, self.spectral), turn

    def _rays(
        self, weight: FloatArray, shares: FloatArray, turn: NDArray[np.complex128], chief_px: FloatArray
    ) -> tuple[FloatArray, RayMoments, FloatArray, FloatArray]:
        """Light that gets through (s, b), moments of rays, where images are centred (s, b, 2), what apertures leave."""
        sums = np.einsum("sf,fbqm,sbq->sbm", weight, self.moment, shares, optimize=True)
        light, entrance, clear = sums[..., 0], sums[..., 1], sums[..., 6]
        mean, square = sums[..., 2:4] / light[..., None], sums[..., 4:6] / light[..., None]
        origin, variance = np.einsum("sf,fbx->sbx", weight, self.origin_px), square - mean**2
        if self.order is not None:
            cos, sin = turn.real[:, None], turn.imag[:, None]
            mean, origin = (np.stack([v[..., 0] * cos, v[..., 0] * sin], axis=-1) for v in (mean, origin))
            along, across = variance[..., 0], variance[..., 1]
            turned = along * cos**2 + across * sin**2, along * sin**2 + across * cos**2
            variance = np.stack(turned, axis=-1)
        moments = RayMoments(chief_px + mean, variance, np.maximum(entrance, clear))
        return light, moments, chief_px + origin, clear

    def _images(
        self, weight: FloatArray, shares: FloatArray, turn: NDArray[np.complex128], band: int
    ) -> list[NDArray[np.float32]]:
        """Light per px^2 of stars in a band, of the light that is sent into the launch disk, as quarters (s, h, h).

        One for each `parity`.
        """
        coefficient = self.coefficient[band]
        points, colours, count = coefficient.shape
        each = (weight.astype(np.float32) @ coefficient.reshape(points, -1)).reshape(-1, colours, count)
        mixed = np.einsum("sk,skc->sc", shares.astype(np.float32), each)
        if self.order is not None:
            turned = turn[:, None] ** self.order[band]
            mixed = np.concatenate([mixed * turned.real, mixed * turned.imag], axis=1).astype(np.float32)
        component, side = self.component[band], self.component[band].shape[-1]
        quarters = []
        for parity in range(4):
            which = np.flatnonzero(self.parity[band] == parity)
            part = slice(int(which[0]), int(which[-1]) + 1) if len(which) else slice(0)
            quarters.append((mixed[:, part] @ component[part].reshape(-1, side**2)).reshape(-1, side, side))
        return quarters

    def _pixels(self, images: list[NDArray[np.float32]], shift_px: FloatArray, stamp_px: int) -> NDArray[np.float32]:
        """Pixels (s, n, n) of images whose middle is off the window's by a shift (s, 2)."""
        samples = len(window_samples(self.field, self._window, self._table.pad_px))
        first = 0.5 - 0.5 * self._window + 0.5 * (samples - 1) * self.field.light_step  # pixel 0 from sample 0
        column, row = (self._table.rows(first - shift_px[:, axis], stamp_px, samples) for axis in (0, 1))
        return np.asarray(_projected(row, images, column), np.float32)

    @property
    def reach(self) -> float:
        """Tangent of the angle of the farthest corner from the axis."""
        return float(np.hypot(*(np.abs(self.middle) + self.half)))

    @property
    def _window(self) -> float:
        return 2.0 * self.radius_px + 1.0

    @property
    def _disk(self) -> NDArray[np.bool_]:
        """Samples of a quarter within the radius."""
        samples = window_samples(self.field, self._window, self._table.pad_px) - 0.5 * self._window
        samples = samples[: -(-len(samples) // 2)]
        return np.asarray(np.hypot(samples, samples[:, None]) <= self.radius_px + 0.5)

    @property
    def _table(self) -> PixelTable:
        return self.field.table(self.camera.blur_px)


TOLERANCE = 1e-4
"""Largest error of a pixel [share of the light], and of the centroid in a window of 13 x 13 px [px]."""
SIZES = (5, 7, 9, 11, 13, 15)
"""Points along either side that are tried."""
RADIAL_SIZES = (5, 7, 9, 11, 13, 16, 20)
"""The same along a radius of the field of a lens of revolution, as far as no aperture cuts the beam."""
BETWEEN_CUTS, DENSITY, MOST_BETWEEN = 3, 0.9, 40
"""Points between two cuts: at least so many more than a part of the size times the root of their distance, and most."""
MOST_CUTS, CUT_STEPS, APART = 4, (128, 16), 0.01
"""Places where apertures begin to cut that are kept, the innermost; steps of the search for them, and of a second one
in each of the steps found; their least distance, in parts of the radius."""
FIRST_CUT, CUT_PLACES = 2, 45
"""Size tried first where apertures cut beams; points that such a grid is expected to need."""
GAIN = 4.0
"""Least reduction of the error by the next size; sizes that would not do are passed over."""
LEAST_GAIN = 0.7
"""Part of the error of a radial grid above which that of a finer one tells that none will do."""
LEAST_STARS = 8
"""Stars on the detector below which no grid is made unasked."""
PAYS = ((2.0, math.inf), (4.0, 5.0), (10.0, 1.0))
"""Frames within which a grid must pay, and its longest time [s]."""
RINGS_S = 0.3
"""Processor time of what makes components that turn of images."""
CENTROID_PX = 6
"""Half the side of the window whose centroid is compared."""
PROBES = 6
"""Places where a grid is judged, the last in a corner."""
COMPONENT = 5e-6
"""Error that principal components may leave in images of the coarsest grid, as a share of the light; finer grids weigh
their images with larger numbers of both signs."""
TURNING = 4e-5
"""The same of components that turn, whose centroids are held by themselves (`render.tracing.waves.polar`)."""
PIXEL_BLUR_PX = 0.14
"""Standard deviation of a Gaussian that leaves at least as much of fine structure as a pixel does."""
MOST_IMAGES = 1900
"""Images of a band that a grid is made of, whose matrix of products is still cheap."""
WING_PX = 30.0
"""How far outside the detector a star may be for its image to be rendered; so far the grid reaches."""
RADII = 24
"""Places along each part of a radius at which light and means of rays are judged."""
CENTRED = 0.05
"""How far off the axis the middle of the field may lie, in terms of its size, to be taken to be there."""
SYMMETRIC_PX = 1e-6
"""Difference of rays from mirrored ones below which a quarter of the field tells the rest."""


@dataclass(frozen=True, slots=True, eq=False)
class GridPlan:
    """Cost and layout of a grid; made by `plan_grid`."""

    images: _FieldImages
    image_s: float  # Processor time of an image of one star and wavelength by itself, of a usual machine
    grid_s: float  # The same of the grid; infinite where there is none

    def pays(self, stars: int) -> bool:
        """Whether a number of stars on the detector costs less by a grid, over a few frames; the same on every
        machine."""
        alone_s = stars * self.images.colours * self.image_s
        soon = any(self.grid_s <= min(frames * alone_s, limit_s) for frames, limit_s in PAYS)
        return stars >= LEAST_STARS and soon


def plan_grid(
    planner: PupilPlanner,
    wavelength_nm: FloatArray,
    collimation: Collimation | None = None,
    least_radius_px: float = 0.0,
) -> GridPlan:
    """Cost of a grid at wavelengths (b, k), from the rays and samples of a star in the middle and in a corner.

    The number of images is that of the grids that are tried first: few of any lens are good enough at once.
    """
    field = _FieldImages(planner, wavelength_nm, collimation, least_radius_px)
    places = field.middle + np.outer([0.0, 0.97], field.half)
    images, groups, chief, _ = field.exact(places, np.full((2, *wavelength_nm.shape), 1.0 / wavelength_nm.shape[1]))
    probes = [probe for group in groups for probe in images.probes(group)]
    if not np.isfinite(chief).all() or any(probe.group.points is None for probe in probes):
        return GridPlan(field, math.inf, math.inf)
    image_s = float(np.mean([images.image_s(probe) for probe in probes]))
    first, judged = 25.0, 2 * PROBES * 3 * len(wavelength_nm)
    if field.mirrored:
        first = 9.0
    more = (RADIAL_SIZES[1] if field.turned else 1.8 * (25.0 if field.mirrored else 81.0)) * field.colours
    if field.cuts:
        first, more = 0.0, CUT_PLACES * field.colours
    count = first * field.colours + more + judged
    return GridPlan(field, image_s, count * image_s + (RINGS_S if field.turned else 0.0))


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
            radial, at = True, -1
        at = min(
            len(RADIAL_SIZES if radial else SIZES) - 1, at + math.ceil(math.log(max(error, 1.01)) / math.log(GAIN))
        )


@dataclass(frozen=True, slots=True)
class _Summed:
    """Images at f places, of q wavelengths in b bands."""

    light: NDArray[np.float32]  # (b, f, q, i, i) On samples
    # moment, origin: (f, b, q, 7), (f, b, 2) As `WaveGrid.moment` and `WaveGrid.origin_px`
    moment: FloatArray
    origin: FloatArray
    radius_px: int  # Of the stamps
    field: FieldSampling
    samples_px: FloatArray  # (i,) Samples about the middle
    spectral: FloatArray  # (b, k, q) As `WaveGrid.spectral`
    judges: list[IntArray]  # (j,) Wavelengths of each band by which a grid is judged

    def on_pixels(self, diffusion_px: float) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
        """Matrix (i, i) from samples to the pixels about them, and which of these lie on the stamp."""
        kernel, samples = self.field.pixel(1.0, diffusion_px), self.samples_px
        smoothing = (kernel(samples[:, None] - samples) * self.field.light_step).astype(np.float32)
        return smoothing, np.hypot(samples, samples[:, None]) <= self.radius_px


class _FieldImages:
    """Exact images at places of the field of a planner's camera."""

    def __init__(
        self, planner: PupilPlanner, wavelength_nm: FloatArray, collimation: Collimation | None, least_radius_px: float
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
            exposure = self.planner.exposure(at_rest(self._direction(place)), self.wavelength_nm)
            place = place + np.nan_to_num((edge - exposure.chiefs.place_px.mean(1)) / self.focal_px)
        low, high = place.min(0), place.max(0)
        middle = np.where(np.abs(low + high) < CENTRED * (high - low), 0.0, 0.5 * (low + high))
        return middle, np.maximum(high - middle, middle - low) * (1.0 + 1e-3)

    def _symmetry(self) -> tuple[bool, bool]:
        """Whether rays of mirrored fields are mirrored, and rays of turned fields turned."""
        if self.collimation is not None:
            return False, False
        angle = np.pi / 8.0 * np.array([1, 7, -1, -7, 0, 4])  # by which the points of the disk are turned onto others
        place = 0.8 * self.half.max() * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
        ends = self.wavelength_nm[:, [0, -1]]
        disk = gauss_disk(4, 16)
        points = np.broadcast_to(np.column_stack([disk.x, disk.y]), (2, len(disk.x), 2))
        kernel = self.planner.kernel(self._direction(place))
        x, y, arrived = kernel.land(TablePoints(points, disk.weight), ends)
        weight = np.where(arrived, disk.weight, 0.0)
        x, y = (np.where(arrived, v - c, 0.0) for v, c in zip((x, y), self.camera.centre_px, strict=True))
        cos, sin = (f(angle)[:, None, None, None] for f in (np.cos, np.sin))
        mirrored = not np.abs(self.middle).max() > 0.0 and _alike(weight[:4], x[:4], y[:4])
        return mirrored, _alike(weight, cos * x + sin * y, cos * y - sin * x)

    def _cuts(self) -> tuple[float, ...]:
        """Parts of the radius of the farthest corner where an aperture begins or ceases to cut beams.

        There the number of arcs of the outlines changes, at either end of a band.
        """
        arcs, steps = self._arcs(np.linspace(0.0, 1.0, CUT_STEPS[0] + 1)), CUT_STEPS[1]
        cuts: list[float] = []
        for first in np.flatnonzero((arcs[1:] != arcs[:-1]).any((1, 2))).tolist():
            finer = (first + np.arange(steps + 1) / steps) / CUT_STEPS[0]
            some = self._arcs(finer)
            cut = float(finer[int(np.argmax((some[1:] != some[:-1]).any((1, 2))))])
            if len(cuts) < MOST_CUTS and cut - (cuts[-1] if cuts else 0.0) > APART and cut < 1.0 - APART:
                cuts.append(cut)
        return tuple(cuts)

    def _arcs(self, part: FloatArray) -> IntArray:
        """Arcs (n, b, 2) of outlines at parts of the radius, at either end of the bands; 0 where there is none."""
        place = self.reach * np.stack([part, np.zeros_like(part)], axis=-1)
        exposure = self.planner.exposure(at_rest(self._direction(place)), self.wavelength_nm)
        arcs = np.zeros((len(part), len(self.wavelength_nm), 2), np.int64)
        for group in self.planner.sampled_by_waves(exposure, np.arange(len(part))).groups:
            if isinstance(group.outlines, Arcs):
                at = np.searchsorted(group.outlines.stars, group.members)
                arcs[group.members] = (group.outlines.length[at][:, :, [0, -1]] > 0.0).sum(-1)
            elif group.mode == "quadrature":
                arcs[group.members] = 1
        return arcs

    def exact(
        self, place: FloatArray, share: FloatArray, wavelength_nm: FloatArray | None = None
    ) -> tuple[SummedImages, list[Group], FloatArray, FloatArray]:
        """Images of stars whose directions have these tangents (n, 2), their groups, chief rays and entrances."""
        paths = replace(at_rest(self._direction(place)), collimation=self.collimation)
        exposure = self.planner.exposure(paths, self.wavelength_nm if wavelength_nm is None else wavelength_nm)
        sampled = self.planner.sampled_by_waves(exposure, np.arange(len(place)))
        chief = np.where(exposure.chiefs.blocked[..., None], np.nan, exposure.chiefs.place_px)
        entrance = np.where(np.isnan(sampled.entrance), 1.0, sampled.entrance)
        return SummedImages(self.planner, exposure, share), sampled.groups, chief, entrance

    def grid(self, size: int) -> WaveGrid | None:
        """A grid with its errors; None for a lens or field without one. Mirrored: from a quarter of the field."""
        points = chebyshev(size)
        first = size // 2 if self.mirrored else 0
        place = self.middle + self.half * np.stack(np.meshgrid(points[first:], points[first:]), axis=-1).reshape(-1, 2)
        found = self._summed(place, size / SIZES[0], size**2)
        if found is None:
            return None
        smoothing, disk = found.on_pixels(self.camera.blur_px)
        limit = COMPONENT * (SIZES[0] / size) ** 2
        step, side = found.field.light_step, found.light.shape[-1]
        parts = [_components(one.reshape(-1, side, side), smoothing, disk, step, limit) for one in found.light]
        moment, origin = found.moment, found.origin
        if self.mirrored:
            parts, moment, origin = _unfolded(parts, moment, origin, size)
        return self._judged(self._made(found, points, moment, origin, parts), found.judges)

    def _radii(self, counts: IntArray) -> FloatArray:
        """Points of a grid along a radius: from the axis on, and mirrored ones before; between cuts."""
        ends = (*self.cuts, 1.0)
        parts = [ends[0] * chebyshev(2 * int(counts[0]))]
        for (low, high), count in zip(pairwise(ends), counts[1:].tolist(), strict=True):
            parts.append(low + (high - low) * 0.5 * (1.0 + chebyshev(count)))
        return np.concatenate(parts)

    def _counts(self, size: int) -> tuple[IntArray, float]:
        """Points, ``size`` within the first cut, and beyond as many as light and means [px] of rays need; their error.

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
        """Largest errors between the cuts, at `RADII` places, of means [px] and light of few rays.

        Of the middle wavelength of every band and of either end.
        """
        points, first = self._radii(counts), int(counts[0])
        ends = (0.0, *self.cuts, 1.0)
        judged = np.concatenate([a + (b - a) * (np.arange(RADII) + 0.5) / RADII for a, b in pairwise(ends)])
        at = np.concatenate([points[first:], judged])
        place = np.stack([self.reach * at, np.zeros_like(at)], axis=-1)
        last = self.wavelength_nm.shape[1] - 1
        waves = np.ascontiguousarray(self.wavelength_nm[:, np.unique([0, (last + 1) // 2, last])])
        images, groups, chief, _ = self.exact(place, np.ones((len(at), *waves.shape)), waves)
        seen = np.full((len(at), 2, *waves.shape), np.nan)
        for probe in (one for group in groups for one in images.probes(group)):
            offset = probe.waves.mean[..., 0] - chief[probe.stars, :, :1]
            seen[probe.stars] = np.stack([offset, probe.waves.weight.sum(-1)], axis=1)
        known, expected = seen[: len(points) - first], seen[-len(judged) :]
        known = np.concatenate([known[:first][::-1] * np.array([-1.0, 1.0])[:, None, None], known])
        error = np.abs(np.tensordot(_along_radius(points, self.cuts, judged), known, axes=1) - expected)
        return np.asarray(np.where(np.isnan(error), np.inf, error).reshape(len(counts), -1).max(1))

    def radial(self, size: int) -> WaveGrid | None:
        """The same for a lens of revolution, from points along a radius, ``size`` as far as no aperture cuts."""
        counts, ray_error = self._counts(size)
        if ray_error > TOLERANCE:
            return None  # images are nowhere nearer than means of rays
        half, points = size, self._radii(counts)
        place = np.stack([self.reach * points[half:], np.zeros(len(points) - half)], axis=-1)
        found = self._summed(place, 1.0, len(place))
        if found is None:
            return None
        _, _, most, side, _ = found.light.shape
        blur_px = math.hypot(PIXEL_BLUR_PX, self.camera.blur_px)
        parts: list[_Components] = []
        orders: list[IntArray] = []
        for light in found.light:
            shapes = turning_shapes(light.reshape(-1, side, side), found.samples_px, found.field, blur_px, TURNING)
            by_parity = np.argsort(shapes.order % 2, kind="stable")
            order, odd = shapes.order[by_parity], shapes.order[by_parity] % 2
            near_by = shapes.value[:, by_parity].reshape(len(place), most, -1)
            quarter = shapes.shape[:, by_parity, : -(-side // 2), : -(-side // 2)]
            parts.append(
                _Components(
                    np.concatenate([near_by[:half][::-1] * (-1.0) ** order, near_by]).astype(np.float32),
                    quarter.reshape(-1, *quarter.shape[2:]),
                    np.concatenate([odd, 3 - odd]),  # cosines are even along rows, sines odd
                )
            )
            orders.append(order)
        moment, origin = (np.concatenate([v[:half][::-1], v]) for v in (found.moment, found.origin))
        moment[:half, ..., 2] *= -1.0
        origin[:half, ..., 0] *= -1.0
        grid = self._judged(self._made(found, points, moment, origin, parts, tuple(orders)), found.judges)
        return None if grid is None else replace(grid, error_px=max(grid.error_px, ray_error))

    def _summed(self, place: FloatArray, finer: float, points: int) -> _Summed | None:
        """Images at places of the field; None for a lens or field without a grid of this number of points."""
        bands, colours = self.wavelength_nm.shape
        picked = [picked_wavelengths(band, finer) for band in self.wavelength_nm]
        most = max(len(which) for which, _, _ in picked)
        if most * points > MOST_IMAGES:
            return None
        images, groups, chief, entrance = self.exact(place, np.full((len(place), bands, colours), 1.0 / colours))
        probes = [probe for group in groups for probe in images.probes(group)]
        if any(probe.group.points is None for probe in probes) or not np.isfinite(chief).all():
            return None  # some beams have no smooth outline, or no light
        needs = images.common_needs(probes)
        radius, fine = max(needs[0], math.ceil(self.least_radius_px)), needs[1]
        field = fine.seen(self.camera.blur_px)
        if radius > LARGEST_RADIUS_PX:
            return None
        pad, window = field.table(self.camera.blur_px).pad_px, 2.0 * radius + 1.0
        samples = window_samples(field, window, pad) - 0.5 * window
        near = np.hypot(samples, samples[:, None]) <= radius + pad + 0.5
        down, margin = coarser(fine, field, window, pad), pad + COARSE_REACH_PX
        light = np.zeros((bands, len(place), most, len(samples), len(samples)), np.float32)
        moment, origin = np.zeros((len(place), bands, most, MOMENTS)), np.zeros((len(place), bands, 2))
        tasks: list[tuple[tuple[int, int, int], Summands, tuple[int, int], int, FloatArray]] = []
        for own in (one for probe in probes for one in images.summands(probe, radius)):
            if not (own.waves.weight.sum(-1) > 0.0).all():
                return None
            every = _ray_moments(own.waves, chief[own.stars], entrance[own.stars])
            finely = replace(own, fields=(fine,) * bands)
            for (s, star), (b, (which, _, _)) in product(enumerate(own.stars), enumerate(picked)):
                moment[star, b, : len(which)] = every[s, b, which]
                mean = own.waves.mean[s, b, which[len(which) // 2]]
                origin[star, b] = mean - chief[star, b]
                tasks += [((b, star, q), finely, (s, b), k, mean) for q, k in enumerate(which)]

        def image(task: tuple[tuple[int, int, int], Summands, tuple[int, int], int, FloatArray]) -> None:
            to, own, at, k, mean = task
            one = np.eye(colours)[k]
            light[to] = (down @ own.light(at, one, mean - 0.5 * window, window, margin) @ down.T) * near

        with ThreadPoolExecutor(dr.thread_count()) as pool, threadpool_limits(1, "blas"):
            list(pool.map(image, tasks))
        spectral = np.zeros((bands, colours, most))
        for b, (which, _, weight) in enumerate(picked):
            spectral[b, :, : len(which)] = weight
        return _Summed(light, moment, origin, radius, field, samples, spectral, [judges for _, judges, _ in picked])

    def _made(
        self,
        found: _Summed,
        points: FloatArray,
        moment: FloatArray,
        origin: FloatArray,
        parts: list[_Components],
        order: tuple[IntArray, ...] | None = None,
    ) -> WaveGrid:
        """The grid of moments and origins at all points, of coefficients and components of every band."""
        return WaveGrid(
            camera=self.camera,
            points=points,
            middle=self.middle,
            half=self.half,
            radius_px=found.radius_px,
            field=found.field,
            spectral=found.spectral,
            origin_px=origin,
            moment=moment,
            coefficient=tuple(part.value.reshape(len(moment), moment.shape[2], -1) for part in parts),
            component=tuple(part.shape for part in parts),
            parity=tuple(part.parity for part in parts),
            order=order,
            cuts=self.cuts,
        )

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


def _alike(weight: FloatArray, x_px: FloatArray, y_px: FloatArray) -> bool:
    """Whether moments of the rays (n, b, k, p) of n stars differ by no more than their signs."""
    reach = [2.0 * float(np.abs(v).max()) + 1.0 for v in (x_px, y_px)]
    scales = ((0, 0), 1.0), ((1, 0), 1.0), ((0, 1), 1.0), ((2, 0), reach[0]), ((0, 2), reach[1])
    for (i, j), scale in scales:
        sums = np.abs((weight * x_px**i * y_px**j).sum(-1))
        if np.abs(sums - sums[:1]).max() > SYMMETRIC_PX * scale:
            return False
    return True


def _ray_moments(waves: PlaneWaves, chief_px: FloatArray, entrance: FloatArray) -> FloatArray:
    """`MOMENTS` (s, b, k, 7) of some waves."""
    x, y = (v - chief_px[:, :, None, None, i] for i, v in enumerate((waves.x, waves.y)))
    sums = [(waves.weight * v).sum(-1) for v in (x, y, x**2, y**2)]
    return np.stack([waves.weight.sum(-1), entrance, *sums, waves.clear], axis=-1)


@dataclass(frozen=True, slots=True)
class _Components:
    """Components of n images."""

    value: NDArray[np.float32]  # (n, c), or what has as many elements
    # shape, parity: (c, h, h), (c,) As `WaveGrid.component` and `WaveGrid.parity` of a band
    shape: NDArray[np.float32]
    parity: IntArray


def _unfolded(
    parts: list[_Components], moment: FloatArray, origin: FloatArray, size: int
) -> tuple[list[_Components], FloatArray, FloatArray]:
    """Components, moments and origins at all points from those at points of the upper quarter."""
    middle, count = size // 2, size - size // 2
    row, column = (v.ravel() for v in np.indices((size, size)))
    source = np.abs(row - middle) * count + np.abs(column - middle)
    values = [part.value.reshape(len(moment), -1, len(part.parity))[source] for part in parts]
    moment, origin = moment[source], origin[source]
    for axis, lower in ((0, column < middle), (1, row < middle)):
        moment[lower, ..., 2 + axis] *= -1.0
        origin[lower, ..., axis] *= -1.0
        for value, part in zip(values, parts, strict=True):
            value[lower] *= np.where(part.parity >> axis & 1, np.float32(-1.0), np.float32(1.0))
    return [replace(part, value=value) for part, value in zip(parts, values, strict=True)], moment, origin


def _folded(values: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any]]:
    """What sums half of an even (..., h), and half of an odd function, as values (..., m) sum all of it."""
    half = -(-values.shape[-1] // 2)
    first, last = values[..., :half], values[..., ::-1][..., :half]
    even = first + last
    if values.shape[-1] % 2:
        even[..., -1] *= 0.5
    return even, first - last


def _projected(row: NDArray[Any], quarters: list[NDArray[Any]], column: NDArray[Any]) -> NDArray[Any]:
    """Rows (..., n, m) times the images of quarters times columns (..., k, m)."""
    (even, odd), (along, across) = _folded(row), _folded(column)
    found = (even @ quarters[0] + odd @ quarters[2]) @ np.swapaxes(along, -1, -2)
    return np.asarray(found + (even @ quarters[1] + odd @ quarters[3]) @ np.swapaxes(across, -1, -2))


def _components(
    images: NDArray[np.float32], smoothing: NDArray[np.float32], disk: NDArray[np.bool_], step_px: float, limit: float
) -> _Components:
    """Components of images (n, m, m).

    Principal components of what pixels see of them: of light on pixels at every third of a pixel, within the disk, for
    each parity by itself. They are so many that what is left out, the root of its squares summed over the pixels of a
    stamp, is below a limit in every image.
    """
    stride, half = max(1, round(1.0 / (3.0 * step_px))), -(-images.shape[-1] // 2)
    few, seen_disk = smoothing[:half:stride], disk[:half:stride, :half:stride]
    turned = images[:, ::-1]
    value, shape, parity = [], [], []
    for p, (flip, by) in enumerate(product((1.0, -1.0), (1.0, -1.0))):
        upper = images[:, :half] + np.float32(flip) * turned[:, :half]
        quarter = 0.25 * (upper[:, :, :half] + np.float32(by) * upper[:, :, ::-1][:, :, :half])
        row, column = _folded(few)[p // 2], _folded(few)[p % 2]
        seen = ((row @ quarter @ column.T) * seen_disk).reshape(len(images), -1).astype(np.float64)
        square, vectors = np.linalg.eigh(seen @ seen.T)
        left = np.cumsum(np.maximum(square, 0.0) * vectors**2, axis=1).max(0) * (2.0 * stride * step_px) ** 2
        keep = vectors[:, left > (0.5 * limit) ** 2].astype(np.float32)
        value.append(keep)
        shape.append(np.tensordot(keep, quarter, axes=(0, 0)))
        parity.append(np.full(keep.shape[1], p))
    return _Components(np.concatenate(value, axis=1), np.concatenate(shape), np.concatenate(parity))
