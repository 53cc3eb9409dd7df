"""The least-squares core on problems with known answers, and beside scipy.optimize.least_squares."""

import numpy as np
import pytest
from scipy.optimize import least_squares

from calib.fitting.least_squares import DenseProblem, solve

# NIST StRD nonlinear regression, Misra1a: data, both starts, and the certified values
MISRA_X = np.array([77.6, 114.9, 141.1, 190.8, 239.9, 289.0, 332.8, 378.4, 434.8, 477.3, 536.8, 593.1, 689.1, 760.0])
MISRA_Y = np.array([10.07, 14.73, 17.94, 23.93, 29.61, 35.18, 40.02, 44.82, 50.76, 55.05, 61.01, 66.40, 75.47, 81.78])


def misra(scale=1.0):
    """y = b1 (1 - exp(-b2 x)), b2 in units of ``scale``."""

    def residuals(b):
        return b[0] * (1 - np.exp(-b[1] * scale * MISRA_X)) - MISRA_Y

    def jacobian(b):
        e = np.exp(-b[1] * scale * MISRA_X)
        return np.column_stack([1 - e, b[0] * MISRA_X * scale * e])

    return residuals, jacobian


@pytest.mark.parametrize("start", [(500.0, 1e-4), (250.0, 5e-4)])
def test_certified_regression(start):
    fit = solve(DenseProblem(*misra(), ("b1", "b2"), start), np.array(start), tolerance=1e-10).solution
    assert fit.converged
    error = (fit.value - [2.3894212918e2, 5.5015643181e-4]) / [2.7070075241, 7.2668688436e-6]
    assert np.abs(error).max() < 2e-6  # standard deviations; the cost is flat within 1e-12 over 1e-6
    assert fit.chi2 == pytest.approx(1.2455138894e-1, rel=1e-9)
    assert fit.degrees_of_freedom == 12
    certified = np.array([2.7070075241, 7.2668688436e-6])  # standard deviations, residual variance estimated
    np.testing.assert_allclose(fit.sigma * np.sqrt(fit.reduced_chi2), certified, rtol=1e-6)


def test_units_make_no_difference():
    plain = solve(DenseProblem(*misra(), ("b1", "b2"), (500.0, 1e-4)), np.array([500.0, 1e-4])).solution
    huge = solve(DenseProblem(*misra(1e-12), ("b1", "b2"), (500.0, 1e8)), np.array([500.0, 1e8])).solution
    assert huge.iterations == plain.iterations
    assert huge.value[1] * 1e-12 == pytest.approx(plain.value[1], rel=1e-9)
    assert huge.condition == pytest.approx(plain.condition, rel=1e-6)


def wavy(rng, outliers):
    """A damped wave with gross errors."""
    x = np.linspace(0, 10, 200)
    truth = np.array([2.0, 0.3, 1.5])
    y = truth[0] * np.exp(-truth[1] * x) * np.sin(truth[2] * x) + rng.normal(0, 0.05, x.size)
    y[:outliers] += rng.choice([-1.0, 1.0], outliers) * rng.uniform(1.0, 3.0, outliers)

    def residuals(b):
        return (b[0] * np.exp(-b[1] * x) * np.sin(b[2] * x) - y) / 0.05

    def jacobian(b):
        e, s, c = np.exp(-b[1] * x), np.sin(b[2] * x), np.cos(b[2] * x)
        return np.column_stack([e * s, -b[0] * x * e * s, b[0] * x * e * c]) / 0.05

    return residuals, jacobian


@pytest.mark.parametrize(("loss", "tuning"), [("linear", 1.0), ("huber", 1.501), ("soft_l1", 1.309), ("cauchy", 2.549)])
def test_same_minimum_as_scipy(loss, tuning):
    """scipy's losses are the same functions with f_scale = c."""
    residuals, jacobian = wavy(np.random.default_rng(2), 20)
    start = np.array([1.8, 0.25, 1.45])
    ours = solve(DenseProblem(residuals, jacobian, ("a", "b", "c"), start), start, loss=loss).solution
    theirs = least_squares(
        residuals, start, jac=jacobian, loss=loss, f_scale=tuning, xtol=1e-14, ftol=1e-14, gtol=1e-14
    )
    assert ours.converged
    np.testing.assert_allclose(ours.value, theirs.x, atol=1e-4 * ours.sigma.min())


def test_redescending_loss_forgets_gross_errors():
    clean, jacobian = wavy(np.random.default_rng(2), 0)
    start = np.array([1.9, 0.28, 1.49])
    reference = solve(DenseProblem(clean, jacobian, ("a", "b", "c"), start), start).solution
    residuals, jacobian = wavy(np.random.default_rng(2), 20)
    fit = solve(DenseProblem(residuals, jacobian, ("a", "b", "c"), start), start, loss="tukey").solution
    assert np.all(fit.robust_weight[:20] == 0)
    assert fit.degrees_of_freedom == np.count_nonzero(fit.robust_weight) - 3
    # 20 of 200 points are gone, the first fifth of the wave with them: a few sigma of the full fit at most
    assert np.abs((fit.value - reference.value) / fit.sigma).max() < 2.5


def test_fixed_parameters_stay():
    problem = DenseProblem(*misra(), ("b1", "b2"), (240.0, 5e-4), free=("b2",))
    fit = solve(problem, problem.start)
    assert fit.solution.names == ("b2",)
    assert fit.state[0] == 240.0
    theirs = least_squares(lambda b: misra()[0]([240.0, b[0] * 1e-4]), [5.0], xtol=1e-15, ftol=1e-15, gtol=1e-15)
    assert fit.solution.value[0] == pytest.approx(theirs.x[0] * 1e-4, rel=1e-9)


def test_what_the_data_do_not_determine_is_named():
    rows = np.random.default_rng(0).standard_normal((30, 3))
    rows[:, 2] = rows[:, 1]
    y = rows @ [1.0, 2.0, 3.0]
    problem = DenseProblem(lambda b: rows @ b - y, lambda b: rows, ("a", "b", "c"), np.zeros(3))
    fit = solve(problem, problem.start).solution
    assert fit.status == "singular"
    assert fit.message.startswith("not determined by these data: b, c (free to change together by ")
    assert fit.value[0] == pytest.approx(1.0)
    assert fit.value[1] + fit.value[2] == pytest.approx(5.0)
    np.testing.assert_array_equal(np.isinf(fit.sigma), [False, True, True])
    assert fit.condition == np.inf


def test_status_of_fits_that_do_not_converge():
    problem = DenseProblem(
        lambda b: np.array([b[0] - 1.0, b[1] ** 2 + 3.0]), lambda b: -np.eye(2), ("a", "b"), (5.0, 5.0)
    )
    fit = solve(problem, problem.start).solution
    assert fit.status == "stalled"
    problem = DenseProblem(*misra(), ("b1", "b2"), (500.0, 1e-4))
    fit = solve(problem, problem.start, max_iterations=2).solution
    assert fit.status == "iteration_limit"
    assert fit.iterations == 2
    problem = DenseProblem(lambda b: np.array([np.nan, b[0]]), lambda b: np.ones((2, 1)), ("a",), (1.0,))
    fit = solve(problem, problem.start).solution
    assert fit.status == "refused"
    assert "outside the domain" in fit.message
    assert np.isinf(fit.sigma).all()
    assert fit.chi2 == np.inf


def test_steps_do_not_leave_the_domain():
    """log b: the full first step would go to a negative b."""

    def residuals(b):
        return np.array([np.log(b[0]) - np.log(1e-3)]) if b[0] > 0 else np.array([np.nan])

    problem = DenseProblem(residuals, lambda b: np.array([[1.0 / b[0]]]), ("b",), (10.0,))
    fit = solve(problem, problem.start).solution
    assert fit.converged
    assert fit.value[0] == pytest.approx(1e-3)
