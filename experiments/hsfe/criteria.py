"""What has to hold for a step test to count as passed."""

from __future__ import annotations

import numpy as np

from experiments.harness.quantities import Outcome
from experiments.harness.summary import Criterion, farthest_from_one

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
                name=f"{method}: causes and noise in quadrature over everything together",
                value=farthest_from_one(outcome.values("quadrature_arcsec", method=method) / number),
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
    return found
