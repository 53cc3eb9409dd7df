"""Attitude of one frame from measured stars: invented stars whose errors are known, with wrong ones among them."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from calibration_scene import CAMERA, GEOMETRY
from measured_frames import measured_frame
from scipy.spatial.transform import Rotation
from star_directions import sky_directions

from calib import BrownConrady, StarFlag, StarTable, identify_stars, solve_attitude
from calib.attitude import pattern_cache, star_attitude
from calib.attitude.identify import failed
from calib.attitude.star_attitude import balanced_attitude
from optics.attitude import attitude_error_arcsec, attitude_from_angles
from optics.records import locked

TRUTH = attitude_from_angles(120.0, 35.0, 200.0)


def random_sky(count=6000):
    """Arrays are write-locked as those of records."""
    return SimpleNamespace(id=locked(np.arange(count) * 7, np.int64), direction=locked(sky_directions(count, 5)))


def measured(sky, *, sigma_px=0.05, common_px=0.0, false=10, seed=0):
    """Stars of the sky in the field as a star table that states sigma_px, with errors of both kinds."""
    rng = np.random.default_rng(seed)
    v = TRUTH.apply(np.array(sky.direction))
    row = np.flatnonzero(CAMERA.visible(v))
    place = CAMERA.project(v[row]) + rng.normal(0.0, np.hypot(sigma_px, common_px), (len(row), 2))
    place = np.vstack([place, rng.uniform(0, 1023, (false, 2))])
    return measured_frame(place, flux_e=rng.uniform(1e3, 1e4, len(place)), sigma_px=sigma_px).stars, row


def solved(sky, stars, near):
    return solve_attitude(stars, identify_stars(stars, CAMERA, sky, near=near), CAMERA, sky)


@pytest.mark.slow
def test_errors_are_as_large_as_predicted_with_and_without_a_common_error():
    sky = random_sky()
    near = Rotation.from_rotvec(np.radians([0.2, -0.3, 0.5])) * TRUTH
    for common_px in (0.0, 0.15):
        pulls, common = [], []
        for seed in range(40):
            stars, row = measured(sky, common_px=common_px, seed=seed)
            one = solved(sky, stars, near)
            assert one.ok
            matched = one.detected < len(row)
            assert (row[one.detected[matched]] == one.catalogue[matched]).all()
            pulls.append(one.error_arcsec(TRUTH) / one.sigma_arcsec)
            common.append(one.common_px)
        # a chi-square of 120 degrees of freedom: its mean is 1 +- sqrt(2 / 120); the scale itself is estimated
        assert np.mean(np.square(pulls)) == pytest.approx(1.0, abs=5 * np.sqrt(2 / 120))
        assert np.median(common) == pytest.approx(common_px, abs=0.02)


def test_identification_names_stars_and_rows():
    sky = random_sky()
    stars, row = measured(sky)
    found = identify_stars(stars, CAMERA, sky, near=TRUTH)
    assert found.ok
    mine = found.detected < len(row)
    assert (found.catalogue_id[mine] == 7 * row[found.detected[mine]]).all()
    assert np.array_equal(found.direction, sky.direction[found.catalogue_id // 7])


def test_lost_in_space_asks_for_patterns_of_the_field_and_for_directions_by_identifier(monkeypatch):
    """A search that finds nothing is repeated without the catalogue, whose identifiers the patterns may not share."""
    sky, calls = random_sky(), []
    stars, _ = measured(sky)
    trail = replace(stars, flags=np.where(np.arange(len(stars)) == 0, StarFlag.TRAIL, 0).astype(np.uint32))
    near = identify_stars(stars, CAMERA, sky, near=TRUTH)
    first = {"catalogue_id": near.catalogue_id[:3], "direction": near.direction[:3], "detected": np.arange(3)}
    found = replace(near, **first, residual_px=None, beyond=None)

    def identify(pixel, model, database, *, flux, catalogue=None):
        calls.append((len(pixel), database, catalogue))
        return failed("no_match", "") if catalogue is not None else found

    monkeypatch.setattr(star_attitude, "identify", identify)
    monkeypatch.setattr(pattern_cache, "kept_database", lambda **fields: tuple(fields.values()))
    star_attitude._database.cache_clear()
    assert identify_stars(trail, CAMERA, sky).detected.tolist() == [1, 2, 3]
    star_attitude._database.cache_clear()
    (count, field, by_id), (_, again, nothing) = calls
    assert (count, again, nothing) == (len(stars) - 1, field, None)
    np.testing.assert_allclose(field, 22.5 * np.array([0.5, 1.06]), rtol=1e-3)
    assert list(by_id) == sky.id.tolist()
    assert len(by_id) == len(sky.id)
    np.testing.assert_array_equal(by_id[14], sky.direction[2])
    assert 15 not in by_id


@pytest.mark.parametrize(("false", "brighter_e"), [(100, 1e4), (800, 0.0), (2000, 1e4)])
def test_a_rough_attitude_is_enough_among_false_stars(false, brighter_e):
    """62 stars; the false ones are brighter than all of them, or as bright. The attitude is wrong by 40 px."""
    sky = random_sky()
    stars, row = measured(sky, false=false)
    flux = np.array(stars.flux_e)
    flux[len(row) :] += brighter_e
    near = Rotation.from_rotvec(np.radians([0.7, -0.5, 1.0])) * TRUTH
    identified = identify_stars(replace(stars, flux_e=flux), CAMERA, sky, near=near)
    assert identified.ok, identified.message
    right = identified.detected[identified.detected < len(row)]
    assert len(right) > 0.9 * len(row)
    same = identified.catalogue_id[identified.detected < len(row)] == 7 * row[right]
    assert same.mean() > 0.95
    error = attitude_error_arcsec(identified.attitude.rotation, TRUTH)
    assert (np.abs(error) < 5.0 * identified.attitude.sigma_arcsec).all()


def test_a_wrong_rough_attitude_is_followed_by_a_search(monkeypatch):
    """The stars of the search are returned with the error of the given attitude, 3 deg; the radius is 1.1 deg."""
    sky = random_sky()
    stars, _ = measured(sky)
    right = identify_stars(stars, CAMERA, sky, near=TRUTH)
    searched = replace(right, detected=np.arange(len(right.detected)), residual_px=None, beyond=None)
    monkeypatch.setattr(star_attitude, "star_patterns", lambda model: None)
    near = Rotation.from_rotvec(np.radians([3.0, 0.0, 0.0])) * TRUTH
    monkeypatch.setattr(star_attitude, "identify", lambda *_, **__: searched)
    identified = identify_stars(stars, CAMERA, sky, near=near)
    assert identified.ok
    assert "the given attitude is 3 deg off" in identified.message
    monkeypatch.setattr(star_attitude, "identify", lambda *_, **__: failed("no_match", "of the search"))
    lost = identify_stars(stars, CAMERA, sky, near=near)
    assert lost.status == "no_match"
    assert "wider" not in lost.message


def test_a_small_error_of_the_model_among_thousands_of_stars_is_stated():
    """Lateral colour of 0.2 px at the edge, different for every star: 9 % more than noise and common error explain."""
    sky, rng = random_sky(110_000), np.random.default_rng(0)
    stars, row = measured(sky, sigma_px=0.0, false=0)
    sigma_px = 10 ** rng.uniform(-2.0, -0.5, len(row))
    colour = 0.2 * rng.normal(size=(len(row), 1)) * (stars.pixel_px - 511.5) / 512.0
    pixel = stars.pixel_px + colour + sigma_px[:, None] * rng.normal(size=(len(row), 2))
    covariance = np.zeros((len(row), 3, 3))
    covariance[:, [0, 1, 2], [0, 1, 2]] = np.column_stack([sigma_px**2, sigma_px**2, np.ones(len(row))])
    noisy = replace(stars, x_px=pixel[:, 0], y_px=pixel[:, 1], covariance=covariance)
    attitude = solved(sky, noisy, TRUTH)
    solution = attitude.solution
    assert len(attitude) > 1000
    assert solution.probability < 1e-6
    assert attitude.ok, solution.message
    assert f"loss {solution.loss:.4g} where {solution.expected_loss:.4g} is expected" in solution.message
    assert f"{solution.misfit.ratio:.3g} times their stated sigma" in repr(attitude)
    assert (np.abs(attitude.error_arcsec(TRUTH)) < 5.0 * attitude.sigma_arcsec).all()


def test_a_large_error_of_the_model_is_refused():
    """0.8 px per axis, more than a common error may be: residuals are 1.36 times what is allowed."""
    rng, row = np.random.default_rng(0), np.arange(1300)
    direction = TRUTH.inv().apply(CAMERA.unproject(rng.uniform(0, 1023, (len(row), 2))))
    v_cam = CAMERA.unproject(CAMERA.project(TRUTH.apply(direction)) + rng.normal(0.0, 0.8, (len(row), 2)))
    solution, *_ = balanced_attitude(v_cam, direction, np.full(len(row), 0.01), CAMERA.pixel_angle_rad)
    assert solution.status == "inconsistent"


def test_stars_within_their_noise_need_no_word():
    sky = random_sky()
    stars, row = measured(sky, false=0)
    found = identify_stars(stars, CAMERA, sky, near=TRUTH)
    mine = found.detected[found.detected < len(row)]
    assert len(mine) > 20
    assert not found.beyond.any()
    assert found.misfit.probability > 1e-3
    assert "stated" not in found.message
    place = CAMERA.project(TRUTH.apply(np.array(found.direction)))
    np.testing.assert_allclose(found.residual_px, stars.pixel_px[found.detected] - place, atol=0.1)


def test_a_residual_beyond_the_noise_is_said_and_a_stated_model_error_covers_it():
    """Distortion unknown to the model: matched within 10 px, which noise of 0.05 px does not allow."""
    sky = random_sky(1200)
    stars, _ = measured(sky, false=0)
    poor = BrownConrady.create(GEOMETRY, focal_length_mm=25.6, q1_per_mm2=-6e-4)
    found = identify_stars(stars, poor, sky, near=TRUTH, tolerance_px=10.0)
    assert found.ok
    largest = float(np.hypot(*found.residual_px.T).max())
    assert largest > 2.0
    assert f"{largest:.3g} px at most" in found.message
    assert found.misfit.ratio > 10
    assert "times what the stated sigma makes them" in found.message
    assert found.beyond.sum() > 0.5 * len(found.beyond)
    allowed = identify_stars(stars, poor, sky, near=TRUTH, tolerance_px=10.0, model_error_px=largest)
    assert not allowed.beyond.any()


def test_single_stars_beyond_their_noise_are_named():
    sky = random_sky(1200)
    stars, _ = measured(sky, false=0)
    place = np.array(stars.pixel_px)
    place[:3] += 1.0  # 20 sigma each way: a blend, within the tolerance of a match
    moved = replace(stars, x_px=place[:, 0], y_px=place[:, 1])
    found = identify_stars(moved, CAMERA, sky, near=TRUTH)
    assert set(found.detected[found.beyond]) == {0, 1, 2}
    assert f"3 of {len(found.detected)} stars lie beyond 5 sigma" in found.message
    assert found.misfit.probability > 1e-3


def test_flagged_stars_do_not_vote():
    sky = random_sky()
    stars, row = measured(sky, false=0)
    flags = np.zeros(len(stars), np.uint32)
    flags[:3] = [int(StarFlag.BLEND), int(StarFlag.SATURATED), int(StarFlag.SPIKE)]
    flagged = replace(stars, flags=flags)
    assert 2 not in identify_stars(flagged, CAMERA, sky, near=TRUTH).detected  # a spike is no star
    one = solved(sky, flagged, TRUTH)
    assert not set(one.detected) & {0, 1, 2}
    assert len(one) > 0.8 * (len(row) - 3)
    assert flagged.sharp.tolist()[:4] == [False, False, True, False]


def test_weights_are_the_mean_variance_of_both_axes():
    """Unequal and correlated axes: a stated noise that is right needs no common error to explain the residuals."""
    sky, rng, common = random_sky(), np.random.default_rng(3), []
    for seed in range(4):
        stars, _ = measured(sky, sigma_px=1e-9, false=0, seed=seed)
        covariance = np.zeros((len(stars), 3, 3))
        covariance[:] = [[0.01, 0.004, 0.0], [0.004, 0.0025, 0.0], [0.0, 0.0, 1.0]]
        error = rng.multivariate_normal([0.0, 0.0], covariance[0, :2, :2], len(stars))
        noisy = replace(stars, x_px=stars.x_px + error[:, 0], y_px=stars.y_px + error[:, 1], covariance=covariance)
        one = solved(sky, noisy, TRUTH)
        common.append(one.common_px)
    # mean variance 0.00625 px^2, known from some 60 stars and 4 fields to 6 %
    assert np.mean(np.square(common)) < 0.25 * 0.00625


def test_the_attitude_of_a_frame_and_of_one_without_identified_stars(monkeypatch):
    sky = random_sky()
    stars, _ = measured(sky)
    known = solved(sky, stars, TRUTH)
    assert (np.abs(known.error_arcsec(TRUTH)) < 5.0 * known.sigma_arcsec).all()
    assert f"{len(known)} stars" in repr(known)
    monkeypatch.setattr(star_attitude, "star_patterns", lambda model: None)
    monkeypatch.setattr(star_attitude, "identify", lambda *_, **__: failed("no_match", ""))
    lost = identify_stars(stars, CAMERA, sky, near=attitude_from_angles(300.0, -35.0, 0.0))
    assert lost.status == "no_match"
    one = solve_attitude(stars, lost, CAMERA, sky)
    assert (one.ok, len(one)) == (False, 0)
    empty = identify_stars(StarTable.empty(), CAMERA, sky, near=TRUTH)
    assert empty.status == "too_few"
