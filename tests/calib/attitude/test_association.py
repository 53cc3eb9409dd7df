"""Association: one to one, ambiguous ones left out; robust against false detections, wrong attitudes, flipped skies."""

from math import comb

import numpy as np
import pytest
from calibration_scene import CAMERA, GEOMETRY
from scipy.spatial.transform import Rotation
from star_directions import sky_directions

from calib.attitude.association import associate, match_stars
from calib.attitude.false_match_probability import false_match_probability
from optics.attitude import attitude_error_arcsec

NOISE_PX = 0.1


@pytest.fixture(scope="module")
def catalogue():
    """4000 stars, even over the sky: about 50 in the field of 22.6 deg."""
    return sky_directions(4000)


def frame(catalogue, seed, *, false=0, lost=0.0):
    """Attitude, detections in shuffled order, and the catalogue row of each (-1: false)."""
    rng = np.random.default_rng(seed)
    attitude = Rotation.random(rng=rng)
    rows = np.flatnonzero(CAMERA.visible(attitude.apply(catalogue)))
    rows = rows[rng.random(len(rows)) >= lost]
    pixel = CAMERA.project(attitude.apply(catalogue[rows])) + NOISE_PX * rng.standard_normal((len(rows), 2))
    pixel = np.concatenate([pixel, rng.uniform(0, (1023, 1023), (false, 2))])
    order = rng.permutation(len(pixel))
    return attitude, pixel[order], np.concatenate([rows, np.full(false, -1)])[order]


def turned(attitude, seed, *, across_deg=0.15, roll_deg=1.0):
    """The attitude wrong by 0.15 deg (7 px) across the boresight and by 1 deg in roll (13 px in the corner)."""
    error = np.radians([across_deg, across_deg, roll_deg]) * np.random.default_rng(seed).choice([-1, 1], 3)
    return Rotation.from_rotvec(error) * attitude


def test_known_attitude_matches_every_lonely_star(catalogue):
    attitude, pixel, truth = frame(catalogue, 2)
    found = associate(pixel, catalogue, attitude, CAMERA, radius_px=0.6)
    assert (truth[found.detected] == found.catalogue).all()
    assert len(found) + len(found.ambiguous) == len(pixel) == found.in_field
    assert len(found) > 0.9 * len(pixel)
    assert found.distance_px.max() < 0.6
    # distances are those of normal noise in two axes: mean square 2 sigma^2
    assert np.mean(found.distance_px**2) == pytest.approx(2 * NOISE_PX**2, rel=4 / np.sqrt(len(found)))
    assert (np.diff(found.detected) > 0).all()


def test_ambiguous_ones_are_left_out():
    """Three stars: one lonely, two 3 px apart; and two detections on one star."""
    attitude = Rotation.from_euler("xyz", [20, 40, 60], degrees=True)
    places = np.array([[100.0, 100], [500, 500], [503, 500], [800, 200]])
    stars = attitude.inv().apply(CAMERA.unproject(places))
    pixel = np.array([[100.2, 100], [500, 500.5], [800, 201], [801, 199], [50, 700]])
    found = associate(pixel, stars, attitude, CAMERA, radius_px=4.0)
    assert found.detected.tolist() == [0]
    assert found.catalogue.tolist() == [0]
    assert found.ambiguous.tolist() == [1, 2, 3]
    narrow = associate(pixel, stars, attitude, CAMERA, radius_px=1.1)
    assert narrow.detected.tolist() == [0, 1, 2]
    assert narrow.catalogue.tolist() == [0, 1, 3]
    assert narrow.distance_px == pytest.approx([0.2, 0.5, 1.0], abs=1e-6)


def test_rows_without_a_position_are_never_matched(catalogue):
    attitude, pixel, truth = frame(catalogue, 3)
    holed = pixel.copy()
    holed[::4] = np.nan
    found = associate(holed, catalogue, attitude, CAMERA, radius_px=0.6)
    assert len(found) > 0
    assert not np.isin(found.detected, np.arange(0, len(pixel), 4)).any()
    assert (truth[found.detected] == found.catalogue).all()
    matched = match_stars(holed, catalogue, turned(attitude, 3), CAMERA, radius_px=30.0)
    assert matched.ok
    assert (truth[matched.association.detected] == matched.association.catalogue).all()


@pytest.mark.parametrize("seed", range(10, 15))
def test_rough_attitude_is_refined(catalogue, seed):
    """Ten false detections and a fifth of the stars lost: all matches right, the attitude within 5 sigma."""
    attitude, pixel, truth = frame(catalogue, seed, false=10, lost=0.2)
    found = match_stars(pixel, catalogue, turned(attitude, seed), CAMERA, radius_px=40.0, tolerance_px=1.0)
    assert found.ok, found.message
    assert (truth[found.association.detected] == found.association.catalogue).mean() > 0.96
    assert len(found.association) > 0.8 * (truth >= 0).sum()
    error = attitude_error_arcsec(found.attitude.rotation, attitude)
    assert (np.abs(error) < 5 * found.attitude.sigma_arcsec).all()
    assert found.false_match_probability < 1e-12


@pytest.mark.parametrize("seed", range(40, 43))
def test_another_sky_is_refused(catalogue, seed):
    """The attitude of somewhere else: nothing may be claimed."""
    _, pixel, _ = frame(catalogue, seed)
    elsewhere = Rotation.random(rng=np.random.default_rng(seed + 1000))
    found = match_stars(pixel, catalogue, elsewhere, CAMERA, radius_px=40.0)
    assert found.status == "no_match"
    assert found.attitude is None
    assert len(found.association) == 0


@pytest.mark.parametrize("seed", range(50, 53))
def test_noise_is_refused(catalogue, seed):
    rng = np.random.default_rng(seed)
    pixel = rng.uniform(0, (1023, 1023), (40, 2))
    found = match_stars(pixel, catalogue, Rotation.random(rng=rng), CAMERA, radius_px=40.0)
    assert not found.ok
    assert found.false_match_probability > 1e-6


@pytest.mark.parametrize(
    ("flip", "what"),
    [
        (lambda p: np.column_stack([1023 - p[:, 0], p[:, 1]]), "columns run backwards"),
        (lambda p: np.column_stack([p[:, 0], 1023 - p[:, 1]]), "rows run backwards"),
        (lambda p: p[:, ::-1], "columns and rows are exchanged"),
    ],
)
def test_mirrored_sky_is_told_from_an_empty_one(catalogue, flip, what):
    attitude, pixel, _ = frame(catalogue, 60)
    found = match_stars(flip(pixel), catalogue, turned(attitude, 60), CAMERA, radius_px=30.0)
    assert found.status == "mirrored"
    assert what in found.message
    assert found.attitude is None


def test_too_few_stars(catalogue):
    attitude, pixel, _ = frame(catalogue, 61)
    for some in (pixel[:2], np.full((5, 2), np.nan), np.empty((0, 2))):
        assert match_stars(some, catalogue, attitude, CAMERA, radius_px=5.0).status == "too_few"
    assert match_stars(pixel[:3], catalogue, attitude, CAMERA, radius_px=5.0).status != "too_few"
    assert match_stars(pixel, catalogue[:0], attitude, CAMERA, radius_px=5.0).status == "too_few"
    empty = associate(np.empty((0, 2)), catalogue, attitude, CAMERA, radius_px=5.0)
    assert len(empty) == 0
    assert empty.in_field == len(pixel)


def test_stars_behind_the_camera_are_not_seen():
    """Far outside the field the distortion folds over; such stars have pixels, but are not there."""
    backwards = np.array([[0.0, 0.0, -1.0], [0.9, 0.0, 0.1], [0.0, 0.01, 1.0]])
    backwards /= np.linalg.norm(backwards, axis=1, keepdims=True)
    found = associate(GEOMETRY.grid_px(20), backwards, Rotation.identity(), CAMERA, radius_px=60.0)
    assert found.in_field == 1


@pytest.mark.parametrize("matches", [3, 4, 6])
def test_false_match_probability_is_a_binomial_tail_over_all_proposals(matches):
    """Ten detections, eight of them free; 20 stars of 1 px radius on 100 pi px^2 hold a fifth of the detector."""
    field = {"stars": 20, "radius_px": 1.0, "area_px2": 100.0 * np.pi}
    tail = sum(comb(8, k) * 0.2**k * 0.8 ** (8 - k) for k in range(matches - 2, 9))
    assert false_match_probability(matches, 10, 1, **field) == pytest.approx(tail, rel=1e-9)
    assert false_match_probability(matches, 10, 40, **field) == pytest.approx(min(1.0, 40 * tail), rel=1e-9)
    assert false_match_probability(2, 10, 5, **field) == 1.0
