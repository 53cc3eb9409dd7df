"""Rendered bench from the calibration to the accuracy of star vectors, at rest and in motion.

Steps of FISHER23: S100 joint calibration, S200 acquisition, S300 star vectors in the table's frame, S400 concentration,
S500 standard deviation per axis. Separate frames calibrate the camera; single frames at other positions give star
vectors. Their scatter is compared with the prediction from covariances (`calib.directional.vector_scatter`), and
with the pixel-residual method on the same frames.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from calib.calibration.record import Calibration
from calib.calibration.star_bench import (
    StarBench,
    clock_covariance_px2,
    design_star_last,
    reading_covariance_px2,
    residual_px,
    star_direction,
    star_vector_by_pixel,
    star_vectors,
)
from calib.calibration.table_reduction import (
    PoseData,
    calibrate_on_table,
    calibrated_bench,
    check_count,
    check_fit,
    predicted_scatter,
)
from calib.cameras.base import CameraModel, unproject_jacobian
from calib.directional.fisher import tangent_plane
from calib.directional.pixel_method import pixel_method_ratio
from calib.directional.vector_accuracy import CONFIDENCE, VectorAccuracy, vector_accuracy
from calib.directional.vector_scatter import (
    VectorScatter,
    pixel_method_scatter,
    scatter_of_own_data,
    vector_sigma_arcsec,
)
from calib.measure.epsf.bspline import smeared_epsfs
from experiments.fisher.settings import FisherConfig
from experiments.harness.drawings import bars, cloud
from experiments.harness.progress import Progress
from experiments.harness.quantities import Quantities
from experiments.harness.sections import Section, agree, col
from experiments.harness.summary import Measured
from experiments.laboratory.devices.turntable import Turntable
from experiments.laboratory.single_star.acquisition import (
    Acquisition,
    TableMotion,
    TablePositions,
    acquire,
    place_psfs,
    smear_px,
    visit_once,
)
from experiments.laboratory.single_star.measure import measure
from experiments.laboratory.single_star.settings import GridConfig
from experiments.laboratory.single_star.setup import (
    build_bench,
    build_star,
    build_table,
    camera_under_test,
    check_table,
    grid_px,
    star_signal,
    start_model,
)
from optics.arrays import FloatArray
from optics.errors import ConfigError, DomainError
from optics.units import DEG_RAD, RAD_ARCSEC
from render.engine.random import Streams
from render.sensor_file.instrument import Instrument

ACQUISITIONS = ("static", "dynamic")
CAUSES = {
    "centroids": "centroids",
    "readings": "readings of the table",
    "clocks": "clocks of table and camera",
    "table": "readings and clocks",
    "calibration": "calibration and camera model",
}
ANGLES = ("calibrated", "data sheet", "field over pixels")
"""Angles per pixel that the pixel method may assume."""
MAX_SMEAR_PX = 40.0
PATH_PER_PX = 4
"""Instants per pixel of the streak by which a PSF is smeared."""
EXTRA_PSF_PX = 2
"""Margin of the PSF around a window."""
NO_NOISE_PX2 = 1e-30
"""Variance of an image for the scatter by the calibration alone; zero would be singular."""
RATIO_SLACK = 5e-4
"""Largest relative error of the predicted ratio of pixel method to Fisher, which is of first order in the noise."""
ADVICE = (
    "too few positions (grid.columns, grid.rows) or too little motion for the unknowns, errors of the table that are "
    "not in its reading noise (table.encoder_amplitude_arcsec), or a lens that the camera model does not describe"
)
"""Advice for a calibration that does not fit."""


def check_config(config: FisherConfig) -> Instrument:
    """The camera; all checks that need no rendering."""
    axes = len(build_table(config.table).axis)
    check_table("table", config.table, axes)
    if axes == 3 and len({round(roll % 360.0, 6) for roll in config.table.rolls_deg}) < 2:
        raise ConfigError(
            f"table.rolls_deg = {list(config.table.rolls_deg)}: the angle of a third axis to the second is not "
            "observable unless it moves; give at least two angles, or use two axes"
        )
    check_count(config.grid.columns * config.grid.rows, build_table(config.table))
    instrument = camera_under_test(config)
    grid_px(config, instrument)
    evaluation_px(config, instrument)
    build_star(config, instrument)
    if (smear := smear_px(_motion(config), instrument)) > MAX_SMEAR_PX:
        raise ConfigError(
            f"dynamic.rate_deg_per_s = {config.dynamic.rate_deg_per_s:g} deg/s smears the image over {smear:.0f} px in "
            f"{config.instrument.exposure_s:g} s; at most {MAX_SMEAR_PX:g} px: lower it or instrument.exposure_s"
        )
    if config.dynamic.samples < smear:
        raise ConfigError(
            f"dynamic.samples = {config.dynamic.samples} for a streak of {smear:.1f} px; at least one per "
            "pixel is needed"
        )
    return instrument


def evaluation_px(config: FisherConfig, instrument: Instrument) -> FloatArray:
    """Positions (n, 2) of the evaluation; checked like the positions of the calibration."""
    evaluation = config.evaluation
    grid = GridConfig(columns=evaluation.columns, rows=evaluation.rows, edge_px=evaluation.edge_px)
    try:
        check_count(evaluation.columns * evaluation.rows, build_table(config.table))
        return grid_px(config.model_copy(update={"grid": grid}), instrument)
    except DomainError as error:
        raise DomainError(str(error).replace("grid.", "evaluation.")) from None


def _motion(config: FisherConfig) -> TableMotion:
    dynamic = config.dynamic
    rate = dynamic.rate_deg_per_s * DEG_RAD
    return TableMotion(rate_rad_per_s=rate, jitter_s=dynamic.jitter_ms * 1e-3, samples=dynamic.samples)


@dataclass(frozen=True, slots=True, kw_only=True)
class CalibratedBench:
    """The bench with its calibration, before the star vectors are acquired."""

    config: FisherConfig
    instrument: Instrument
    streams: Streams
    true_bench: StarBench
    nominal_table: Turntable  # Orthogonal axes
    calibration: Calibration
    model: CameraModel  # Calibrated camera
    bench: StarBench

    @property
    def commanded(self) -> FloatArray:
        """Directions (n, 3) in cam of the positions of the evaluation."""
        position_px = evaluation_px(self.config, self.instrument)
        return self.instrument.camera.nominal_direction(
            position_px[:, 0], position_px[:, 1], self.instrument.focal_length_mm
        )

    def window_px(self, motion: TableMotion) -> int:
        """Side of a window for the streak, with the margin of a window at rest."""
        return self.config.window_px + 2 * int(np.ceil(smear_px(motion, self.instrument) / 2))


def calibrate_bench(config: FisherConfig, instrument: Instrument, streams: Streams, stage: Any) -> CalibratedBench:
    """Render the frames of the calibration, and fit camera, star, installation and axes to them."""
    measurement = measure(config, instrument, config.table, streams.child("calibration"), advance=stage.advance)
    nominal = build_table(config.table).nominal
    calibration = _joint_calibration(
        measurement.pose_data, nominal.averaged(config.frames), config, instrument, "joint calibration (S100)"
    )
    stage.advance()
    return CalibratedBench(
        config=config,
        instrument=instrument,
        streams=streams,
        true_bench=build_bench(config, config.table),
        nominal_table=nominal,
        calibration=calibration,
        model=calibration.model,
        bench=calibrated_bench(calibration, nominal),
    )


def _joint_calibration(
    data: PoseData, table: Turntable, config: FisherConfig, instrument: Instrument, name: str
) -> Calibration:
    """Fit that starts from the focal length of the data sheet and the star's direction rounded to degrees."""
    start_star = star_direction(round(config.star.azimuth_deg), round(config.star.elevation_deg))
    calibration = calibrate_on_table(data, table, start_model(instrument, None), leans=True, start_star=start_star)
    check_fit(calibration, name, ADVICE)
    return calibration


def acquire_frames(calibrated: CalibratedBench, name: str, motion: TableMotion, psfs: FloatArray) -> Acquisition:
    """A frame and a reading at every position of the evaluation."""
    config = calibrated.config
    streams = calibrated.streams.child(name)
    commanded = calibrated.commanded
    rolls = np.radians(config.table.rolls_deg)
    roll = rolls[np.arange(len(commanded)) % len(rolls)]
    places = visit_once(calibrated.true_bench, commanded, roll, motion, config.evaluation.columns, streams)
    return acquire(
        name,
        places,
        calibrated.true_bench,
        _dimmed_star(calibrated),
        smeared_epsfs(psfs, _path_px(calibrated, places)),
        calibrated.model.project(calibrated.bench.star_in_cam(places.reading_rad)),
        calibrated.instrument,
        window_px=calibrated.window_px(motion),
        dark_frames=config.dark_frames,
        streams=streams,
    )


def _dimmed_star(calibrated: CalibratedBench) -> Any:
    signal = star_signal(calibrated.config, calibrated.instrument, calibrated.config.evaluation)
    return replace(build_star(calibrated.config, calibrated.instrument), signal_e=signal.signal_e)


def _path_px(calibrated: CalibratedBench, places: TablePositions) -> FloatArray:
    """Path of the image (n, t, 2) about its mean, from readings and rate."""
    motion = places.motion
    if motion.rate_rad_per_s == 0.0:
        return np.zeros((len(places), 1, 2))
    instants = max(8, int(np.ceil(PATH_PER_PX * smear_px(motion, calibrated.instrument))))
    as_read = replace(places, true_rad=places.reading_rad, motion=replace(motion, samples=instants))
    direction = as_read.directions(calibrated.bench, calibrated.instrument.config.exposure_s)
    path = calibrated.model.project(direction.reshape(-1, 3)).reshape(len(direction), -1, 2)
    return np.asarray(path - path.mean(1, keepdims=True))


@dataclass(frozen=True, slots=True, kw_only=True)
class AcquisitionAccuracy:
    """Star vectors of an acquisition: standard deviation per axis by Fisher and by pixel residuals, predicted."""

    n: int = col("n")
    sigma_arcsec: Measured = col("σ per axis", "arcsec")
    sigma_interval_95_arcsec: Sequence[float] = col("95 %", "arcsec", ".4f", "end")
    sigma_predicted_arcsec: float = col("Predicted", "arcsec", ".4f")
    deviation_sigma: float = col("Deviation", "sigma", "+.2f")  # z score of the sum of squared chords
    # Deviation for an error of 100 % of the standard deviation, to first order
    full_deviation_sigma: float = col("Deviation for an error of 100 %", "sigma", ".1f", shown=False)
    # Predicted errors of readings and clocks subtracted in quadrature; NaN if they exceed the measured value
    sigma_without_table_arcsec: float = col("σ less table", "arcsec", ".4f")
    # The uncertainty is the scatter predicted for two methods on the same frames, hence with the same noise
    pixel_method_ratio: Measured = col("Pixel / Fisher", "", ".4f")
    pixel_method_ratio_predicted: float = col("Pixel / Fisher, predicted", "", ".4f")
    streak_px: float = col("Streak", "px", ".1f", shown=False)
    one_minus_resultant_length: float = col("1 − R", "", ".4e", shown=False)
    concentration_eq11: float = col("1/(1 − R)", "", ".4e", shown=False)  # FISHER23 eq. 11
    concentration: float = col("(n − 1)/(n (1 − R))", "", ".4e", shown=False)  # Unbiased inverse
    isotropy_p_value: float = col("Isotropy, p", "", ".2g", shown=False)  # Mauchly's test
    isotropy_ratio: float = col("Major over minor axis", "", ".2f", shown=False)
    # Modified Kolmogorov statistic of k (1 - cos) against the exponential distribution; 5 % critical value 1.094
    exponential_statistic: float = col("Kolmogorov", "", ".3f", shown=False)
    outliers: int = col("Outliers", shown=False)
    unmeasured: int = col("Positions without a centroid", shown=False)
    effective_degrees_of_freedom: float = col("Degrees of freedom from the scatter itself", "", ".0f", shown=False)
    sigma_interval_95_effective_arcsec: Sequence[float] = col(
        "95 % by degrees of freedom from the scatter", "arcsec", ".4f", "end", shown=False
    )
    pixel_method_arcsec: FloatArray = col("Pixel method", "arcsec", ".4f", "source", shown=False)
    offset_arcsec: FloatArray = col("Star vectors about their mean", "arcsec", dims="vector axis", shown=False)


def evaluate_acquisition(
    calibrated: CalibratedBench, acquired: Acquisition
) -> tuple[AcquisitionAccuracy, dict[str, float], dict[str, float]]:
    """Steps S300 to S500 of an acquisition; its scatter by cause, expected and realised."""
    motion = acquired.places.motion
    angle = acquired.places.reading_rad
    probability = calibrated.config.evaluation.outlier_probability
    measured = _evaluated(
        calibrated.model, calibrated.bench, acquired.position_px, angle, outlier_probability=probability
    )
    causes = _noise(calibrated, acquired)
    predicted, expected = _expected(calibrated, acquired, causes)
    noise = sum(causes.values(), np.zeros_like(acquired.covariance_px2))
    by_pixel = star_vector_by_pixel(calibrated.model, calibrated.bench, angle)
    pixel_angles = _angles_per_pixel(calibrated)
    fit = measured.fit
    without_table2 = measured.sigma_arcsec**2 - expected["table"] ** 2
    ratio = measured.pixel_method_arcsec(pixel_angles["calibrated"]) / measured.sigma_arcsec
    # With a rolled camera the methods subtract different means: their sigmas differ by some 1/n
    scatter = np.hypot(pixel_method_scatter(by_pixel, noise), 1.0 / fit.count if angle.shape[1] > 2 else 0.0)
    return (
        AcquisitionAccuracy(
            n=fit.count,
            sigma_arcsec=_sigma(measured),
            sigma_interval_95_arcsec=measured.interval_arcsec(),
            sigma_predicted_arcsec=predicted.sigma_arcsec,
            deviation_sigma=predicted.z_score(fit.chord_sum_rad2),
            full_deviation_sigma=float(np.sqrt(2.0 * predicted.satterthwaite)),
            sigma_without_table_arcsec=float(np.sqrt(without_table2)) if without_table2 > 0 else float("nan"),
            pixel_method_ratio=Measured(value=ratio, uncertainty=float(ratio * scatter)),
            pixel_method_ratio_predicted=_expected_pixel_method_ratio(calibrated.model, acquired.position_px, noise),
            streak_px=smear_px(motion, calibrated.instrument),
            one_minus_resultant_length=fit.deficit,
            concentration_eq11=fit.concentration_document,
            concentration=fit.concentration,
            isotropy_p_value=measured.isotropy.p_value,
            isotropy_ratio=measured.isotropy.ratio,
            exponential_statistic=measured.tails.statistic,
            outliers=int(measured.outlier.sum()),
            unmeasured=acquired.lost,
            effective_degrees_of_freedom=measured.effective_degrees,
            sigma_interval_95_effective_arcsec=measured.effective_interval_arcsec(),
            pixel_method_arcsec=np.array([measured.pixel_method_arcsec(angle) for angle in pixel_angles.values()]),
            offset_arcsec=_offsets(measured, len(calibrated.commanded)),
        ),
        expected,
        _realised(calibrated, acquired),
    )


def _evaluated(
    model: CameraModel, bench: StarBench, pixel_px: FloatArray, angle_rad: FloatArray, **options: Any
) -> VectorAccuracy:
    """Steps S300 to S500."""
    vectors = star_vectors(model, bench, pixel_px, angle_rad)
    return vector_accuracy(vectors, residual_px(model, bench, pixel_px, angle_rad), **options)


def _sigma(measured: VectorAccuracy) -> Measured:
    error = measured.fit.sigma_uncertainty_rad * RAD_ARCSEC
    return Measured(value=measured.sigma_arcsec, unit="arcsec", uncertainty=error, n=measured.fit.count)


def _offsets(measured: VectorAccuracy, count: int) -> FloatArray:
    """Vectors about their mean (count, 2), filled with rows of NaN for the positions without a centroid."""
    offset = np.full((count, 2), np.nan)
    offset[: len(measured.vectors)] = tangent_plane(measured.vectors, measured.fit.mean) * RAD_ARCSEC
    return offset


def _noise(calibrated: CalibratedBench, acquired: Acquisition) -> dict[str, FloatArray]:
    """Covariances of the images by centroids, readings of the table and clocks."""
    model = calibrated.model
    bench = calibrated.bench
    motion = acquired.places.motion
    angle = acquired.places.reading_rad
    return {
        "centroids": acquired.covariance_px2,
        "readings": reading_covariance_px2(model, bench, angle),
        "clocks": clock_covariance_px2(model, bench, angle, motion.rate_rad_per_s, motion.jitter_s),
    }


def _expected(
    calibrated: CalibratedBench, acquired: Acquisition, noise: Mapping[str, FloatArray]
) -> tuple[VectorScatter, dict[str, float]]:
    """Scatter from covariances, and standard deviation per axis by cause."""
    angle = acquired.places.reading_rad
    by_pixel = star_vector_by_pixel(calibrated.model, calibrated.bench, angle)
    total = sum(noise.values(), np.zeros(by_pixel.shape))
    no_noise = np.broadcast_to(NO_NOISE_PX2 * np.eye(2), by_pixel.shape)
    causes = {name: vector_sigma_arcsec(by_pixel, covariance) for name, covariance in noise.items()}
    causes["table"] = float(np.hypot(causes["readings"], causes["clocks"]))
    causes["calibration"] = predicted_scatter(calibrated.calibration, calibrated.bench, angle, no_noise).sigma_arcsec
    return predicted_scatter(calibrated.calibration, calibrated.bench, angle, total), causes


def _realised(calibrated: CalibratedBench, acquired: Acquisition) -> dict[str, float]:
    """Scatter per axis by cause in this run: measured quantities are replaced by the truth one after the other."""
    places = acquired.places
    bench = calibrated.model, calibrated.bench
    measured = star_vectors(*bench, acquired.position_px, places.reading_rad)
    rays = star_vectors(*bench, acquired.bundle_px, places.reading_rad)
    truth = star_vectors(*bench, acquired.bundle_px, places.true_rad)
    errors = {"centroids": measured - rays, "table": rays - truth, "calibration": truth}
    # A unit vector scatters in two of its three components
    return {name: float(np.sqrt(error.var(0, ddof=1).sum() / 2) * RAD_ARCSEC) for name, error in errors.items()}


def _expected_pixel_method_ratio(model: CameraModel, pixel_px: FloatArray, noise_px2: FloatArray) -> float:
    """Expected ratio of the pixel method, with the angle per pixel of the axis, to the truth."""
    axis_px = model.project(np.array([[0.0, 0.0, 1.0]]))
    by_pixel, on_axis = (unproject_jacobian(model, pixel).by_pixel for pixel in (pixel_px, axis_px))
    return pixel_method_ratio(by_pixel, on_axis[0], noise_px2)


def _angles_per_pixel(calibrated: CalibratedBench) -> dict[str, float]:
    """Angles of a pixel [arcsec] that the pixel method may assume: `ANGLES`."""
    camera = calibrated.instrument.camera
    models = calibrated.model, start_model(calibrated.instrument, None)
    focal_mm, data_sheet_mm = (model.value("focal_length_mm") for model in models)
    half_tangent = camera.width_px * camera.pixel_pitch_mm / 2 / focal_mm
    angles = (
        camera.pixel_pitch_mm / focal_mm,
        camera.pixel_pitch_mm / data_sheet_mm,
        2 * np.arctan(half_tangent) / camera.width_px,
    )
    return {name: float(angle * RAD_ARCSEC) for name, angle in zip(ANGLES, angles, strict=True)}


@dataclass(frozen=True, slots=True, kw_only=True)
class ScatterCause:
    """Scatter per axis by one of `CAUSES`; NaN where the run does not separate it from others."""

    expected_arcsec: Sequence[float] = col("Expected", "arcsec", ".4f", "acquisition")
    realised_arcsec: Sequence[float] = col("Realised", "arcsec", ".4f", "acquisition")


@dataclass(frozen=True, slots=True, kw_only=True)
class SameData:
    """Static vectors, evaluated with a calibration of q unknowns that was fitted to them."""

    unknowns: int = col("Unknowns q")
    naive_arcsec: float = col("σ with 2 (n − 1) degrees of freedom", "arcsec", ".4f")
    predicted_naive_arcsec: float = col("predicted", "arcsec", ".4f")
    corrected_arcsec: float = col("σ with 2 n − q degrees of freedom", "arcsec", ".4f")


@dataclass(frozen=True, slots=True, kw_only=True)
class FisherSetup:
    """Instrument of the measurement."""

    lens: str = col("Lens")
    pixel_arcsec: float = col("Angle of a pixel", "arcsec", ".2f")
    calibration_signal_e: float = col("Signal of the calibration", "e-", ".0f")
    calibration_signal_star: str = col("Star of the calibration")
    signal_e: float = col("Signal", "e-", ".0f")
    signal_star: str = col("Star")
    pixel_angle_arcsec: FloatArray = col("Angle per pixel", "arcsec", ".5f", "source")


def evaluate_calibration_data(calibrated: CalibratedBench, acquired: Acquisition) -> SameData:
    """Calibrate with the evaluated data, and evaluate them with the result."""
    angle = acquired.places.reading_rad
    count = len(acquired.places)
    data = PoseData(pixel_px=acquired.position_px, covariance_px2=acquired.covariance_px2, reading_rad=angle)
    name = "joint calibration with the evaluated data"
    table = calibrated.nominal_table
    calibration = _joint_calibration(data, table, calibrated.config, calibrated.instrument, name)
    model = calibration.model
    bench = calibrated_bench(calibration, table)
    noise = data.covariance_px2 + reading_covariance_px2(model, bench, angle)
    by_pixel = star_vector_by_pixel(model, bench, angle)
    unknowns = len(calibration.solution.names)
    naive, corrected = (
        _evaluated(
            model, bench, data.pixel_px, angle, outlier_probability=None, degrees_of_freedom=freedom
        ).sigma_arcsec
        for freedom in (2.0 * (count - 1), 2.0 * count - unknowns)
    )
    return SameData(
        unknowns=unknowns,
        naive_arcsec=naive,
        predicted_naive_arcsec=scatter_of_own_data(by_pixel, noise, design_star_last(model, bench, angle)).sigma_arcsec,
        corrected_arcsec=corrected,
    )


def describe_setup(calibrated: CalibratedBench) -> FisherSetup:
    """Lens, and signals of the calibration and of the evaluation."""
    calibration = star_signal(calibrated.config, calibrated.instrument, None)
    evaluation = star_signal(calibrated.config, calibrated.instrument, calibrated.config.evaluation)
    return FisherSetup(
        lens=calibrated.instrument.camera.lens.name,
        pixel_arcsec=calibrated.instrument.pixel_arcsec,
        calibration_signal_e=calibration.signal_e,
        calibration_signal_star=calibration.star,
        signal_e=evaluation.signal_e,
        signal_star=evaluation.star,
        pixel_angle_arcsec=np.array(list(_angles_per_pixel(calibrated).values())),
    )


def axes(config: FisherConfig) -> Quantities:
    """Dimensions that sections share."""
    q = Quantities()
    q.axis("acquisition", ACQUISITIONS, "Acquisition")
    q.axis("cause", list(CAUSES), "Cause", names=CAUSES)
    q.axis("source", ANGLES, "Angle per pixel from")
    half = round(50.0 * (1.0 - CONFIDENCE), 6)
    q.axis("end", [half, 100.0 - half], "End", unit="percent", names=["from", "to"])
    return q


def run_rendered(
    config: FisherConfig, instrument: Instrument, streams: Streams, progress: Progress
) -> Mapping[str, Any]:
    """Calibrate, acquire at rest and on the move, evaluate: records of the sections."""
    with progress.stage("calibration (S100)", total=5) as stage:
        calibrated = calibrate_bench(config, instrument, streams, stage)
    moving = _motion(config)
    with progress.stage("acquisition (S200)", total=3) as stage:
        half = calibrated.window_px(moving) // 2 + EXTRA_PSF_PX
        psfs = place_psfs(_dimmed_star(calibrated), calibrated.commanded, instrument, half)
        stage.advance()
        acquisitions = []
        for name, motion in zip(ACQUISITIONS, (TableMotion(), moving), strict=True):
            acquisitions.append(acquire_frames(calibrated, name, motion, psfs))
            stage.advance()
    with progress.stage("evaluation (S300-S500)"):
        records, expected, realised = zip(
            *(evaluate_acquisition(calibrated, acquired) for acquired in acquisitions), strict=True
        )
        causes = [
            ScatterCause(
                expected_arcsec=[sigmas[cause] for sigmas in expected],
                realised_arcsec=[sigmas.get(cause, np.nan) for sigmas in realised],
            )
            for cause in CAUSES
        ]
        static = evaluate_calibration_data(calibrated, acquisitions[0])
    return {"setup": describe_setup(calibrated), "accuracy": records, "causes": causes, "same_data": static}


SECTIONS = {
    "accuracy": Section(
        record=AcquisitionAccuracy,
        dim="acquisition",
        across="end source",
        caption="Accuracy of single-frame star vectors (S300–S500).",
        note="Uncertainty 1 σ, interval by χ² with 2 (n − 1) degrees of freedom. Predicted: from the "
        "covariances of centroids, readings, clocks, calibration; deviation in σ. σ less table: "
        "known contributions of readings and clocks subtracted in quadrature. Pixel method: with "
        "the calibrated angle per pixel, same frames.",
        figures={
            "vector_scatter": cloud(
                "offset_arcsec", ellipses="sigma_arcsec sigma_predicted_arcsec", panels="acquisition"
            )
        },
        verdicts=[
            agree(
                "deviation_sigma",
                0.0,
                error=1.0,
                of="full_deviation_sigma",
                title="standard deviation of the star vectors against the prediction, static and dynamic",
                advice="noise of centroids or table readings differs from the stated noise: see the causes",
            ),
            agree(
                "pixel_method_ratio",
                with_="pixel_method_ratio_predicted",
                slack=RATIO_SLACK,
                title="ratio of pixel method to Fisher against the prediction from lens and noise",
                advice="the angle per pixel changes over the field by more than the camera model describes",
            ),
        ],
    ),
    "causes": Section(
        record=ScatterCause,
        dim="cause",
        across="acquisition",
        caption="Scatter by cause, per axis.",
        note="Expected: from covariances. Realised: in this run, with the truth in place of all other "
        "measured quantities.",
        figures={
            "cause_bars": bars("cause", bars="realised_arcsec", points="expected_arcsec", panels="acquisition"),
        },
    ),
    "same_data": Section(record=SameData),
    "setup": Section(record=FisherSetup),
}
