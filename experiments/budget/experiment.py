"""The error budget: every term predicted without frames, measured in the virtual laboratory, and summed.

Terms and sum are here; further parts of the study have their own modules: `chromatic` (Table 1), `thermal`,
`attitude`.
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
from experiments.budget.chromatic import TABLE1, table1_of
from experiments.budget.laboratory import BudgetLaboratory, build_laboratory, check_laboratory, half_field
from experiments.budget.measure import MeasuredTerms, measure_terms, steps_of
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

EVERY = (*TERMS, *SUMS)
TESTED = (*FRAME_TERMS, "LSFE-C1", "LSFE-C2")
AIMED = ("TE", "HSFE", "LSFE-S", "total")
"""Errors that an instrument tuned to the published budget must reproduce."""
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


def conditions(lab: BudgetLaboratory) -> BudgetConditions:
    """Names, signal, and the line of sight of a collimator that moves."""
    pixel_arcsec = lab.instrument.pixel_arcsec
    frame_to_frame_px2, _ = lab.bench.power_px2(lab.instrument)
    return BudgetConditions(
        ecss=[ECSS[name] for name in EVERY],
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

    # Predicted minus measured; LSFE-S: of the entry of Table 1 with the largest deviation
    deviation_sigma: FloatArray = col("Deviation", "sigma", "+.2f", "tested axis")
    # Predicted term in units of the same standard deviation; 0 for C2, which is no property of the camera
    term_sigma: FloatArray = col("Term", "sigma", ".3g", "tested axis", shown=False)
    frame_terms_ratio: Sequence[Measured] = col("TE, HSFE and S together, predicted over measured", dims="axis")


def compared(predicted: PredictedTerms, frames: MeasuredTerms | None = None) -> TermComparison:
    """Predicted and measured budget of one centroider; no ratio of terms below 5 sigma of the measurement."""
    predictions = [predicted.budget[name] for name in EVERY]
    comparison = TermComparison(predicted_arcsec=_with_uncertainty(predictions))
    if frames is None:
        return comparison
    measurements = [frames.budget[name] for name in EVERY]
    ratios = [term_ratio(*terms) for terms in zip(EVERY, predictions, measurements, strict=True)]
    return replace(
        comparison,
        measured_arcsec=_with_uncertainty(measurements),
        measured_n=np.repeat([[term.n] for term in measurements], 2, axis=1),
        ratio=measured(*np.stack(ratios, axis=1)),
    )


def _with_uncertainty(terms: Sequence[ErrorTerm]) -> Any:
    return measured([term.arcsec for term in terms], [term.uncertainty_arcsec for term in terms])


def deviations(predicted: PredictedTerms, frames: MeasuredTerms, name: str) -> FloatArray:
    """Predicted minus measured (2,) in standard deviations; of the chromatic term of its signed entries (b, 2)."""
    if name != "LSFE-S":
        return term_pull(name, predicted.budget[name], frames.budget[name])
    a, b = predicted.chromatic, frames.chromatic
    return (a.table1_px - b.table1_px) / np.hypot(a.sigma_px, b.sigma_px)


def agreement(predicted: PredictedTerms, frames: MeasuredTerms) -> Agreement:
    """Largest deviation of each term, and the root sum of squares of `FRAME_TERMS`, predicted over measured."""
    largest, term_sigma = [], []
    for name in TESTED:
        entries = np.atleast_2d(deviations(predicted, frames, name))
        largest.append(entries[np.abs(entries).argmax(0), [0, 1]])
        prediction, measurement = predicted.budget[name], frames.budget[name]
        sigma = difference_sigma(name, prediction.uncertainty_arcsec, measurement.uncertainty_arcsec)
        term_sigma.append(prediction.arcsec / np.maximum(sigma, 1e-300) * (name != "LSFE-C2"))
    return Agreement(
        deviation_sigma=np.array(largest),
        term_sigma=np.array(term_sigma),
        frame_terms_ratio=measured(*frame_terms_ratio(predicted.budget, frames.budget)),
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class Tuned:
    """An instrument that is meant to have the published budget (``published_within_fraction``)."""

    over_published: Sequence[Sequence[Measured]] = col("Measured over published", dims="aimed axis")
    within_fraction: float = col("Required agreement")


def tuned(config: BudgetConfig, frames: MeasuredTerms) -> Tuned | None:
    """Measured over published, if requested in the configuration."""
    if config.published_within_fraction is None:
        return None
    ratios = [
        (frames.budget[name].arcsec / published, frames.budget[name].uncertainty_arcsec / published)
        for name, published in ((name, np.array(PUBLISHED_ARCSEC[name])) for name in AIMED)
    ]
    return Tuned(over_published=measured(*np.stack(ratios, axis=1)), within_fraction=config.published_within_fraction)


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
class TermParts:
    """Parts of the terms by the main centroider, 3 sigma."""

    te_cramer_rao_arcsec: FloatArray = col("TE: Cramér-Rao bound", "arcsec", ".3f", "axis")
    single_position_predicted_arcsec: FloatArray = col("HSFE of one position, predicted", "arcsec", ".3f", "axis")
    single_position_measured_arcsec: FloatArray = col("measured", "arcsec", ".3f", "axis")
    sigma_d_predicted_arcsec: FloatArray = col("σ_d, predicted", "arcsec", ".3f", "axis")
    sigma_d_measured_arcsec: FloatArray = col("measured", "arcsec", ".3f", "axis")
    sigma_dd_predicted_arcsec: FloatArray = col("σ_Dd, predicted", "arcsec", ".3f", "axis")
    sigma_dd_measured_arcsec: FloatArray = col("measured", "arcsec", ".3f", "axis")
    # C1 of a perfect camera without noise
    c1_marking_errors_arcsec: FloatArray = col("C1 of marking errors alone", "arcsec", ".3f", "axis")
    c1_single_survey_arcsec: FloatArray = col("C1, one survey", "arcsec", ".3f", "axis")
    c1_survey_scatter_arcsec: FloatArray = col("Its scatter", "arcsec", ".3f", "axis")


def parts(predicted: PredictedTerms, frames: MeasuredTerms) -> TermParts:
    """Numbers of the prediction and of the frames."""
    return TermParts(
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


def collimator(lab: BudgetLaboratory, frames: Mapping[str, MeasuredTerms]) -> CollimatorShift | None:
    """Contribution of the collimator to Table 1, for any main centroider by a fit of the true PSF: its position follows
    the mean of all light."""
    table = frames[motion_method(lab.config.methods)].chromatic
    corners = corner_directions(lab.config.target, lab.instrument)
    return collimator_shift(lab.filtered, lab.instrument, corners, table.table1_px, table.sigma_px)


def axes(config: BudgetConfig) -> Quantities:
    """Terms, axes, centroiders, pairs of filters."""
    q = Quantities()
    names = {name: LABELS.get(name, name) for name in EVERY}
    names["attitude"] = f"attitude, total / √{config.attitude.stars}"
    q.axis("term", list(names), "Term", names=names)
    q.axis("tested", list(TESTED), "Term")
    q.axis("aimed", list(AIMED), "Term")
    q.axis("axis", ["x", "y"], "Axis")
    labels = MethodLabels(matched="simulator's PSF", measured="PSF from frames")
    q.axis("method", list(config.methods), "Centroider", names=labels)
    return q


def predict(config: BudgetConfig, *, progress: Progress) -> dict[str, Any]:
    """The budget without frames, of the main centroider (`experiments.budget.predict.coarse_terms`)."""
    with progress.stage("predict"):
        terms = coarse_terms(config)
    return {
        "setup": conditions(build_laboratory(config)),
        **prediction_sections(config, {config.centroid: terms}),
    }


def prediction_sections(
    config: BudgetConfig, predicted: Mapping[str, PredictedTerms], frames: Mapping[str, MeasuredTerms] | None = None
) -> dict[str, Any]:
    """Sections of a prediction, with measured values where frames exist."""
    comparisons = [compared(terms, frames[name] if frames else None) for name, terms in predicted.items()]
    comparable = is_published_sensor(config) or config.published_within_fraction is not None
    published = np.array([PUBLISHED_ARCSEC[name] for name in EVERY]) if comparable else None
    main = predicted[config.centroid]
    return {
        "terms": replace(comparisons[0], published_arcsec=published),
        "methods": comparisons if frames else None,
        "rms": axis_rms(main),
        "causes": [HsfeContribution(cause=cause, hsfe_arcsec=hsfe) for cause, hsfe in main.causes_arcsec.items()],
    }


def run(config: BudgetConfig, *, progress: Progress) -> dict[str, Any]:
    """Predict, measure, vary.

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
    with progress.stage("measure", total=steps_of(lab)) as stage:
        frames = measure_terms(lab, advance=stage.advance)
    with progress.stage("temperature"):
        thermal = thermal_term(lab, streams.child("temperature"))
    main, main_frames = predicted[config.centroid], frames[config.centroid]
    with progress.stage("attitude", total=len(config.attitude.counts)) as stage:
        errors = DirectionErrors.of(main_frames.budget)
        study = attitude_study(
            half_field(lab.instrument), errors, config.attitude, streams.child("attitude"), advance=stage.advance
        )
    if isinstance(thermal, ThermalTerm):
        lsfe_t = np.array([axis.value for axis in thermal.measured_arcsec])
        thermal = replace(
            thermal,
            total_predicted_arcsec=np.hypot(thermal.predicted_arcsec, main.budget.total.arcsec),
            total_measured_arcsec=np.hypot(lsfe_t, main_frames.budget.total.arcsec),
        )
    return {
        "setup": replace(conditions(lab), no_thermal=thermal if isinstance(thermal, str) else None),
        **prediction_sections(config, predicted, frames),
        "agreement": [agreement(predicted[method], frames[method]) for method in config.methods],
        "tuned": tuned(config, main_frames),
        "parts": parts(main, main_frames),
        "chromatic": table1_of(main.chromatic, main_frames.chromatic),
        "collimator": collimator(lab, frames),
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
        "HSFE and C1: scatter from chip to chip.",
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
                of="term_sigma",
                each="method",
                title="TE, HSFE, S, C1, C2, predicted minus measured",
            ),
            ratio_near("frame_terms_ratio", within=0.03, at={"method": 0}),
        ],
    ),
    "tuned": Section(
        record=Tuned, verdicts=[agree("over_published", 1.0, slack="within_fraction", title="measured over published")]
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
    "parts": Section(record=TermParts, rows="axis", caption="Parts of the terms, 3 sigma."),
    "chromatic": TABLE1,
    "collimator": COLLIMATOR,
    **attitude.SECTIONS,
    "thermal": THERMAL,
}
