"""Sums of ACC18 eq. 31-32 against the printed ones, and their uncertainties against drawn terms."""

from __future__ import annotations

import numpy as np
import pytest

from calib.accuracy.error_budget import TERMS, ErrorTerm, combine

PRINTED_TERMS = [(1.14, 1.23), (1.08, 1.01), (0.03, 0.66), (0.29, 0.41), (0.5, 0.5)]
PRINTED = {"LSFE": (0.91, 1.12), "total": (1.76, 1.95), "attitude": (0.56, 0.62)}


def test_printed_terms_give_the_printed_sums_but_for_the_slip():
    made = combine(
        {name: ErrorTerm(arcsec=np.array(pair)) for name, pair in zip(TERMS, PRINTED_TERMS, strict=True)}, stars=10
    )
    for name in ("total", "attitude"):
        np.testing.assert_allclose(made[name].arcsec, PRINTED[name], atol=0.0051)
    assert made.lsfe.arcsec[1] == pytest.approx(PRINTED["LSFE"][1], abs=0.0051)
    assert made.lsfe.arcsec[0] == pytest.approx(0.79, abs=0.0051)  # the printed 0.91 is 0.41 + 0.50
    assert abs(made.lsfe.arcsec[0] - PRINTED["LSFE"][0]) > 0.1


def test_uncertainty_of_the_sums_is_that_of_drawn_terms():
    rng = np.random.default_rng(1)
    size = {"TE": 1.1, "HSFE": 0.9, "LSFE-S": 0.4, "LSFE-C1": 0.3, "LSFE-C2": 0.5}
    spread = {"TE": 0.02, "HSFE": 0.03, "LSFE-S": 0.01, "LSFE-C1": 0.02, "LSFE-C2": 0.0}
    terms = {n: ErrorTerm(arcsec=np.full(2, size[n]), uncertainty_arcsec=np.full(2, spread[n])) for n in TERMS}
    made = combine(terms, stars=4)
    count = 20_000
    totals, lows = [], []
    for _ in range(count // 10):
        drawn = {n: ErrorTerm(arcsec=size[n] + spread[n] * rng.standard_normal(2)) for n in TERMS}
        one = combine(drawn, stars=4)
        totals.append(one.total.arcsec)
        lows.append(one.lsfe.arcsec)
    tolerance = 5.0 / np.sqrt(2.0 * count / 5)  # two columns
    assert np.std(totals) == pytest.approx(made.total.uncertainty_arcsec[0], rel=tolerance)
    assert np.std(lows) == pytest.approx(made.lsfe.uncertainty_arcsec[0], rel=tolerance)
    np.testing.assert_allclose(made.attitude.arcsec, made.total.arcsec / 2.0)
