"""Filter curves from CSV files of filter makers and spectrophotometers."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from optics.arrays import FloatArray
from optics.errors import ConfigError, DomainError
from optics.light.band import TabulatedBand
from optics.response import check_table
from optics.textfile import read_text, two_columns

BLOCKED_FRACTION = 1e-3
"""Of the peak: tails below it are left out; the curve of a blocked filter would transmit at all wavelengths."""
NOISE_FRACTION = 0.005
"""Readings down to minus this are the noise of a spectrophotometer at zero."""
_COLUMNS = {
    "transmission": 1.0,
    "transmission_percent": 0.01,
    "quantum_efficiency": 1.0,
    "quantum_efficiency_percent": 0.01,
}


def load_band(path: str | Path, name: str = "") -> TabulatedBand:
    """Read a filter curve.

    The first two columns are wavelength [nm], up or down, and transmission as a fraction, separated by commas,
    semicolons, tabs or blanks; lines that begin with ``#`` are left out. The header may be missing. A second column
    named ``transmission_percent`` is converted (of a detector: ``quantum_efficiency_percent``).
    """
    shown = Path(path).name
    table, scale = _table(read_text(path, "a table of wavelengths and values").lines, shown)
    wave, value = table[:, 0], table[:, 1] * scale
    if len(wave) > 1 and wave[0] > wave[-1]:
        wave, value = wave[::-1], value[::-1]
    if wave.max() < 100.0:
        raise DomainError(
            f"{shown}: wavelengths up to {wave.max():g}: nanometres are needed; the values seem to be in another unit"
        )
    if scale == 1.0 and value.max() > 1.0:
        raise DomainError(
            f"{shown}: transmissions up to {value.max():g}: fractions of 1 are needed; if these are percent, call the "
            "column transmission_percent"
        )
    value = np.where((value < 0.0) & (value >= -NOISE_FRACTION), 0.0, value)
    check_table(wave, value, shown, upper=1.0)
    lit = np.flatnonzero(value >= BLOCKED_FRACTION * value.max())
    inside = (np.arange(len(wave)) >= lit[0]) & (np.arange(len(wave)) <= lit[-1])
    value = np.where(inside, value, 0.0)
    part = slice(max(int(lit[0]) - 1, 0), int(lit[-1]) + 2)
    return TabulatedBand(name=name or Path(path).stem, source=shown, wavelength_nm=wave[part], value=value[part])


def _table(lines: Sequence[str], shown: str) -> tuple[FloatArray, float]:
    """Rows (n, 2), and the factor of the second column."""
    head, rows = two_columns(lines, shown, "a wavelength and a value")
    scales = [_scale(cells, f"{shown}, line {number}") for number, cells in head]
    if len(rows) < 2:
        raise ConfigError(f"{shown}: {len(rows)} rows of a wavelength and a value; at least two are needed")
    return np.array(rows), scales[-1] if scales else 1.0


def _scale(cells: list[str], where: str) -> float:
    """Factor of the second column by its header; percent has to be named."""
    words = [cell.strip("\"'").lower() for cell in cells]
    if len(words) > 1 and words[1] in _COLUMNS:
        return _COLUMNS[words[1]]
    if any("%" in word or "percent" in word for word in words):
        raise ConfigError(f"{where}: write the header as wavelength_nm, transmission_percent if the values are percent")
    return 1.0
