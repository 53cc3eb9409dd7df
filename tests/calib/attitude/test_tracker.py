"""A star tracker: frames drawn from Gaussian spots whose attitude is known."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from star_directions import sky_directions
from star_images import frame_of as drawn_frame

from calib import BrownConrady, SensorGeometry, find_stars
from calib.attitude.tracker import StarTracker, guide_catalogue, sky_coverage, unlike_stars
from calib.measure.centroiding.gaussian import draw_gaussian
from optics.attitude import attitude_error_arcsec, attitude_from_angles
from optics.stellar_aberration import aberrated

SIDE, READ_E, GAIN, OFFSET = 256, 5.0, 1.0, 100
GEOMETRY = SensorGeometry(width_px=SIDE, height_px=SIDE, pixel_pitch_mm=0.01)
MODEL = BrownConrady.create(GEOMETRY, focal_length_mm=20.0)
TRUTH = attitude_from_angles(120.0, 35.0, 200.0)
RATE = np.array([0.002, -0.001, 0.003])


@pytest.fixture(scope="module")
def sky():
    magnitude = np.random.default_rng(3).uniform(2.0, 6.0, 20_000)
    return SimpleNamespace(id=np.arange(20_000) * 3, direction=sky_directions(20_000), magnitude=magnitude)


@pytest.fixture(scope="module")
def guides(sky):
    return guide_catalogue(sky.id, sky.direction, sky.magnitude, faintest_mag=5.5, apart_rad=11 * 5e-4)


def frame_of(sky, attitude, *, seed, velocity=None, extra=()):
    """Stars of 20 000 e- at magnitude 4, spots of sigma 0.9 px, Poisson and read noise."""
    seen = np.array(sky.direction) if velocity is None else aberrated(sky.direction, velocity)
    v = attitude.apply(seen)
    row = np.flatnonzero(MODEL.visible(v))
    place = MODEL.project(v[row])
    light = np.zeros((SIDE, SIDE))
    for (x, y), mag in zip(place, sky.magnitude[row], strict=True):
        light += 2e4 * 10.0 ** (-0.4 * (mag - 4.0)) * draw_gaussian(np.array([x]), np.array([y]), 0.9, (SIDE, SIDE))[0]
    for x, y, electrons in extra:
        light[y, x] += electrons
    rng = np.random.default_rng(seed)
    dn = rng.poisson(light) * GAIN + rng.normal(OFFSET, READ_E, light.shape)
    dn = np.clip(np.rint(dn), 0, 65535).astype(np.uint16)
    return drawn_frame(dn, gain_dn_per_e=GAIN, offset_dn=OFFSET, read_noise_e=READ_E)


def at(time_s):
    return Rotation.from_rotvec(-RATE * time_s) * TRUTH


def tracker(guides, **options):
    return StarTracker(MODEL, guides, centroid="gaussian", window_px=11, **options)


def test_it_tracks_a_turning_sky_and_errs_as_it_states(sky, guides):
    head = tracker(guides)
    head.begin(-0.2, at(-0.2))
    pulls = []
    for n in range(12):
        found = head(frame_of(sky, at(0.2 * n), seed=n), 0.2 * n, rate_rad_per_s=RATE)
        assert found.ok
        assert found.mode == "tracking"
        pulls.append(attitude_error_arcsec(found.attitude, at(0.2 * n)) / found.sigma_arcsec)
        assert np.isclose(np.linalg.norm(found.quat_xyzw), 1.0)
    # 36 deviates: the mean square is 1 +- sqrt(2 / 36); pixel phase of a well sampled spot is small
    assert np.mean(np.square(pulls)) == pytest.approx(1.0, abs=4 * np.sqrt(2 / 36))


def test_without_a_gyro_it_carries_the_turn_between_its_last_attitudes_on(sky, guides):
    head = tracker(guides)
    head.begin(-0.02, at(-0.02))
    assert head(frame_of(sky, at(0.0), seed=1), 0.0).mode == "tracking"
    # in 1 s the sky moves by some 4 px in the field and turns: too far for a tracker that stays where it was
    assert head(frame_of(sky, at(1.0), seed=2), 1.0).mode == "tracking"


def test_false_stars_are_rejected_and_do_not_move_the_attitude(sky, guides):
    clean = tracker(guides)(frame_of(sky, TRUTH, seed=5), 0.0, near=TRUTH)
    head = tracker(guides)
    place = clean.pixel_px[:3]
    false = [(int(x) + dx, int(y) + dy, 60_000.0) for (x, y), dx, dy in zip(place, (3, -3, 0), (0, 1, 4), strict=True)]
    found = head(frame_of(sky, TRUTH, seed=5, extra=false), 0.0, near=TRUTH)
    assert found.ok
    assert found.rejected >= 2
    assert len(found.star_id) < len(clean.star_id)
    error = attitude_error_arcsec(found.attitude, TRUTH)
    assert (np.abs(error) < 5.0 * found.sigma_arcsec).all()


def test_tracks_of_cosmic_rays_are_told_from_stars_by_their_shape(sky):
    """Straight tracks of 1 to 8 px at random angles, in the pixels that they cross."""
    rng, tracks, count = np.random.default_rng(9), [], 16
    for length, turn, x, y in rng.uniform([1, 0, 20, 20], [8, 7, 235, 235], (count, 4)):
        steps = np.arange(0.0, length, 0.1)
        tracks += [(int(x + s * np.cos(turn)), int(y + s * np.sin(turn)), 80.0) for s in steps]
    stars = find_stars(frame_of(sky, TRUTH, seed=9, extra=tracks), "gaussian")
    away = np.linalg.norm(stars.pixel_px[:, None] - np.array(tracks)[:, :2], axis=2).min(axis=1)
    assert (away < 2.0).sum() >= count
    assert unlike_stars(stars)[away < 2.0].mean() > 0.8
    alone = stars.fit & (away > 8.0)  # no track in the window
    assert alone.sum() > 12
    assert not unlike_stars(stars)[alone].any()


@pytest.mark.parametrize("off_px", [2.0, 4.5])
def test_an_attitude_that_is_handed_over_may_be_off_by_pixels(sky, guides, off_px):
    rough = Rotation.from_rotvec(off_px * 5e-4 * np.array([0.8, -0.6, 0.0])) * TRUTH
    frame = frame_of(sky, TRUTH, seed=5)
    found, clean = (tracker(guides)(frame, 0.0, near=near) for near in (rough, TRUTH))
    assert set(found.star_id) >= set(clean.star_id[:10])
    assert (np.abs(attitude_error_arcsec(found.attitude, TRUTH)) < 5.0 * found.sigma_arcsec).all()


def test_a_warm_lens_costs_no_star_where_its_scale_error_is_stated(sky, guides):
    """A scale of 1e-3 moves stars in the corner by 0.18 px, some twenty times their noise."""
    warm, frame = BrownConrady.create(GEOMETRY, focal_length_mm=20.02), frame_of(sky, TRUTH, seed=6)
    blind, told = (
        StarTracker(warm, guides, centroid="gaussian", window_px=11, scale_error=error)(frame, 0.0, near=TRUTH)
        for error in (0.0, 1e-3)
    )
    assert told.rejected == 0
    assert blind.rejected >= 0.3 * len(told.star_id)
    assert (np.abs(attitude_error_arcsec(told.attitude, TRUTH)) < 5.0 * told.sigma_arcsec).all()


def test_a_guide_star_of_known_large_error_has_no_weight(sky, guides):
    frame = frame_of(sky, TRUTH, seed=7)
    all_stars = tracker(guides)(frame, 0.0, near=TRUTH)
    error = np.where(np.isin(guides.id, all_stars.star_id[:5]), 100.0, 0.0)
    told = tracker(guides, star_error_px=error)(frame, 0.0, near=TRUTH)
    kept = {name: getattr(guides, name)[error == 0.0] for name in ("id", "direction", "magnitude", "row")}
    few = tracker(replace(guides, **kept))(frame, 0.0, near=TRUTH)
    np.testing.assert_allclose(told.covariance_rad2, few.covariance_rad2, rtol=1e-4)


def test_aberration_left_out_turns_the_attitude_by_the_velocity_over_that_of_light(sky, guides):
    velocity = np.array([20.0, -15.0, 10.0])
    frame = frame_of(sky, TRUTH, seed=8, velocity=velocity)
    head = tracker(guides)
    told = attitude_error_arcsec(head(frame, 0.0, near=TRUTH, velocity_km_per_s=velocity).attitude, TRUTH)
    left = attitude_error_arcsec(head(frame, 0.0, near=TRUTH).attitude, TRUTH)
    across = TRUTH.apply(velocity) / 299792.458 * 206264.806
    # stars move towards the velocity, v + dV / c: a turn about z x dV. The cos of 4 deg and the field's tilt: 1 %
    np.testing.assert_allclose(left[:2] - told[:2], [-across[1], across[0]], atol=0.02 * np.hypot(*across[:2]))


def test_a_frame_without_stars_gives_no_attitude_and_says_so(sky, guides):
    head = tracker(guides)
    head.begin(-0.1, TRUTH)
    empty = SimpleNamespace(id=sky.id[:0], direction=sky.direction[:0], magnitude=sky.magnitude[:0])
    found = head(frame_of(empty, TRUTH, seed=4), 0.0)
    assert (found.ok, found.status, found.mode) == (False, "few_stars", "acquisition")
    assert found.attitude is None
    assert np.isnan(found.quat_xyzw).all()
    assert np.isinf(found.covariance_rad2).any()


def test_guide_stars_stand_alone_between_their_limits(sky, guides):
    some = slice(None, None, 60)
    distance = np.degrees(np.arccos(np.clip(guides.direction[some] @ sky.direction.T, -1.0, 1.0)))
    near = (distance < np.degrees(11 * 5e-4)) & (distance > 1e-4)
    fainter = sky.magnitude[None] >= guides.magnitude[some, None] + 3.0
    assert (~near | fainter).all()
    assert guides.magnitude.max() <= 5.5
    assert (np.diff(guides.magnitude) >= 0).all()


def test_coverage_counts_the_stars_of_the_field(guides):
    counts = sky_coverage(guides, MODEL, attitudes=2000)
    solid = 4.0 * np.arcsin(np.sin(np.arctan(SIDE * 0.005 / 20.0)) ** 2)  # of a square pyramid, of 4 pi
    mean = len(guides) * solid / (4.0 * np.pi)
    # places overlap: as many independent fields as there are on the sky
    assert counts.mean() == pytest.approx(mean, abs=5.0 * np.sqrt(mean * solid / (4.0 * np.pi)) + 0.02 * mean)
