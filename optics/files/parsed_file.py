"""Contents of a lens file in millimetres and in the terms of our prescription, before glasses and stop are assigned."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from optics.errors import ConfigError
from optics.files.report import ReportBuilder
from optics.glass.catalogue import Glass

LARGEST = 1e15
"""Numbers above stand for infinity."""
FAR_MM = 1e9
"""An object at this distance or further is at infinity."""


@dataclass(slots=True)
class GlassName:
    """A glass as a file names it; ``nd`` and ``vd`` if it states them too."""

    name: str
    line: int
    command: str
    nd: float | None = None
    vd: float | None = None
    partial: float = 0.0
    model: bool = False
    catalogue: str = ""
    offset: tuple[float, float] = (0.0, 0.0)


@dataclass(slots=True)
class SurfaceRow:
    """A surface, or a coordinate break.

    ``shape`` and ``moved`` are keys of a surface table (`optics.lens.tables`); ``clear_mm`` is a clear aperture,
    ``drawn_mm`` the semi-diameter that the program found for its drawing.
    """

    number: int
    line: int
    shape: dict[str, Any] = field(default_factory=lambda: {"kind": "sphere", "radius_mm": math.inf})
    thickness_mm: float = 0.0
    glass: GlassName | None = None
    mirror: bool = False
    stop: bool = False
    clear_mm: float | None = None
    inner_mm: float = 0.0
    drawn_mm: float | None = None
    apertures: list[dict[str, Any]] = field(default_factory=list)
    moved: dict[str, Any] = field(default_factory=dict)
    comment: str = ""
    coating: str = ""

    @property
    def is_break(self) -> bool:
        """Whether it only moves the frame."""
        return bool(self.shape.get("kind") == "coordinate_break")


@dataclass(slots=True)
class StatedAperture:
    """How the file states the aperture: ``EPD`` [mm], ``FNO``, ``NAO`` (object side), ``NA`` (image side), ``STOP``."""

    kind: str
    value: float
    line: int


@dataclass(slots=True)
class StatedField:
    """A field point in the unit of the file's field type, its weight and vignetting factors (dx, dy, cx, cy, angle)."""

    x: float = 0.0
    y: float = 0.0
    weight: float = 1.0
    vignetting: tuple[float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0)


@dataclass(slots=True)
class ParsedFile:
    """All contents of a file.

    ``rows`` are the surfaces between object and image; ``image`` the last row. ``field_kind`` is one of ``angle``
    [deg], ``object`` [mm], ``paraxial_image`` [mm], ``real_image`` [mm].
    """

    path: Path
    report: ReportBuilder
    unit_mm: float = 1.0
    name: str = ""
    notes: list[str] = field(default_factory=list)
    wavelengths: list[tuple[float, float]] = field(default_factory=list)
    primary: int = 0
    field_kind: str = "angle"
    fields: list[StatedField] = field(default_factory=list)
    fields_line: int = 0
    aperture: StatedAperture | None = None
    temperature_c: float = 20.0
    pressure_hpa: float = 1013.25
    adjusted: bool = False
    catalogues: list[str] = field(default_factory=list)
    private: dict[str, Glass] = field(default_factory=dict)
    coatings: dict[str, dict[str, Any]] = field(default_factory=dict)
    rows: list[SurfaceRow] = field(default_factory=list)
    object_mm: float = math.inf
    image: SurfaceRow | None = None
    stated: dict[str, tuple[float, str]] = field(default_factory=dict)
    configurations: int = 1
    configuration: int = 1

    def fail(self, line: int, message: str) -> ConfigError:
        """An error at a line of the file, to be raised."""
        return ConfigError(f"{self.report.file}: line {line}: {message}")


def number(words: list[str], at: int, default: float | None = None, *, what: str = "a number") -> float:
    """A number of a command; Fortran exponents and INFINITY are read as design programs write them."""
    if at >= len(words):
        if default is None:
            raise ValueError(f"{what} is missing")
        return default
    text = words[at].strip().upper()
    if text in ("INFINITY", "INF", "1.#INF", "+INF", "+INFINITY"):
        return math.inf
    try:
        value = float(text.replace("D", "E")) if text.isascii() and "_" not in text else math.nan
    except ValueError:
        value = math.nan
    if math.isnan(value):
        raise ValueError(f"{words[at][:40]!r} is not a number")
    return value if abs(value) < LARGEST else math.copysign(math.inf, value)


def whole(words: list[str], at: int, default: int | None = None) -> int:
    """A whole number among the words of a command; ValueError as `number`."""
    value = number(words, at, default)
    if not math.isfinite(value) or value != int(value):
        raise ValueError(f"{words[at][:40]!r} is not a whole number")
    return int(value)
