"""The bench from the calibration (S100) to the accuracy of star vectors (S500), rendered: at rest, and on the move."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from calib.attitude.star_vectors import initial_frame_vectors
from calib.calibration.record import Calibration
from calib.cameras.base import CameraModel
from experiments.fisher.acquire import (
    Acquisition,
    Motion,
    Places,
    acquire,
    motion_of,
    place_psfs,
    smear_px,
    smeared_psfs,
    visit_once,
)
from experiments.fisher.checks import evaluation_px
from experiments.fisher.field_of_view import baseline_over_sphere
from experiments.fisher.predict import (
    Scatter,
    calibration_of_rows,
    covariance_of_rows,
    jitter_covariance_px2,
    on_the_sphere,
    predict_independent,
    predict_same_data,
    ratio_scatter,
    table_covariance_px2,
    tangent_maps,
)
from experiments.fisher.reduce import Evaluation, evaluate, expected_px
from experiments.fisher.settings import Config
from experiments.harness.progress import Progress
from experiments.laboratory.instrument import Instrument
from experiments.laboratory.single_star.bench import Bench
from experiments.laboratory.single_star.derivatives import reading_covariance_px2
from experiments.laboratory.single_star.measure import Measurement, measure
from experiments.laboratory.single_star.reduce import (
    Data,
    calibrated_bench,
    check_fit,
    reduce_data,
    start_model,
)
from experiments.laboratory.single_star.setup import averaged, build_bench, build_star, build_table, star_signal
from experiments.laboratory.single_star.star import SingleStar, star_direction
from experiments.laboratory.turntable import Turntable
from optics.arrays import FloatArray
from optics.units import RAD_ARCSEC
from render.engine.random import Streams
from render.forward import StarRenderer
from render.tracing.psf import epsf_tracer

__all__ = ["BenchRun", "Case", "SameData", "run_bench"]


PATH_PER_PX = 4
"""Instants per pixel of the streak by which a PSF is smeared."""
EXTRA_PSF_PX = 2
ADVICE = (
    "too few places (grid.columns, grid.rows) or too little motion for the unknowns, errors of the table that are not "
    "in its reading noise (table.encoder_amplitude_arcsec), or a lens that the camera model does not describe"
)
"""What to look at when a calibration does not fit."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Case:
    """One acquisition, evaluated."""

    acquisition: Acquisition  # The frames
    evaluation: Evaluation  # Steps S300-S500, with the calibration of S100, which has seen none of these frames
    predicted: Scatter  # From covariances
    # Standard deviation per axis that each cause is expected to make: "centroids", "readings", "clocks",
    # "calibration"
    expected_arcsec: Mapping[str, float]
    # What the causes made in this run, known to the simulation alone: "centroids", "table", "camera"
    realised_arcsec: Mapping[str, float]
    # Pixel method over Fisher as covariances and the lens predict it, with the calibrated angle per pixel, and the
    # standard deviation of that ratio of so many vectors, relative
    expected_ratio: float
    # Pixel method over Fisher as covariances and the lens predict it, with the calibrated angle per pixel, and the
    # standard deviation of that ratio of so many vectors, relative
    ratio_scatter: float
    smear_px: float  # Length of the streak

    @property
    def z_score(self) -> float:
        """How far the scatter is off its prediction, as a normal deviate."""
        return self.predicted.z_score(self.evaluation.fit.chord_sum_rad2)

    @property
    def table_arcsec(self) -> float:
        """What readings and clocks are expected to make together."""
        return float(np.hypot(self.expected_arcsec["readings"], self.expected_arcsec["clocks"]))

    @property
    def camera_arcsec(self) -> float:
        """Standard deviation without what the table is known to add; NaN where the table is all of it."""
        table2 = self.expected_arcsec["readings"] ** 2 + self.expected_arcsec["clocks"] ** 2
        rest = self.evaluation.sigma_arcsec**2 - table2
        return float(np.sqrt(rest)) if rest > 0 else float("nan")


@dataclass(frozen=True, slots=True, kw_only=True)
class SameData:
    """Static vectors, evaluated with a calibration that was fitted to them."""

    unknowns: int  # Of the calibration
    naive: Evaluation  # With 2 (n - 1) degrees of freedom, and with 2 n minus the unknowns
    corrected: Evaluation  # With 2 (n - 1) degrees of freedom, and with 2 n minus the unknowns
    predicted: Scatter  # From covariances


@dataclass(frozen=True, slots=True, kw_only=True)
class BenchRun:
    """Everything that was rendered."""

    measurement: Measurement  # Data of the calibration (S100)
    calibration: Calibration  # Its result
    model: CameraModel  # Camera and bench as calibrated
    bench: Bench  # Camera and bench as calibrated
    true_bench: Bench  # As it really is
    cases: Sequence[Case]  # At rest; on the move
    same_data: SameData  # At rest, calibrated with the data themselves
    resolutions_arcsec: Mapping[str, float]  # Angles per pixel that may be assumed


def run_bench(config: Config, instrument: Instrument, progress: Progress) -> BenchRun:
    """Calibrate, acquire at rest and on the move, evaluate."""
    streams = Streams(config.seed).child("fisher")
    with progress.stage("calibration (S100)", total=5) as stage:
        measurement = measure(
            config,
            instrument,
            config.table,
            streams.child("calibration"),
            advance=stage.advance,
        )
        believed = build_table(config.table).nominal
        calibration = _calibrate(measurement, believed, instrument, config)
        stage.advance()
    model, bench = calibration.model, calibrated_bench(calibration, believed)
    work = _Work(
        config=config,
        instrument=instrument,
        model=model,
        bench=bench,
        true_bench=build_bench(config, config.table),
        calibration=calibration,
        star=replace(
            build_star(config, instrument), signal_e=star_signal(config, instrument, config.evaluation).signal_e
        ),
        renderer=StarRenderer(instrument.camera, exposure_s=instrument.config.exposure_s),
        wanted_px=evaluation_px(config, instrument),
        streams=streams,
    )
    motion = motion_of(config.dynamic.rate_deg_per_s, config.dynamic.jitter_ms, config.dynamic.samples)
    with progress.stage("acquisition (S200)", total=3) as stage:
        psfs = work.psfs(motion)
        stage.advance()
        static = work.case("static", Motion(), psfs)
        stage.advance()
        dynamic = work.case("dynamic", motion, psfs)
        stage.advance()
    with progress.stage("same data"):
        same = _same_data(static.acquisition, believed, instrument, _nominal_star(config))
    return BenchRun(
        measurement=measurement,
        calibration=calibration,
        model=model,
        bench=bench,
        true_bench=work.true_bench,
        cases=(static, dynamic),
        same_data=same,
        resolutions_arcsec=_resolutions(model, instrument),
    )


def _resolutions(model: CameraModel, instrument: Instrument) -> dict[str, float]:
    camera = instrument.camera
    focal = float(model.parameters[model.parameter_names.index("focal_length_mm")])
    rounded = start_model(instrument, None)
    start = float(rounded.parameters[rounded.parameter_names.index("focal_length_mm")])
    half = camera.width_px * camera.pixel_pitch_mm / 2 / focal
    return {
        "calibrated": float(camera.pixel_pitch_mm / focal * RAD_ARCSEC),
        "data sheet": float(camera.pixel_pitch_mm / start * RAD_ARCSEC),
        "field over pixels": float(2 * np.arctan(half) / camera.width_px * RAD_ARCSEC),
    }


def _calibrate(measurement: Measurement, believed: Turntable, instrument: Instrument, config: Config) -> Calibration:
    data = Data.of(measurement)
    start, table = start_model(instrument, None), averaged(believed, config.frames)
    ahead = _nominal_star(config)
    calibration = reduce_data(data, table, start, leans=True, start_star=ahead)
    check_fit(calibration, "joint calibration (S100)", ADVICE)
    return calibration


def _nominal_star(config: Config) -> FloatArray:
    """Where the simulator was set up to stand, to whole degrees."""
    return star_direction(round(config.star.azimuth_deg), round(config.star.elevation_deg))


def _same_data(acquisition: Acquisition, believed: Turntable, instrument: Instrument, ahead: FloatArray) -> SameData:
    places, count = acquisition.places, len(acquisition.places)
    data = Data(
        pixel_px=np.array(acquisition.position_px),
        covariance_px2=np.array(acquisition.covariance_px2),
        reading_rad=np.array(places.reading_rad),
    )
    calibration = reduce_data(data, believed, start_model(instrument, None), leans=True, start_star=ahead)
    check_fit(calibration, "joint calibration with the vectors' own data", ADVICE)
    model, bench = calibration.model, calibrated_bench(calibration, believed)
    angle = np.array(places.reading_rad)
    maps = tangent_maps(model, bench, angle)
    noise = np.array(acquisition.covariance_px2) + reading_covariance_px2(model, bench, angle)
    unknowns = len(calibration.solution.names)

    def evaluated(freedom: float) -> Evaluation:
        return evaluate(
            model,
            bench,
            acquisition.position_px,
            angle,
            outlier_probability=None,
            degrees_of_freedom=freedom,
        )

    return SameData(
        unknowns=unknowns,
        naive=evaluated(2.0 * (count - 1)),
        corrected=evaluated(2.0 * count - unknowns),
        predicted=predict_same_data(maps, noise, calibration_of_rows(model, bench, angle)),
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class _Work:
    """What the acquisitions share."""

    config: Config
    instrument: Instrument
    model: CameraModel
    bench: Bench
    true_bench: Bench
    calibration: Calibration
    star: SingleStar
    renderer: StarRenderer
    wanted_px: FloatArray
    streams: Streams

    def _wanted(self) -> FloatArray:
        return self.instrument.camera.nominal_direction(
            self.wanted_px[:, 0], self.wanted_px[:, 1], self.instrument.focal_length_mm
        )

    def window_px(self, motion: Motion) -> int:
        """Side of a window that holds the streak as well as a window at rest holds the star."""
        return self.config.window_px + 2 * int(np.ceil(smear_px(motion, self.instrument) / 2))

    def psfs(self, motion: Motion) -> FloatArray:
        """PSFs (n, m, m) at the places, wide enough for the streak."""
        half = self.window_px(motion) // 2 + EXTRA_PSF_PX
        return place_psfs(epsf_tracer(self.instrument.camera), self.star, self._wanted(), self.instrument, half)

    def places(self, name: str, motion: Motion) -> Places:
        rolls = np.radians(self.config.table.rolls_deg)
        return visit_once(
            self.true_bench,
            self._wanted(),
            rolls[np.arange(len(self.wanted_px)) % len(rolls)],
            motion,
            self.config.evaluation.columns,
            self.streams.child(name),
        )

    def case(self, name: str, motion: Motion, psfs: FloatArray) -> Case:
        """One acquisition from the table to the prediction."""
        places = self.places(name, motion)
        taken = acquire(
            name,
            places,
            self.true_bench,
            self.star,
            self.renderer,
            smeared_psfs(psfs, self._path(places, motion)),
            expected_px(self.model, self.bench, places.reading_rad),
            self.instrument,
            window_px=self.window_px(motion),
            dark_frames=self.config.dark_frames,
            streams=self.streams.child(name),
        )
        evaluation = evaluate(
            self.model,
            self.bench,
            taken.position_px,
            taken.places.reading_rad,
            outlier_probability=self.config.evaluation.outlier_probability,
        )
        predicted, expected, (ratio, scatter) = self._predict(taken, motion)
        return Case(
            acquisition=taken,
            evaluation=evaluation,
            predicted=predicted,
            expected_arcsec=expected,
            realised_arcsec=self._realised(taken),
            expected_ratio=ratio,
            ratio_scatter=scatter,
            smear_px=smear_px(motion, self.instrument),
        )

    def _path(self, places: Places, motion: Motion) -> FloatArray:
        """Path of the image (n, t, 2) about its mean, from readings and rate."""
        if motion.rate_rad_per_s == 0.0:
            return np.zeros((len(places), 1, 2))
        instants = max(8, int(np.ceil(PATH_PER_PX * smear_px(motion, self.instrument))))
        known = replace(places, true_rad=places.reading_rad, motion=replace(motion, samples=instants))
        seen = known.directions(self.bench, self.instrument.config.exposure_s)
        path = self.model.project(seen.reshape(-1, 3)).reshape(len(seen), -1, 2)
        return np.asarray(path - path.mean(1, keepdims=True))

    def _predict(self, taken: Acquisition, motion: Motion) -> tuple[Scatter, dict[str, float], tuple[float, float]]:
        angle = np.array(taken.places.reading_rad)
        maps = tangent_maps(self.model, self.bench, angle)
        centroid = np.array(taken.covariance_px2)
        noise = centroid + table_covariance_px2(self.model, self.bench, angle, motion)
        rows = calibration_of_rows(self.model, self.bench, angle)
        known = covariance_of_rows(self.calibration)
        quiet = predict_independent(maps, 1e-30 * np.broadcast_to(np.eye(2), maps.shape), rows, known)
        expected = {
            "centroids": on_the_sphere(maps, centroid),
            "readings": on_the_sphere(maps, reading_covariance_px2(self.model, self.bench, angle)),
            "clocks": on_the_sphere(maps, jitter_covariance_px2(self.model, self.bench, angle, motion)),
            "calibration": quiet.sigma_arcsec,
        }
        ratio = baseline_over_sphere(self.model, np.array(taken.position_px), noise), ratio_scatter(maps, noise)
        return predict_independent(maps, noise, rows, known), expected, ratio

    def _realised(self, taken: Acquisition) -> dict[str, float]:
        """What each cause did, by putting the truth in place of the measured, one after the other."""
        places = taken.places

        def vectors(pixel: FloatArray, angle: FloatArray) -> FloatArray:
            return initial_frame_vectors(
                self.model,
                np.array(pixel),
                installation=self.bench.installation,
                table_rotation=self.bench.table.rotation(np.array(angle)),
            )

        def spread(difference: FloatArray) -> float:
            apart = difference - difference.mean(0)
            return float(np.sqrt(np.sum(apart**2) / (2 * (len(apart) - 1))) * RAD_ARCSEC)

        seen = vectors(taken.position_px, places.reading_rad)
        rays = vectors(taken.bundle_px, places.reading_rad)
        truth = vectors(taken.bundle_px, places.true_rad)
        return {"centroids": spread(seen - rays), "table": spread(rays - truth), "camera": spread(truth)}
