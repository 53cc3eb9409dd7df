"""Metrics at a confidence level against closed forms and published tables."""

import numpy as np
import pytest

from calib.accuracy.ecss_metrics import (
    bound_at_level,
    ecss_metrics,
    mixture_bound,
    normal_factor,
    quantile_limit,
    runs_needed,
    success_limit,
)


def test_factors_of_normal_errors_and_of_their_mixtures():
    assert normal_factor(0.6827) == pytest.approx(1.0, abs=1e-4)
    assert normal_factor(0.95) == pytest.approx(1.959964, abs=1e-6)
    assert normal_factor(0.9973) == pytest.approx(3.0, abs=1e-4)
    # one sigma: the normal factor. Half at rest: the level of the others is twice as far from 1
    assert mixture_bound(np.full(7, 2.0), 0.95) == pytest.approx(2.0 * 1.959964, rel=1e-6)
    assert mixture_bound(np.array([1e-9, 1.0]), 0.975) == pytest.approx(1.959964, rel=1e-6)
    assert mixture_bound(np.array([1.0, np.inf]), 0.6) == np.inf
    draws = np.random.default_rng(3).normal(size=400_000) * np.tile([0.5, 1.0, 4.0, 8.0], 100_000)
    assert mixture_bound(np.array([0.5, 1.0, 4.0, 8.0]), 0.997) == pytest.approx(
        np.quantile(np.abs(draws), 0.997),
        rel=0.02,  # 1200 draws beyond it: 3 % of their number is 0.4 % of the bound; four sigma
    )


@pytest.mark.parametrize(
    ("share", "confidence", "failures", "runs"),
    [(0.95, 0.95, 0, 59), (0.95, 0.95, 1, 93), (0.99, 0.95, 0, 299), (0.90, 0.90, 0, 22), (0.997, 0.95, 0, 998)],
)
def test_runs_that_show_a_share_with_confidence(share, confidence, failures, runs):
    """Wilks' table; without failures the least n with share^n below 1 - confidence."""
    assert runs_needed(share, confidence, failures) == runs


def test_runs_that_all_succeed_show_the_fraction_that_wilks_has():
    """(1 - confidence)^(1/n); with failures, the limit of the runs that `runs_needed` asks for."""
    assert success_limit(10, 10, 0.9) == pytest.approx(0.1**0.1, rel=1e-12)
    assert success_limit(92, 93, 0.95) > 0.95 > success_limit(91, 92, 0.95)
    assert success_limit(0, 5, 0.9) == 0.0


def test_confidence_limit_of_a_quantile():
    """The largest of 59 exceeds the 95 % quantile with 95 % confidence, the largest of 58 does not."""
    assert quantile_limit(np.arange(59.0), 0.95, 0.95) == 58.0
    assert quantile_limit(np.arange(58.0), 0.95, 0.95) == np.inf
    rng = np.random.default_rng(5)
    covered = [quantile_limit(rng.uniform(size=300), 0.9, 0.9) >= 0.9 for _ in range(2000)]
    assert 0.9 - 3.0 * 0.0067 <= np.mean(covered) <= 0.95  # sigma of a share of 2000; ranks are whole numbers


def test_metrics_of_a_bias_a_drift_and_noise():
    bias = ecss_metrics(np.full((3, 40), -2.0), 10, 0.9)
    assert bias == pytest.approx({"AME": 2.0, "MME": 2.0, "RME": 0.0, "MDE": 0.0})
    ramp = ecss_metrics(np.arange(40.0)[None] * 0.5, 10, 0.9)
    assert ramp["MDE"] == pytest.approx(5.0)  # ten steps of a half from window to window
    assert ramp["RME"] == pytest.approx(2.25)  # within a window from -2.25 to 2.25, the outermost a fifth of all
    noise = ecss_metrics(np.random.default_rng(1).normal(size=(50, 4000)), 100, 0.95)
    assert noise["AME"] == pytest.approx(1.96, rel=0.01)
    assert noise["MME"] == pytest.approx(0.196, rel=0.08)  # 2000 means
    assert noise["MDE"] == pytest.approx(0.196 * np.sqrt(2.0), rel=0.08)


def test_times_without_a_measurement_are_left_out():
    error = np.random.default_rng(2).normal(size=(3, 60))
    gaps = np.append(error, np.full((3, 20), np.nan), axis=1)
    gaps[:, 5] = np.nan
    short = np.delete(error, 5, axis=1)
    found = ecss_metrics(gaps, 20, 0.9)
    assert found["AME"] == pytest.approx(np.quantile(np.abs(short), 0.9))
    means = np.stack([short[:, :19].mean(1), short[:, 19:39].mean(1), short[:, 39:].mean(1)], axis=1)
    assert found["MME"] == pytest.approx(np.quantile(np.abs(means), 0.9))
    assert ecss_metrics(gaps, 20, 0.9, "temporal")["AME"] == pytest.approx(
        np.quantile(np.abs(short), 0.9, axis=1).max()
    )


def test_interpretations():
    """A bad sensor is the worst realisation, a bad moment the worst time; mixed they are rare."""
    error = np.ones((10, 200))
    error[3] = 5.0
    assert bound_at_level(error, 0.85, "temporal") == 5.0
    assert bound_at_level(error, 0.85, "ensemble") == 1.0
    assert bound_at_level(error, 0.85, "mixed") == 1.0
    error = np.ones((10, 200))
    error[:, 7] = 9.0
    assert (bound_at_level(error, 0.85, "temporal"), bound_at_level(error, 0.85, "ensemble")) == (1.0, 9.0)
