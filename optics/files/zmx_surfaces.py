"""Surface types of .zmx files, and their conversion to our prescription (`optics.lens.tables`)."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from optics.files.parsed_file import GlassName, SurfaceRow, number, whole

APERTURE_KEYS = ("CLAP", "FLAP", "OBSC", "SQAP", "SQOB", "ELAP", "ELOB", "SPID", "UDAP", "UDOB", "OBDC")
"""Commands that describe apertures of a surface."""
_MEANINGS = {
    "TYPE": "kind of surface",
    "CURV": "curvature",
    "CONI": "conic constant",
    "DISZ": "thickness",
    "STOP": "aperture stop",
    "PARM": "coefficient of the surface",
    "XDAT": "coefficient of the surface",
    "SCBD": "tilts kept with the surface, all zero",
    **dict.fromkeys(
        ("MAZH", "CHZH", "EDGT", "TCOM", "TOLE", "PUPL", "CCEN", "POSI", "OPDF", "MAZU", "CHZU"),
        "the thickness was solved for; its stored result is kept",
    ),
}


@dataclass(slots=True)
class ZmxSurface:
    """Numbers of one surface: curvature [1/mm], lengths [mm]; ``parm`` and ``xdat`` in the unit of the file."""

    number: int
    line: int
    kind: str = "STANDARD"
    kind_line: int = 0
    curvature: float = 0.0
    conic: float = 0.0
    thickness: float = 0.0
    parm: dict[int, float] = field(default_factory=dict)
    xdat: dict[int, float] = field(default_factory=dict)
    glass: GlassName | None = None
    mirror: bool = False
    stop: bool = False
    fixed: float | None = None
    drawn: float | None = None
    clear: float | None = None
    inner: float = 0.0
    outlines: list[dict[str, Any]] = field(default_factory=list)
    centre: tuple[float, float] = (0.0, 0.0)
    comment: str = ""
    coat: tuple[int, list[str], str] | None = None
    coating: str = ""
    pickups: list[tuple[int, str, list[str], str]] = field(default_factory=list)

    @property
    def radius_mm(self) -> float:
        """Radius of curvature; infinite for a plane."""
        return 1.0 / self.curvature if self.curvature else math.inf

    def take(self, key: str, words: list[str], line: int, unit: float) -> str | None:
        """Take a command; its meaning, or None if unknown."""
        meaning = _MEANINGS.get(key)
        if key == "TYPE":
            self.kind, self.kind_line = words[1].upper(), line
        elif key == "CURV":
            self.curvature = number(words, 1) / unit
            solve = number(words, 2, 0.0) if len(words) > 2 else 0.0
            meaning = f"curvature; the result of a solve (type {solve:g})" if solve else meaning
        elif key == "CONI":
            self.conic = number(words, 1)
        elif key == "DISZ":
            self.thickness = unit * number(words, 1)
        elif key == "STOP":
            self.stop = True
        elif key in ("PARM", "XDAT"):
            target = self.parm if key == "PARM" else self.xdat
            target[whole(words, 1)] = number(words, 2)
        elif key == "SCBD":
            if any(number(words, i, 0.0) for i in range(4, len(words))):
                raise ValueError("tilts kept with the surface (SCBD) are not read; use coordinate breaks")
        elif meaning is None and self._aperture(key, words, unit):
            return "aperture of the surface"
        return meaning

    def _aperture(self, key: str, words: list[str], unit: float) -> bool:
        """Take a command that describes an aperture; False if it is none."""
        if key not in APERTURE_KEYS:
            return False
        size = [unit * number(words, i, 0.0) for i in (1, 2)] if key not in ("OBDC", "UDAP", "UDOB") else []
        if key in ("CLAP", "FLAP"):
            self.inner, self.clear = size[0], size[1] or None
        elif key == "OBSC":
            self.outlines.append({"kind": "circle", "radius_mm": size[1], "obscures": True})
            if size[0]:
                raise ValueError(f"an obscuration that begins at {size[0]:g} mm from its centre is not read")
        elif key in ("SQAP", "SQOB"):
            self.outlines.append({"kind": "rectangle", "half_width_mm": size, "obscures": key == "SQOB"})
        elif key in ("ELAP", "ELOB"):
            self.outlines.append({"kind": "ellipse", "half_width_mm": size, "obscures": key == "ELOB"})
        elif key == "SPID":
            arms = number(words, 2)
            self.outlines.append({"kind": "spider", "arms": int(arms), "width_mm": size[0]})
        elif key in ("UDAP", "UDOB"):
            raise ValueError("a user-defined aperture (UDA file) is not supported")
        else:
            self.centre = (unit * number(words, 1, 0.0), unit * number(words, 2, 0.0))
        return True

    def row(self, unit: float) -> SurfaceRow:
        """The surface as a table of our own prescription."""
        if self.kind not in SURFACE_KINDS:
            raise ValueError(f"this kind of surface is not read; {', '.join(sorted(SURFACE_KINDS))} are")
        outlines = [dict(outline) for outline in self.outlines]
        clear = self.clear if self.clear is not None else self.fixed
        inner = self.inner
        if any(self.centre):
            if self.clear is not None:  # a round aperture beside the vertex
                outlines.append({"kind": "circle", "radius_mm": self.clear})
                if inner:
                    outlines.append({"kind": "circle", "radius_mm": inner, "obscures": True})
                clear, inner = None, 0.0
            for outline in outlines:
                outline["centre_mm"] = list(self.centre)
        return SurfaceRow(
            number=self.number,
            line=self.line,
            shape=SURFACE_KINDS[self.kind](self, unit),
            thickness_mm=self.thickness,
            glass=self.glass,
            mirror=self.mirror,
            stop=self.stop,
            clear_mm=clear,
            inner_mm=inner,
            drawn_mm=self.drawn,
            apertures=outlines,
            comment=self.comment,
            coating=self.coating,
        )


def _standard(s: ZmxSurface, unit: float) -> dict[str, Any]:
    if not s.curvature:
        return {"kind": "plane"}
    if not s.conic:
        return {"kind": "sphere", "radius_mm": s.radius_mm}
    return {"kind": "conic", "radius_mm": s.radius_mm, "conic": s.conic}


def _lengths(values: list[float], first: int, step: int, unit: float) -> list[float]:
    """Coefficients of r^first, r^(first + step), ... in mm, without zeros at the end."""
    scaled = [v * unit ** (1 - first - step * i) for i, v in enumerate(values)]
    while scaled and scaled[-1] == 0.0:
        scaled.pop()
    return scaled


def _even(s: ZmxSurface, unit: float, values: list[float]) -> dict[str, Any]:
    """Conic plus a polynomial in r^2 that begins with the r^2 term."""
    terms = _lengths(values, 2, 2, unit)
    if not terms:
        return _standard(s, unit)
    base = {"radius_mm": s.radius_mm, "conic": s.conic}
    if terms[0]:
        odd = [0.0] * (2 * len(terms))
        odd[1::2] = terms
        return {"kind": "odd_asphere", **base, "terms": odd}
    return {"kind": "even_asphere", **base, "asphere": terms[1:]}


def _even_asphere(s: ZmxSurface, unit: float) -> dict[str, Any]:
    return _even(s, unit, [s.parm.get(i, 0.0) for i in range(1, 9)])


def _odd(s: ZmxSurface, unit: float, values: list[float]) -> dict[str, Any]:
    terms = _lengths(values, 1, 1, unit)
    if not terms:
        return _standard(s, unit)
    return {"kind": "odd_asphere", "radius_mm": s.radius_mm, "conic": s.conic, "terms": terms}


def _odd_asphere(s: ZmxSurface, unit: float) -> dict[str, Any]:
    return _odd(s, unit, [s.parm.get(i, 0.0) for i in range(1, 9)])


def _extra(s: ZmxSurface, skip: int) -> tuple[list[float], float]:
    """Coefficients behind their count and the normalisation radius, and that radius in the file's unit."""
    count = int(s.xdat.get(1, 0.0))
    radius = s.xdat.get(2, 1.0)
    if not 0 <= count <= 240 or not radius > 0.0:
        raise ValueError(f"{count} coefficients over a normalisation radius of {radius:g} do not define a surface")
    return [s.xdat.get(i + 1 + skip, 0.0) for i in range(1, count + 1)], radius


def _extended_even(s: ZmxSurface, unit: float) -> dict[str, Any]:
    values, radius = _extra(s, 1)
    return _even(s, unit, [v / radius ** (2 * i + 2) for i, v in enumerate(values)])


def _extended_odd(s: ZmxSurface, unit: float) -> dict[str, Any]:
    values, radius = _extra(s, 1)
    return _odd(s, unit, [v / radius ** (i + 1) for i, v in enumerate(values)])


def _polynomial(s: ZmxSurface, unit: float) -> dict[str, Any]:
    values, radius = _extra(s, 1)
    shape = {"kind": "polynomial", "radius_mm": s.radius_mm, "conic": s.conic, "norm_radius_mm": radius * unit}
    return {**shape, "coefficients_mm": [v * unit for v in values]}


def _zernike(ordering: str) -> Callable[[ZmxSurface, float], dict[str, Any]]:
    def make(s: ZmxSurface, unit: float) -> dict[str, Any]:
        if any(s.parm.get(i, 0.0) for i in range(0, 14)):
            raise ValueError("a Zernike sag with further aspheric terms or an offset is not read")
        values, radius = _extra(s, 1)
        shape = {"kind": "zernike", "radius_mm": s.radius_mm, "conic": s.conic, "norm_radius_mm": radius * unit}
        return {**shape, "ordering": ordering, "coefficients_mm": [v * unit for v in values]}

    return make


def _qed(s: ZmxSurface, unit: float) -> dict[str, Any]:
    """Q-type asphere (Forbes 2007): extra data are its type (0: Q_bfs on a conic, 1: Q_con), the count of terms, the
    normalisation radius, the terms."""
    kind = {0.0: "qbfs", 1.0: "qcon"}.get(s.xdat.get(1, 0.0))
    if kind is None:
        raise ValueError("a Q-type asphere of another type than 0 (Q_bfs) or 1 (Q_con) is not read")
    count, radius = int(s.xdat.get(2, 0.0)), s.xdat.get(3, 1.0)
    if not 0 <= count <= 100:
        raise ValueError(f"{count} terms of a Q-type asphere")
    values = [unit * s.xdat.get(i + 4, 0.0) for i in range(count)]
    shape = {"kind": kind, "radius_mm": s.radius_mm, "conic": s.conic}
    return {**shape, "norm_radius_mm": unit * radius, "q_mm": values}


def _toroidal(s: ZmxSurface, unit: float) -> dict[str, Any]:
    if any(s.parm.get(i, 0.0) for i in range(9, 14)) or any(v for i, v in s.xdat.items() if i > 2):
        raise ValueError("a toroid with Zernike terms is not read")
    rotation = unit * s.parm.get(1, 0.0)
    terms = _lengths([s.parm.get(i, 0.0) for i in range(2, 9)], 2, 2, unit)
    if rotation == 0.0 and not terms:
        if not s.curvature:
            return {"kind": "plane"}
        return {"kind": "cylinder", "radius_mm": s.radius_mm, "conic": s.conic}
    shape = {"kind": "toroid", "radius_mm": s.radius_mm, "conic": s.conic, "terms": terms}
    return {**shape, "rotation_radius_mm": rotation or math.inf}


def _biconic(s: ZmxSurface, unit: float) -> dict[str, Any]:
    across = unit * s.parm.get(1, 0.0)
    return {
        "kind": "biconic",
        "radius_x_mm": across or math.inf,
        "radius_y_mm": s.radius_mm,
        "conic_x": s.parm.get(2, 0.0),
        "conic_y": s.conic,
    }


def _paraxial(s: ZmxSurface, unit: float) -> dict[str, Any]:
    focal = unit * s.parm.get(1, 0.0)
    if not focal:
        raise ValueError("an ideal lens of focal length 0")
    return {"kind": "paraxial", "focal_length_mm": focal}


def _break(s: ZmxSurface, unit: float) -> dict[str, Any]:
    p = [s.parm.get(i, 0.0) for i in range(7)]
    shape: dict[str, Any] = {"kind": "coordinate_break"}
    if any(p[1:3]):
        shape["decentre_mm"] = [unit * p[1], unit * p[2]]
    if any(p[3:6]):
        shape["tilt_deg"] = p[3:6]
    if p[6]:
        return {**shape, "axes": "fixed", "first": "tilt"}
    return {**shape, "axes": "moving", "first": "decentre"}


SURFACE_KINDS: dict[str, Callable[[ZmxSurface, float], dict[str, Any]]] = {
    "STANDARD": _standard,
    "EVENASPH": _even_asphere,
    "ODDASPHE": _odd_asphere,
    "XASPHERE": _extended_even,
    "XOSPHERE": _extended_odd,
    "XPOLYNOM": _polynomial,
    "SZERNSAG": _zernike("noll"),
    "FZERNSAG": _zernike("fringe"),
    "QED_TYPE": _qed,
    "TOROIDAL": _toroidal,
    "BICONICX": _biconic,
    "PARAXIAL": _paraxial,
    "COORDBRK": _break,
}
"""Kinds that are read, by their name in the file."""
