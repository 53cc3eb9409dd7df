"""Motion of a body: its attitude and its angular rate at any time.

``attitude(t)`` is the rotation *body from reference*: ``v_body = R v_ref``. The body is what camera and gyro are
mounted on; a camera's own trajectory is ``mounted(trajectory, cam_from_body)``. ``rate(t)`` is the angular velocity of
the body against the reference, in body axes [rad/s], as a gyro feels it. The two are tied by

    R(t + dt) = exp(-rate dt) R(t):

a body that turns by a positive angle about its z axis sees the stars turn by the negative one.

* `ConstantRate`: exact, ``R(t) = exp(-rate (t - t0)) R(t0)``.
* `SampledAttitude`: a spline through given attitudes, with continuous rate and acceleration (`scipy` RotationSpline).
* `Slew`: a turn about one fixed axis that begins and ends at rest.
* `TurningAxis`: a rate of constant size whose direction goes round an axis of the body.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation, RotationSpline

from optics.arrays import FloatArray
from optics.errors import DomainError
from optics.records import freeze

TURNING_TILT = float(np.arctan(np.sqrt(0.5)))
"""Of the axis of `TurningAxis` against its plane: each body axis then has the same mean square rate."""
SLACK_S = 1e-9  # a time this far outside still counts as the end: sums of steps do not land on it exactly


class Trajectory(Protocol):
    """Attitude and rate between ``start_s`` and ``end_s``."""

    @property
    def start_s(self) -> float:
        """First time [s]."""
        ...

    @property
    def end_s(self) -> float:
        """Last time [s]."""
        ...

    def attitude(self, time_s: ArrayLike) -> Rotation:
        """Body from reference at a time of the trajectory, or at n of them [s]."""
        ...

    def rate(self, time_s: ArrayLike) -> FloatArray:
        """Angular velocity in body axes [rad/s], (3,) at a time or (n, 3) at n of them."""
        ...


def _times(trajectory: Trajectory, time_s: ArrayLike) -> FloatArray:
    """Times () or (n,), checked and moved onto the ends where they miss them by rounding."""
    t = np.asarray(time_s, float)
    if t.ndim > 1:
        raise DomainError(f"time_s has shape {t.shape}; one time or (n,) times are needed")
    first, last = trajectory.start_s, trajectory.end_s
    slack = SLACK_S + 1e-12 * max(abs(first), abs(last))
    wrong = ~((t >= first - slack) & (t <= last + slack))
    if wrong.any():
        value = t if t.ndim == 0 else t[wrong][0]
        raise DomainError(
            f"time_s = {float(value):g} s lies outside of the trajectory, which runs from {first:g} to {last:g} s"
        )
    return np.clip(t, first, last)


def _check_span(owner: str, start_s: float, end_s: float) -> None:
    if not (np.isfinite(start_s) and np.isfinite(end_s) and end_s > start_s):
        raise DomainError(f"{owner} runs from {start_s} to {end_s} s; finite times are needed, the end after the start")


def _check_single(owner: str, name: str, rotation: Rotation) -> None:
    if not isinstance(rotation, Rotation) or not rotation.single:
        raise DomainError(f"{owner}.{name}: one scipy Rotation is needed")


@dataclass(frozen=True, slots=True, kw_only=True)
class ConstantRate:
    """A body that turns at a constant rate about an axis fixed in it (and therefore in the reference)."""

    initial: Rotation  # Body from reference at ``start_s``
    rate_rad_per_s: FloatArray  # (3,) In body axes; zero for a body at rest
    end_s: float
    start_s: float = 0.0

    def __post_init__(self) -> None:
        _check_single("ConstantRate", "initial", self.initial)
        freeze(self, "rate_rad_per_s", shape=(3,))
        _check_span("ConstantRate", self.start_s, self.end_s)

    def attitude(self, time_s: ArrayLike) -> Rotation:
        elapsed = _times(self, time_s) - self.start_s
        return Rotation.from_rotvec(-elapsed[..., None] * self.rate_rad_per_s) * self.initial

    def rate(self, time_s: ArrayLike) -> FloatArray:
        t = _times(self, time_s)
        return np.broadcast_to(self.rate_rad_per_s, (*t.shape, 3)).copy()


@dataclass(frozen=True, slots=True, kw_only=True)
class SampledAttitude:
    """A smooth motion through given attitudes.

    The rotation vector between samples is cubic in time, with continuous rate and acceleration (scipy `RotationSpline`
    and the note by N. Mayorov, "Smooth attitude interpolation", that it cites); two samples give a constant rate.
    """

    samples_s: FloatArray  # (n,) Increasing times [s], at least two
    attitudes: Rotation  # Body from reference at these times; neighbours less than 180 deg apart
    _spline: RotationSpline = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        times = freeze(self, "samples_s", shape=("n",))
        if len(times) < 2 or not (np.diff(times) > 0).all():
            raise DomainError(f"SampledAttitude.samples_s: at least two increasing times are needed, got {len(times)}")
        if not isinstance(self.attitudes, Rotation) or self.attitudes.single or len(self.attitudes) != len(times):
            raise DomainError(f"SampledAttitude.attitudes: {len(times)} rotations are needed, one for each time")
        # scipy's spline turns body vectors into the reference, and gives rates in body axes.
        object.__setattr__(self, "_spline", RotationSpline(times, self.attitudes.inv()))

    @property
    def start_s(self) -> float:
        return float(self.samples_s[0])

    @property
    def end_s(self) -> float:
        return float(self.samples_s[-1])

    def attitude(self, time_s: ArrayLike) -> Rotation:
        return self._spline(_times(self, time_s)).inv()

    def rate(self, time_s: ArrayLike) -> FloatArray:
        return np.asarray(self._spline(_times(self, time_s), 1))


@dataclass(frozen=True, slots=True, kw_only=True)
class Slew:
    """A turn about one fixed axis from rest to rest, as short as it can be.

    The fraction of the angle after the fraction s of the time is ``10 s^3 - 15 s^4 + 6 s^5``: rate and acceleration
    vanish at both ends.
    """

    # initial, final: Body from reference at the start and at the end
    initial: Rotation
    final: Rotation
    # end_s, start_s: Last and first time [s]
    end_s: float
    start_s: float = 0.0

    def __post_init__(self) -> None:
        _check_single("Slew", "initial", self.initial)
        _check_single("Slew", "final", self.final)
        _check_span("Slew", self.start_s, self.end_s)

    @property
    def turn_rad(self) -> FloatArray:
        """Rotation vector (3,) of the whole turn, in body axes [rad]: axis of the rate times the angle."""
        return np.asarray(-(self.final * self.initial.inv()).as_rotvec())

    def attitude(self, time_s: ArrayLike) -> Rotation:
        s = (_times(self, time_s) - self.start_s) / (self.end_s - self.start_s)
        part = s**3 * (10.0 - 15.0 * s + 6.0 * s * s)
        return Rotation.from_rotvec(-part[..., None] * self.turn_rad) * self.initial

    def rate(self, time_s: ArrayLike) -> FloatArray:
        duration = self.end_s - self.start_s
        s = (_times(self, time_s) - self.start_s) / duration
        return np.asarray((30.0 * s**2 * (1.0 - s) ** 2 / duration)[..., None] * self.turn_rad)


@dataclass(frozen=True, slots=True, kw_only=True)
class TurningAxis:
    """A body whose rate keeps its size while its direction goes round the body's z axis.

    The rate is speed (cos b cos wt, cos b sin wt, sin b). In axes that go round with it the rate is constant, so that
    with w0 = speed (cos b, 0, sin b) the attitude is exactly R(t) = exp([z]w t) exp(-[w0 + w z]t) R(0).
    """

    initial: Rotation  # Body from reference at time 0
    speed_rad_per_s: float  # Size of the rate
    turns_rad_per_s: float  # w: how fast the axis goes round; 0 for a fixed axis
    end_s: float  # Last time

    def __post_init__(self) -> None:
        _check_single("TurningAxis", "initial", self.initial)
        _check_span("TurningAxis", 0.0, self.end_s)

    @property
    def start_s(self) -> float:
        return 0.0

    @property
    def _fixed(self) -> FloatArray:
        return self.speed_rad_per_s * np.array([np.cos(TURNING_TILT), 0.0, np.sin(TURNING_TILT)])

    def attitude(self, time_s: ArrayLike) -> Rotation:
        time = _times(self, time_s)[..., None]
        z = np.array([0.0, 0.0, self.turns_rad_per_s])
        return Rotation.from_rotvec(z * time) * Rotation.from_rotvec(-(self._fixed + z) * time) * self.initial

    def rate(self, time_s: ArrayLike) -> FloatArray:
        time = _times(self, time_s)[..., None]
        z = np.array([0.0, 0.0, self.turns_rad_per_s])
        return np.asarray(Rotation.from_rotvec(z * time).apply(self._fixed))


@dataclass(frozen=True, slots=True, kw_only=True)
class Mounted:
    """The motion of an object fixed to a moving body, e.g. a camera; see `mounted`."""

    body: Trajectory  # Motion of the body
    mount: Rotation  # The object's axes from the body's axes: ``v_object = R v_body``

    def __post_init__(self) -> None:
        _check_single("Mounted", "mount", self.mount)

    @property
    def start_s(self) -> float:
        return self.body.start_s

    @property
    def end_s(self) -> float:
        return self.body.end_s

    def attitude(self, time_s: ArrayLike) -> Rotation:
        return self.mount * self.body.attitude(time_s)

    def rate(self, time_s: ArrayLike) -> FloatArray:
        return np.asarray(self.mount.apply(self.body.rate(time_s)))


def mounted(body: Trajectory, mount: Rotation) -> Mounted:
    """Trajectory of an object fixed to a body, with ``v_object = mount v_body``: ``mounted(body, cam_from_body)``."""
    return Mounted(body=body, mount=mount)


def trail_of_rate(rate_rad_per_s: ArrayLike) -> tuple[float, float]:
    """Rate across the line of sight [deg/s]; direction in which stars trail [deg], from column towards row."""
    x, y, _ = np.asarray(rate_rad_per_s, float)
    return float(np.degrees(np.hypot(x, y))), float(np.degrees(np.arctan2(x, -y))) if x or y else 0.0


def rate_of_trail(rate_deg_per_s: float, direction_deg: float) -> FloatArray:
    """Angular velocity (3,) in cam [rad/s] for which stars trail at a rate in a direction; inverts `trail_of_rate`."""
    towards = np.radians(direction_deg)
    return np.asarray(np.radians(rate_deg_per_s) * np.array([np.sin(towards), -np.cos(towards), 0.0]))


def swept_rotation(trajectory: Trajectory, time_s: FloatArray, substeps: int = 20) -> FloatArray:
    """Integral over time of the rotation (3, 3) from the body at t to the body at the first time, up to n times [s].

    What a constant bias of a gyro adds to the attitude in axes of the first body. Simpson's rule between the times,
    which are equally spaced.

    Shapes: ``time_s`` (n,), returns (n, 3, 3).
    """
    fine = np.linspace(time_s[0], time_s[-1], 2 * substeps * (len(time_s) - 1) + 1)
    turned = (trajectory.attitude(time_s[0]) * trajectory.attitude(fine).inv()).as_matrix()
    step = fine[1] - fine[0]
    pieces = step / 3.0 * (turned[:-1:2] + 4.0 * turned[1::2] + turned[2::2])
    sums = np.concatenate([np.zeros((1, 3, 3)), np.cumsum(pieces, axis=0)])
    return np.asarray(sums[::substeps])


def precession(
    initial: Rotation,
    *,
    rate_rad_per_s: float,
    tilt_rad: float,
    turn_rad: float,
    end_s: float,
    steps: int,
    knot_every: int = 1,
) -> SampledAttitude:
    """A turn at constant speed about an axis that itself turns about the body's z axis, from time 0 to ``end_s``.

    The sign of the rate is that of a turn of what the body sees; the axis, at an angle ``tilt_rad`` from z, turns by
    ``turn_rad`` about z. ``knot_every``: integration steps from knot to knot of the spline that is returned.
    """
    part = (np.arange(steps) + 0.5) / steps
    sine = np.sin(tilt_rad)
    axis = np.column_stack(
        [-sine * np.sin(turn_rad * part), sine * np.cos(turn_rad * part), np.full(steps, np.cos(tilt_rad))]
    )
    attitudes = [initial]
    for increment in Rotation.from_rotvec(-axis * (rate_rad_per_s * end_s / steps)):
        attitudes.append(increment * attitudes[-1])
    knots = slice(None, None, knot_every)
    return SampledAttitude(
        samples_s=np.linspace(0.0, end_s, steps + 1)[knots], attitudes=Rotation.concatenate(attitudes)[knots]
    )
