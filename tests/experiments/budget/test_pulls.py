"""Predicted against measured over several chips: the subset of benchmarks/pulls.py that a test can afford."""

import runpy
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import chi2

PULLS = runpy.run_path(str(Path(__file__).resolve().parents[3] / "benchmarks" / "pulls.py"))
SEEDS = range(41, 43)
CHANCE = 1e-4


@pytest.fixture(scope="module")
def found(engine):
    """Pulls of two chips, by rays: what is judged is how noise and patterns scatter."""
    settings = ('compare=["epsf", "epsf_measured"]', "instrument.diffraction=rays")
    return [PULLS["pulls_of"](seed, settings) for seed in SEEDS]


@pytest.mark.slow
@pytest.mark.parametrize("method", ["cog", "epsf", "epsf_measured"])
@pytest.mark.parametrize("term", PULLS["TERMS"])
def test_pulls_are_those_of_right_uncertainties(found, method, term):
    """Rationale: chip and noise are drawn anew. Expected: sum of squares of chi-square, neither too large nor small."""
    pulls = np.ravel([one[method][term] for one in found])
    low, high = chi2.ppf([CHANCE, 1.0 - CHANCE], len(pulls))
    assert low < (pulls**2).sum() < high
    assert abs(pulls.mean()) < 4.0 / np.sqrt(len(pulls))
