"""Every term measured in the virtual laboratory, for every centroider on the same frames.

Where ACC18's test is one random sample (one path of the hexapod, one survey of the target), it is repeated and the RMS
of the results is taken, so that the uncertainty of the term is small against 10 %.
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
    BudgetLaboratory,
    field_positions_px,
    grid_streams,
    half_field,
    target_survey_term,
)
from experiments.laboratory.bench.centroid_methods import needs_measured_epsf
from experiments.laboratory.bench.epsf_session import epsf_session, measured_epsf
from experiments.laboratory.bench.points import point_scene
from experiments.laboratory.distortion_error import measure_distortion
from experiments.laboratory.high_frequency import measure_high_frequency
from experiments.laboratory.temporal_error import measure_temporal, star_target_directions
from optics.arrays import FloatArray
from render.engine.random import Streams

TEMPORAL_SERIES = 1
CHROMATIC_CORNERS = 4
DISTORTION_SERIES = 2  # One for the camera, one for the polynomial


@dataclass(frozen=True, slots=True, kw_only=True)
class MeasuredTerms:
    """A budget from frames; arcsec are 3 sigma."""

    budget: ErrorBudget  # Terms and their sums (ACC18 eq. 31-32)
    single_position_arcsec: FloatArray  # (2,) HSFE of one position against the truth, without temporal noise
    sigma_d_arcsec: FloatArray  # (2,) sigma_d, residuals before the polynomial, RMS over the surveys
    sigma_dd_arcsec: FloatArray  # (2,) sigma_Dd, residuals after the polynomial, RMS over the surveys
    # (2,) sigma_C1 of the first survey: the number that a laboratory with a single survey would print
    c1_single_survey_arcsec: FloatArray
    c1_survey_scatter_arcsec: FloatArray  # (2,) Standard deviation of sigma_C1 from survey to survey
    chromatic: ChromaticTerm  # Table 1


def measure_terms(
    lab: BudgetLaboratory,
    *,
    advance: Callable[[], None] = lambda: None,
    streams: Streams | None = None,
) -> dict[str, MeasuredTerms]:
    """Run the virtual laboratory for every term, and reduce its frames with every centroider."""
    root = streams or Streams(lab.config.seed).child("budget", "measured")
    instrument, grid = lab.instrument, lab.config.grid
    scene = point_scene(lab.bench, instrument)
    if _builds_epsf(lab):
        epsf = measured_epsf(
            lab.bench,
            instrument,
            lab.config.hexapod,
            psf=scene.psfs(star_target_directions(lab.bench, instrument)),
            streams=root.child("ePSF"),
            scene=scene,
            advance=advance,
        )
        lab = lab.with_epsf(epsf)
    temporal = measure_temporal(lab.bench, instrument, streams=root.child("TE"), scene=scene)
    advance()
    step_tests = [
        measure_high_frequency(
            lab.bench,
            instrument,
            lab.config.hexapod,
            lab.config.steps,
            place_px=centre_px,
            split=False,
            streams=root.child("HSFE", f"place {number}"),
            scene=scene,
            advance=advance,
        )
        for number, centre_px in enumerate(field_positions_px(lab).tolist())
    ]
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
    c2 = survey_term(distortion.surveyed) or target_survey_term(lab)
    scale = 3.0 * instrument.pixel_arcsec
    surveys = len(distortion.surveyed)
    measured = {}
    for method in lab.bench.methods:
        # sigma_d, sigma_Dd, sigma_C1 of every survey (q, 3, 2), their RMS and their scatter
        sigma_arcsec = scale * distortion.over_surveys(method, grid.reference)
        sigma_d, sigma_dd, sigma_c1 = np.sqrt((sigma_arcsec**2).mean(0))
        c1_scatter = sigma_arcsec[:, 2].std(0, ddof=1) if surveys > 1 else np.full(2, np.nan)
        terms = {
            "TE": temporal.temporal_error(method),
            "HSFE": repeated_term([test.high_frequency_error(method) for test in step_tests]),
            "LSFE-S": chromatic[method].error_term(),
            "LSFE-C1": ErrorTerm(
                arcsec=sigma_c1,
                uncertainty_arcsec=c1_scatter / np.sqrt(surveys),
                n=surveys * grid.rows * grid.columns,
            ),
            "LSFE-C2": c2,
        }
        budget = combine(terms, stars=lab.config.attitude.stars)
        attitude = attitude_term(
            budget,
            half_field(instrument),
            stars=lab.config.attitude.stars,
            trials=lab.config.attitude.trials,
            rng=root.child("attitude", method).generator("attitude"),
        )
        measured[method] = MeasuredTerms(
            budget=replace(budget, attitude=attitude),
            single_position_arcsec=scale * rms_over([test.single_px(method) for test in step_tests]),
            sigma_d_arcsec=sigma_d,
            sigma_dd_arcsec=sigma_dd,
            c1_single_survey_arcsec=sigma_arcsec[0, 2],
            c1_survey_scatter_arcsec=c1_scatter,
            chromatic=chromatic[method],
        )
    return measured


def _builds_epsf(lab: BudgetLaboratory) -> bool:
    return any(needs_measured_epsf(method) for method in lab.bench.methods)


def count_advances(lab: BudgetLaboratory) -> int:
    """Number of calls of ``advance`` by `measure_terms`."""
    epsf_positions = epsf_session(lab.bench).positions if _builds_epsf(lab) else 0
    step_positions = lab.config.steps.places * lab.config.steps.positions
    return epsf_positions + TEMPORAL_SERIES + step_positions + CHROMATIC_CORNERS + DISTORTION_SERIES
