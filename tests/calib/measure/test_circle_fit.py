"""Circle and ellipse fits: exact points, a slow independent minimisation, scatter against covariance, refusals."""

import numpy as np
import pytest
from scipy.optimize import minimize

from calib.measure.circle_fit import _ellipse_distance, fit_circle, fit_ellipse
from optics.errors import DomainError


def on_circle(angles, centre=(3.2, -1.7), radius=12.5):
    return np.array(centre) + radius * np.column_stack([np.cos(angles), np.sin(angles)])


def on_ellipse(angles, x=4.0, y=-2.0, a=9.0, b=5.5, turn=0.6):
    u, v = a * np.cos(angles), b * np.sin(angles)
    return np.column_stack([x + u * np.cos(turn) - v * np.sin(turn), y + u * np.sin(turn) + v * np.cos(turn)])


def test_points_of_a_circle_give_it_back():
    fit = fit_circle(on_circle(np.linspace(0, 5.5, 40)))
    assert fit.centre == pytest.approx([3.2, -1.7], abs=1e-10)
    assert fit.radius == pytest.approx(12.5, abs=1e-10)
    assert fit.rms < 1e-10


def test_points_of_an_ellipse_give_it_back():
    fit = fit_ellipse(on_ellipse(np.linspace(0, 2 * np.pi, 50, endpoint=False)))
    assert fit.centre == pytest.approx([4.0, -2.0], abs=1e-9)
    assert fit.semi_axes == pytest.approx([9.0, 5.5], abs=1e-9)
    assert fit.angle_rad == pytest.approx(0.6, abs=1e-9)


def test_fit_minimises_the_orthogonal_distances():
    """Short noisy arc, where algebraic fits are biased: the same minimum as a simplex search on the sum itself."""
    rng = np.random.default_rng(5)
    points = on_circle(np.linspace(0, 1.2, 60)) + 0.05 * rng.standard_normal((60, 2))

    def total(value):
        return np.sum((np.hypot(*(points - value[:2]).T) - value[2]) ** 2)

    best = minimize(total, [3.0, -2.0, 12.0], method="Nelder-Mead", options={"xatol": 1e-9, "fatol": 1e-14})
    fit = fit_circle(points, clip_sigma=np.inf)
    assert [*fit.centre, fit.radius] == pytest.approx(best.x, abs=1e-5)


def test_distance_to_an_ellipse_is_the_shortest():
    rng = np.random.default_rng(6)
    points = on_ellipse(rng.uniform(0, 2 * np.pi, 30)) + rng.normal(0, 0.4, (30, 2))
    dense = on_ellipse(np.linspace(0, 2 * np.pi, 400001))
    nearest = [np.hypot(*(dense - point).T).min() for point in points]
    distance, jacobian = _ellipse_distance(points, np.array([4.0, -2.0, 9.0, 5.5, 0.6]))
    assert np.abs(distance) == pytest.approx(nearest, abs=1e-5)
    for k in range(5):
        step = np.zeros(5)
        step[k] = 1e-6
        value = np.array([4.0, -2.0, 9.0, 5.5, 0.6])
        numeric = (_ellipse_distance(points, value + step)[0] - _ellipse_distance(points, value - step)[0]) / 2e-6
        assert jacobian[:, k] == pytest.approx(numeric, abs=1e-6)


@pytest.mark.parametrize("stated", [True, False])
def test_covariance_is_the_scatter(stated):
    """200 circles of 60 points: variance of a pull is 1 to 3 sqrt(2/200) = 0.3, its mean 0 to 3/sqrt(200) = 0.21."""
    rng = np.random.default_rng(7)
    angles = np.linspace(0, 4.0, 60)
    pulls = []
    for _ in range(200):
        points = on_circle(angles) + 0.1 * rng.standard_normal((60, 2))
        fit = fit_circle(points, sigma=0.1 if stated else None, clip_sigma=np.inf)
        pulls.append(([*fit.centre, fit.radius] - np.array([3.2, -1.7, 12.5])) / fit.sigma)
    assert np.mean(pulls, axis=0) == pytest.approx([0, 0, 0], abs=0.21)
    assert np.var(pulls, axis=0) == pytest.approx([1, 1, 1], abs=0.3)


def test_stray_points_are_left_out():
    rng = np.random.default_rng(8)
    points = on_circle(np.linspace(0, 6.0, 80)) + 0.02 * rng.standard_normal((80, 2))
    points[::16] += 0.1 * (points[::16] - np.array([3.2, -1.7]))
    fit = fit_circle(points, sigma=0.02)
    assert not fit.used[::16].any()
    assert fit.used.sum() >= 73
    assert fit.centre == pytest.approx([3.2, -1.7], abs=0.02)


@pytest.mark.parametrize(
    ("points", "said"),
    [
        (np.zeros((3, 2)), "at least 4 points"),
        (np.zeros((10, 3)), "at least 4 points"),
        (np.ones((10, 2)), "coincide"),
        (np.column_stack([np.arange(10.0), 2 * np.arange(10.0)]), "on a line"),
        (np.full((10, 2), np.nan), "not finite"),
    ],
)
def test_what_is_no_circle_is_refused(points, said):
    with pytest.raises(DomainError, match=said):
        fit_circle(points)


def test_sigma_must_be_positive():
    with pytest.raises(DomainError, match="must be positive"):
        fit_circle(on_circle(np.arange(6.0)), sigma=0.0)
