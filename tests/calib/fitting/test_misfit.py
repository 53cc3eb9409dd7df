"""Chi-square beside its expectation: SciPy's law, and noise stated wrong by ten or a hundred in calibrations."""

from dataclasses import replace

import numpy as np
import pytest
from calibration_scene import CAMERA, make_scene
from scipy.stats import chi2

from calib import calibrate
from calib.fitting.misfit import UNTESTED, ChiSquare, chi_square_minimum, two_sided_quantile


@pytest.mark.parametrize("freedom", [1, 5, 400])
@pytest.mark.parametrize("part", [1e-3, 0.9])
def test_probability_is_two_sided(freedom, part):
    value = chi2.ppf(part, freedom)
    found = ChiSquare(value=value, degrees_of_freedom=freedom)
    assert found.probability == pytest.approx(2 * min(part, 1 - part), rel=1e-6)
    assert found.ratio == pytest.approx(np.sqrt(value / freedom))


def test_right_noise_gets_a_note_once_in_a_thousand_fits():
    """5000 fits of 8 degrees of freedom: 5 notes expected, 15 would be 4.5 sigma."""
    draws = chi2.rvs(8, size=5000, random_state=3)
    assert sum(bool(ChiSquare(value=value, degrees_of_freedom=8).note) for value in draws) < 15


def test_nothing_is_said_where_nothing_is_tested():
    assert not UNTESTED.tested
    for freedom, value in ((0, 7.0), (-2, 7.0), (4, np.inf)):
        found = ChiSquare(value=value, degrees_of_freedom=freedom)
        assert not found.note
        assert np.isnan(found.probability)
        assert str(found) == "chi-square not tested"


@pytest.mark.parametrize("wrong", [0.1, 1.0, 10.0])
@pytest.mark.parametrize("method", ["free", "acc", "angles", "weighted angles", "robust free", "robust angles"])
def test_calibrations_say_that_the_stated_noise_is_wrong(method, wrong):
    """Stars scatter by 0.05 px and are said to scatter by 0.05 px times a factor."""
    scene = make_scene(frames=12, stars=15)
    stars = scene.noisy(np.random.default_rng(2))
    stars = replace(stars, covariance_px2=stars.covariance_px2 * wrong**2)
    family = scene.family(method.removeprefix("robust "))
    loss = "tukey" if method.startswith("robust") else "linear"
    solution = calibrate(stars, CAMERA, family, loss=loss).solution
    text = f"{solution.message} {solution!r}"
    if wrong == 1.0:
        assert solution.converged
        assert "stated" not in text
        assert solution.misfit.probability > 1e-3
    elif wrong < 1.0:
        assert "stated too small" in text or (solution.status == "refused" and "times the stated sigma" in text)
    else:
        assert "stated too large" in solution.message
        assert "stated too large" in repr(solution)


def test_minimum_of_a_parabola_and_published_quantiles():
    """chi-square 1000 + (x - 45)^2 / 10 of 1000 degrees of freedom: sigma is sqrt(10)."""
    value = np.array([20.0, 58.0, 90.0])
    assert chi_square_minimum(value, 1000 + 0.1 * (value - 45.0) ** 2, 1000) == pytest.approx((45.0, np.sqrt(10.0)))
    assert np.isnan(chi_square_minimum(value, -(value**2), 10)).all()
    assert two_sided_quantile(0.05) == pytest.approx(1.959964, abs=1e-6)
    assert two_sided_quantile(0.05, 4) == pytest.approx(2.776, abs=5e-4)
