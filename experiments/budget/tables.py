"""Tables of the budget, for the report and as ECSV files."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from experiments.budget.combine import SUMS, TERMS
from experiments.harness.pivot import Pivot, pivot
from experiments.harness.quantities import Outcome
from experiments.harness.summary import Measured
from experiments.harness.tables import Cell, Column, Table

__all__ = ["tables"]

SWEPT = (*TERMS[:-1], "total")
"""What tables and figures of a sweep show."""


def tables(outcome: Outcome) -> Mapping[str, Table | Pivot]:
    """Tables by the name of their file."""
    upper = outcome.data.assign_coords(axis_label=("axis", ["X", "Y"]))
    made: dict[str, Table | Pivot] = {
        "budget": _budget(outcome),
        "printed_slips": _slips(outcome),
        "parts": _parts(outcome),
        "chromatic": pivot(
            upper,
            Pivot(
                rows="pair axis",
                columns="predicted_table1_px measured_table1_px rms_shift_px",
                caption="Chromatic term: mean shift between filters, halved (ACC18 eq. 16), signed.",
            ),
        ),
        "tolerances": _tolerances(outcome),
        "attitude": _attitude(outcome),
        "attitude_curve": Pivot(
            rows="stars",
            across="component",
            columns=" ".join(str(name) for name in outcome.data.data_vars if str(name).startswith("curve_")),
            caption="Attitude error against the number of stars, 3 sigma.",
        ),
    }
    if outcome.result.sweep is not None:
        made["sweep"] = _sweep(outcome)
    if outcome.result.tornado is not None:
        made["tornado"] = _tornado(outcome)
    if outcome.result.changed:
        made["changed"] = _changed(outcome)
    return made


def _columns(outcome: Outcome, names: str) -> list[Column]:
    """Columns of single quantities, with heads of their own."""
    return list(pivot(outcome.data, Pivot(columns=names, rows="term axis")).heads[2:])


def _budget(outcome: Outcome) -> Table:
    """Predicted, measured, published; words where there is no ratio."""
    rows: list[tuple[Cell, ...]] = []
    for label, name in zip(outcome.names("term"), outcome.data["term"].values.tolist(), strict=True):
        for axis in "xy":
            at = {"term": name, "axis": axis}
            cells = [outcome.value(f"{column}_arcsec", **at) for column in ("predicted", "measured", "published")]
            ratio: Cell = outcome.value("ratio", **at)
            if name == "LSFE-C2":
                ratio = "input"
            elif not np.isfinite(outcome.values("ratio", **at)):
                ratio = "none found"
            rows.append((label, outcome.value("ecss", term=name), axis, *cells, ratio))
    return Table(
        columns=(
            "Term",
            Column(name=outcome.heading("ecss"), key="ecss"),
            "Axis",
            *_columns(outcome, "predicted_arcsec measured_arcsec published_arcsec ratio"),
        ),
        rows=rows,
        caption="The budget, 3 sigma; uncertainties are one standard deviation of that number.",
        note="“none found”: a statistic that is zero for a centred lens. What is measured there is noise without its "
        "sign, and a ratio of two zeros means nothing; the criteria compare the signed entries of Table 1 with their "
        "prediction instead. Published: as printed.",
    )


def _slips(outcome: Outcome) -> Table:
    """The sums as printed, and as the document's equations give them."""
    equations = ("eq. 31 from the printed S, C1, C2", "eq. 32", "total / √10")
    labels = dict(zip(outcome.data["term"].values.tolist(), outcome.names("term"), strict=True)) | {
        "attitude": "attitude"
    }
    rows: list[tuple[Cell, ...]] = []
    for name, equation in zip(SUMS, equations, strict=True):
        for axis in "xy":
            at = {"term": name, "axis": axis}
            printed, value = outcome.value("published_arcsec", **at), outcome.value("by_equations_arcsec", **at)
            agrees = abs(value - printed) <= 0.0051
            rows.append((labels[name], equation, axis, printed, value, "agrees" if agrees else "slip in print"))
    return Table(
        columns=(
            "Sum",
            "By",
            "Axis",
            Column(name="Printed", unit="″", key="printed_arcsec", format=".2f"),
            Column(name="Recomputed", unit="″", key="recomputed_arcsec", format=".3f"),
            "Judgement",
        ),
        rows=rows,
        caption="The document's own arithmetic.",
        note="0.91″ is 0.41 + 0.50, the y value of C1 with the marking error. The printed total of 1.76″ needs 0.79″.",
    )


def _parts(outcome: Outcome) -> Table:
    """What the terms are made of: predicted x and y, measured x and y where there is such a number."""
    nothing = np.full(2, np.nan)
    parts: list[tuple[str, Any, Any]] = [("TE: Cramér-Rao bound", outcome.values("bound_te_arcsec"), nothing)]
    for cause in outcome.names("cause"):
        parts.append((f"HSFE: {cause}", outcome.values("cause_arcsec", cause=cause), nothing))
    both = ("predicted", "measured")
    for label, name in (
        ("HSFE of one position, temporal noise removed", "single"),
        ("σ_d: residual found", "found"),
        ("σ_Dd: left by the polynomial", "left"),
    ):
        predicted, measured = (outcome.values(f"{side}_{name}_arcsec") for side in both)
        parts.append((label, predicted, measured))
    predicted, measured = (outcome.values(f"{side}_arcsec", term="LSFE-C1") for side in both)
    parts.append(("σ_C1: removed by the polynomial (in the budget)", predicted, measured))
    x, y = outcome.values("survey_scatter_arcsec")
    return Table(
        columns=(
            "Part",
            *(
                Column(name=f"{side.capitalize()} {axis}", unit="″", key=f"{side}_{axis}_arcsec", format=".3f")
                for side in both
                for axis in "xy"
            ),
        ),
        rows=[(label, *_cells(predicted), *_cells(measured)) for label, predicted, measured in parts],
        caption="What the terms are made of, 3 sigma.",
        note=f"C1 is the RMS over {outcome.config.grid.surveys} surveys of the target; a single one scatters by "
        f"{x:.2f}″ (x) and {y:.2f}″ (y).",
    )


def _cells(values: Any) -> list[Cell]:
    """Plain numbers for cells; None for NaN."""
    return [float(v) if np.isfinite(v) else None for v in np.ravel(values)]


def _sweep(outcome: Outcome) -> Table:
    """The budget at every value of a parameter, at full precision."""
    sweep = outcome.result.sweep
    predicted = np.stack([outcome.values("sweep_predicted_arcsec", term=name) for name in SWEPT], axis=1)
    windows = outcome.values("sweep_window_px").tolist()
    rows: list[list[Cell]] = [
        [float(value), window, *_cells(numbers)]
        for value, window, numbers in zip(outcome.values("sweep_value"), windows, predicted, strict=True)
    ]
    columns = [
        Column(name=sweep.key, key="value", format=".5g"),
        Column(name="Window", unit="px", key="window_px"),
    ]
    for name in SWEPT:
        key = name.lower().replace("-", "_")
        columns += [Column(name=f"{name} {a}", unit="″", key=f"{key}_{a}", format=".3f") for a in "xy"]
    if outcome.config.sweep_measured:
        columns += [Column(name=f"measured total {a}", unit="″", key=f"measured_total_{a}") for a in "xy"]
        rows = [[*row, *_measured_total(outcome, setting)] for setting, row in enumerate(rows)]
    if any(one.refusal for one in sweep.settings):
        columns.append(Column(name="Refused because", key="refusal"))
        rows = [[*row, one.refusal or None] for row, one in zip(rows, sweep.settings, strict=True)]
    return Table(columns=columns, rows=rows, caption=f"The budget against {sweep.key}, predicted, 3 sigma.")


def _measured_total(outcome: Outcome, setting: int) -> list[Cell]:
    """Measured total, x and y, of one value of the parameter."""
    if outcome.result.sweep.settings[setting].measured is None:
        return [None, None]
    total = outcome.data.sel(term="total").isel(setting=setting)
    pairs = zip(total["sweep_measured_arcsec"].values, total["sweep_measured_arcsec_error"].values, strict=True)
    return [Measured(value=float(value), unit="arcsec", uncertainty=float(error)) for value, error in pairs]


def _tornado(outcome: Outcome) -> Table:
    """Parameters, their ends, and the change of the total at both."""
    table = pivot(
        outcome.data,
        Pivot(rows="swing", hidden="swing", columns="swing_label swing_key swing_low swing_high"),
    )
    change = outcome.values("total_change_arcsec").transpose(0, 2, 1).reshape(-1, 4).tolist()
    ends = [
        Column(name=f"{axis}, {end}", unit="″", key=f"{axis}_{end}_arcsec", format="+.4f")
        for axis in "xy"
        for end in ("low", "high")
    ]
    return Table(
        columns=(*table.heads, *ends),
        rows=[(*row, *one) for row, one in zip(table.rows, change, strict=True)],
        caption="Change of the predicted total, 3 sigma, when one parameter moves by its tolerance.",
    )


def _tolerances(outcome: Outcome) -> Pivot:
    tolerance = outcome.config.tolerances
    return Pivot(
        rows="built_error axis",
        across="percentile",
        columns="design_arcsec built_arcsec",
        caption=f"{outcome.value('lenses')} lenses as built: the error that so many of them stay below, 3 sigma.",
        note=f"Chromatic: of all the light, by ray trace. {outcome.value('lost')} lenses were left out. "
        f"One sigma of every element: decentre {tolerance.decentre_um:g} µm and tilt "
        f"{tolerance.tilt_arcmin:g} arcmin per axis, despace {tolerance.despace_um:g} µm.",
    )


READINGS = {
    "independent": "LSFE independent from star to star",
    "as it is": "chromatic common, distortion a smooth map",
    "common": "all LSFE common to all stars",
}


def _attitude(outcome: Outcome) -> Table:
    """At N of the budget: readings of the low-frequency error, then stars in a part of the field only."""
    rule, relative = outcome.values("attitude_rule_arcsec"), outcome.value("attitude_uncertainty")
    cases = [(label, "whole field", outcome.values("attitude_arcsec", reading=key)) for key, label in READINGS.items()]
    cases += [
        (READINGS["independent"], name, outcome.values("layout_arcsec", layout=name))
        for name in outcome.names("layout")
        if name != "whole field"
    ]
    rows: list[tuple[Cell, ...]] = [
        (
            label,
            where,
            *(Measured(value=float(v), uncertainty=float(v) * relative) for v in values),
            *(values / rule).tolist(),
        )
        for label, where, values in cases
    ]
    components = outcome.names("component")
    return Table(
        columns=(
            "Low-frequency error",
            "Stars in",
            *(Column(name=name, unit="″", key=f"{name}_arcsec") for name in components),
            *(Column(name=f"{name} / rule", key=f"{name}_ratio", format=".2f") for name in components),
        ),
        rows=rows,
        caption=f"Attitude from {outcome.value('attitude_stars')} stars: {outcome.value('attitude_trials')} fields "
        "through the estimator, 3 sigma.",
        note="x, y: displacement of the boresight. Rule: total / √N; for roll also divided by the RMS distance of a "
        f"star from the middle of the field: {rule[0]:.3f}″, {rule[1]:.3f}″, {rule[2]:.2f}″.",
    )


def _changed(outcome: Outcome) -> Table:
    rows: list[tuple[Cell, ...]] = [
        (key, _text(was) if was is not None else "data file" if key.startswith("detector.") else "none", _text(now))
        for key, (was, now) in outcome.result.changed.items()
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
