"""Solutions and calibrations: statistics of a fit, and the shapes they insist on."""

import numpy as np

from calib.fitting.solution import Solution


def solution(**change):
    values = {
        "value": [1.0, 2.0, 3.0],
        "names": ("a_px", "b_px", "c_mm"),
        "covariance": np.diag([0.25, 0.0, np.inf]),
        "status": "converged",
        "message": "",
        "iterations": 4,
        "chi2": 12.0,
        "degrees_of_freedom": 6,
        "condition": 10.0,
        "residual_pulls": np.zeros(9),
        "robust_weight": np.ones(9),
    }
    return Solution(**(values | change))


def test_pulls_are_errors_over_their_sigma_and_unknown_without_one():
    pulls = solution().pulls([0.0, 2.0, 3.0])
    assert pulls[0] == 2.0
    assert np.isnan(pulls[1:]).all()
    np.testing.assert_array_equal(solution().sigma, [0.5, 0.0, np.inf])
    assert solution().index("c_mm") == 2
    assert solution().reduced_chi2 == 2.0
    assert np.isnan(solution(degrees_of_freedom=0).reduced_chi2)
    assert solution().converged
    assert not any(solution(status=s).converged for s in ("stalled", "iteration_limit", "singular", "refused"))


def test_misfit_of_correlated_terms_has_their_own_degrees_of_freedom():
    """12 for 6, of which 3 are independent: 6 for 3; none, where no noise was stated or nothing is left."""
    tested = [solution(independent=n).misfit for n in (None, 3)]
    assert [(one.value, one.degrees_of_freedom) for one in tested] == [(12.0, 6), (6.0, 3)]
    for untested in (solution(independent=0), solution(degrees_of_freedom=-2), solution(independent=-1)):
        assert untested.misfit.degrees_of_freedom == 0
        assert not untested.misfit.tested
