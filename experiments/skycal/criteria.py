"""What has to hold for a calibration under the sky to count as passed."""

from __future__ import annotations

import numpy as np
from scipy.stats import norm

from experiments.harness.quantities import Outcome
from experiments.harness.summary import Criterion

__all__ = ["criteria"]

LEAST_PROBABILITY = 1e-3
"""A noise map may be as unlikely as this; with four of them one seed in 250 fails."""
WRONG_LIMIT = 1e-3
FALSE_ALARM = 1e-3
"""Probability that the farthest attitude of a camera fails although all is well (Bonferroni)."""
MOVED_LIMIT, RESIDUAL_OFF_PX = 1e-3, 1e-6
FOCAL_LIMIT = 2e-3
"""Defocus and the light's colours move the scale by some 5e-4."""
ROBUST, TOO_MANY = 1, 2
"""Trials with wrong matches put in: the robust fit with the configured part of them, and with far too many."""


def criteria(outcome: Outcome) -> list[Criterion]:
    """Of every camera: matches, convergence, noise maps, the noiseless map, wrong matches."""
    return [one for name, lens in outcome.labels("camera").items() for one in _of_camera(outcome, name, f"{lens} lens")]


def _of_camera(outcome: Outcome, name: str, title: str) -> list[Criterion]:
    camera = {"camera": name}
    counting = [
        outcome.value(f"{data}_status", method=method, **camera)
        for data in ("measured", "corrected")
        for method in ("free", "linked")
    ]
    predicted = outcome.value("measured_predicted_arcsec", method="free", **camera).value
    model = outcome.value("camera_model", **camera)
    robust, hopeless = (
        {part: outcome.value(f"wrong_{part}", trial=trial, **camera) for part in ("fraction", "status", "apart_arcsec")}
        for trial in (ROBUST, TOO_MANY)
    )
    matched = outcome.value("detections", outcome="used", **camera)
    return [
        *_independent(outcome, name, title),
        Criterion(
            name=f"{title}: wrong matches among the stars calibrated with, part of them",
            value=outcome.value("wrong_matches", **camera) / matched,
            limit=WRONG_LIMIT,
        ),
        Criterion(
            name=f"{title}: calibrations from poor start values that did not converge, of {len(counting)}",
            value=float(sum(status != "converged" for status in counting)),
            limit=0.0,
        ),
        *(
            Criterion(
                name=f"{title}: probability of such a noise map under its predicted covariance, {attitudes}",
                value=outcome.value(quantity, **camera),
                limit=LEAST_PROBABILITY,
                relation=">=",
            )
            for quantity, attitudes in (
                ("noise_map_probability", "free attitudes"),
                ("linked_map_probability", "with the gyro"),
            )
        ),
        Criterion(
            name=f"{title}: error of noiseless stars, against the model's own limit plus the predicted uncertainty",
            value=outcome.value("part_rms_arcsec", part="mismatch", **camera),
            limit=outcome.value(f"{name}_model_direct_arcsec", **{f"{name}_model": model}) + predicted,
            unit="arcsec",
        ),
        Criterion(
            name=f"{title}: how far {100 * robust['fraction']:.0f} % wrong matches move the map, against its "
            "uncertainty",
            value=robust["apart_arcsec"] if robust["status"] == "converged" else float("nan"),
            limit=predicted,
            unit="arcsec",
        ),
        Criterion(
            name=f"{title}: calibrations accepted with {100 * hopeless['fraction']:.0f} % wrong matches",
            value=float(hopeless["status"] == "converged"),
            limit=0.0,
        ),
    ]


def _independent(outcome: Outcome, name: str, title: str) -> list[Criterion]:
    """By equations written out apart from simulation and estimator, and by known moves."""

    def value(what: str) -> float:
        return float(outcome.values(what, camera=name))

    count = outcome.result.cameras[name].evaluation.check.attitudes
    made = [
        Criterion(
            name=f"{title}: attitudes against the commanded motion put together anew, farthest of {count}",
            value=value("attitude_off_sigma"),
            limit=float(norm.isf(FALSE_ALARM / (2 * count))),
            unit="sigma",
        ),
        Criterion(
            name=f"{title}: stars and sky moved by known amounts, part that did not come back",
            value=value("moved_part"),
            limit=MOVED_LIMIT,
        ),
    ]
    if np.isfinite(value("focal_ratio")):  # a Brown-Conrady model
        what = f"{title}: residuals against ACF17 eq. 3 and 4 and quaternions written out, largest"
        made.append(Criterion(name=what, value=value("residual_off_px"), limit=RESIDUAL_OFF_PX, unit="px"))
        what = f"{title}: calibrated focal length over the paraxial one of the prescription"
        made.append(Criterion(name=what, value=value("focal_ratio"), about=1.0, limit=FOCAL_LIMIT))
    return made
