"""The cube-mirror experiment: predictions by themselves, one rendered bench, and a small run from end to end."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calib.calibration.cube_mirror import concentric_angles
from experiments.cube import bench as cube_bench
from experiments.cube import experiment as study
from experiments.cube import montecarlo as cube_montecarlo
from experiments.cube.bench import (
    CubeCase,
    build_table,
    draw_truths,
    face_start_rad,
)
from experiments.cube.budget import (
    beam_sensitivity,
    geometric_error,
    non_orthogonality_sensitivity,
)
from experiments.cube.montecarlo import CASES, CaseResult
from experiments.cube.sensor import calibrate_sensor, field_angles, fit_sensor, observe_spots, sensor_chip
from experiments.cube.settings import CubeMirrorConfig
from experiments.cube.settings import experiment as declared
from experiments.harness.progress import Progress
from render.bench.scene import CubePose
from render.bench.sensor import MaskSensor
from render.bench.spot import reflected_spot_mm
from render.engine.random import Streams

ARCSEC = np.pi / 180 / 3600


def mask():
    return MaskSensor(
        width_px=1280, height_px=1280, pitch_mm=0.007, hole_mm=0.2, gap_mm=3.0, offset_px=np.array([1.0, -2.0])
    )


@pytest.fixture(scope="module")
def laboratory(engine):
    config = CubeMirrorConfig(benches={"count": 4, "log2_particles": 16}, sensor={"grid": 5, "log2_particles": 12})
    return cube_bench.build_laboratory(config)


def test_benches_do_not_depend_on_their_order():
    first, again = (draw_truths(CubeMirrorConfig(benches={"count": 3}), Streams(3)) for _ in range(2))
    assert all(np.array_equal(a.normal, b.normal) for a, b in zip(first, again, strict=True))


@pytest.mark.parametrize("face", ["+Z", "+X", "-X"])
def test_concentric_angles_return_the_light_into_the_aperture(face):
    """On a crooked table too: the law of reflection puts the spot into the middle of the hole."""
    config = CubeMirrorConfig(benches={"count": 2}, table={"square_arcsec": 200.0})
    truth = replace(draw_truths(config, Streams(5))[0], non_orthogonality=1.0)
    table = build_table(config, truth, CubeCase(name="", label="", non_orthogonal=True))
    geometry = cube_bench.build_geometry(config)
    angle = concentric_angles(table, truth.normal_in_table(face), face_start_rad(face))
    pose = CubePose.of_table(geometry, table.rotation(angle[None])[0].as_matrix(), truth.table_from_cube, truth.normal)
    assert reflected_spot_mm(geometry, pose, face) == pytest.approx([0, 0], abs=1e-9)


def test_non_orthogonal_axes_act_on_z_and_half_of_it_cancels():
    """By hand: the second face takes the full angle about z. The spots of the sun sensor are sheared: spots along x
    turn by the angle, spots along y do not: half a rotation, and half a shear that no rotation fits."""
    rate = non_orthogonality_sensitivity(CubeMirrorConfig(sensor={"grid": 5, "field_deg": 5.0}), mask())
    assert rate[:2] == pytest.approx([0, 0], abs=1e-6)
    assert abs(rate[2]) == pytest.approx(0.5, abs=2e-3)


def test_error_of_the_beam_is_not_in_the_published_budget():
    rates = beam_sensitivity(CubeMirrorConfig(sensor={"grid": 5}), mask())
    assert np.abs(rates).max() > 1.0
    assert geometric_error(CubeMirrorConfig(sensor={"grid": 5}), mask()) == pytest.approx([0, 0, 0], abs=1e-6)


def test_sensor_calibration_recovers_the_truth(laboratory):
    """Rendered spots: R_sr within 4 of its sigmas, which are below 3 arcsec with 25 positions."""
    truth = draw_truths(laboratory.config, laboratory.streams)[0]
    table = build_table(laboratory.config, truth, CubeCase(name="", label=""))
    run = observe_spots(laboratory, truth, table, Streams(8))
    calibration = calibrate_sensor(laboratory, truth, table, run, Streams(9), fit_non_orthogonality=False)
    error = (calibration.rotation * Rotation.from_matrix(truth.sensor_from_table).inv()).as_rotvec() / ARCSEC
    sigma = np.sqrt(np.diag(calibration.covariance_rad2)) / ARCSEC
    assert np.all(np.abs(error) < 4 * sigma)
    assert sigma.max() < 3.0
    assert calibration.focal_length_mm == pytest.approx(truth.sensor.gap_mm, abs=1e-4)


def test_every_bench_has_another_sun_sensor_chip(laboratory):
    """One fixed pattern in all of them would be a bias of the whole Monte-Carlo."""
    truths = draw_truths(laboratory.config, laboratory.streams)
    seeds = {sensor_chip(laboratory, truth).sensor_seed for truth in truths}
    assert len(seeds) == len(truths)
    assert sensor_chip(laboratory, truths[0]).sensor_seed in seeds


@pytest.fixture(scope="module")
def performed(laboratory):
    """One bench as performed, with its pictures and the spots of its sensor."""
    truth, cache = draw_truths(laboratory.config, laboratory.streams)[1], cube_montecarlo.SensorCache()
    case = next(c for c in cube_montecarlo.CASES if c.name == "procedure")
    bench = cube_montecarlo.run_bench(laboratory, truth, case, cache, log2_particles=17, keep_pictures=True)
    return truth, bench, cache


def test_one_bench_as_performed(performed):
    """Every face ends below a pixel; remaining offset, mount and reading explain the error of the cube."""
    truth, bench, _ = performed
    per_px = 0.015 / 1300 / ARCSEC
    for face, trim in enumerate(bench.trims):
        assert len(trim.rows) >= 2
        assert np.abs(trim.rows[0].offset_px).max() > 1.0
        assert np.all(np.abs(trim.rows[-1].offset_px) < 1.0)
        assert len(trim.pictures) == 3
        # the mount moved the picture of the spot: its hole is displaced from the glowing aperture by as much
        shift = 2.0 * truth.mounting[face, 0] / per_px
        assert trim.offset.offset_px - trim.one_picture_offset.offset_px == pytest.approx(shift, abs=0.5)
    assert np.abs(bench.cube_error_arcsec).max() < 12.0
    assert bench.face_angle_rad == pytest.approx(bench.true_face_angle_rad, abs=20 * ARCSEC)


def test_sections_of_a_run(laboratory, performed, monkeypatch):
    """Four equal benches: figures, tables and verdicts; offsets by circle fits and by the law of reflection."""
    truth, bench, cache = performed
    cases = {case.name: CaseResult(case=case, bench=(bench,) * 4) for case in CASES}
    monkeypatch.setattr(study, "build_laboratory", lambda config: laboratory)
    monkeypatch.setattr(study, "draw_truths", lambda config, streams: [truth] * 4)
    monkeypatch.setattr(study, "SensorCache", lambda: cache)
    monkeypatch.setattr(study, "run_bench", lambda *_, **options: bench)
    monkeypatch.setattr(study, "run_cases", lambda *_: cases)
    outcome = declared.outcome(laboratory.config, study.run(laboratory.config, progress=Progress()))
    offset, sigma = outcome.values("example.offset_px"), outcome.errors("example.offset_px")
    assert (np.abs(offset - outcome.values("example.true_offset_px")) < 5.0 * sigma).all()
    assert outcome.values("budget.measured")[0] == pytest.approx(np.abs(bench.error_arcsec))
    assert outcome.value("eq13_arcsec") == pytest.approx(2.38, abs=0.01)
    assert outcome.values("benches.error_arcsec").shape == (8, 4, 3)
    assert len(outcome.values("trims.inner_deg")) == sum(len(trim.rows) for trim in bench.trims)
    assert np.abs(outcome.values("example.residual_px")).max() < 0.1
    assert len(study.draw_pictures(outcome, 0).axes) == 3


def test_wahba_on_three_faces_twice(laboratory):
    """More faces and repeats by least squares, with the certificate of the cube; aligned benches, no other errors."""
    config = laboratory.config.model_copy(
        update={
            "cube": laboratory.config.cube.model_copy(
                update={"faces": ("+Z", "+X", "-X"), "repeats": 2, "method": "wahba"}
            )
        }
    )
    more = replace(laboratory, config=config)
    truth = draw_truths(config, more.streams)[0]
    bench = cube_montecarlo.run_bench(
        more, truth, CubeCase(name="x", label="x"), cube_montecarlo.SensorCache(), log2_particles=16
    )
    assert len(bench.trims) == 6
    assert np.abs(bench.cube_error_arcsec).max() < 1.0


@pytest.mark.parametrize("seed", range(3))
def test_bench_on_exact_coordinates_is_reduced_without_error(seed):
    """Exact spots and angles, cube and sensor misaligned: R_sp is the true one to rounding."""
    config = CubeMirrorConfig(benches={"count": 2}, sensor={"grid": 5})
    truth, case = draw_truths(config, Streams(seed))[0], CubeCase(name="", label="")
    table, angle = build_table(config, truth, case), field_angles(config)
    sun = table.rotation(angle).inv().apply([0.0, 0.0, 1.0]) @ truth.sensor_from_table.T
    sensor = fit_sensor(config, truth.sensor.spot_px(sun), angle, table, truth.sensor, fit_non_orthogonality=False)
    none = SimpleNamespace(offset_px=np.zeros(2), covariance_px2=1e-4 * np.eye(2))
    trims = [
        SimpleNamespace(
            face=face,
            one_picture_offset=none,
            offset=none,
            reading_rad=concentric_angles(table, truth.normal_in_table(face), face_start_rad(face)),
        )
        for face in config.cube.faces
    ]
    geometry = cube_bench.build_geometry(config)
    laboratory = SimpleNamespace(config=config, geometry=geometry, pitch_mm=0.015, tilt_per_px=0.015 / geometry.path_mm)
    bench = cube_montecarlo.reduce_bench(laboratory, truth, table, trims, sensor, improved=False)
    assert bench.error_arcsec == pytest.approx(np.zeros(3), abs=1e-5)
