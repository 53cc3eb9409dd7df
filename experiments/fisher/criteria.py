"""What has to hold for a run to count as passed."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.stats import norm, t

from experiments.fisher.coverage import LEVELS
from experiments.fisher.independent import LEVEL
from experiments.harness.quantities import Outcome
from experiments.harness.summary import Criterion

__all__ = ["criteria"]

FALSE_ALARM = 1e-3
"""Probability that a criterion on many numbers fails although all is well (Bonferroni)."""
PRECISION_AT_ARCSEC = 0.1
PRECISION_LIMIT = 1e-6
SAME_VECTORS_LIMIT = 5e-4
SIGMA_LIMIT = 3.0
WRITTEN_OUT_LIMIT = 1e-5
"""Rounding of the unit vectors, 1e-16 of 1 - R = 1e-12 to 1e-11."""
CONE_LIMIT = 1e-6
KNOWN_SIGMAS = 3.29
"""0.1 %, two-sided, of one test."""


def criteria(outcome: Outcome) -> list[Criterion]:
    """The rendered bench against predictions, the studies against closed forms."""
    return [*_of_the_bench(outcome), *_on_coordinates(outcome), *_independent(outcome)]


def _of_the_bench(outcome: Outcome) -> list[Criterion]:
    result, names = outcome.result, outcome.names("acquisition")
    lost = sum(case.acquisition.lost for case in result.bench.cases) + int(outcome.values("same_data_lost").sum())
    ratio = outcome.values("baseline_over_fisher") / outcome.values("baseline_over_fisher_predicted")
    return [
        Criterion(name="places without a position, calibrations without convergence", value=lost, limit=0),
        *(
            Criterion(
                name=f"{name}: scatter of the star vectors against the prediction from covariances",
                value=abs(outcome.value("z_score", acquisition=name)),
                limit=SIGMA_LIMIT,
                unit="σ",
            )
            for name in names
        ),
        *(
            Criterion(
                name=f"{name}: pixel method over Fisher, against what lens and noise predict",
                value=abs(float(ratio[n]) - 1.0),
                limit=_ratio_limit(outcome, n),
            )
            for n, name in enumerate(names)
        ),
        Criterion(
            name="static, calibrated with its own data: scatter against the prediction",
            value=abs(outcome.value("same_data_rendered_z_score")),
            limit=SIGMA_LIMIT,
            unit="σ",
        ),
    ]


def _independent(outcome: Outcome) -> list[Criterion]:
    """By paths that share no equation with simulation and reduction."""
    names = outcome.names("acquisition")
    found = {name: outcome.value(f"known_{name}") for name in ("variance", "cone", "held")}
    return [
        *(
            Criterion(
                name=f"{name}: σ by S300 to S500 written out from images and readings, over that found",
                value=float(outcome.value("written_out", acquisition=name)),
                about=1.0,
                limit=WRITTEN_OUT_LIMIT,
            )
            for name in names
        ),
        *(
            Criterion(
                name=f"{name}: mean star vector, written out, against the direction that was set, probability",
                value=float(outcome.value("mean_probability", acquisition=name)),
                limit=FALSE_ALARM / len(names),
                relation=">=",
            )
            for name in names
        ),
        Criterion(
            name="vectors of known noise: variance found over variance put in",
            value=found["variance"].value,
            about=1.0,
            limit=KNOWN_SIGMAS * found["variance"].uncertainty,
        ),
        Criterion(
            name=f"vectors of known noise: cone of {LEVEL:.0%} against its limit of small angles, relative",
            value=float(found["cone"]),
            limit=CONE_LIMIT,
        ),
        Criterion(
            name=f"vectors of known noise: cones of {LEVEL:.0%} that hold the true direction",
            value=found["held"].value,
            about=LEVEL,
            limit=KNOWN_SIGMAS * found["held"].uncertainty,
        ),
    ]


def _ratio_limit(outcome: Outcome, case: int) -> float:
    """Both methods take the same mean off; of a rolled camera they do not, which makes some 1/n of a difference.

    Where the angle per pixel changes over the field, the ratio scatters with the places of the large residuals.
    """
    one = outcome.result.bench.cases[case]
    places = one.acquisition.places
    rolled = places.true_rad.shape[1] > 2
    return (3.0 / len(places) if rolled else SAME_VECTORS_LIMIT) + KNOWN_SIGMAS * one.ratio_scatter


def _on_coordinates(outcome: Outcome) -> list[Criterion]:
    config = outcome.config
    same_limit = _t_limit(outcome.data.sizes["places"], config.same_data.runs)
    fisher = np.array([kind in ("fisher", "moderate") for kind in outcome.values("coverage_kind")])
    off = (outcome.values("covered") - np.array(LEVELS))[fisher] / outcome.errors("covered")[fisher]
    precise = outcome.values("digits_sigma_arcsec") >= PRECISION_AT_ARCSEC
    return [
        *(
            Criterion(
                name=name,
                value=_largest_pull(outcome, quantity, against),
                limit=_t_limit(outcome.data.sizes["field"], config.field.runs),
                unit="standard errors",
            )
            for name, quantity, against in (
                (
                    "bias of the pixel method against its closed form, all fields",
                    "baseline_bias_percent",
                    outcome.values("closed_form_percent"),
                ),
                ("Fisher against the truth, all fields", "fisher_bias_percent", 0.0),
                (
                    "noise isotropic in pixels: Fisher over pixel method against quadrature, all fields",
                    "pixel_noise_fisher_percent",
                    outcome.values("pixel_noise_quadrature_percent"),
                ),
            )
        ),
        Criterion(
            name=f"coverage of the {LEVELS[0]:.0%} and {LEVELS[1]:.0%} intervals, Fisher distribution",
            value=float(np.abs(off).max()) if off.size else float("nan"),
            limit=float(norm.isf(FALSE_ALARM / 2 / max(off.size, 1))),
            unit="standard errors",
        ),
        *(
            Criterion(
                name=name,
                value=_largest_pull(outcome, quantity, against),
                limit=same_limit,
                unit="standard errors",
            )
            for name, quantity, against in (
                (
                    "same data, 2n − unknowns degrees of freedom: variance against the truth",
                    "same_data_corrected",
                    1.0,
                ),
                (
                    "same data, 2(n − 1) degrees of freedom: variance against the prediction",
                    "same_data_naive",
                    outcome.values("same_data_predicted_naive"),
                ),
                (
                    "data of their own: variance against the prediction",
                    "same_data_independent",
                    outcome.values("same_data_predicted_independent"),
                ),
            )
        ),
        Criterion(
            name=f"concentration at {PRECISION_AT_ARCSEC:g}″ against 50 digits, relative",
            value=float(outcome.values("digits_chords")[precise].max()),
            limit=PRECISION_LIMIT,
        ),
    ]


def _largest_pull(outcome: Outcome, quantity: str, against: Any) -> float:
    """Largest distance of a quantity from what it should be, in standard errors."""
    return float(np.abs((outcome.values(quantity) - against) / outcome.errors(quantity)).max())


def _t_limit(tests: int, runs: int) -> float:
    return float(t.isf(FALSE_ALARM / 2 / max(tests, 1), max(runs - 1, 1)))
