"""The numbers of the error budget, each described once; angles are 3 sigma, uncertainties one standard deviation."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from experiments.budget.attitude import READINGS
from experiments.budget.combine import ECSS, FRAME_TERMS, PRINTED, SUMS, TERMS, Budget
from experiments.budget.result import Result
from experiments.budget.sweep import Sweep, Tornado
from experiments.budget.thermal import ThermalTerm
from experiments.harness.quantities import Quantities
from experiments.laboratory.centroid_methods import MethodLabels
from experiments.laboratory.collimator_effects import add_chromatic_effect
from experiments.laboratory.signal import add_signal
from optics.arrays import FloatArray

__all__ = ["ANGLE", "LABELS", "OF_TERMS", "describe", "describe_sweep", "extra", "of_budget"]

LABELS = {
    "LSFE-S": "LSFE-S, chromatic",
    "LSFE-C1": "LSFE-C1, distortion",
    "LSFE-C2": "LSFE-C2, marking",
    "LSFE": "LSFE (eq. 31)",
    "total": "total (eq. 32)",
}
ANGLE: dict[str, Any] = {"unit": "arcsec"}
OF_TERMS: dict[str, Any] = {**ANGLE, "dims": "term axis"}
PERCENT = (50, 90, 95, 99)
BUILT = {
    "chromatic_arcsec_3sigma": "LSFE-S, chromatic",
    "distortion_residual_arcsec_3sigma": "distortion, calibrated",
    "lsfe_arcsec_3sigma": "both",
    "uncalibrated_arcsec_3sigma": "distortion, moved after calibration",
}


def describe(result: Result) -> Quantities:
    """Quantities of a run: terms and sums, their parts, the budget elsewhere, lenses as built, attitude."""
    q = Quantities()
    names = {name: LABELS.get(name, name) for name in (*TERMS, *SUMS)}
    names["attitude"] = f"attitude, total / √{result.config.attitude.stars}"
    q.axis("term", list(names), "Term", names=names)
    q.axis("axis", ["x", "y"], "Axis")
    q.axis("component", ["x", "y", "roll"], "Component")
    labels = MethodLabels(own="simulator's PSF", measured="PSF from frames")
    q.axis("method", list(result.config.methods), "Centroider", names=labels)
    q.axis("pair", result.lab.filtered.pair_names, "Bands", unit="nm", key="bands")
    q.add("ecss", [ECSS[name] for name in names], "ECSS-E-ST-60-20C", dims="term")
    add_signal(q, result.lab.signal)
    _terms(q, result)
    if result.published is not None:
        _published(q, result.published)
    _methods(q, result)
    _parts(q, result)
    _chromatic(q, result)
    if result.sweep is not None:
        describe_sweep(q, result.sweep)
    if result.tornado is not None:
        _tornado(q, result.tornado)
    _built(q, result)
    _attitude(q, result)
    if isinstance(result.thermal, ThermalTerm):
        _thermal(q, result, result.thermal)
    if result.collimator is not None:
        add_chromatic_effect(q, result.collimator)
        between = result.lab.bench.power_px2(result.lab.instrument)[0] ** 0.5
        place = "collimator.line_of_sight_between_arcsec_3sigma"
        sight = 3.0 * between * result.lab.instrument.pixel_arcsec
        q.add(
            "collimator_between_arcsec", sight, "Line of sight from frame to frame", **ANGLE, format=".3f", json=place
        )
    return q


def extra(result: Result) -> dict[str, Any]:
    """Settings that differ from the defaults."""
    return {"changed_settings": {key: {"default": was, "here": now} for key, (was, now) in result.changed.items()}}


def of_budget(budget: Budget, part: str = "arcsec") -> list[Any]:
    """Values of the terms and sums of a budget, or their uncertainties."""
    return [getattr(budget[name], part) for name in (*TERMS, *SUMS)]


def _terms(q: Quantities, result: Result) -> None:
    for name, label, budget in (
        ("predicted", "Predicted", result.predicted[result.config.centroid].budget),
        ("measured", "Measured", result.measured[result.config.centroid].budget),
    ):
        q.add(
            f"{name}_arcsec",
            of_budget(budget),
            label,
            **OF_TERMS,
            error=of_budget(budget, "uncertainty_arcsec"),
            json=f"terms[term][axis].{name}_arcsec_3sigma",
            json_error=f"terms[term][axis].{name}_uncertainty",
        )
    counting = result.measured[result.config.centroid].budget
    samples = np.repeat([[counting[name].n] for name in (*TERMS, *SUMS)], 2, axis=1)
    q.add("measured_n", samples, "Samples", dims="term axis", json="terms[term][axis].measured_n")
    ratio, spread = zip(*(result.pair(result.config.centroid).ratio(name) for name in (*TERMS, *SUMS)), strict=True)
    place = "terms[term][axis].ratio"
    error = f"{place}_uncertainty"
    label = "Predicted / measured"
    q.add("ratio", ratio, label, dims="term axis", error=spread, json=place, json_error=error)


def _published(q: Quantities, budget: Budget) -> None:
    """The document's budget, as printed and as its equations give it."""
    printed = [PRINTED.get(name, budget[name].arcsec) for name in (*TERMS, *SUMS)]
    place = "terms[term][axis].published_arcsec_3sigma"
    q.add("published_arcsec", printed, "Published", **OF_TERMS, format=".2f", json=place)
    places = {name: f"published_by_eq_31_32.{name}" for name in SUMS}
    q.add("by_equations_arcsec", of_budget(budget), "Recomputed", **OF_TERMS, format=".3f", json=places)


def _methods(q: Quantities, result: Result) -> None:
    """The budget by every centroider on the same frames, and how far each term is from its prediction."""
    methods, every = result.config.methods, (*TERMS, *SUMS)
    place = "methods[method][term][axis]"
    for name, label, budgets in (
        ("predicted", "Predicted", [result.predicted[m].budget for m in methods]),
        ("measured", "Measured", [result.measured[m].budget for m in methods]),
    ):
        q.add(
            f"method_{name}_arcsec",
            [of_budget(one) for one in budgets],
            label,
            **ANGLE,
            dims="method term axis",
            error=[of_budget(one, "uncertainty_arcsec") for one in budgets],
            key=f"{{method}}_{name}_arcsec",
            json=f"{place}.{name}_arcsec_3sigma",
            json_error=f"{place}.{name}_uncertainty",
        )
    q.axis("tested", [*FRAME_TERMS, "LSFE-C1"], "Term")
    ratio, spread = zip(*(zip(*(result.pair(m).ratio(t) for t in every), strict=True) for m in methods), strict=True)
    q.add("method_ratio", ratio, "Predicted / measured", dims="method term axis", error=spread, json=f"{place}.ratio")
    pulls = [[result.pair(method).largest_pull(name) for name in (*FRAME_TERMS, "LSFE-C1")] for method in methods]
    label = "Predicted minus measured"
    q.add("pull", pulls, label, unit="sigma", dims="method tested axis", format="+.2f", json="pulls[method][tested]")
    together, spread = zip(*(result.pair(method).together() for method in methods), strict=True)
    label, place = "Predicted / measured, together", "frame_terms_together[method][axis]"
    q.add(
        "together",
        together,
        label,
        dims="method axis",
        error=spread,
        json=f"{place}.ratio",
        json_error=f"{place}.uncertainty",
    )


def _parts(q: Quantities, result: Result) -> None:
    """What the terms are made of."""
    predicted, measured = result.predicted[result.config.centroid], result.measured[result.config.centroid]
    q.axis("cause", list(predicted.causes_arcsec), "Cause")
    causes = list(predicted.causes_arcsec.values())
    q.add("cause_arcsec", causes, "3σ", **ANGLE, dims="cause axis", json="parts.hsfe_causes_predicted")
    for name, label, place, values in (
        ("bound_te", "TE: Cramér-Rao bound", "cramer_rao_te", predicted.bound_te_arcsec),
        ("predicted_single", "HSFE of one position", "hsfe_single_position.predicted", predicted.single_arcsec),
        ("measured_single", "HSFE of one position", "hsfe_single_position.measured", measured.single_arcsec),
        ("predicted_found", "σ_d", "sigma_d.predicted", predicted.found_arcsec),
        ("measured_found", "σ_d", "sigma_d.measured", measured.found_arcsec),
        ("predicted_left", "σ_Dd", "sigma_dd.predicted", predicted.left_arcsec),
        ("measured_left", "σ_Dd", "sigma_dd.measured", measured.left_arcsec),
        ("marking_alone", "C1 of marking errors alone", "c1_of_marking_errors_alone", predicted.marking_alone_arcsec),
        ("surveyed", "Marking error of the surveys", "marking_error_of_the_surveys", measured.surveyed_arcsec),
        ("one_survey", "C1, one survey", "c1_one_survey.measured", measured.one_survey_arcsec),
        (
            "survey_scatter",
            "Scatter of C1",
            "c1_one_survey.scatter_from_survey_to_survey",
            measured.survey_scatter_arcsec,
        ),
    ):
        q.add(f"{name}_arcsec", values, label, **ANGLE, dims="axis", format=".3f", json=f"parts.{place}")


def _chromatic(q: Quantities, result: Result) -> None:
    """Table 1 of ACC18."""
    counting = result.config.centroid
    predicted, measured = result.predicted[counting].chromatic, result.measured[counting].chromatic

    def by_pair(values: Mapping[str, FloatArray]) -> list[FloatArray]:
        return [values[name] for name in measured.table1_px]

    entry: dict[str, Any] = {"unit": "px", "dims": "pair axis"}
    place = "parts.table1_px.predicted"
    values = by_pair(predicted.table1_px)
    q.add("predicted_table1_px", values, "Predicted", **entry, format=".5f", key="predicted_px", json=place)
    q.add(
        "measured_table1_px",
        by_pair(measured.table1_px),
        "Measured",
        **entry,
        error=by_pair(measured.sigma_px),
        n=measured.n,
        key="measured_px",
        json="parts.table1_px.measured",
        json_error="parts.table1_px.sigma",
    )
    values = by_pair(measured.rms_px)
    q.add("rms_shift_px", values, "RMS shift of a point", **entry, format=".4f", key="rms_px", json="")


def describe_sweep(q: Quantities, sweep: Sweep) -> None:
    """The budget against a parameter; NaN where it is refused or was not measured."""
    settings = sweep.settings
    q.axis("setting", [float(one.value) for one in settings], sweep.key, format=".5g", key="value")
    q.add("sweep_key", sweep.key, "Parameter", json="sweep.key")
    q.add("sweep_value", [one.value for one in settings], sweep.key, dims="setting", json="sweep.value")
    windows = [one.window_px for one in settings]
    q.add("sweep_window_px", windows, "Window", unit="px", dims="setting", key="window_px", json="sweep.window_px")
    nothing = np.full((len(TERMS) + len(SUMS), 2), np.nan)
    found = {**ANGLE, "dims": "setting term axis"}
    values = [nothing if one.predicted is None else of_budget(one.predicted) for one in settings]
    q.add("sweep_predicted_arcsec", values, "3σ", **found, json="sweep.predicted")
    if any(one.measured is not None for one in settings):
        values, error = (
            [nothing if one.measured is None else of_budget(one.measured.budget, part) for one in settings]
            for part in ("arcsec", "uncertainty_arcsec")
        )
        place = "sweep.measured"
        q.add(
            "sweep_measured_arcsec", values, "3σ", **found, error=error, json=place, json_error=f"{place}_uncertainty"
        )
    refused = [one.refusal for one in settings]
    q.add("sweep_refused", refused, "Refused because", dims="setting", key="refusal", json="sweep.refused")


def _tornado(q: Quantities, tornado: Tornado) -> None:
    """Sensitivities, the largest first."""
    swings = tornado.swings
    q.axis("end", ["low", "high"], "End")
    labels = [f"{one.label} [{one.unit}]" if one.unit else one.label for one in swings]
    q.add("swing_label", labels, "Parameter", dims="swing", key="parameter", json="")
    for name, format_spec in (("key", ""), ("low", ".5g"), ("high", ".5g")):
        values = [getattr(one, name) for one in swings]
        place = f"tornado[swing].{name}"
        q.add(f"swing_{name}", values, name.capitalize(), dims="swing", format=format_spec, key=name, json=place)
    q.add(
        "total_change_arcsec",
        np.reshape([one.change("total", tornado.base) for one in swings], (-1, 2, 2)),
        "Change",
        **ANGLE,
        dims="swing end axis",
        format="+.4f",
        key="{axis}_{end}_arcsec",
        json="tornado[swing].total_change_arcsec",
    )
    q.add("tornado_total_arcsec", tornado.base.total.arcsec, "Total", **ANGLE, dims="axis", format=".3f", json="")


def _built(q: Quantities, result: Result) -> None:
    """Lenses as built."""
    built = result.tolerances
    q.add("lenses", len(built.chromatic_arcsec), "Lenses", json="tolerances.lenses")
    q.add("lost", built.lost, "Lenses left out", json="tolerances.lost")
    q.axis("built_error", list(BUILT), "Error", key="error", names=list(BUILT.values()))
    q.axis("percentile", [str(p) for p in PERCENT], "Share of the lenses", names=[f"{p} %" for p in PERCENT])
    design = built.design_arcsec
    both = np.hypot(design["chromatic"], design["distortion"])
    q.add(
        "design_arcsec",
        [design["chromatic"], design["distortion"], both, np.zeros(2)],
        "Design",
        **ANGLE,
        dims="built_error axis",
        format=".3f",
        json="",
    )
    errors = (built.chromatic_arcsec, built.distortion_arcsec, built.lsfe_arcsec, built.uncalibrated_arcsec)
    q.add(
        "built_arcsec",
        [np.percentile(values, PERCENT, axis=0) for values in errors],
        "Below",
        **ANGLE,
        dims="built_error percentile axis",
        format=".3f",
        key="p{percentile}_arcsec",
        json="tolerances[built_error]",
    )


def _attitude(q: Quantities, result: Result) -> None:
    """Attitude from N stars."""
    study = result.attitude
    q.axis("reading", list(READINGS), "Low-frequency error")
    q.axis("layout", list(study.layout), "Stars in")
    q.axis("stars", study.counts, "Stars", key="stars")
    q.add("attitude_stars", study.stars, "Stars", json="attitude.stars")
    q.add("attitude_trials", study.trials, "Trials", json="attitude.trials")
    for name, dims, place, values in (
        ("attitude", "reading component", "monte_carlo", [study.at[name] for name in READINGS]),
        ("attitude_rule", "component", "rule", study.rule_at),
        ("layout", "layout component", "layout", list(study.layout.values())),
    ):
        q.add(
            f"{name}_arcsec", values, "Attitude error, 3σ", **ANGLE, dims=dims, json=f"attitude.{place}_arcsec_3sigma"
        )
    q.add("attitude_uncertainty", study.relative_uncertainty, "Uncertainty", json="attitude.relative_uncertainty")
    for name, values in (("rule", study.rule), ("estimator", study.bound), *study.curve.items()):
        word = name.replace(" ", "_")
        q.add(
            f"curve_{word}_arcsec",
            values,
            name,
            **ANGLE,
            dims="stars component",
            format=".4g",
            key=f"{word}_{{component}}_arcsec",
            json="",
        )


def _thermal(q: Quantities, result: Result, term: ThermalTerm) -> None:
    """LSFE-T, and the total with it."""
    q.add("calibrated_at_c", term.temperature_c, "Calibrated at", unit="degC", json="thermal.calibrated_at_c")
    for name, label, value, total in (
        ("predicted", "Predicted", term.predicted, result.predicted[result.config.centroid].budget.total),
        ("measured", "Measured", term.measured, result.measured[result.config.centroid].budget.total),
    ):
        place = f"thermal.{name}_arcsec_3sigma"
        q.add(
            f"thermal_{name}_arcsec",
            value.arcsec,
            label,
            **ANGLE,
            dims="axis",
            format=".3f",
            error=value.uncertainty_arcsec,
            json=place,
            json_error=f"thermal.{name}_uncertainty",
        )
        both = np.hypot(value.arcsec, total.arcsec)
        place = f"thermal.total_{name}_arcsec_3sigma"
        q.add(f"thermal_total_{name}_arcsec", both, label, **ANGLE, dims="axis", format=".3f", json=place)
    ppm: dict[str, Any] = {"unit": "1e-6/K", "format": ".2f"}
    place = "thermal.scale_ppm_per_k"
    q.add("scale_ppm_per_k", term.scale_ppm_per_k, "Scale", **ppm, dims="axis", json=f"{place}.predicted")
    q.add(
        "measured_scale_ppm_per_k",
        term.measured_scale_ppm_per_k,
        "Scale",
        **ppm,
        dims="axis",
        error=term.scale_sigma_ppm_per_k,
        json=f"{place}.measured",
        json_error=f"{place}.sigma",
    )
    q.add("paraxial_ppm_per_k", term.paraxial_ppm_per_k, "Scale, paraxial", **ppm, json=f"{place}.paraxial")
    q.add("focus_um_per_k", term.focus_um_per_k, "Focus", unit="um/K", format=".2f", json="thermal.focus_um_per_k")
    place = "thermal.outermost_star_px_per_k"
    q.add("corner_px_per_k", term.corner_px_per_k, "Outermost star", unit="px/K", format=".3f", json=place)
