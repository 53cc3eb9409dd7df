"""Writer of Zemax OpticStudio's sequential files (.zmx)."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from optics.errors import ConfigError
from optics.export.sequence import Break, Element, Sequence, design_data, safe_name
from optics.lens.tables import MIRROR, SurfaceTable
from optics.lens_file import LensFile

ZmxShape = tuple[str, float, float, dict[int, float], dict[int, float]]
"""Kind, curvature, conic constant, parameters, extra data."""


def _conic(table: Any, kind: str, parm: dict[int, float] | None = None, extra: list[float] | None = None) -> ZmxShape:
    """A conic with parameters and extra data; a plane where there is no radius, a sphere without conic constant."""
    curvature = 1.0 / table.radius_mm if hasattr(table, "radius_mm") else 0.0
    return kind, curvature, getattr(table, "conic", 0.0), parm or {}, dict(enumerate(extra or [], 1))


def _even(table: Any) -> ZmxShape:
    terms = [0.0, *table.asphere]
    if len(terms) <= 8:
        return _conic(table, "EVENASPH", dict(enumerate(terms, 1)))
    return _conic(table, "XASPHERE", extra=[len(terms), 1.0, *terms])


def _expansion(table: Any, kind: str) -> ZmxShape:
    values = table.coefficients_mm
    return _conic(table, kind, extra=[float(len(values)), table.norm_radius_mm, *values])


def _forbes(table: Any) -> ZmxShape:
    extra = [float(table.kind == "qcon"), float(len(table.q_mm)), table.norm_radius_mm, *table.q_mm]
    return _conic(table, "QED_TYPE", extra=extra)


def _finite(radius_mm: float) -> float:
    """A radius as the format writes it: 0 for infinity."""
    return 0.0 if math.isinf(radius_mm) else radius_mm


def _biconic(table: Any) -> ZmxShape:
    parm = {1: _finite(table.radius_x_mm), 2: table.conic_x}
    return "BICONICX", 1.0 / table.radius_y_mm, table.conic_y, parm, {}


_KINDS: dict[str, Callable[[Any], ZmxShape]] = {
    **dict.fromkeys(("plane", "sphere", "conic"), lambda t: _conic(t, "STANDARD")),
    "even_asphere": _even,
    "odd_asphere": lambda t: _conic(t, "XOSPHERE", extra=[float(len(t.terms)), 1.0, *t.terms]),
    **dict.fromkeys(("qbfs", "qcon"), _forbes),
    "polynomial": lambda t: _expansion(t, "XPOLYNOM"),
    "zernike": lambda t: _expansion(t, "SZERNSAG" if t.ordering == "noll" else "FZERNSAG"),
    "cylinder": lambda t: _conic(t, "TOROIDAL"),
    "toroid": lambda t: _conic(t, "TOROIDAL", {1: _finite(t.rotation_radius_mm), **dict(enumerate(t.terms, 2))}),
    "biconic": _biconic,
    "paraxial": lambda t: _conic(t, "PARAXIAL", {1: t.focal_length_mm}),
}


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
        shape: Any = outline.aperture()
        if shape.angle_deg:
            raise ConfigError("a rotated aperture cannot be written as .zmx")
        letter = "OB" if shape.obscures else "AP"
        if shape.kind == "circle":
            lines.append(f"  OBSC 0 {shape.radius_mm!r} 0" if shape.obscures else f"  CLAP 0 {shape.radius_mm!r} 0")
        elif shape.kind in ("rectangle", "ellipse"):
            name = ("SQ" if shape.kind == "rectangle" else "EL") + letter
            lines.append(f"  {name} {shape.half_width_mm[0]!r} {shape.half_width_mm[1]!r} 0")
        elif shape.kind == "spider":
            lines.append(f"  SPID {shape.width_mm!r} {shape.arms} 0")
        else:
            raise ConfigError(f"an aperture of kind {shape.kind!r} cannot be written as .zmx")
        if any(shape.centre_mm):
            lines.append(f"  OBDC {shape.centre_mm[0]!r} {shape.centre_mm[1]!r}")
    return lines


def _surface(item: Element) -> list[str]:
    table = item.table
    if table.kind not in _KINDS:
        raise ConfigError(f"a surface of kind {table.kind!r} cannot be written as .zmx")
    kind, curvature, conic, parm, extra = _KINDS[table.kind](table)
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


def zmx_text(file: LensFile, sequence: Sequence, catalogues: tuple[str, ...]) -> str:
    """A lens as a .zmx file."""
    lens, environment = file.lens, file.lens.environment
    waves, weights, primary, fields = design_data(file)
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
        *(f"WAVM {i + 1} {1e-3 * waves[i]!r} {weights[i]!r}" for i in range(len(waves))),
        f"PWAV {primary}",
    ]
    blocks = [["  TYPE STANDARD", "  CURV 0.0", "  DISZ INFINITY"]]
    for item in sequence.items:
        blocks.extend(_break(item) if isinstance(item, Break) else [_surface(item)])
    blocks.append(["  TYPE STANDARD", "  CURV 0.0", "  DISZ 0"])
    for number, block in enumerate(blocks):
        head += [f"SURF {number}", *block]
    return "\n".join(head) + "\n"
