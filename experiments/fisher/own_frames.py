"""Accuracy of star vectors from own frames: poses that calibrate the camera, and poses whose vectors are evaluated."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from experiments.fisher.predict import (
    Scatter,
    calibration_of_rows,
    covariance_of_rows,
    on_the_sphere,
    predict_independent,
    tangent_maps,
)
from experiments.fisher.reduce import Evaluation, evaluate
from experiments.harness.pivot import Pivot
from experiments.harness.plotting import PALETTE, new_figure
from experiments.harness.quantities import Outcome, Quantities
from experiments.harness.summary import Criterion
from experiments.laboratory import point_figures
from experiments.laboratory.own_frames.experiment import FramesTest
from experiments.laboratory.own_frames.folder import FrameFolder
from experiments.laboratory.own_frames.series import SeriesFrames, reduce_series
from experiments.laboratory.own_frames.settings import SETTINGS_FILE
from experiments.laboratory.single_star.derivatives import reading_covariance_px2
from experiments.laboratory.single_star.own_frames import (
    POSES,
    PoseCalibration,
    calibrate_poses,
    fit_criteria,
    pose_data,
)
from experiments.laboratory.single_star.reduce import Data
from optics.errors import ConfigError, DomainError
from optics.units import ARCSEC_RAD

__all__ = ["VectorFrames", "own_frames", "reduce"]

SIGMA_LIMIT = 4.0
FEWEST = 10
"""Star vectors below which an accuracy means little."""


@dataclass(frozen=True, slots=True, kw_only=True)
class VectorFrames:
    """Star vectors of n frames that the calibration has not seen."""

    fitted: PoseCalibration  # From the poses for calibration
    evaluated: tuple[SeriesFrames, ...]  # The others, one frame each
    data: Data  # Their images and readings
    evaluation: Evaluation  # Steps S300 to S500
    predicted: Scatter  # From the covariances of images, readings and calibration
    parts_arcsec: Mapping[str, float]  # Standard deviation per axis that centroids and readings are expected to make

    @property
    def series(self) -> tuple[SeriesFrames, ...]:
        """Poses for calibration, then those for evaluation."""
        return (*self.fitted.series, *self.evaluated)


def reduce(folder: FrameFolder, methods: Sequence[str], config: Any) -> VectorFrames:
    """Calibrate with some poses, evaluate the star vectors of the others."""
    chosen = [one for one in folder.series if one.settings.use == "evaluation"]
    if not chosen:
        raise ConfigError(
            f"{SETTINGS_FILE}: no series has use = 'evaluation'; star vectors are evaluated on poses that did not "
            "calibrate"
        )
    several = next((one for one in chosen if len(one.windows.dn) > 1), None)
    if several is not None:
        raise ConfigError(
            f"{SETTINGS_FILE}, {several.name}: {len(several.windows.dn)} frames with use = 'evaluation'; a star vector "
            "is one frame with its own reading: give every frame a series (series_table), or evaluate one of them"
        )
    if len(chosen) < FEWEST:
        raise DomainError(f"{SETTINGS_FILE}: {len(chosen)} star vectors for evaluation; at least {FEWEST} are needed")
    fitted = calibrate_poses(folder, methods, ("calibration",))
    model, bench = fitted.calibration.model, fitted.bench
    evaluated = tuple(reduce_series(folder, one, methods[:1]) for one in chosen)
    data = pose_data(evaluated, bench.table, methods[0])
    lost = ~np.isfinite(data.pixel_px).all(1)
    if lost.any():
        raise DomainError(
            f"{evaluated[int(np.argmax(lost))].name}: no position by {methods[0]!r}; take another centroid"
        )
    probability = config.evaluation.outlier_probability
    evaluation = evaluate(model, bench, data.pixel_px, data.reading_rad, outlier_probability=probability)
    kept = ~evaluation.outlier
    angle, centroid = data.reading_rad[kept], data.covariance_px2[kept]
    maps, reading = tangent_maps(model, bench, angle), reading_covariance_px2(model, bench, angle)
    rows, known = calibration_of_rows(model, bench, angle), covariance_of_rows(fitted.calibration)
    return VectorFrames(
        fitted=fitted,
        evaluated=evaluated,
        data=data,
        evaluation=evaluation,
        predicted=predict_independent(maps, centroid + reading, rows, known),
        parts_arcsec={"centroids": on_the_sphere(maps, centroid), "readings": on_the_sphere(maps, reading)},
    )


def _describe(q: Quantities, reduced: VectorFrames, methods: Sequence[str]) -> None:
    evaluation, angle = reduced.evaluation, {"unit": "arcsec", "format": ".4f"}
    low, high = evaluation.interval_arcsec()
    q.add("sigma_arcsec", evaluation.sigma_arcsec, "Star vector, σ per axis", **angle)
    q.add("interval_arcsec", [low, high], "95 % interval", **angle, dims="end")
    q.add("predicted_arcsec", reduced.predicted.sigma_arcsec, "Predicted", **angle)
    for name, value in reduced.parts_arcsec.items():
        q.add(f"{name}_arcsec", value, f"of it {name}", **angle, json=f"predicted_parts_arcsec.{name}")
    model = reduced.fitted.calibration.model
    scale = float(np.arctan(model.geometry.pixel_pitch_mm / model.value("focal_length_mm")) / ARCSEC_RAD)
    q.add("pixel_method_arcsec", evaluation.baseline_arcsec(scale), "Pixel residuals", **angle)
    q.add(
        "z_score", reduced.predicted.z_score(evaluation.fit.chord_sum_rad2), "Measured against predicted", unit="sigma"
    )
    q.add("vectors", int((~evaluation.outlier).sum()), "Star vectors")
    q.add("outliers", int(evaluation.outlier.sum()), "Outliers left out")
    q.add("isotropy_p", evaluation.isotropy.p_value, "Chance of an ellipse as long", format=".3g")
    q.add("tails", evaluation.tails.statistic, "Kolmogorov statistic of the tails", format=".3g")
    q.add("calibration_poses", len(reduced.fitted.series), "Poses that calibrated")


def _headline(outcome: Outcome) -> Mapping[str, Any]:
    return {
        "Star vector, σ per axis": outcome.quantity("sigma_arcsec"),
        "Predicted": outcome.quantity("predicted_arcsec"),
    }


def _tables(outcome: Outcome) -> Mapping[str, Pivot]:
    return {"accuracy": _ACCURACY, "checks": _CHECKS}


_ACCURACY = Pivot(
    columns="sigma_arcsec predicted_arcsec centroids_arcsec readings_arcsec pixel_method_arcsec",
    caption="Standard deviation of a star vector per axis (FISHER23, S300 to S500), and what covariances predict.",
    note="*Pixel residuals*: standard deviation of the residuals on the detector times the angle of a pixel.",
)
_CHECKS = Pivot(columns="vectors outliers isotropy_p tails", caption="Whether the vectors follow the distribution.")


def _arrows(outcome: Outcome) -> Figure:
    """Residuals of the evaluated images as arrows over the detector."""
    reduced, folder = outcome.result.reduced, outcome.result.folder
    figure, panel = new_figure(aspect_ratio=0.7)
    error, reach = reduced.evaluation.residual_px * folder.settings.pixel_arcsec, 0.06 * folder.width_px
    longest = point_figures.arrows(panel, reduced.data.pixel_px, error, longest_px=reach, color=PALETTE[0], width=0.004)
    point_figures.detector_outline(panel, folder.width_px, folder.height_px)
    panel.set(xlabel="column [px]", ylabel="row [px]", title=f"longest {longest:.2f}″")
    return figure


def _criteria(outcome: Outcome) -> list[Criterion]:
    z = outcome.value("z_score")
    more = "the star moved during exposures, the table's readings are worse than stated, or the lens needs more terms"
    less = "the reading noise or the camera's noise is stated too large"
    return [
        *fit_criteria(outcome.result.reduced.fitted, outcome.result.folder),
        Criterion(
            name="scatter of the star vectors against what covariances predict",
            value=z,
            about=0.0,
            limit=SIGMA_LIMIT,
            unit="σ",
            advice=f"star vectors scatter {'more' if z > 0 else 'less'} than predicted: {more if z > 0 else less}",
        ),
        Criterion(
            name=f"star vectors that are outliers, at a level of {outcome.config.evaluation.outlier_probability:g}",
            value=outcome.value("outliers"),
            limit=0,
            advice="a few frames are off: a lost star, readings of another frame, a table that had not settled",
        ),
    ]


own_frames = FramesTest(
    title="Accuracy of star vectors",
    layout=POSES,
    reduce=reduce,
    describe=_describe,
    headline=_headline,
    tables=_tables,
    figures={
        "residuals": (_arrows, "Images of the evaluated frames minus the star as calibrated, at the angles as read.")
    },
    criteria=_criteria,
    show=("accuracy",),
    series="Pose",
)
