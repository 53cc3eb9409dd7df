"""Accuracy of drawn star vectors: by the distribution, by pixels, by cause; no image is rendered."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calib.calibration.star_bench import StarBench, aiming_angles, star_direction
from calib.calibration.table_reduction import PoseData, calibrate_on_table
from calib.cameras import BrownConrady, SensorGeometry
from experiments.fisher import accuracy as study
from experiments.fisher import experiment, own_frames
from experiments.fisher.accuracy import CalibratedBench, _path_px, evaluate_acquisition, evaluate_calibration_data
from experiments.fisher.settings import FisherConfig, rendered
from experiments.harness.progress import Progress
from experiments.laboratory.devices.turntable import build_turntable
from experiments.laboratory.single_star.acquisition import TableMotion, visit_once
from experiments.reduce.poses import PoseCalibration
from experiments.turntable import own_frames as turntable_frames
from optics.errors import StarbenchError
from optics.units import RAD_ARCSEC
from render.engine.random import Streams

SIGMA_PX, PIXEL_RAD, COUNT = 0.02, 0.0055 / 50.0, 100
READING_ARCSEC = (0.2, 0.5)


@pytest.fixture(scope="module")
def calibrated():
    """A bench and a camera of 50 mm that are calibrated to a millionth of a pixel."""
    geometry = SensorGeometry(width_px=2048, height_px=2048, pixel_pitch_mm=0.0055)
    model = BrownConrady.create(geometry, focal_length_mm=50.0, x0_px=6.0, y0_px=-4.0, q1_per_mm2=2e-5)
    table = build_turntable("xy", reading_noise_arcsec=READING_ARCSEC, non_orthogonality_arcsec=4.0)
    bench = StarBench(
        table=table, star=star_direction(0.3, -0.2), installation=Rotation.from_rotvec([0.01, -0.02, 0.3])
    )  # fmt: skip
    angle = aiming_angles(bench, model.unproject(geometry.grid_px(6)), np.zeros(36))
    exact = PoseData(
        pixel_px=model.project(bench.star_in_cam(angle)),
        covariance_px2=np.tile(1e-12 * np.eye(2), (36, 1, 1)),
        reading_rad=angle,
    )
    still = build_turntable("xy", reading_noise_arcsec=(1e-6, 1e-6), non_orthogonality_arcsec=4.0)
    calibration = calibrate_on_table(exact, still, model, leans=True, start_star=np.array(bench.star))
    camera = SimpleNamespace(
        lens=SimpleNamespace(name="drawn"),
        width_px=2048,
        height_px=2048,
        pixel_pitch_mm=0.0055,
        nominal_direction=lambda x, y, f: model.unproject(geometry.grid_px(10)),
    )
    instrument = SimpleNamespace(
        camera=camera,
        focal_length_mm=50.0,
        pixel_arcsec=PIXEL_RAD * RAD_ARCSEC,
        config=SimpleNamespace(exposure_s=0.2),
    )
    return CalibratedBench(
        config=FisherConfig(),
        instrument=instrument,
        streams=Streams(1),
        true_bench=bench,
        nominal_table=table,
        calibration=calibration,
        model=model,
        bench=bench,
    )


def acquired_with(calibrated, seed, motion=None):
    """Images with centroid noise at the true angles of the table, and noisy readings."""
    direction = calibrated.model.unproject(calibrated.model.geometry.grid_px(10))
    places = visit_once(calibrated.true_bench, direction, np.zeros(COUNT), motion or TableMotion(), 10, Streams(seed))
    exact_px = calibrated.model.project(calibrated.bench.star_in_cam(np.array(places.true_rad)))
    noise = SIGMA_PX * np.random.default_rng(seed).standard_normal(exact_px.shape)
    return SimpleNamespace(
        places=places,
        position_px=exact_px + noise,
        covariance_px2=np.tile(SIGMA_PX**2 * np.eye(2), (COUNT, 1, 1)),
        bundle_px=exact_px,
        lost=3,
    )


def test_scatter_is_predicted_by_cause(calibrated):
    """40 acquisitions of 100 vectors: deviations of a normal distribution, a variance known to sqrt(2 / 40)."""
    motion = TableMotion(rate_rad_per_s=2e-3, jitter_s=2e-3, samples=4)
    results = [evaluate_acquisition(calibrated, acquired_with(calibrated, seed, motion)) for seed in range(40)]
    z = np.array([result.deviation_sigma for result, _, _ in results])
    assert abs(z.mean()) < 4.0 / np.sqrt(40)
    assert z.std() == pytest.approx(1.0, abs=4.0 / np.sqrt(80))
    ratio = np.array([result.pixel_method_ratio.value for result, _, _ in results])
    first, expected, _ = results[0]
    assert ratio.mean() == pytest.approx(first.pixel_method_ratio_predicted, abs=4.0 * ratio.std() / np.sqrt(40) + 1e-4)
    assert ratio.std() == pytest.approx(first.pixel_method_ratio.uncertainty, rel=4.0 / np.sqrt(80))
    pixel = PIXEL_RAD * RAD_ARCSEC
    assert expected["centroids"] == pytest.approx(SIGMA_PX * pixel, rel=0.03)  # the field makes it smaller
    # one axis turns the star by its own noise, both across it; per axis half of the sum of squares
    assert expected["readings"] == pytest.approx(np.hypot(*READING_ARCSEC) / np.sqrt(2.0), rel=0.06)
    clocks = motion.rate_rad_per_s * motion.jitter_s * RAD_ARCSEC / np.sqrt(2.0)
    assert expected["clocks"] == pytest.approx(clocks, rel=0.06, abs=1e-12)
    assert expected["table"] == pytest.approx(np.hypot(expected["readings"], expected["clocks"]))
    assert expected["calibration"] < 1e-3
    total = np.hypot(expected["centroids"], expected["table"])
    assert first.sigma_predicted_arcsec == pytest.approx(total, rel=1e-3)
    for cause in ("centroids", "table"):
        size = np.sqrt(np.mean([realised[cause] ** 2 for *_, realised in results]))
        assert size == pytest.approx(expected[cause], rel=4.0 / np.sqrt(2 * 40 * 100))
    for result, _, realised in results:
        assert realised["calibration"] < 1e-6
        if np.isnan(result.sigma_without_table_arcsec):
            continue
        table2 = result.sigma_arcsec.value**2 - result.sigma_without_table_arcsec**2
        assert table2 == pytest.approx(expected["table"] ** 2, rel=0.05)
        assert result.sigma_interval_95_arcsec[0] < result.sigma_arcsec.value < result.sigma_interval_95_arcsec[1]


def test_one_acquisition_in_numbers(calibrated):
    acquired = acquired_with(calibrated, 4, TableMotion(rate_rad_per_s=2e-3, jitter_s=0.0, samples=4))
    result, _, _ = evaluate_acquisition(calibrated, acquired)
    assert (result.n, result.unmeasured, result.outliers) == (COUNT, 3, 0)
    assert result.streak_px == pytest.approx(2e-3 * 0.2 / PIXEL_RAD)
    kappa = result.concentration
    assert result.concentration_eq11 == pytest.approx(1.0 / result.one_minus_resultant_length)
    assert kappa == pytest.approx(result.concentration_eq11 * (COUNT - 1) / COUNT, rel=1e-6)
    # of a Fisher distribution 1 / kappa is the variance per axis
    assert result.sigma_arcsec.value == pytest.approx(RAD_ARCSEC / np.sqrt(kappa), rel=1e-3)
    assert result.sigma_arcsec.uncertainty == pytest.approx(result.sigma_arcsec.value / np.sqrt(4.0 * COUNT), rel=0.1)
    assert result.offset_arcsec.shape == (COUNT, 2)
    squares = (result.offset_arcsec**2).sum() / (2.0 * (COUNT - 1))
    assert np.sqrt(squares) == pytest.approx(result.sigma_arcsec.value, rel=1e-3)
    pixel_arcsec, sheet_arcsec, field_arcsec = result.pixel_method_arcsec
    assert pixel_arcsec / result.sigma_arcsec.value == pytest.approx(result.pixel_method_ratio.value)
    half = np.arctan(1024 * PIXEL_RAD)
    assert field_arcsec / pixel_arcsec == pytest.approx(half / (1024 * PIXEL_RAD))
    assert sheet_arcsec > pixel_arcsec  # a data sheet's focal length is rounded down
    # z of an error of 100 %: the deviation of a variance of 2 n degrees by twice itself, root of n degrees
    assert result.full_deviation_sigma == pytest.approx(np.sqrt(2.0 * 2.0 * COUNT), rel=0.15)
    path = _path_px(calibrated, acquired.places)
    length = np.linalg.norm(path[:, -1] - path[:, 0], axis=1) * path.shape[1] / (path.shape[1] - 1)
    assert length.max() == pytest.approx(result.streak_px, rel=0.1)
    assert np.abs(path.mean(1)).max() < 1e-9
    assert not _path_px(calibrated, acquired_with(calibrated, 4).places).any()


def test_vectors_used_in_the_calibration_scatter_less(calibrated):
    """Fourteen unknowns of 200 coordinates: 10 acquisitions of 200 numbers are known to 4 / sqrt(4000)."""
    results = [evaluate_calibration_data(calibrated, acquired_with(calibrated, seed)) for seed in range(10)]
    assert {result.unknowns for result in results} == {14}
    for result in results:
        assert result.corrected_arcsec / result.naive_arcsec == pytest.approx(np.sqrt(198.0 / 186.0))
    naive = np.sqrt(np.mean([result.naive_arcsec**2 for result in results]))
    predicted = results[0].predicted_naive_arcsec
    assert naive == pytest.approx(predicted, rel=4.0 / np.sqrt(4000))
    total = np.hypot(SIGMA_PX * PIXEL_RAD * RAD_ARCSEC, np.hypot(*READING_ARCSEC) / np.sqrt(2.0))
    assert predicted < 0.98 * total


def test_a_run_on_coordinates(calibrated, monkeypatch):
    """Calibration, acquisitions at rest and in motion and all sections, with drawn centroids in place of frames."""

    def measured(config, instrument, table, streams, *, advance):
        angle = aiming_angles(
            calibrated.bench, calibrated.model.unproject(calibrated.model.geometry.grid_px(6)), np.zeros(36)
        )
        pixel = calibrated.model.project(calibrated.bench.star_in_cam(angle))
        data = PoseData(pixel_px=pixel, covariance_px2=np.tile(1e-12 * np.eye(2), (36, 1, 1)), reading_rad=angle)
        return SimpleNamespace(pose_data=data)

    def acquire_drawn(name, places, bench, star, psfs, expected_px, instrument, **options):
        assert np.abs(expected_px - calibrated.model.project(bench.star_in_cam(places.reading_rad))).max() < 1e-3
        return acquired_with(calibrated, 5, places.motion)

    monkeypatch.setattr(study, "measure", measured)
    monkeypatch.setattr(study, "acquire", acquire_drawn)
    monkeypatch.setattr(study, "place_psfs", lambda star, direction, instrument, half: np.zeros((len(direction), 3, 3)))
    monkeypatch.setattr(study, "build_bench", lambda config, table: calibrated.true_bench)
    monkeypatch.setattr(study, "_dimmed_star", lambda calibrated: None)
    monkeypatch.setattr(
        study, "build_table", lambda config: replace(calibrated.nominal_table, reading_noise_arcsec=[1e-6, 1e-6])
    )
    monkeypatch.setattr(study, "star_signal", lambda *_: SimpleNamespace(signal_e=2000.0, star=""))
    monkeypatch.setattr(
        CalibratedBench,
        "commanded",
        property(lambda _: calibrated.model.unproject(calibrated.model.geometry.grid_px(10))),
    )
    config = FisherConfig(field={"field_deg": (3.0, 20.0), "directions": 100, "runs": 5})
    monkeypatch.setattr(experiment, "check_config", lambda config: calibrated.instrument)
    outcome = rendered.outcome(config, experiment.run(config, progress=Progress()))
    sigma = outcome.values("sigma_arcsec")
    assert sigma[1] > sigma[0]  # clocks
    assert outcome.values("one_minus_resultant_length") == pytest.approx((sigma / RAD_ARCSEC) ** 2, rel=0.05)
    assert outcome.values("expected_arcsec", cause="clocks", acquisition="static") == 0.0
    assert outcome.value("same_data.unknowns") == 14
    assert outcome.values("closed_form_percent") == pytest.approx([0.0343, 1.557], rel=2e-3)


def test_own_frames_of_poses(calibrated, monkeypatch):
    """Poses that calibrate and poses that are evaluated; a pose of several frames, too few and none are refused."""
    acquired = acquired_with(calibrated, 6)
    data = PoseData(
        pixel_px=acquired.position_px, covariance_px2=acquired.covariance_px2, reading_rad=acquired.places.reading_rad
    )
    fitted = PoseCalibration(series=(), data=data, calibration=calibrated.calibration, bench=calibrated.bench)
    monkeypatch.setattr(own_frames, "calibrate_poses", lambda *_: fitted)
    monkeypatch.setattr(own_frames, "reduce_series", lambda folder, series, methods: series)
    monkeypatch.setattr(own_frames, "pose_data", lambda series, table, method: data)
    pose = SimpleNamespace(
        name="p", settings=SimpleNamespace(use="evaluation"), windows=SimpleNamespace(dn=np.zeros((1, 3)))
    )
    settings = SimpleNamespace(pixel_arcsec=PIXEL_RAD * RAD_ARCSEC, prnu_fraction=0.0)
    folder = SimpleNamespace(series=[pose] * COUNT, settings=settings, flat=None)
    config = FisherConfig()
    _, records = own_frames.reduce(folder, ["epsf"], config)
    vectors, distribution = records["vectors"], records["distribution"]
    assert distribution.vectors + distribution.outliers == COUNT
    assert vectors.sigma_arcsec == pytest.approx(vectors.predicted_arcsec, rel=4.0 / np.sqrt(4 * COUNT))
    assert vectors.interval_arcsec[0] < vectors.sigma_arcsec < vectors.interval_arcsec[1]
    parts = np.hypot(vectors.centroids_arcsec, vectors.readings_arcsec)
    assert vectors.predicted_arcsec == pytest.approx(parts, rel=0.01)
    monkeypatch.setattr(turntable_frames, "calibrate_poses", lambda *_: fitted)
    _, records = turntable_frames.reduce(folder, ["epsf"])
    assert [unknown.name for unknown in records["unknowns"]][8:10] == ["star_azimuth_rad", "star_elevation_rad"]
    assert records["errors"].centroid_sigma_px == pytest.approx([SIGMA_PX] * 2)
    assert len(records["poses"]) == COUNT
    assert "worse" in own_frames._scatter_advice(SimpleNamespace(value=lambda name: 4.0))
    assert "too large" in own_frames._scatter_advice(SimpleNamespace(value=lambda name: -4.0))
    several = SimpleNamespace(**{**vars(pose), "windows": SimpleNamespace(dn=np.zeros((2, 3)))})
    for series, words in (([], "no series has use"), ([several], "own table reading"), ([pose] * 9, "at least 10")):
        folder.series = series
        with pytest.raises(StarbenchError, match=words):
            own_frames.reduce(folder, ["epsf"], config)
