"""Plane waves of stars between few traced ones: series over smooth pupils.

Directions, phases and amplitudes change smoothly over a pupil whose outline is smooth. Rays on some rings and azimuths
tell them everywhere: waves along the azimuth, polynomials along the radius. Sums over pupils need many more rays than
those, which cost less to be interpolated than traced, and few near the middle, where a turn about it is short.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from optics.arrays import BoolArray, FloatArray
from render.tracing.outlines import rings
from render.tracing.plane_waves import PlaneWaves, RayArrays

__all__ = ["WaveSeries", "azimuths", "nodes_along"]


TAIL = 2e-6
"""Largest of the last coefficients of a series that is resolved: phase [turns], or share of the amplitude."""
REACH_PX = 25.0
"""Distance from the mean of the rays at which frequencies have to give phases that well."""
LAST_RINGS, LAST_TURNS = 2, 4
"""Coefficients at either end of a series by which it is judged."""
ROUNDED = 16
"""Steps of the number of azimuths, so that few tables are needed."""


def azimuths(around: FloatArray) -> FloatArray:
    """How many of them integrate over a ring along which the phase changes by so much per radian.

    Bessel functions J_m(x) vanish for m > x + some x^(1/3).
    """
    return np.asarray(around + 2.5 * np.cbrt(around) + 3.0)


def nodes_along(radial: FloatArray) -> FloatArray:
    """How many rings integrate over a radius along which the phase changes by so much.

    Gauss's rule of n nodes ends with J_2n of half of it; 5 more than a quarter were 1e-4 of the light short at 350 rad.
    """
    return np.asarray(radial / 4.0 + np.maximum(5.0, 1.6 * np.cbrt(radial / 2.0)))


@dataclass(frozen=True, slots=True, eq=False)
class WaveSeries:
    """Plane waves of s stars in b bands at k wavelengths."""

    # (s, b, k, rings, 4, turns) Of Legendre polynomials in the radius, and waves in azimuth, of the frequencies fx,
    # fy [cycles/px], of the phase about `mean` [turns] and of the amplitude per part of the pupil
    coefficient: NDArray[np.complex128]
    mean: FloatArray  # (s, b, k, 2) Mean landing point [px]
    resolved: BoolArray  # (s,) Whether the series end with small numbers

    @classmethod
    def of(cls, waves: PlaneWaves, order: tuple[int, int], turn: FloatArray) -> WaveSeries:
        """Series of traced waves."""
        # turn (k, rings)
        count, arms = order
        mean = waves.mean
        x0, y0 = mean[..., 0, None], mean[..., 1, None]
        phase = waves.turns + waves.fx * (x0 - waves.x) + waves.fy * (y0 - waves.y)
        with np.errstate(invalid="ignore"):
            density = waves.amplitude * arms / np.repeat(rings(count)[1], arms)
            values = np.stack([waves.fx, waves.fy, phase - phase[..., :1], density], axis=-2)
            values = values.reshape(*mean.shape[:3], 4, count, arms)
            back = np.exp(-2j * np.pi / arms * turn[:, :, None] * np.arange(arms // 2))
            spectrum = np.fft.rfft(values, axis=-1)[..., :-1] * (back[:, None] / arms)
            coefficient = np.ascontiguousarray(np.moveaxis(_legendre(count) @ spectrum, 4, 3))
            size = np.abs(coefficient)
            tail = np.maximum(
                size[:, :, :, -LAST_RINGS:].max((3, 5)),
                size[..., -LAST_TURNS:].max((3, 5)),
            )
            scale = np.broadcast_to(np.array([REACH_PX, REACH_PX, 1.0, 1.0]), tail.shape).copy()
            scale[..., 3] = 1.0 / size[:, :, :, 0, 3, 0]
            good = (tail * scale < TAIL).all((1, 2, 3)) & (waves.weight > 0.0).all((1, 2, 3))
        return cls(coefficient, mean, np.asarray(good))

    def take(self, stars: BoolArray) -> WaveSeries:
        """The same of some of the stars."""
        return WaveSeries(self.coefficient[stars], self.mean[stars], self.resolved[stars])

    def rays(self, at: tuple[int, int], order: tuple[int, int], colour: int) -> RayArrays:
        """Rays of one star and band at one wavelength, on rings and azimuths that an order asks for at the rim."""
        (x, y), shape = self.mean[*at, colour], self.coefficient.shape[3:]
        spectrum = self.coefficient[*at, colour].view(np.float64).reshape(shape[0], -1)
        polynomials, weight, arms = _rings(order, shape[0])
        along = (polynomials @ spectrum).reshape(-1, shape[1], 2 * shape[2])
        parts = [along[part] @ _waves(shape[2], count) for count, part in arms]
        fx, fy, turns, amplitude = np.concatenate([np.moveaxis(p, 1, 0).reshape(shape[1], -1) for p in parts], axis=1)
        return np.full(len(fx), x), np.full(len(fx), y), fx, fy, turns, amplitude * weight


@cache
def _legendre(count: int) -> FloatArray:
    """What makes coefficients of Legendre polynomials of values at rings."""
    return np.asarray(np.linalg.inv(np.polynomial.legendre.legvander(2.0 * rings(count)[0] - 1.0, count - 1)))


@cache
def _waves(turns: int, arms: int) -> FloatArray:
    """What makes values at equidistant azimuths (arms,) of real and imaginary parts of waves (2 turns,)."""
    turned = np.exp(2j * np.pi / arms * np.outer(np.arange(turns), np.arange(arms)))
    turned[1:] *= 2.0
    return np.stack([turned.real, -turned.imag], axis=1).reshape(2 * turns, arms)


@cache
def _rings(order: tuple[int, int], count: int) -> tuple[FloatArray, FloatArray, tuple[tuple[int, slice], ...]]:
    """Legendre polynomials (rings, count) at the rings of a sum, weights of rays, and numbers of azimuths of rings."""
    ring, weight = rings(order[0])
    around = np.linspace(0.0, order[1], 4 * order[1])
    wanted = azimuths(ring * np.interp(order[1], azimuths(around), around))
    arms = np.clip(ROUNDED * np.ceil(wanted / ROUNDED), ROUNDED, order[1]).astype(int)
    starts = np.flatnonzero(np.diff(arms, prepend=0))
    ends = [*starts[1:].tolist(), len(ring)]
    parts = tuple((int(arms[a]), slice(int(a), int(b))) for a, b in zip(starts, ends, strict=True))
    polynomials = np.polynomial.legendre.legvander(2.0 * ring - 1.0, count - 1)
    return np.asarray(polynomials, np.float64), np.repeat(weight / arms, arms), parts
