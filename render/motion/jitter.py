r"""Random motion about a trajectory, with given power spectra: attitude and rate in closed form at any time.

Spectral representation (Shinozuka & Deodatis 1991, Appl. Mech. Rev. 44, 191): about each axis of the body

.. math:: \delta(t) = \sum_k \sqrt{2 P_k} \cos(2 \pi f_k t + \varphi_k)

with the power :math:`P_k` of a cell of frequencies, one frequency drawn in every cell and a phase drawn for each. The
variance over time is the sum of :math:`P_k`, which is the integral of the spectrum for every draw; the values at any
time are Gaussian in the limit of many cells.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from optics.arrays import FloatArray
from optics.errors import DomainError
from optics.records import freeze, freeze_all, locked
from optics.units import ARCSEC_RAD
from render.engine.random import Streams
from render.motion.trajectory import Trajectory

CELLS = 512
"""Cells of equal ratio between the lowest and the highest frequency."""
EXPOSURE_CELLS = 20000
"""Cells of the integral over sinc squared."""
_AXES = ("x", "y", "z")


@dataclass(frozen=True, slots=True, kw_only=True)
class JitterSpectrum:
    """One-sided power spectral densities of rotations about the body's axes."""

    frequency_hz: FloatArray  # (m,) Increasing, positive
    # (3, m) Density for x, y, z there; power laws in between, nothing beyond. An axis is positive throughout or zero
    psd_arcsec2_per_hz: FloatArray

    def __post_init__(self) -> None:
        sizes: dict[str, int] = {}
        f = freeze(self, "frequency_hz", shape=("m",), sizes=sizes)
        psd = freeze(self, "psd_arcsec2_per_hz", shape=(3, "m"), sizes=sizes)
        if len(f) < 2 or f[0] <= 0 or not (np.diff(f) > 0).all():
            raise DomainError("JitterSpectrum.frequency_hz: at least two increasing frequencies above 0 Hz are needed")
        for axis, values in zip(_AXES, psd, strict=True):
            if not ((values > 0).all() or (values == 0).all()):
                raise DomainError(
                    f"JitterSpectrum.psd_arcsec2_per_hz about {axis} contains {values.min():g} arcsec^2/Hz; it must be "
                    "positive throughout, or zero throughout for an axis at rest"
                )

    def power_arcsec2(self, edge_hz: FloatArray) -> FloatArray:
        """Power (3, e - 1) between edges (e,) [Hz] within the range: integrals of the power laws [arcsec^2]."""
        edges = np.asarray(edge_hz, float)
        running = np.stack([_running_power(self.frequency_hz, psd, edges) for psd in self.psd_arcsec2_per_hz])
        return np.diff(running, axis=1)

    def exposure_power_arcsec2(self, exposure_s: float) -> tuple[FloatArray, FloatArray]:
        """Variance (3,) about each axis of the mean over an exposure, and within one [arcsec^2].

        In closed form: the mean over a time T passes the part sinc(f T)^2 of the power at f.
        """
        edges = np.geomspace(self.frequency_hz[0], self.frequency_hz[-1], EXPOSURE_CELLS + 1)
        edges[[0, -1]] = self.frequency_hz[[0, -1]]
        power = self.power_arcsec2(edges)
        passed = np.sinc(np.sqrt(edges[1:] * edges[:-1]) * exposure_s) ** 2
        return (power * passed).sum(1), (power * (1.0 - passed)).sum(1)

    @property
    def rms_arcsec(self) -> FloatArray:
        """Root mean square (3,) of the rotation about each axis."""
        return np.sqrt(self.power_arcsec2(self.frequency_hz[[0, -1]])[:, 0])


def _running_power(frequency: FloatArray, psd: FloatArray, at: FloatArray) -> FloatArray:
    """Power from the lowest frequency up to others, of a spectrum of power laws."""
    if not psd.any():
        return np.zeros(len(at))
    slope = np.diff(np.log(psd)) / np.diff(np.log(frequency))

    def up_to(piece: NDArray[np.int64], f: FloatArray) -> FloatArray:
        start, level, power = frequency[piece], psd[piece], slope[piece] + 1.0
        log = np.log(f / start)
        x = power * log
        ratio = np.where(np.abs(x) > 1e-12, np.expm1(x) / np.where(x == 0.0, 1.0, x), 1.0)  # (r^p - 1) / (p log r)
        return np.asarray(level * start * log * ratio)

    pieces = np.arange(len(slope))
    cumulative = np.concatenate([[0.0], np.cumsum(up_to(pieces, frequency[1:]))])
    piece = np.clip(np.searchsorted(frequency, at, side="right") - 1, 0, len(slope) - 1)
    return cumulative[piece] + up_to(piece, at)


@dataclass(frozen=True, slots=True, kw_only=True)
class Jittered:
    """A trajectory with jitter: ``attitude = exp(-delta) base.attitude``; made by `jittered`."""

    base: Trajectory  # What is jittered
    # frequency_hz, phase_rad: (3, k) Of the oscillations about each body axis
    frequency_hz: FloatArray
    phase_rad: FloatArray
    amplitude_rad: FloatArray  # (3, k) Their amplitudes

    def __post_init__(self) -> None:
        freeze_all(self, frequency_hz=(3, "k"), phase_rad=(3, "k"), amplitude_rad=(3, "k"))

    @property
    def start_s(self) -> float:
        return self.base.start_s

    @property
    def end_s(self) -> float:
        return self.base.end_s

    def offset_rad(self, time_s: ArrayLike) -> FloatArray:
        """Rotation vector delta (..., 3) by which the body is turned away from the base, in body axes [rad]."""
        return self._sum(time_s, np.cos, self.amplitude_rad)

    def attitude(self, time_s: ArrayLike) -> Rotation:
        base = self.base.attitude(time_s)
        return Rotation.from_rotvec(-self.offset_rad(time_s)) * base

    def rate(self, time_s: ArrayLike) -> FloatArray:
        """Angular velocity in body axes [rad/s]: that of the base, turned, and its own (left Jacobian of -delta)."""
        base, delta = self.base.rate(time_s), self.offset_rad(time_s)
        speed = -self._sum(time_s, np.sin, 2.0 * np.pi * self.frequency_hz * self.amplitude_rad)
        angle2 = (delta**2).sum(-1, keepdims=True)
        angle = np.sqrt(np.maximum(angle2, 1e-16))
        first = np.where(angle2 > 1e-8, (1.0 - np.cos(angle)) / np.maximum(angle2, 1e-16), 0.5 - angle2 / 24.0)
        second = np.where(angle2 > 1e-8, (angle - np.sin(angle)) / angle**3, 1.0 / 6.0 - angle2 / 120.0)
        across = -np.cross(delta, speed)
        jitter_rate = speed + first * across - second * np.cross(delta, across)
        return np.asarray(jitter_rate + Rotation.from_rotvec(-delta).apply(base))

    def _sum(self, time_s: ArrayLike, wave: np.ufunc, amplitude_rad: FloatArray) -> FloatArray:
        """Sum of oscillations (..., 3)."""
        t = np.asarray(time_s, float)
        if not np.isfinite(t).all():
            raise DomainError("time_s contains a time that is not finite")
        angle = 2.0 * np.pi * t[..., None, None] * self.frequency_hz + self.phase_rad
        return np.asarray((amplitude_rad * wave(angle)).sum(-1))


def jittered(trajectory: Trajectory, spectrum: JitterSpectrum, *, streams: Streams, frame: int = 0) -> Jittered:
    """Add jitter to a trajectory; its variance over time is that of the spectrum about the body's axes.

    ``frame`` is the key of the realization: frames of one continuous motion share a number.
    """
    low, high = spectrum.frequency_hz[[0, -1]]
    edges = np.geomspace(low, high, CELLS + 1)
    edges[[0, -1]] = low, high
    amplitude = np.sqrt(2.0 * spectrum.power_arcsec2(edges)) * ARCSEC_RAD
    drawn = np.stack([streams.generator(f"jitter {axis}", frame).random((2, CELLS)) for axis in _AXES])
    frequency = edges[:-1] * (edges[1:] / edges[:-1]) ** drawn[:, 0]
    return Jittered(
        base=trajectory,
        frequency_hz=locked(frequency),
        phase_rad=locked(2.0 * math.pi * drawn[:, 1]),
        amplitude_rad=locked(amplitude),
    )
