"""Chi-square at one standard deviation: one for a linear problem, in closed form for a parabola."""

import numpy as np
import pytest

from calib.fitting.least_squares import DenseProblem
from calib.fitting.linearity import chi_square_rise

SIGMA = 0.3


def parabola(bend, names=("slope",)):
    """One measurement of a + bend a^2, exact at a = 0.5."""
    measured = 0.5 + bend * 0.25
    return DenseProblem(
        lambda a: (a + bend * a**2 - measured) / SIGMA,
        lambda a: np.diag(1.0 + 2.0 * bend * a) / SIGMA,
        names,
        np.full(len(names), 0.5),
    )


@pytest.mark.parametrize("bend", [0.0, 0.4, 3.0])
def test_rise_of_a_parabola(bend):
    """With the derivative D = 1 + 2 bend a, sigma_a = SIGMA / D and the rise is 1 + (bend sigma_a^2 / SIGMA)^2."""
    rise, names = chi_square_rise(parabola(bend), np.array([0.5]), np.ones(1))
    sigma = SIGMA / (1.0 + bend)
    assert rise == pytest.approx(1.0 + (bend * sigma**2 / SIGMA) ** 2)
    assert names == ["slope"]


def test_an_unknown_without_effect_has_no_rise():
    problem = DenseProblem(lambda a: a[:1] - 1.0, lambda a: np.array([[1.0, 0.0]]), ("seen", "lost"), np.zeros(2))
    rise, names = chi_square_rise(problem, np.array([1.0, 0.0]), np.ones(1))
    assert np.isnan(rise)
    assert names == []
