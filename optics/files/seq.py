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

from optics.errors import ConfigError
from optics.files.parsed_file import MOST_SURFACES, LensReader, ParsedFile, StatedAperture, integer, number
from optics.files.seq_surfaces import SeqSurface
from optics.glass.catalogue import Glass
from optics.glass.dispersion import Dispersion
from optics.glass.index_database import fitted_index
from optics.textfile import TextFile

UNITS_MM = {"M": 1.0, "MM": 1.0, "C": 10.0, "CM": 10.0, "I": 25.4, "IN": 25.4}
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
_APERTURES = ("EPD", "FNO", "NAO", "NA")


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
    """Commands without comments, joined over ``&``, separated at ``;``."""
    pending, start = "", 0
    for line, raw in enumerate(lines, 1):
        text = raw[: next(_unquoted(raw, "!"), len(raw))].rstrip()
        start = start if pending else line
        if text.endswith("&"):
            pending += text[:-1] + " "
            continue
        text, pending = pending + text, ""
        ends = [*_unquoted(text, ";"), len(text)]
        for begin, end in zip([0, *(at + 1 for at in ends)], ends, strict=False):
            words = _WORD.findall(text[begin:end])
            if words:
                yield _Command(start, words, text[begin:end].strip())
    if pending.strip():
        yield _Command(start, _WORD.findall(pending), pending.strip())


def _unquoted(text: str, mark: str) -> Iterator[int]:
    """Positions of a mark outside quotes; a quote that is not closed is a letter."""
    quote = ""
    for at, letter in enumerate(text):
        if quote:
            quote = "" if letter == quote else quote
        elif letter in "'\"":
            quote = letter if letter in text[at + 1 :] else ""
        elif letter == mark:
            yield at


class _SeqReader(LensReader):
    """State while the commands are read."""

    def __init__(self, path: Path, text: TextFile, configuration: int | None) -> None:
        super().__init__(path, text, "CODE V (.seq)", configuration)
        self.commands = list(_commands(text.lines))
        self.surfaces: list[SeqSurface] = []
        self.ended = False
        self.by_radii = True
        self.fields: dict[str, list[float]] = {}
        self.waves: list[float] = []
        self.weights: list[float] = []
        self.private_waves: list[float] = []
        self.in_private = False
        self.zooms: list[_Command] = []
        self.pickups: list[_Command] = []

    def read(self) -> ParsedFile:
        """Read all commands."""
        for command in self.commands:
            argument = command.words[1].upper() if len(command.words) > 1 else ""
            if command.key == "DIM":
                if argument not in UNITS_MM:
                    raise self.parsed.fail(command.line, f"dimension {argument!r} is none of M, C, I")
                self.parsed.unit_mm = UNITS_MM[argument]
            if command.key == "RDM":
                self.by_radii = not argument.startswith("N")
        keys = {command.key for command in self.commands}
        if "DIM" not in keys:
            self.report.assumed("DIM", "the file states no dimension; millimetres are assumed, as by the program")
        if "RDM" not in keys:
            self._radii_or_curvatures()
        for command in self.commands:
            with self.located(command.line, command.text):
                self._take(command)
        for line, raw in enumerate(self.lines, 1):
            if raw.lstrip().startswith("!"):
                self.report.ignored(line, raw.strip()[:80], "comment")
        self._complete()
        return self.parsed

    def _radii_or_curvatures(self) -> None:
        """Without RDM the numbers may be radii or curvatures: the alternative that no lens can have is ruled out."""

        def sizes(key: str, at: int) -> list[float]:
            """Finite numbers at one position of a command; invalid ones are refused where they are read."""
            values = []
            for command in self.commands:
                with suppress(ValueError):
                    values += [abs(number(command.words, at, 0.0))] if command.key == key else []
            return [value for value in values if 0.0 < value < math.inf]

        bases = sizes("S", 1)
        size = max(sizes("EPD", 1), default=max(sizes("S", 2), default=1.0)) / 2.0
        as_radii, as_curvatures = (all(b > 0.5 * size for b in bases), all(b * size < 2.0 for b in bases))
        if bases and as_radii == as_curvatures:
            raise ConfigError(
                f"{self.report.file}: the file does not say whether its numbers are radii (RDM Y) or curvatures "
                "(RDM N), and both are possible; add the correct line"
            )
        self.by_radii = as_radii
        what, other = ("radii", "curvatures") if as_radii else ("curvatures", "radii")
        if bases:
            self.report.assumed("RDM", f"the file does not say it; numbers are {what}: as {other} no light would pass")

    def _take(self, command: _Command) -> None:
        key, words = command.key, command.words
        if self.in_private:
            self.report.taken(command.line, command.text[:80], self._private(command))
        elif key in ("S", "SO", "SI"):
            self._open(command)
        elif (numbered := _SURFACE.match(key)) and len(words) > 1:
            self._surface_by_number(command, numbered[1])
        elif key in _REFUSED:
            raise ValueError(_REFUSED[key])
        elif key in ("ZOO", "PIK"):
            (self.zooms if key == "ZOO" else self.pickups).append(command)
        elif key in _NOTED:
            self.in_private = key == "PRV"
            self.report.taken(command.line, command.text, _NOTED[key])
        elif (message := self._system(command)) is not None:
            self.report.taken(command.line, command.text[:80], message)
        elif not self._of_surface(command):
            harmless = key in _HARMLESS or bool(re.match(r"(HCO|HCC|HCT|HWL|HOR)$", key))
            what = "control of optimisation, label or display" if harmless else "unknown command"
            current = self.surfaces[-1].number if self.surfaces else None
            self.report.ignored(command.line, command.text[:80], what, current, harmless=harmless)

    # --- system -----------------------------------------------------------------------------------------------------

    def _system(self, command: _Command) -> str | None:  # noqa: PLR0911
        """Take a command of the system; its meaning, None if it is none."""
        key, words, parsed = command.key, command.words, self.parsed
        if key[:3] == "TIT":
            parsed.name = " ".join(words[1:]).strip("'\" ")
            return "name of the lens"
        if key in _APERTURES:
            value = number(words, 1) * (parsed.unit_mm if key == "EPD" else 1.0)
            if not 0.0 < value < math.inf:
                raise ValueError(f"an aperture of {value:g}; it must be positive")
            parsed.aperture = StatedAperture(key, value, command.line)
            if key == "FNO":
                parsed.stated["F-number"] = (value, f"line {command.line}")
            return f"aperture {key} = {value:g}"
        if key == "REF":
            parsed.primary = integer(words, 1) - 1
            return "reference wavelength: the design wavelength"
        if key == "TEM":
            parsed.temperature_c = number(words, 1)
            return "temperature [C]"
        if key == "PRE":
            parsed.pressure_hpa = number(words, 1) * 1013.25 / 760.0
            return "pressure [mm Hg]"
        if key in ("WL", "WTW", "WTF", *_FIELDS, *_VIGNETTING):
            return self._list(key, [number(words, i) for i in range(1, len(words))], command.line)
        return None

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

    def _private(self, command: _Command) -> str:
        """Glasses that the file defines by their indices."""
        key, words = command.key, command.words
        if key == "END":
            self.in_private = False
            return "end of the file's glasses"
        if key == "PWL":
            self.private_waves = [number(words, i) for i in range(1, len(words))]
            return "wavelengths of the file's glasses [nm]"
        name = words[0].strip("'\"").upper()
        if len(words) > 2 and words[1].upper() == "LAU":
            glass, formula = self._laurent(name, [number(words, i) for i in range(2, len(words))]), "Laurent's formula"
        else:
            indices = [number(words, i) for i in range(1, len(words))]
            glass, formula = self._tabulated(command.line, name, indices), "its indices"
        self.parsed.private[name] = glass
        return f"glass {name} by {formula}"

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

    def _tabulated(self, line: int, name: str, indices: list[float]) -> Glass:
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
        fit = f"polynomial through {len(wave)} indices, residuals to {residual:.1e}"
        return Glass(
            name=name,
            source=f"{self.report.file}, line by line: {fit}",
            dispersion=dispersion,
            range_nm=(float(wave[0]), float(wave[-1])),
            maker="private",
        )

    # --- surfaces ---------------------------------------------------------------------------------------------------

    def _open(self, command: _Command) -> None:
        key = command.key
        if (key == "SO") != (not self.surfaces):
            what = "the object (SO) stands behind other surfaces" if self.surfaces else "the object (SO) is missing"
            raise ValueError(what)
        if self.ended:
            raise ValueError("a surface stands behind the image (SI)")
        if len(self.surfaces) >= MOST_SURFACES:
            raise ValueError(f"more than {MOST_SURFACES} surfaces")
        self.ended = key == "SI"
        self.surfaces.append(SeqSurface(len(self.surfaces), command.line))
        self._set_surface(self.surfaces[-1], command, number(command.words, 1, 0.0))

    def _surface_by_number(self, command: _Command, which: str) -> None:
        """``S5 radius thickness glass``: an existing surface, or the next one."""
        at = {"O": 0, "I": len(self.surfaces) - 1}.get(which.upper(), int(which) if which.isdigit() else -1)
        if at == len(self.surfaces) and at > 0:
            self._open(_Command(command.line, ["S", *command.words[1:]], command.text))
        else:
            self._set_surface(self._surface(f"S{at}"), command, number(command.words, 1))

    def _set_surface(self, surface: SeqSurface, command: _Command, base: float) -> None:
        """Radius or curvature, thickness and glass in one command."""
        unit = self.parsed.unit_mm
        surface.set_base(base, self.by_radii, unit)
        surface.thickness_mm = unit * number(command.words, 2, surface.thickness_mm / unit)
        if len(command.words) > 3:
            surface.set_glass(command.words[3], command.line, command.text)
        self.report.taken(command.line, command.text, "surface", surface.number)

    def _surface(self, word: str) -> SeqSurface:
        numbered = _SURFACE.match(word)
        if numbered is None:
            raise ValueError(f"{word!r} is not a surface")
        which = numbered[1].upper()
        at = {"O": 0, "I": len(self.surfaces) - 1, "A": -2}.get(which, int(which) if which.isdigit() else -2)
        if not 0 <= at < len(self.surfaces):
            raise ValueError(f"there is no surface {word}")
        return self.surfaces[at]

    def _of_surface(self, command: _Command) -> bool:
        words = list(command.words)
        if not self.surfaces:
            return False
        surface = self.surfaces[-1]
        if len(words) > 1 and _SURFACE.match(words[1]):
            surface = self._surface(words.pop(1))
        message = surface.take(words, command.line, command.text, self.parsed.unit_mm)
        if message is None:
            return False
        if message.startswith("!"):
            self.report.ignored(command.line, command.text, message[1:], surface.number)
        else:
            self.report.taken(command.line, command.text, message, surface.number)
        return True

    # --- the file ---------------------------------------------------------------------------------------------------

    def _complete(self) -> None:
        parsed, fields = self.parsed, self.fields
        if len(self.surfaces) < 3 or not self.ended:
            raise ConfigError(
                f"{self.report.file}: {len(self.surfaces)} surfaces; object (SO), lens (S) and image (SI) are needed"
            )
        self._zoom()
        for command in self.pickups:
            self._pickup(command)
        self.finish_surfaces()
        axes: list[list[float]] = [[], []]
        for key in fields.keys() & _FIELDS.keys():  # all of one kind
            axes[_FIELDS[key][1]] = fields[key]
        count = max(map(len, axes))
        # upper and lower factors cut the pupil on one side each: decentre and compression of the same ellipse
        ux, lx, uy, ly = ([*fields.get(key, []), *[0.0] * count][:count] for key in _VIGNETTING)
        decentres = ([(low - up) / 2 for up, low in zip(*pair, strict=True)] for pair in ((ux, lx), (uy, ly)))
        compressions = ([(up + low) / 2 for up, low in zip(*pair, strict=True)] for pair in ((ux, lx), (uy, ly)))
        parsed.add_fields(count, *axes, fields.get("WTF", []), *decentres, *compressions, [])
        weights = [*self.weights, *[1.0] * len(self.waves)]
        parsed.wavelengths = list(zip(self.waves, weights, strict=False))

    def _zoom(self) -> None:
        """Zoom positions: ``ZOO n`` and ``ZOO command surface values``; the surfaces hold position 1."""
        parsed = self.parsed
        for command in self.zooms:
            if len(command.words) == 2:
                parsed.configurations = max(1, integer(command.words, 1))
        chosen = parsed.configuration = self.choose_configuration(1)
        for command in self.zooms:
            words = command.words[1:]
            with self.located(command.line, command.text):
                if len(words) == 1:
                    message = f"{parsed.configurations} zoom positions"
                elif _SURFACE.match(words[1]):
                    single = [words[0], words[1], words[1 + chosen]]
                    if not self._of_surface(_Command(command.line, single, command.text)):
                        raise ValueError(f"zoom (ZOO) of {words[0]} is not supported")
                    continue
                elif chosen == 1 and words[0].upper() in (*_APERTURES, "TIT", *_FIELDS, *_VIGNETTING, "WTF"):
                    message = "values of the zoom positions; values of position 1 are in the file's own commands"
                else:
                    raise ValueError(f"zoom (ZOO) of {words[0]} is not supported")
            self.report.taken(command.line, command.text, message)

    def _pickup(self, command: _Command) -> None:
        """A value taken over from another surface; the stored one must agree with it."""
        text = command.text
        words = [word for word in command.words[1:] if not re.match(r"Z\d+$", word, re.IGNORECASE)]
        try:
            what, target, source_what, source = words[0].upper(), words[1], words[2].upper(), words[3]
            scale, offset = number(words, 4, 1.0), number(words, 5, 0.0)
            stored, wanted = self._surface(target).value(what), scale * self._surface(source).value(source_what)
        except (ValueError, IndexError, KeyError) as error:
            raise self.parsed.fail(command.line, f"{text[:60]!r}: this pickup is not supported ({error})") from None
        wanted += offset * self.parsed.unit_mm
        if math.isclose(stored, wanted, rel_tol=1e-6, abs_tol=1e-9) or stored == wanted:
            self.report.taken(command.line, text, "pickup; its stored result agrees")
        else:
            message = f"pickup gives {wanted:.9g}, the file stores {stored:.9g}, which is kept"
            self.report.approximated(command.line, text, message)


def read_seq(path: Path, text: TextFile, configuration: int | None = None) -> ParsedFile:
    """Read a CODE V sequence file; arguments and errors as `optics.files.zmx.read_zmx`."""
    return _SeqReader(path, text, configuration).read()
