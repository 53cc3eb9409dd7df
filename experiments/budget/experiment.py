"""The error budget: every term predicted without frames, measured in the virtual laboratory, and summed.

Terms of ACC18 (TE temporal, HSFE high-spatial-frequency, LSFE low-spatial-frequency error: S chromatic, C1 distortion,
C2 target survey) and their sums; `chromatic` (Table 1), `thermal` and `attitude` are modules of their own.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from calib.accuracy.attitude_from_stars import DirectionErrors
from calib.accuracy.budget_comparison import difference_sigma, frame_terms_ratio, term_pull, term_ratio
from calib.accuracy.error_budget import ECSS, FRAME_TERMS, SUMS, TERMS, ErrorTerm
from calib.accuracy.step_prediction import rms_over
from experiments.budget import attitude
from experiments.budget.attitude import attitude_study
from experiments.budget.chromatic import TABLE1, tabulate_table1
from experiments.budget.laboratory import BudgetLaboratory, build_laboratory, check_laboratory, half_field
from experiments.budget.measure import MeasuredTerms, count_advances, measure_terms
from experiments.budget.predict import PredictedTerms, coarse_terms, predict_terms
from experiments.budget.settings import BudgetConfig
from experiments.budget.thermal import THERMAL, ThermalTerm, thermal_term
from experiments.harness.drawings import bars
from experiments.harness.progress import Progress
from experiments.harness.quantities import Quantities
from experiments.harness.sections import Section, agree, col, ratio_near
from experiments.harness.summary import Measured, measured
from experiments.laboratory.bench.centroid_methods import MethodLabels
from experiments.laboratory.bench.point_bench import motion_method
from experiments.laboratory.devices.collimator_effects import COLLIMATOR, CollimatorShift, collimator_shift
from experiments.laboratory.devices.target import corner_directions
from experiments.laboratory.settings.published import ACC18_ARCSEC, ACC18_SUMS_ARCSEC, is_published_sensor
from optics.arrays import FloatArray
from render.engine.random import Streams

ALL_TERMS = (*TERMS, *SUMS)
COMPARED_TERMS = (*FRAME_TERMS, "LSFE-C1", "LSFE-C2")
TUNED_TERMS = ("TE", "HSFE", "LSFE-S", "total")
"""Errors that an instrument tuned to the published budget must reproduce."""
SMALLEST_SIGMA = 1e-300
"""Floor of a standard deviation that is zero, such as that of a term without uncertainty."""
PUBLISHED_ARCSEC = {**ACC18_ARCSEC, **ACC18_SUMS_ARCSEC}
LABELS = {
    "LSFE-S": "LSFE-S, chromatic",
    "LSFE-C1": "LSFE-C1, distortion",
    "LSFE-C2": "LSFE-C2, marking",
    "LSFE": "LSFE (eq. 31)",
    "total": "total (eq. 32)",
}


@dataclass(frozen=True, slots=True, kw_only=True)
class BudgetConditions:
    """Instrument and signal of the budget."""

    ecss: Sequence[str] = col("ECSS-E-ST-60-20C", dims="term")
    signal_e: float = col("Signal", "e-", ".0f")
    signal_star: str = col("Star")
    lens_name: str = col("Lens")
    detector_name: str = col("Detector")
    pixel_arcsec: float = col("Angle of a pixel", "arcsec", ".3f")
    frame_to_frame_arcsec: float | None = col(
        "Line of sight from frame to frame",
        "arcsec",
        ".3f",
        default=None,
    )
    no_thermal: str | None = col("Reason for no thermal term", default=None)


def describe_conditions(lab: BudgetLaboratory) -> BudgetConditions:
    """Lens, detector and signal; motion of the line of sight from frame to frame if there is a collimator."""
    pixel_arcsec = lab.instrument.pixel_arcsec
    frame_to_frame_px2, _ = lab.bench.power_px2(lab.instrument)
    return BudgetConditions(
        ecss=[ECSS[name] for name in ALL_TERMS],
        signal_e=lab.signal.signal_e,
        signal_star=lab.signal.star,
        lens_name=lab.instrument.camera.lens.name,
        detector_name=lab.instrument.detector.name,
        pixel_arcsec=pixel_arcsec,
        frame_to_frame_arcsec=None if lab.bench.collimator is None else 3.0 * pixel_arcsec * frame_to_frame_px2**0.5,
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class TermComparison:
    """Terms and sums of the budget by a centroider, 3 sigma; uncertainties are one standard deviation."""

    predicted_arcsec: FloatArray = col(
        "Predicted",
        "arcsec",
        dims="term axis",
    )
    measured_arcsec: FloatArray | None = col(
        "Measured",
        "arcsec",
        dims="term axis",
        default=None,
    )
    measured_n: FloatArray | None = col("Samples", dims="term axis", default=None, shown=False)
    ratio: FloatArray | None = col("Predicted / measured", dims="term axis", default=None)
    published_arcsec: FloatArray | None = col("Published", "arcsec", ".2f", "term axis", default=None)


@dataclass(frozen=True, slots=True, kw_only=True)
class Agreement:
    """Whether prediction and frames agree, by centroider."""

    # Predicted minus measured over its standard deviation; LSFE-S: entry of Table 1 with the largest deviation
    deviation_sigma: FloatArray = col("Deviation", "sigma", "+.2f", "tested axis")
    # Predicted term over the standard deviation of the difference; 0 for LSFE-C2, an input
    term_over_sigma: FloatArray = col("Term", "sigma", ".3g", "tested axis", shown=False)
    frame_terms_ratio: Sequence[Measured] = col("TE, HSFE and LSFE-S together, predicted over measured", dims="axis")


def compare_terms(predicted: PredictedTerms, frames: MeasuredTerms | None = None) -> TermComparison:
    """Predicted and measured budget of one centroider; no ratio of terms below 5 sigma of the measurement."""
    predictions = [predicted.budget[name] for name in ALL_TERMS]
    comparison = TermComparison(predicted_arcsec=_with_uncertainty(predictions))
    if frames is None:
        return comparison
    measurements = [frames.budget[name] for name in ALL_TERMS]
    ratios = [term_ratio(*terms) for terms in zip(ALL_TERMS, predictions, measurements, strict=True)]
    return replace(
        comparison,
        measured_arcsec=_with_uncertainty(measurements),
        measured_n=np.repeat([[term.n] for term in measurements], 2, axis=1),
        ratio=measured(*np.stack(ratios, axis=1)),
    )


def _with_uncertainty(terms: Sequence[ErrorTerm]) -> Any:
    return measured([term.arcsec for term in terms], [term.uncertainty_arcsec for term in terms])


def deviations(predicted: PredictedTerms, frames: MeasuredTerms, name: str) -> FloatArray:
    """Predicted minus measured (2,) in standard deviations; for LSFE-S the signed entries (b, 2) of Table 1."""
    if name != "LSFE-S":
        return term_pull(name, predicted.budget[name], frames.budget[name])
    prediction, measurement = predicted.chromatic, frames.chromatic
    sigma_px = np.hypot(prediction.sigma_px, measurement.sigma_px)
    return (prediction.table1_px - measurement.table1_px) / sigma_px


def judge_agreement(predicted: PredictedTerms, frames: MeasuredTerms) -> Agreement:
    """Largest deviation of each term, and the root sum of squares of `FRAME_TERMS`, predicted over measured."""
    largest_deviation = []
    for name in COMPARED_TERMS:
        entries = np.atleast_2d(deviations(predicted, frames, name))
        largest_deviation.append(entries[np.abs(entries).argmax(0), [0, 1]])
    return Agreement(
        deviation_sigma=np.array(largest_deviation),
        term_over_sigma=np.array([_term_over_sigma(predicted, frames, name) for name in COMPARED_TERMS]),
        frame_terms_ratio=measured(*frame_terms_ratio(predicted.budget, frames.budget)),
    )


def _term_over_sigma(predicted: PredictedTerms, frames: MeasuredTerms, name: str) -> FloatArray:
    """Predicted term (2,) over the standard deviation of predicted minus measured."""
    if name == "LSFE-C2":  # an input, not judged
        return np.zeros(2)
    prediction, measurement = predicted.budget[name], frames.budget[name]
    sigma = difference_sigma(name, prediction.uncertainty_arcsec, measurement.uncertainty_arcsec)
    return prediction.arcsec / np.maximum(sigma, SMALLEST_SIGMA)


@dataclass(frozen=True, slots=True, kw_only=True)
class PublishedBudgetMatch:
    """Agreement of an instrument tuned to the published budget (``published_within_fraction``)."""

    over_published: Sequence[Sequence[Measured]] = col("Measured over published", dims="tuned_term axis")
    within_fraction: float = col("Required agreement")


def match_published(config: BudgetConfig, frames: MeasuredTerms) -> PublishedBudgetMatch | None:
    """Measured over published terms; None if the configuration requires no agreement."""
    if config.published_within_fraction is None:
        return None
    ratios = []
    for name in TUNED_TERMS:
        published = np.array(PUBLISHED_ARCSEC[name])
        term = frames.budget[name]
        ratios.append((term.arcsec / published, term.uncertainty_arcsec / published))
    return PublishedBudgetMatch(
        over_published=measured(*np.stack(ratios, axis=1)), within_fraction=config.published_within_fraction
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class AxisRms:
    """Predicted terms and total, 3 sigma, root mean square of x and y, for sweeps and comparisons."""

    total_rms_arcsec: float = col("Total (x, y RMS)", "arcsec", ".3f")
    te_rms_arcsec: float = col("TE", "arcsec", ".3f")
    hsfe_rms_arcsec: float = col("HSFE", "arcsec", ".3f")
    chromatic_rms_arcsec: float = col("LSFE-S", "arcsec", ".3f")
    distortion_rms_arcsec: float = col("LSFE-C1", "arcsec", ".3f")


def axis_rms(predicted: PredictedTerms) -> AxisRms:
    """Root mean squares over the axes."""
    names = {"total": "total", "te": "TE", "hsfe": "HSFE", "chromatic": "LSFE-S", "distortion": "LSFE-C1"}
    return AxisRms(
        **{f"{field}_rms_arcsec": float(rms_over([*predicted.budget[name].arcsec])) for field, name in names.items()}
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class HsfeContribution:
    """Contribution of a cause to the HSFE, predicted, 3 sigma."""

    cause: str = col("Cause")
    hsfe_arcsec: FloatArray = col("Part of the HSFE", "arcsec", ".3f", "axis")


@dataclass(frozen=True, slots=True, kw_only=True)
class TermBreakdown:
    """Contributions to the terms and intermediate statistics, main centroider, 3 sigma."""

    te_cramer_rao_arcsec: FloatArray = col("TE: Cramér-Rao bound", "arcsec", ".3f", "axis")
    single_position_predicted_arcsec: FloatArray = col("HSFE of one position, predicted", "arcsec", ".3f", "axis")
    single_position_measured_arcsec: FloatArray = col("measured", "arcsec", ".3f", "axis")
    sigma_d_predicted_arcsec: FloatArray = col("σ_d, predicted", "arcsec", ".3f", "axis")
    sigma_d_measured_arcsec: FloatArray = col("measured", "arcsec", ".3f", "axis")
    sigma_dd_predicted_arcsec: FloatArray = col("σ_Dd, predicted", "arcsec", ".3f", "axis")
    sigma_dd_measured_arcsec: FloatArray = col("measured", "arcsec", ".3f", "axis")
    # LSFE-C1 of a perfect camera without noise
    c1_marking_errors_arcsec: FloatArray = col("C1 of marking errors alone", "arcsec", ".3f", "axis")
    c1_single_survey_arcsec: FloatArray = col("C1, one survey", "arcsec", ".3f", "axis")
    c1_survey_scatter_arcsec: FloatArray = col("C1, survey to survey", "arcsec", ".3f", "axis")


def break_down_terms(predicted: PredictedTerms, frames: MeasuredTerms) -> TermBreakdown:
    """Predicted and measured contributions side by side."""
    return TermBreakdown(
        te_cramer_rao_arcsec=predicted.te_cramer_rao_arcsec,
        single_position_predicted_arcsec=predicted.single_position_arcsec,
        single_position_measured_arcsec=frames.single_position_arcsec,
        sigma_d_predicted_arcsec=predicted.sigma_d_arcsec,
        sigma_d_measured_arcsec=frames.sigma_d_arcsec,
        sigma_dd_predicted_arcsec=predicted.sigma_dd_arcsec,
        sigma_dd_measured_arcsec=frames.sigma_dd_arcsec,
        c1_marking_errors_arcsec=predicted.c1_marking_errors_arcsec,
        c1_single_survey_arcsec=frames.c1_single_survey_arcsec,
        c1_survey_scatter_arcsec=frames.c1_survey_scatter_arcsec,
    )


def find_collimator_shift(lab: BudgetLaboratory, frames: Mapping[str, MeasuredTerms]) -> CollimatorShift | None:
    """Contribution of the collimator to Table 1, by the centroider that fits the true PSF, because its position follows
    the centroid of all light; None without a collimator."""
    table = frames[motion_method(lab.config.methods)].chromatic
    corners = corner_directions(lab.config.target, lab.instrument)
    return collimator_shift(lab.filtered, lab.instrument, corners, table.table1_px, table.sigma_px)


def axes(config: BudgetConfig) -> Quantities:
    """Terms, axes, centroiders, pairs of filters."""
    quantities = Quantities()
    names = {name: LABELS.get(name, name) for name in ALL_TERMS}
    names["attitude"] = f"attitude, total / √{config.attitude.stars}"
    quantities.axis("term", list(names), "Term", names=names)
    quantities.axis("tested", list(COMPARED_TERMS), "Term")
    quantities.axis("tuned_term", list(TUNED_TERMS), "Term")
    quantities.axis("axis", ["x", "y"], "Axis")
    labels = MethodLabels(matched="simulator's PSF", measured="PSF from frames")
    quantities.axis("method", list(config.methods), "Centroider", names=labels)
    return quantities


def predict(config: BudgetConfig, *, progress: Progress) -> dict[str, Any]:
    """The budget without frames, of the main centroider (`experiments.budget.predict.coarse_terms`)."""
    with progress.stage("predict"):
        terms = coarse_terms(config)
    return {
        "setup": describe_conditions(build_laboratory(config)),
        **prediction_sections(config, {config.centroid: terms}),
    }


def prediction_sections(
    config: BudgetConfig, predicted: Mapping[str, PredictedTerms], frames: Mapping[str, MeasuredTerms] | None = None
) -> dict[str, Any]:
    """Sections of a prediction, with measured values where frames exist."""
    comparisons = [compare_terms(terms, frames[name] if frames else None) for name, terms in predicted.items()]
    comparable = is_published_sensor(config) or config.published_within_fraction is not None
    published = np.array([PUBLISHED_ARCSEC[name] for name in ALL_TERMS]) if comparable else None
    main = predicted[config.centroid]
    return {
        "terms": replace(comparisons[0], published_arcsec=published),
        "methods": comparisons if frames else None,
        "rms": axis_rms(main),
        "causes": [HsfeContribution(cause=cause, hsfe_arcsec=hsfe) for cause, hsfe in main.causes_arcsec.items()],
    }


def run(config: BudgetConfig, *, progress: Progress) -> dict[str, Any]:
    """Predict and measure all terms, the thermal term and the attitude.

    Raises
    ------
    StarbenchError
        On anything the user can mend: unknown names, light that misses detector or windows, saturated points.
    """
    lab = build_laboratory(config)
    check_laboratory(lab)
    streams = Streams(config.seed).child("budget")
    with progress.stage("predict"):
        predicted = predict_terms(lab)
    with progress.stage("measure", total=count_advances(lab)) as stage:
        frames = measure_terms(lab, advance=stage.advance)
    with progress.stage("temperature"):
        thermal = thermal_term(lab, streams.child("temperature"))
    main = predicted[config.centroid]
    main_frames = frames[config.centroid]
    with progress.stage("attitude", total=len(config.attitude.counts)) as stage:
        errors = DirectionErrors.of(main_frames.budget)
        study = attitude_study(
            half_field(lab.instrument), errors, config.attitude, streams.child("attitude"), advance=stage.advance
        )
    if isinstance(thermal, ThermalTerm):
        thermal = thermal.with_totals(main.budget.total.arcsec, main_frames.budget.total.arcsec)
    return {
        "setup": replace(describe_conditions(lab), no_thermal=thermal if isinstance(thermal, str) else None),
        **prediction_sections(config, predicted, frames),
        "agreement": [judge_agreement(predicted[method], frames[method]) for method in config.methods],
        "tuned": match_published(config, main_frames),
        "parts": break_down_terms(main, main_frames),
        "chromatic": tabulate_table1(main.chromatic, main_frames.chromatic),
        "collimator": find_collimator_shift(lab, frames),
        **study,
        "thermal": thermal if isinstance(thermal, ThermalTerm) else None,
    }


SECTIONS = {
    "setup": Section(record=BudgetConditions),
    "terms": Section(
        record=TermComparison,
        table="budget",
        caption="The budget, 3 sigma; uncertainties are one standard deviation.",
        note="C2, measured: scatter of repeated surveys, independent of frames. Attitude, measured: "
        "error of attitudes solved from stars with the measured errors. Predicted uncertainties of "
        "HSFE and C1: scatter from detector to detector.",
        figures={
            "budget_bars": bars(
                "term",
                bars="measured_arcsec",
                points="predicted_arcsec",
                marks="published_arcsec",
                panels="axis",
                aspect_ratio=0.42,
            )
        },
    ),
    "methods": Section(
        record=TermComparison,
        dim="method",
        rows="term axis",
        across="method",
        columns="measured_arcsec",
        caption="Measured budget by centroider, same frames, 3 sigma.",
    ),
    "rms": Section(record=AxisRms),
    "agreement": Section(
        record=Agreement,
        dim="method",
        rows="tested axis",
        across="method",
        columns="deviation_sigma",
        caption="Deviations: predicted minus measured, in standard deviations, by centroider.",
        note="LSFE-S: signed entry of ACC18 Table 1 with the largest deviation from its prediction.",
        verdicts=[
            agree(
                "deviation_sigma",
                0.0,
                error=1.0,
                of="term_over_sigma",
                each="method",
                title="TE, HSFE, S, C1, C2, predicted minus measured",
            ),
            ratio_near("frame_terms_ratio", within=0.03, at={"method": 0}),
        ],
    ),
    "tuned": Section(
        record=PublishedBudgetMatch,
        verdicts=[agree("over_published", 1.0, slack="within_fraction", title="measured over published")],
    ),
    "causes": Section(
        record=HsfeContribution,
        dim="cause",
        along="cause",
        rows="cause",
        across="axis",
        caption="Predicted HSFE by cause, 3 sigma.",
        figures={"cause_bars": bars("cause", bars="hsfe_arcsec", by="axis", width="half", aspect_ratio=0.75)},
    ),
    "parts": Section(record=TermBreakdown, rows="axis", caption="Parts of the terms, 3 sigma."),
    "chromatic": TABLE1,
    "collimator": COLLIMATOR,
    **attitude.SECTIONS,
    "thermal": THERMAL,
}
