"""Whether the frames confirm the prediction; whether the sensor is good enough is another question (`verdicts`)."""

from __future__ import annotations

import numpy as np
from scipy.stats import chi2, norm

from experiments.camera.confirmation import compare
from experiments.camera.records import CameraPrediction
from experiments.camera.rendered import Rendered
from experiments.harness.quantities import Outcome
from experiments.harness.summary import Criterion

__all__ = ["criteria", "frame_criteria"]


ALARM = 1e-3
"""Probability that a criterion fails although everything is right."""
MODEL_SHARE = 0.03
"""What the prediction leaves out may make of the NEA: fields between five, PSFs in cells, a linear response."""
MODEL_MAG = 0.05


def criteria(outcome: Outcome) -> list[Criterion]:
    """Light, noise, detection, false alarms, stars and attitudes of the frames against their prediction."""
    result = outcome.result
    return [] if result.rendered is None else frame_criteria(result.prediction, result.rendered)


def frame_criteria(prediction: CameraPrediction, rendered: Rendered, *, looks: int = 1) -> list[Criterion]:
    """Criteria on the frames of one sensor."""
    compared = {one.name: one for one in compare(prediction, rendered)}
    alarm = ALARM / looks
    limit = float(norm.isf(alarm / 2.0))
    light, noise, faint = compared["electrons"], compared["nea"], compared["limiting_magnitude"]
    allowed = limit * noise.error / noise.predicted + MODEL_SHARE
    found = [
        Criterion(
            name="electrons of a star, rendered over predicted",
            value=light.measured / light.predicted,
            about=1.0,
            limit=2e-3,
            advice="the pupil of the lens is found in two ways that differ: look at its apertures",
        ),
        Criterion(
            name="NEA, scatter of readouts over prediction",
            value=noise.measured / noise.predicted,
            about=1.0,
            limit=round(allowed, 4),
            advice="the centroider does not follow its linear response: too faint a star, too small a window",
        ),
        Criterion(
            name="limiting magnitude, from the share of chart stars that are found",
            value=faint.measured,
            about=round(faint.predicted, 3),
            limit=round(limit * faint.error + MODEL_MAG, 3),
            unit="mag",
        ),
    ]
    for name, words in (("false_alarms", "false alarms"), ("stars", "stars found in the sky")):
        found.append(
            Criterion(
                name=f"{words}: {compared[name].measured:.0f} counted, {compared[name].predicted:.1f} predicted",
                value=abs(compared[name].pull),
                limit=round(limit, 2),
                unit="sigma",
            )
        )
    return [*found, *_attitudes(prediction, rendered, alarm)]


def _attitudes(prediction: CameraPrediction, rendered: Rendered, alarm: float) -> list[Criterion]:
    """Sum of the squared errors over their predicted variances: chi-square of as many degrees of freedom."""
    sky, forecast = rendered.sky, prediction.attitude
    ratio = sky.error_arcsec / forecast.total_arcsec[: len(sky.error_arcsec)]
    solved = np.isfinite(ratio).all(axis=1)
    enough = forecast.stars[: len(ratio)] >= FEWEST_STARS
    found = [
        Criterion(
            name=f"frames of the sky with {FEWEST_STARS} stars or more that are not solved",
            value=float(np.count_nonzero(enough & ~solved)),
            limit=0.0,
        )
    ]
    for columns, words in ((slice(0, 2), "across"), (slice(2, 3), "roll")):
        squares = ratio[solved][:, columns] ** 2
        if not squares.size:
            continue
        chance = float(chi2.sf(squares.sum(), squares.size))
        found.append(
            Criterion(
                name=f"attitude {words}, chance of errors as large (or as small) as those of the frames",
                value=2.0 * min(chance, 1.0 - chance),
                limit=alarm,
                relation=">=",
            )
        )
    return found


FEWEST_STARS = 8
"""Fewer are not always told from chance."""
