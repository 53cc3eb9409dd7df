"""Reader of Zemax OpticStudio's sequential lens files (.zmx).

The format is not published; the meaning of keywords follows files of many versions and the program's help. Unknown
keywords are listed in the report and count as possible differences, unless they follow the surfaces, where merit
functions and tolerances are stored.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

from optics.errors import ConfigError
from optics.files.parsed_file import MOST_SURFACES, GlassName, LensReader, ParsedFile, StatedAperture, integer, number
from optics.files.zmx_surfaces import APERTURE_KEYS, ZmxSurface
from optics.textfile import TextFile

UNITS_MM = {"MM": 1.0, "CM": 10.0, "IN": 25.4, "INCH": 25.4, "METER": 1000.0, "M": 1000.0}
ATMOSPHERE_HPA = 1013.25
MOST_LISTED = 200

_DISPLAY = dict.fromkeys(
    (
        "PFIL", "LANG", "GFAC", "SDMA", "OMMA", "ROPD", "HYPR", "PICB", "POLS", "GLRS", "GSTD", "NSCD", "COFN", "LUID",
        "EERA", "IWDP", "STUD", "BLNK", "TOL", "AUTH", "VDSZ", "RCMF", "PUSH", "FUNC", "ISNA",
    ),
    "display, analysis or tolerances",
) | {
    "RAIM": "ray aiming of the program; here every ray is aimed at the real stop",
    "VERS": "version of the program",
}  # fmt: skip
_SURFACE_DISPLAY = {
    "FIMP", "HIDE", "MIRR", "SLAB", "SSID", "MEMA", "OEMA", "POPS", "COMM", "GLCB", "VPAR", "CHMF",
}  # fmt: skip
_SURFACE_KEYS = {"TYPE", "CURV", "CONI", "DISZ", "STOP", "GLAS", "DIAM", "PARM", "XDAT", "PPAR", *APERTURE_KEYS}
"""Commands that some writers do not indent."""
_FIELD_KINDS = {0: "angle", 1: "object", 2: "paraxial_image", 3: "real_image"}
_VIGNETTING = {"VDXN": 0, "VDYN": 1, "VCXN": 2, "VCYN": 3, "VANN": 4, "ZVDX": 0, "ZVDY": 1, "ZVCX": 2, "ZVCY": 3}


class _ZmxReader(LensReader):
    """State while the lines are read. Header methods take a command and return its meaning for the report."""

    def __init__(self, path: Path, text: TextFile, configuration: int | None) -> None:
        super().__init__(path, text, "Zemax OpticStudio (.zmx)", configuration)
        self.surfaces: list[ZmxSurface] = []
        self.columns: dict[str | int, list[float]] = {}
        self.waves: dict[int, tuple[float, float]] = {}
        self.counts = (0, 0)
        self.primary = 1
        self.operands: list[tuple[int, list[str]]] = []

    # --- header -----------------------------------------------------------------------------------------------------

    def header(self, line: int, key: str, words: list[str], text: str) -> None:
        """One command that belongs to no surface."""
        if key == "NOTE":
            note = text[4:].strip().lstrip("0123456789").strip()
            self.parsed.notes.extend([note] if note else [])
            self.report.ignored(line, text, "note")
        elif key == "DBDT" and not (len(words) >= 5 and words[1] == "0" and number(words, 3) > 0.0):
            self.report.ignored(line, text, "entry of a stock-lens catalogue")
        elif key == "WAVM" and 0 < self.counts[1] < integer(words, 1):
            self.waves[integer(words, 1)] = (1e3 * number(words, 2), number(words, 3, 1.0))
            self.report.ignored(line, text, f"not one of the {self.counts[1]} wavelengths in use")
        elif key in _HEADER:
            self.report.taken(line, text, _HEADER[key](self, line, key, words))
        elif key in _DISPLAY:
            self.report.ignored(line, text, _DISPLAY[key])
        elif not self.surfaces:
            self.report.ignored(line, text, "unknown command of the header", harmless=False)
        elif self.parsed.configurations > 1 and len(words) >= 4:
            self.operands.append((line, words))
        else:
            self.report.ignored(line, text, "operand of a merit function or of an analysis")

    def _mode(self, line: int, key: str, words: list[str]) -> str:
        if words[1:] and words[1].upper() != "SEQ":
            raise ValueError(f"mode {words[1]!r}: only sequential lenses can be read")
        return "sequential"

    def _name(self, line: int, key: str, words: list[str]) -> str:
        self.parsed.name = self.lines[line - 1].strip()[4:].strip().strip('"')
        return "name of the lens"

    def _unit_line(self, line: int, key: str, words: list[str]) -> str:
        return f"lens unit {words[1].upper()} = {self.parsed.unit_mm:g} mm"

    def _environment(self, line: int, key: str, words: list[str]) -> str:
        parsed = self.parsed
        parsed.temperature_c, parsed.adjusted = number(words, 1, 20.0), bool(integer(words, 3, 0))
        parsed.pressure_hpa = ATMOSPHERE_HPA * number(words, 2, 1.0)
        indices = "indices adjusted to it" if parsed.adjusted else "indices as in the catalogues"
        return f"{parsed.temperature_c:g} C, {parsed.pressure_hpa:g} hPa, {indices}"

    def _catalogues(self, line: int, key: str, words: list[str]) -> str:
        self.parsed.catalogues = [word.upper() for word in words[1:]]
        return "catalogues in this order"

    def _configurations(self, line: int, key: str, words: list[str]) -> str:
        parsed = self.parsed
        parsed.configurations, parsed.configuration = max(1, integer(words, 1, 1)), integer(words, 2, 1)
        return f"{parsed.configurations} configuration(s), number {parsed.configuration} is active"

    def _stock_lens(self, line: int, key: str, words: list[str]) -> str:
        """Focal length that makers of stock lenses enter."""
        self.parsed.stated["EFL"] = (self.parsed.unit_mm * number(words, 3), f"line {line}, stock-lens entry")
        return "focal length as the maker states it: compared below"

    def _aperture(self, line: int, key: str, words: list[str]) -> str:
        kind = {"ENPD": "EPD", "FNUM": "FNO", "OBNA": "NAO", "FLOA": "STOP"}[key]
        value = 0.0 if key == "FLOA" else number(words, 1)
        if key != "FLOA" and not 0.0 < value < math.inf:
            raise ValueError(f"an aperture of {value:g}; it must be positive")
        if key == "ENPD":
            value *= self.parsed.unit_mm
        if key == "FNUM":
            self.parsed.stated["F-number"] = (value, f"line {line}")
        self.parsed.aperture = StatedAperture(kind, value, line)
        meanings = {"EPD": f"entrance pupil of {value:g} mm", "FNO": f"F/{value:g}", "NAO": f"object-side NA {value:g}"}
        return meanings.get(kind, "aperture by the stop's own semi-diameter")

    def _field_type(self, line: int, key: str, words: list[str]) -> str:
        kind, parsed = integer(words, 1), self.parsed
        if kind not in _FIELD_KINDS:
            raise ValueError(f"field type {kind} is not known; angles and heights (0 to 3) are read")
        parsed.field_kind, parsed.fields_line = _FIELD_KINDS[kind], line
        self.counts = (max(0, integer(words, 3, 0)), max(0, integer(words, 4, 0)))
        if max(self.counts) > MOST_LISTED:
            raise ValueError(
                f"{self.counts[0]} fields and {self.counts[1]} wavelengths; at most {MOST_LISTED} are read"
            )
        return f"fields by {parsed.field_kind.replace('_', ' ')}, {self.counts[0]} of them"

    def _fields(self, line: int, key: str, words: list[str]) -> str:
        self.columns[_VIGNETTING.get(key, key)] = [number(words, i) for i in range(1, len(words))]
        if key in _VIGNETTING:
            return "vignetting factors: kept as defaults; rays are cut by clear apertures only"
        return "fields: defaults of the file"

    def _primary(self, line: int, key: str, words: list[str]) -> str:
        self.primary = integer(words, 1)
        return "primary wavelength: the design wavelength"

    def _wave(self, line: int, key: str, words: list[str]) -> str:
        self.waves[integer(words, 1)] = (1e3 * number(words, 2), number(words, 3, 1.0))
        return "wavelength in um and weight"

    def _waves(self, line: int, key: str, words: list[str]) -> str:
        for i in range(1, len(words)):
            wave, weight = self.waves.get(i, (0.0, 1.0))
            value = number(words, i)
            self.waves[i] = (1e3 * value, weight) if key == "WAVL" else (wave, value)
        return "wavelengths in um" if key == "WAVL" else "weights of the wavelengths"

    # --- surfaces ---------------------------------------------------------------------------------------------------

    def surface(self, line: int, key: str, words: list[str], text: str) -> None:
        """One command of the current surface."""
        surface, unit = self.surfaces[-1], self.parsed.unit_mm
        if key == "GLAS":
            self._glass(line, words, text, surface)
        elif key == "DIAM":
            self._diameter(line, words, text, surface)
        elif key in ("PZUP", "PPAR", "CPUP"):
            surface.pickups.append((line, key, words, text))
        elif key == "COAT":
            surface.coat = (line, words, text)
        elif key == "COMM":
            self.report.ignored(line, text, "comment", surface.number)
        elif (meaning := surface.take(key, words, line, unit)) is not None:
            self.report.taken(line, text, meaning, surface.number)
        elif key in _SURFACE_DISPLAY or key in _DISPLAY:
            self.report.ignored(line, text, "display, edges or physical optics", surface.number)
        else:
            self.report.ignored(line, text, "unknown command of a surface", surface.number, harmless=False)

    def _glass(self, line: int, words: list[str], text: str, surface: ZmxSurface) -> None:
        name, mode = words[1], integer(words, 2, 0)
        if name.upper() == "MIRROR":
            surface.mirror = True
            self.report.taken(line, text, "mirror", surface.number)
            return
        glass = surface.glass = GlassName(name=name, line=line, command=text, model=mode == 1)
        nd, vd = number(words, 4, 0.0), number(words, 5, 0.0)
        entered = mode in (1, 2) or (nd, vd) != (1.5, 40.0)  # 1.5 and 40 stand where nothing was entered
        if entered and (nd > 1.0 or mode == 1):
            glass.nd, glass.vd, glass.partial = nd, vd, number(words, 6, 0.0)
        if mode == 4:
            glass.offset = (number(words, 10, 0.0), number(words, 11, 0.0))

    def _diameter(self, line: int, words: list[str], text: str, surface: ZmxSurface) -> None:
        surface.drawn_mm = self.parsed.unit_mm * number(words, 1)
        if integer(words, 2, 0) in (1, 2) and surface.drawn_mm > 0.0:
            surface.fixed_mm = surface.drawn_mm
            self.report.taken(line, text, "semi-diameter set by hand: a clear aperture", surface.number)
        else:
            message = "semi-diameter that the program found for its rays: no aperture"
            self.report.ignored(line, text, message, surface.number)

    # --- the file ---------------------------------------------------------------------------------------------------

    def read(self) -> ParsedFile:
        """Read all lines."""
        self._unit()
        for line, raw in enumerate(self.lines, 1):
            words, text = raw.split(), raw.strip()
            if not words:
                continue
            key = words[0].upper()
            with self.located(line, text):
                if key == "SURF":
                    self._next_surface(line, words, text)
                elif self.surfaces and (raw[:1] in " \t" or key in _SURFACE_KEYS):
                    self.surface(line, key, words, text)
                else:
                    self.header(line, key, words, text)
        self._complete()
        return self.parsed

    def _unit(self) -> None:
        """The lens unit comes first: every length is in it."""
        units = ((line, words) for line, raw in enumerate(self.lines, 1) if (words := raw.split())[:1] == ["UNIT"])
        line, words = next(units, (0, []))
        if not line:
            self.report.assumed("UNIT", "the file states no lens unit; millimetres are assumed, as by the program")
        elif len(words) < 2 or words[1].upper() not in UNITS_MM:
            raise self.parsed.fail(line, f"lens unit {' '.join(words[1:2])!r} is none of {', '.join(UNITS_MM)}")
        else:
            self.parsed.unit_mm = UNITS_MM[words[1].upper()]

    def _next_surface(self, line: int, words: list[str], text: str) -> None:
        index = integer(words, 1)
        if index != len(self.surfaces):
            raise ValueError(f"surface {len(self.surfaces)} is expected here; a surface is missing or repeated")
        if index >= MOST_SURFACES:
            raise ValueError(f"more than {MOST_SURFACES} surfaces")
        self.surfaces.append(ZmxSurface(index, line))
        self.report.taken(line, text, "surface", index)

    def _complete(self) -> None:
        parsed = self.parsed
        if len(self.surfaces) < 3:
            raise ConfigError(f"{self.report.file}: {len(self.surfaces)} surfaces; object, lens and image are needed")
        self._configure()
        for surface in self.surfaces:
            for line, key, words, text in surface.pickups:
                with self.located(line, text):
                    self._pickup(surface, line, key, words, text)
        for surface in self.surfaces:
            if surface.coat is not None:
                self._coating(surface, *surface.coat)
        self.finish_surfaces()
        listed = ("XFLN", "YFLN", "FWGN")
        longest = max((len(values) for key, values in self.columns.items() if key in listed), default=0)
        parsed.add_fields(self.counts[0] or longest, *(self.columns.get(key, []) for key in (*listed, *range(5))))
        used = self.counts[1] or len(self.waves)
        parsed.wavelengths = [self.waves[i] for i in sorted(self.waves) if i <= used]
        parsed.primary = self.primary - 1

    def _coating(self, surface: ZmxSurface, line: int, words: list[str], text: str) -> None:
        """Take the coatings that the program's help defines; others are defined in a file of the program."""
        name = words[1] if words[1:] else ""
        wave = self.waves.get(self.primary, (0.0, 1.0))[0]
        ideal = re.fullmatch(r"I(\.\d+)", name.upper())
        if name.upper() == "AR" and wave > 0.0 and not surface.mirror:
            table: dict[str, Any] = {"kind": "quarter_wave", "design_wavelength_nm": wave, "material": "MgF2"}
            meaning = f"a quarter wave of MgF2 at {wave:g} nm"
        elif ideal and not surface.mirror:
            reflectance = 1.0 - float(ideal[1])
            table = {"kind": "table", "source": f"ideal coating {name}", "wavelength_nm": [100.0, 1e5]}
            table["reflectance"] = [[reflectance, reflectance]]
            meaning = f"reflects {reflectance:g} at all wavelengths and angles"
        else:
            what = f"coating {name!r} is defined in a file of the program; give it as [coating.NAME] in a TOML file"
            self.report.ignored(line, text, what if name else "no coating", surface.number)
            return
        surface.coating = name
        self.parsed.coatings[name] = table
        self.report.taken(line, text, meaning, surface.number)

    def _configure(self) -> None:
        """Values of the requested configuration; the surfaces hold the active one."""
        active, report = self.parsed.configuration, self.report
        chosen = self.choose_configuration(active)
        for line, words in self.operands:
            text = " ".join(words)
            with self.located(line, text):
                if number(words, 2) != chosen:
                    report.ignored(line, text, f"of another configuration than {chosen}")
                elif self._operand(words):
                    report.taken(line, text, f"value in configuration {chosen}")
                elif chosen == active or words[0].upper() in ("MOFF", "MCOM", "LTTL"):
                    report.ignored(line, text, "operand whose value the surfaces hold already")
                else:
                    raise ValueError(f"operand {words[0]} of configuration {chosen} is not read")
        self.parsed.configuration = chosen

    def _operand(self, words: list[str]) -> bool:
        """Apply one operand of a configuration; False if it is not known."""
        key, at, unit = words[0].upper(), integer(words, 1), self.parsed.unit_mm
        if key in ("THIC", "CRVT", "CONN"):
            if not 0 <= at < len(self.surfaces):
                raise ValueError(f"there is no surface {at}")
            surface, value = self.surfaces[at], number(words, 3)
            if key == "THIC":
                surface.thickness_mm = unit * value
            elif key == "CRVT":
                surface.curvature = value / unit
            else:
                surface.conic = value
        elif key == "APER" and self.parsed.aperture is not None:
            self.parsed.aperture.value = number(words, 3) * (unit if self.parsed.aperture.kind == "EPD" else 1.0)
        elif key in ("XFIE", "YFIE") and 0 < at <= MOST_LISTED:
            self.columns.setdefault(f"{key[0]}FLN", [0.0] * at)[at - 1] = number(words, 3)
        elif key == "TEMP":
            self.parsed.temperature_c = number(words, 3)
        else:
            return False
        return True

    def _pickup(self, surface: ZmxSurface, line: int, key: str, words: list[str], text: str) -> None:
        """A value taken over from another surface; the stored one must agree with it."""
        shift = 1 if key == "PPAR" else 0
        source, scale, offset = (number(words, 1 + shift + i, d) for i, d in enumerate((0.0, 1.0, 0.0)))
        if not 0 <= source < len(self.surfaces) or source != int(source):
            raise ValueError(f"there is no surface {source:g} to take a value from")
        other, unit = self.surfaces[int(source)], self.parsed.unit_mm
        message = f"value of surface {source:g}, scaled by {scale:g}, plus {offset:g}"
        if integer(words, 4 + shift, 0) or key == "CPUP":
            self.report.taken(line, text, f"{message}: its stored result is kept", surface.number)
            return
        if key == "PPAR":
            at = integer(words, 1)
            stored, wanted = surface.parm.get(at, 0.0), scale * other.parm.get(at, 0.0) + offset
        else:
            stored, wanted = surface.thickness_mm, scale * other.thickness_mm + unit * offset
        if math.isclose(stored, wanted, rel_tol=1e-9, abs_tol=1e-9):
            self.report.taken(line, text, message, surface.number)
            return
        message += f" = {wanted:.10g}, but the file stores {stored:.10g}, which is kept"
        self.report.approximated(line, text, message, surface.number)


_HEADER: dict[str, Callable[[_ZmxReader, int, str, list[str]], str]] = {
    "MODE": _ZmxReader._mode,
    "NAME": _ZmxReader._name,
    "UNIT": _ZmxReader._unit_line,
    "ENVD": _ZmxReader._environment,
    "GCAT": _ZmxReader._catalogues,
    "DBDT": _ZmxReader._stock_lens,
    "MNUM": _ZmxReader._configurations,
    "FTYP": _ZmxReader._field_type,
    "PWAV": _ZmxReader._primary,
    "WAVM": _ZmxReader._wave,
    **dict.fromkeys(("WAVL", "WWGN"), _ZmxReader._waves),
    **dict.fromkeys(("XFLN", "YFLN", "FWGN", *_VIGNETTING), _ZmxReader._fields),
    **dict.fromkeys(("ENPD", "FNUM", "OBNA", "FLOA"), _ZmxReader._aperture),
}


def read_zmx(path: Path, text: TextFile, configuration: int | None = None) -> ParsedFile:
    """Read a sequential Zemax file."""
    if any(line.lstrip().startswith("SURF") for line in text.lines):
        return _ZmxReader(path, text, configuration).read()
    raise ConfigError(f"{path.name}: no surface (a line that begins with SURF): not a sequential .zmx file")
