"""Integration of rates: exact where it must be, of fourth order under coning."""

import numpy as np
import pytest
from calibration_scene import PHI_DEG, THETA_DEG, body_turns, document_matrix
from scipy.spatial.transform import Rotation

from calib.attitude.gyro_attitude import integrate_rates, integrate_rates_many, link_attitudes


def mean_rates(rate, time_s, nodes=8):
    """Means of a rate over intervals, by a quadrature of order 16."""
    x, w = np.polynomial.legendre.leggauss(nodes)
    step = np.diff(time_s)
    t = time_s[:-1, None] + 0.5 * step[:, None] * (x + 1)
    return 0.5 * np.einsum("q,nqi->ni", w, rate(t.ravel()).reshape(len(step), nodes, 3))


CONE_RAD, CONE_RAD_PER_S = 0.05, 2 * np.pi * 2.0


def cone_attitude(t):
    """Body from reference of a coning motion: the body's rotation vector has a fixed length and circles in a plane."""
    phase = CONE_RAD_PER_S * t
    vector = CONE_RAD * np.column_stack([np.cos(phase), np.sin(phase), 0 * phase])
    return Rotation.from_rotvec(vector).inv()


def cone_rate(t):
    """Its rate in body axes: W (-sin a sin Wt, sin a cos Wt, -2 sin^2(a / 2)) (Savage 1998)."""
    phase = CONE_RAD_PER_S * t
    across = CONE_RAD_PER_S * np.sin(CONE_RAD)
    along = -2 * CONE_RAD_PER_S * np.sin(CONE_RAD / 2) ** 2
    return np.column_stack([-across * np.sin(phase), across * np.cos(phase), along + 0 * phase])


def cone_error(steps, *, coning):
    time = np.linspace(0, 2.0, steps + 1)
    got = integrate_rates(time, mean_rates(cone_rate, time), coning=coning)
    truth = cone_attitude(time) * cone_attitude(time[:1])[0].inv()
    return (got * truth.inv()).as_rotvec()


@pytest.mark.parametrize("coning", [True, False])
@pytest.mark.parametrize("steps", [1, 2, 7, 6000])
def test_fixed_direction_is_exact(steps, coning):
    """Uneven steps, a rate that changes its size: the angle is the integral, to rounding."""
    rng = np.random.default_rng(1)
    time = np.concatenate([[0], np.cumsum(rng.uniform(0.005, 0.02, steps))])
    axis, speed = np.array([0.6, 0, -0.8]), rng.uniform(-1, 1, steps)
    rotation = integrate_rates(time, speed[:, None] * axis, coning=coning)
    angle = np.concatenate([[0], np.cumsum(speed * np.diff(time))])
    assert (rotation * Rotation.from_rotvec(angle[:, None] * axis)).magnitude().max() < 1e-14
    assert len(rotation) == steps + 1


def test_sense_is_body_from_first_body():
    """A quarter turn about z: what lay along the first x axis now lies along -y."""
    rotation = integrate_rates([0.0, 1.0, 2.0], np.tile([0, 0, np.pi / 4], (2, 1)))
    assert rotation[-1].apply([1, 0, 0]) == pytest.approx([0, -1, 0], abs=1e-15)
    assert rotation[0].magnitude() == 0


def test_products_are_those_of_a_plain_loop():
    rng = np.random.default_rng(2)
    for steps in (1, 2, 3, 8, 13, 100):
        time = np.arange(steps + 1) * 0.1
        rate = rng.normal(size=(steps, 3))
        got = integrate_rates(time, rate, coning=False)
        loop = Rotation.identity()
        for k in range(steps):
            loop = Rotation.from_rotvec(-0.1 * rate[k]) * loop
            assert (got[k + 1] * loop.inv()).magnitude() < 1e-13


def test_coning_has_order_four_with_the_correction_and_two_without():
    """Halving the step divides the drift by 2^4 and by 2^2."""
    with_it = [np.linalg.norm(cone_error(n, coning=True)[-1]) for n in (100, 200, 400)]
    without = [np.linalg.norm(cone_error(n, coning=False)[-1]) for n in (100, 200, 400)]
    assert np.log2(np.divide(with_it[:-1], with_it[1:])) == pytest.approx([4, 4], abs=0.3)
    assert np.log2(np.divide(without[:-1], without[1:])) == pytest.approx([2, 2], abs=0.05)
    assert with_it[1] < 0.02 * without[1]


def test_uneven_steps_keep_the_order():
    rng = np.random.default_rng(3)
    errors = []
    for steps in (100, 200):
        time = np.linspace(0, 2.0, steps + 1)
        time[1:-1] += rng.uniform(-0.2, 0.2, steps - 1) * 2.0 / steps
        got = integrate_rates(time, mean_rates(cone_rate, time))[-1]
        truth = cone_attitude(time[-1:]) * cone_attitude(time[:1]).inv()
        errors.append((got * truth.inv()).magnitude()[0])
    assert errors[0] / errors[1] > 6


def test_a_rate_that_turns_evenly_is_exact_to_third_order_from_the_first_interval_on():
    """Rationale: rates at the middles of two intervals tell an even change; Magnus' second term then stands in h^3.
    Expected: against 1000 times finer rates, the error after each interval falls with the fifth power of its length."""
    b, c = np.array([0.3, -0.2, 0.5]), np.array([-0.4, 0.9, 0.1])
    errors = []
    for h in (0.2, 0.1):
        time = np.array([0.0, h, 2.0 * h])
        got = integrate_rates(time, b + c * (time[:-1] + h / 2)[:, None])
        fine = np.linspace(0.0, 2.0 * h, 2001)
        truth = integrate_rates(fine, b + c * (fine[:-1] + h / 2000)[:, None], at_s=time)
        errors.append((got * truth.inv()).magnitude()[1:])
    assert np.all(np.array(errors[0]) / errors[1] > 20.0)


def test_requested_times_of_one_record_and_of_many():
    """On the ends of intervals the whole products, between them a constant rate; any order, both ends."""
    rng = np.random.default_rng(4)
    time, rate = np.arange(11) * 0.1, rng.normal(size=(10, 3))
    all_ends = integrate_rates(time, rate)
    picked = integrate_rates(time, rate, time[[10, 3, 0]])
    assert (picked * all_ends[[10, 3, 0]].inv()).magnitude().max() < 1e-15
    between = integrate_rates(time, rate, [0.34], coning=False)
    assert (
        between * (Rotation.from_rotvec(-0.04 * rate[3]) * integrate_rates(time, rate, [0.3], coning=False)).inv()
    ).magnitude()[0] < 1e-15
    rng = np.random.default_rng(5)
    time, rates = np.arange(8) * 0.2, rng.normal(size=(4, 7, 3))
    at = [0.0, 0.5, 1.4]
    for many, rate in zip(integrate_rates_many(time, rates, at), rates, strict=True):
        assert (many * integrate_rates(time, rate, at).inv()).magnitude().max() < 1e-15


def test_frames_linked_by_a_gyro():
    """Eq. 6 with the matrices multiplied out."""
    a, first = document_matrix(THETA_DEG), document_matrix(PHI_DEG)
    turn = body_turns(5, 3.0)
    linked = link_attitudes(Rotation.from_matrix(first), Rotation.from_matrix(a), Rotation.from_matrix(turn))
    for k in range(5):
        np.testing.assert_allclose(linked[k].as_matrix(), a @ turn[k] @ a.T @ first, atol=1e-14)
    assert (linked[0] * Rotation.from_matrix(first).inv()).magnitude() < 1e-14
