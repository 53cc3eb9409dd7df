"""Verdicts on the terms of a flight: passed for ratios and slopes of 1, failed for others, absent for NaN."""

import math

import numpy as np
import pytest

from calib.accuracy.attitude_terms import TERMS
from experiments.flight.experiment import SECTIONS, axes
from experiments.flight.terms import AttitudeTerm
from experiments.harness.quantities import Outcome
from experiments.harness.sections import described, judged
from experiments.harness.summary import Measured

UNKNOWN = [Measured(value=math.nan, uncertainty=math.nan)] * 2


def criteria(ratio=1.0, slope=1.0):
    """Criteria for terms of equal ratio and slope, sigma 0.5 %; both NaN for the bias."""
    terms = []
    for name in (*TERMS, "total"):
        numbers = [[Measured(value=value, uncertainty=0.005, n=80)] * 2 for value in (ratio, slope)]
        ratios, slopes = numbers if name != "bias" else (UNKNOWN, UNKNOWN)
        slopes = slopes if name in ("thermo_elastic", "fov_spatial", "aberration") else UNKNOWN
        size = [Measured(value=1.0, unit="arcsec", uncertainty=0.02, n=80)] * 2
        terms.append(
            AttitudeTerm(term=name, measured_arcsec=size, predicted_arcsec=np.ones(2), ratio=ratios, slope=slopes)
        )
    sections = {"terms": SECTIONS["terms"]}
    data = described(sections, axes(None), {"terms": terms}).dataset
    return judged(sections, Outcome(config=None, result={"terms": terms}, data=data))


@pytest.mark.parametrize(
    ("wrong", "failed"), [({}, 0), ({"ratio": 1.13}, 2), ({"ratio": 1.5}, 12), ({"slope": -1.0}, 6)]
)
def test_verdicts_of_every_known_term_and_component(wrong, failed):
    """A ratio of 1.13 fails the total alone (limit 10 %), 1.5 fails all six terms with a ratio."""
    verdicts = criteria(**wrong)
    assert len(verdicts) == 18
    assert sum(verdict.failed for verdict in verdicts) == failed
