"""Surface types of .zmx files, and their conversion to our prescription (`optics.lens.tables`)."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from optics.files.parsed_file import SurfaceRow, integer, number

APERTURE_KEYS = ("CLAP", "FLAP", "OBSC", "SQAP", "SQOB", "ELAP", "ELOB", "SPID", "UDAP", "UDOB", "OBDC")
"""Commands that describe apertures of a surface."""
_SOLVES = ("MAZH", "CHZH", "EDGT", "TCOM", "TOLE", "PUPL", "CCEN", "POSI", "OPDF", "MAZU", "CHZU")
_OUTLINES = {"SQ": "rectangle", "EL": "ellipse"}


@dataclass(slots=True)
class ZmxSurface(SurfaceRow):
    """Commands of one surface; ``parm`` and ``xdat`` in the unit of the file."""

    kind: str = "STANDARD"
    parm: dict[int, float] = field(default_factory=dict)
    xdat: dict[int, float] = field(default_factory=dict)
    fixed_mm: float | None = None
    coat: tuple[int, list[str], str] | None = None
    pickups: list[tuple[int, str, list[str], str]] = field(default_factory=list)

    @property
    def title(self) -> str:
        """Name in messages."""
        return f"surface {self.number} ({self.kind})"

    def parms(self, first: int, last: int) -> list[float]:
        """Parameters from a number to another one; 0 where the file has none."""
        return [self.parm.get(i, 0.0) for i in range(first, last + 1)]

    def take(self, key: str, words: list[str], line: int, unit: float) -> str | None:  # noqa: PLR0911
        """Take a command; its meaning, or None if unknown."""
        match key:
            case "TYPE":
                self.kind, self.shape_line = words[1].upper(), line
                return "kind of surface"
            case "CURV":
                self.curvature = number(words, 1) / unit
                solve = number(words, 2, 0.0)
                return f"curvature; the result of a solve (type {solve:g})" if solve else "curvature"
            case "CONI":
                self.conic = number(words, 1)
                return "conic constant"
            case "DISZ":
                self.thickness_mm = unit * number(words, 1)
                return "thickness"
            case "STOP":
                self.stop = True
                return "aperture stop"
            case "PARM" | "XDAT":
                (self.parm if key == "PARM" else self.xdat)[integer(words, 1)] = number(words, 2)
                return "coefficient of the surface"
            case "SCBD":
                if any(number(words, i, 0.0) for i in range(4, len(words))):
                    raise ValueError("tilts kept with the surface (SCBD) are not read; use coordinate breaks")
                return "tilts kept with the surface, all zero"
            case _ if key in _SOLVES:
                return "the thickness was solved for; its stored result is kept"
            case _ if key in APERTURE_KEYS:
                self._aperture(key, words, unit)
                return "aperture of the surface"
        return None

    def _aperture(self, key: str, words: list[str], unit: float) -> None:
        if key in ("UDAP", "UDOB"):
            raise ValueError("a user-defined aperture (UDA file) is not supported")
        size = [unit * number(words, i, 0.0) for i in (1, 2)]
        if key == "OBDC":
            self.centre_mm = size
        elif key in ("CLAP", "FLAP"):
            self.inner_mm, self.clear_mm = size[0], size[1] or None
        elif key == "OBSC":
            if size[0]:
                raise ValueError(f"an obscuration that begins at {size[0]:g} mm from its centre is not read")
            self.apertures.append({"kind": "circle", "radius_mm": size[1], "obscures": True})
        elif key == "SPID":
            self.apertures.append({"kind": "spider", "arms": int(number(words, 2)), "width_mm": size[0]})
        else:
            outline = {"kind": _OUTLINES[key[:2]], "half_width_mm": size, "obscures": key.endswith("OB")}
            self.apertures.append(outline)

    def finish(self, unit: float) -> None:
        if self.kind not in SURFACE_KINDS:
            raise ValueError(f"this kind of surface is not read; {', '.join(sorted(SURFACE_KINDS))} are")
        off_axis = self.clear_mm is not None and any(self.centre_mm)
        self.move_apertures()
        if off_axis and self.inner_mm:
            hole = {"kind": "circle", "radius_mm": self.inner_mm, "obscures": True, "centre_mm": list(self.centre_mm)}
            self.apertures.append(hole)
            self.inner_mm = 0.0
        if self.clear_mm is None and not off_axis:
            self.clear_mm = self.fixed_mm
        self.shape = SURFACE_KINDS[self.kind](self, unit)


def _even(s: ZmxSurface, unit: float, values: list[float], radius: float = 1.0) -> dict[str, Any]:
    """Conic plus a polynomial in r^2 that begins with the r^2 term."""
    terms = _lengths(values, 2, 2, unit, radius)
    if not terms:
        return s.conic_shape()
    if terms[0]:
        return {"kind": "odd_asphere", **s.base, "terms": [term for even in terms for term in (0.0, even)]}
    return {"kind": "even_asphere", **s.base, "asphere": terms[1:]}


def _odd(s: ZmxSurface, unit: float, values: list[float], radius: float = 1.0) -> dict[str, Any]:
    terms = _lengths(values, 1, 1, unit, radius)
    return {"kind": "odd_asphere", **s.base, "terms": terms} if terms else s.conic_shape()


def _lengths(values: list[float], first: int, step: int, unit: float, radius: float = 1.0) -> list[float]:
    """Coefficients of (r / radius)^first, ^(first + step), ... in mm, without zeros at the end."""
    powers = range(first, first + step * len(values), step)
    scaled = [v / radius**p * unit ** (1 - p) for v, p in zip(values, powers, strict=True)]
    while scaled and scaled[-1] == 0.0:
        scaled.pop()
    return scaled


def _extra(s: ZmxSurface) -> tuple[list[float], float]:
    """Coefficients behind their count and the normalisation radius, and that radius in the file's unit."""
    count, radius = int(s.xdat.get(1, 0.0)), s.xdat.get(2, 1.0)
    if not 0 <= count <= 240 or not radius > 0.0:
        raise ValueError(f"{count} coefficients over a normalisation radius of {radius:g} do not define a surface")
    return [s.xdat.get(i + 2, 0.0) for i in range(1, count + 1)], radius


def _expansion(s: ZmxSurface, unit: float, kind: str, **more: str) -> dict[str, Any]:
    """Conic plus coefficients [mm] of functions over a normalisation radius."""
    if kind == "zernike" and any(s.parms(0, 13)):
        raise ValueError("a Zernike sag with further aspheric terms or an offset is not read")
    values, radius = _extra(s)
    coefficients = [v * unit for v in values]
    return {"kind": kind, **s.base, "norm_radius_mm": radius * unit, **more, "coefficients_mm": coefficients}


def _forbes(s: ZmxSurface, unit: float) -> dict[str, Any]:
    """Q-type asphere (Forbes 2007): extra data are its type (0: Q_bfs on a conic, 1: Q_con), the count of terms, the
    normalisation radius, the terms."""
    kind = {0.0: "qbfs", 1.0: "qcon"}.get(s.xdat.get(1, 0.0))
    if kind is None:
        raise ValueError("a Q-type asphere of another type than 0 (Q_bfs) or 1 (Q_con) is not read")
    count, radius = int(s.xdat.get(2, 0.0)), s.xdat.get(3, 1.0)
    if not 0 <= count <= 100:
        raise ValueError(f"{count} terms of a Q-type asphere")
    values = [unit * s.xdat.get(i + 4, 0.0) for i in range(count)]
    return {"kind": kind, **s.base, "norm_radius_mm": unit * radius, "q_mm": values}


def _toroidal(s: ZmxSurface, unit: float) -> dict[str, Any]:
    if any(s.parms(9, 13)) or any(v for i, v in s.xdat.items() if i > 2):
        raise ValueError("a toroid with Zernike terms is not read")
    rotation = unit * s.parm.get(1, 0.0)
    terms = _lengths(s.parms(2, 8), 2, 2, unit)
    if rotation == 0.0 and not terms:
        return {"kind": "cylinder", **s.base} if s.curvature else {"kind": "plane"}
    return {"kind": "toroid", **s.base, "terms": terms, "rotation_radius_mm": rotation or math.inf}


def _biconic(s: ZmxSurface, unit: float) -> dict[str, Any]:
    shape = {"kind": "biconic", "radius_x_mm": unit * s.parm.get(1, 0.0) or math.inf, "radius_y_mm": s.radius_mm}
    return {**shape, "conic_x": s.parm.get(2, 0.0), "conic_y": s.conic}


def _paraxial(s: ZmxSurface, unit: float) -> dict[str, Any]:
    focal = unit * s.parm.get(1, 0.0)
    if not focal:
        raise ValueError("an ideal lens of focal length 0")
    return {"kind": "paraxial", "focal_length_mm": focal}


def _break(s: ZmxSurface, unit: float) -> dict[str, Any]:
    x, y, *tilt_deg, order = s.parms(1, 6)
    shape: dict[str, Any] = {"kind": "coordinate_break"}
    if x or y:
        shape["decentre_mm"] = [unit * x, unit * y]
    if any(tilt_deg):
        shape["tilt_deg"] = tilt_deg
    axes, first = ("fixed", "tilt") if order else ("moving", "decentre")
    return {**shape, "axes": axes, "first": first}


SURFACE_KINDS: dict[str, Callable[[ZmxSurface, float], dict[str, Any]]] = {
    "STANDARD": lambda s, unit: s.conic_shape(),
    "EVENASPH": lambda s, unit: _even(s, unit, s.parms(1, 8)),
    "ODDASPHE": lambda s, unit: _odd(s, unit, s.parms(1, 8)),
    "XASPHERE": lambda s, unit: _even(s, unit, *_extra(s)),
    "XOSPHERE": lambda s, unit: _odd(s, unit, *_extra(s)),
    "XPOLYNOM": lambda s, unit: _expansion(s, unit, "polynomial"),
    "SZERNSAG": lambda s, unit: _expansion(s, unit, "zernike", ordering="noll"),
    "FZERNSAG": lambda s, unit: _expansion(s, unit, "zernike", ordering="fringe"),
    "QED_TYPE": _forbes,
    "TOROIDAL": _toroidal,
    "BICONICX": _biconic,
    "PARAXIAL": _paraxial,
    "COORDBRK": _break,
}
"""Kinds that are read, by their name in the file."""
