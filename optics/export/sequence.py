"""A prescription in the form of design programs: surfaces and coordinate breaks in sequence, glasses by catalogue."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from scipy.spatial.transform import Rotation

from optics.arrays import FloatArray
from optics.errors import ConfigError, DomainError
from optics.glass.catalogue import Glass, get_glass
from optics.glass.dispersion import AGF_FORMULAS, Dispersion
from optics.lens.prescription import LocalFrame, glasses_of
from optics.lens.tables import MIRROR, BreakTable, MovedTable, Prescription, SurfaceTable
from optics.lens_file import LensFile

MAKERS = ("SCHOTT", "OHARA", "CDGM")
"""Glasses of these are in the catalogues of every design program under the same name."""


@dataclass(frozen=True, slots=True)
class Break:
    """A coordinate break: shift along the old axes [mm], then turns about x, the turned y, the turned z [deg].

    ``inverse`` undoes exactly that. It is followed by a thickness along the new z axis [mm].
    """

    shift_mm: tuple[float, float, float]
    turn_deg: tuple[float, float, float]
    thickness_mm: float
    inverse: bool = False


@dataclass(frozen=True, slots=True)
class Element:
    """A surface, with the thickness behind it in its frame [mm]."""

    table: SurfaceTable
    thickness_mm: float


@dataclass(frozen=True, slots=True)
class Sequence:
    """Surfaces and breaks in the order of the light, and glasses missing in makers' catalogues."""

    items: tuple[Break | Element, ...]
    file_glasses: dict[str, Glass]
    catalogues: tuple[str, ...]


def safe_name(name: str) -> str:
    """Name of a glass in formats that end words at blanks and quotes."""
    return "_".join(name.replace("'", "").replace('"', "").replace(";", "").replace("!", "").split()) or "GLASS"


def _break(moved: MovedTable, thickness_mm: float) -> Break | None:
    """The break of a table; None if it does nothing."""
    a, b, c = [*moved.tilt_deg, 0.0][:3]
    x, y, z = (float(s) for s in [*moved.decentre_mm, 0.0][:3])
    if not any((a, b, c, x, y, z, thickness_mm)):
        return None
    if moved.axes == "moving" and moved.first == "decentre":
        return Break((x, y, z), (a, b, c), thickness_mm)
    if moved.axes == "fixed" and moved.first == "tilt":
        return Break((-x, -y, -z), (-a, -b, -c), thickness_mm, inverse=True)
    pose = LocalFrame().moved(moved)
    x, y, z = (float(v) for v in pose.origin)
    return Break((x, y, z), _angles_deg(pose.axes), thickness_mm)


def _angles_deg(turn: FloatArray) -> tuple[float, float, float]:
    a, b, c = (float(v) for v in Rotation.from_matrix(turn).as_euler("XYZ", degrees=True))
    return a, b, c


def _bent(turn: FloatArray) -> tuple[float, float, float]:
    """Turn from a mirror's own frame to the one in which the axis is reflected: the mirror's turn once more."""
    return _angles_deg(turn.T @ LocalFrame().bent(turn[:, 2]).axes)


def _items(file: Prescription) -> list[Break | Element]:
    items: list[Break | Element] = []
    for table in file.surface:
        if isinstance(table, BreakTable):
            moved = _break(table, table.thickness_mm)
            items.extend([moved] if moved else [])
            continue
        before = _break(table, 0.0)
        if before is None:
            items.append(Element(table, table.thickness_mm))
            continue
        items.append(before)
        if table.carry == "forward":
            items.append(Element(table, table.thickness_mm))
        elif table.carry == "bend":
            items.append(Element(table, 0.0))
            items.append(Break((0.0, 0.0, 0.0), _bent(LocalFrame().moved(table).axes), table.thickness_mm))
        else:
            items.append(Element(table, 0.0))
            items.append(Break(before.shift_mm, before.turn_deg, table.thickness_mm, inverse=not before.inverse))
    image = _break(file.image, 0.0)
    return [*items, *([image] if image else [])]


def _with_stop(file: Prescription, items: list[Break | Element]) -> list[Break | Element]:
    """The items with a stop that is no surface of the file's list."""
    if file.stop is None:
        return items
    stop = {"kind": "plane", "thickness_mm": 0.0, "medium": "air", "stop": True}
    for key in ("semi_diameter_mm", "inner_semi_diameter_mm"):
        stop[key] = getattr(file.stop, key)
    plane = Prescription.model_validate({**file.model_dump(), "stop": None, "surface": [stop]}).surface[0]
    assert isinstance(plane, SurfaceTable)
    z, medium, before, at = 0.0, "air", -file.stop.z_mm, 0
    while at < len(items) and z < file.stop.z_mm:
        item = items[at]
        if isinstance(item, Break) or item.table.medium == MIRROR:
            raise ConfigError(
                "a separate [stop] behind a mirror or a coordinate break cannot be written; use stop = true"
            )
        medium, before = item.table.medium, file.stop.z_mm - z
        z, at = z + item.thickness_mm, at + 1
    alone = Element(plane.model_copy(update={"medium": medium}), z - file.stop.z_mm)
    if not at:
        return [alone, *items]
    last = items[at - 1]
    assert isinstance(last, Element)
    return [*items[: at - 1], Element(last.table, before), alone, *items[at:]]


def sequence(file: LensFile) -> Sequence:
    """The surfaces of a lens in the order of the light."""
    prescription = Prescription.model_validate(file.tables)
    items = _with_stop(prescription, _items(prescription))
    for i, item in enumerate(items):
        if isinstance(item, Break):
            continue
        if item.table.error is not None:
            raise ConfigError("a measured surface error cannot be written into this format")
        if item.table.stop:  # its radius may follow from [pupil]
            radius = {"semi_diameter_mm": file.lens.surfaces[file.lens.stop_index].semi_diameter_mm}
            items[i] = Element(item.table.model_copy(update=radius), item.thickness_mm)
    glasses = glasses_of(prescription)
    file_glasses = {name: glass for name, glass in glasses.items() if not _everywhere(name, glass)}
    makers = {glass.maker for name, glass in glasses.items() if name not in file_glasses}
    return Sequence(tuple(items), file_glasses, tuple(m for m in MAKERS if m in makers))


def design_data(file: LensFile) -> tuple[list[float], list[float], int, list[tuple[float, float, float]]]:
    """Wavelengths [nm], their weights, number of the reference wavelength, and fields (x, y [deg], weight)."""
    lens, defaults = file.lens, file.defaults
    fields = [(0.0, fraction * lens.max_field_deg, 1.0) for fraction in (0.0, 0.7, 1.0)]
    if defaults is None:
        return [lens.design_wavelength_nm], [1.0], 1, fields
    waves, weights = defaults.wavelength_nm.tolist(), defaults.wavelength_weight.tolist()
    reference = 1 + min(range(len(waves)), key=lambda i: abs(waves[i] - lens.design_wavelength_nm))
    points = zip(defaults.field_deg.tolist(), defaults.field_weight.tolist(), strict=True)
    return waves, weights, reference, [(x, y, weight) for (x, y), weight in points] or fields


def _everywhere(name: str, glass: Glass) -> bool:
    try:
        return glass.maker in MAKERS and get_glass(name) is glass
    except ConfigError:
        return False


def _agf_dispersion(glass: str, dispersion: Dispersion) -> tuple[int, list[float]]:
    """Number and coefficients of the same formula in AGF files."""
    formula, c = dispersion.formula, list(dispersion.coefficients)
    if formula == "shifted_sellmeier" and c[0] == 0.0:
        formula, c = "sellmeier", c[1:]
    if formula == "polynomial" and len(c) <= 2 and not any(c[1:]):
        formula, c = "conrady", [c[0], 0.0, 0.0]
    if formula == "square_polynomial":
        powers = dict(zip((0.0, *c[2::2]), (c[0], *c[1::2]), strict=True))
        order = (0, 2, 4, -2, -4, -6, -8, -10, -12)
        if not set(powers) - set(order):
            formula, c = "extended3", [powers.get(p, 0.0) for p in order]
    for number, (name, count) in AGF_FORMULAS.items():
        if name == formula and len(c) <= count:
            return number, [*c, *[0.0] * (count - len(c))]
    raise DomainError(f"glass {glass}: its formula {dispersion.formula!r} is not an AGF formula")


def agf_text(glasses: Mapping[str, Glass], title: str) -> str:
    """Glasses as an AGF catalogue."""
    lines = [f"CC {title}"]
    for name, glass in glasses.items():
        number, coefficients = _agf_dispersion(name, glass.dispersion)
        nd, vd = glass.nd or 0.0, glass.vd or 0.0
        lines.append(f"NM {safe_name(name)} {number} 0 {nd!r} {vd!r} 0 0")
        lines.append(f"ED {1e6 * (glass.cte_per_k or 0.0):.10g} 0 {glass.density_g_cm3 or 0.0:.10g} 0 0")
        lines.append("CD " + " ".join(map(repr, coefficients)))
        thermal = [0.0] * 6 if glass.dndt is None else glass.dndt.constants
        lines.append("TD " + " ".join(map(repr, [*thermal, glass.reference_temperature_c])))
        lines.append(f"LD {1e-3 * glass.range_nm[0]!r} {1e-3 * glass.range_nm[1]!r}")
        if glass.transmittance is not None:
            pairs = zip(glass.transmittance.wavelength_nm, glass.transmittance.value, strict=True)
            lines.extend(f"IT {1e-3 * w:.10g} {t:.10g} {glass.transmittance_mm:g}" for w, t in pairs)
    return "\n".join(lines) + "\n"
