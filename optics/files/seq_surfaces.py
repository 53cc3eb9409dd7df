"""One surface of a .seq file, and its conversion to our prescription (`optics.lens.tables`)."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from optics.files.parsed_file import GlassName, SurfaceRow, number

_POLYNOMIAL = "ABCDEFGHJ"
"""Commands of the even asphere: r^4, r^6, ... r^20."""
_MOVES = {"XDE": 0, "YDE": 1, "ZDE": 2}
_TURNS = {"ADE": 0, "BDE": 1, "CDE": 2}
_IGNORED_WORDS = {"EDG": "edge, no aperture"}


@dataclass(slots=True)
class SeqSurface:
    """Numbers of one surface in mm; polynomial coefficients in the unit of the file."""

    number: int
    line: int
    curvature: float = 0.0
    curvature_x: float | None = None
    conic: float = 0.0
    thickness: float = 0.0
    polynomial: dict[int, float] = field(default_factory=dict)
    odd: dict[int, float] = field(default_factory=dict)
    glass: GlassName | None = None
    mirror: bool = False
    stop: bool = False
    cylinder: bool = False
    clear: float | None = None
    hole: float = 0.0
    rectangle: dict[str, list[float]] = field(default_factory=dict)
    obscured: list[dict[str, Any]] = field(default_factory=list)
    centre: list[float] = field(default_factory=lambda: [0.0, 0.0])
    shift: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])
    turn: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])
    decentred: bool = False
    mode: str = ""
    special: str = ""

    def set_base(self, value: float, radii: bool, unit: float) -> None:
        """Set radius or curvature, whichever the file gives."""
        if radii:
            self.curvature = 0.0 if value == 0.0 or math.isinf(value) else 1.0 / (unit * value)
        else:
            self.curvature = value / unit

    def set_glass(self, word: str, line: int, text: str) -> None:
        """Medium behind the surface: a glass, air or a mirror."""
        name = word.strip("'\"")
        if name.upper() in ("REFL", "REFL_TIR", "TIRO"):
            self.mirror = True
        elif name.upper() != "AIR":
            self.glass = GlassName(name=name, line=line, command=text)

    def value(self, what: str) -> float:
        """A number that another surface may take over."""
        if what == "RDY":
            return 1.0 / self.curvature if self.curvature else 0.0
        return {"THI": self.thickness, "CUY": self.curvature, "K": self.conic}[what]

    def take(self, words: list[str], line: int, text: str, unit: float, radii: bool) -> str | None:
        """Take one command; its meaning, with "!" before it if it has no effect, None if unknown."""
        key = words[0].upper()
        if len(words) > 2 and (key in ("K", "RDY", "CUY", "RDX", "CUX") or (key in _POLYNOMIAL and len(key) == 1)):
            raise ValueError(f"{' '.join(words[2:])!r} follows the value; separate two commands by a semicolon")
        plain = _PLAIN.get(key)
        if plain is not None:
            return plain(self, words, line, text, unit)
        if key in ("RDY", "CUY"):
            self.set_base(number(words, 1), key == "RDY", unit)
            return "radius or curvature"
        if key in ("RDX", "CUX"):
            value = number(words, 1)
            straight = value == 0.0 or math.isinf(value)
            self.curvature_x = 0.0 if straight else (1.0 / (unit * value) if key == "RDX" else value / unit)
            return "radius or curvature across"
        if key in _POLYNOMIAL and len(key) == 1:
            self.polynomial[_POLYNOMIAL.index(key)] = number(words, 1)
            return "coefficient of the asphere"
        if key in ("CUF", "SPS", "AAS", "XTO", "YTO", "SCO"):
            return self._special(key, words)
        return self._aperture(key, words, unit) or self._decentre(key, words, unit)

    def _is_stop(self, words: list[str], line: int, text: str, unit: float) -> str:
        self.stop = True
        return "aperture stop"

    def _is_cylinder(self, words: list[str], line: int, text: str, unit: float) -> str:
        self.cylinder = True
        return "cylinder"

    def _is_named(self, words: list[str], line: int, text: str, unit: float) -> str:
        return "kind of surface"

    def _thick(self, words: list[str], line: int, text: str, unit: float) -> str:
        if words[1].upper() in ("HMY", "UMY", "HCY", "UCY", "EDG", "PIM"):
            return "the thickness was solved for; its stored result is kept"
        self.thickness = unit * number(words, 1)
        return "thickness"

    def _conic(self, words: list[str], line: int, text: str, unit: float) -> str:
        self.conic = number(words, 1)
        return "conic constant"

    def _filled(self, words: list[str], line: int, text: str, unit: float) -> str:
        self.set_glass(words[1], line, text)
        return "medium behind the surface"

    def _mode(self, words: list[str], line: int, text: str, unit: float) -> str:
        self.mirror = words[1].upper().startswith("REFL")
        return "mode of the surface"

    def _special(self, key: str, words: list[str]) -> str:
        if key == "CUF" and number(words, 1, 0.0) == 0.0:
            return "Fresnel base curvature, none"
        if key == "SPS" and words[1].upper() == "ODD":
            self.special = "ODD"
            return "odd asphere"
        if key == "SCO" and self.special == "ODD":
            index = int(words[1].upper().lstrip("C"))
            if not 1 <= index <= 31:
                raise ValueError(f"coefficient C{index} of an odd asphere; C1 to C31 are read")
            if index == 1:
                self.conic = number(words, 2)
            else:
                self.odd[index - 1] = number(words, 2)
            return "coefficient of the odd asphere"
        raise ValueError(f"special surfaces of this kind ({' '.join(words[:2])}) are not read")

    def _aperture(self, key: str, words: list[str], unit: float) -> str | None:
        extra = [word.upper() for word in words[1:] if not _is_number(word)]
        if key in ("CIR", "REX", "REY", "ELX", "ELY") and any(word in _IGNORED_WORDS for word in extra):
            return "!edge, no aperture"
        if key in ("CIR", "REX", "REY", "ELX", "ELY", "ADX", "ADY", "ARO"):
            value = number([word for word in words if _is_number(word)], 0)
        else:
            return None
        if key == "CIR":
            self._circle(unit * value, extra)
        elif "OBS" in extra or "HOL" in extra:
            raise ValueError("obscurations other than round ones are not read")
        elif key in ("ADX", "ADY"):
            self.centre[key == "ADY"] = unit * value
        elif key == "ARO" and value:
            raise ValueError("a rotated aperture (ARO) is not supported")
        elif key != "ARO":
            kind = "rectangle" if key[0] == "R" else "ellipse"
            self.rectangle.setdefault(kind, [math.nan, math.nan])[key[2] == "Y"] = unit * value
        return "aperture of the surface"

    def _circle(self, size: float, extra: list[str]) -> None:
        if "OBS" in extra:
            self.obscured.append({"kind": "circle", "radius_mm": size, "obscures": True})
        elif "HOL" in extra:
            self.hole = size
        else:
            self.clear = size

    def _decentre(self, key: str, words: list[str], unit: float) -> str | None:
        if key in _MOVES:
            self.shift[_MOVES[key]], self.decentred = unit * number(words, 1), True
            return "decentre"
        if key in _TURNS:
            self.turn[_TURNS[key]], self.decentred = number(words, 1), True
            return "tilt [deg]"
        if key in ("DAR", "BEN", "REV", "BAS"):
            if key == "BAS":
                raise ValueError("decentres about the base frame (BAS) are not read")
            self.mode, self.decentred = key, True
            return {"DAR": "this surface only", "BEN": "the axis follows the mirror", "REV": "inverse"}[key]
        return None

    def _shape(self, unit: float) -> dict[str, Any]:
        radius = 1.0 / self.curvature if self.curvature else math.inf
        if self.special == "ODD":
            terms = [self.odd.get(i, 0.0) * unit ** (1 - i) for i in range(1, max(self.odd, default=0) + 1)]
            return {"kind": "odd_asphere", "radius_mm": radius, "conic": self.conic, "terms": terms}
        if self.cylinder or self.curvature_x is not None:
            return self._toric(radius)
        count = max((i for i, v in self.polynomial.items() if v), default=-1) + 1
        if count:
            values = [self.polynomial.get(i, 0.0) * unit ** -(3 + 2 * i) for i in range(count)]
            return {"kind": "even_asphere", "radius_mm": radius, "conic": self.conic, "asphere": values}
        if self.curvature and self.conic:
            return {"kind": "conic", "radius_mm": radius, "conic": self.conic}
        return {"kind": "sphere", "radius_mm": radius} if self.curvature else {"kind": "plane"}

    def _toric(self, radius: float) -> dict[str, Any]:
        if self.polynomial:
            raise ValueError("a cylinder or toroid with a polynomial is not read")
        across = self.curvature_x or 0.0
        if self.cylinder and not across:
            return {"kind": "cylinder", "radius_mm": radius, "conic": self.conic}
        x = 1.0 / across if across else math.inf
        shape = {"kind": "biconic", "radius_x_mm": x, "radius_y_mm": radius}
        return {**shape, "conic_x": self.conic, "conic_y": self.conic}

    def _moved(self) -> dict[str, Any]:
        """Decentre and tilt; alpha and beta are left-handed in these files, gamma right-handed."""
        if not self.decentred or not (any(self.shift) or any(self.turn)):
            return {"carry": "bend"} if self.mode == "BEN" else {}
        x, y, z = self.shift
        tilt = [-self.turn[0], -self.turn[1], self.turn[2]]
        if self.mode == "REV":  # the inverse: back about z, y, x, then back along the axes that come out
            keys = {"decentre_mm": [-x, -y, -z], "tilt_deg": [-t for t in tilt], "axes": "fixed", "first": "tilt"}
        else:
            keys = {"decentre_mm": [x, y, z], "tilt_deg": tilt, "axes": "moving", "first": "decentre"}
        carry = {"DAR": "none", "BEN": "bend"}.get(self.mode, "forward")
        if carry == "bend" and not self.mirror:
            raise ValueError("BEN is for mirrors only")
        return {**keys, "carry": carry}

    def row(self, unit: float) -> SurfaceRow:
        """The surface as a table of our own prescription; ValueError for unsupported contents."""
        outlines = list(self.obscured)
        for kind, sizes in self.rectangle.items():
            if not all(s > 0.0 for s in sizes):
                raise ValueError(f"the {kind} aperture needs both of its dimensions")
            outlines.append({"kind": kind, "half_width_mm": sizes})
        clear, hole = self.clear, self.hole
        if any(self.centre):
            if clear is not None:
                outlines.append({"kind": "circle", "radius_mm": clear})
                clear = None
            outlines = [{**outline, "centre_mm": list(self.centre)} for outline in outlines]
        return SurfaceRow(
            number=self.number,
            line=self.line,
            shape=self._shape(unit),
            thickness_mm=self.thickness,
            glass=self.glass,
            mirror=self.mirror,
            stop=self.stop,
            clear_mm=clear,
            inner_mm=hole if clear is None or hole < clear else 0.0,
            apertures=outlines,
            moved=self._moved(),
        )


_PLAIN: dict[str, Callable[[SeqSurface, list[str], int, str, float], str]] = {
    **dict.fromkeys(("STO", "STOP"), SeqSurface._is_stop),
    **dict.fromkeys(("ASP", "CON", "SPH"), SeqSurface._is_named),
    **dict.fromkeys(("GLA", "GL1", "GL2"), SeqSurface._filled),
    "CYL": SeqSurface._is_cylinder,
    "THI": SeqSurface._thick,
    "K": SeqSurface._conic,
    "RMD": SeqSurface._mode,
}


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True
