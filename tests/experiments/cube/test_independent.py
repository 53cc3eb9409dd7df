"""Criteria by written-out equations: they hold over seeds, and fail where an equation is wrong."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from calib.calibration import cube_mirror
from experiments.cube import bench as cube_bench
from experiments.cube import budget, independent
from experiments.cube import reduce as cube_reduce
from experiments.cube.bench import Case, build_table, concentric_angles, draw_truths, geometry_of
from experiments.cube.criteria import DIFFERENCES, WRITTEN_OUT_ARCSEC
from experiments.cube.independent import covariance_off, reading_effect_arcsec, written_out_off_arcsec
from experiments.cube.noise import _spot_variance_px2, cube_error_per_lean, cube_matrix, sensor_noise
from experiments.cube.quantities import UNEQUAL_ARCSEC
from experiments.cube.reduce import reduce_bench
from experiments.cube.sensor import field_angles, fit_sensor
from experiments.cube.settings import Config
from experiments.laboratory.turntable import Turntable
from render.detector.spec import load_detector
from render.engine.random import Streams

ARCSEC = np.pi / 648000


def written_out(seed=1, spot_px=0.005):
    """R_sp of a bench on coordinates, with readings and spots of some noise, against the written-out one."""
    config = Config(benches={"count": 2}, sensor={"grid": 5})
    truth = draw_truths(config, Streams(seed))[0]
    case = Case(name="", label="", reading=True)
    table, rng = build_table(config, truth, case), np.random.default_rng(seed)
    angle = field_angles(config)
    reading = table.read(angle, Streams(seed).child("sensor"))
    sun = table.rotation(angle).inv().apply([0.0, 0.0, 1.0]) @ truth.sensor_from_table.T
    spots = truth.sensor.spot_px(sun) + spot_px * rng.standard_normal((len(angle), 2))
    sensor = fit_sensor(config, spots, reading, table, truth.sensor, free=False)
    offset = SimpleNamespace(offset_px=np.zeros(2), covariance_px2=1e-4 * np.eye(2))
    trims = [
        SimpleNamespace(
            face=face,
            reading_rad=table.read(
                concentric_angles(table, truth.normal_in_table(face), face)[None], Streams(seed).child(face)
            )[0],
            own=offset,
            offset=offset,
        )
        for face in config.cube.faces
    ]
    geometry = geometry_of(config)
    laboratory = SimpleNamespace(config=config, geometry=geometry, pitch_mm=0.015, tilt_per_px=0.015 / geometry.path_mm)
    found = reduce_bench(laboratory, truth, table, trims, sensor, improved=False)
    return written_out_off_arcsec(config, truth, found, SimpleNamespace(pixel_px=spots))


def reading_off():
    outer, inner = UNEQUAL_ARCSEC
    return np.abs(budget.reading_term(outer, inner) / reading_effect_arcsec(outer, inner) - 1).max()


def test_criteria_hold():
    assert written_out() < WRITTEN_OUT_ARCSEC
    assert reading_off() < DIFFERENCES
    assert covariance_off() < DIFFERENCES


@pytest.mark.slow
def test_criteria_hold_over_seeds():
    assert max(written_out(seed) for seed in range(20)) < WRITTEN_OUT_ARCSEC


def reversed_axes(self, _original=Turntable.true_axis.fget):
    return -_original(self)


def base_vectors_as_rows(reference, observed, _original=cube_mirror.triad):
    return _original(observed, reference)


def normal_from_laboratory(table, reading_rad, offset_mm, distance_mm):
    return table.rotation(reading_rad[None])[0].apply([0.0, 0.0, 1.0])


MUTANTS = {
    "sense of the axes reversed": (Turntable, "true_axis", property(reversed_axes)),
    "eq. 5 transposed": (cube_mirror, "triad", base_vectors_as_rows),
    "eq. 7 without its inverses": (cube_reduce, "measured_normal", normal_from_laboratory),
}


@pytest.mark.parametrize("name", MUTANTS)
def test_r_sp_written_out_notices(name, monkeypatch):
    owner, attribute, wrong = MUTANTS[name]
    monkeypatch.setattr(owner, attribute, wrong)
    assert not written_out() < WRITTEN_OUT_ARCSEC


def test_r_sp_written_out_notices_the_order_of_eq_11(monkeypatch):
    """As printed, R_sr^-1 R_pr: rotation and truth alike."""

    def printed(cube, sensor_from_table, covariance):
        return sensor_from_table.inv() * cube.rotation, np.zeros((3, 3)) + cube.covariance_rad2 + covariance

    monkeypatch.setattr(cube_reduce, "sensor_to_cube", printed)
    assert not written_out() < WRITTEN_OUT_ARCSEC


def test_exchanged_readings_are_noticed(monkeypatch):
    monkeypatch.setattr(budget, "reading_term", lambda outer, inner: np.array([inner, outer, inner]))
    assert not reading_off() < DIFFERENCES


def test_a_covariance_turned_the_wrong_way_is_noticed(monkeypatch):
    def wrong(cube, sensor_from_table, covariance):
        turn = (cube.rotation * sensor_from_table.inv()).as_matrix()
        return None, cube.covariance_rad2 + turn.T @ covariance @ turn

    monkeypatch.setattr(independent, "sensor_to_cube", wrong)
    assert not covariance_off() < DIFFERENCES


def test_cube_frame_by_hand():
    """Faces that look at the Sun at (180, 0) and (90, 0) deg: Z of the cube looks back, X against the table's."""
    assert cube_matrix(np.zeros(2), np.radians([180.0, 90.0])) == pytest.approx(np.diag([-1.0, 1.0, -1.0]), abs=1e-12)
    assert cube_error_per_lean() == pytest.approx([0.0, 0.0, -1.0], abs=1e-4)


@pytest.mark.slow
def test_noise_of_the_sun_sensor_is_that_of_many_fits():
    """Spots of known noise, N = 200 fits; a standard deviation is known to 5 %, four of those."""
    config = Config(benches={"count": 2}, sensor={"grid": 5})
    laboratory = SimpleNamespace(config=config, sensor_detector=load_detector(cube_bench.DATA / "cube_sun_sensor.toml"))
    truth = draw_truths(config, Streams(3))[0]
    sensor = replace(truth.sensor, offset_px=np.zeros(2), gap_mm=config.sensor.gap_mm)
    case = Case(name="", label="", reading=True)
    table, angle, rng = (
        build_table(config, replace(truth, lean=0.0), case),
        field_angles(config),
        np.random.default_rng(5),
    )
    exact = sensor.spot_px(table.rotation(angle).inv().apply([0.0, 0.0, 1.0]))
    noise = sensor_noise(laboratory, reading=True, lean=False)
    cosine = table.rotation(angle).as_matrix()[:, 2, 2]
    sigma = np.sqrt(_spot_variance_px2(laboratory, cosine))[:, None]
    found = []
    for run in range(200):
        spots = exact + sigma * rng.standard_normal(exact.shape)
        read = table.read(angle, Streams(7), call=run)
        found.append(fit_sensor(config, spots, read, table, sensor, free=False).rotation.as_rotvec())
    predicted = np.sqrt(np.diag(noise.covariance_rad2))
    assert np.std(found, axis=0) / predicted == pytest.approx(np.ones(3), abs=0.2)
