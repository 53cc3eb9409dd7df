"""Trajectories: attitude and rate agree, constant rate is exact, the range is kept."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from render.motion.trajectory import (
    ConstantRate,
    SampledAttitude,
    Slew,
    TurningAxis,
    mounted,
    precession,
    rate_of_trail,
    swept_rotation,
    trail_of_rate,
)

START = Rotation.from_euler("zyx", [30, -20, 50], degrees=True)
RATE = np.radians([0.3, -0.4, 0.5])


def wobble(samples=41):
    """Attitudes every 0.5 s that turn about changing axes."""
    t = np.linspace(0, 20, samples)
    angles = np.column_stack([0.3 * np.sin(0.4 * t), 0.2 * np.cos(0.7 * t), 0.1 * t])
    return SampledAttitude(samples_s=t, attitudes=Rotation.from_rotvec(angles) * START)


FAMILY = {
    "constant": ConstantRate(initial=START, rate_rad_per_s=RATE, end_s=20.0),
    "sampled": wobble(),
    "slew": Slew(initial=START, final=Rotation.from_euler("xz", [70, -40], degrees=True) * START, end_s=20.0),
    "turning": TurningAxis(initial=START, speed_rad_per_s=0.05, turns_rad_per_s=0.3, end_s=20.0),
    "camera": mounted(wobble(), Rotation.from_euler("xyz", [2, 92, -30], degrees=True)),
}


@pytest.mark.parametrize("trajectory", FAMILY.values(), ids=FAMILY.keys())
def test_rate_is_the_derivative_of_the_attitude(trajectory):
    """Central differences of the attitude, error of second order: the stars turn by minus the body's rate."""
    t, h = np.linspace(0.5, 19.5, 77), 1e-3
    step = trajectory.attitude(t + h) * trajectory.attitude(t - h).inv()
    assert np.abs(-step.as_rotvec() / (2 * h) - trajectory.rate(t)).max() < 1e-6


@pytest.mark.parametrize("trajectory", FAMILY.values(), ids=FAMILY.keys())
def test_one_time_and_many(trajectory):
    t = np.array([0.0, 3.3, 20.0])
    many, rates = trajectory.attitude(t), trajectory.rate(t)
    assert rates.shape == (3, 3)
    for k, one in enumerate(t):
        assert trajectory.attitude(one).single
        assert (trajectory.attitude(one) * many[k].inv()).magnitude() < 1e-14
        assert trajectory.rate(one) == pytest.approx(rates[k], abs=1e-15)


def test_ends_are_kept_in_spite_of_rounding():
    assert FAMILY["sampled"].attitude(np.full(200, 0.1).cumsum()).as_quat().shape == (200, 4)


def test_body_turning_forward_sees_the_stars_turn_back():
    """The sense of ACF17's R_z(a) = [[cos, sin, 0], [-sin, cos, 0], [0, 0, 1]] with a = rate * time."""
    turn = ConstantRate(initial=Rotation.identity(), rate_rad_per_s=[0, 0, np.radians(1)], end_s=60)
    c, s = np.cos(np.radians(30)), np.sin(np.radians(30))
    assert turn.attitude(30).as_matrix() == pytest.approx(np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]]), abs=1e-15)


def test_constant_rate_is_exact():
    """Ten thousand revolutions later it is back, and half the time twice is the whole."""
    spin = ConstantRate(initial=START, rate_rad_per_s=2 * np.pi * np.array([0.6, 0, 0.8]), end_s=1e4)
    assert (spin.attitude(1e4) * START.inv()).magnitude() < 1e-11  # rounding of the angle, 6e4 rad
    half = spin.attitude(0.125) * START.inv()
    assert (half * half * START * spin.attitude(0.25).inv()).magnitude() < 1e-15


def test_start_time_is_an_origin():
    early = ConstantRate(initial=START, rate_rad_per_s=RATE, end_s=20.0)
    late = ConstantRate(initial=START, rate_rad_per_s=RATE, start_s=100.0, end_s=120.0)
    assert (early.attitude(7.0) * late.attitude(107.0).inv()).magnitude() < 1e-14


def test_spline_goes_through_its_samples_and_keeps_a_constant_rate():
    constant = FAMILY["constant"]
    t = np.array([0.0, 1.0, 4.0, 9.0, 20.0])
    spline = SampledAttitude(samples_s=t, attitudes=constant.attitude(t))
    dense = np.linspace(0, 20, 300)
    assert (spline.attitude(dense) * constant.attitude(dense).inv()).magnitude().max() < 1e-13
    assert np.abs(spline.rate(dense) - RATE).max() < 1e-13
    wobbly = wobble()
    assert (wobbly.attitude(wobbly.samples_s) * wobbly.attitudes.inv()).magnitude().max() < 1e-14


def test_spline_converges_at_its_order():
    """Twice the samples, an eighth to a sixteenth of the error (cubic spline, fourth order inside)."""
    truth = wobble(samples=2001)
    t = np.linspace(5, 15, 501)

    def error(samples):
        knots = np.linspace(0, 20, samples)
        spline = SampledAttitude(samples_s=knots, attitudes=truth.attitude(knots))
        return (spline.attitude(t) * truth.attitude(t).inv()).magnitude().max()

    assert error(21) / error(41) > 8


def test_slew_goes_from_rest_to_rest():
    slew = FAMILY["slew"]
    assert (slew.attitude(0.0) * START.inv()).magnitude() < 1e-15
    assert (slew.attitude(20.0) * slew.final.inv()).magnitude() < 1e-15
    assert slew.rate([0.0, 20.0]) == pytest.approx(np.zeros((2, 3)))
    t = np.linspace(0, 20, 2001)
    angle = np.linalg.norm(slew.rate(t), axis=1).sum() * (t[1] - t[0])
    assert angle == pytest.approx((slew.final * START.inv()).magnitude(), rel=1e-9)


def test_camera_on_the_body():
    """The camera's attitude by hand; its speed is the body's."""
    mount = FAMILY["camera"].mount
    body, t = wobble(), np.array([2.0, 11.0])
    v = np.array([0.36, 0.48, 0.8])
    assert FAMILY["camera"].attitude(t).apply(v) == pytest.approx(mount.apply(body.attitude(t).apply(v)), abs=1e-15)
    assert np.linalg.norm(FAMILY["camera"].rate(t), axis=1) == pytest.approx(np.linalg.norm(body.rate(t), axis=1))


def test_a_star_on_the_boresight_trails_where_the_rate_is_made_for():
    rate = rate_of_trail(0.3, 20.0)
    path = ConstantRate(initial=Rotation.identity(), rate_rad_per_s=rate, end_s=1.0)
    x, y, _ = path.attitude(1.0).apply([0.0, 0.0, 1.0])
    assert np.degrees(np.hypot(x, y)) == pytest.approx(0.3, rel=1e-5)
    assert np.degrees(np.arctan2(y, x)) == pytest.approx(20.0, abs=1e-9)
    assert trail_of_rate(rate) == pytest.approx((0.3, 20.0))
    assert trail_of_rate([0.0, 0.0, 1.0]) == (0.0, 0.0)


def test_swept_rotation_is_the_integral():
    """Against a midpoint sum 50 times finer than the times; error of that is some 1e-4 of a step."""
    motion = FAMILY["turning"]
    time = (np.arange(19 * 50) + 0.5) / 50
    turned = (motion.attitude(0.0) * motion.attitude(time).inv()).as_matrix()
    sums = np.concatenate([np.zeros((1, 3, 3)), np.cumsum(turned / 50, axis=0)])[::50]
    assert swept_rotation(motion, np.arange(20.0)) == pytest.approx(sums, abs=1e-4)
    assert np.linalg.norm(motion.rate(time), axis=1) == pytest.approx(0.05, rel=1e-12)


def test_precession_has_a_constant_speed_about_an_axis_that_turns():
    """A small tilt: the axis in the body turns by the asked angle; the speed is that of the rate."""
    path = precession(START, rate_rad_per_s=0.02, tilt_rad=0.3, turn_rad=np.pi, end_s=10.0, steps=400, knot_every=5)
    rate = path.rate(np.array([0.5, 5.0, 9.5]))
    assert np.linalg.norm(rate, axis=1) == pytest.approx(0.02, rel=1e-4)
    along = rate / np.linalg.norm(rate, axis=1, keepdims=True)
    turned = np.pi * np.array([0.05, 0.5, 0.95])
    axis = np.column_stack([-np.sin(0.3) * np.sin(turned), np.sin(0.3) * np.cos(turned), np.full(3, np.cos(0.3))])
    np.testing.assert_allclose(along, axis, atol=1e-3)
