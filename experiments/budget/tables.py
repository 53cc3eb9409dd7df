"""Tables of the budget, for the report and as ECSV files."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

import numpy as np

from experiments.budget.combine import FRAME_TERMS, SUMS, TERMS
from experiments.budget.thermal import ThermalTerm
from experiments.harness.pivot import Pivot, pivot
from experiments.harness.quantities import Outcome, shown_unit
from experiments.harness.summary import Measured
from experiments.harness.tables import Cell, Column, Table
from experiments.laboratory.collimator_effects import chromatic_table
from experiments.laboratory.published import chromatic_of_table1_arcsec

__all__ = ["sweep_table", "tables"]

SIDES = ("predicted", "measured")
SWEPT = (*TERMS[:-1], "total")
"""What tables and figures of a sweep show."""


def tables(outcome: Outcome) -> Mapping[str, Table | Pivot]:
    """Tables by the name of their file."""
    upper = outcome.data.assign_coords(axis_label=("axis", ["X", "Y"]))
    made: dict[str, Table | Pivot] = {
        "budget": _budget(outcome),
        "agreement": _agreement(outcome),
        **({"printed_slips": _slips(outcome)} if outcome.result.published is not None else {}),
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
    if outcome.result.collimator is not None:
        made["collimator"] = chromatic_table()
    if outcome.result.sweep is not None:
        made["sweep"] = sweep_table(outcome)
    if outcome.result.tornado is not None:
        made["tornado"] = Pivot(
            rows="swing",
            hidden="swing",
            across="axis end",
            columns="swing_label swing_key swing_low swing_high total_change_arcsec",
            caption="Change of the predicted total, 3 sigma, when one parameter moves by its tolerance.",
        )
    if isinstance(outcome.result.thermal, ThermalTerm):
        made["thermal"] = _thermal(outcome)
    if outcome.result.changed:
        made["changed"] = _changed(outcome)
    return made


def _columns(outcome: Outcome, names: str) -> list[Column]:
    """Columns as quantities describe them."""
    found = [outcome.quantity(name) for name in names.split()]
    return [Column(name=one.label, unit=shown_unit(one.unit), key=one.key, format=one.format) for one in found]


def _budget(outcome: Outcome) -> Table:
    """Published, then predicted and measured by every centroider."""
    beside = ["published_arcsec"] if outcome.result.published is not None else []
    methods = outcome.data["method"].values.tolist()
    labels = dict(zip(methods, outcome.names("method"), strict=True))
    rows: list[tuple[Cell, ...]] = []
    for label, name in zip(outcome.names("term"), outcome.data["term"].values.tolist(), strict=True):
        for axis in "xy":
            at = {"term": name, "axis": axis}
            cells = [
                outcome.value(f"method_{side}_arcsec", method=method, **at) for method in methods for side in SIDES
            ]
            rows.append((label, axis, *(outcome.value(name, **at) for name in beside), *cells))
    return Table(
        columns=(
            "Term",
            "Axis",
            *_columns(outcome, " ".join(beside)),
            *(
                Column(name=f"{labels[method]}: {side}", unit="″", key=f"{method}_{side}_arcsec")
                for method in methods
                for side in SIDES
            ),
        ),
        rows=rows,
        caption="The budget, 3 sigma, by centroider on the same frames; uncertainties are one standard deviation.",
        note=("Published: as printed. " if beside else "")
        + "C2 is an input. C1 is what the polynomial takes of the marking errors: "
        + ", ".join(f"{v:.3f}″" for v in outcome.values("marking_alone_arcsec"))
        + " (x, y) with a perfect camera. Predicted uncertainties of HSFE and C1 are the scatter from chip to chip.",
    )


def _agreement(outcome: Outcome) -> Table:
    """Predicted against measured of the terms that frames can contradict; words where there is no ratio."""
    rows: list[tuple[Cell, ...]] = []
    methods = zip(outcome.data["method"].values.tolist(), outcome.names("method"), strict=True)
    for method, label in methods:
        for name in FRAME_TERMS:
            for axis in "xy":
                at = {"method": method, "axis": axis}
                sides = [outcome.value(f"method_{side}_arcsec", term=name, **at) for side in SIDES]
                ratio: Cell = outcome.value("method_ratio", term=name, **at)
                if not np.isfinite(outcome.values("method_ratio", term=name, **at)):
                    ratio = "none found"
                rows.append((label, name, axis, *sides, ratio, outcome.value("pull", tested=name, **at)))
        for axis in "xy":
            at = {"method": method, "axis": axis}
            both = [
                float(
                    sum(float(outcome.values(f"method_{side}_arcsec", term=t, **at)) ** 2 for t in FRAME_TERMS) ** 0.5
                )
                for side in SIDES
            ]
            rows.append((label, "together", axis, *both, outcome.value("together", **at), float("nan")))
    return Table(
        columns=(
            Column(name="Centroider", key="method"),
            "Term",
            "Axis",
            *(Column(name=side.capitalize(), unit="″", key=f"{side}_arcsec") for side in SIDES),
            *_columns(outcome, "method_ratio pull"),
        ),
        rows=rows,
        caption="What frames can contradict: TE, HSFE and S, 3 sigma.",
        note="“none found”: a statistic that is zero for a centred lens. What is measured there is noise without its "
        "sign; the deviation is that of the signed entry of Table 1 that is farthest from its prediction.",
    )


def _slips(outcome: Outcome) -> Table:
    """The sums as printed, and as the document's equations give them."""
    equations = ("eq. 31 from the printed S, C1, C2", "eq. 32", "total / √10")
    labels = dict(zip(outcome.data["term"].values.tolist(), outcome.names("term"), strict=True)) | {
        "attitude": "attitude"
    }
    rows: list[tuple[Cell, ...]] = []
    for axis, value in zip("xy", chromatic_of_table1_arcsec(), strict=True):
        printed = outcome.value("published_arcsec", term="LSFE-S", axis=axis)
        judgement = "agrees" if abs(value - printed) <= 0.0051 else "slip in print"
        rows.append((labels["LSFE-S"], "largest entry of Table 1 / 3, 3σ", axis, printed, value, judgement))
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
        note="0.03″ in x is the entry 5e-3 px; the largest is 7e-3 px. 0.91″ is 0.41 + 0.50, the y value of C1 with "
        "the marking error. The printed total of 1.76″ needs 0.79″.",
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
    parts.append(("σ_C1 of the marking errors alone", outcome.values("marking_alone_arcsec"), nothing))
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


def sweep_table(outcome: Outcome) -> Table:
    """The budget at every value of a parameter, at full precision."""
    key = outcome.value("sweep_key")
    shown = [("", "sweep_predicted_arcsec", name, axis, ".3f") for name in SWEPT for axis in "xy"]
    if "sweep_measured_arcsec" in outcome.data:
        shown += [("measured ", "sweep_measured_arcsec", "total", axis, "") for axis in "xy"]
    columns = [Column(name=key, key="value", format=".5g"), *_columns(outcome, "sweep_window_px")]
    for what, _, term, axis, spec in shown:
        name = f"{what}{term} {axis}"
        columns.append(Column(name=name, unit="″", key=re.sub(r"\W", "_", name.lower()), format=spec))
    rows: list[list[Cell]] = []
    for value, window in zip(outcome.data["setting"].values.tolist(), outcome.values("sweep_window_px"), strict=True):
        cells = (outcome.value(name, setting=value, term=term, axis=axis) for _, name, term, axis, _ in shown)
        rows.append([value, int(window), *cells])
    refused = outcome.values("sweep_refused").tolist()
    if any(refused):
        columns += _columns(outcome, "sweep_refused")
        rows = [[*row, why or None] for row, why in zip(rows, refused, strict=True)]
    return Table(columns=columns, rows=rows, caption=f"The budget against {key}, predicted, 3 sigma.")


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


def _thermal(outcome: Outcome) -> Table:
    rows: list[tuple[Cell, ...]] = []
    for label, name in (("LSFE-T", "thermal"), ("total (eq. 32) with LSFE-T", "thermal_total")):
        for axis in "xy":
            rows.append((label, axis, *(outcome.value(f"{name}_{side}_arcsec", axis=axis) for side in SIDES)))
    return Table(
        columns=(
            "Term",
            "Axis",
            *(Column(name=side.capitalize(), unit="″", key=f"{side}_arcsec") for side in SIDES),
        ),
        rows=rows,
        caption=f"Lens and housing ± {outcome.config.thermal.stability_k:g} K about the temperature of the "
        "calibration, 3 sigma.",
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
