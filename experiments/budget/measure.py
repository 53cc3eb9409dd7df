"""Every term measured in the virtual laboratory, for every centroider on the same frames.

Where the document's test is one random sample (one path of the platform, one survey of the target), it is repeated and
its RMS taken, so that its uncertainty is small against 10 %.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from calib.accuracy.attitude_from_stars import attitude_term
from calib.accuracy.budget_comparison import repeated_term, survey_term
from calib.accuracy.error_budget import ErrorBudget, ErrorTerm, combine
from calib.accuracy.step_prediction import rms_over
from experiments.budget.chromatic import ChromaticTerm, measured_terms
from experiments.budget.laboratory import (
    Laboratory,
    grid_streams,
    half_field,
    marking,
    places_px,
)
from experiments.laboratory.bench.centroid_methods import needs_measured_epsf
from experiments.laboratory.bench.epsf_session import epsf_session, measured_epsf
from experiments.laboratory.bench.points import PointScene, point_scene
from experiments.laboratory.distortion_error import DistortionMeasurement, measure_distortion
from experiments.laboratory.high_frequency import HighFrequencyMeasurement, measure_high_frequency
from experiments.laboratory.temporal_error import measure_temporal, target_place
from optics.arrays import FloatArray
from render.engine.random import Streams


@dataclass(frozen=True, slots=True, kw_only=True)
class Measurement:
    """A budget from frames."""

    budget: ErrorBudget  # The terms
    single_arcsec: FloatArray  # (2,) HSFE of one position against the truth, without temporal noise
    left_arcsec: FloatArray  # (2,) sigma_Dd, 3 sigma, RMS over the surveys
    found_arcsec: FloatArray  # (2,) sigma_d, 3 sigma, RMS over the surveys
    # (2,) sigma_C1 of the first survey alone: what a laboratory that surveys once would print
    one_survey_arcsec: FloatArray
    survey_scatter_arcsec: FloatArray  # (2,) Standard deviation of that from survey to survey
    chromatic: ChromaticTerm  # Table 1


def measure_terms(
    lab: Laboratory,
    *,
    advance: Callable[[], None] = lambda: None,
    streams: Streams | None = None,
) -> dict[str, Measurement]:
    """Run the virtual laboratory for every term, and reduce its frames with every centroider."""
    root = streams or Streams(lab.config.seed).child("budget", "measured")
    instrument, grid = lab.instrument, lab.config.grid
    scene = point_scene(lab.bench, instrument)
    if _builds_epsf(lab):
        epsf = measured_epsf(
            lab.bench,
            instrument,
            lab.config.hexapod,
            psf=scene.psfs(target_place(lab.bench, instrument)),
            streams=root.child("ePSF"),
            scene=scene,
            advance=advance,
        )
        lab = lab.with_epsf(epsf)
    temporal = measure_temporal(lab.bench, instrument, streams=root.child("TE"), scene=scene)
    advance()
    places = _step_tests(lab, scene, root.child("HSFE"), advance)
    chromatic = measured_terms(lab, root.child("LSFE-S"), advance=advance)
    distortion = measure_distortion(
        lab.bench,
        instrument,
        lab.config.grid,
        order=grid.order,
        surveys=grid.surveys,
        streams=grid_streams(lab),
        scene=scene,
        advance=advance,
    )
    found, c2 = {}, survey_term(distortion.surveyed) or marking(lab)
    for method in lab.bench.methods:
        every, rms, spread = _over_surveys(lab, distortion, method)
        c1 = ErrorTerm(
            arcsec=rms[2],
            uncertainty_arcsec=spread[2] / np.sqrt(len(every)),
            n=len(every) * grid.rows * grid.columns,
        )
        term = {
            "TE": temporal.temporal_error(method),
            "HSFE": repeated_term([place.high_frequency_error(method) for place in places]),
            "LSFE-S": chromatic[method].value(),
            "LSFE-C1": c1,
            "LSFE-C2": c2,
        }
        budget = combine(term, stars=lab.config.attitude.stars)
        solved = attitude_term(
            budget,
            half_field(instrument),
            stars=lab.config.attitude.stars,
            trials=lab.config.attitude.trials,
            rng=root.child("attitude", method).generator("attitude"),
        )
        found[method] = Measurement(
            budget=replace(budget, attitude=solved),
            single_arcsec=3.0 * instrument.pixel_arcsec * rms_over([place.single_px(method) for place in places]),
            left_arcsec=rms[1],
            found_arcsec=rms[0],
            one_survey_arcsec=every[0, 2],
            survey_scatter_arcsec=spread[2],
            chromatic=chromatic[method],
        )
    return found


def _builds_epsf(lab: Laboratory) -> bool:
    return any(needs_measured_epsf(method) for method in lab.bench.methods)


def steps_of(lab: Laboratory) -> int:
    """Number of calls of ``advance`` by `measure_terms`."""
    before = epsf_session(lab.bench).positions if _builds_epsf(lab) else 0
    return before + 1 + lab.config.steps.places * lab.config.steps.positions + 4 + 2


def _over_surveys(
    lab: Laboratory, distortion: DistortionMeasurement, method: str
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """sigma_d, sigma_Dd, sigma_C1 [arcsec, 3 sigma] of every survey (q, 3, 2), their RMS and their scatter (3, 2)."""
    every = distortion.over_surveys(method, lab.config.grid.reference) * (3.0 * lab.instrument.pixel_arcsec)
    spread = every.std(0, ddof=1) if len(every) > 1 else np.full((3, 2), np.nan)
    return every, np.sqrt((every**2).mean(0)), spread


def _step_tests(
    lab: Laboratory, scene: PointScene, streams: Streams, advance: Callable[[], None]
) -> list[HighFrequencyMeasurement]:
    """The step test at every place."""
    return [
        measure_high_frequency(
            lab.bench,
            lab.instrument,
            lab.config.hexapod,
            lab.config.steps,
            place_px=place.tolist(),
            split=False,
            streams=streams.child(f"place {number}"),
            scene=scene,
            advance=advance,
        )
        for number, place in enumerate(places_px(lab))
    ]
