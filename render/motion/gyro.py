"""A strapdown gyro triad: true rotation in, noisy rates out.

The output is the *integrated* rate, as of rate-integrating and fibre-optic gyros: the k-th value is the mean of the
rate over the k-th interval, i.e. the increment of the angle (per axis) divided by the step. A rate sampled at an
instant would miss what happens between the samples; the mean keeps the angle of a rotation about a fixed direction to
rounding, however coarse the steps. What increments per axis cannot tell is in which order the axes turned within a step
(coning); `calib.attitude.gyro_attitude` restores most of it from neighbouring steps.

Model of the three axes, with the true rate w in the axes of the sensor:

    measured = (I + diag(scale) + misalignment) w + b(t) + n(t)

n: white rate noise of density N (angle random walk), which adds N sqrt(dt) to the angle of a step. b: constant bias,
plus a random walk of density K if one is stated. Terms as in IEEE Std 952-1997, annex C; the rates of change of the
random walk are integrated over the step exactly (mean and end value of a Wiener process jointly).
Default values: ACF17, Table 1.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy.spatial.transform import Rotation

from optics.arrays import FloatArray
from optics.errors import DomainError
from optics.records import freeze
from optics.units import ARCSEC_RAD, DEG_RAD
from render.engine.random import Streams
from render.motion.trajectory import Trajectory

HOUR_S = 3600.0
# Gauss-Legendre nodes in a step: exact for a rate that is a polynomial of degree 7 over the step.
NODES, NODE_WEIGHTS = np.polynomial.legendre.leggauss(4)


@dataclass(frozen=True, slots=True, kw_only=True)
class Gyro:
    """Three gyro axes. A single number stands for all three axes."""

    rate_hz: float = 100.0  # Increments per second [Hz]
    bias_deg_per_h: FloatArray = field(default_factory=lambda: np.full(3, 0.03))  # (3,) Constant bias [deg/h]
    # (3,) Density N of the white rate noise [deg/sqrt(h)]: the angle's standard deviation after the time t is N
    # sqrt(t)
    angle_random_walk_deg_per_sqrt_h: FloatArray = field(default_factory=lambda: np.full(3, 0.005))
    # (3,) Density K of the bias's random walk [deg/h/sqrt(h)]: the bias's standard deviation after t is K sqrt(t)
    rate_random_walk_deg_per_h_per_sqrt_h: FloatArray = field(default_factory=lambda: np.zeros(3))
    scale_factor_ppm: FloatArray = field(default_factory=lambda: np.zeros(3))  # (3,) Relative error of the scale [1e-6]
    # (3, 3) Small angles: row i, column j is how much of axis j the axis i feels [arcsec]; the diagonal is zero
    misalignment_arcsec: FloatArray = field(default_factory=lambda: np.zeros((3, 3)))
    # Axes of the gyro from the axes of the body, ``v_sensor = R v_body``
    sensor_from_body: Rotation = field(default_factory=Rotation.identity)

    def __post_init__(self) -> None:
        if not (np.isfinite(self.rate_hz) and self.rate_hz > 0):
            raise DomainError(f"Gyro.rate_hz = {self.rate_hz} Hz; it must be finite and positive")
        for name in (
            "bias_deg_per_h",
            "angle_random_walk_deg_per_sqrt_h",
            "rate_random_walk_deg_per_h_per_sqrt_h",
            "scale_factor_ppm",
        ):
            value = np.asarray(getattr(self, name), float)
            object.__setattr__(self, name, np.full(3, value) if value.ndim == 0 else value)
            freeze(self, name, shape=(3,))
            if "random_walk" in name and (getattr(self, name) < 0).any():
                raise DomainError(f"Gyro.{name} = {value.tolist()}; a density cannot be negative")
        misalignment = freeze(self, "misalignment_arcsec", shape=(3, 3))
        if np.diag(misalignment).any():
            raise DomainError(
                "Gyro.misalignment_arcsec: its diagonal must be zero; scale errors go into scale_factor_ppm"
            )
        if not isinstance(self.sensor_from_body, Rotation) or not self.sensor_from_body.single:
            raise DomainError("Gyro.sensor_from_body: one scipy Rotation is needed")

    @property
    def bias_rad_per_s(self) -> FloatArray:
        """Bias (3,) [rad/s]."""
        return np.asarray(self.bias_deg_per_h * DEG_RAD / HOUR_S)

    @property
    def angle_random_walk_rad_per_sqrt_s(self) -> FloatArray:
        """N (3,) [rad/sqrt(s)]."""
        return np.asarray(self.angle_random_walk_deg_per_sqrt_h * DEG_RAD / np.sqrt(HOUR_S))

    @property
    def rate_random_walk_rad_per_s_per_sqrt_s(self) -> FloatArray:
        """K (3,) [rad/s/sqrt(s)]."""
        return np.asarray(self.rate_random_walk_deg_per_h_per_sqrt_h * DEG_RAD / HOUR_S**1.5)

    @property
    def response(self) -> FloatArray:
        """Matrix (3, 3) from the true rate in body axes to the measured one in sensor axes."""
        errors = np.diag(1e-6 * self.scale_factor_ppm) + ARCSEC_RAD * self.misalignment_arcsec
        return np.asarray((np.eye(3) + errors) @ self.sensor_from_body.as_matrix())


@dataclass(frozen=True, slots=True, kw_only=True)
class GyroRecord:
    """Output of a gyro."""

    time_s: FloatArray  # (n + 1,) Ends of the intervals [s]
    rate_rad_per_s: FloatArray  # (n, 3) Mean rate over each interval, in sensor axes [rad/s]

    def __post_init__(self) -> None:
        time = freeze(self, "time_s", shape=("m",))
        freeze(self, "rate_rad_per_s", shape=(max(len(time) - 1, 0), 3))


def _interval_ends(trajectory: Trajectory, gyro: Gyro, start_s: float | None, end_s: float | None) -> FloatArray:
    """Ends (n + 1,) of all whole steps from the start on [s]."""
    first = trajectory.start_s if start_s is None else float(start_s)
    last = trajectory.end_s if end_s is None else float(end_s)
    steps = int(np.floor((last - first) * gyro.rate_hz + 1e-6)) if np.isfinite(last - first) else 0
    if steps < 1:
        raise DomainError(
            f"a gyro of {gyro.rate_hz:g} Hz has no complete sampling interval from {first:g} to {last:g} s; "
            "a longer time is needed"
        )
    return np.asarray(first + np.arange(steps + 1) / gyro.rate_hz)


def true_rates(
    trajectory: Trajectory, gyro: Gyro, *, start_s: float | None = None, end_s: float | None = None
) -> GyroRecord:
    """Output of the gyro without bias and noise, with scale errors, misalignment and mounting."""
    ends = _interval_ends(trajectory, gyro, start_s, end_s)
    step = 1.0 / gyro.rate_hz
    inner = ends[:-1, None] + 0.5 * step * (NODES + 1.0)
    rates = trajectory.rate(inner.ravel()).reshape(len(inner), len(NODES), 3)
    mean = 0.5 * np.einsum("q,nqi->ni", NODE_WEIGHTS, rates)
    return GyroRecord(time_s=ends, rate_rad_per_s=mean @ gyro.response.T)


def _noise(gyro: Gyro, steps: int, rng: np.random.Generator) -> FloatArray:
    """Bias and noise of the mean rates (steps, 3) [rad/s]."""
    step = 1.0 / gyro.rate_hz
    noise = rng.standard_normal((steps, 3)) * (gyro.angle_random_walk_rad_per_sqrt_s / np.sqrt(step))
    noise += gyro.bias_rad_per_s
    density = gyro.rate_random_walk_rad_per_s_per_sqrt_s
    if density.any():
        # Over a step a Wiener process moves by d and has the mean (start + d / 2) plus an independent part.
        moves, inside = rng.standard_normal((2, steps, 3)) * (density * np.sqrt(step))
        walk = np.cumsum(moves, axis=0)
        noise += walk - 0.5 * moves + inside / np.sqrt(12.0)
    return noise


def simulate_gyro(
    trajectory: Trajectory,
    gyro: Gyro,
    streams: Streams,
    *,
    run: int = 0,
    start_s: float | None = None,
    end_s: float | None = None,
) -> GyroRecord:
    """Mean rates over the steps of a gyro on a moving body."""
    runs = range(run, run + 1)
    time_s, rates = simulate_gyro_runs(trajectory, gyro, streams, runs=runs, start_s=start_s, end_s=end_s)
    return GyroRecord(time_s=time_s, rate_rad_per_s=rates[0])


def simulate_gyro_runs(
    trajectory: Trajectory,
    gyro: Gyro,
    streams: Streams,
    *,
    runs: int | range,
    start_s: float | None = None,
    end_s: float | None = None,
) -> tuple[FloatArray, FloatArray]:
    """Many runs of one motion at once: rates that differ by their noise only."""
    # -> (n + 1,), (r, n, 3)
    truth = true_rates(trajectory, gyro, start_s=start_s, end_s=end_s)
    steps = len(truth.rate_rad_per_s)
    noise = [
        _noise(gyro, steps, streams.generator("gyro", run)) for run in (range(runs) if isinstance(runs, int) else runs)
    ]
    return truth.time_s, truth.rate_rad_per_s + np.reshape(noise, (len(noise), steps, 3))
