r"""The far diffraction image of a bright star beyond its stamp, with the spikes of vanes.

Far from the core the image is determined by the edges of the aperture, independent of aberrations. The aperture on the
axis is traced on a grid of cells, edge cells with partial weight; the square of its Fourier transform is the image in
units of lambda N, the same for all wavelengths. Its running sums give the light of any pixel:

.. math:: P(q) = |\mathrm{FT}[m](q)|^2, \qquad q = a x / \lambda, \qquad \int P \, dq = 1

It begins at the end of the stamp and is scaled so that stamp and far image, extended to infinity, contain all light of
the star. It ends where a pixel of its mean over a few degrees, the brightest ones, holds ``FarLight.ends_e``, and for
stars whose brightest pixel holds more than ``FarLight.saturated_e`` no nearer than where `BEYOND` of the light is left.
Charge diffusion, which moves light by less than a pixel, and the change of the aperture over the field are neglected.
"""

from __future__ import annotations

import math
import pickle
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray
from scipy.fft import rfft2

from optics.arrays import FloatArray
from render.tracing.motion.paths import NodeLight, at_rest
from render.tracing.pupil.planning import PupilPlanner
from render.tracing.pupil.points import TablePoints
from render.tracing.truth import TruthSums, WaveStamps
from render.tracing.waves.direct_sums import Trail
from render.tracing.waves.plane_waves import trace_waves

CELLS = (1024, 1536)
"""Across the aperture; the second where spikes hold more than `BEYOND` of the light beyond the reach of the first."""
PARTS = 55
"""Points of a cell at its edge, a Fibonacci lattice: edges along the axes are found to 1 / 55 of a cell."""
LAST = 0.39
"""Largest distance [lambda N] of the image over the number of cells across the aperture."""
ANNULUS = (60.0, 160.0)
"""Distances [lambda N] at which the fall of the image is measured, as 1 / r^3, in `SECTORS` sectors."""
SECTORS = 72
BEYOND = 7e-4
"""Part of the light of a saturated star that is left out."""
ASKEW = 0.02
"""Part by which the axes of pupil and image may be turned against each other."""
MOST_TIMES = 8
"""Points along a trail at which far images are added."""

_cache: dict[bytes, FarImage | None] = {}
_of: WeakKeyDictionary[PupilPlanner, FarImage | None] = WeakKeyDictionary()
MOST_CACHED = 4


@dataclass(frozen=True, slots=True, eq=False)
class FarImage:
    """Far image of one camera."""

    running: FloatArray  # (n + 1, n + 1) Light below edges of the samples, rows first
    per_px: tuple[float, float]  # Frequencies q of a pixel along columns and rows, at `wavelength_nm`
    wavelength_nm: float
    fall: float  # Mean light per (lambda N)^2 at a distance r [lambda N], times r^3
    spikes: float  # The same of the brightest sector
    last: float  # Largest distance at which it is known [lambda N]

    @property
    def saturated(self) -> float:
        """Distance [lambda N] beyond which `BEYOND` of the light lies."""
        return 2.0 * math.pi * self.fall / BEYOND

    def unit_px(self, wavelength_nm: FloatArray | float) -> Any:
        """lambda N [px]."""
        return wavelength_nm / (2.0 * self.wavelength_nm * math.sqrt(self.per_px[0] * self.per_px[1]))

    def pixels(self, x_px: FloatArray, y_px: FloatArray, wavelength_nm: FloatArray, weights: FloatArray) -> FloatArray:
        """Light (h, w) between edges (w + 1,), (h + 1,) from the middle, of wavelengths (k,) with weights."""
        line = len(self.running)
        flat, middle = self.running.ravel(), 0.5 * line
        below = np.zeros((len(y_px), len(x_px)))  # light left of and above corners of pixels
        for nm, part in zip(wavelength_nm, weights, strict=True):
            if part == 0.0:
                continue
            row, column = (
                np.clip(4.0 * edges * per_px * self.wavelength_nm / nm + middle, 0.0, line - 1 - 1e-9)
                for edges, per_px in ((y_px, self.per_px[1]), (x_px, self.per_px[0]))
            )
            first_row, first_column = row.astype(np.int64), column.astype(np.int64)
            corner, along = (first_row * line)[:, None] + first_column, column - first_column
            upper, lower = (
                start + (flat.take(at + 1) - start) * along
                for at, start in ((at, flat.take(at)) for at in (corner, corner + line))
            )
            below += part * (upper + (lower - upper) * (row - first_row)[:, None])
        return np.diff(np.diff(below, axis=0), axis=1)

    def radius_px(self, electrons: float, unit_px: float, ends_e: float, saturated: bool) -> float:
        """Radius of the end of a star's image."""
        radius = float(np.cbrt(electrons * self.spikes * unit_px / ends_e))
        if saturated:
            radius = max(radius, self.saturated * unit_px)
        return min(radius, self.last * unit_px)


def far_image(planner: PupilPlanner, wavelength_nm: float) -> FarImage | None:
    """Far image of a planner's camera; None where no light of the axis arrives or pupil and image are turned askew."""
    if planner in _of:
        return _of[planner]
    camera = planner.camera
    state = replace(camera, rotation_cam_from_world=np.eye(3), response=None, far=None, losses=None, scatter=None)
    key = pickle.dumps(state)
    if key not in _cache:
        while len(_cache) >= MOST_CACHED:
            _cache.pop(next(iter(_cache)))
        for cells in CELLS:
            _cache[key] = image = _far_image(planner, wavelength_nm, cells)
            if image is None or image.saturated < image.last:
                break
    _of[planner] = _cache[key]
    return _cache[key]


def _far_image(planner: PupilPlanner, wavelength_nm: float, cells: int) -> FarImage | None:
    wave = np.array([[wavelength_nm]])
    exposure = planner.exposure(at_rest(np.array([[0.0, 0.0, 1.0]])), wave)
    (centre,), (radius,) = (v[:, 0] for v in planner.disks(exposure, wave, np.zeros(1, np.int64)))
    star = np.zeros(1, np.uint32)

    def table(points: FloatArray) -> TablePoints:
        return TablePoints((centre + radius * points)[None], np.full(len(points), 1.0 / len(points)))

    def arrives(points: FloatArray) -> FloatArray:
        inside, arrived = np.hypot(*points.T) <= 1.0, np.zeros(len(points))
        arrived[inside] = exposure.mid.land(table(points[inside]), wave, star)[2].ravel()
        return arrived

    middle = (np.arange(cells) + 0.5) * (2.0 / cells) - 1.0
    x, y = (v.ravel() for v in np.meshgrid(middle, middle))
    mask = _aperture(arrives, x, y, cells)
    if not mask.any():
        return None
    lit = np.flatnonzero(mask > 0.5)
    some = np.stack([x[lit], y[lit]], axis=-1)[:: max(1, len(lit) // 500)]
    index = np.asarray(planner.camera.focused_lens.indices(wave)[-1])
    waves = trace_waves(exposure.mid, table(some), wave, index, star)
    design = np.column_stack([some, np.ones(len(some))])
    slope = np.linalg.lstsq(design, np.stack([waves.fx[0, 0, 0], waves.fy[0, 0, 0]], axis=-1), rcond=None)[0][:2].T
    if max(abs(slope[0, 1]), abs(slope[1, 0])) > ASKEW * np.abs(slope).max():
        return None
    if slope[0, 0] * slope[1, 1] < 0.0:  # the square of the transform is the same from both sides of the middle
        mask = mask[:, ::-1]
    half = np.abs(rfft2(mask.astype(np.float32), s=(2 * cells, 2 * cells))) ** 2
    cell = np.sinc(np.fft.fftfreq(2 * cells)) ** 2  # transfer function of cells
    half /= cell[:, None] * cell[: cells + 1]
    power = np.empty((2 * cells, 2 * cells))
    power[:, : cells + 1] = half
    mirrored = (-np.arange(2 * cells)) % (2 * cells)
    power[:, cells + 1 :] = half[mirrored][:, cells - 1 : 0 : -1]
    power = np.fft.fftshift(power / power.sum())
    fall, spikes = _falls(power)
    power *= 1.0 - math.sqrt(32.0) * fall / (0.5 * cells)  # light outside the square
    running = np.zeros((2 * cells + 1, 2 * cells + 1))
    np.cumsum(np.cumsum(power, axis=0), axis=1, out=running[1:, 1:])
    per_px = abs(float(slope[0, 0])), abs(float(slope[1, 1]))
    return FarImage(running, per_px, wavelength_nm, fall, spikes, LAST * cells)


def _aperture(arrives: Callable[[FloatArray], FloatArray], x: FloatArray, y: FloatArray, cells: int) -> FloatArray:
    """Part of every cell (n, n) about its middle x, y that light passes; those at edges are divided."""
    mask = arrives(np.stack([x, y], axis=-1)).reshape(cells, cells)
    edge = np.zeros(mask.shape, np.bool_)
    for axis in (0, 1):
        changes = np.diff(mask, axis=axis) != 0.0
        edge[(slice(None),) * axis + (slice(1, None),)] |= changes
        edge[(slice(None),) * axis + (slice(None, -1),)] |= changes
    few = np.flatnonzero(edge)
    if len(few):
        number = np.arange(PARTS)
        dx, dy = (((v + 0.5) / PARTS - 0.5) * (2.0 / cells) for v in (number, number * 34 % PARTS))
        inner = np.stack([(x[few, None] + dx).ravel(), (y[few, None] + dy).ravel()], axis=-1)
        mask.ravel()[few] = arrives(inner).reshape(len(few), -1).mean(1)
    return mask


def _falls(power: FloatArray) -> tuple[float, float]:
    """Light of samples per (lambda N)^2 times the cube of their distance [lambda N]: mean, and brightest sector."""
    place = 0.5 * (np.arange(len(power)) - 0.5 * len(power))  # samples at steps of half a unit
    distance = np.hypot(place, place[:, None])
    some = (distance > ANNULUS[0]) & (distance < ANNULUS[1])
    row, column = np.nonzero(some)
    value = 4.0 * power[some] * distance[some] ** 3
    sector = ((np.arctan2(place[row], place[column]) / (2.0 * np.pi) % 1.0) * SECTORS).astype(int) % SECTORS
    means = np.bincount(sector, value, SECTORS) / np.bincount(sector, minlength=SECTORS)
    return float(value.mean()), float(means.max())


def add_far_images(
    planner: PupilPlanner,
    stamps: WaveStamps,
    radius_px: float,
    light: NodeLight,
    image: NDArray[np.float32],
    sums: TruthSums,
    trail: Trail | None = None,
) -> None:
    """Add light beyond the stamps of bright stars, disks of a radius, and subtract it from the light left out."""
    camera = planner.camera
    limits = camera.far
    if limits is None:
        return
    stars, bands = stamps.stars, light.wavelength_nm.shape[0]
    electrons = light.electrons[stars] * stamps.light
    spectrum = light.weight[stars].reshape(len(stars), bands, -1, light.wavelength_nm.shape[1]).sum(2)
    for s, b in np.argwhere(electrons > limits.least_e).tolist():
        wave = light.wavelength_nm[b]
        far = far_image(planner, float(wave.mean()))
        if far is None:
            return
        unit, light_e = far.unit_px(float(spectrum[s, b] @ wave)), float(electrons[s, b])
        brightest = float(stamps.pixels[s, b].max() * light.electrons[stars[s], b])
        end = far.radius_px(light_e, unit, limits.ends_e, brightest > limits.saturated_e)
        if end < radius_px + 1.0:
            continue
        star = int(stars[s])
        positions = [(stamps.mean_px[s, b], 1.0)]
        if trail is not None:
            offset_px, weight = trail.offset_px[star, b], trail.weight[star, b]
            first = stamps.mean_px[s, b] - weight @ offset_px
            parts = np.array_split(np.arange(len(weight)), min(len(weight), MOST_TIMES))
            positions = [(first + weight[p] @ offset_px[p] / weight[p].sum(), float(weight[p].sum())) for p in parts]
        remaining_e = float(sums.beyond[star, b])
        for position_px, weight_here in positions:
            geometry, colours = (position_px, radius_px, end), (wave, spectrum[s, b])
            total_e = float(sums.image[star, b] + sums.off_edge[star, b])
            squares = total_e**2 / float(sums.noise_area[star, b])
            landed, on_image, squares_added = _add(
                far, geometry, colours, remaining_e * weight_here, image[..., b], camera.sensitive_columns
            )
            sums.image[star, b] += on_image
            sums.off_edge[star, b] += landed - on_image
            sums.beyond[star, b] -= landed
            sums.noise_area[star, b] = (total_e + landed) ** 2 / (squares + squares_added)


def _add(
    far: FarImage,
    geometry: tuple[FloatArray, float, float],
    colours: tuple[FloatArray, FloatArray],
    remaining_e: float,
    image: NDArray[np.float32],
    sensitive: NDArray[np.bool_] | None,
) -> tuple[float, float, float]:
    """Add one far image; its electrons, those on the detector, and the sum of squares of its pixels."""
    mean_px, radius_px, end_px = geometry
    reach, middle = math.ceil(end_px), np.rint(mean_px)
    edges = np.arange(-reach, reach + 2) - 0.5
    x, y = (edges + (m - p) for m, p in zip(middle, mean_px, strict=True))
    pixels = far.pixels(x, y, *colours)
    steps = np.arange(-reach, reach + 1)
    distance = np.hypot(steps, steps[:, None])
    outside = 1.0 - float(pixels[distance <= radius_px].sum())
    pixels *= (distance > radius_px) & (distance <= end_px)
    pixels *= remaining_e / outside
    (column, row), (height, width) = middle.astype(int) - reach, image.shape
    rows, columns = (slice(max(0, -a), max(0, min(2 * reach + 1, n - a))) for a, n in ((row, height), (column, width)))
    on_image = pixels[rows, columns]
    if on_image.size and sensitive is not None:
        on_image = on_image * sensitive[column + columns.start : column + columns.stop]
    if on_image.size:
        image[row + rows.start : row + rows.stop, column + columns.start : column + columns.stop] += on_image.astype(
            np.float32
        )
    return float(pixels.sum()), float(on_image.sum()), float((pixels**2).sum())
