"""Sampling of the pupil: quadrature inside a known outline, scrambled Sobol points otherwise.

The quadrature order is determined on stars spread over the field: the first order whose pixels, for any position of
their edges, agree to `TOLERANCE` of the star's light with an order of twice the number of rays. If none does (no charge
diffusion, so that pixel edges cut the bundle; an image dozens of pixels wide), Sobol points are used.

Under motion the order is lowered as far as the characteristic function of the landing points, times the transfer of
diffusion kernel and pixel, allows.

The azimuths of each wavelength node are turned by a golden-ratio fraction of their spacing, so that the nodes fill each
other's gaps; this halves the number of azimuths.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from optics.arrays import FloatArray
from optics.rays.pupil_sampling import gauss_disk
from render.tracing.convergence import damped_frequencies, transfer
from render.tracing.pupil.outlines import node_turns
from render.tracing.pupil.points import SobolPoints, TablePoints
from render.tracing.rays.kernel import ARRIVED, FIRST, LOST, StampSums

LADDER = tuple(
    zip((4, 6, 8, 10, 12, 15, 19, 24, 30, 38, 48, 60), (8, 10, 14, 18, 22, 28, 36, 46, 58, 74, 94, 120), strict=True)
)
"""Rings and azimuths that are tried, in this order."""

OUTLINE_LADDER = tuple(
    zip(
        (4, 6, 7, 8, 10, 11, 12, 13, 14, 16, 18, 20, 22, 25, 31, 39, 49, 62),
        (6, 8, 10, 12, 14, 16, 17, 19, 21, 23, 26, 29, 33, 37, 47, 60, 77, 98),
        strict=True,
    )
)
"""The same for outlines, where the rings' azimuths are staggered."""

BRIGHTEST = 0.01
"""Light in the brightest pixel below which errors count in terms of that."""
MEANS_FINER = 30.0
"""How many times as close as the pixels the mean of a bundle, which is truth, is held."""
LEAST_LIGHT = 1e-12
"""Share of a star's light below which none is lost (rounding of the sums)."""

PROBE_NODES = 6
"""Wavelength nodes per band on which the quadrature order is tried."""


@dataclass(frozen=True, slots=True)
class Landed:
    """Landing points of the rays of stars."""

    x: FloatArray  # (n, b, k, m) Columns [px]
    y: FloatArray  # (n, b, k, m) Rows [px]
    arrived: NDArray[np.bool_]  # (n, b, k, m) Whether they do
    weight: FloatArray  # Weights of the rays of a node; broadcasts to these
    node_weight: FloatArray | None = None  # (k,) Weights of the nodes, sum 1; equal if left out


@dataclass(frozen=True, slots=True)
class Trial:
    """Result of an order for probe stars."""

    pixels: FloatArray  # (n, ...) Light of all pixels, of all bands
    light: FloatArray  # (n, ...) Light that arrives
    mean: FloatArray  # (n, ...) Its mean [px]
    clear: NDArray[np.bool_]  # (n,) Whether all light arrives

    @classmethod
    def of(cls, stamps: StampSums, size_px: int) -> Trial:
        """Trial from cells of half a pixel: pixels at every half pixel."""
        rows = stamps.pixels[..., :-1, :] + stamps.pixels[..., 1:, :]
        pixels = rows[..., :-1] + rows[..., 1:]
        light = stamps.moments[..., ARRIVED]
        with np.errstate(invalid="ignore"):
            mean = size_px * stamps.moments[..., FIRST] / light[..., None]
        return cls(pixels, light, mean, np.asarray((stamps.moments[..., LOST] < LEAST_LIGHT).all(1)))

    def change(self, finer: Trial) -> float:
        """Largest change to a finer order; see `converged_order`."""
        axes = tuple(range(1, self.pixels.ndim))
        scale = np.minimum(1.0, finer.pixels.max(axes) / BRIGHTEST)
        pixel = np.abs(self.pixels - finer.pixels).max(axes) / scale
        light, mean = (
            np.abs(a - b).reshape(len(scale), -1).max(1)
            for a, b in ((self.light, finer.light), (self.mean, finer.mean))
        )
        return float(np.max([v[finer.clear] for v in (pixel, light, MEANS_FINER * mean)]))


def bounding_disk() -> TablePoints:
    """Unit-disk points whose landing points bound a bundle: a dense rim, where vignetting shows, and zones."""
    rings = [(1.0, 48), (0.93, 8), (0.85, 12), (0.7, 8), (0.5, 8), (0.25, 6)]
    points = [
        radius * np.column_stack([np.cos(a), np.sin(a)])
        for radius, arms in rings
        for a in (2 * np.pi * np.arange(arms) / arms,)
    ]
    every = np.concatenate([*points, np.zeros((1, 2))])
    return TablePoints(np.broadcast_to(every, (3, *every.shape)), np.full(len(every), 1.0 / len(every)))


def probe_fields(reach_rad: float) -> FloatArray:
    """Directions (n, 3) in cam spread over a field of half angle ``reach_rad``: on the axis, and on three circles."""
    fields = [(0.0, 0.0)]
    for part, count, start in ((0.5, 4, 0.3), (0.8, 4, 1.0), (1.0, 8, 0.0)):
        fields += [(part * reach_rad, start + 2 * math.pi * i / count) for i in range(count)]
    angle, azimuth = np.array(fields).T
    return np.stack([np.sin(angle) * np.cos(azimuth), np.sin(angle) * np.sin(azimuth), np.cos(angle)], axis=1)


@lru_cache(maxsize=4)
def staggered(order: tuple[int, int], nodes: int, times: int = 1) -> TablePoints:
    """Gauss x trapezoid points, turned from wavelength node to wavelength node, and from time to time."""
    pupil = gauss_disk(*order)
    turn = 2 * np.pi / order[1] * node_turns(nodes, times)[:, None]
    x = np.cos(turn) * pupil.x - np.sin(turn) * pupil.y
    y = np.sin(turn) * pupil.x + np.cos(turn) * pupil.y
    return TablePoints(np.stack([x, y], axis=-1), np.asarray(pupil.weight))


def whole_disk(order: tuple[int, int], nodes: int) -> TablePoints:
    """Gauss x trapezoid points of the whole disk, the same for every node."""
    samples = gauss_disk(*order)
    points = np.broadcast_to(np.column_stack([samples.x, samples.y]), (nodes, len(samples.x), 2))
    return TablePoints(points, np.asarray(samples.weight))


def _spectrum(
    landed: Landed, frequency: FloatArray, transfer_function: FloatArray
) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Damped characteristic function, light and mean of the landing points (n, b, 2 f + 3); which stars are clear."""
    x, y = landed.x, landed.y
    origin_x, origin_y = x.mean((2, 3), keepdims=True), y.mean((2, 3), keepdims=True)
    shares = landed.weight / x.shape[2] if landed.node_weight is None else landed.weight * landed.node_weight[:, None]
    weight = np.broadcast_to(shares, x.shape)
    half_x, half_y = (np.exp(1j * np.pi * value) for value in (x, y))  # half a cycle per pixel; powers follow
    diagonal = np.sqrt(0.5)
    base = {
        (1, 0): half_x,
        (0, 1): half_y,
        (1, 1): np.exp(1j * np.pi * diagonal * (x + y)),
        (1, -1): np.exp(1j * np.pi * diagonal * (x - y)),
    }
    columns = []
    powers = {key: np.ones_like(value) for key, value in base.items()}
    for at in range(0, len(frequency), 4):
        for offset, key in enumerate(base):
            powers[key] = powers[key] * base[key]
            columns.append(transfer_function[at + offset] * (weight * powers[key]).sum((2, 3)))
    rows = [part for column in columns for part in (column.real, column.imag)]
    light = weight.sum((2, 3))
    rows += [light, *((weight * (v - o)).sum((2, 3)) / light + o[..., 0, 0] for v, o in ((x, origin_x), (y, origin_y)))]
    return np.stack(rows, axis=-1), np.asarray(landed.arrived.all((1, 2, 3)))


def probe_nodes(nodes: int) -> NDArray[np.int64]:
    """A few wavelength nodes that decide for all.

    Fewer nodes leave wider gaps between their azimuths, so the order errs on the safe side.
    """
    return np.unique(np.rint(np.linspace(0, nodes - 1, min(nodes, PROBE_NODES))).astype(int))


def converged_order(
    trial: Callable[[tuple[int, int]], Trial], tolerance: float, ladder: tuple[tuple[int, int], ...] = LADDER
) -> tuple[tuple[int, int], float] | None:
    """Lowest order of a ladder that is converged for probe stars, and its error; None without.

    The error is the largest change of a pixel or of all light [the star's light], where the brightest pixel holds less
    than `BRIGHTEST` in units of what that would then hold, or of the mean [px] times `MEANS_FINER`.
    """
    tried: dict[tuple[int, int], Trial] = {}
    for order in ladder:
        beyond = math.ceil(math.sqrt(2.0) * order[0]), math.ceil(math.sqrt(2.0) * order[1])
        finer = next((candidate for candidate in ladder if math.prod(candidate) >= 2 * math.prod(order)), beyond)
        for candidate in (order, finer):
            if candidate not in tried:
                tried[candidate] = trial(candidate)
        if not tried[finer].clear.any():
            return None
        error = tried.pop(order).change(tried[finer])
        if error < tolerance:
            return order, error
    return None


def lowest_order(
    land: Callable[[tuple[int, int]], Landed],
    diffusion_px: float,
    tolerance: float,
    start: tuple[int, int],
    least: tuple[int, int],
) -> tuple[tuple[int, int], float]:
    """Order with as few azimuths, then as few rings, as agree with a higher one than ``start`` to the tolerance.

    For stars in motion, where the time nodes fill gaps in the pupil.
    """
    frequency = damped_frequencies(diffusion_px, tolerance)
    assert frequency is not None
    grid = frequency, transfer(frequency, diffusion_px)
    exact, clear = _spectrum(land((start[0] + 2, start[1] + 4)), *grid)
    errors: dict[tuple[int, int], float] = {}

    def error(order: tuple[int, int]) -> float:
        if order not in errors:
            errors[order] = float(np.abs(_spectrum(land(order), *grid)[0] - exact)[clear].max(initial=0.0))
        return errors[order]

    rings, arms = start
    for axis, margin in ((1, 0.7), (0, 1.0)):
        low, high = least[axis], start[axis]
        while low < high:  # the lowest that is good enough; errors fall with the order
            middle = (low + high) // 2
            if error((rings, middle) if axis else (middle, arms)) < margin * tolerance:
                high = middle
            else:
                low = middle + 1
        rings, arms = (rings, high) if axis else (high, arms)
    return (rings, arms), error((rings, arms))


def sobol_points(nodes: int, seed: int, log2_rays: int) -> SobolPoints:
    """Scrambled Sobol points, one net for each wavelength node of a band of at least 2^``log2_rays`` points."""
    return SobolPoints(max(6, math.ceil(log2_rays - math.log2(nodes))), seed)
