"""Wrong matches put in on purpose: what the robust loss survives, and what it has to refuse."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from calib.calibration.calibrate import calibrate
from calib.calibration.free_attitudes import FreeAttitudes
from experiments.skycal.calibrate import LOSS, Bench, Judged, rms, start_camera

if TYPE_CHECKING:
    from render.engine.random import Streams

__all__ = ["TOO_MANY", "WrongRun", "wrong_runs"]

TOO_MANY = 0.6
"""Part of wrong matches that nothing should survive."""
NO_WEIGHT = 0.05


@dataclass(frozen=True, slots=True, kw_only=True)
class WrongRun:
    """A calibration with wrong matches put in.

    Attributes
    ----------
    loss : str
        Loss of the fit.
    fraction : float
        Part of the matches that are wrong.
    status, message : str
        Of the fit.
    rms_arcsec : float
        Error of the map; NaN where the fit gives none.
    apart_arcsec : float
        RMS distance from the map without wrong matches.
    caught_fraction : float
        Part of the wrong matches that got (almost) no weight.
    """

    loss: str
    fraction: float
    status: str
    message: str
    rms_arcsec: float
    apart_arcsec: float
    caught_fraction: float

    @property
    def accepted(self) -> bool:
        """Whether the fit says that its values may be used."""
        return self.status == "converged"


def wrong_runs(bench: Bench, clean: Judged, streams: Streams) -> tuple[WrongRun, ...]:
    """Least squares and robust with the configured part of wrong matches, and robust with far too many.

    Parameters
    ----------
    bench : Bench
        Stars and truth.
    clean : Judged
        The same without wrong matches.
    streams : Streams
        Which matches are made wrong.
    """
    fraction = bench.config.wrong_fraction
    cases = ((fraction, "linear"), (fraction, LOSS), (TOO_MANY, LOSS))
    return tuple(_run(bench, clean, streams, part, loss) for part, loss in cases)


def _run(bench: Bench, clean: Judged, streams: Streams, fraction: float, loss: str) -> WrongRun:
    stars = bench.observations(clean.data)
    rng = streams.child("wrong matches", f"{fraction:g}").generator("which")
    chosen = np.sort(rng.permutation(len(stars))[: round(fraction * len(stars))])
    names = np.arange(len(stars))
    for frame in range(stars.frames):  # stars of one frame exchange their names
        mine = chosen[stars.frame[chosen] == frame]
        names[mine] = np.roll(mine, 1)
    mixed = replace(stars, direction=stars.direction[names], star=stars.star[names])
    start, free = start_camera(bench.scene, bench.config, clean.model)
    made = calibrate(mixed, start, FreeAttitudes(), loss=loss, free=free)
    found = bench.judge(made, method="free", model=clean.model, data=clean.data)
    wrong, weight = names != np.arange(len(stars)), made.solution.robust_weight
    caught = float(np.mean(weight[wrong] < NO_WEIGHT)) if len(weight) == len(stars) and wrong.any() else float("nan")
    return WrongRun(
        loss=loss,
        fraction=float(np.mean(wrong)),
        status=made.solution.status,
        message=made.solution.message,
        rms_arcsec=found.rms_arcsec,
        apart_arcsec=rms(found.error_arcsec - clean.error_arcsec),
        caught_fraction=caught,
    )
