"""ACC18 eq. 3-12 on numbers whose statistics are known."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from experiments.laboratory.high_frequency import HighFrequencyMeasurement
from experiments.laboratory.step_statistics import (
    _degrees,
    document_rms_px,
    halved_px,
    jackknife_px,
    single_rms_px,
    step_residual_px,
)
from optics.errors import DomainError

M, W = 400, 25
STARS = np.random.default_rng(5).uniform(0.0, 2000.0, (W, 2))


def test_common_motion_cancels():
    walk = np.random.default_rng(0).normal(size=(M, 1, 2)).cumsum(0)
    assert np.abs(step_residual_px(STARS + walk)).max() < 1e-9


def test_a_star_that_jumps_once_is_seen_in_one_step():
    mean = np.tile(STARS, (4, 1, 1))
    mean[2:, 3, 0] += 0.5
    left = step_residual_px(mean)
    assert left[1, 3, 0] == pytest.approx(0.5 * (1 - 1 / W))
    assert np.abs(left[[0, 2]]).max() < 1e-12
    assert np.abs(left[..., 1]).max() < 1e-12


def test_independent_errors_show_sqrt_2_times_in_the_document_and_once_when_halved():
    rng = np.random.default_rng(1)
    sigma, noise, frames = np.array([0.02, 0.03]), 0.05, 30
    error = sigma * rng.normal(size=(M, W, 2))
    mean = STARS + error + noise / np.sqrt(frames) * rng.normal(size=(M, W, 2))
    margin = 4.0 / np.sqrt(M * W)  # two axes, differences share positions: variance of the square is below 3 / (M W)
    document = document_rms_px(mean)
    expected = np.sqrt(2.0 * (sigma**2 + noise**2 / frames) * (1 - 1 / W))
    np.testing.assert_allclose(document, expected, rtol=margin)
    np.testing.assert_allclose(halved_px(document, np.full((M, W, 2), noise), frames), sigma, rtol=2 * margin)
    np.testing.assert_allclose(single_rms_px(mean - STARS, np.full((M, W, 2), noise), frames), sigma, rtol=2 * margin)


def test_errors_that_neighbours_share_do_not_show_in_the_document():
    error = np.tile(0.1 * np.random.default_rng(2).normal(size=(1, W, 2)), (M, 1, 1))
    assert document_rms_px(STARS + error).max() < 1e-9
    assert single_rms_px(error).min() > 0.05


def test_the_jackknife_gives_the_scatter_from_one_set_of_stars_to_the_next():
    rng = np.random.default_rng(3)
    runs = [STARS + 0.02 * rng.normal(size=(12, W, 2)) for _ in range(200)]
    scatter = np.std([document_rms_px(run) for run in runs], axis=0)
    estimate = np.sqrt(np.mean([jackknife_px(run) ** 2 for run in runs], axis=0))
    np.testing.assert_allclose(estimate, scatter, rtol=0.25)  # 200 runs: 5 % each, and the jackknife's bias upwards


@pytest.mark.parametrize(("alone", "effect"), [(True, 0.3), (False, 0.4)])
def test_what_a_cause_does_alone_and_what_is_missing_without_it(alone, effect):
    runs = {"all": 1.0, "none": 0.2, "only prnu": 0.5, "without prnu": 0.6}
    seen = SimpleNamespace(mean_px={name: {"cog": np.full((3, 2, 2), value)} for name, value in runs.items()})
    found = HighFrequencyMeasurement.effect_px(seen, "cog", "prnu", alone=alone)
    np.testing.assert_allclose(found, effect, rtol=1e-12)


def test_degrees_of_freedom_of_correlated_steps():
    """Scatter of a sum of squares is sqrt(2 / degrees): of five stars in 12 steps that share half with the next one."""
    rng, free = np.random.default_rng(4), 5
    drawn = rng.standard_normal((4000, 13, free))
    left = drawn[:, 1:] + drawn[:, :-1]
    square = (left**2).sum((1, 2))
    degrees = 1.0 / np.mean([1.0 / _degrees(one, free) for one in left])
    assert degrees == pytest.approx(2.0 * square.mean() ** 2 / square.var(), rel=0.08)


@pytest.mark.parametrize("shape", [(1, 5, 2), (4, 1, 2), (4, 2)])
def test_too_little_is_refused(shape):
    with pytest.raises(DomainError, match="at least 2 positions of 2 stars"):
        step_residual_px(np.zeros(shape))
