"""Tables of the budget, for the report and as ECSV files."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from experiments.budget.combine import ECSS, PRINTED, TERMS
from experiments.budget.evaluate import as_measured
from experiments.budget.result import Result
from experiments.harness.summary import Measured
from experiments.harness.tables import Cell, Column, Table

__all__ = ["all_tables", "sweep_in_short"]

LABELS = {
    "TE": "TE",
    "HSFE": "HSFE",
    "LSFE-S": "LSFE-S, chromatic",
    "LSFE-C1": "LSFE-C1, distortion",
    "LSFE-C2": "LSFE-C2, marking",
    "LSFE": "LSFE (eq. 31)",
    "total": "total (eq. 32)",
    "attitude": "attitude",
}
SUMS = ("LSFE", "total", "attitude")


def _arcsec(name: str, key: str, format_spec: str = "") -> Column:
    return Column(name=name, unit="″", key=key, format=format_spec)


def _budget(result: Result) -> Table:
    rows: list[tuple[Cell, ...]] = []
    for name in (*TERMS, *SUMS):
        ratio, spread = result.ratio(name)
        for axis, letter in enumerate("xy"):
            given = name == "LSFE-C2"
            told: Cell = Measured(value=float(ratio[axis]), uncertainty=float(spread[axis]))
            if given or not np.isfinite(ratio[axis]):
                told = "input" if given else "none found"
            label = LABELS[name] if name != "attitude" else f"attitude, total / √{result.config.attitude.stars}"
            rows.append(
                (
                    label,
                    ECSS[name],
                    letter,
                    as_measured(result.predicted.budget[name], axis),
                    as_measured(result.measured.budget[name], axis),
                    float(PRINTED[name][axis] if name in PRINTED else result.published[name].arcsec[axis]),
                    told,
                )
            )
    return Table(
        columns=(
            "Term",
            Column(name="ECSS-E-ST-60-20C", key="ecss"),
            "Axis",
            _arcsec("Predicted", "predicted_arcsec"),
            _arcsec("Measured", "measured_arcsec"),
            _arcsec("Published", "published_arcsec", ".2f"),
            Column(name="Predicted / measured", key="ratio"),
        ),
        rows=rows,
        caption="The budget, 3 sigma; uncertainties are one standard deviation of that number.",
        note="“none found”: a statistic that is zero for a centred lens. What is measured there is noise without its "
        "sign, and a ratio of two zeros means nothing; the criteria compare the signed entries of Table 1 with their "
        "prediction instead. Published: as printed.",
    )


def _slips(result: Result) -> Table:
    p = result.published
    rows: list[tuple[Cell, ...]] = []
    for name, what in (
        ("LSFE", "eq. 31 from the printed S, C1, C2"),
        ("total", "eq. 32"),
        ("attitude", "total / √10"),
    ):
        for axis, letter in enumerate("xy"):
            value, printed = float(p[name].arcsec[axis]), PRINTED[name][axis]
            agrees = abs(value - printed) <= 0.0051
            rows.append((LABELS[name], what, letter, printed, value, "agrees" if agrees else "slip in print"))
    return Table(
        columns=(
            "Sum",
            "By",
            "Axis",
            _arcsec("Printed", "printed_arcsec", ".2f"),
            _arcsec("Recomputed", "recomputed_arcsec", ".3f"),
            "Judgement",
        ),
        rows=rows,
        caption="The document's own arithmetic.",
        note="0.91″ is 0.41 + 0.50, the y value of C1 with the marking error. The printed total of 1.76″ needs 0.79″.",
    )


def _parts(result: Result) -> Table:
    a, b = result.predicted, result.measured
    rows: list[tuple[Cell, ...]] = []

    def add(label: str, predicted: Any, measured: Any = None) -> None:
        seen = (None, None) if measured is None else (float(measured[0]), float(measured[1]))
        rows.append((label, float(predicted[0]), float(predicted[1]), *seen))

    add("TE: Cramér-Rao bound", a.bound_te_arcsec)
    for name, value in a.causes_arcsec.items():
        add(f"HSFE: {name}", value)
    add("HSFE of one position, temporal noise removed", a.single_arcsec, b.single_arcsec)
    add("σ_d: residual found", a.found_arcsec, b.found_arcsec)
    add("σ_Dd: left by the polynomial", a.left_arcsec, b.left_arcsec)
    add("σ_C1: removed by the polynomial (in the budget)", a.budget["LSFE-C1"].arcsec, b.budget["LSFE-C1"].arcsec)
    return Table(
        columns=(
            "Part",
            _arcsec("Predicted x", "predicted_x_arcsec", ".3f"),
            _arcsec("Predicted y", "predicted_y_arcsec", ".3f"),
            _arcsec("Measured x", "measured_x_arcsec", ".3f"),
            _arcsec("Measured y", "measured_y_arcsec", ".3f"),
        ),
        rows=rows,
        caption="What the terms are made of, 3 sigma.",
        note=f"C1 is the RMS over {result.config.grid.surveys} surveys of the target; a single one scatters by "
        f"{b.survey_scatter_arcsec[0]:.2f}″ (x) and {b.survey_scatter_arcsec[1]:.2f}″ (y).",
    )


def _table1(result: Result) -> Table:
    rows: list[tuple[Cell, ...]] = []
    a, b = result.predicted.chromatic, result.measured.chromatic
    for name in b.table1_px:
        for axis, letter in enumerate("XY"):
            measured = Measured(value=float(b.table1_px[name][axis]), uncertainty=float(b.sigma_px[name][axis]), n=b.n)
            rows.append((name, letter, float(a.table1_px[name][axis]), measured, float(b.rms_px[name][axis])))
    return Table(
        columns=(
            Column(name="Bands", unit="nm", key="bands"),
            "Axis",
            Column(name="Predicted", unit="px", key="predicted_px", format=".5f"),
            Column(name="Measured", unit="px", key="measured_px"),
            Column(name="RMS shift of a point", unit="px", key="rms_px", format=".4f"),
        ),
        rows=rows,
        caption="Chromatic term: mean shift between filters, halved (ACC18 eq. 16), signed.",
    )


def _sweep(result: Result) -> Table:
    assert result.sweep is not None
    rows: list[tuple[Cell, ...]] = []
    for one in result.sweep.settings:
        row: list[Cell] = [float(one.value), one.window_px]
        for name in (*TERMS[:-1], "total"):
            row += [None, None] if one.predicted is None else [float(v) for v in one.predicted[name].arcsec]
        if result.config.sweep_measured:
            values = one.measured.budget["total"] if one.measured is not None else None
            row += [None, None] if values is None else [as_measured(values, 0), as_measured(values, 1)]
        rows.append((*row, one.refusal or None))
    columns = [
        Column(name=result.sweep.key, key="value", format=".5g"),
        Column(name="Window", unit="px", key="window_px"),
    ]
    for name in (*TERMS[:-1], "total"):
        columns += [_arcsec(f"{name} {a}", f"{name.lower().replace('-', '_')}_{a}", ".3f") for a in "xy"]
    if result.config.sweep_measured:
        columns += [_arcsec(f"measured total {a}", f"measured_total_{a}") for a in "xy"]
    columns.append(Column(name="Refused because", key="refusal"))
    if not any(one.refusal for one in result.sweep.settings):
        columns, rows = columns[:-1], [row[:-1] for row in rows]
    return Table(columns=columns, rows=rows, caption=f"The budget against {result.sweep.key}, predicted, 3 sigma.")


def sweep_in_short(result: Result) -> Table:
    """The sweep with x and y in one cell, for the report."""
    assert result.sweep is not None
    names = (*TERMS[:-1], "total")
    rows: list[tuple[Cell, ...]] = []
    for one in result.sweep.settings:
        row: list[Cell] = [float(one.value), one.window_px]
        for name in names:
            row.append("–" if one.predicted is None else _both(one.predicted[name].arcsec))
        if result.config.sweep_measured:
            row.append("–" if one.measured is None else _both(one.measured.budget.total.arcsec))
        rows.append(tuple(row))
    columns = [Column(name=result.sweep.key, format=".5g"), Column(name="Window", unit="px")]
    columns += [Column(name=name, unit="″") for name in names]
    if result.config.sweep_measured:
        columns.append(Column(name="total, measured", unit="″"))
    return Table(
        columns=columns,
        rows=rows,
        caption=f"The budget against {result.sweep.key}, predicted, 3 sigma, x and y.",
        note="A dash: refused, see the text. Full precision in sweep.ecsv.",
    )


def _both(values: Any) -> str:
    return f"{float(values[0]):.3f}, {float(values[1]):.3f}"


def _tornado(result: Result) -> Table:
    assert result.tornado is not None
    rows: list[tuple[Cell, ...]] = []
    for swing in result.tornado.swings:
        change = swing.change("total", result.tornado.base)
        numbers = [float(v) for v in change.T.ravel()]
        label = f"{swing.label} [{swing.unit}]" if swing.unit else swing.label
        rows.append((label, swing.key, swing.low, swing.high, *numbers))
    return Table(
        columns=(
            "Parameter",
            "Key",
            Column(name="Low", format=".5g"),
            Column(name="High", format=".5g"),
            _arcsec("x, low", "x_low_arcsec", "+.4f"),
            _arcsec("x, high", "x_high_arcsec", "+.4f"),
            _arcsec("y, low", "y_low_arcsec", "+.4f"),
            _arcsec("y, high", "y_high_arcsec", "+.4f"),
        ),
        rows=rows,
        caption="Change of the predicted total, 3 sigma, when one parameter moves by its tolerance.",
    )


def _tolerances(result: Result) -> Table:
    built = result.tolerances
    rows: list[tuple[Cell, ...]] = []
    for label, values, design in (
        ("LSFE-S, chromatic", built.chromatic_arcsec, built.design_arcsec["chromatic"]),
        ("distortion, calibrated", built.distortion_arcsec, built.design_arcsec["distortion"]),
        ("both", built.lsfe_arcsec, np.hypot(built.design_arcsec["chromatic"], built.design_arcsec["distortion"])),
        ("distortion, moved after calibration", built.uncalibrated_arcsec, np.zeros(2)),
    ):
        for axis, letter in enumerate("xy"):
            quantiles = [float(v) for v in np.percentile(values[:, axis], [50, 90, 95, 99])]
            rows.append((label, letter, float(design[axis]), *quantiles))
    return Table(
        columns=(
            "Error",
            "Axis",
            _arcsec("Design", "design_arcsec", ".3f"),
            *(_arcsec(f"{p} %", f"p{p}_arcsec", ".3f") for p in (50, 90, 95, 99)),
        ),
        rows=rows,
        caption=f"{len(built.chromatic_arcsec)} lenses as built: the error that so many of them stay below, 3 sigma.",
        note=f"Chromatic: of all the light, by ray trace. {built.lost} lenses were left out. "
        f"One sigma of every element: decentre {result.config.tolerances.decentre_um:g} µm and tilt "
        f"{result.config.tolerances.tilt_arcmin:g} arcmin per axis, despace "
        f"{result.config.tolerances.despace_um:g} µm.",
    )


def _attitude(result: Result) -> Table:
    study = result.attitude
    rows: list[tuple[Cell, ...]] = []
    for label, key in (
        ("LSFE independent from star to star", "independent"),
        ("chromatic common, distortion a smooth map", "as it is"),
        ("all LSFE common to all stars", "common"),
    ):
        rows.append((label, "whole field", *_with_ratio(study.at[key], study.rule_at, study.relative_uncertainty)))
    for name, value in study.layout.items():
        if name != "whole field":
            ratio = _with_ratio(value, study.rule_at, study.relative_uncertainty)
            rows.append(("LSFE independent from star to star", name, *ratio))
    return Table(
        columns=(
            "Low-frequency error",
            "Stars in",
            _arcsec("x", "x_arcsec"),
            _arcsec("y", "y_arcsec"),
            _arcsec("roll", "roll_arcsec"),
            Column(name="x / rule", key="x_ratio", format=".2f"),
            Column(name="y / rule", key="y_ratio", format=".2f"),
            Column(name="roll / rule", key="roll_ratio", format=".2f"),
        ),
        rows=rows,
        caption=f"Attitude from {study.stars} stars: {study.trials} fields through the estimator, 3 sigma.",
        note="x, y: displacement of the boresight. Rule: total / √N; for roll also divided by the RMS distance of a "
        "star from the middle of the field: "
        f"{study.rule_at[0]:.3f}″, {study.rule_at[1]:.3f}″, {study.rule_at[2]:.2f}″.",
    )


def _with_ratio(value: Any, rule: Any, relative: float) -> list[Cell]:
    cells: list[Cell] = [Measured(value=float(v), uncertainty=float(v) * relative) for v in value]
    return [*cells, *(float(v / r) for v, r in zip(value, rule, strict=True))]


def _curve(result: Result) -> Table:
    study = result.attitude
    rows: list[tuple[Cell, ...]] = []
    for i, count in enumerate(study.counts):
        row: list[Cell] = [int(count)]
        for values in (study.rule, study.bound, *study.curve.values()):
            row += [float(v) for v in values[i]]
        rows.append(tuple(row))
    columns = [Column(name="Stars", key="stars")]
    for name in ("rule", "estimator", *study.curve):
        columns += [_arcsec(f"{name} {a}", f"{name.replace(' ', '_')}_{a}_arcsec", ".4g") for a in ("x", "y", "roll")]
    return Table(columns=columns, rows=rows, caption="Attitude error against the number of stars, 3 sigma.")


def _changed(result: Result) -> Table:
    rows: list[tuple[Cell, ...]] = [
        (key, _text(was) if was is not None else "data file" if key.startswith("detector.") else "none", _text(now))
        for key, (was, now) in result.changed.items()
    ]
    return Table(
        columns=(Column(name="Setting", key="setting"), "Default", Column(name="Here", key="here")),
        rows=rows,
        caption="Settings that differ from the defaults.",
    )


def _text(value: object) -> str:
    if isinstance(value, tuple | list) and len(value) > 4:
        return f"{len(value)} values"
    return f"{value:g}" if isinstance(value, float) else str(value)


def all_tables(result: Result) -> Mapping[str, Table]:
    """Tables by the name of their file."""
    made = {
        "budget": _budget(result),
        "printed_slips": _slips(result),
        "parts": _parts(result),
        "chromatic": _table1(result),
        "tolerances": _tolerances(result),
        "attitude": _attitude(result),
        "attitude_curve": _curve(result),
    }
    if result.sweep is not None:
        made["sweep"] = _sweep(result)
    if result.tornado is not None:
        made["tornado"] = _tornado(result)
    if result.changed:
        made["changed"] = _changed(result)
    return made
