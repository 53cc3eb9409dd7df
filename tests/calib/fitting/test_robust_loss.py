"""Robust losses: weight is the slope of rho, and the stated efficiency is what a simulation finds."""

import numpy as np
import pytest

from calib.fitting.robust_loss import get_loss, list_losses

ROBUST = [name for name in list_losses() if name != "linear"]


@pytest.mark.parametrize("name", list_losses())
def test_weight_is_the_slope_of_rho(name):
    loss = get_loss(name)
    s = np.linspace(0.01, 60.0, 400)
    s = s[np.abs(s - loss.tuning**2) > 0.1]  # huber bends there
    slope = (loss.rho(s + 1e-5) - loss.rho(s - 1e-5)) / 2e-5
    np.testing.assert_allclose(loss.weight(s), slope, atol=1e-8)
    assert loss.rho(np.array([0.0]))[0] == 0.0
    assert loss.weight(np.array([0.0]))[0] == 1.0


def test_only_some_forget():
    assert [name for name in list_losses() if get_loss(name).redescending] == ["cauchy", "tukey"]
    assert get_loss("tukey").weight(np.array([1e4]))[0] == 0.0


@pytest.mark.parametrize("name", ROBUST)
def test_default_tuning_keeps_95_percent_for_star_positions(name):
    assert get_loss(name).efficiency(2) == pytest.approx(0.95, abs=2e-3)


@pytest.mark.parametrize(("name", "tuning"), [("huber", 1.345), ("tukey", 4.685), ("cauchy", 2.385)])
def test_textbook_tunings_of_one_dimension(name, tuning):
    """Holland & Welsch (1977): these give 95 % efficiency for scalars."""
    assert get_loss(name, tuning=tuning).efficiency(1) == pytest.approx(0.95, abs=1e-3)


@pytest.mark.parametrize("name", ROBUST)
def test_efficiency_and_variance_factor_of_a_mean(name):
    """Location of 60 two-dimensional normal points, 1500 times, by reweighting: variance as stated, within 5 sigma."""
    loss, n, trials = get_loss(name), 60, 1500
    points = np.random.default_rng(1).standard_normal((trials, n, 2))
    mean = points.mean(axis=1)
    for _ in range(25):
        weight = loss.weight(np.sum((points - mean[:, None]) ** 2, axis=2))
        mean = np.sum(weight[:, :, None] * points, axis=1) / weight.sum(axis=1)[:, None]
    variance = np.mean(mean**2) * n
    spread = 5 * np.sqrt(2.0 / (2 * trials))
    # the M-estimate of 60 points is not yet asymptotic: another 1/60
    assert variance * loss.efficiency(2) == pytest.approx(1.0, abs=spread + 1 / n)
    predicted = loss.variance_factor(2) / weight.sum(axis=1)
    assert np.mean(mean**2) / np.mean(predicted) == pytest.approx(1.0, abs=spread + 1 / n)
