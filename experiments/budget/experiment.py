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
from calib.accuracy.error_budget import ECSS, FRAME_TERMS, SUMS, TERMS
from experiments.budget import attitude
from experiments.budget.attitude import attitude_study
from experiments.budget.chromatic import TABLE1, table1_of
from experiments.budget.laboratory import Laboratory, build_laboratory, check_laboratory, half_field
from experiments.budget.measure import Measurement, measure_terms, steps_of
from experiments.budget.predict import PredictedTerms, coarse_terms, predict_terms
from experiments.budget.settings import Config
from experiments.budget.thermal import THERMAL, Thermal, thermal_term
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
class Setup:
    """Instrument and signal of the budget."""

    ecss: Sequence[str] = col("ECSS-E-ST-60-20C", dims="term")
    signal_e: float = col("Signal", "e-", ".0f")
    signal_star: str = col("Star")
    lens_name: str = col("Lens")
    detector_name: str = col("Detector")
    pixel_arcsec: float = col("Angle of a pixel", "arcsec", ".3f")
    between_arcsec: float | None = col(
        "Line of sight from frame to frame",
        "arcsec",
        ".3f",
        default=None,
    )
    no_thermal: str | None = col("Reason for no thermal term", default=None)


def setup(lab: Laboratory) -> Setup:
    """Names, signal, and the line of sight of a collimator that moves."""
    signal, between = lab.signal, 3.0 * lab.bench.power_px2(lab.instrument)[0] ** 0.5 * lab.instrument.pixel_arcsec
    return Setup(
        ecss=[ECSS[name] for name in EVERY],
        signal_e=signal.signal_e,
        signal_star=signal.star,
        lens_name=lab.instrument.camera.lens.name,
        detector_name=lab.instrument.detector.name,
        pixel_arcsec=lab.instrument.pixel_arcsec,
        between_arcsec=between if lab.bench.collimator is not None else None,
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class Comparison:
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

    # LSFE-S: of the entry of Table 1 that is farthest from its prediction
    pull: FloatArray = col("Deviation", "sigma", "+.2f", "tested axis")
    # The same for the verdict, with its standard deviation, and the predicted terms in that unit: errors of these are
    # to be noticed, not of C2, which is no property of the camera
    deviation: Sequence[Sequence[Measured]] = col("Deviation", "sigma", dims="tested axis", shown=False)
    whole: FloatArray = col("Term", "sigma", ".3g", "tested axis", shown=False)
    together: FloatArray = col(
        "TE, HSFE and S together, predicted over measured",
        dims="axis",
    )


def compared(predicted: PredictedTerms, frames: Measurement | None = None) -> Comparison:
    """Predicted and measured budget of one centroider; no ratio of terms below 5 sigma of the measurement."""
    a = [predicted.budget[name] for name in EVERY]
    first = measured([one.arcsec for one in a], [one.uncertainty_arcsec for one in a])
    if frames is None:
        return Comparison(predicted_arcsec=first)
    b = [frames.budget[name] for name in EVERY]
    ratio = np.stack([term_ratio(name, *terms) for name, *terms in zip(EVERY, a, b, strict=True)], axis=1)
    return Comparison(
        predicted_arcsec=first,
        measured_arcsec=measured([one.arcsec for one in b], [one.uncertainty_arcsec for one in b]),
        measured_n=np.repeat([[one.n] for one in b], 2, axis=1),
        ratio=measured(*ratio),
    )


def pulls(predicted: PredictedTerms, frames: Measurement, name: str) -> FloatArray:
    """Predicted minus measured (2,) in standard deviations; of the chromatic term of its signed entries (b, 2)."""
    if name == "LSFE-S":
        a, b = predicted.chromatic, frames.chromatic
        return np.stack(
            [
                (a.table1_px[pair] - b.table1_px[pair]) / np.hypot(a.sigma_px[pair], b.sigma_px[pair])
                for pair in b.table1_px
            ]
        )
    return term_pull(name, predicted.budget[name], frames.budget[name])


def agreement(predicted: PredictedTerms, frames: Measurement) -> Agreement:
    """Largest deviation of each term, and the root sum of squares of `FRAME_TERMS`, predicted over measured."""
    largest, whole = [], []
    for name in TESTED:
        entries = np.atleast_2d(pulls(predicted, frames, name))
        largest.append(entries[np.abs(entries).argmax(0), [0, 1]])
        term, other = predicted.budget[name], frames.budget[name]
        spread = difference_sigma(name, term.uncertainty_arcsec, other.uncertainty_arcsec)
        whole.append(term.arcsec / np.maximum(spread, 1e-300) * (name != "LSFE-C2"))
    return Agreement(
        pull=np.array(largest),
        deviation=measured(largest, 1.0),
        whole=np.array(whole),
        together=measured(*frame_terms_ratio(predicted.budget, frames.budget)),
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class Tuned:
    """An instrument that is meant to have the published budget (``published_within_fraction``)."""

    over_published: Sequence[Sequence[Measured]] = col("Measured over published", dims="aimed axis")
    within_fraction: float = col("Required agreement")


def tuned(config: Config, frames: Measurement) -> Tuned | None:
    """Measured over published, if requested in the configuration."""
    if config.published_within_fraction is None:
        return None
    seen, wanted = [frames.budget[name] for name in AIMED], np.array([PUBLISHED_ARCSEC[name] for name in AIMED])
    values, errors = (np.array([getattr(one, part) for one in seen]) for part in ("arcsec", "uncertainty_arcsec"))
    return Tuned(
        over_published=measured(values / wanted, errors / wanted), within_fraction=config.published_within_fraction
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class Chief:
    """Predicted terms and total, 3 sigma, root mean square of x and y, for sweeps and comparisons."""

    total_rms_arcsec: float = col("Total (x, y RMS)", "arcsec", ".3f")
    te_rms_arcsec: float = col("TE", "arcsec", ".3f")
    hsfe_rms_arcsec: float = col("HSFE", "arcsec", ".3f")
    chromatic_rms_arcsec: float = col("LSFE-S", "arcsec", ".3f")
    distortion_rms_arcsec: float = col("LSFE-C1", "arcsec", ".3f")


def chief(predicted: PredictedTerms) -> Chief:
    """Root mean squares over the axes."""
    names = {"total": "total", "te": "TE", "hsfe": "HSFE", "chromatic": "LSFE-S", "distortion": "LSFE-C1"}
    values = {f"{key}_rms_arcsec": predicted.budget[name].arcsec for key, name in names.items()}
    return Chief(**{key: float(np.sqrt((value**2).mean())) for key, value in values.items()})


@dataclass(frozen=True, slots=True, kw_only=True)
class Cause:
    """A cause of the HSFE, predicted, 3 sigma."""

    name: str = col("Cause")
    arcsec: FloatArray = col("Part of the HSFE", "arcsec", ".3f", "axis")


@dataclass(frozen=True, slots=True, kw_only=True)
class Parts:
    """Parts of the terms by the main centroider, 3 sigma."""

    bound_te_arcsec: FloatArray = col("TE: Cramér-Rao bound", "arcsec", ".3f", "axis")
    predicted_single_arcsec: FloatArray = col("HSFE of one position, predicted", "arcsec", ".3f", "axis")
    measured_single_arcsec: FloatArray = col("measured", "arcsec", ".3f", "axis")
    predicted_found_arcsec: FloatArray = col("σ_d, predicted", "arcsec", ".3f", "axis")
    measured_found_arcsec: FloatArray = col("measured", "arcsec", ".3f", "axis")
    predicted_left_arcsec: FloatArray = col("σ_Dd, predicted", "arcsec", ".3f", "axis")
    measured_left_arcsec: FloatArray = col("measured", "arcsec", ".3f", "axis")
    # C1 of a perfect camera without noise
    marking_alone_arcsec: FloatArray = col("C1 of marking errors alone", "arcsec", ".3f", "axis")
    one_survey_arcsec: FloatArray = col("C1, one survey", "arcsec", ".3f", "axis")
    survey_scatter_arcsec: FloatArray = col("Its scatter", "arcsec", ".3f", "axis")


def parts(predicted: PredictedTerms, frames: Measurement) -> Parts:
    """Numbers of both sides."""
    sides = {
        f"{side}_{part}_arcsec": getattr(of, f"{part}_arcsec")
        for side, of in (("predicted", predicted), ("measured", frames))
        for part in ("single", "found", "left")
    }
    return Parts(
        bound_te_arcsec=predicted.bound_te_arcsec,
        marking_alone_arcsec=predicted.marking_alone_arcsec,
        one_survey_arcsec=frames.one_survey_arcsec,
        survey_scatter_arcsec=frames.survey_scatter_arcsec,
        **sides,
    )


def collimator(lab: Laboratory, frames: Mapping[str, Measurement]) -> CollimatorShift | None:
    """Contribution of the collimator to Table 1; by a fit of the true PSF, which follows all light, for any main
    centroider."""
    table, corners = (
        frames[motion_method(lab.config.methods)].chromatic,
        corner_directions(lab.config.target, lab.instrument),
    )
    values = (np.array(list(of.values())) for of in (table.table1_px, table.sigma_px))
    return collimator_shift(lab.filtered, lab.instrument, corners, *values)


def axes(config: Config) -> Quantities:
    """Terms, axes, centroiders, pairs of filters."""
    q = Quantities()
    names = {name: LABELS.get(name, name) for name in EVERY}
    names["attitude"] = f"attitude, total / √{config.attitude.stars}"
    q.axis("term", list(names), "Term", names=names)
    q.axis("tested", list(TESTED), "Term")
    q.axis("aimed", list(AIMED), "Term")
    q.axis("axis", ["x", "y"], "Axis")
    labels = MethodLabels(own="simulator's PSF", measured="PSF from frames")
    q.axis("method", list(config.methods), "Centroider", names=labels)
    return q


def predict(config: Config, *, progress: Progress) -> dict[str, Any]:
    """The budget without frames, of the main centroider (`experiments.budget.predict.coarse_terms`)."""
    with progress.stage("predict"):
        terms = coarse_terms(config)
    return {"setup": setup(build_laboratory(config)), **of_prediction(config, {config.centroid: terms})}


def of_prediction(
    config: Config, predicted: Mapping[str, PredictedTerms], frames: Mapping[str, Measurement] | None = None
) -> dict[str, Any]:
    """Sections of a prediction, with measured values where frames exist."""
    sides = [compared(one, frames[name] if frames else None) for name, one in predicted.items()]
    known = is_published_sensor(config) or config.published_within_fraction is not None
    published = np.array([PUBLISHED_ARCSEC[name] for name in EVERY]) if known else None
    first = predicted[config.centroid]
    return {
        "terms": replace(sides[0], published_arcsec=published),
        "methods": sides if frames else None,
        "chief": chief(first),
        "causes": [Cause(name=name, arcsec=value) for name, value in first.causes_arcsec.items()],
    }


def run(config: Config, *, progress: Progress) -> dict[str, Any]:
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
    first, seen = predicted[config.centroid], frames[config.centroid]
    with progress.stage("attitude", total=len(config.attitude.counts)) as stage:
        errors = DirectionErrors.of(seen.budget)
        study = attitude_study(
            half_field(lab.instrument), errors, config.attitude, streams.child("attitude"), advance=stage.advance
        )
    if isinstance(thermal, Thermal):
        term = np.array([one.value for one in thermal.measured_arcsec])
        thermal = replace(
            thermal,
            total_predicted_arcsec=np.hypot(thermal.predicted_arcsec, first.budget.total.arcsec),
            total_measured_arcsec=np.hypot(term, seen.budget.total.arcsec),
        )
    return {
        "setup": replace(setup(lab), no_thermal=thermal if isinstance(thermal, str) else None),
        **of_prediction(config, predicted, frames),
        "agreement": [agreement(predicted[method], frames[method]) for method in config.methods],
        "tuned": tuned(config, seen),
        "parts": parts(first, seen),
        "chromatic": table1_of(first.chromatic, seen.chromatic),
        "collimator": collimator(lab, frames),
        **study,
        "thermal": thermal if isinstance(thermal, Thermal) else None,
    }


SECTIONS = {
    "setup": Section(record=Setup),
    "terms": Section(
        record=Comparison,
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
        record=Comparison,
        dim="method",
        rows="term axis",
        across="method",
        columns="measured_arcsec",
        caption="Measured budget by centroider, same frames, 3 sigma.",
    ),
    "chief": Section(record=Chief),
    "agreement": Section(
        record=Agreement,
        dim="method",
        rows="tested axis",
        across="method",
        columns="pull",
        caption="Deviations: predicted minus measured, in standard deviations, by centroider.",
        note="LSFE-S: signed entry of ACC18 Table 1 with the largest deviation from its prediction.",
        verdicts=[
            agree("deviation", 0.0, of="whole", each="method", title="TE, HSFE, S, C1, C2, predicted minus measured"),
            ratio_near("together", within=0.03, at={"method": 0}),
        ],
    ),
    "tuned": Section(
        record=Tuned, verdicts=[agree("over_published", 1.0, slack="within_fraction", title="measured over published")]
    ),
    "causes": Section(
        record=Cause,
        dim="cause",
        along="name",
        rows="cause",
        across="axis",
        caption="Predicted HSFE by cause, 3 sigma.",
        figures={"cause_bars": bars("cause", bars="arcsec", by="axis", width="half", aspect_ratio=0.75)},
    ),
    "parts": Section(record=Parts, rows="axis", caption="Parts of the terms, 3 sigma."),
    "chromatic": TABLE1,
    "collimator": COLLIMATOR,
    **attitude.SECTIONS,
    "thermal": THERMAL,
}
