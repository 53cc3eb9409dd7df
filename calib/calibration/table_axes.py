"""Axes of a turntable of two or three axes: its attitude at angles, and how that changes with angles and axes.

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

from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from optics.arrays import FloatArray
from optics.errors import ConfigError, DomainError
from optics.records import freeze
from optics.units import ARCSEC_RAD

_LETTERS = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}
_NAMES = {2: ("outer", "inner"), 3: ("outer", "middle", "inner")}
_LARGEST_LEAN_ARCSEC = 36000.0


@dataclass(frozen=True, slots=True, kw_only=True)
class TableAxes:
    """k = 2 or 3 axes of a turntable, outermost first, as a reduction knows them.

    Attributes
    ----------
    axis : (k, 3)
        Nominal directions in the laboratory at zero angles: unit vectors, neighbours at right angles.
    non_orthogonality_arcsec : (k - 1,)
        By how much less than 90 deg each axis encloses with its carrier.
    reading_noise_arcsec : (k,)
        Standard deviation of a reading.
    """

    axis: FloatArray
    non_orthogonality_arcsec: FloatArray
    reading_noise_arcsec: FloatArray

    @classmethod
    def create(
        cls, axes: str, *, non_orthogonality_arcsec: ArrayLike = 0.0, reading_noise_arcsec: ArrayLike = 0.0
    ) -> TableAxes:
        """Axes from letters as of `axis_directions`; one value stands for all axes."""
        axis = axis_directions(axes)
        lean, noise = (np.ravel(np.asarray(v, float)) for v in (non_orthogonality_arcsec, reading_noise_arcsec))
        lean = np.repeat(lean, len(axis) - 1) if len(lean) == 1 else lean
        noise = np.repeat(noise, len(axis)) if len(noise) == 1 else noise
        return TableAxes(axis=axis, non_orthogonality_arcsec=lean, reading_noise_arcsec=noise)

    def __post_init__(self) -> None:
        name = type(self).__name__
        axis = freeze(self, "axis", shape=("k", 3))
        if len(axis) not in _NAMES:
            raise DomainError(f"{name}.axis: {len(axis)} axes; a table of 2 or 3 axes is needed")
        noise = freeze(self, "reading_noise_arcsec", shape=(len(axis),))
        lean = freeze(self, "non_orthogonality_arcsec", shape=(len(axis) - 1,))
        if np.abs(lean).max() > _LARGEST_LEAN_ARCSEC:
            raise DomainError(
                f"{name}.non_orthogonality_arcsec = {lean.tolist()}; at most {_LARGEST_LEAN_ARCSEC:g} arcsec is allowed"
            )
        self._check_axes()
        if noise.min() < 0:
            raise DomainError(f"{name}.reading_noise_arcsec = {noise.tolist()} arcsec; it must not be negative")

    def _check_axes(self) -> None:
        for name, direction in zip(self.axis_names, self.axis, strict=True):
            length = float(np.linalg.norm(direction))
            if abs(length - 1.0) > 1e-9:
                raise DomainError(f"{type(self).__name__}.axis, {name}: length {length:.12g}; unit vectors are needed")
        for i in range(len(self.axis) - 1):
            between = float(self.axis[i] @ self.axis[i + 1])
            if abs(between) > 1e-9:
                raise DomainError(
                    f"{type(self).__name__}.axis: {self.axis_names[i]} and {self.axis_names[i + 1]} axis enclose "
                    f"{np.degrees(np.arccos(np.clip(between, -1.0, 1.0))):.6f} deg; nominal axes must be "
                    "orthogonal; deviations go into non_orthogonality_arcsec"
                )

    @property
    def axis_names(self) -> tuple[str, ...]:
        """Names of the axes, outermost first."""
        return _NAMES[len(self.axis)]

    @property
    def nominal(self) -> Self:
        """The same table with orthogonal axes, the user's assumption."""
        return replace(self, non_orthogonality_arcsec=np.zeros(len(self.axis) - 1))

    @property
    def true_axis(self) -> FloatArray:
        """Real axis directions (k, 3) in the laboratory at zero angles."""
        lean = self.non_orthogonality_arcsec[:, None] * ARCSEC_RAD
        directions = self.axis.copy()  # SciPy's rotations refuse write-locked arrays
        directions[1:] = Rotation.from_rotvec(self._pivots() * lean).apply(directions[1:])
        return directions

    def averaged(self, readings: int) -> Self:
        """The axes for the mean of several readings, whose random errors average out."""
        return replace(self, reading_noise_arcsec=self.reading_noise_arcsec / np.sqrt(readings))

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

    def _angles(self, values: ArrayLike) -> FloatArray:
        angle = np.asarray(values, dtype=np.float64)
        if angle.ndim != 2 or angle.shape[1] != len(self.axis):
            raise DomainError(
                f"angles of shape {angle.shape} for a table of {len(self.axis)} axes; (n, {len(self.axis)}) is needed"
            )
        if not np.all(np.isfinite(angle)):
            raise DomainError(f"angle at index {np.argwhere(~np.isfinite(angle))[0].tolist()} is not finite")
        return angle


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
