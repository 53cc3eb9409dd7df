"""Rendered bench from the calibration to the accuracy of star vectors, at rest and in motion.

Steps of FISHER23: S100 joint calibration, S200 acquisition, S300 star vectors in the table's frame, S400 concentration,
S500 standard deviation per axis. Separate frames calibrate the camera; single frames at other places become star
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
from experiments.fisher.settings import Config
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
LONGEST_SMEAR_PX = 40.0
PATH_PER_PX = 4
"""Instants per pixel of the streak by which a PSF is smeared."""
EXTRA_PSF_PX = 2
NO_NOISE_PX2 = 1e-30
RATIO_SLACK = 5e-4
"""Largest relative error of the predicted ratio of pixel method to Fisher, which is of first order in the noise."""
ADVICE = (
    "too few places (grid.columns, grid.rows) or too little motion for the unknowns, errors of the table that are not "
    "in its reading noise (table.encoder_amplitude_arcsec), or a lens that the camera model does not describe"
)
"""Advice for a calibration that does not fit."""


def check_config(config: Config) -> Instrument:
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
    if (smear := smear_px(_motion(config), instrument)) > LONGEST_SMEAR_PX:
        raise ConfigError(
            f"dynamic.rate_deg_per_s = {config.dynamic.rate_deg_per_s:g} deg/s smears the image over {smear:.0f} px in "
            f"{config.instrument.exposure_s:g} s; at most {LONGEST_SMEAR_PX:g} px: lower it or instrument.exposure_s"
        )
    if config.dynamic.samples < smear:
        raise ConfigError(
            f"dynamic.samples = {config.dynamic.samples} for a streak of {smear:.1f} px; at least one per "
            "pixel is needed"
        )
    return instrument


def evaluation_px(config: Config, instrument: Instrument) -> FloatArray:
    """Places (n, 2) of the evaluation; checked like those of the calibration."""
    chosen = config.evaluation
    grid = GridConfig(columns=chosen.columns, rows=chosen.rows, edge_px=chosen.edge_px)
    try:
        check_count(chosen.columns * chosen.rows, build_table(config.table))
        return grid_px(config.model_copy(update={"grid": grid}), instrument)
    except DomainError as error:
        raise DomainError(str(error).replace("grid.", "evaluation.")) from None


def _motion(config: Config) -> TableMotion:
    dynamic = config.dynamic
    rate = dynamic.rate_deg_per_s * DEG_RAD
    return TableMotion(rate_rad_per_s=rate, jitter_s=dynamic.jitter_ms * 1e-3, samples=dynamic.samples)


@dataclass(frozen=True, slots=True, kw_only=True)
class Calibrated:
    """The bench with its calibration, before the star vectors are acquired."""

    config: Config
    instrument: Instrument
    streams: Streams
    true_bench: StarBench  # As it really is
    believed: Turntable  # Axes taken as square
    calibration: Calibration
    model: CameraModel  # Camera and bench as calibrated
    bench: StarBench

    @property
    def wanted(self) -> FloatArray:
        """Directions (n, 3) in cam of the places of the evaluation."""
        place = evaluation_px(self.config, self.instrument)
        return self.instrument.camera.nominal_direction(place[:, 0], place[:, 1], self.instrument.focal_length_mm)

    def window_px(self, motion: TableMotion) -> int:
        """Side of a window that holds the streak as well as a window at rest holds the star."""
        return self.config.window_px + 2 * int(np.ceil(smear_px(motion, self.instrument) / 2))


def calibrated(config: Config, instrument: Instrument, streams: Streams, stage: Any) -> Calibrated:
    """Render the frames of the calibration, and fit camera, star, installation and axes to them."""
    measurement = measure(config, instrument, config.table, streams.child("calibration"), advance=stage.advance)
    believed = build_table(config.table).nominal
    calibration = _fitted(
        measurement.pose_data, believed.averaged(config.frames), config, instrument, "joint calibration (S100)"
    )
    stage.advance()
    return Calibrated(
        config=config,
        instrument=instrument,
        streams=streams,
        true_bench=build_bench(config, config.table),
        believed=believed,
        calibration=calibration,
        model=calibration.model,
        bench=calibrated_bench(calibration, believed),
    )


def _fitted(data: PoseData, table: Turntable, config: Config, instrument: Instrument, what: str) -> Calibration:
    """Joint calibration from a poor start: a data sheet's focal length, the simulator's direction to whole degrees."""
    ahead = star_direction(round(config.star.azimuth_deg), round(config.star.elevation_deg))
    calibration = calibrate_on_table(data, table, start_model(instrument, None), leans=True, start_star=ahead)
    check_fit(calibration, what, ADVICE)
    return calibration


def acquisition(rig: Calibrated, name: str, motion: TableMotion, psfs: FloatArray) -> Acquisition:
    """One frame and one reading at every place of the evaluation."""
    config, own = rig.config, rig.streams.child(name)
    wanted, rolls = rig.wanted, np.radians(config.table.rolls_deg)
    roll = rolls[np.arange(len(wanted)) % len(rolls)]
    places = visit_once(rig.true_bench, wanted, roll, motion, config.evaluation.columns, own)
    return acquire(
        name,
        places,
        rig.true_bench,
        _dimmed_star(rig),
        smeared_epsfs(psfs, _path_px(rig, places)),
        rig.model.project(rig.bench.star_in_cam(places.reading_rad)),
        rig.instrument,
        window_px=rig.window_px(motion),
        dark_frames=config.dark_frames,
        streams=own,
    )


def _dimmed_star(rig: Calibrated) -> Any:
    signal = star_signal(rig.config, rig.instrument, rig.config.evaluation)
    return replace(build_star(rig.config, rig.instrument), signal_e=signal.signal_e)


def _path_px(rig: Calibrated, places: TablePositions) -> FloatArray:
    """Path of the image (n, t, 2) about its mean, from readings and rate."""
    motion = places.motion
    if motion.rate_rad_per_s == 0.0:
        return np.zeros((len(places), 1, 2))
    instants = max(8, int(np.ceil(PATH_PER_PX * smear_px(motion, rig.instrument))))
    known = replace(places, true_rad=places.reading_rad, motion=replace(motion, samples=instants))
    direction = known.directions(rig.bench, rig.instrument.config.exposure_s)
    path = rig.model.project(direction.reshape(-1, 3)).reshape(len(direction), -1, 2)
    return np.asarray(path - path.mean(1, keepdims=True))


@dataclass(frozen=True, slots=True, kw_only=True)
class Accuracy:
    """Star vectors of one acquisition: standard deviation per axis by Fisher and by pixel residuals, predicted."""

    n: int = col("n")
    sigma_arcsec: Measured = col("σ per axis", "arcsec")
    sigma_interval_95_arcsec: Sequence[float] = col("95 %", "arcsec", ".4f", "end")
    sigma_predicted_arcsec: float = col("Predicted", "arcsec", ".4f")
    z_score: float = col("Deviation", "sigma", "+.2f")  # By the distribution of the sum of squared chords
    # The deviation that an error of 100 % of the standard deviation makes, to first order
    z_of_whole: float = col("Deviation for an error of 100 %", "sigma", ".1f", shown=False)
    # Readings and clocks of the table taken off in quadrature; NaN where they are all of it
    sigma_without_table_arcsec: float = col("σ less table", "arcsec", ".4f")
    # Uncertainty: scatter of the ratio from covariances; both methods share the noise
    baseline_over_fisher: Measured = col("Pixel / Fisher", "", ".4f")
    baseline_over_fisher_predicted: float = col("Pixel / Fisher, predicted", "", ".4f")
    streak_px: float = col("Streak", "px", ".1f", shown=False)
    one_minus_resultant_length: float = col("1 − R", "", ".4e", shown=False)
    concentration_document: float = col("1/(1 − R)", "", ".4e", shown=False)  # FISHER23 eq. 11
    concentration: float = col("(n − 1)/(n (1 − R))", "", ".4e", shown=False)  # Its inverse is unbiased
    isotropy_p_value: float = col("Isotropy, p", "", ".2g", shown=False)  # Mauchly's test
    isotropy_ratio: float = col("Major over minor axis", "", ".2f", shown=False)
    # Modified Kolmogorov statistic of k (1 - cos) against the exponential distribution, refused at 5 % above 1.094
    exponential_statistic: float = col("Kolmogorov", "", ".3f", shown=False)
    outliers: int = col("Outliers", shown=False)
    lost: int = col("Places without a position", shown=False)
    effective_degrees: float = col("Degrees of freedom from the scatter itself", "", ".0f", shown=False)
    sigma_interval_95_own_degrees_arcsec: Sequence[float] = col(
        "95 % by degrees of freedom from the scatter", "arcsec", ".4f", "end", shown=False
    )
    baseline_arcsec: FloatArray = col("Pixel method", "arcsec", ".4f", "source", shown=False)
    offset_arcsec: FloatArray = col("Star vectors about their mean", "arcsec", dims="vector axis", shown=False)


def accuracy(rig: Calibrated, taken: Acquisition) -> tuple[Accuracy, dict[str, float], dict[str, float]]:
    """Steps S300 to S500 of one acquisition; scatter by cause, expected and realised."""
    motion, angle = taken.places.motion, taken.places.reading_rad
    probability = rig.config.evaluation.outlier_probability
    found = _evaluated(rig.model, rig.bench, taken.position_px, angle, outlier_probability=probability)
    causes = _noise(rig, taken)
    predicted, expected = _expected(rig, taken, causes)
    noise = sum(causes.values(), np.zeros_like(taken.covariance_px2))
    by_pixel = star_vector_by_pixel(rig.model, rig.bench, angle)
    angles, n, fit = _angles_per_pixel(rig), found.fit.count, found.fit
    rest = found.sigma_arcsec**2 - expected["table"] ** 2
    ratio = found.pixel_method_arcsec(angles["calibrated"]) / found.sigma_arcsec
    # a rolled camera takes another mean off: some 1/n of a difference
    chance = np.hypot(pixel_method_scatter(by_pixel, noise), 1.0 / n if angle.shape[1] > 2 else 0.0)
    return (
        Accuracy(
            n=n,
            sigma_arcsec=_sigma(found),
            sigma_interval_95_arcsec=found.interval_arcsec(),
            sigma_predicted_arcsec=predicted.sigma_arcsec,
            z_score=predicted.z_score(fit.chord_sum_rad2),
            z_of_whole=float(np.sqrt(2.0 * predicted.satterthwaite)),
            sigma_without_table_arcsec=float(np.sqrt(rest)) if rest > 0 else float("nan"),
            baseline_over_fisher=Measured(value=ratio, uncertainty=float(ratio * chance)),
            baseline_over_fisher_predicted=_pixel_method_ratio(rig.model, taken.position_px, noise),
            streak_px=smear_px(motion, rig.instrument),
            one_minus_resultant_length=fit.deficit,
            concentration_document=fit.concentration_document,
            concentration=fit.concentration,
            isotropy_p_value=found.isotropy.p_value,
            isotropy_ratio=found.isotropy.ratio,
            exponential_statistic=found.tails.statistic,
            outliers=int(found.outlier.sum()),
            lost=taken.lost,
            effective_degrees=found.effective_degrees,
            sigma_interval_95_own_degrees_arcsec=found.effective_interval_arcsec(),
            baseline_arcsec=np.array([found.pixel_method_arcsec(one) for one in angles.values()]),
            offset_arcsec=_offsets(found, len(rig.wanted)),
        ),
        expected,
        _realised(rig, taken),
    )


def _evaluated(
    model: CameraModel, bench: StarBench, pixel_px: FloatArray, angle_rad: FloatArray, **options: Any
) -> VectorAccuracy:
    """Steps S300 to S500."""
    vectors = star_vectors(model, bench, pixel_px, angle_rad)
    return vector_accuracy(vectors, residual_px(model, bench, pixel_px, angle_rad), **options)


def _sigma(found: VectorAccuracy) -> Measured:
    error = found.fit.sigma_uncertainty_rad * RAD_ARCSEC
    return Measured(value=found.sigma_arcsec, unit="arcsec", uncertainty=error, n=found.fit.count)


def _offsets(found: VectorAccuracy, count: int) -> FloatArray:
    """Vectors about their mean (count, 2), NaN for places without a position."""
    offset = np.full((count, 2), np.nan)
    offset[: len(found.vectors)] = tangent_plane(found.vectors, found.fit.mean) * RAD_ARCSEC
    return offset


def _noise(rig: Calibrated, taken: Acquisition) -> dict[str, FloatArray]:
    """Covariances of the images by centroids, readings of the table and clocks."""
    model, bench, motion = rig.model, rig.bench, taken.places.motion
    angle = taken.places.reading_rad
    return {
        "centroids": taken.covariance_px2,
        "readings": reading_covariance_px2(model, bench, angle),
        "clocks": clock_covariance_px2(model, bench, angle, motion.rate_rad_per_s, motion.jitter_s),
    }


def _expected(
    rig: Calibrated, taken: Acquisition, noise: Mapping[str, FloatArray]
) -> tuple[VectorScatter, dict[str, float]]:
    """Scatter from covariances, and the standard deviation per axis that each cause makes."""
    angle = taken.places.reading_rad
    by_pixel = star_vector_by_pixel(rig.model, rig.bench, angle)
    total = sum(noise.values(), np.zeros(by_pixel.shape))
    nothing = np.broadcast_to(NO_NOISE_PX2 * np.eye(2), by_pixel.shape)
    alone = predicted_scatter(rig.calibration, rig.bench, angle, nothing)
    causes = {name: vector_sigma_arcsec(by_pixel, one) for name, one in noise.items()}
    table = float(np.hypot(causes["readings"], causes["clocks"]))
    return predicted_scatter(rig.calibration, rig.bench, angle, total), {
        **causes,
        "table": table,
        "calibration": alone.sigma_arcsec,
    }


def _realised(rig: Calibrated, taken: Acquisition) -> dict[str, float]:
    """What each cause did in this run, by putting the truth in place of the measured, one after the other."""
    places = taken.places

    bench = rig.model, rig.bench
    measured = star_vectors(*bench, taken.position_px, places.reading_rad)
    rays = star_vectors(*bench, taken.bundle_px, places.reading_rad)
    truth = star_vectors(*bench, taken.bundle_px, places.true_rad)
    parts = {"centroids": measured - rays, "table": rays - truth, "calibration": truth}
    # two of the three components of a vector scatter
    return {name: float(np.sqrt(part.var(0, ddof=1).sum() / 2) * RAD_ARCSEC) for name, part in parts.items()}


def _pixel_method_ratio(model: CameraModel, pixel_px: FloatArray, noise_px2: FloatArray) -> float:
    """Expected ratio of the pixel method, with the angle per pixel of the axis, to the truth."""
    axis_px = model.project(np.array([[0.0, 0.0, 1.0]]))
    by_pixel, on_axis = (unproject_jacobian(model, pixel).by_pixel for pixel in (pixel_px, axis_px))
    return pixel_method_ratio(by_pixel, on_axis[0], noise_px2)


def _angles_per_pixel(rig: Calibrated) -> dict[str, float]:
    """Angles of a pixel [arcsec] that the pixel method may assume: `ANGLES`."""
    camera = rig.instrument.camera
    focal, sheet = (model.value("focal_length_mm") for model in (rig.model, start_model(rig.instrument, None)))
    half = camera.width_px * camera.pixel_pitch_mm / 2 / focal
    angles = camera.pixel_pitch_mm / focal, camera.pixel_pitch_mm / sheet, 2 * np.arctan(half) / camera.width_px
    return {name: float(angle * RAD_ARCSEC) for name, angle in zip(ANGLES, angles, strict=True)}


@dataclass(frozen=True, slots=True, kw_only=True)
class Cause:
    """Scatter per axis by one of `CAUSES`; NaN where the run does not tell it apart."""

    expected_arcsec: Sequence[float] = col(
        "Expected",
        "arcsec",
        ".4f",
        "acquisition",
    )
    realised_arcsec: Sequence[float] = col(
        "Realised",
        "arcsec",
        ".4f",
        "acquisition",
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class SameData:
    """Static vectors, evaluated with a calibration of q unknowns that was fitted to them."""

    unknowns: int = col("Unknowns q")
    naive_arcsec: float = col("σ with 2 (n − 1) degrees of freedom", "arcsec", ".4f")
    predicted_naive_arcsec: float = col("predicted", "arcsec", ".4f")
    corrected_arcsec: float = col("σ with 2 n − q degrees of freedom", "arcsec", ".4f")


@dataclass(frozen=True, slots=True, kw_only=True)
class Setup:
    """Instrument of the measurement."""

    lens: str = col("Lens")
    pixel_arcsec: float = col("Angle of a pixel", "arcsec", ".2f")
    calibration_signal_e: float = col("Signal of the calibration", "e-", ".0f")
    calibration_signal_star: str = col("Star of the calibration")
    signal_e: float = col("Signal", "e-", ".0f")
    signal_star: str = col("Star")
    resolutions_arcsec: FloatArray = col("Angle per pixel", "arcsec", ".5f", "source")


def same_data(rig: Calibrated, taken: Acquisition) -> SameData:
    """Calibrate with the vectors' own data, and evaluate them with the result."""
    angle, count = taken.places.reading_rad, len(taken.places)
    data = PoseData(pixel_px=taken.position_px, covariance_px2=taken.covariance_px2, reading_rad=angle)
    what = "joint calibration with the vectors' own data"
    calibration = _fitted(data, rig.believed, rig.config, rig.instrument, what)
    model, bench = calibration.model, calibrated_bench(calibration, rig.believed)
    noise = data.covariance_px2 + reading_covariance_px2(model, bench, angle)
    by_pixel, unknowns = star_vector_by_pixel(model, bench, angle), len(calibration.solution.names)
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


def setup(rig: Calibrated) -> Setup:
    """Light and lens."""
    first, star = (star_signal(rig.config, rig.instrument, one) for one in (None, rig.config.evaluation))
    return Setup(
        lens=rig.instrument.camera.lens.name,
        pixel_arcsec=rig.instrument.pixel_arcsec,
        calibration_signal_e=first.signal_e,
        calibration_signal_star=first.star,
        signal_e=star.signal_e,
        signal_star=star.star,
        resolutions_arcsec=np.array(list(_angles_per_pixel(rig).values())),
    )


def axes(config: Config) -> Quantities:
    """Dimensions that sections share."""
    q = Quantities()
    q.axis("acquisition", ACQUISITIONS, "Acquisition")
    q.axis("cause", list(CAUSES), "Cause", names=CAUSES)
    q.axis("source", ANGLES, "Angle per pixel from")
    half = round(50.0 * (1.0 - CONFIDENCE), 6)
    q.axis("end", [half, 100.0 - half], "End", unit="percent", names=["from", "to"])
    return q


def rendered(config: Config, instrument: Instrument, streams: Streams, progress: Progress) -> Mapping[str, Any]:
    """Calibrate, acquire at rest and on the move, evaluate: records of the sections."""
    with progress.stage("calibration (S100)", total=5) as stage:
        rig = calibrated(config, instrument, streams, stage)
    moving = _motion(config)
    with progress.stage("acquisition (S200)", total=3) as stage:
        half = rig.window_px(moving) // 2 + EXTRA_PSF_PX
        psfs = place_psfs(_dimmed_star(rig), rig.wanted, instrument, half)
        stage.advance()
        taken = []
        for name, motion in zip(ACQUISITIONS, (TableMotion(), moving), strict=True):
            taken.append(acquisition(rig, name, motion, psfs))
            stage.advance()
    with progress.stage("evaluation (S300-S500)"):
        records, expected, realised = zip(*(accuracy(rig, one) for one in taken), strict=True)
        causes = [
            Cause(
                expected_arcsec=[one[cause] for one in expected],
                realised_arcsec=[one.get(cause, np.nan) for one in realised],
            )
            for cause in CAUSES
        ]
        own = same_data(rig, taken[0])
    return {"setup": setup(rig), "accuracy": records, "causes": causes, "same_data": own}


SECTIONS = {
    "accuracy": Section(
        record=Accuracy,
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
                "z_score",
                0.0,
                error=1.0,
                of="z_of_whole",
                title="standard deviation of the star vectors against the prediction, static and dynamic",
                advice="noise of centroids or table readings differs from the stated noise: see the causes",
            ),
            agree(
                "baseline_over_fisher",
                with_="baseline_over_fisher_predicted",
                slack=RATIO_SLACK,
                title="ratio of pixel method to Fisher against the prediction from lens and noise",
                advice="the angle per pixel changes over the field by more than the camera model describes",
            ),
        ],
    ),
    "causes": Section(
        record=Cause,
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
    "setup": Section(record=Setup),
}
