"""Parts of a radius of the field in which one polynomial follows the light and the mean of the rays of stars.

An aperture that begins to cut beams takes light as the power 3/2 of how far the field lies beyond, and one that begins
to limit another part of the outline leaves a kink of some other kind; where that is depends on the wavelength. Nodes
along a radius serve where they keep to one side of a kink, so that the radius is divided.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.polynomial import chebyshev as series

from optics.arrays import FloatArray, IntArray

__all__ = ["CutBeams", "radial_edges"]


LEFT = 2e-5
"""Most that a polynomial may leave of the light [share] or of the mean [px]."""
LEAST_SAMPLES = 2
"""Samples of a part that can not be shorter, per coefficient."""


@dataclass(frozen=True, slots=True)
class CutBeams:
    """Light and means of beams at n places of a field where apertures cut them, at c wavelengths of each band.

    Attributes
    ----------
    place : (n, 2)
        Tangents; of a lens of revolution along one radius.
    part, turn : (n,)
        Parts of that radius, and angles by which images are turned where they are judged.
    which : (c,)
        Numbers of the wavelengths.
    light, mean_px : (n, b, c), (n, b, c, 2)
        Light that gets through the lens, mean landing point.
    chief_px : (n, b, 2)
        Where chief rays land.
    """

    place: FloatArray
    part: FloatArray
    turn: FloatArray
    which: IntArray
    light: FloatArray
    mean_px: FloatArray
    chief_px: FloatArray

    def turned(self, error: FloatArray, count: int) -> FloatArray:
        """As many places (p, 2), where errors (n,) are largest, one of each part of the field, turned."""
        at = [part[error[part].argmax()] for part in np.array_split(np.arange(len(error)), count)]
        (x, y), cos, sin = self.place[at].T, np.cos(self.turn[at]), np.sin(self.turn[at])
        return np.stack([cos * x - sin * y, sin * x + cos * y], axis=-1)


def radial_edges(part: FloatArray, even: FloatArray, odd: FloatArray, inner: int, outer: int) -> FloatArray:
    """Where parts of a radius end, the last of them at its end left out.

    Parameters
    ----------
    part : (n,)
        Samples of the radius, in parts of it, ascending.
    even, odd : (n, e), (n, o)
        Functions sampled there that are even and odd in the radius.
    inner, outer : int
        Coefficients of a polynomial of the innermost part, which is even or odd, and of others.
    """
    last, edges = len(part), [0.0]
    begin = 0
    while begin < last:
        count = inner if begin == 0 else outer

        def fits(end: int, begin: int = begin, count: int = count) -> bool:
            t, values = part[begin:end], (even[begin:end], odd[begin:end])
            if begin == 0:
                every = series.chebvander(t / t[-1], 2 * count - 1)
                return all(_left(every[:, odd_::2], v) < LEFT for odd_, v in enumerate(values))
            scaled = 2.0 * (t - t[0]) / (t[-1] - t[0]) - 1.0
            return _left(series.chebvander(scaled, count - 1), np.concatenate(values, axis=1)) < LEFT

        begin = _farthest(fits, begin + LEAST_SAMPLES * count, last)
        edges.append(float(0.5 * (part[begin - 1] + part[begin])) if begin < last else 1.0)
    return np.array(edges[1:-1])


def _farthest(fits: Callable[[int], bool], least: int, last: int) -> int:
    """The largest end for which a fit holds, by bisection."""
    if least >= last or fits(last):
        return last
    low, high = least, last
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (middle, high) if fits(middle) else (low, middle)
    return low


def _left(terms: FloatArray, values: FloatArray) -> float:
    """Largest residual of a fit of values (n, v) by terms (n, t)."""
    orthogonal = np.linalg.qr(terms)[0]
    return float(np.abs(values - orthogonal @ (orthogonal.T @ values)).max(initial=0.0))
