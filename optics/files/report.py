"""Report on every line of a lens file: taken, approximated, or ignored, with the reason."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import StrEnum

from optics.errors import ConfigError


class Status(StrEnum):
    """Treatment of a line."""

    TAKEN = "taken"
    APPROXIMATED = "approximated"
    IGNORED = "ignored"


@dataclass(frozen=True, slots=True)
class ReportLine:
    """One command of a file."""

    line: int  # Its line in the file, from 1; 0 for what the file does not say and had to be chosen
    command: str  # The command as the file writes it
    surface: int | None  # Surface it belongs to, numbered as in the file
    status: Status  # What became of it
    message: str  # What it means here, or why it is left out
    harmless: bool = True  # Whether leaving it out cannot change the lens: display, comments, optimisation

    @property
    def exact(self) -> bool:
        """Whether the lens is the same as in the program that wrote the file, as far as this line goes."""
        return self.status is Status.TAKEN or (self.status is Status.IGNORED and self.harmless)

    def __str__(self) -> str:
        where = f"line {self.line}" if self.line else "not stated"
        surface = "" if self.surface is None else f" surface {self.surface}:"
        return f"{where}:{surface} {self.command}: {self.status}: {self.message}"


@dataclass(frozen=True, slots=True, kw_only=True)
class GlassChoice:
    """A glass that the file names and the one that was taken."""

    asked: str  # Name in the file, name in the lens
    taken: str
    where: str  # Catalogue or formula that it comes from
    status: Status  # ``TAKEN`` for the same glass, ``APPROXIMATED`` for another one or a model of it
    wavelength_nm: tuple[float, ...] = ()  # Design wavelengths
    index: tuple[float, ...] = ()  # Index of the glass that was taken, at these
    change: tuple[float, ...] | None = None  # What was taken less what was asked for, as far as that is known
    efl_mm: float | None = None  # Change of focal length and back focus by this choice
    bfl_mm: float | None = None

    @property
    def change_text(self) -> str:
        """The change of index and of first-order data in words."""
        if self.change is None:
            return "change of index not known: the file states no index at the design wavelengths"
        text = ", ".join(f"{c:+.1e} at {w:g} nm" for w, c in zip(self.wavelength_nm, self.change, strict=True))
        if self.efl_mm is None or self.bfl_mm is None:
            return f"index {text}"
        return f"index {text}; EFL {self.efl_mm:+.4g} mm, BFL {self.bfl_mm:+.4g} mm"


@dataclass(frozen=True, slots=True)
class FirstOrderComparison:
    """A first-order quantity as computed here and as the file states it."""

    name: str
    computed: float | None
    stated: float | None
    unit: str
    source: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class ImportReport:
    """Report on a lens file."""

    file: str  # The file, its format, the encoding of its text
    kind: str
    encoding: str
    lines: tuple[ReportLine, ...]  # Every command of the file in its order; first what it does not say
    glasses: tuple[GlassChoice, ...] = ()  # Its glasses
    comparisons: tuple[FirstOrderComparison, ...] = ()  # First-order data, computed and stated

    @property
    def count(self) -> dict[Status, int]:
        """Number of commands taken, approximated and ignored."""
        found = Counter(line.status for line in self.lines)
        return {status: found[status] for status in Status}

    @property
    def inexact(self) -> tuple[ReportLine, ...]:
        """Commands that make the lens differ from the file, or may do so."""
        return tuple(line for line in self.lines if not line.exact)

    def require_exact(self) -> None:
        """Raise ConfigError, one line per command, if anything relevant was approximated or left out."""
        if self.inexact:
            head = f"{self.file}: not read exactly, and strict = true refuses any approximation"
            raise ConfigError("\n".join([head, *(f"{self.file}: {line}" for line in self.inexact)]))

    def __str__(self) -> str:
        counts = ", ".join(f"{number} {status}" for status, number in self.count.items())
        return f"{self.file} ({self.kind}, {self.encoding}): {counts}"


@dataclass(slots=True)
class ReportBuilder:
    """The report while a file is read; a command without an entry is unknown."""

    file: str
    kind: str
    encoding: str
    lines: list[ReportLine] = field(default_factory=list)

    def add(
        self, line: int, command: str, status: Status, message: str, surface: int | None = None, harmless: bool = True
    ) -> None:
        """One more command."""
        self.lines.append(ReportLine(line, command, surface, status, message, harmless))

    def taken(self, line: int, command: str, message: str, surface: int | None = None) -> None:
        """A command that is in the lens exactly."""
        self.add(line, command, Status.TAKEN, message, surface)

    def approximated(self, line: int, command: str, message: str, surface: int | None = None) -> None:
        """A command that is in the lens with a deviation from the file."""
        self.add(line, command, Status.APPROXIMATED, message, surface, harmless=False)

    def ignored(
        self, line: int, command: str, message: str, surface: int | None = None, *, harmless: bool = True
    ) -> None:
        """A command that is left out."""
        self.add(line, command, Status.IGNORED, message, surface, harmless)

    def assumed(self, command: str, message: str, *, exact: bool = False) -> None:
        """A value missing in the file."""
        self.add(0, command, Status.TAKEN if exact else Status.APPROXIMATED, message, None, exact)

    def finished(
        self, glasses: Sequence[GlassChoice] = (), comparisons: Sequence[FirstOrderComparison] = ()
    ) -> ImportReport:
        """The report, in the order of the file."""
        return ImportReport(
            file=self.file,
            kind=self.kind,
            encoding=self.encoding,
            lines=tuple(sorted(self.lines, key=lambda entry: entry.line)),
            glasses=tuple(glasses),
            comparisons=tuple(comparisons),
        )
