"""Point-source transmittance (PST): a table of stray light by cause against the angle of the source, with file format.

PST is the mean irradiance on the detector over the irradiance of the source through a plane normal to its light; the
direct image of the source is excluded.
"""

from __future__ import annotations

import io
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from optics.arrays import FloatArray
from optics.errors import ConfigError, DomainError
from optics.frames import polar_direction
from optics.interpolation import bilinear
from optics.records import freeze

FLOOR = 1e-30
"""Value in place of zero light where logarithms are taken."""
FINE = 4000
"""Angles of the grid on which a value is searched."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PointSourceTransmittance:
    """Stray light against the angle between a source and the boresight.

    Both axes of the detector are taken as mirrors: a source at any azimuth has that of its quadrant; beyond the first
    or last the values there hold.
    """

    angle_deg: FloatArray  # (a,) Increasing, above 0 to 90
    azimuth_deg: FloatArray  # (z,) Increasing, 0 ... 90, from columns towards rows
    causes: tuple[str, ...]  # Names of the c parts
    value: FloatArray  # (c, z, a) PST of each part
    error: FloatArray  # (c, z, a) Standard errors, independent of each other
    source: str = ""  # Origin of the table

    def __post_init__(self) -> None:
        sizes = {"c": len(self.causes)}
        angle = freeze(self, "angle_deg", shape=("a",), sizes=sizes)
        azimuth = freeze(self, "azimuth_deg", shape=("z",), sizes=sizes)
        for name, grid, low in (("angle", angle, 0.0), ("azimuth", azimuth, -1e-12)):
            if not len(grid) or grid[0] <= low or grid[-1] > 90.0 or (np.diff(grid) <= 0.0).any():
                raise DomainError(f"PST: {name}s must increase within 0 ... 90 deg; they are {grid.tolist()}")
        for name in ("value", "error"):
            table = freeze(self, name, shape=("c", "z", "a"), sizes=sizes)
            if (table < 0.0).any():
                raise DomainError(f"PST: {name} of {table.min():g}; it must not be negative")

    def only(self, cause: str) -> PointSourceTransmittance:
        """The table of one cause."""
        row = [self.causes.index(cause)]
        return replace(self, causes=(cause,), value=self.value[row], error=self.error[row])

    @property
    def total(self) -> FloatArray:
        """Sum of all causes (z, a)."""
        return np.asarray(self.value.sum(axis=0))

    @property
    def total_error(self) -> FloatArray:
        """Standard error of the sum (z, a)."""
        return np.asarray(np.sqrt((self.error**2).sum(axis=0)))

    def at(self, v_cam: ArrayLike) -> FloatArray:
        """Total for sources at unit vectors (..., 3) in cam.

        In the logarithm, linear in the logarithm of the angle and in the azimuth; nearer than the first angle its value
        holds, behind the camera there is none.
        """
        v = np.asarray(v_cam, dtype=np.float64)
        angle = np.degrees(np.arctan2(np.hypot(v[..., 0], v[..., 1]), v[..., 2]))
        azimuth = np.degrees(np.arctan2(np.abs(v[..., 1]), np.abs(v[..., 0])))
        knots = self.azimuth_deg, np.log(self.angle_deg)
        position = azimuth, np.log(np.maximum(angle, self.angle_deg[0]))
        value = np.exp(bilinear(np.log(np.maximum(self.total, FLOOR)), knots, position))
        return np.where((angle > 90.0) | (value <= 2.0 * FLOOR), 0.0, value)

    def last_angle_deg(self, value: ArrayLike) -> FloatArray:
        """Largest angles (...,) at which the total of the first azimuth reaches values (...,); 0: nowhere."""
        angle, largest = self._beyond()
        count = (largest >= np.asarray(value, float)[..., None]).sum(axis=-1)
        return np.where(count > 0, angle[count - 1], 0.0)

    def angles_by_value(self, count: int, least: float, most: float) -> list[float]:
        """Angles [deg] at which the total falls by even factors from ``most`` to ``least``, and the last angle."""
        _, largest = self._beyond()
        low, high = max(least, float(largest[-1]) * 1.01), max(min(most, float(largest[0])), 1.5 * least)
        angles = self.last_angle_deg(np.geomspace(low, high, count - 1))
        return sorted({*angles[angles > 0.0].tolist(), float(self.angle_deg[-1])})

    def _beyond(self) -> tuple[FloatArray, FloatArray]:
        """A fine grid of angles at the first azimuth, and the largest total at each of them or beyond it."""
        angle = np.geomspace(self.angle_deg[0], self.angle_deg[-1], FINE)
        total = self.at(polar_direction(angle, self.azimuth_deg[0]))
        return angle, np.maximum.accumulate(total[::-1])[::-1]


def write_pst(path: str | Path, pst: PointSourceTransmittance) -> Path:
    """Write a table as ECSV (suffix ``.ecsv``) or CSV: ``angle_deg``, ``azimuth_deg``, each cause and its error."""
    lines = []
    if Path(path).suffix == ".ecsv":
        names = [f"{cause}{end}" for cause in pst.causes for end in ("", "_error")]
        lines = ["# %ECSV 1.0", "# ---", "# datatype:"]
        lines += [f"# - {{name: {name}, unit: deg, datatype: float64}}" for name in ("angle_deg", "azimuth_deg")]
        lines += [f"# - {{name: {name}, datatype: float64}}" for name in names]
        lines += ["# delimiter: ','", f"# meta: {{source: '{pst.source.replace(chr(39), chr(39) * 2)}'}}"]
        lines += ["# schema: astropy-2.0"]
    heads = [name for cause in pst.causes for name in (cause, f"{cause}_error")]
    lines.append(",".join(["angle_deg", "azimuth_deg", *heads]))
    for z, azimuth in enumerate(pst.azimuth_deg):
        for a, angle in enumerate(pst.angle_deg):
            cells = np.stack([pst.value[:, z, a], pst.error[:, z, a]], axis=-1).ravel()
            lines.append(",".join(repr(float(v)) for v in (angle, azimuth, *cells)))
    Path(path).write_text("\n".join(lines) + "\n", encoding="utf-8")
    return Path(path)


def read_pst(path: str | Path) -> PointSourceTransmittance:
    """Read a table of `write_pst`, or one of the user.

    CSV or ECSV with the columns ``angle_deg`` and one per cause (``pst`` will do), each with ``NAME_error`` if known;
    ``azimuth_deg`` may be left out. Every azimuth has the same angles. ``total`` in addition to others is not read.
    `ConfigError`: no such file, columns that are missing or hold no numbers, a grid that is not full; `DomainError` as
    `PointSourceTransmittance`.
    """
    try:
        text = Path(path).read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"{path}: cannot be read as a table of PST ({error})") from None
    plain = "\n".join(line for line in text.splitlines() if line.strip() and not line.startswith("#"))
    head, _, body = plain.partition("\n")
    delimiter = "," if "," in head else None
    names = [name.strip().strip('"') for name in head.split(delimiter)]
    try:
        table = np.loadtxt(io.StringIO(body), delimiter=delimiter, ndmin=2)
    except ValueError as error:
        raise ConfigError(f"{path}: not a table of numbers ({error})") from None
    if "angle_deg" not in names or table.shape[1:] != (len(names),) or not len(table):
        raise ConfigError(f"{path}: a PST table needs a header with angle_deg, and as many numbers in every row")
    columns = dict(zip(names, table.T, strict=True))
    parts = [n for n in names if n not in ("angle_deg", "azimuth_deg") and not n.endswith("_error")]
    causes = [name for name in parts if name != "total"] or parts
    if not causes:
        raise ConfigError(f"{path}: there is no PST column; at least one besides the angles is needed")
    azimuth = columns.get("azimuth_deg", np.zeros(len(table)))
    angles, azimuths = np.unique(columns["angle_deg"]), np.unique(azimuth)
    order = np.lexsort((columns["angle_deg"], azimuth))
    full = len(order) == len(angles) * len(azimuths)
    if not full or not np.array_equal(columns["angle_deg"][order], np.tile(angles, len(azimuths))):
        raise ConfigError(f"{path}: every azimuth needs the same angles, each once")
    shape = (len(azimuths), len(angles))
    zero = np.zeros(len(table))
    return PointSourceTransmittance(
        angle_deg=angles,
        azimuth_deg=azimuths,
        causes=tuple(causes),
        value=np.stack([columns[cause][order].reshape(shape) for cause in causes]),
        error=np.stack([columns.get(f"{cause}_error", zero)[order].reshape(shape) for cause in causes]),
        source=str(path),
    )
