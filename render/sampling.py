"""How the pupil is sampled: quadrature where it is round and clear, scrambled Sobol where it is not.

The quadrature order is found by trial: the characteristic function of the landing points, damped by the diffusion
kernel, is what the pixel values depend on; the first order that agrees with the next one to `TOLERANCE` is taken. The
azimuths of each wavelength node are turned by a golden-ratio fraction of their spacing: the nodes fill each other's
gaps, which halves the number of azimuths needed.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from optics.pupil import gauss_disk, sobol_disk
from render.star_kernel import StarKernel

__all__ = ["PROBES", "TOLERANCE", "PupilPlan", "bounding_points", "quadrature_plan", "sobol_plan"]

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
TOLERANCE = 3e-5
PROBES = 7
_GOLDEN = 0.6180339887498949
_FREQUENCIES = np.array([(1, 0), (0, 1), (1, 1), (1, -1), (2, 0), (0, 2), (2, 2), (3, 0), (0, 3), (4, 0), (0, 4)]) * 0.5


@dataclass(frozen=True, slots=True)
class PupilPlan:
    """Sampling of the pupil for a group of stars.

    Attributes
    ----------
    mode : {"quadrature", "sobol"}
        Which rule.
    points : (k, p, 2)
        Unit-disk points of every wavelength node.
    weight : (p,)
        Weights, sum 1.
    error : float
        Change of the characteristic function against the next order (quadrature), NaN for Sobol.
    """

    mode: str
    points: FloatArray
    weight: FloatArray
    error: float

    @property
    def rays_per_node(self) -> int:
        """Rays per star, band and wavelength node."""
        return self.points.shape[1]


def bounding_points() -> FloatArray:
    """Unit-disk points (m, 2) whose landing points bound a bundle: rim first (16 rays), then zones and centre."""
    rings = [(1.0, 16), (0.93, 8), (0.85, 12), (0.7, 8), (0.5, 8), (0.25, 6)]
    points = [
        radius * np.column_stack([np.cos(a), np.sin(a)])
        for radius, arms in rings
        for a in (2 * np.pi * np.arange(arms) / arms,)
    ]
    return np.concatenate([*points, np.zeros((1, 2))])


def _staggered(order: tuple[int, int], nodes: int) -> tuple[FloatArray, FloatArray]:
    """Gauss x trapezoid points (k, p, 2), turned from node to node, and weights (p,)."""
    pupil = gauss_disk(*order)
    turn = 2 * np.pi / order[1] * (_GOLDEN * np.arange(nodes) % 1.0)[:, None]
    x = np.cos(turn) * pupil.x - np.sin(turn) * pupil.y
    y = np.sin(turn) * pupil.x + np.cos(turn) * pupil.y
    return np.stack([x, y], axis=-1), np.asarray(pupil.weight)


def _characteristic(
    kernel: StarKernel, wavelength_nm: FloatArray, share: FloatArray, order: tuple[int, int], diffusion_px: float
) -> FloatArray:
    """Damped characteristic function and mean of the landing points, (n, b, f)."""
    points, pupil_weight = _staggered(order, wavelength_nm.shape[1])
    x, y, _ = kernel.land(points, wavelength_nm)
    weight = share[..., None] * pupil_weight
    origin_x, origin_y = x.mean((2, 3), keepdims=True), y.mean((2, 3), keepdims=True)
    rows = []
    for fx, fy in _FREQUENCIES:
        damp = np.exp(-2 * (np.pi * diffusion_px) ** 2 * (fx**2 + fy**2))
        phase = 2 * np.pi * (fx * x + fy * y)
        rows += [damp * (weight * np.cos(phase)).sum((2, 3)), damp * (weight * np.sin(phase)).sum((2, 3))]
    rows += [((weight * (v - o)).sum((2, 3)) + o[..., 0, 0]) for v, o in ((x, origin_x), (y, origin_y))]
    return np.stack(rows, axis=-1)


def quadrature_plan(
    kernel: StarKernel, wavelength_nm: FloatArray, share: FloatArray, diffusion_px: float, tolerance: float = TOLERANCE
) -> PupilPlan:
    """Lowest Gauss x trapezoid order that is converged for the probe stars in ``kernel``.

    Parameters
    ----------
    kernel : StarKernel
        Holds the probe stars only.
    wavelength_nm, share
        (b, k) wavelengths and (n, b, k) shares of the nodes.
    diffusion_px : float
        Width of the diffusion kernel.
    tolerance : float
        Largest change of the characteristic function that counts as converged.
    """
    previous = _characteristic(kernel, wavelength_nm, share, LADDER[0], diffusion_px)
    order, error = LADDER[0], np.inf
    for following in LADDER[1:]:
        current = _characteristic(kernel, wavelength_nm, share, following, diffusion_px)
        error = float(np.abs(current - previous).max())
        if error < tolerance:
            break
        order, previous = following, current
    return PupilPlan("quadrature", *_staggered(order, wavelength_nm.shape[1]), error)


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
    log2_points = max(6, int(np.ceil(log2_rays - np.log2(nodes))))
    nets = [sobol_disk(1 << log2_points, seed=seed + node) for node in range(nodes)]
    points = np.stack([np.column_stack([net.x, net.y]) for net in nets])
    return PupilPlan("sobol", points, np.full(points.shape[1], 1.0 / points.shape[1]), float("nan"))
