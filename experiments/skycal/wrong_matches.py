"""Wrong matches put in on purpose: what the robust loss survives, and what it has to refuse."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from calib.calibration.calibrate import calibrate
from calib.calibration.free_attitudes import FreeAttitudes
from experiments.skycal.calibrate import LOSS, CalibratedMap, Calibrator, rms, start_camera
from render.engine.random import Streams

__all__ = ["TOO_MANY", "WrongMatchFit", "wrong_match_fits"]

TOO_MANY = 0.6
"""Part of wrong matches that nothing should survive."""
NO_WEIGHT = 0.05


@dataclass(frozen=True, slots=True, kw_only=True)
class WrongMatchFit:
    """A calibration with wrong matches put in."""

    loss: str  # Loss of the fit
    fraction: float  # Part of the matches that are wrong
    status: str  # Of the fit; "converged" says that its values may be used
    rms_arcsec: float  # Error of the map; NaN where the fit gives none
    apart_arcsec: float  # RMS distance from the map without wrong matches
    caught_fraction: float  # Part of the wrong matches that got (almost) no weight


def wrong_match_fits(calibrator: Calibrator, clean: CalibratedMap, streams: Streams) -> tuple[WrongMatchFit, ...]:
    """Least squares and robust with the configured part of wrong matches, and robust with far too many."""
    fraction = calibrator.config.wrong_fraction
    cases = ((fraction, "linear"), (fraction, LOSS), (TOO_MANY, LOSS))
    return tuple(_run(calibrator, clean, streams, part, loss) for part, loss in cases)


def _run(calibrator: Calibrator, clean: CalibratedMap, streams: Streams, fraction: float, loss: str) -> WrongMatchFit:
    stars = calibrator.observations(clean.data)
    rng = streams.child("wrong matches", f"{fraction:g}").generator("which")
    chosen = np.sort(rng.permutation(len(stars))[: round(fraction * len(stars))])
    names = np.arange(len(stars))
    for frame in range(stars.frames):  # stars of one frame exchange their names
        mine = chosen[stars.frame[chosen] == frame]
        names[mine] = np.roll(mine, 1)
    mixed = replace(stars, direction=stars.direction[names], star=stars.star[names])
    start, free = start_camera(calibrator.scene, calibrator.config, clean.model)
    made = calibrate(mixed, start, FreeAttitudes(), loss=loss, free=free)
    found = calibrator.compare(made, method="free", model=clean.model, data=clean.data)
    wrong, weight = names != np.arange(len(stars)), made.solution.robust_weight
    caught = float(np.mean(weight[wrong] < NO_WEIGHT)) if len(weight) == len(stars) and wrong.any() else float("nan")
    return WrongMatchFit(
        loss=loss,
        fraction=float(np.mean(wrong)),
        status=made.solution.status,
        rms_arcsec=found.rms_arcsec,
        apart_arcsec=rms(found.error_arcsec - clean.error_arcsec),
        caught_fraction=caught,
    )
