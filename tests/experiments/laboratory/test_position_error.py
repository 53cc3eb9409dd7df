"""The error of one position and its interval hold the truth; scenes are drawn with NumPy, frame by frame."""

from __future__ import annotations

import numpy as np
import pytest

from experiments.hsfe.own_frames import interval_text
from experiments.laboratory.step_statistics import position_error

POSITIONS, STARS, FRAMES, RUNS = 8, 16, 10, 250


def scene(rng, error_px, frame_px, *, neighbours=0.0, stars=STARS):
    """Centroids (m, f, W, 2): places of the stars, a path with scale and roll, errors of positions, noise of frames."""
    base = rng.uniform(0, 1000, (stars, 2))
    path = np.cumsum(rng.normal(0.2, 0.05, (POSITIONS, 2)), 0)
    strain = rng.normal(0, 1e-5, (2, 2))
    error = rng.normal(0.0, error_px, (POSITIONS, stars, 2))
    for m in range(1, POSITIONS):
        error[m] = neighbours * error[m - 1] + np.sqrt(1 - neighbours**2) * error[m]
    moved = base + path[:, None] + np.arange(POSITIONS)[:, None, None] * ((base - 500) @ strain) + error
    return moved[:, None] + rng.normal(0.0, frame_px, (POSITIONS, FRAMES, stars, 2))


def estimates(error_px, frame_px, seed=3, **scenes):
    rng = np.random.default_rng(seed)
    found = []
    for _ in range(RUNS):
        centroid = scene(rng, error_px, frame_px, **scenes)
        found.append(position_error(centroid.mean(1), centroid.std(1, ddof=1), np.full(POSITIONS, FRAMES)))
    return found


@pytest.mark.parametrize(("error_px", "neighbours"), [(0.02, 0.0), (0.02, 0.7), (0.006, 0.0)])
def test_estimate_and_interval_hold_the_truth(error_px, neighbours):
    """Variance without bias within its standard error; 95 % intervals hold the truth in 95 % of 500, 4 sigma of that.

    The truth is the error about its mean over the path: of errors alike at neighbours with the correlation r^|k| that
    is the variance times 1 minus the mean correlation of two different positions.
    """
    found = estimates(error_px, 0.05, neighbours=neighbours)
    lag = np.abs(np.subtract.outer(np.arange(POSITIONS), np.arange(POSITIONS)))
    alike = (float(neighbours) ** lag)[~np.eye(POSITIONS, dtype=bool)].mean()
    truth = error_px * np.sqrt(1.0 - alike)
    variance = np.array([one.variance_px2 for one in found]).ravel()
    assert variance.mean() == pytest.approx(truth**2, abs=4 * variance.std() / np.sqrt(variance.size))
    inside = [(one.low_px <= truth) & (truth <= one.high_px) for one in found]
    below = [truth <= one.upper_px for one in found]
    spread = np.sqrt(0.95 * 0.05 / variance.size)
    floor = 0.95 - 4 * spread - (0.03 if neighbours else 0.0)  # degrees of freedom are estimated from 13 free stars
    assert floor <= np.mean(inside) <= 0.95 + 4 * spread
    assert floor <= np.mean(below) <= 1.0


def test_axes_do_not_know_of_one_another():
    """Axes exchanged, one of them with an error that neighbours share: every number goes along, degrees too."""
    centroid = scene(np.random.default_rng(4), [0.02, 0.08], 0.05, neighbours=0.5)
    one, other = (
        position_error(at.mean(1), at.std(1, ddof=1), np.full(POSITIONS, FRAMES))
        for at in (centroid, centroid[..., ::-1])
    )
    assert one.degrees[0] != pytest.approx(one.degrees[1], rel=0.01)
    for name in ("variance_px2", "low_px", "high_px", "upper_px", "degrees"):
        np.testing.assert_allclose(getattr(other, name), getattr(one, name)[::-1], rtol=1e-6, err_msg=name)


def test_no_error_is_consistent_with_zero():
    """Frames of a camera without this error: that is said in 97 % of the cases; the limit is below a mean's noise."""
    found = estimates(0.0, 0.05)
    words = [interval_text(one, axis, 1.0) for one in found for axis in range(2)]
    assert np.mean([one.startswith("consistent with zero, upper limit 0.0") for one in words]) > 0.95
    upper = np.array([one.upper_px for one in found])
    assert upper.min() > 0.0  # also where the estimate is far below zero
    assert np.median(upper) < 0.05 / np.sqrt(FRAMES)
    assert np.isnan(found[0].value_px).any() or found[0].variance_px2.min() > 0
