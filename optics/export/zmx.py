"""Writer of Zemax OpticStudio's sequential files (.zmx)."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from optics.errors import ConfigError
from optics.export.sequence import Break, Element, Sequence, safe_name
from optics.lens.tables import MIRROR, SurfaceTable
from optics.lens_file import LensFile

Made = tuple[str, float, float, dict[int, float], dict[int, float]]
"""Kind, curvature, conic constant, parameters, extra data."""


def _curvature(table: Any, key: str = "radius_mm") -> float:
    return 1.0 / getattr(table, key)


def _even(table: Any) -> Made:
    terms = [0.0, *table.asphere]
    if len(terms) <= 8:
        return "EVENASPH", _curvature(table), table.conic, dict(enumerate(terms, 1)), {}
    return "XASPHERE", _curvature(table), table.conic, {}, {1: len(terms), 2: 1.0, **dict(enumerate(terms, 3))}


def _odd(table: Any) -> Made:
    extra = {1: float(len(table.terms)), 2: 1.0, **dict(enumerate(table.terms, 3))}
    return "XOSPHERE", _curvature(table), table.conic, {}, extra


def _expansion(kind: str) -> Callable[[Any], Made]:
    def make(table: Any) -> Made:
        values = table.coefficients_mm
        extra = {1: float(len(values)), 2: table.norm_radius_mm, **dict(enumerate(values, 3))}
        return kind, _curvature(table), table.conic, {}, extra

    return make


def _forbes(table: Any) -> Made:
    extra = {
        1: float(table.kind == "qcon"),
        2: float(len(table.q_mm)),
        3: table.norm_radius_mm,
        **dict(enumerate(table.q_mm, 4)),
    }
    return "QED_TYPE", _curvature(table), table.conic, {}, extra


def _toroid(table: Any) -> Made:
    rotation = 0.0 if math.isinf(table.rotation_radius_mm) else table.rotation_radius_mm
    return "TOROIDAL", _curvature(table), table.conic, {1: rotation, **dict(enumerate(table.terms, 2))}, {}


def _biconic(table: Any) -> Made:
    across = 0.0 if math.isinf(table.radius_x_mm) else table.radius_x_mm
    return "BICONICX", _curvature(table, "radius_y_mm"), table.conic_y, {1: across, 2: table.conic_x}, {}


_KINDS: dict[str, Callable[[Any], Made]] = {
    "plane": lambda t: ("STANDARD", 0.0, 0.0, {}, {}),
    "sphere": lambda t: ("STANDARD", _curvature(t), 0.0, {}, {}),
    "conic": lambda t: ("STANDARD", _curvature(t), t.conic, {}, {}),
    "even_asphere": _even,
    "odd_asphere": _odd,
    "qbfs": _forbes,
    "qcon": _forbes,
    "polynomial": _expansion("XPOLYNOM"),
    "cylinder": lambda t: ("TOROIDAL", _curvature(t), t.conic, {}, {}),
    "toroid": _toroid,
    "biconic": _biconic,
    "paraxial": lambda t: ("PARAXIAL", 0.0, 0.0, {1: t.focal_length_mm}, {}),
}


def _shape(table: SurfaceTable) -> Made:
    if table.kind == "zernike":
        ordering = "SZERNSAG" if table.ordering == "noll" else "FZERNSAG"  # type: ignore[attr-defined]
        return _expansion(ordering)(table)
    if table.kind not in _KINDS:
        raise ConfigError(f"a surface of kind {table.kind!r} cannot be written as .zmx")
    return _KINDS[table.kind](table)


def _aperture(table: SurfaceTable) -> list[str]:
    lines = []
    finite = math.isfinite(table.semi_diameter_mm)
    if finite:
        lines.append(f'  DIAM {table.semi_diameter_mm!r} 1 0 0 1 ""')
    if table.inner_semi_diameter_mm:
        lines.append(f"  CLAP {table.inner_semi_diameter_mm!r} {table.semi_diameter_mm if finite else 1e9!r} 0")
    if len(table.aperture) + bool(table.inner_semi_diameter_mm) > 1:
        raise ConfigError(".zmx allows a single aperture per surface; this lens has a surface with several")
    for outline in table.aperture:
        made: Any = outline.aperture()
        if made.angle_deg:
            raise ConfigError("a rotated aperture cannot be written as .zmx")
        letter = "OB" if made.obscures else "AP"
        if made.kind == "circle":
            lines.append(f"  OBSC 0 {made.radius_mm!r} 0" if made.obscures else f"  CLAP 0 {made.radius_mm!r} 0")
        elif made.kind in ("rectangle", "ellipse"):
            name = ("SQ" if made.kind == "rectangle" else "EL") + letter
            lines.append(f"  {name} {made.half_width_mm[0]!r} {made.half_width_mm[1]!r} 0")
        elif made.kind == "spider":
            lines.append(f"  SPID {made.width_mm!r} {made.arms} 0")
        else:
            raise ConfigError(f"an aperture of kind {made.kind!r} cannot be written as .zmx")
        if any(made.centre_mm):
            lines.append(f"  OBDC {made.centre_mm[0]!r} {made.centre_mm[1]!r}")
    return lines


def _surface(item: Element) -> list[str]:
    table = item.table
    kind, curvature, conic, parm, extra = _shape(table)
    lines = ["  STOP"] if table.stop else []
    lines += [f"  TYPE {kind}", f'  CURV {curvature!r} 0 0 0 0 ""']
    lines += [f"  PARM {i} {v!r}" for i, v in parm.items()]
    lines += [f'  XDAT {i} {v!r} 0 0 1 0 0 ""' for i, v in extra.items()]
    lines.append(f"  DISZ {item.thickness_mm!r}")
    if table.medium == MIRROR:
        lines.append("  GLAS MIRROR 0 0 1.5 40 0 0 0 0 0 0")
    elif table.medium != "air":
        lines.append(f"  GLAS {safe_name(table.medium)} 0 0 1.5 40 0 0 0 0 0 0")
    return lines + ([f"  CONI {conic!r}"] if conic else []) + _aperture(table)


def _break(item: Break) -> list[list[str]]:
    """One or two coordinate breaks: they shift along x and y only, a shift along z is a thickness."""
    (x, y, z), turn = item.shift_mm, item.turn_deg
    values = [-v for v in (x, y, *turn)] if item.inverse else [x, y, *turn]
    lines = ["  TYPE COORDBRK"] + [f"  PARM {i} {v!r}" for i, v in enumerate(values, 1)]
    lines.append(f"  PARM 6 {int(item.inverse)}")
    if item.inverse:
        return [[*lines, f"  DISZ {item.thickness_mm - z!r}"]]
    first = [["  TYPE COORDBRK", "  PARM 6 0", f"  DISZ {z!r}"]] if z else []
    return [*first, [*lines, f"  DISZ {item.thickness_mm!r}"]]


def zmx_text(file: LensFile, made: Sequence, catalogues: tuple[str, ...]) -> str:
    """A lens as a .zmx file."""
    lens, defaults = file.lens, file.defaults
    waves = [(lens.design_wavelength_nm, 1.0)]
    fields = [(0.0, part * lens.max_field_deg, 1.0) for part in (0.0, 0.7, 1.0)]
    primary = 1
    if defaults is not None:
        waves = list(zip(defaults.wavelength_nm, defaults.wavelength_weight, strict=True))
        primary = 1 + min(range(len(waves)), key=lambda i: abs(waves[i][0] - lens.design_wavelength_nm))
        points = zip(defaults.field_deg, defaults.field_weight, strict=True)
        fields = [(float(f[0]), float(f[1]), float(w)) for f, w in points] or fields
    environment = lens.environment
    head = [
        "VERS 190513 80 123457 L123457",
        "MODE SEQ",
        f"NAME {' '.join(lens.name.split())}",
        f"NOTE 0 {' '.join(lens.source.split())}",
        "UNIT MM X W X CM MR CPMM",
        "FLOA",
        f"ENVD {environment.temperature_c!r} {environment.pressure_hpa / 1013.25!r} 1",
        f"GCAT {' '.join(catalogues)}".rstrip(),
        f"FTYP 0 0 {len(fields)} {len(waves)} 0 0 0",
        *(f"{key} {' '.join(repr(f[i]) for f in fields)}" for i, key in enumerate(("XFLN", "YFLN", "FWGN"))),
        *(f"WAVM {i} {1e-3 * float(w)!r} {float(weight)!r}" for i, (w, weight) in enumerate(waves, 1)),
        f"PWAV {primary}",
    ]
    blocks = [["  TYPE STANDARD", "  CURV 0.0", "  DISZ INFINITY"]]
    for item in made.items:
        blocks.extend(_break(item) if isinstance(item, Break) else [_surface(item)])
    blocks.append(["  TYPE STANDARD", "  CURV 0.0", "  DISZ 0"])
    for number, block in enumerate(blocks):
        head += [f"SURF {number}", *block]
    return "\n".join(head) + "\n"
