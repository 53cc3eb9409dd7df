"""Attitudes of the frames: lists and motions from files."""

from __future__ import annotations

import hashlib
import os
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from optics.arrays import FloatArray
from optics.attitude import attitude_from_angles
from optics.errors import ConfigError, DomainError

__all__ = ["file_digest", "read_attitudes", "read_motion"]


NORM_TOLERANCE = 1e-6
"""A quaternion written with seven digits is this near to unit length; farther off it is something else."""
_FEWEST_TO_JUDGE = 20
_QUATERNION = ("quat_x", "quat_y", "quat_z", "quat_w")


def file_digest(name: str | Path) -> str:
    """SHA-256 of a file that frames depend on."""
    try:
        return hashlib.sha256(Path(name).read_bytes()).hexdigest()
    except OSError as error:
        raise ConfigError(f"{name}: cannot be read ({error.strerror})") from None


def read_attitudes(name: str, key: str) -> Rotation:
    """Attitudes of a file, cam from icrs."""
    return _attitudes(_table(name, key), name)


def read_motion(name: str, key: str) -> tuple[FloatArray, Rotation]:
    """Times [s] and attitudes of a file with a column ``time_s``; errors as `read_attitudes`."""
    table = _table(name, key)
    time_s = _column(table, "time_s", "s", name)
    late = np.flatnonzero(np.diff(time_s) <= 0)
    if len(late):
        row = int(late[0]) + 1
        raise DomainError(f"{name}: time_s of row {row} is {time_s[row]:g} s, not later than the row before")
    return time_s, _attitudes(table, name)


def _table(name: str, key: str) -> Any:
    from astropy.table import Table

    if not name:
        raise ConfigError(f"{key} is empty; name a CSV or ECSV file with attitudes")
    path = Path(name)
    if not os.path.isfile(path):
        raise ConfigError(f"{key}: {name}: no such file")
    if path.suffix.lower() not in (".csv", ".ecsv"):
        raise ConfigError(f"{key}: {name}: a file .csv or .ecsv is needed")
    try:
        table = Table.read(path, format="ascii.ecsv" if path.suffix.lower() == ".ecsv" else "ascii.csv")
    except Exception as error:  # astropy raises what its readers happen to raise
        raise ConfigError(f"{key}: {name} cannot be read: {' '.join(str(error).split())[:200]}") from None
    if not len(table):
        raise ConfigError(f"{key}: {name} holds no rows")
    return table


def _attitudes(table: Any, name: str) -> Rotation:
    if all(column in table.colnames for column in _QUATERNION):
        return _from_quaternions(table, name)
    found = [next((c for c in (f"{a}_deg", a) if c in table.colnames), None) for a in ("ra", "dec", "roll")]
    if None in found:
        raise ConfigError(
            f"{name}: columns {', '.join(table.colnames)}; ra_deg, dec_deg, roll_deg or {', '.join(_QUATERNION)} needed"
        )
    ra, dec, roll = (_column(table, str(column), "deg", name) for column in found)
    stated = any(table[column].unit is not None or str(column).endswith("_deg") for column in found)
    if not stated and len(ra) >= _FEWEST_TO_JUDGE and max(np.ptp(ra), 2 * np.abs(dec).max()) <= 2 * np.pi:
        raise DomainError(f"{name}: no angle is above 2 pi; are they radians? State the unit or name the columns _deg")
    beyond = np.flatnonzero(np.abs(dec) > 90.0)
    if len(beyond):
        raise DomainError(f"{name}: declination of row {beyond[0]} is {dec[beyond[0]]:g} deg; -90 to 90 deg is allowed")
    for label, angle in (("right ascension", ra), ("roll", roll)):
        beyond = np.flatnonzero(np.abs(angle) > 360.0)
        if len(beyond):
            raise DomainError(
                f"{name}: {label} of row {beyond[0]} is {angle[beyond[0]]:g} deg; -360 to 360 deg is allowed"
            )
    return attitude_from_angles(ra, dec, roll)


def _from_quaternions(table: Any, name: str) -> Rotation:
    quaternion = np.stack([_column(table, column, "", name) for column in _QUATERNION], axis=1)
    length = np.linalg.norm(quaternion, axis=1)
    worst = int(np.argmax(np.abs(length - 1.0)))
    if abs(length[worst] - 1.0) > NORM_TOLERANCE:
        raise DomainError(
            f"{name}: the quaternion of row {worst} has length {length[worst]:.9g}; an attitude must be normalised "
            f"(1 within {NORM_TOLERANCE:g})"
        )
    return Rotation.from_quat(quaternion)


def _column(table: Any, column: str, unit: str, name: str) -> FloatArray:
    """Values of a column in a unit; those without a unit are taken to be in it."""
    from astropy import units

    if column not in table.colnames:
        raise ConfigError(f"{name}: column {column} is missing; it has {', '.join(table.colnames)}")
    try:
        held = table[column]
        factor = 1.0 if held.unit is None else units.Unit(held.unit).to(units.Unit(unit))
        values = np.ma.filled(np.ma.asarray(held, float), np.nan) * factor
    except units.UnitConversionError:
        wanted = unit or "none"
        raise ConfigError(f"{name}: column {column} is in {table[column].unit}; its unit must be {wanted}") from None
    except (TypeError, ValueError):
        raise ConfigError(f"{name}: column {column} holds something that is no number") from None
    if not np.isfinite(values).all():
        raise DomainError(f"{name}: {column} of row {int(np.argmin(np.isfinite(values)))} is missing or not finite")
    return np.asarray(values, np.float64)
