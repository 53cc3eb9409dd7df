"""One surface of a .seq file, and its conversion to our prescription (`optics.lens.tables`)."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

from optics.files.parsed_file import GlassName, SurfaceRow, number

_POLYNOMIAL = "ABCDEFGHJ"
"""Commands of the even asphere: r^4, r^6, ... r^20."""
_DECENTRES = {"XDE": 0, "YDE": 1, "ZDE": 2}
_TILTS = {"ADE": 0, "BDE": 1, "CDE": 2}
_MODES = {"DAR": "this surface only", "BEN": "the axis follows the mirror", "REV": "inverse"}
_OUTLINES = ("CIR", "REX", "REY", "ELX", "ELY")


def _curvature(value: float, is_radius: bool, unit: float) -> float:
    if not is_radius:
        return value / unit
    return 0.0 if value == 0.0 or math.isinf(value) else 1.0 / (unit * value)


@dataclass(slots=True)
class SeqSurface(SurfaceRow):
    """Commands of one surface; polynomial coefficients in the unit of the file."""

    curvature_x: float | None = None
    polynomial: dict[int, float] = field(default_factory=dict)
    odd: dict[int, float] = field(default_factory=dict)
    cylinder: bool = False
    widths: dict[str, list[float]] = field(default_factory=dict)
    decentre: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])
    tilt_deg: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])
    decentred: bool = False
    mode: str = ""
    special: str = ""

    def set_base(self, value: float, is_radius: bool, unit: float) -> None:
        """Set radius or curvature, whichever the file gives."""
        self.curvature = _curvature(value, is_radius, unit)

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
        return {"THI": self.thickness_mm, "CUY": self.curvature, "K": self.conic}[what]

    def take(self, words: list[str], line: int, text: str, unit: float) -> str | None:  # noqa: PLR0911, PLR0912
        """Take one command; its meaning, with "!" before it if it has no effect, None if unknown."""
        key = words[0].upper()
        if len(words) > 2 and key in ("K", "RDY", "CUY", "RDX", "CUX", *_POLYNOMIAL):
            raise ValueError(f"{' '.join(words[2:])!r} follows the value; separate two commands by a semicolon")
        match key:
            case "STO" | "STOP":
                self.stop = True
                return "aperture stop"
            case "CYL":
                self.cylinder = True
                return "cylinder"
            case "ASP" | "CON" | "SPH":
                return "kind of surface"
            case "GLA" | "GL1" | "GL2":
                self.set_glass(words[1], line, text)
                return "medium behind the surface"
            case "THI" if words[1].upper() in ("HMY", "UMY", "HCY", "UCY", "EDG", "PIM"):
                return "the thickness was solved for; its stored result is kept"
            case "THI":
                self.thickness_mm = unit * number(words, 1)
                return "thickness"
            case "K":
                self.conic = number(words, 1)
                return "conic constant"
            case "RMD":
                self.mirror = words[1].upper().startswith("REFL")
                return "mode of the surface"
            case "RDY" | "CUY":
                self.set_base(number(words, 1), key == "RDY", unit)
                return "radius or curvature"
            case "RDX" | "CUX":
                self.curvature_x = _curvature(number(words, 1), key == "RDX", unit)
                return "radius or curvature across"
            case "CUF" | "SPS" | "AAS" | "XTO" | "YTO" | "SCO":
                return self._special(key, words)
            case _ if len(key) == 1 and key in _POLYNOMIAL:
                self.polynomial[_POLYNOMIAL.index(key)] = number(words, 1)
                return "coefficient of the asphere"
        return self._aperture(key, words, unit) or self._decentre(key, words, unit)

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
        if key not in (*_OUTLINES, "ADX", "ADY", "ARO"):
            return None
        options = [word.upper() for word in words[1:] if not _is_number(word)]
        if key in _OUTLINES and "EDG" in options:
            return "!edge, no aperture"
        value = number([word for word in words if _is_number(word)], 0)
        if key == "CIR":
            self._circle(unit * value, options)
        elif "OBS" in options or "HOL" in options:
            raise ValueError("obscurations other than round ones are not read")
        elif key in ("ADX", "ADY"):
            self.centre_mm[key == "ADY"] = unit * value
        elif key == "ARO" and value:
            raise ValueError("a rotated aperture (ARO) is not supported")
        elif key != "ARO":
            kind = "rectangle" if key[0] == "R" else "ellipse"
            self.widths.setdefault(kind, [math.nan, math.nan])[key[2] == "Y"] = unit * value
        return "aperture of the surface"

    def _circle(self, size: float, options: list[str]) -> None:
        if "OBS" in options:
            self.apertures.append({"kind": "circle", "radius_mm": size, "obscures": True})
        elif "HOL" in options:
            self.inner_mm = size
        else:
            self.clear_mm = size

    def _decentre(self, key: str, words: list[str], unit: float) -> str | None:
        if key == "BAS":
            raise ValueError("decentres about the base frame (BAS) are not read")
        if key in _DECENTRES:
            self.decentre[_DECENTRES[key]], self.decentred = unit * number(words, 1), True
            return "decentre"
        if key in _TILTS:
            self.tilt_deg[_TILTS[key]], self.decentred = number(words, 1), True
            return "tilt [deg]"
        if key in _MODES:
            self.mode, self.decentred = key, True
        return _MODES.get(key)

    def _shape(self, unit: float) -> dict[str, Any]:
        if self.special == "ODD":
            terms = [self.odd.get(i, 0.0) * unit ** (1 - i) for i in range(1, max(self.odd, default=0) + 1)]
            return {"kind": "odd_asphere", **self.base, "terms": terms}
        if self.cylinder or self.curvature_x is not None:
            return self._toric()
        count = max((i for i, v in self.polynomial.items() if v), default=-1) + 1
        if count:
            terms = [self.polynomial.get(i, 0.0) * unit ** -(3 + 2 * i) for i in range(count)]
            return {"kind": "even_asphere", **self.base, "asphere": terms}
        return self.conic_shape()

    def _toric(self) -> dict[str, Any]:
        if self.polynomial:
            raise ValueError("a cylinder or toroid with a polynomial is not read")
        if self.cylinder and not self.curvature_x:
            return {"kind": "cylinder", **self.base}
        radius_x = 1.0 / self.curvature_x if self.curvature_x else math.inf
        shape = {"kind": "biconic", "radius_x_mm": radius_x, "radius_y_mm": self.radius_mm}
        return {**shape, "conic_x": self.conic, "conic_y": self.conic}

    def _moved(self) -> dict[str, Any]:
        """Decentre and tilt; alpha and beta are left-handed in these files, gamma right-handed."""
        if not self.decentred or not (any(self.decentre) or any(self.tilt_deg)):
            return {"carry": "bend"} if self.mode == "BEN" else {}
        x, y, z = self.decentre
        tilt = [-self.tilt_deg[0], -self.tilt_deg[1], self.tilt_deg[2]]
        if self.mode == "REV":  # the inverse: tilts about z, y, x first, then the shift along the axes that result
            keys = {"decentre_mm": [-x, -y, -z], "tilt_deg": [-t for t in tilt], "axes": "fixed", "first": "tilt"}
        else:
            keys = {"decentre_mm": [x, y, z], "tilt_deg": tilt, "axes": "moving", "first": "decentre"}
        carry = {"DAR": "none", "BEN": "bend"}.get(self.mode, "forward")
        if carry == "bend" and not self.mirror:
            raise ValueError("BEN is for mirrors only")
        return {**keys, "carry": carry}

    def finish(self, unit: float) -> None:
        for kind, sizes in self.widths.items():
            if not all(s > 0.0 for s in sizes):
                raise ValueError(f"the {kind} aperture needs both of its dimensions")
            self.apertures.append({"kind": kind, "half_width_mm": sizes})
        self.move_apertures()
        if self.clear_mm is not None and self.inner_mm >= self.clear_mm:
            self.inner_mm = 0.0
        self.shape, self.moved = self._shape(unit), self._moved()


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True
