"""What has to hold for a temporal-error test to count as passed; limits leave a chance of one in a hundred each."""

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
from experiments.laboratory.temporal_error import small_sample_factor

__all__ = ["criteria"]


def criteria(outcome: Outcome) -> list[Criterion]:
    """Measured against predicted at every level and at the signal of the source; the ePSF fit against its bound."""
    found = []
    for method in outcome.config.methods:
        pulls = (outcome.values("level_ratio", method=method) - 1.0) / outcome.errors("level_ratio", method=method)
        found.append(
            Criterion(
                name=f"{method}: measured against predicted over all levels, largest deviation",
                value=float(np.abs(pulls).max()),
                limit=two_sided_limit(pulls.size, 0.01),
                unit="sigma",
            )
        )
    first = outcome.config.methods[0]
    for axis in "xy":
        one = outcome.value("ratio", method=first, axis=axis)
        found.append(
            Criterion(
                name=f"{first}, {axis}: measured over predicted at the signal of the source",
                value=one.value,
                about=1.0,
                limit=max(0.1, 3.0 * (one.uncertainty or 0.0)),
            )
        )
    if "epsf" in outcome.config.methods:
        c4 = small_sample_factor(outcome.result.measured.frames)
        best = outcome.values("level_dark_arcsec", method="epsf") / (c4 * outcome.values("level_bound_arcsec"))
        spread = float(outcome.errors("level_ratio", method="epsf", axis="x").max())
        found.append(
            Criterion(
                name="ePSF fit over the Cramer-Rao bound, mean over levels and axes",
                value=float(best.mean()),
                about=1.0,
                limit=float(0.02 + 3.0 * spread / np.sqrt(best.size)),
            )
        )
    return [*found, *_end_to_end(outcome)]


def _end_to_end(outcome: Outcome) -> list[Criterion]:
    """By paths that share no equation with the reduction: a known motion, the printed equations, the light itself."""
    result, methods = outcome.result, outcome.config.methods
    found = [_shaken(outcome, method) for method in methods]
    nominal, stated = result.nominal.position_px, outcome.value("pixel_arcsec")
    printed = [as_printed.temporal_arcsec(nominal[method], stated) for method in methods]
    found.append(as_the_paper("temporal error of all centroiders", outcome.values("dark_arcsec"), printed, "arcsec"))
    found.append(pixel_angle(result.instrument))
    mean = {method: np.nanmean(nominal[method], axis=0) for method in methods}
    if result.sight is not None:
        found.append(line_of_sight_criterion(result.sight))
    still = 0.0 if result.sight is None else result.sight.between_px / np.sqrt(result.nominal.frames)
    return [*found, *centroids_on_the_light("", mean, result.nominal.light.photon_px, still)]


def _shaken(outcome: Outcome, method: str) -> Criterion:
    """The temporal error of a target that moves, against the motion in quadrature with the error at rest."""
    result = outcome.result
    shaken, light = result.shaken, result.nominal.light
    at_rest = outcome.values("drawn_arcsec", method=method)
    expected = np.hypot(shaken.motion_arcsec, at_rest)
    seen = np.array([one.value for one in shaken.te_arcsec(method)])
    # of each star's half distance: noise of the frames, and what pixels do to a place, which differs at the two places
    frames = at_rest / np.sqrt(sum(shaken.frames))
    apart = np.nanmean(result.nominal.position_px[method], axis=0) - light.photon_px
    pixels = 3.0 * shaken.pixel_arcsec * apart.std(axis=0, ddof=1) / np.sqrt(2.0)
    common = 0.0 if result.sight is None else 3.0 * shaken.pixel_arcsec * result.sight.between_px
    common /= np.sqrt(sum(shaken.frames))
    error = np.hypot(np.hypot(frames, pixels) / np.sqrt(len(light)), common) / expected
    motion = " and ".join(f"{value:.2f}″" for value in shaken.motion_arcsec)
    return Criterion(
        name=f"{method}: temporal error of a target that moves by {motion} (3 σ, x and y), over what that gives",
        value=farthest_from_one(seen / expected),
        about=1.0,
        limit=MOTION_RATIO + two_sided_limit(2) * float(error.max()),
    )
