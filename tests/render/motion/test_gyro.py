"""The gyro: units, increments, noise laws against their closed forms, reproducible runs."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from render.engine.random import Streams
from render.motion.gyro import Gyro, simulate_gyro, simulate_gyro_runs, true_rates
from render.motion.trajectory import ConstantRate, Slew

REST = ConstantRate(initial=Rotation.identity(), rate_rad_per_s=np.zeros(3), end_s=100.0)
QUIET = {"bias_deg_per_h": 0.0, "angle_random_walk_deg_per_sqrt_h": 0.0}


def test_defaults_are_acf17_table_1():
    gyro = Gyro()
    assert gyro.rate_hz == 100
    assert gyro.bias_rad_per_s == pytest.approx(np.full(3, 1.4544410433286078e-7), rel=1e-12)  # 0.03"/s
    # 0.005 deg/sqrt(h) is 0.3"/sqrt(s)
    assert gyro.angle_random_walk_rad_per_sqrt_s == pytest.approx(np.full(3, 0.3 * 4.84813681109536e-6), rel=1e-12)


def test_record_covers_the_trajectory():
    record = true_rates(REST, Gyro())
    assert len(record.rate_rad_per_s) == 10_000
    assert record.time_s[0] == 0
    assert record.time_s[-1] == pytest.approx(100, abs=1e-9)
    part = true_rates(REST, Gyro(rate_hz=10), start_s=2.0, end_s=3.05)
    assert part.time_s == pytest.approx(np.arange(11) / 10 + 2)


def test_increments_are_integrals_of_the_rate():
    """A slew about one axis: the sum of the increments is the turn, though the rate varies within each step."""
    turn = np.array([0.2, -0.5, 0.3])
    slew = Slew(initial=Rotation.identity(), final=Rotation.from_rotvec(turn), end_s=10.0)
    for rate_hz in (1.0, 100.0):
        record = true_rates(slew, Gyro(rate_hz=rate_hz))
        assert (record.rate_rad_per_s * np.diff(record.time_s)[:, None]).sum(axis=0) == pytest.approx(-turn, abs=1e-14)


def test_what_the_axes_feel():
    """Scale 100 ppm on x, y misaligned towards z by 10", everything turned by 90 deg about z."""
    spin = ConstantRate(initial=Rotation.identity(), rate_rad_per_s=[0.0, 0.02, 0.01], end_s=1.0)
    mount = Rotation.from_matrix([[0, 1, 0], [-1, 0, 0], [0, 0, 1]])
    plain = true_rates(spin, Gyro(sensor_from_body=mount)).rate_rad_per_s[0]
    assert plain == pytest.approx([0.02, 0, 0.01], abs=1e-16)
    misalignment = np.zeros((3, 3))
    misalignment[1, 2] = 10.0
    gyro = Gyro(sensor_from_body=mount, scale_factor_ppm=[100, 0, 0], misalignment_arcsec=misalignment)
    felt = true_rates(spin, gyro).rate_rad_per_s[0]
    assert felt - plain == pytest.approx([2e-6, 0.01 * 10 / 206264.80624709636, 0], abs=1e-15)


def final_angle(gyro, runs, seconds):
    _, rates = simulate_gyro_runs(REST, gyro, Streams(3), runs=runs, end_s=seconds)
    return rates.sum(axis=1) / gyro.rate_hz


@pytest.mark.parametrize(("seconds", "rate_hz"), [(0.01, 100.0), (1.0, 100.0), (60.0, 100.0), (1.0, 1000.0)])
def test_angle_random_walk_grows_as_the_root_of_time(seconds, rate_hz):
    """sigma = N sqrt(t), whatever the step; 3 axes x runs, tolerance 4 / sqrt(2 M)."""
    runs = 200
    gyro = Gyro(rate_hz=rate_hz, bias_deg_per_h=0.0, angle_random_walk_deg_per_sqrt_h=0.005)
    angle_deg = np.degrees(final_angle(gyro, runs, seconds))
    expected_deg = 0.005 * np.sqrt(seconds / 3600)
    assert np.sqrt(np.mean(angle_deg**2)) == pytest.approx(expected_deg, rel=4 / np.sqrt(6 * runs))


def test_bias_drifts_with_time():
    angle = final_angle(Gyro(bias_deg_per_h=[0.03, -0.06, 0.0], angle_random_walk_deg_per_sqrt_h=0.0), 1, 60.0)[0]
    assert np.degrees(angle) * 3600 == pytest.approx([1.8, -3.6, 0.0], abs=1e-9)


def test_rate_random_walk_grows_with_the_power_of_three_halves():
    """sigma of the angle = K t^1.5 / sqrt(3), also over a single step."""
    runs, density = 400, 3.0
    for seconds, rate_hz in ((1.0, 1.0), (50.0, 10.0)):
        gyro = Gyro(rate_hz=rate_hz, rate_random_walk_deg_per_h_per_sqrt_h=density, **QUIET)
        angle_deg = np.degrees(final_angle(gyro, runs, seconds))
        expected_deg = density * (seconds / 3600) ** 1.5 / np.sqrt(3)
        assert np.sqrt(np.mean(angle_deg**2)) == pytest.approx(expected_deg, rel=4 / np.sqrt(6 * runs))


def test_noise_of_the_axes_is_independent():
    rates = simulate_gyro(REST, Gyro(), Streams(6)).rate_rad_per_s
    assert np.abs(np.corrcoef(rates.T) - np.eye(3)).max() < 4 / np.sqrt(len(rates))
    assert abs(np.corrcoef(rates[1:, 0], rates[:-1, 0])[0, 1]) < 4 / np.sqrt(len(rates))


def test_a_run_is_the_same_alone_and_among_others():
    gyro, streams = Gyro(rate_random_walk_deg_per_h_per_sqrt_h=1.0), Streams(8)
    time, rates = simulate_gyro_runs(REST, gyro, streams, runs=range(3, 6), end_s=2.0)
    alone = simulate_gyro(REST, gyro, streams, run=4, end_s=2.0)
    assert (alone.rate_rad_per_s == rates[1]).all()
    assert (alone.time_s == time).all()
    assert not (rates[0] == rates[1]).any()
    # a longer record begins with the same white noise
    longer = simulate_gyro(REST, Gyro(), streams, run=4, end_s=4.0).rate_rad_per_s[:200]
    assert (longer == simulate_gyro(REST, Gyro(), streams, run=4, end_s=2.0).rate_rad_per_s).all()
