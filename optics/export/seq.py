"""Writer of CODE V sequence files (.seq)."""

from __future__ import annotations

import math
from typing import Any

from optics.errors import ConfigError
from optics.export.sequence import Break, Element, Sequence, design_data, safe_name
from optics.lens.system import AMBIENT
from optics.lens.tables import MIRROR, SurfaceTable
from optics.lens_file import LensFile

_LETTERS = "ABCDEFGHJ"


def _radius(value: float) -> str:
    return "0.0" if math.isinf(value) else repr(value)


def _shape(table: Any) -> tuple[str, list[str]]:
    """Radius and the further commands of a surface."""
    if table.kind == "plane":
        return "0.0", []
    if table.kind in ("sphere", "conic"):
        return _radius(table.radius_mm), ["CON", f"K {table.conic!r}"] if table.kind == "conic" else []
    if table.kind == "even_asphere" and len(table.asphere) <= len(_LETTERS):
        terms = [f"{letter} {value!r}" for letter, value in zip(_LETTERS, table.asphere, strict=False)]
        return _radius(table.radius_mm), ["ASP", f"K {table.conic!r}", *terms]
    if table.kind == "odd_asphere":
        terms = [f"SCO C{i} {value!r}" for i, value in enumerate(table.terms, 2)]
        return _radius(table.radius_mm), ["SPS ODD", f"SCO C1 {table.conic!r}", *terms]
    if table.kind == "cylinder":
        return _radius(table.radius_mm), ["CYL", f"K {table.conic!r}"]
    if table.kind == "biconic" and table.conic_x == table.conic_y:
        return _radius(table.radius_y_mm), [f"RDX {_radius(table.radius_x_mm)}", f"K {table.conic_y!r}"]
    raise ConfigError(f"a surface of kind {table.kind!r} cannot be written as .seq")


def _aperture(table: SurfaceTable) -> list[str]:
    lines = [f"CIR {table.semi_diameter_mm!r}"] if math.isfinite(table.semi_diameter_mm) else []
    if table.inner_semi_diameter_mm:
        lines.append(f"CIR HOL {table.inner_semi_diameter_mm!r}")
    centres = set()
    for outline in table.aperture:
        shape: Any = outline.aperture()
        centres.add(tuple(shape.centre_mm))
        if shape.kind == "circle" and shape.obscures:
            lines.append(f"CIR OBS {shape.radius_mm!r}")
        elif shape.kind in ("rectangle", "ellipse") and not shape.obscures and not shape.angle_deg:
            x, y = ("REX", "REY") if shape.kind == "rectangle" else ("ELX", "ELY")
            lines += [f"{x} {shape.half_width_mm[0]!r}", f"{y} {shape.half_width_mm[1]!r}"]
        elif shape.kind == "circle" and not math.isfinite(table.semi_diameter_mm):
            lines.append(f"CIR {shape.radius_mm!r}")
        else:
            raise ConfigError(f"an aperture of kind {shape.kind!r} cannot be written as .seq")
    if len(centres) > 1 or (any(any(c) for c in centres) and math.isfinite(table.semi_diameter_mm)):
        raise ConfigError(".seq allows a single centre for the apertures of a surface")
    for x, y in centres:
        lines += [f"ADX {x!r}", f"ADY {y!r}"] if x or y else []
    return lines


def seq_text(file: LensFile, sequence: Sequence, catalogue: str, entrance_pupil_mm: float) -> str:
    """A lens as a .seq file."""
    lens = file.lens
    waves, weights, reference, fields = design_data(file)
    lines = [
        'RDM;LEN "lens"',
        f"TITLE '{lens.name.replace(chr(39), ' ')}'",
        f"EPD {entrance_pupil_mm!r}",
        "DIM M",
        f"WL {' '.join(map(repr, waves))}",
        f"REF {reference}",
        f"WTW {' '.join(map(repr, weights))}",
        f"XAN {' '.join(repr(f[0]) for f in fields)}",
        f"YAN {' '.join(repr(f[1]) for f in fields)}",
        f"TEM {lens.environment.temperature_c!r}",
        "SO 0.0 0.1e14",
    ]
    medium = ""
    for item in sequence.items:
        if isinstance(item, Break):
            lines.extend(_break(item, medium))
        elif item.table.medium == MIRROR:
            lines.extend(_surface(item, " REFL"))
        else:
            name = item.table.medium
            maker = catalogue if name in sequence.file_glasses else lens.glasses[name].maker if name != AMBIENT else ""
            medium = f" {safe_name(name)}_{maker}" if name != AMBIENT else ""
            lines.extend(_surface(item, medium))
    return "\n".join([*lines, "SI 0.0 0.0", "GO"]) + "\n"


def _surface(item: Element, medium: str) -> list[str]:
    table = item.table
    radius, commands = _shape(table)
    lines = [f"S {radius} {item.thickness_mm!r}{medium}", *(["STO"] if table.stop else []), *commands]
    return lines + _aperture(table)


def _break(item: Break, medium: str) -> list[str]:
    """A dummy plane that carries the move; alpha and beta are left-handed in these files."""
    a, b, c = item.turn_deg
    values = zip(("XDE", "YDE", "ZDE", "ADE", "BDE", "CDE"), (*item.shift_mm, -a, -b, c), strict=True)
    moves = [f"{key} {value!r}" for key, value in values if value]
    reverse = ["REV"] if item.inverse and moves else []
    return [f"S 0.0 {item.thickness_mm!r}{medium}", *reverse, *moves]
