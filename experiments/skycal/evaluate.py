"""What the line-of-sight error is made of.

The same stars, frames and weights are calibrated again and again, and one more error is switched on each time:

1. ``reference``: positions that stars of the reference colour would have, means of traced rays. What is left is what
   the camera model cannot describe: *camera model*.
2. ``light``: the light as it fell, every star in its own colour: *+ star colours*.
3. ``own``: centroids measured with the PSF of each star's own colour: *+ noise and pixels*.
4. ``measured``: centroids measured with the PSF of one colour, what a camera does by itself: *+ PSF of one colour*.

Each part is the difference of one map and the one before, so that they add up as vectors; whether their squares add up
depends on whether they are independent. ``corrected`` is ``own`` with the colour shift of every star taken off.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from experiments.skycal.calibrate import CalibratedMap, Calibrator, rms
from experiments.skycal.independent import Check, check_calibration
from experiments.skycal.match import Matched
from experiments.skycal.measure import Recording
from experiments.skycal.positions import STEPS, positions
from experiments.skycal.scene import Scene
from experiments.skycal.settings import Config
from experiments.skycal.truth import Chart, trace_chart
from experiments.skycal.wrong_matches import WrongMatchFit, wrong_match_fits
from optics.arrays import FloatArray
from optics.errors import DomainError
from render.engine.random import Streams

__all__ = ["PARTS", "Evaluation", "evaluate"]


PARTS = ("mismatch", "chromatic", "noise", "psf")
"""What each step adds: camera model, star colours, noise and pixels, PSF of one colour."""
ROBUST = frozenset({"light", "own", "measured", "corrected"})
"""Kinds that get the robust loss: the colour of a very red star is an outlier, with and without noise."""
LEAST_SURPLUS = 40


@dataclass(frozen=True, slots=True, kw_only=True)
class Evaluation:
    """All calibrations of one camera."""

    chart: Chart  # Truth
    position_px: dict[str, FloatArray]  # (n, 2) Positions of all matched stars: `STEPS` and "corrected"
    used: NDArray[np.bool_]  # (n,) Matched stars that are calibrated with
    # Error per axis added to the noise of every centroid so that residuals are what was expected: "measured" for all
    # steps, and "corrected"
    floor_px: dict[str, float]
    # Calibrations with their map errors, by (method, model, data); all `STEPS` for the model that counts. All have
    # the same weights but those of ``corrected``
    maps: dict[tuple[str, str, str], CalibratedMap]
    clean: CalibratedMap  # ``reference`` with the weights of ``corrected``
    direct: dict[str, CalibratedMap]  # Each model fitted to the chart itself: no stars, no noise
    part_arcsec: dict[str, FloatArray]  # (n, 2) Maps of `PARTS` for the model that counts
    residual_px: FloatArray  # (k, 2) Residuals of the used stars in the measured fit that counts
    wrong_matches: tuple[WrongMatchFit, ...]  # Fits with wrong matches put in
    check: Check  # The calibration that counts by equations written out

    @property
    def part_rms_arcsec(self) -> dict[str, float]:
        """RMS of each part."""
        return {name: rms(part) for name, part in self.part_arcsec.items()}

    @property
    def quadrature_arcsec(self) -> float:
        """Root of the sum of the squares of the parts."""
        return float(np.sqrt(sum(size**2 for size in self.part_rms_arcsec.values())))

    @property
    def part_correlation(self) -> dict[str, float]:
        """Correlation of every two parts over the chart: their mean product over their RMS."""
        maps, sizes = self.part_arcsec, self.part_rms_arcsec
        return {
            f"{one}, {other}": float(np.nanmean((maps[one] * maps[other]).sum(axis=1)) / (sizes[one] * sizes[other]))
            for one, other in combinations(PARTS, 2)
        }


def evaluate(
    scene: Scene,
    recording: Recording,
    matched: Matched,
    config: Config,
    streams: Streams,
    *,
    advance: Callable[[], None],
) -> Evaluation:
    """Calibrate, switch the errors on one by one, and compare with the traced lens."""
    _check_count(scene, config, matched, np.asarray(np.isfinite(matched.in_cam).all(axis=1)))
    chart = trace_chart(scene, config)
    position = positions(scene, recording, matched, config)
    used = np.all([np.isfinite(place).all(axis=1) for place in position.values()], axis=0)
    _check_count(scene, config, matched, used)
    advance()
    plain = Calibrator(
        scene=scene, matched=matched, config=config, chart=chart, used=used, position_px=position, robust=ROBUST
    )
    name = scene.config.model
    calibrator = replace(plain, floor_px=plain.find_floor_px("measured", name))
    fine = replace(plain, floor_px=plain.find_floor_px("corrected", name))
    maps: dict[tuple[str, str, str], CalibratedMap] = {}
    direct = {}
    for model in scene.config.models:
        for data in STEPS if model == name else ("reference", "measured"):
            maps["free", model, data] = calibrator.calibrate(data, model=model)
        maps["free", model, "corrected"] = fine.calibrate("corrected", model=model)
        direct[model] = calibrator.direct(model)
        advance()
    for method in ("acc", "linked", "acc_true"):
        maps[method, name, "measured"] = calibrator.calibrate("measured", model=name, method=method)
        maps[method, name, "corrected"] = fine.calibrate("corrected", model=name, method=method)
    advance()
    wrong_matches = wrong_match_fits(calibrator, maps["free", name, "measured"], streams)
    advance()
    return Evaluation(
        chart=chart,
        position_px=position,
        used=used,
        floor_px={"measured": calibrator.floor_px, "corrected": fine.floor_px},
        maps=maps,
        clean=fine.calibrate("reference", model=name),
        direct=direct,
        part_arcsec=_parts([maps["free", name, data] for data in STEPS]),
        residual_px=calibrator.residuals(maps["free", name, "measured"]),
        wrong_matches=wrong_matches,
        check=check_calibration(scene, calibrator, maps["free", name, "measured"].calibration, config),
    )


def _check_count(scene: Scene, config: Config, matched: Matched, used: NDArray[np.bool_]) -> None:
    """Refuse to calibrate with next to nothing."""
    stars, frames = int(used.sum()), len(np.unique(matched.frame[used]))
    needed = 2 * frames + LEAST_SURPLUS
    if stars < needed:
        raise DomainError(
            f"{scene.name}: {stars} good stars matched in {frames} frames; at least {needed} are needed: raise "
            f"{scene.name}.instrument.exposure_s ({scene.instrument.config.exposure_s:g} s) or "
            f"{scene.name}.faintest_mag ({scene.config.faintest_mag:g}), or lower least_snr ({config.least_snr:g})"
        )


def _parts(runs: list[CalibratedMap]) -> dict[str, FloatArray]:
    """Each part of the error: a map minus the one before."""
    before = np.zeros_like(runs[0].error_arcsec)
    out = {}
    for part, run in zip(PARTS, runs, strict=True):
        out[part] = run.error_arcsec - before
        before = run.error_arcsec
    return out
