"""A turntable of two or three axes: true axes, setting, readings.

Convention. At zero angles the frame of the table top and the laboratory frame agree ("initial table frame"). The outer
axis is fixed in the laboratory, each further axis is carried by the previous one; axis directions are those at zero
angles. Every angle follows the right-hand rule about its axis, and rotations act outermost last::

    v_lab = R(outer, angle_0) [R(middle, angle_1)] R(inner, angle_last) v_table

For outer X', inner Y' this is Rot(X', theta_1) Rot(Y', theta_2) of CUBE09 (eq. 5-8); with three axes it corresponds to
eq. 3.2 of FISHER23.

Non-orthogonality. Two neighbouring axes enclose 90 deg minus ``non_orthogonality``: the carried axis leans towards its
carrier. A lean in the other direction only shifts the zero of the carrier's angle, and is not a separate error.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from optics.arrays import FloatArray
from optics.errors import ConfigError, DomainError
from optics.records import freeze
from optics.units import ARCSEC_RAD, DEG_RAD
from render.engine.random import Streams

_LETTERS = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}
_NAMES = {2: ("outer", "inner"), 3: ("outer", "middle", "inner")}
_LARGEST_LEAN_ARCSEC = 36000.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Turntable:
    """A table of k = 2 or 3 axes, outermost first; the module states the convention, `build_turntable` makes one."""

    # (k, 3) Nominal axis directions in the laboratory at zero angles: unit vectors, neighbours at right angles
    axis: FloatArray
    non_orthogonality_arcsec: FloatArray  # By how much less than 90 deg each axis encloses with its carrier
    reading_noise_arcsec: FloatArray  # (k,) Standard deviation of a reading, each reading anew
    # (k,) Standard deviation of the true angle about the commanded one, each setting anew; it is no error of the
    # reading
    setting_noise_arcsec: FloatArray
    step_arcsec: FloatArray  # (k,) The table goes to whole multiples of this; 0: anywhere
    encoder_amplitude_arcsec: FloatArray  # (k,) Amplitude of a sinusoidal error of the reading over the angle
    encoder_cycles: FloatArray  # (k,) Its cycles per turn
    encoder_phase_deg: FloatArray  # (k,) Its phase at angle 0

    def __post_init__(self) -> None:
        sizes: dict[str, int] = {}
        axis = freeze(self, "axis", shape=("k", 3), sizes=sizes)
        if len(axis) not in _NAMES:
            raise DomainError(f"Turntable.axis: {len(axis)} axes; a table of 2 or 3 axes is needed")
        for name in self.__dataclass_fields__:
            if name not in ("axis", "non_orthogonality_arcsec"):
                freeze(self, name, shape=("k",), sizes=sizes)
        lean = freeze(self, "non_orthogonality_arcsec", shape=(len(axis) - 1,))
        if np.abs(lean).max() > _LARGEST_LEAN_ARCSEC:
            raise DomainError(
                f"Turntable.non_orthogonality_arcsec = {lean.tolist()}; at most {_LARGEST_LEAN_ARCSEC:g} arcsec is "
                "allowed"
            )
        self._check_axes()
        for name in ("reading_noise_arcsec", "setting_noise_arcsec", "step_arcsec"):
            value = getattr(self, name)
            if value.min() < 0:
                raise DomainError(f"Turntable.{name} = {value.tolist()} arcsec; it must not be negative")

    def _check_axes(self) -> None:
        for name, direction in zip(self.axis_names, self.axis, strict=True):
            length = float(np.linalg.norm(direction))
            if abs(length - 1.0) > 1e-9:
                raise DomainError(f"Turntable.axis, {name}: length {length:.12g}; unit vectors are needed")
        for i in range(len(self.axis) - 1):
            between = float(self.axis[i] @ self.axis[i + 1])
            if abs(between) > 1e-9:
                raise DomainError(
                    f"Turntable.axis: {self.axis_names[i]} and {self.axis_names[i + 1]} axis enclose "
                    f"{np.degrees(np.arccos(np.clip(between, -1.0, 1.0))):.6f} deg; nominal axes must be "
                    "orthogonal; deviations go into non_orthogonality_arcsec"
                )

    @property
    def axis_names(self) -> tuple[str, ...]:
        """Names of the axes, outermost first."""
        return _NAMES[len(self.axis)]

    @property
    def nominal(self) -> Turntable:
        """The same table with orthogonal axes, the user's assumption."""
        return replace(self, non_orthogonality_arcsec=np.zeros(len(self.axis) - 1))

    @property
    def true_axis(self) -> FloatArray:
        """Real axis directions (k, 3) in the laboratory at zero angles."""
        lean = self.non_orthogonality_arcsec[:, None] * ARCSEC_RAD
        directions = self.axis.copy()  # SciPy's rotations refuse write-locked arrays
        directions[1:] = Rotation.from_rotvec(self._pivots() * lean).apply(directions[1:])
        return directions

    def _pivots(self) -> FloatArray:
        """Unit vectors (k - 1, 3) about which a carried axis turns when it leans towards its carrier."""
        return np.cross(self.axis[1:], self.axis[:-1])

    def rotation(self, angle_rad: ArrayLike) -> Rotation:
        """Attitudes of the table top."""
        angle = self._angles(angle_rad)
        turn = Rotation.from_rotvec(angle[:, :1] * self.true_axis[0])
        for i in range(1, len(self.axis)):
            turn = turn * Rotation.from_rotvec(angle[:, i : i + 1] * self.true_axis[i])
        return turn

    def angle_rates(self, angle_rad: ArrayLike) -> FloatArray:
        """Rotation of the top per angle: rotation vector per radian, in the laboratory, (n, k, 3).

        The direction in which each axis points at these angles (the geometric Jacobian of a serial chain).
        """
        angle = self._angles(angle_rad)
        rates = np.empty((*angle.shape, 3))
        carrier = Rotation.identity(len(angle))
        for i, direction in enumerate(self.true_axis):
            rates[:, i] = carrier.apply(direction)
            carrier = carrier * Rotation.from_rotvec(angle[:, i : i + 1] * direction)
        return rates

    def lean_rates(self, angle_rad: ArrayLike) -> FloatArray:
        """Rotation of the top per non-orthogonality: laboratory rotation vector per radian, (n, k-1, 3).

        With the lean Q about the pivot p, the carried turn is Q R Q^T, whose derivative is the rotation vector
        p - R p at the carrier.
        """
        angle = self._angles(angle_rad)
        rates = np.empty((len(angle), len(self.axis) - 1, 3))
        carrier = Rotation.from_rotvec(angle[:, :1] * self.true_axis[0])
        for i, pivot in enumerate(self._pivots()):
            turn = Rotation.from_rotvec(angle[:, i + 1 : i + 2] * self.true_axis[i + 1])
            rates[:, i] = carrier.apply(pivot - turn.apply(pivot))
            carrier = carrier * turn
        return rates

    def set(self, commanded_rad: ArrayLike, streams: Streams, *, call: int = 0) -> FloatArray:
        """Go to angles."""
        angle = self._angles(commanded_rad)
        step = self.step_arcsec * ARCSEC_RAD
        reached = np.where(step > 0, np.rint(angle / np.where(step > 0, step, 1.0)) * step, angle)
        return np.asarray(reached + self._noise(len(angle), self.setting_noise_arcsec, streams, "setting", call))

    def read(self, true_rad: ArrayLike, streams: Streams, *, call: int = 0) -> FloatArray:
        """Read the encoders."""
        angle = self._angles(true_rad)
        wave = np.sin(self.encoder_cycles * angle + self.encoder_phase_deg * DEG_RAD)
        systematic = self.encoder_amplitude_arcsec * ARCSEC_RAD * wave
        return np.asarray(
            angle + systematic + self._noise(len(angle), self.reading_noise_arcsec, streams, "reading", call)
        )

    def _noise(self, count: int, sigma_arcsec: FloatArray, streams: Streams, name: str, call: int) -> FloatArray:
        columns = [
            sigma * ARCSEC_RAD * streams.child("turntable", name).generator(axis, call).standard_normal(count)
            for axis, sigma in zip(self.axis_names, sigma_arcsec, strict=True)
        ]
        return np.column_stack(columns)

    def _angles(self, values: ArrayLike) -> FloatArray:
        angle = np.asarray(values, dtype=np.float64)
        if angle.ndim != 2 or angle.shape[1] != len(self.axis):
            raise DomainError(
                f"angles of shape {angle.shape} for a table of {len(self.axis)} axes; (n, {len(self.axis)}) is needed"
            )
        if not np.all(np.isfinite(angle)):
            raise DomainError(f"angle at index {np.argwhere(~np.isfinite(angle))[0].tolist()} is not finite")
        return angle


def build_turntable(
    axes: str | ArrayLike,
    *,
    non_orthogonality_arcsec: float | Sequence[float] = 0.0,
    reading_noise_arcsec: float | Sequence[float] = 0.0,
    setting_noise_arcsec: float | Sequence[float] = 0.0,
    step_arcsec: float | Sequence[float] = 0.0,
    encoder_amplitude_arcsec: float | Sequence[float] = 0.0,
    encoder_cycles: float | Sequence[float] = 1.0,
    encoder_phase_deg: float | Sequence[float] = 0.0,
) -> Turntable:
    """A table from letters; one value stands for all axes.

    Examples
    --------
    >>> table = build_turntable("xy", reading_noise_arcsec=(0.3, 0.4))
    >>> table.rotation([[0.5, 0.0]]).apply([0.0, 1.0, 0.0]).round(6).tolist()
    [[0.0, 0.877583, 0.479426]]
    """
    axis = axis_directions(axes) if isinstance(axes, str) else np.asarray(axes, dtype=np.float64)
    count = len(axis)

    def spread(values: float | Sequence[float], size: int = count) -> FloatArray:
        array = np.asarray(values, dtype=np.float64)
        return np.full(size, float(array)) if array.ndim == 0 else array

    return Turntable(
        axis=axis,
        non_orthogonality_arcsec=spread(non_orthogonality_arcsec, max(count - 1, 1)),
        reading_noise_arcsec=spread(reading_noise_arcsec),
        setting_noise_arcsec=spread(setting_noise_arcsec),
        step_arcsec=spread(step_arcsec),
        encoder_amplitude_arcsec=spread(encoder_amplitude_arcsec),
        encoder_cycles=spread(encoder_cycles),
        encoder_phase_deg=spread(encoder_phase_deg),
    )


def axis_directions(letters: str) -> FloatArray:
    """Unit vectors (k, 3) of a string like "y-x" or "zxy"."""
    directions: list[FloatArray] = []
    sign = 1.0
    for letter in letters.lower():
        if letter == "-" and sign > 0:
            sign = -1.0
        elif letter in _LETTERS:
            directions.append(sign * np.array(_LETTERS[letter]))
            sign = 1.0
        else:
            sign = 0.0
            break
    if sign != 1.0 or not directions:
        raise ConfigError(
            f"turntable axes {letters!r}; letters x, y, z are needed, outermost first, like 'yx' or 'z-xy'"
        )
    return np.array(directions)
