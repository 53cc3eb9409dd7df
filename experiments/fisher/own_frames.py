"""Accuracy of star vectors from own frames: poses that calibrate the camera, and poses whose vectors are evaluated."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from calib.calibration.star_bench import (
    reading_covariance_px2,
    residual_px,
    star_vector_by_pixel,
    star_vectors,
)
from calib.calibration.table_reduction import predicted_scatter
from calib.directional.vector_accuracy import vector_accuracy
from calib.directional.vector_scatter import vector_sigma_arcsec
from experiments.harness.drawings import arrows
from experiments.harness.quantities import Outcome
from experiments.harness.sections import Section, agree, below, col
from experiments.reduce.folder import FrameFolder
from experiments.reduce.frames_toml import SETTINGS_FILE
from experiments.reduce.pipeline import FramesTest, Reduced
from experiments.reduce.poses import FIT, POSES, calibrate_poses, fit_record, pose_data
from experiments.reduce.series import reduce_series
from optics.arrays import FloatArray
from optics.errors import ConfigError, DomainError
from optics.units import ARCSEC_RAD

MIN_VECTORS = 10
"""Smallest number of star vectors for an accuracy."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Vectors:
    """Star vectors of frames that did not calibrate: standard deviation per axis."""

    sigma_arcsec: float = col("Star vector, σ per axis", "arcsec", ".4f")
    interval_arcsec: Sequence[float] = col("95 % interval", "arcsec", ".4f", "end", shown=False)
    # Propagated from the covariances of images, readings and calibration
    predicted_arcsec: float = col("Predicted", "arcsec", ".4f")
    centroids_arcsec: float = col("by centroids", "arcsec", ".4f")
    readings_arcsec: float = col("by readings", "arcsec", ".4f")
    pixel_method_arcsec: float = col("Pixel residuals", "arcsec", ".4f")
    deviation_sigma: float = col("Measured against predicted", "sigma", shown=False)
    # Deviation for an error of 100 % of the standard deviation, to first order
    full_deviation_sigma: float = col("Deviation for an error of 100 %", "sigma", shown=False)
    calibration_poses: int = col("Poses that calibrated", shown=False)
    position_px: FloatArray = col("Image", "px", ".2f", "vector axis")
    residual_arcsec: FloatArray = col("Residual", "arcsec", ".2f", "vector axis")


@dataclass(frozen=True, slots=True, kw_only=True)
class Distribution:
    """Tests of the distribution of the vectors."""

    vectors: int = col("Star vectors")
    outliers: int = col("Outliers rejected")
    isotropy_p_value: float = col("Probability of an ellipse at least as elongated", format=".3g")
    exponential_statistic: float = col("Kolmogorov statistic of the tails", format=".3g")


def _evaluation_series(folder: FrameFolder) -> list[Any]:
    """Series for evaluation; refuses none, too few, and series of several frames."""
    chosen = [series for series in folder.series if series.settings.use == "evaluation"]
    if not chosen:
        raise ConfigError(
            f"{SETTINGS_FILE}: no series has use = 'evaluation'; star vectors must be evaluated on poses without "
            "use in the calibration"
        )
    several = next((series for series in chosen if len(series.windows.dn) > 1), None)
    if several is not None:
        raise ConfigError(
            f"{SETTINGS_FILE}, {several.name}: {len(several.windows.dn)} frames with use = 'evaluation'; a star "
            "vector needs its own table reading: give every frame a series (series_table), or evaluate a single "
            "frame"
        )
    if len(chosen) < MIN_VECTORS:
        raise DomainError(
            f"{SETTINGS_FILE}: {len(chosen)} star vectors for evaluation; at least {MIN_VECTORS} are needed"
        )
    return chosen


def reduce(folder: FrameFolder, methods: Sequence[str], config: Any) -> Reduced:
    """Calibrate with the poses for calibration, evaluate the star vectors of the poses for evaluation."""
    evaluation_series = _evaluation_series(folder)
    fitted = calibrate_poses(folder, methods, ("calibration",))
    model, bench = fitted.calibration.model, fitted.bench
    evaluated = tuple(reduce_series(folder, series, methods[:1]) for series in evaluation_series)
    data = pose_data(evaluated, bench.table, methods[0])
    unmeasured = ~np.isfinite(data.pixel_px).all(1)
    if unmeasured.any():
        raise DomainError(
            f"{evaluated[int(np.argmax(unmeasured))].name}: no position by {methods[0]!r}; take another centroid"
        )
    evaluation = vector_accuracy(
        star_vectors(model, bench, data.pixel_px, data.reading_rad),
        residual_px(model, bench, data.pixel_px, data.reading_rad),
        outlier_probability=config.evaluation.outlier_probability,
    )
    inlier = ~evaluation.outlier
    angle = data.reading_rad[inlier]
    centroid = data.covariance_px2[inlier]
    reading = reading_covariance_px2(model, bench, angle)
    by_pixel = star_vector_by_pixel(model, bench, angle)
    predicted = predicted_scatter(fitted.calibration, bench, angle, centroid + reading)
    scale = float(np.arctan(model.geometry.pixel_pitch_mm / model.value("focal_length_mm")) / ARCSEC_RAD)
    return (*fitted.series, *evaluated), {
        "vectors": Vectors(
            sigma_arcsec=evaluation.sigma_arcsec,
            interval_arcsec=evaluation.interval_arcsec(),
            predicted_arcsec=predicted.sigma_arcsec,
            centroids_arcsec=vector_sigma_arcsec(by_pixel, centroid),
            readings_arcsec=vector_sigma_arcsec(by_pixel, reading),
            pixel_method_arcsec=evaluation.pixel_method_arcsec(scale),
            deviation_sigma=predicted.z_score(evaluation.fit.chord_sum_rad2),
            full_deviation_sigma=float(np.sqrt(2.0 * predicted.satterthwaite)),
            calibration_poses=len(fitted.series),
            position_px=data.pixel_px,
            residual_arcsec=evaluation.residual_px * folder.settings.pixel_arcsec,
        ),
        "distribution": Distribution(
            vectors=int(inlier.sum()),
            outliers=int(evaluation.outlier.sum()),
            isotropy_p_value=evaluation.isotropy.p_value,
            exponential_statistic=evaluation.tails.statistic,
        ),
        "fit": fit_record(fitted, folder),
    }


def _scatter_advice(outcome: Outcome) -> str:
    if outcome.value("deviation_sigma") > 0:
        return (
            "star vectors scatter more than predicted: the star moved during exposures, the table's readings are worse "
            "than stated, or the lens needs more terms"
        )
    return "star vectors scatter less than predicted: the reading noise or the camera's noise is stated too large"


own_frames = FramesTest(
    title="Accuracy of star vectors",
    layout=POSES,
    reduce=reduce,
    sections={
        "vectors": Section(
            record=Vectors,
            table="accuracy",
            columns="sigma_arcsec predicted_arcsec centroids_arcsec readings_arcsec pixel_method_arcsec",
            caption="Standard deviation of a star vector per axis (FISHER23, S300 to S500), measured and "
            "predicted from covariances.",
            note="*Pixel residuals*: standard deviation of the residuals on the detector times the angle of a pixel.",
            figures={"residuals": arrows("position_px", "residual_arcsec", frame="frame_size_px")},
            verdicts=[
                agree(
                    "deviation_sigma",
                    0.0,
                    error=1.0,
                    of="full_deviation_sigma",
                    title="scatter of the star vectors against what covariances predict",
                    advice=_scatter_advice,
                )
            ],
        ),
        "distribution": Section(
            record=Distribution,
            table="checks",
            caption="Tests of the distribution of the vectors.",
            verdicts=[
                below(
                    "outliers",
                    0,
                    title="star vectors that are outliers (evaluation.outlier_probability)",
                    advice="a few wrong frames: a lost star, readings of another frame, a table that had not settled",
                )
            ],
        ),
        "fit": FIT,
    },
    head={"Star vector, σ per axis": ("sigma_arcsec", {}), "Predicted": ("predicted_arcsec", {})},
    captions={"residuals": "Images of the evaluated frames minus the star as calibrated, at the angles as read."},
    series="Pose",
)
