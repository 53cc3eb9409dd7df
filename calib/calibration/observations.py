"""Input of a calibration: measured star positions with their directions, frame by frame."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from optics.arrays import FloatArray, IntArray
from optics.errors import DomainError
from optics.records import freeze, freeze_all, locked

NORM_TOLERANCE = 1e-6
"""Largest deviation of a direction's length from 1: wide enough for unit vectors that went through float32 (6e-8)."""


def _unset() -> IntArray:
    return np.empty(0, dtype=np.int64)


@dataclass(frozen=True, slots=True, kw_only=True)
class Observations:
    """Stars of one or more frames: measured position and catalogue direction.

    Attributes
    ----------
    pixel_px : (n, 2)
        Measured (column, row), an integer is a pixel centre.
    covariance_px2 : (n, 2, 2)
        Covariance of each measurement, symmetric and positive definite.
    direction : (n, 3)
        Unit vectors towards the stars in the reference frame (``icrs`` or the laboratory). Lengths off by less than
        1e-6 (single precision) are brought to 1, anything else is refused.
    frame : (n,) int64
        Frame in which each star was measured, 0 .. frames - 1; in any order.
    frames : int
        Number of frames, those without a star included.
    band : (n,) int64
        Band of each measurement; 0 if left out.
    star : (n,) int64
        Row of the star in a catalogue, -1 where unknown; -1 if left out.

    Raises
    ------
    DomainError
        On NaN, wrong shapes, directions that are not unit vectors (angles in degrees or hours handed as vectors),
        covariances that are not positive definite, frames or bands out of range.
    """

    pixel_px: FloatArray
    covariance_px2: FloatArray
    direction: FloatArray
    frame: IntArray
    frames: int
    band: IntArray = field(default_factory=_unset)
    star: IntArray = field(default_factory=_unset)

    def __post_init__(self) -> None:
        sizes: dict[str, int] = {}
        pixel = freeze(self, "pixel_px", shape=("n", 2), sizes=sizes)
        _refuse_angles(self.direction)
        freeze_all(self, direction=("n", 3), covariance_px2=("n", 2, 2), sizes=sizes)
        for name, value in (("band", 0), ("star", -1)):
            if np.size(getattr(self, name)) == 0:
                object.__setattr__(self, name, np.full(len(pixel), value, dtype=np.int64))
        for name in ("frame", "band", "star"):
            _refuse_fractions(name, getattr(self, name))
            freeze(self, name, shape=("n",), dtype=np.int64, sizes=sizes)
        object.__setattr__(self, "direction", locked(_unit(self.direction)))
        _check_covariance(self.covariance_px2)
        _check_indices(self)

    def __len__(self) -> int:
        return len(self.pixel_px)

    @classmethod
    def isotropic(
        cls,
        *,
        pixel_px: ArrayLike,
        direction: ArrayLike,
        frame: ArrayLike,
        sigma_px: ArrayLike,
        frames: int | None = None,
        band: ArrayLike | None = None,
        star: ArrayLike | None = None,
    ) -> Observations:
        """Observations with the same, uncorrelated standard deviation in x and y.

        Parameters
        ----------
        pixel_px, direction, frame, band, star
            As in the record.
        sigma_px : float or (n,)
            Standard deviation per axis [px], positive.
        frames : int, optional
            Number of frames; the last frame with a star plus one if left out.

        Raises
        ------
        DomainError
            On a standard deviation that is not positive and finite, and as the record does.
        """
        pixel = np.asarray(pixel_px, dtype=np.float64)
        count = len(np.atleast_1d(pixel))
        sigma = np.asarray(sigma_px, dtype=np.float64)
        if sigma.shape not in ((), (count,)):
            raise DomainError(f"Observations: sigma_px of shape {sigma.shape}; one number or one per star ({count},)")
        if not np.all((sigma > 0) & np.isfinite(sigma)):
            raise DomainError(f"Observations: sigma_px = {np.min(sigma)} px; it must be positive and finite")
        covariance = np.broadcast_to(sigma, (count,))[:, None, None] ** 2 * np.eye(2)
        number = np.asarray(frame)
        if frames is None:
            frames = int(np.max(number, initial=-1)) + 1
        optional = {k: v for k, v in (("band", band), ("star", star)) if v is not None}
        return cls(
            pixel_px=pixel,
            covariance_px2=covariance,
            direction=direction,  # type: ignore[arg-type]
            frame=number,
            frames=frames,
            **optional,  # type: ignore[arg-type]
        )

    def select(self, rows: Any) -> Observations:
        """The observations picked by an index array, a mask or a slice; frames keep their numbers.

        Raises
        ------
        DomainError
            On a mask of another length.
        """
        index = np.arange(len(self))
        picker = np.asarray(rows) if not isinstance(rows, slice) else rows
        if isinstance(picker, np.ndarray) and picker.dtype == np.bool_ and picker.shape != index.shape:
            raise DomainError(f"Observations.select: mask of shape {picker.shape} for {len(self)} observations")
        chosen = index[picker]
        return Observations(
            pixel_px=self.pixel_px[chosen],
            covariance_px2=self.covariance_px2[chosen],
            direction=self.direction[chosen],
            frame=self.frame[chosen],
            frames=self.frames,
            band=self.band[chosen],
            star=self.star[chosen],
        )


def _refuse_angles(direction: Any) -> None:
    """One clear line for the commonest mistake: right ascension and declination where vectors are needed."""
    if np.ndim(direction) == 2 and np.shape(direction)[1] == 2:
        raise DomainError(
            "Observations.direction: two columns; angles (right ascension, declination) must be turned into unit "
            "vectors first"
        )


def _unit(direction: FloatArray) -> FloatArray:
    """Directions of length 1, or the refusal of what is no unit vector."""
    length = np.linalg.norm(direction, axis=1)
    bad = np.abs(length - 1.0) > NORM_TOLERANCE
    if np.any(bad):
        first = int(np.argmax(bad))
        raise DomainError(
            f"Observations.direction: {int(bad.sum())} of {len(length)} rows are not unit vectors (row {first} has "
            f"length {length[first]:.6g}); angles in degrees or hours must be turned into unit vectors first"
        )
    off = np.abs(length - 1.0) > 1e-12
    return np.where(off[:, None], direction / length[:, None], direction)


def _refuse_fractions(name: str, values: Any) -> None:
    array = np.asarray(values)
    if array.dtype.kind in "iu":
        return
    if array.dtype.kind != "f" or not np.all(np.isfinite(array)) or np.any(array != np.round(array)):
        raise DomainError(f"Observations.{name}: whole numbers are needed")


def _check_covariance(covariance: FloatArray) -> None:
    a, b, c, d = (covariance[:, i, j] for i in range(2) for j in range(2))
    bad = ~((a > 0) & (d > 0) & (a * d - b * c > 0) & (np.abs(b - c) <= 1e-9 * np.sqrt(np.abs(a * d))))
    if np.any(bad):
        first = int(np.argmax(bad))
        raise DomainError(
            f"Observations.covariance_px2: row {first} is {covariance[first].tolist()} px^2; it must be symmetric and "
            "positive definite"
        )


def _check_indices(record: Observations) -> None:
    if isinstance(record.frames, bool) or not isinstance(record.frames, int | np.integer) or record.frames < 0:
        raise DomainError(f"Observations.frames = {record.frames!r}; a number of frames, 0 or more, is needed")
    object.__setattr__(record, "frames", int(record.frames))
    if len(record) == 0:
        return
    if record.frame.min() < 0 or record.frame.max() >= record.frames:
        raise DomainError(
            f"Observations.frame: values from {record.frame.min()} to {record.frame.max()}; with {record.frames} "
            f"frames they must lie in 0 .. {record.frames - 1}"
        )
    if record.band.min() < 0:
        raise DomainError(f"Observations.band: value {record.band.min()}; bands are counted from 0")
    if record.star.min() < -1:
        raise DomainError(f"Observations.star: value {record.star.min()}; rows are counted from 0, unknown is -1")
