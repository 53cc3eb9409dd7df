"""What has to hold for a step test to count as passed."""

from __future__ import annotations

import numpy as np

from experiments.harness.quantities import Outcome
from experiments.harness.summary import Criterion, farthest_from_one
from experiments.laboratory import as_printed
from experiments.laboratory.collimator_effects import line_of_sight_criterion
from experiments.laboratory.criteria import (
    MOTION_RATIO,
    as_the_paper,
    centroids_on_the_light,
    pixel_angle,
    two_sided_limit,
)

__all__ = ["criteria"]

SIGMA_LIMIT = 4.0
"""Of two axes, two predictions and several methods the largest deviation counts."""
MODEL_RATIO = 0.03
"""What the linear model may be off: a threshold smooths the S-curve under noise by about this much."""


def criteria(outcome: Outcome) -> list[Criterion]:
    """Measured against predicted, parts against the whole, S-curves against those of the PSF, motion against rays."""
    found = []
    for method in outcome.config.methods:
        number = outcome.values("document_arcsec", method=method)
        for label, name in (("the motion seen", "predicted_arcsec"), ("drawn paths", "predicted_before_arcsec")):
            expected, scatter = outcome.values(name, method=method), outcome.errors(name, method=method)
            spread = np.hypot(SIGMA_LIMIT * scatter, MODEL_RATIO * expected)
            found.append(
                Criterion(
                    name=f"{method}: document's figure against prediction for {label}, in units of what is allowed "
                    "(4 σ and 3 %)",
                    value=float(np.abs((number - expected) / spread).max()),
                    limit=1.0,
                )
            )
        found.append(
            Criterion(
                name=f"{method}: everything together over causes and noise in quadrature",
                value=farthest_from_one(number / outcome.values("quadrature_arcsec", method=method)),
                about=1.0,
                # cross terms of causes and noise have no mean but scatter as the figure itself does
                limit=MODEL_RATIO + SIGMA_LIMIT * float(outcome.errors("ratio", method=method).max()),
            )
        )
        if method != "epsf":
            seen, expected = (
                outcome.values(name, method=method, cause="s_curve")
                for name in ("alone_arcsec", "cause_predicted_arcsec")
            )
            found.append(
                Criterion(
                    name=f"{method}: S-curve of the rendered light over that of the sampled PSF",
                    value=farthest_from_one(seen / expected),
                    about=1.0,
                    limit=0.05,
                )
            )
    here = outcome.values("hexapod_label") == "this one"
    found.append(
        Criterion(
            name="true motion of the light after the mean over the stars is removed",
            value=float(outcome.values("motion_px").max()),
            limit=3.0 * float(outcome.values("left_px")[here].max()),
            unit="px",
        )
    )
    return [*found, *_end_to_end(outcome)]


def _end_to_end(outcome: Outcome) -> list[Criterion]:
    """By paths that share no equation with the reduction: a known motion, the printed equations, the light itself."""
    result, methods = outcome.result, outcome.config.methods
    found = [_walking(outcome, method) for method in methods]
    seen, stated = result.measured.mean_px["all"], outcome.value("pixel_arcsec")
    printed = [as_printed.high_frequency_arcsec(seen[method], stated) for method in methods]
    found.append(as_the_paper("HSFE of all centroiders", outcome.values("document_arcsec"), printed, "arcsec"))
    found.append(pixel_angle(result.instrument))
    still = 0.0
    if result.sight is not None:
        found.append(line_of_sight_criterion(result.sight))
        still = result.sight.between_px / np.sqrt(result.sight.frames)
    return [*found, *centroids_on_the_light("", seen, result.measured.photon_px, still)]


def _walking(outcome: Outcome, method: str) -> Criterion:
    """The document's figure of points that walk, against their own motion in quadrature with the figure at rest."""
    walking = outcome.result.walking
    at_rest = outcome.values("predicted_arcsec", method=method)
    expected = np.hypot(walking.walk_arcsec, at_rest)
    number = np.array([one.value for one in walking.measured.document_arcsec(method)])
    steps = walking.measured.photon_px.shape[1] * (walking.measured.photon_px.shape[0] - 1)
    # motion and error of a step have nothing in common, but the mean of their product scatters
    error = at_rest / np.sqrt(steps) / expected
    motion = " and ".join(f"{value:.2f}″" for value in walking.walk_arcsec)
    return Criterion(
        name=f"{method}: document's figure of points that step by {motion} each for itself, over what that gives",
        value=farthest_from_one(number / expected),
        about=1.0,
        limit=MOTION_RATIO + two_sided_limit(2) * float(error.max()),
    )
