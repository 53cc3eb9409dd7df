"""How the pupil is sampled: quadrature where it is round and clear, scrambled Sobol where it is not.

The quadrature order is found by trial on stars spread over the field: what a pixel value depends on is the
characteristic function of the landing points, times the transfer of the diffusion kernel and of the pixel; the first
order that agrees with the next one to `TOLERANCE` is taken. Where none does (no charge diffusion, so that a pixel's
edge cuts the bundle; an image dozens of pixels wide) Sobol points serve too.

The azimuths of each wavelength node are turned by a golden-ratio fraction of their spacing: the nodes fill each other's
gaps, which halves the number of azimuths needed.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from optics.pupil import gauss_disk
from render.pupil_points import PupilPoints, SobolPoints, TablePoints
from render.star_kernel import StarKernel

__all__ = ["LADDER", "TOLERANCE", "PupilPlan", "bounding_points", "probe_fields", "quadrature_plan", "sobol_plan"]

FloatArray = NDArray[np.float64]

LADDER = (
    (4, 8),
    (6, 10),
    (8, 14),
    (10, 18),
    (12, 22),
    (15, 28),
    (19, 36),
    (24, 46),
    (30, 58),
    (38, 74),
    (48, 94),
    (60, 120),
)
"""Rings and azimuths that are tried, in this order."""

TOLERANCE = 3e-5
HIGHEST_FREQUENCY = 8.0
"""Cycles per pixel beyond which a spot is not followed; diffusion below 0.09 px lets more through: Sobol points."""

PROBE_NODES = 6
"""Wavelength nodes per band on which the quadrature order is tried."""
_GOLDEN = 0.6180339887498949


@dataclass(frozen=True, slots=True)
class PupilPlan:
    """Sampling of the pupil for a group of stars.

    Attributes
    ----------
    mode : {"quadrature", "sobol"}
        Which rule.
    pupil : PupilPoints
        Unit-disk points of every wavelength node.
    error : float
        Change of the damped characteristic function against the next order (quadrature), NaN for Sobol.
    """

    mode: str
    pupil: PupilPoints
    error: float

    @property
    def rays_per_node(self) -> int:
        """Rays per star, band and wavelength node."""
        return self.pupil.count


def bounding_points() -> FloatArray:
    """Unit-disk points (m, 2) whose landing points bound a bundle: a dense rim, where vignetting shows, and zones."""
    rings = [(1.0, 48), (0.93, 8), (0.85, 12), (0.7, 8), (0.5, 8), (0.25, 6)]
    points = [
        radius * np.column_stack([np.cos(a), np.sin(a)])
        for radius, arms in rings
        for a in (2 * np.pi * np.arange(arms) / arms,)
    ]
    return np.concatenate([*points, np.zeros((1, 2))])


def probe_fields(reach_rad: float) -> FloatArray:
    """Directions (n, 3) in cam spread over a field of half angle ``reach_rad``: on the axis, and on three circles."""
    fields = [(0.0, 0.0)]
    for part, count, start in ((0.5, 4, 0.3), (0.8, 4, 1.0), (1.0, 8, 0.0)):
        fields += [(part * reach_rad, start + 2 * math.pi * i / count) for i in range(count)]
    angle, azimuth = np.array(fields).T
    return np.stack([np.sin(angle) * np.cos(azimuth), np.sin(angle) * np.sin(azimuth), np.cos(angle)], axis=1)


def staggered(order: tuple[int, int], nodes: int) -> TablePoints:
    """Gauss x trapezoid points, turned from wavelength node to wavelength node."""
    pupil = gauss_disk(*order)
    turn = 2 * np.pi / order[1] * (_GOLDEN * np.arange(nodes) % 1.0)[:, None]
    x = np.cos(turn) * pupil.x - np.sin(turn) * pupil.y
    y = np.sin(turn) * pupil.x + np.cos(turn) * pupil.y
    return TablePoints(np.stack([x, y], axis=-1), np.asarray(pupil.weight))


def _frequencies(diffusion_px: float, tolerance: float) -> tuple[FloatArray, FloatArray] | None:
    """Frequencies (f, 2) [cycles/px] at which spots are compared, and the transfer of diffusion and pixel (f,) there.

    None where diffusion lets more than `HIGHEST_FREQUENCY` through.
    """
    if diffusion_px <= 0.0:
        return None
    highest = math.sqrt(0.5 * math.log(1.0 / tolerance)) / (math.pi * diffusion_px)
    if highest > HIGHEST_FREQUENCY:
        return None
    radii = np.arange(1, math.ceil(2 * highest) + 1) * 0.5
    along = np.array([(1.0, 0.0), (0.0, 1.0), (np.sqrt(0.5), np.sqrt(0.5)), (np.sqrt(0.5), -np.sqrt(0.5))])
    frequency = (radii[:, None, None] * along).reshape(-1, 2)
    pixel = np.minimum(1.0, 1.0 / (np.pi * np.maximum(np.abs(frequency), 1e-9))).prod(1)
    return frequency, pixel * np.exp(-2 * (np.pi * diffusion_px) ** 2 * (frequency**2).sum(1))


def _spectrum(
    kernel: StarKernel, wavelength_nm: FloatArray, order: tuple[int, int], frequency: FloatArray, transfer: FloatArray
) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Damped characteristic function and mean of the landing points (n, b, 2 f + 2); which stars are clear (n,)."""
    pupil = staggered(order, wavelength_nm.shape[1])
    x, y, ok = kernel.land(pupil, wavelength_nm)
    origin_x, origin_y = x.mean((2, 3), keepdims=True), y.mean((2, 3), keepdims=True)
    weight = np.broadcast_to(pupil.weight / wavelength_nm.shape[1], x.shape)
    half_x, half_y = (np.exp(1j * np.pi * value) for value in (x, y))  # half a cycle per pixel; powers of it follow
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
            columns.append(transfer[at + offset] * (weight * powers[key]).sum((2, 3)))
    rows = [part for column in columns for part in (column.real, column.imag)]
    rows += [(weight * (v - o)).sum((2, 3)) + o[..., 0, 0] for v, o in ((x, origin_x), (y, origin_y))]
    return np.stack(rows, axis=-1), np.asarray(ok.all((1, 2, 3)))


def quadrature_plan(
    kernel: StarKernel, wavelength_nm: FloatArray, diffusion_px: float, tolerance: float = TOLERANCE
) -> PupilPlan | None:
    """Lowest Gauss x trapezoid order that is converged for the probe stars in ``kernel``; None if there is none.

    Parameters
    ----------
    kernel : StarKernel
        Holds the probe stars only; those that are not clear do not count.
    wavelength_nm : (b, k)
        Wavelength nodes.
    diffusion_px : float
        Width of the diffusion kernel.
    tolerance : float
        Largest change of the characteristic function and of the mean [px] that counts as converged.
    """
    grid = _frequencies(diffusion_px, tolerance)
    if grid is None:
        return None
    # a few nodes judge for all: fewer nodes leave wider gaps between their azimuths, so the order errs on the safe side
    every = wavelength_nm.shape[1]
    few = np.unique(np.rint(np.linspace(0, every - 1, min(every, PROBE_NODES))).astype(int))
    probed = np.ascontiguousarray(wavelength_nm[:, few])
    previous, _ = _spectrum(kernel, probed, LADDER[0], *grid)
    for order, following in itertools.pairwise(LADDER):
        current, clear = _spectrum(kernel, probed, following, *grid)
        if not clear.any():
            return None
        error = float(np.abs(current - previous)[clear].max())
        if error < tolerance:
            return PupilPlan("quadrature", staggered(order, every), error)
        previous = current
    return None


def sobol_plan(nodes: int, seed: int, log2_rays: int) -> PupilPlan:
    """Scrambled Sobol points, a net of its own for every wavelength node.

    Parameters
    ----------
    nodes : int
        Wavelength nodes per band.
    seed : int
        Of the scrambling.
    log2_rays : int
        Logarithm of the least number of rays per star and band.
    """
    log2_points = max(6, math.ceil(log2_rays - math.log2(nodes)))
    return PupilPlan("sobol", SobolPoints(log2_points, seed), float("nan"))
