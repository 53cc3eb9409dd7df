"""Tables of the page of a lens."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from experiments.harness.tables import Column, Table
from optics.lens_study import SHOWN, Study, white_rms_mm

_SHOWN_KEYS = {
    "kind", "radius_mm", "thickness_mm", "medium", "semi_diameter_mm", "conic", "inner_semi_diameter_mm", "stop",
}  # fmt: skip


def _finite(value: Any) -> Any:
    return value if value is None or math.isfinite(value) else "∞"


def _prescription(study: Study) -> Table:
    rows = []
    tables = study.file.tables["surface"]
    labels = study.file.labels or [str(number) for number in range(len(tables))]
    for label, table in zip(labels, tables, strict=True):
        rest = ", ".join(f"{k} {_words(v)}" for k, v in table.items() if k not in _SHOWN_KEYS)
        radius = table.get("radius_mm")
        rows.append(
            (
                f"{label.removeprefix('surface ')}{' stop' if table.get('stop') else ''}",
                table.get("kind", ""),
                "" if radius is None else f"{radius:.8g}" if math.isfinite(radius) else "∞",
                f"{table.get('thickness_mm', 0.0):.8g}",
                table.get("medium", ""),
                f"{table['semi_diameter_mm']:.6g}" if math.isfinite(table.get("semi_diameter_mm", math.inf)) else "",
                f"{table['conic']:.8g}" if table.get("conic") else "",
                rest,
            )
        )
    heads = ("surface", "kind", "radius [mm]", "thickness [mm]", "medium", "semi-diameter [mm]", "conic", "further")
    return Table(
        columns=heads,
        rows=rows,
        caption=f"Prescription in the order of the light, counted {'by the file' if study.file.labels else 'from 0'}.",
    )


def _words(value: Any) -> str:
    if isinstance(value, list | tuple):
        return "[" + ", ".join(_words(v) for v in value) + "]"
    if isinstance(value, dict):
        if "kind" in value:
            size = ", ".join(f"{k} {_words(v)}" for k, v in value.items() if k not in ("kind", "obscures"))
            return f"{value['kind']}{' that obscures' if value.get('obscures') else ''}, {size}"
        return "{" + ", ".join(f"{k} {_words(v)}" for k, v in value.items()) + "}"
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def _first_order(study: Study) -> Table:
    first = study.first_order
    assert first is not None
    rows = [
        ("focal length (EFL)", first.efl_mm, "mm"),
        ("back focus (BFL)", first.bfl_mm, "mm"),
        ("F-number", first.f_number, ""),
        ("entrance pupil, diameter", 2.0 * first.entrance_pupil_radius_mm, "mm"),
        ("entrance pupil, z from the first vertex", first.entrance_pupil_z_mm, "mm"),
        ("exit pupil, diameter", 2.0 * first.exit_pupil_radius_mm, "mm"),
        ("half field", study.file.lens.max_field_deg, "°"),
    ]
    caption = (
        f"First-order data at {first.wavelength_nm:g} nm, along the axis as mirrors turn it; other tilts and decentres "
        "do not count."
    )
    return Table(
        columns=("quantity", "value", "unit"),
        rows=[(name, f"{value:.6g}" if math.isfinite(value) else "∞", unit) for name, value, unit in rows],
        caption=caption,
    )


def _fields(study: Study) -> Table:
    rms = white_rms_mm(study)
    performance = study.performance
    area = None if study.spots is None else study.spots.area_mm2.sum(axis=(1, 2))
    rows: list[Any] = [
        (
            float(field),
            None if rms is None or not np.isfinite(rms[at]) else float(1e3 * rms[at]),
            *((None, None) if study.focus is None else (_finite(float(1e3 * focus)) for focus in study.focus[at])),
            None if performance is None else float(100.0 * performance.distortion[at]),
            None if area is None or not area[0] > 0.0 else float(100.0 * area[at] / area[0]),
        )
        for at, field in enumerate(study.field_deg)
    ]
    columns = (
        Column(name="field", unit="°"),
        Column(name="RMS spot", unit="µm", format=".2f"),
        Column(name="focus along", unit="µm", format=".1f"),
        Column(name="focus across", unit="µm", format=".1f"),
        Column(name="distortion", unit="%", format=".4f"),
        Column(name="beam area", unit="%", format=".1f"),
    )
    return Table(
        columns=columns, rows=rows, caption="Over the field: all wavelengths, weighted; beam against the axis."
    )


_ZERNIKE_NAMES = (
    "piston", "tilt along", "tilt across", "defocus", "astigmatism 45°", "astigmatism 0°", "coma across", "coma along",
    "trefoil across", "trefoil along", "spherical", "second astigmatism 0°", "second astigmatism 45°",
    "tetrafoil 0°", "tetrafoil 22.5°",
)  # fmt: skip


def _wavefront(study: Study) -> dict[str, Table]:
    """Strehl ratios with errors of the wavefront, and its Zernike coefficients."""
    waves = study.waves
    assert waves is not None
    columns = [Column(name=f"{study.field_deg[at]:.3g}°", format=".4f") for at in SHOWN]
    rows: list[Any] = [
        ("Strehl ratio", *(waves.images.strehl if waves.images else [None] * len(SHOWN))),
        ("exp(-(2π σ)²) (Maréchal)", *(error.marechal for error in waves.wavefront)),
        ("RMS σ [waves]", *(error.rms_waves for error in waves.wavefront)),
        ("peak to valley [waves]", *(error.peak_to_valley_nm / error.wavelength_nm for error in waves.wavefront)),
    ]
    zernike: list[Any] = [
        (f"{j + 1}", name, *(float(v) for v in waves.zernike_waves[:, j])) for j, name in enumerate(_ZERNIKE_NAMES) if j
    ]
    return {
        "wavefront": Table(
            columns=(Column(name="in the plane of the file"), *columns),
            rows=rows,
            caption="Wavefront at the design wavelength, tilt removed.",
        ),
        "zernike": Table(
            columns=(Column(name="j"), Column(name="term"), *columns),
            rows=zernike,
            caption="Zernike coefficients (Noll, orthonormal) [waves]; positive: light is late.",
        ),
    }


def _report(study: Study) -> dict[str, Table]:
    report = study.file.report
    assert report is not None
    heads = ("line", "surface", "command", "became", "meaning")
    lines = [
        (f"{e.line or '–'}", "" if e.surface is None else f"{e.surface}", e.command, str(e.status), e.message)
        for e in report.lines
    ]
    inexact = [row for row, entry in zip(lines, report.lines, strict=True) if not entry.exact]
    compared = []
    for row in report.comparisons:
        values = ("" if v is None or not math.isfinite(v) else f"{v:.8g}" for v in (row.computed, row.stated))
        compared.append((row.name, row.unit, *values, row.source))
    glasses = [
        (g.asked, g.taken, g.where, str(g.status), g.change_text if any(g.change or (1.0,)) else "none")
        for g in report.glasses
    ]
    return {
        "import": Table(columns=heads, rows=lines, caption="Every command of the file."),
        "inexact": Table(columns=heads, rows=inexact, caption="Lines that were approximated or ignored."),
        "compared": Table(
            columns=("quantity", "unit", "computed", "stated", "where"),
            rows=compared,
            caption="Computed and stated values; as in design programs, thicknesses are added without tilts "
            "and decentres.",
        ),
        "glasses": Table(
            columns=("in the file", "taken", "from", "became", "change"),
            rows=glasses,
            caption="Glasses; change of index: glass used minus glass of the file.",
        ),
    }


def tables(study: Study) -> dict[str, Table]:
    """Every table by name."""
    by_name = {"prescription": _prescription(study), "fields": _fields(study)}
    if study.first_order is not None:
        by_name["first_order"] = _first_order(study)
    if study.waves is not None:
        by_name |= _wavefront(study)
    return by_name | (_report(study) if study.file.report is not None else {})
