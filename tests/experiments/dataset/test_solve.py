"""Frames solved blind by tetra3rs, on stars placed by a pinhole camera: error, predicted sigma, and what is refused."""

import sys
from types import SimpleNamespace

import numpy as np
import pytest
from measured_frames import measured_frame
from scipy.spatial.transform import Rotation

from calib.cameras.base import SensorGeometry
from calib.cameras.brown_conrady import BrownConrady
from calib.flags import StarFlag
from experiments.dataset.solve import BlindSolver, SkyMap, SolvedFrame, attitudes, solve_frame
from optics.units import RAD_ARCSEC
from render.catalogue.gaia import load_gaia
from render.catalogue.index import build_index

pytestmark = pytest.mark.reference

FOCAL_MM, PITCH_MM, SIDE, LIMIT_MAG = 26.0, 5.5e-3, 1024, 7.0
PIXEL_ARCSEC = PITCH_MM / FOCAL_MM * RAD_ARCSEC
NOISE_PX = 0.05


@pytest.fixture(scope="module")
def database():
    pytest.importorskip("tetra3rs")
    from calib.attitude.identify import build_database

    return build_database(min_fov_deg=11.5, max_fov_deg=13.0)


@pytest.fixture(scope="module")
def sky():
    catalogue = load_gaia()
    return catalogue.select(np.flatnonzero(catalogue.magnitude <= LIMIT_MAG))


@pytest.fixture(scope="module")
def model():
    geometry = SensorGeometry(width_px=SIDE, height_px=SIDE, pixel_pitch_mm=PITCH_MM)
    return BrownConrady.create(geometry, focal_length_mm=FOCAL_MM)


def measured(sky, model, attitude, seed, *, mirrored=False, burnt=0):
    """Stars of a frame with Gaussian noise; the brightest ``burnt`` of them flagged as saturated and 0.7 px off."""
    rng = np.random.default_rng(seed)
    near = build_index(sky).within(attitude.inv().apply([0.0, 0.0, 1.0]), np.radians(8.8))
    pixel = model.project(attitude.apply(sky.direction[near]))
    inside = np.all((pixel > 3) & (pixel < SIDE - 4), axis=1)
    pixel, magnitude = pixel[inside], sky.magnitude[near][inside]
    order = np.argsort(magnitude)
    pixel, magnitude = pixel[order] + rng.normal(0.0, NOISE_PX, pixel.shape), magnitude[order]
    pixel[:burnt] += rng.choice([-0.5, 0.5], (burnt, 2))
    if mirrored:
        pixel[:, 0] = SIDE - 1 - pixel[:, 0]
    flags = np.where(np.arange(len(pixel)) < burnt, int(StarFlag.SATURATED), 0)
    return measured_frame(pixel, flux_e=10 ** (-0.4 * (magnitude - 10)), flags=flags, sigma_px=NOISE_PX)


def solved(k, stars, *, sky, model, database, truth, near=None):
    return solve_frame(
        k,
        stars,
        model=model,
        model_turn=Rotation.identity(),
        database=database,
        sky=SkyMap(direction=sky.direction, by_id=dict(zip(sky.id.tolist(), sky.direction, strict=True)), id=sky.id),
        truth=truth,
        pixel_arcsec=PIXEL_ARCSEC,
        near=near,
    )


@pytest.mark.slow
def test_errors_are_what_noise_and_number_of_stars_make(sky, model, database):
    """12 attitudes; sigma across the boresight is noise / sqrt(n); 24 pulls scatter by 14 %."""
    turns = Rotation.random(12, random_state=4)
    frames = tuple(
        solved(k, measured(sky, model, one, k), sky=sky, model=model, database=database, truth=one)
        for k, one in enumerate(turns)
    )
    found = attitudes(frames)
    assert (found.solved, found.mirrored, found.wrong) == (12, 0, 0)
    expected = np.array([NOISE_PX * PIXEL_ARCSEC / np.sqrt(one.used) for one in frames])
    error = np.array([one.error_arcsec[:2] for one in frames])
    assert np.sqrt(np.mean((error / expected[:, None]) ** 2)) == pytest.approx(1.0, abs=0.42)
    np.testing.assert_allclose([one.sigma_arcsec[:2].mean() for one in frames], expected, rtol=0.35)


def test_burnt_stars_help_to_identify_and_do_not_count(sky, model, database):
    attitude = Rotation.random(random_state=9)
    one = solved(0, measured(sky, model, attitude, 1, burnt=4), sky=sky, model=model, database=database, truth=attitude)
    assert one.solved
    assert one.used <= one.fit == one.detected - 4
    assert np.hypot(*one.error_arcsec[:2]) < 5 * NOISE_PX * PIXEL_ARCSEC / np.sqrt(one.used)


def test_a_mirrored_image_is_not_solved(sky, model, database):
    attitude = Rotation.random(random_state=3)
    stars = measured(sky, model, attitude, 2, mirrored=True)
    one = solved(0, stars, sky=sky, model=model, database=database, truth=attitude)
    assert not one.solved
    assert attitudes((one,)).mirrored == 1


def test_an_attitude_that_is_not_the_truth_is_wrong(sky, model, database):
    attitude = Rotation.random(random_state=3)
    other = Rotation.from_rotvec([0.0, 2 * PIXEL_ARCSEC / RAD_ARCSEC, 0.0]) * attitude
    one = solved(0, measured(sky, model, attitude, 2), sky=sky, model=model, database=database, truth=other)
    assert one.status == "wrong"


@pytest.mark.parametrize(
    ("off_px", "searched", "solves"), [(20.0, False, True), (400.0, False, False), (400.0, True, True)]
)
def test_a_rough_attitude_takes_the_place_of_patterns(sky, model, monkeypatch, off_px, searched, solves):
    """The right attitude from one that is 20 px off; from one in the wrong place, only if tetra3rs may search."""
    if searched:
        pytest.importorskip("tetra3rs")
    else:
        monkeypatch.setitem(sys.modules, "tetra3rs", None)
    attitude = Rotation.random(random_state=5)
    turn = Rotation.from_rotvec(off_px * PIXEL_ARCSEC / RAD_ARCSEC * np.array([0.6, -0.8, 0.0]))
    one = solved(
        0, measured(sky, model, attitude, 6), sky=sky, model=model, database=None, truth=attitude, near=turn * attitude
    )
    assert one.solved is solves
    if solves:
        assert np.hypot(*one.error_arcsec[:2]) < 5 * NOISE_PX * PIXEL_ARCSEC / np.sqrt(one.used)


def solved_as(error, sigma, status="identified", common=0.01):
    return SolvedFrame(
        frame=0, status=status, detected=20, fit=19, identified=18, used=17, message="", error_arcsec=error,
        sigma_arcsec=sigma, equal_error_arcsec=2.0 * np.array(error), common_px=common,
    )  # fmt: skip


def test_statistics_of_drawn_attitudes():
    """2000 frames, sigma 1, 1 and 30 arcsec: median length 1.177, 95 % below 2.448, roll 0.6745 of its sigma."""
    rng, sigma = np.random.default_rng(3), np.array([1.0, 1.0, 30.0])
    frames = [solved_as(sigma * e, sigma) for e in rng.standard_normal((2000, 3))]
    nothing = np.full(3, np.nan)
    frames += [solved_as(nothing, nothing, one, np.nan) for one in ("mirrored", "wrong", "unmatched")]
    found = attitudes(tuple(frames))
    assert (found.attempted, found.solved, found.mirrored, found.wrong, found.unsolved) == (2003, 2000, 1, 1, 3)
    assert found.unsolved_limit == 10
    # the median of n lengths: 1 / (2 f sqrt(n)) with the density f = 1.177 / 2 there
    assert found.median_arcsec.value == pytest.approx(1.1774, abs=4.0 * 0.85 / np.sqrt(2000))
    assert found.median_arcsec.uncertainty == pytest.approx(0.85 / np.sqrt(2000), rel=0.1)
    assert found.equal_weights_median_arcsec == pytest.approx(2.0 * found.median_arcsec.value)
    assert found.p95_arcsec == pytest.approx(2.4477, abs=0.2)
    assert found.roll_median_arcsec == pytest.approx(30.0 * 0.6745, rel=0.1)
    assert found.pull_rms == pytest.approx([1.0] * 3, abs=4.0 / np.sqrt(4000))
    assert found.pull.value == pytest.approx(1.0, abs=4.0 / np.sqrt(12000))
    assert found.pull.uncertainty == pytest.approx(1.0 / np.sqrt(12000), rel=0.15)
    assert found.common_px == 0.01
    assert np.isnan(attitudes((frames[-1],)).median_arcsec.value)


def test_rows_that_are_read_later_are_turned_back(model):
    """A camera that turns by 0.2 deg/s and reads a row in 10 us: where a star of the middle row would have been."""
    attitude = Rotation.from_rotvec([0.02, -0.01, 0.5])
    rate = np.array([0.1, -0.2, 0.05])
    star = attitude.inv().apply(model.unproject(model.geometry.grid_px(5)))
    still, later = model.project(attitude.apply(star)), model.project(attitude.apply(star))
    for _ in range(5):  # the row tells the time, and the time the row
        time_s = (later[:, 1] - (SIDE - 1) / 2.0) * 1e-5
        seen = [
            (Rotation.from_rotvec(-np.radians(rate) * t) * attitude).apply(s) for t, s in zip(time_s, star, strict=True)
        ]
        later = model.project(np.array(seen))
    assert 0.05 < np.abs(later - still).max() < 2.0
    setting = SimpleNamespace(line_time_us=10.0)
    solver = object.__new__(BlindSolver)
    solver.scene = SimpleNamespace(
        config=SimpleNamespace(instrument=setting), instrument=SimpleNamespace(camera=SimpleNamespace(height_px=SIDE))
    )
    solver.calibration = SimpleNamespace(model=model, rotation=Rotation.identity())
    lost = np.vstack([later, [np.nan, np.nan]])
    given = SimpleNamespace(stars=SimpleNamespace(pixel_px=lost))
    carried = solver.turned(SimpleNamespace(rate_deg_per_s=rate.tolist()), given)
    np.testing.assert_allclose(carried[:-1], still, atol=1e-6)
    assert np.isnan(carried[-1]).all()
    setting.line_time_us = 0.0
    assert solver.turned(SimpleNamespace(rate_deg_per_s=rate.tolist()), given) is lost
