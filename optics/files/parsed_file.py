"""Contents of a lens file in millimetres and in the terms of our prescription, before glasses and stop are assigned."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from optics.errors import ConfigError, StarbenchError
from optics.files.report import ReportBuilder
from optics.glass.catalogue import Glass
from optics.textfile import TextFile

LARGEST = 1e15
"""Numbers above mean infinity."""
FAR_MM = 1e9
"""An object at this distance or further is at infinity."""
MOST_SURFACES = 1000


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
    offset: tuple[float, float] = (0.0, 0.0)


@dataclass(slots=True)
class SurfaceRow:
    """A surface, or a coordinate break.

    ``shape`` and ``moved`` are keys of a surface table (`optics.lens.tables`); ``clear_mm`` is a clear aperture,
    ``drawn_mm`` the semi-diameter that the program computed for its drawing. Each file format has a subclass that its
    commands fill (``take``) and that then sets these fields (``finish``).
    """

    number: int
    line: int
    shape_line: int = 0
    shape: dict[str, Any] = field(default_factory=lambda: {"kind": "sphere", "radius_mm": math.inf})
    curvature: float = 0.0
    conic: float = 0.0
    thickness_mm: float = 0.0
    glass: GlassName | None = None
    mirror: bool = False
    stop: bool = False
    clear_mm: float | None = None
    inner_mm: float = 0.0
    drawn_mm: float | None = None
    apertures: list[dict[str, Any]] = field(default_factory=list)
    centre_mm: list[float] = field(default_factory=lambda: [0.0, 0.0])
    moved: dict[str, Any] = field(default_factory=dict)
    coating: str = ""

    @property
    def is_break(self) -> bool:
        """Whether it only moves the frame."""
        return bool(self.shape.get("kind") == "coordinate_break")

    @property
    def radius_mm(self) -> float:
        """Radius of curvature; infinite for a plane."""
        return 1.0 / self.curvature if self.curvature else math.inf

    @property
    def base(self) -> dict[str, float]:
        """Keys of the conic that an asphere departs from."""
        return {"radius_mm": self.radius_mm, "conic": self.conic}

    def conic_shape(self) -> dict[str, Any]:
        """Plane, sphere or conic."""
        if not self.curvature:
            return {"kind": "plane"}
        return {"kind": "conic", **self.base} if self.conic else {"kind": "sphere", "radius_mm": self.radius_mm}

    @property
    def title(self) -> str:
        """Name in messages."""
        return f"surface {self.number}"

    def finish(self, unit: float) -> None:
        """Set shape and apertures from the commands; ValueError for contents that are not supported."""

    def move_apertures(self) -> None:
        """Shift all outlines to ``centre_mm``; a round clear aperture becomes one of them."""
        if any(self.centre_mm):
            if self.clear_mm is not None:
                self.apertures.append({"kind": "circle", "radius_mm": self.clear_mm})
                self.clear_mm = None
            self.apertures = [{**outline, "centre_mm": list(self.centre_mm)} for outline in self.apertures]


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
    vignetting: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0, 0.0)


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

    def add_fields(self, count: int, *columns: list[float]) -> None:
        """Fields of columns x, y, weight and five vignetting factors; short columns end in defaults."""
        scale = 1.0 if self.field_kind == "angle" else self.unit_mm
        for i in range(count):
            x, y, weight, *factors = (
                column[i] if i < len(column) else float(k == 2) for k, column in enumerate(columns)
            )
            self.fields.append(StatedField(scale * x, scale * y, weight, tuple(factors)))


class LensReader:
    """State and steps that readers of all formats share."""

    def __init__(self, path: Path, text: TextFile, kind: str, configuration: int | None) -> None:
        self.report = ReportBuilder(path.name, kind, text.encoding)
        self.parsed = ParsedFile(path, self.report)
        self.lines, self.configuration = text.lines, configuration
        self.surfaces: list[Any] = []

    @contextmanager
    def located(self, line: int, text: str) -> Iterator[None]:
        """Turn a fault of a command into an error that names its line."""
        try:
            yield
        except StarbenchError as error:
            raise self.parsed.fail(line, str(error)) from None
        except (ValueError, IndexError, KeyError, OverflowError) as error:
            reason = "a value is missing" if isinstance(error, IndexError) else error
            raise self.parsed.fail(line, f"{text[:60]!r}: {reason}") from None

    def choose_configuration(self, active: int) -> int:
        """The requested configuration, or the active one; ConfigError if there is none of this number."""
        chosen, count = active if self.configuration is None else self.configuration, self.parsed.configurations
        if not 1 <= chosen <= count:
            raise ConfigError(f"{self.report.file}: configuration {chosen} does not exist; it has {count}")
        return chosen

    def finish_surfaces(self) -> None:
        """Object distance, surfaces and image of the parsed file."""
        for surface in self.surfaces[1:]:
            try:
                surface.finish(self.parsed.unit_mm)
            except (ValueError, KeyError, OverflowError) as error:
                raise self.parsed.fail(surface.shape_line or surface.line, f"{surface.title}: {error}") from None
        first, *self.parsed.rows, self.parsed.image = self.surfaces
        self.parsed.object_mm = first.thickness_mm if abs(first.thickness_mm) < FAR_MM else math.inf


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


def integer(words: list[str], at: int, default: int | None = None) -> int:
    """An integer of a command; ValueError as `number`."""
    value = number(words, at, default)
    if not math.isfinite(value) or value != int(value):
        raise ValueError(f"{words[at][:40]!r} is not a whole number")
    return int(value)
