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
from optics.files.parsed_file import (
    FAR_MM,
    GlassName,
    ParsedFile,
    StatedAperture,
    StatedField,
    SurfaceRow,
    number,
    whole,
)
from optics.files.report import ReportBuilder
from optics.files.zmx_surfaces import APERTURE_KEYS, ZmxSurface
from optics.textfile import TextFile

UNITS_MM = {"MM": 1.0, "CM": 10.0, "IN": 25.4, "INCH": 25.4, "METER": 1000.0, "M": 1000.0}
ATMOSPHERE_HPA = 1013.25
MOST_SURFACES = 1000
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


class _ZmxReader:
    """State while the lines are read."""

    def __init__(self, path: Path, text: TextFile, configuration: int | None) -> None:
        self.report = ReportBuilder(path.name, "Zemax OpticStudio (.zmx)", text.encoding)
        self.parsed = ParsedFile(path, self.report)
        self.lines = text.lines
        self.wanted = configuration
        self.surfaces: list[ZmxSurface] = []
        self.numbers: dict[str, list[float]] = {}
        self.vignetting: dict[int, list[float]] = {}
        self.waves: dict[int, tuple[float, float]] = {}
        self.counts = (0, 0)
        self.primary = 1
        self.operands: list[tuple[int, list[str]]] = []

    # --- header -----------------------------------------------------------------------------------------------------

    def header(self, line: int, key: str, words: list[str], text: str) -> None:
        """One command that belongs to no surface."""
        known = _HEADER.get(key)
        if known is not None:
            known(self, line, key, words, text)
        elif key in _DISPLAY:
            self.report.ignored(line, text, _DISPLAY[key])
        elif not self.surfaces:
            self.report.ignored(line, text, "unknown command of the header", harmless=False)
        elif self.parsed.configurations > 1 and len(words) >= 4:
            self.operands.append((line, words))
        else:
            self.report.ignored(line, text, "operand of a merit function or of an analysis")

    def _mode(self, line: int, key: str, words: list[str], text: str) -> None:
        if words[1:] and words[1].upper() != "SEQ":
            raise ValueError(f"mode {words[1]!r}: only sequential lenses can be read")
        self.report.taken(line, text, "sequential")

    def _name(self, line: int, key: str, words: list[str], text: str) -> None:
        self.parsed.name = text[4:].strip().strip('"')
        self.report.taken(line, text, "name of the lens")

    def _unit_line(self, line: int, key: str, words: list[str], text: str) -> None:
        self.report.taken(line, text, f"lens unit {words[1].upper()} = {self.parsed.unit_mm:g} mm")

    def _environment(self, line: int, key: str, words: list[str], text: str) -> None:
        parsed = self.parsed
        parsed.temperature_c, parsed.adjusted = number(words, 1, 20.0), bool(whole(words, 3, 0))
        parsed.pressure_hpa = ATMOSPHERE_HPA * number(words, 2, 1.0)
        how = "indices adjusted to it" if parsed.adjusted else "indices as in the catalogues"
        self.report.taken(line, text, f"{parsed.temperature_c:g} C, {parsed.pressure_hpa:g} hPa, {how}")

    def _catalogues(self, line: int, key: str, words: list[str], text: str) -> None:
        self.parsed.catalogues = [word.upper() for word in words[1:]]
        self.report.taken(line, text, "catalogues in this order")

    def _note(self, line: int, key: str, words: list[str], text: str) -> None:
        note = text[4:].strip().lstrip("0123456789").strip()
        self.parsed.notes.extend([note] if note else [])
        self.report.ignored(line, text, "note")

    def _configurations(self, line: int, key: str, words: list[str], text: str) -> None:
        parsed = self.parsed
        parsed.configurations, parsed.configuration = max(1, whole(words, 1, 1)), whole(words, 2, 1)
        self.report.taken(
            line, text, f"{parsed.configurations} configuration(s), number {parsed.configuration} is active"
        )

    def _stated(self, line: int, key: str, words: list[str], text: str) -> None:
        """Part number, focal length and aperture that makers of stock lenses enter."""
        if len(words) >= 5 and words[1] == "0" and number(words, 3) > 0.0:
            unit = self.parsed.unit_mm
            self.parsed.stated["EFL"] = (unit * number(words, 3), f"line {line}, stock-lens entry")
            self.report.taken(line, text, "focal length as the maker states it: compared below")
            return
        self.report.ignored(line, text, "entry of a stock-lens catalogue")

    def _aperture(self, line: int, key: str, words: list[str], text: str) -> None:
        kinds = {"ENPD": "EPD", "FNUM": "FNO", "OBNA": "NAO", "FLOA": "STOP"}
        value = 0.0 if key == "FLOA" else number(words, 1)
        if key != "FLOA" and not 0.0 < value < math.inf:
            raise ValueError(f"an aperture of {value:g}; it must be positive")
        if key == "ENPD":
            value *= self.parsed.unit_mm
        if key == "FNUM":
            self.parsed.stated["F-number"] = (value, f"line {line}")
        what = {"ENPD": f"entrance pupil of {value:g} mm", "FNUM": f"F/{value:g}", "OBNA": f"object-side NA {value:g}"}
        self.parsed.aperture = StatedAperture(kinds[key], value, line)
        self.report.taken(line, text, what.get(key, "aperture by the stop's own semi-diameter"))

    def _field_type(self, line: int, key: str, words: list[str], text: str) -> None:
        kind, parsed = whole(words, 1), self.parsed
        if kind not in _FIELD_KINDS:
            raise ValueError(f"field type {kind} is not known; angles and heights (0 to 3) are read")
        parsed.field_kind, parsed.fields_line = _FIELD_KINDS[kind], line
        self.counts = (max(0, whole(words, 3, 0)), max(0, whole(words, 4, 0)))
        if max(self.counts) > MOST_LISTED:
            raise ValueError(
                f"{self.counts[0]} fields and {self.counts[1]} wavelengths; at most {MOST_LISTED} are read"
            )
        self.report.taken(line, text, f"fields by {parsed.field_kind.replace('_', ' ')}, {self.counts[0]} of them")

    def _fields(self, line: int, key: str, words: list[str], text: str) -> None:
        values = [number(words, i) for i in range(1, len(words))]
        if key in _VIGNETTING:
            self.vignetting[_VIGNETTING[key]] = values
            self.report.taken(line, text, "vignetting factors: kept as defaults; rays are cut by clear apertures only")
            return
        self.numbers[key] = values
        self.report.taken(line, text, "fields: defaults of the file")

    def _primary(self, line: int, key: str, words: list[str], text: str) -> None:
        self.primary = whole(words, 1)
        self.report.taken(line, text, "primary wavelength: the design wavelength")

    def _wave(self, line: int, key: str, words: list[str], text: str) -> None:
        at = whole(words, 1)
        self.waves[at] = (1e3 * number(words, 2), number(words, 3, 1.0))
        if not self.counts[1] or at <= self.counts[1]:
            self.report.taken(line, text, "wavelength in um and weight")
        else:
            self.report.ignored(line, text, f"not one of the {self.counts[1]} wavelengths in use")

    def _waves(self, line: int, key: str, words: list[str], text: str) -> None:
        for i in range(1, len(words)):
            wave, weight = self.waves.get(i, (0.0, 1.0))
            value = number(words, i)
            self.waves[i] = (1e3 * value, weight) if key == "WAVL" else (wave, value)
        self.report.taken(line, text, "wavelengths in um" if key == "WAVL" else "weights of the wavelengths")

    # --- surfaces ---------------------------------------------------------------------------------------------------

    def surface(self, line: int, key: str, words: list[str], text: str) -> None:
        """One command of the current surface."""
        data, unit = self.surfaces[-1], self.parsed.unit_mm
        if key == "GLAS":
            self._glass(line, words, text, data)
        elif key == "DIAM":
            self._diameter(line, words, text, data)
        elif key in ("PZUP", "PPAR", "CPUP"):
            data.pickups.append((line, key, words, text))
        elif key == "COAT":
            data.coat = (line, words, text)
        elif key == "COMM":
            data.comment = text[4:].strip()
            self.report.ignored(line, text, "comment", data.number)
        elif (meaning := data.take(key, words, line, unit)) is not None:
            self.report.taken(line, text, meaning, data.number)
        elif key in _SURFACE_DISPLAY or key in _DISPLAY:
            self.report.ignored(line, text, "display, edges or physical optics", data.number)
        else:
            self.report.ignored(line, text, "unknown command of a surface", data.number, harmless=False)

    def _glass(self, line: int, words: list[str], text: str, data: ZmxSurface) -> None:
        name, mode = words[1], whole(words, 2, 0)
        if name.upper() == "MIRROR":
            data.mirror = True
            self.report.taken(line, text, "mirror", data.number)
            return
        glass = GlassName(name=name, line=line, command=text, model=mode == 1)
        nd, vd = number(words, 4, 0.0), number(words, 5, 0.0)
        if (mode in (1, 2) or (nd, vd) != (1.5, 40.0)) and (
            nd > 1.0 or mode == 1
        ):  # 1.5 and 40 stand where nothing was entered
            glass.nd, glass.vd, glass.partial = nd, vd, number(words, 6, 0.0)
        if mode == 4:
            glass.offset = (number(words, 10, 0.0), number(words, 11, 0.0))
        data.glass = glass

    def _diameter(self, line: int, words: list[str], text: str, data: ZmxSurface) -> None:
        value, mode = self.parsed.unit_mm * number(words, 1), whole(words, 2, 0)
        data.drawn = value
        if mode in (1, 2) and value > 0.0:
            data.fixed = value
            self.report.taken(line, text, "semi-diameter set by hand: a clear aperture", data.number)
        else:
            self.report.ignored(
                line, text, "semi-diameter that the program found for its rays: no aperture", data.number
            )

    # --- all of it --------------------------------------------------------------------------------------------------

    def read(self) -> ParsedFile:
        """The whole file."""
        self._unit()
        for line, raw in enumerate(self.lines, 1):
            words, text = raw.split(), raw.strip()
            if not words:
                continue
            key = words[0].upper()
            try:
                if key == "SURF":
                    self._next_surface(line, words, text)
                elif self.surfaces and (raw[:1] in " \t" or key in _SURFACE_KEYS):
                    self.surface(line, key, words, text)
                else:
                    self.header(line, key, words, text)
            except (ValueError, IndexError, OverflowError) as error:
                reason = "a value is missing" if isinstance(error, IndexError) else error
                raise self.parsed.fail(line, f"{text[:60]!r}: {reason}") from None
        self._settle()
        return self.parsed

    def _unit(self) -> None:
        """The lens unit comes first: every length is in it."""
        found = [(n, raw.split()) for n, raw in enumerate(self.lines, 1) if raw.split()[:1] == ["UNIT"]]
        if not found:
            self.report.assumed("UNIT", "the file states no lens unit; millimetres are assumed, as by the program")
            return
        line, words = found[0]
        if len(words) < 2 or words[1].upper() not in UNITS_MM:
            raise self.parsed.fail(line, f"lens unit {' '.join(words[1:2])!r} is none of {', '.join(UNITS_MM)}")
        self.parsed.unit_mm = UNITS_MM[words[1].upper()]

    def _next_surface(self, line: int, words: list[str], text: str) -> None:
        index = whole(words, 1)
        if index != len(self.surfaces):
            raise ValueError(f"surface {len(self.surfaces)} is expected here; a surface is missing or repeated")
        if index >= MOST_SURFACES:
            raise ValueError(f"more than {MOST_SURFACES} surfaces")
        self.surfaces.append(ZmxSurface(index, line))
        self.report.taken(line, text, "surface", index)

    def _settle(self) -> None:
        parsed = self.parsed
        if len(self.surfaces) < 3:
            raise ConfigError(f"{self.report.file}: {len(self.surfaces)} surfaces; object, lens and image are needed")
        self._configure()
        self._pickups()
        for data in self.surfaces:
            self._coating(data)
        first, *inner, last = self.surfaces
        parsed.object_mm = first.thickness if abs(first.thickness) < FAR_MM else math.inf
        parsed.rows = [self._row(data) for data in inner]
        parsed.image = self._row(last)
        counted = self.counts[0] or max(map(len, self.numbers.values()), default=0)
        listed = [self.numbers.get(key, []) for key in ("XFLN", "YFLN", "FWGN")]
        scale = 1.0 if parsed.field_kind == "angle" else parsed.unit_mm
        for i in range(counted):
            x, y, weight = (v[i] if i < len(v) else d for v, d in zip(listed, (0.0, 0.0, 1.0), strict=True))
            factors = [self.vignetting.get(k, []) for k in range(5)]
            dx, dy, cx, cy, turn = (v[i] if i < len(v) else 0.0 for v in factors)
            parsed.fields.append(StatedField(scale * x, scale * y, weight, (dx, dy, cx, cy, turn)))
        used = self.counts[1] or len(self.waves)
        chosen = [self.waves[i] for i in sorted(self.waves) if i <= used]
        parsed.wavelengths = chosen
        parsed.primary = self.primary - 1

    def _coating(self, data: ZmxSurface) -> None:
        """Take the coatings that the program's help defines; others stand in a file of the program and are named."""
        if data.coat is None:
            return
        line, words, text = data.coat
        name = words[1] if words[1:] else ""
        wave = self.waves.get(self.primary, (0.0, 1.0))[0]
        ideal = re.fullmatch(r"I(\.\d+)", name.upper())
        if name.upper() == "AR" and wave > 0.0 and not data.mirror:
            table: dict[str, Any] = {"kind": "quarter_wave", "design_wavelength_nm": wave, "material": "MgF2"}
            meaning = f"a quarter wave of MgF2 at {wave:g} nm"
        elif ideal and not data.mirror:
            share = 1.0 - float(ideal[1])
            table = {"kind": "table", "source": f"ideal coating {name}", "wavelength_nm": [100.0, 1e5]}
            table["reflectance"] = [[share, share]]
            meaning = f"reflects {share:g} at all wavelengths and angles"
        else:
            what = f"coating {name!r} is defined in a file of the program; give it as [coating.NAME] in a TOML file"
            self.report.ignored(line, text, what if name else "no coating", data.number)
            return
        data.coating = name
        self.parsed.coatings[name] = table
        self.report.taken(line, text, meaning, data.number)

    def _row(self, data: ZmxSurface) -> SurfaceRow:
        try:
            return data.row(self.parsed.unit_mm)
        except (ValueError, KeyError, OverflowError) as error:
            raise self.parsed.fail(data.kind_line, f"surface {data.number} ({data.kind}): {error}") from None

    def _configure(self) -> None:
        """Values of the requested configuration; the surfaces hold the active one."""
        parsed, report = self.parsed, self.report
        chosen = parsed.configuration if self.wanted is None else self.wanted
        if not 1 <= chosen <= parsed.configurations:
            raise ConfigError(f"{report.file}: configuration {chosen} does not exist; it has {parsed.configurations}")
        for line, words in self.operands:
            text = " ".join(words)
            try:
                if number(words, 2) != chosen:
                    report.ignored(line, text, f"of another configuration than {chosen}")
                elif self._operand(words):
                    report.taken(line, text, f"value in configuration {chosen}")
                elif chosen == parsed.configuration or words[0].upper() in ("MOFF", "MCOM", "LTTL"):
                    report.ignored(line, text, "operand whose value the surfaces hold already")
                else:
                    raise ValueError(f"operand {words[0]} of configuration {chosen} is not read")
            except (ValueError, IndexError) as error:
                raise parsed.fail(line, f"{text[:60]!r}: {error}") from None
        parsed.configuration = chosen

    def _operand(self, words: list[str]) -> bool:
        """Apply one operand of a configuration; False if it is not known."""
        key, at, unit = words[0].upper(), whole(words, 1), self.parsed.unit_mm
        if key in ("THIC", "CRVT", "CONN"):
            if not 0 <= at < len(self.surfaces):
                raise ValueError(f"there is no surface {at}")
            data, value = self.surfaces[at], number(words, 3)
            if key == "THIC":
                data.thickness = unit * value
            elif key == "CRVT":
                data.curvature = value / unit
            else:
                data.conic = value
        elif key == "APER" and self.parsed.aperture is not None:
            self.parsed.aperture.value = number(words, 3) * (unit if self.parsed.aperture.kind == "EPD" else 1.0)
        elif key in ("XFIE", "YFIE") and 0 < at <= MOST_LISTED:
            self.numbers.setdefault(f"{key[0]}FLN", [0.0] * at)[at - 1] = number(words, 3)
        elif key == "TEMP":
            self.parsed.temperature_c = number(words, 3)
        else:
            return False
        return True

    def _pickups(self) -> None:
        """Values taken over from other surfaces: the stored ones must agree with them."""
        for data in self.surfaces:
            for line, key, words, text in data.pickups:
                try:
                    self._pickup(data, line, key, words, text)
                except (ValueError, IndexError) as error:
                    raise self.parsed.fail(line, f"{text[:60]!r}: {error}") from None

    def _pickup(self, data: ZmxSurface, line: int, key: str, words: list[str], text: str) -> None:
        shift = 1 if key == "PPAR" else 0
        source, scale, offset = (number(words, 1 + shift + i, d) for i, d in enumerate((0.0, 1.0, 0.0)))
        if not 0 <= source < len(self.surfaces) or source != int(source):
            raise ValueError(f"there is no surface {source:g} to take a value from")
        other, unit = self.surfaces[int(source)], self.parsed.unit_mm
        column = whole(words, 4 + shift, 0) if len(words) > 4 + shift else 0
        message = f"value of surface {source:g}, scaled by {scale:g}, plus {offset:g}"
        if column or key == "CPUP":
            self.report.taken(line, text, f"{message}: its stored result is kept", data.number)
            return
        if key == "PPAR":
            at = whole(words, 1)
            stored, wanted = data.parm.get(at, 0.0), scale * other.parm.get(at, 0.0) + offset
        else:
            stored, wanted = data.thickness, scale * other.thickness + unit * offset
        if math.isclose(stored, wanted, rel_tol=1e-9, abs_tol=1e-9):
            self.report.taken(line, text, message, data.number)
            return
        self.report.approximated(
            line, text, f"{message} = {wanted:.10g}, but the file stores {stored:.10g}, which is kept", data.number
        )


_HEADER: dict[str, Callable[[_ZmxReader, int, str, list[str], str], None]] = {
    "MODE": _ZmxReader._mode,
    "NAME": _ZmxReader._name,
    "UNIT": _ZmxReader._unit_line,
    "ENVD": _ZmxReader._environment,
    "GCAT": _ZmxReader._catalogues,
    "NOTE": _ZmxReader._note,
    "DBDT": _ZmxReader._stated,
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
    if text.lines and any(line.lstrip().startswith("SURF") for line in text.lines):
        return _ZmxReader(path, text, configuration).read()
    raise ConfigError(f"{path.name}: no surface (a line that begins with SURF): not a sequential .zmx file")
