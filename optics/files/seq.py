"""Reader of CODE V sequence files (.seq).

Commands are words of three letters in either case, several to a line between semicolons, continued after ``&``;
comments follow ``!``. Numbers follow the command. ``Sk`` as first word selects surface k, otherwise the command applies
to the last surface opened by ``S``, ``SO`` or ``SI`` (CODE V, *Lens System Setup Reference Manual*).
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from optics.errors import ConfigError, StarbenchError
from optics.files.parsed_file import FAR_MM, ParsedFile, StatedAperture, StatedField, number, whole
from optics.files.report import ReportBuilder
from optics.files.seq_surfaces import SeqSurface
from optics.glass.catalogue import Glass
from optics.glass.dispersion import Dispersion
from optics.glass.index_database import fitted_index
from optics.textfile import TextFile

UNITS_MM = {"M": 1.0, "MM": 1.0, "C": 10.0, "CM": 10.0, "I": 25.4, "IN": 25.4}
MOST_SURFACES = 1000
EXACT_RESIDUAL, ROUGH_RESIDUAL = 1e-6, 1e-3
"""Of the indices of a file's own glass from a smooth curve: from here on approximated, refused."""
_WORD = re.compile(r"'[^']*'|\"[^\"]*\"|[^\s'\"]+")
_SURFACE = re.compile(r"S(\d+|O|I|A)$", re.IGNORECASE)

_HARMLESS = {
    "LEN", "VERSION", "INI", "GO", "CCY", "THC", "KC", "AC", "BC", "CC", "DC", "EC", "FC", "GC", "HC", "JC", "CUC",
    "DER", "SLB", "CUM", "THM", "CLS", "POL", "CA", "WTA", "PIM", "OUT", "LBL", "GLC", "EDG", "WRN", "COM", "DOR",
    "VER", "IN", "TOW", "TOR", "CNF", "DLT", "DLR", "DLN", "UID", "SPH", "COMM", "GRP", "RSI", "VIE", "RET:",
    "XDC", "YDC", "ZDC", "ADC", "BDC", "CDC", "CON", "CUF", "CPY", "STE", "LIS", "FIR", "DAY", "RUN",
}  # fmt: skip
_REFUSED = {
    "DIF": "diffractive surfaces are not read", "GRT": "gratings are not read", "HOE": "holograms are not read",
    "GRN": "gradient-index glass is not read", "AFI": "an afocal lens makes no image", "NSS": "non-sequential surfaces",
    "RET": "returning to the frame of another surface (RET) is not read", "GLB": "global frames (GLB) are not read",
    "ENV": "an environment change inside the file is not read",
    "INC": "interferograms in other files are not read", "FRE": "Fresnel surfaces are not read",
}  # fmt: skip
_NOTED = {"PRV": "glasses of the file", "DIM": "unit of length", "RDM": "radii or curvatures"}
_FIELDS = {
    "XAN": ("angle", 0), "YAN": ("angle", 1), "XOB": ("object", 0), "YOB": ("object", 1),
    "XIM": ("paraxial_image", 0), "YIM": ("paraxial_image", 1), "XRI": ("real_image", 0), "YRI": ("real_image", 1),
}  # fmt: skip
_VIGNETTING = ("VUX", "VLX", "VUY", "VLY")


@dataclass(slots=True)
class _Command:
    line: int
    words: list[str]
    text: str

    @property
    def key(self) -> str:
        """Command, in capitals."""
        return self.words[0].upper()


def _commands(lines: tuple[str, ...]) -> Iterator[_Command]:
    """Commands without comments, put together over ``&``, taken apart at ``;``."""
    held, start = "", 0
    for line, raw in enumerate(lines, 1):
        text = _without_comment(raw).rstrip()
        start = start if held else line
        if text.endswith("&"):
            held += text[:-1] + " "
            continue
        for part in _split(held + text):
            words = _WORD.findall(part)
            if words:
                yield _Command(start, words, part.strip())
        held = ""
    if held.strip():
        yield _Command(start, _WORD.findall(held), held.strip())


def _unquoted(text: str, mark: str) -> Iterator[int]:
    """Where a mark stands outside quotes; a quote that is not closed is a letter."""
    quote = ""
    for at, letter in enumerate(text):
        if quote:
            quote = "" if letter == quote else quote
        elif letter in "'\"":
            quote = letter if letter in text[at + 1 :] else ""
        elif letter == mark:
            yield at


def _without_comment(raw: str) -> str:
    return raw[: next(_unquoted(raw, "!"), len(raw))]


def _split(text: str) -> list[str]:
    ends = list(_unquoted(text, ";"))
    return [text[begin:end] for begin, end in zip([0, *(at + 1 for at in ends)], [*ends, len(text)], strict=True)]


class _SeqReader:
    """State while the commands are read."""

    def __init__(self, path: Path, text: TextFile, configuration: int | None) -> None:
        self.report = ReportBuilder(path.name, "CODE V (.seq)", text.encoding)
        self.parsed = ParsedFile(path, self.report)
        self.commands = list(_commands(text.lines))
        self.lines = text.lines
        self.wanted = configuration
        self.surfaces: list[SeqSurface] = []
        self.ended = False
        self.radius_mode = True
        self.fields: dict[str, list[float]] = {}
        self.waves: list[float] = []
        self.weights: list[float] = []
        self.private: dict[str, list[float]] = {}
        self.private_waves: list[float] = []
        self.in_private = False
        self.zooms: list[_Command] = []
        self.pickups: list[_Command] = []

    def read(self) -> ParsedFile:
        """The whole file."""
        for at, command in enumerate(self.commands):
            if command.key == "DIM":
                unit = command.words[1].upper() if len(command.words) > 1 else ""
                if unit not in UNITS_MM:
                    raise self.parsed.fail(command.line, f"dimension {unit!r} is none of M, C, I")
                self.parsed.unit_mm = UNITS_MM[unit]
            if command.key == "RDM" and at < len(self.commands):
                self.radius_mode = not (len(command.words) > 1 and command.words[1].upper().startswith("N"))
        known = {c.key for c in self.commands}
        if "DIM" not in known:
            self.report.assumed("DIM", "the file states no dimension; millimetres are assumed, as by the program")
        if "RDM" not in known:
            self._radii_or_curvatures()
        for command in self.commands:
            try:
                self._one(command)
            except (ValueError, IndexError, OverflowError) as error:
                if isinstance(error, StarbenchError):
                    raise self.parsed.fail(command.line, str(error)) from None
                reason = "a value is missing" if isinstance(error, IndexError) else error
                raise self.parsed.fail(command.line, f"{command.text[:60]!r}: {reason}") from None
        self._comments()
        self._settle()
        return self.parsed

    def _radii_or_curvatures(self) -> None:
        """Without RDM the numbers may be radii or curvatures: what no surface can be is ruled out."""

        def sizes(key: str, at: int) -> list[float]:
            """Numbers of one place of a command; invalid numbers are refused where they are read."""
            found = []
            for command in self.commands:
                with suppress(ValueError):
                    found += [abs(number(command.words, at, 0.0))] if command.key == key else []
            return [value for value in found if 0.0 < value < math.inf]

        bent = sizes("S", 1)
        size = max(sizes("EPD", 1), default=max(sizes("S", 2), default=1.0)) / 2.0
        as_radii, as_curvatures = (all(b > 0.5 * size for b in bent), all(b * size < 2.0 for b in bent))
        if bent and as_radii == as_curvatures:
            raise ConfigError(
                f"{self.report.file}: the file does not say whether its numbers are radii (RDM Y) or curvatures "
                "(RDM N), and both are possible; add the correct line"
            )
        self.radius_mode = as_radii
        what, other = ("radii", "curvatures") if as_radii else ("curvatures", "radii")
        if bent:
            self.report.assumed("RDM", f"the file does not say it; numbers are {what}: as {other} no light would pass")

    def _comments(self) -> None:
        """Comments are lines too."""
        for line, raw in enumerate(self.lines, 1):
            if raw.lstrip().startswith("!"):
                self.report.ignored(line, raw.strip()[:80], "comment")

    def _one(self, command: _Command) -> None:
        key, words = command.key, command.words
        if self.in_private:
            self._private(command)
        elif key in ("S", "SO", "SI"):
            self._open(command)
        elif (named := _SURFACE.match(key)) and len(words) > 1:
            self._surface_by_number(command, named[1])
        elif key in _REFUSED:
            raise ValueError(_REFUSED[key])
        elif key in ("ZOO", "PIK"):
            (self.zooms if key == "ZOO" else self.pickups).append(command)
        elif key in _NOTED:
            self.in_private = key == "PRV"
            self.report.taken(command.line, command.text, _NOTED[key])
        elif not self._system(command) and not self._of_surface(command):
            harmless = key in _HARMLESS or bool(re.match(r"(HCO|HCC|HCT|HWL|HOR)$", key))
            what = "control of optimisation, label or display" if harmless else "unknown command"
            self.report.ignored(command.line, command.text[:80], what, self._current, harmless=harmless)

    @property
    def _current(self) -> int | None:
        return self.surfaces[-1].number if self.surfaces else None

    # --- system -----------------------------------------------------------------------------------------------------

    def _system(self, command: _Command) -> bool:
        key, words, parsed = command.key, command.words, self.parsed
        if key[:3] == "TIT":
            parsed.name = " ".join(words[1:]).strip("'\" ")
            message = "name of the lens"
        elif key in ("EPD", "FNO", "NAO", "NA"):
            value = number(words, 1) * (parsed.unit_mm if key == "EPD" else 1.0)
            if not 0.0 < value < math.inf:
                raise ValueError(f"an aperture of {value:g}; it must be positive")
            parsed.aperture = StatedAperture(key, value, command.line)
            if key == "FNO":
                parsed.stated["F-number"] = (value, f"line {command.line}")
            message = f"aperture {key} = {value:g}"
        elif key == "REF":
            parsed.primary, message = whole(words, 1) - 1, "reference wavelength: the design wavelength"
        elif key == "TEM":
            parsed.temperature_c, message = number(words, 1), "temperature [C]"
        elif key == "PRE":
            parsed.pressure_hpa, message = number(words, 1) * 1013.25 / 760.0, "pressure [mm Hg]"
        elif key in ("WL", "WTW", "WTF", *_FIELDS, *_VIGNETTING):
            message = self._list(key, [number(words, i) for i in range(1, len(words))], command.line)
        else:
            return False
        self.report.taken(command.line, command.text[:80], message)
        return True

    def _list(self, key: str, values: list[float], line: int) -> str:
        """Wavelengths, fields and their weights."""
        if key == "WL":
            self.waves = values
            return "wavelengths in nm"
        if key == "WTW":
            self.weights = values
            return "weights of the wavelengths"
        self.fields[key] = values
        if key in _VIGNETTING:
            return "vignetting factors: kept as defaults; rays are cut by clear apertures only"
        if key == "WTF":
            return "weights of the fields"
        kind, _ = _FIELDS[key]
        if any(_FIELDS[k][0] != kind for k in self.fields if k in _FIELDS):
            raise ValueError("fields are given both by angles and by heights; only one is possible")
        self.parsed.field_kind, self.parsed.fields_line = kind, line
        return f"fields by {kind.replace('_', ' ')}: defaults of the file"

    def _private(self, command: _Command) -> None:
        """Glasses that the file defines by their indices."""
        key, words = command.key, command.words
        if key == "END":
            self.in_private = False
            self.report.taken(command.line, command.text, "end of the file's glasses")
        elif key == "PWL":
            self.private_waves = [number(words, i) for i in range(1, len(words))]
            self.report.taken(command.line, command.text[:80], "wavelengths of the file's glasses [nm]")
        else:
            name = words[0].strip("'\"").upper()
            if len(words) > 2 and words[1].upper() == "LAU":
                self.parsed.private[name] = self._laurent(name, [number(words, i) for i in range(2, len(words))])
                self.report.taken(command.line, command.text[:80], f"glass {name} by Laurent's formula")
                return
            indices = [number(words, i) for i in range(1, len(words))]
            self.parsed.private[name] = self._measured(command.line, name, indices)
            self.report.taken(command.line, command.text[:80], f"glass {name} by its indices")

    def _laurent(self, name: str, coefficients: list[float]) -> Glass:
        """n^2 = A0 + A1 l^2 + A2 / l^2 + A3 / l^4 + ..., without a range: that of the wavelengths in use."""
        waves = self.waves or self.private_waves
        if len(coefficients) > 6 or not waves:
            raise ValueError(f"{len(coefficients)} coefficients at {len(waves)} wavelengths do not define a glass")
        return Glass(
            name=name,
            source=f"{self.report.file}: Laurent's formula, range not stated",
            dispersion=Dispersion("schott", tuple(coefficients)),
            range_nm=(0.9 * min(waves), 1.1 * max(waves)),
            maker="private",
        )

    def _measured(self, line: int, name: str, indices: list[float]) -> Glass:
        waves = self.private_waves
        if len(waves) != len(indices) or len(waves) < 2 or len(set(waves)) < len(waves) or not np.isfinite(waves).all():
            raise ValueError(f"{len(indices)} indices at {len(waves)} wavelengths do not define a glass")
        order = np.argsort(waves)
        wave, index = np.array(waves)[order], np.array(indices)[order]
        if not (wave[0] > 100.0 and (index >= 1.0).all() and (index < 5.0).all()):
            raise ValueError("wavelengths or indices outside the range of any glass")
        dispersion, residual = fitted_index(1e-3 * wave, index)
        if residual > ROUGH_RESIDUAL:
            raise ValueError(f"no smooth curve fits the indices of glass {name}: residuals of {residual:.1e}")
        if residual > EXACT_RESIDUAL:
            self.report.approximated(line, f"'{name}'", f"indices by a smooth curve, residuals up to {residual:.1e}")
        source = (
            f"{self.report.file}, line by line: polynomial through {len(wave)} indices, residuals to {residual:.1e}"
        )
        return Glass(
            name=name,
            source=source,
            dispersion=dispersion,
            range_nm=(float(wave[0]), float(wave[-1])),
            maker="private",
        )

    # --- surfaces ---------------------------------------------------------------------------------------------------

    def _open(self, command: _Command) -> None:
        key, words = command.key, command.words
        if (key == "SO") != (not self.surfaces):
            what = "the object (SO) stands behind other surfaces" if self.surfaces else "the object (SO) is missing"
            raise ValueError(what)
        if self.ended:
            raise ValueError("a surface stands behind the image (SI)")
        if len(self.surfaces) >= MOST_SURFACES:
            raise ValueError(f"more than {MOST_SURFACES} surfaces")
        self.ended = key == "SI"
        data = SeqSurface(len(self.surfaces), command.line)
        self.surfaces.append(data)
        data.set_base(number(words, 1, 0.0), self.radius_mode, self.parsed.unit_mm)
        data.thickness = self.parsed.unit_mm * number(words, 2, 0.0)
        if len(words) > 3:
            data.set_glass(words[3], command.line, command.text)
        self.report.taken(command.line, command.text, "surface", data.number)

    def _surface_by_number(self, command: _Command, which: str) -> None:
        """``S5 radius thickness glass``: a surface that is there already, or the next one."""
        at = {"O": 0, "I": len(self.surfaces) - 1}.get(which.upper(), int(which) if which.isdigit() else -1)
        if at == len(self.surfaces) and at > 0:
            self._open(_Command(command.line, ["S", *command.words[1:]], command.text))
            return
        data = self._find(f"S{at}")
        data.set_base(number(command.words, 1), self.radius_mode, self.parsed.unit_mm)
        data.thickness = self.parsed.unit_mm * number(command.words, 2, data.thickness / self.parsed.unit_mm)
        if len(command.words) > 3:
            data.set_glass(command.words[3], command.line, command.text)
        self.report.taken(command.line, command.text, "surface", data.number)

    def _find(self, word: str) -> SeqSurface:
        named = _SURFACE.match(word)
        if named is None:
            raise ValueError(f"{word!r} is not a surface")
        which = named[1].upper()
        at = {"O": 0, "I": len(self.surfaces) - 1, "A": -2}.get(which, int(which) if which.isdigit() else -2)
        if not 0 <= at < len(self.surfaces):
            raise ValueError(f"there is no surface {word}")
        return self.surfaces[at]

    def _of_surface(self, command: _Command) -> bool:
        words = list(command.words)
        if not self.surfaces:
            return False
        data = self.surfaces[-1]
        if len(words) > 1 and _SURFACE.match(words[1]):
            data = self._find(words.pop(1))
        message = data.take(words, command.line, command.text, self.parsed.unit_mm, self.radius_mode)
        if message is None:
            return False
        if message.startswith("!"):
            self.report.ignored(command.line, command.text, message[1:], data.number)
        else:
            self.report.taken(command.line, command.text, message, data.number)
        return True

    # --- all of it --------------------------------------------------------------------------------------------------

    def _settle(self) -> None:
        parsed = self.parsed
        if len(self.surfaces) < 3 or not self.ended:
            raise ConfigError(
                f"{self.report.file}: {len(self.surfaces)} surfaces; object (SO), lens (S) and image (SI) are needed"
            )
        self._zoom()
        self._pickup_all()
        first, *inner, last = self.surfaces
        parsed.object_mm = first.thickness if abs(first.thickness) < FAR_MM else math.inf
        for data in (*inner, last):
            try:
                row = data.row(parsed.unit_mm)
            except (ValueError, OverflowError) as error:
                raise parsed.fail(data.line, f"surface {data.number}: {error}") from None
            if data is last:
                parsed.image = row
            else:
                parsed.rows.append(row)
        points = max((len(v) for k, v in self.fields.items() if k in _FIELDS), default=0)
        scale = 1.0 if parsed.field_kind == "angle" else parsed.unit_mm
        for i in range(points):
            at = {0: 0.0, 1: 0.0}
            for key, (_, axis) in _FIELDS.items():
                if key in self.fields and i < len(self.fields[key]):
                    at[axis] = scale * self.fields[key][i]
            ux, lx, uy, ly = (v[i] if i < len(v) else 0.0 for v in (self.fields.get(k, []) for k in _VIGNETTING))
            weights = self.fields.get("WTF", [])
            # upper and lower factors cut the pupil on one side each: decentre and compression of the same ellipse
            factors = ((lx - ux) / 2, (ly - uy) / 2, (ux + lx) / 2, (uy + ly) / 2, 0.0)
            parsed.fields.append(StatedField(at[0], at[1], weights[i] if i < len(weights) else 1.0, factors))
        parsed.wavelengths = [
            (wave, self.weights[i] if i < len(self.weights) else 1.0) for i, wave in enumerate(self.waves)
        ]
        parsed.adjusted = False

    def _zoom(self) -> None:
        """Zoom positions: ``ZOO n`` and ``ZOO command surface values``; position 1 is what the surfaces hold."""
        parsed = self.parsed
        for command in self.zooms:
            if len(command.words) == 2:
                parsed.configurations = max(1, whole(command.words, 1))
        chosen = parsed.configuration = 1 if self.wanted is None else self.wanted
        if not 1 <= chosen <= parsed.configurations:
            name = self.report.file
            raise ConfigError(f"{name}: configuration {chosen} does not exist; it has {parsed.configurations}")
        for command in self.zooms:
            words = command.words[1:]
            try:
                if len(words) == 1:
                    message = f"{parsed.configurations} zoom positions"
                elif _SURFACE.match(words[1]):
                    single = [words[0], words[1], words[1 + chosen]]
                    if not self._of_surface(_Command(command.line, single, command.text)):
                        raise ValueError(f"zoom (ZOO) of {words[0]} is not supported")
                    continue
                elif words[0].upper() in ("EPD", "FNO", "NAO", "NA", "TIT", *_FIELDS, *_VIGNETTING, "WTF") and (
                    chosen == 1
                ):
                    message = "values of the zoom positions; values of position 1 are in the file's own commands"
                else:
                    raise ValueError(f"zoom (ZOO) of {words[0]} is not supported")
            except (ValueError, IndexError) as error:
                raise parsed.fail(command.line, f"{command.text[:60]!r}: {error}") from None
            self.report.taken(command.line, command.text, message)

    def _pickup_all(self) -> None:
        for command in self.pickups:
            text = command.text
            words = [word for word in command.words[1:] if not re.match(r"Z\d+$", word, re.IGNORECASE)]
            try:
                what, target, source_what, source = words[0].upper(), words[1], words[2].upper(), words[3]
                scale, offset = number(words, 4, 1.0), number(words, 5, 0.0)
                stored, wanted = self._find(target).value(what), scale * self._find(source).value(source_what)
            except (ValueError, IndexError, KeyError) as error:
                raise self.parsed.fail(command.line, f"{text[:60]!r}: this pickup is not supported ({error})") from None
            wanted += offset * self.parsed.unit_mm
            if math.isclose(stored, wanted, rel_tol=1e-6, abs_tol=1e-9) or stored == wanted:
                self.report.taken(command.line, text, "pickup; its stored result agrees")
            else:
                self.report.approximated(
                    command.line, text, f"pickup gives {wanted:.9g}, the file stores {stored:.9g}, which is kept"
                )


def read_seq(path: Path, text: TextFile, configuration: int | None = None) -> ParsedFile:
    """Read a CODE V sequence file; arguments and errors as `optics.files.zmx.read_zmx`."""
    return _SeqReader(path, text, configuration).read()
