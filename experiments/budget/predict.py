"""Every term predicted without frames, for every centroider, by `experiments.laboratory`.

Sweeps use a reduced prediction (`coarse_terms`) of the main centroider:

- target of 3 x 3 points over the same area; every filter with the PSF of the central point
- at most six positions of the step test, without step errors of the hexapod, at the first field position
- fewer Monte-Carlo samples; no bad pixels

ACC18 eq. 8 subtracts the mean over the W stars of the target, which leaves the variance sigma^2 (1 - 1/W) of errors
that are independent from star to star: the HSFE of W = 9 is multiplied by sqrt((1 - 1/W) / (1 - 1/9)).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from calib.accuracy.distortion_prediction import expected_numbers
from calib.accuracy.error_budget import ErrorBudget, ErrorTerm, combine
from calib.accuracy.step_prediction import StepPrediction, rms_over, step_term
from calib.accuracy.temporal import small_sample_factor
from experiments.budget.chromatic import ChromaticTerm, predicted_terms, trace_target
from experiments.budget.laboratory import (
    BudgetLaboratory,
    build_laboratory,
    cached_light,
    cached_psfs,
    check_laboratory,
    field_positions_px,
    grid_streams,
    target_survey_term,
)
from experiments.budget.settings import BudgetConfig
from experiments.laboratory.bench.centroid_methods import needs_measured_epsf
from experiments.laboratory.bench.epsf_session import predicted_epsfs
from experiments.laboratory.devices.target import grid_directions
from experiments.laboratory.distortion_model import marking_errors, predict_distortion
from experiments.laboratory.high_frequency_model import predict_high_frequency
from experiments.laboratory.temporal_error import predict_temporal, star_target_directions
from optics.arrays import FloatArray
from render.detector.maps import sensor_maps

STEP_NOISE_DRAWS = 60
"""Noisy copies of each window of the step test: their mean is then good to an eighth of the noise of a frame."""

EPSF_REALISATIONS = 8
"""Monte-Carlo realisations of a PSF built from frames: its standard deviation is then known to a quarter."""

COARSE_POINTS = 3
"""Points along a side of the target of `coarse_terms`."""
COARSE_POSITIONS = 6
"""Largest number of positions of the step test of `coarse_terms`."""
COARSE_DRAWS = 60
"""Noisy copies of each window of `coarse_terms`."""
COARSE_EPSF_REALISATIONS = 2

_CAUSE_LABELS = {"s_curve": "S-curve", "prnu": "PRNU", "pattern": "offset pattern", "defects": "defects"}


@dataclass(frozen=True, slots=True, kw_only=True)
class PredictedTerms:
    """A budget without frames; arcsec are 3 sigma."""

    budget: ErrorBudget  # Terms and their sums (ACC18 eq. 31-32)
    te_cramer_rao_arcsec: FloatArray  # (2,) Cramer-Rao bound of the temporal error
    causes_arcsec: Mapping[str, FloatArray]  # (2,) Contributions to the HSFE by label
    single_position_arcsec: FloatArray  # (2,) HSFE of one position, without temporal noise
    sigma_d_arcsec: FloatArray  # (2,) sigma_d, residuals before the polynomial
    sigma_dd_arcsec: FloatArray  # (2,) sigma_Dd, residuals after the polynomial
    c1_marking_errors_arcsec: FloatArray  # (2,) sigma_C1 of a perfect camera and frames without noise
    chromatic: ChromaticTerm  # Table 1


def predict_terms(
    lab: BudgetLaboratory,
    *,
    draws: int = 200,
    step_draws: int = 200,
    coarse: bool = False,
) -> dict[str, PredictedTerms]:
    """Predict every term, by centroider."""
    config, instrument, seed = lab.config, lab.instrument, lab.config.seed
    psf = cached_psfs(lab, lab.bench, "field position 0", star_target_directions(lab.bench, instrument))
    if any(needs_measured_epsf(method) for method in lab.bench.methods):
        realisations = COARSE_EPSF_REALISATIONS if coarse else EPSF_REALISATIONS
        epsfs = predicted_epsfs(lab.bench, instrument, psf, seed=seed, sessions=realisations)
        lab = lab.with_epsf(epsfs[0], epsfs)
    defect = None if coarse else sensor_maps(instrument.detector).defect
    scale = 3.0 * instrument.pixel_arcsec
    temporal = predict_temporal(lab.bench, instrument, psf=psf, draws=draws, defect=defect, seed=seed)
    step_tests = _predict_step_tests(lab, step_draws, defect, coarse=coarse)
    target = "chromatic, coarse" if coarse else "chromatic"
    traced = cached_light(lab, lab.filtered, target, lambda: trace_target(lab, coarse=coarse))
    chromatic = predicted_terms(lab, traced, draws=draws, defect=defect)
    grid = config.grid
    direction = grid_directions(grid, instrument, grid_streams(lab))
    distortion = predict_distortion(
        lab.bench,
        instrument,
        grid,
        direction,
        psf=cached_psfs(lab, lab.bench, "grid", direction),
        order=grid.order,
        references=(grid.reference,),
        noise_draws=2 * draws,
        defect=defect,
        seed=seed,
    )
    survey_errors = marking_errors(grid, instrument, direction)
    _, _, c1_of_survey_px = expected_numbers(survey_errors, grid.order, grid.reference).rms_px
    c4 = small_sample_factor(config.frames)  # ACC18 averages standard deviations of N frames
    predictions = {}
    for method in lab.bench.methods:
        sampled = temporal.sampled_error(method)
        steps = [step_test[method] for step_test in step_tests]
        sigma_d, sigma_dd, sigma_c1 = scale * distortion.mean_px[method][grid.reference]
        _, _, c1_uncertainty = scale * distortion.of_surveys_px(method, grid.reference, grid.surveys)
        terms = {
            "TE": ErrorTerm(arcsec=c4 * sampled.arcsec, uncertainty_arcsec=c4 * sampled.uncertainty_arcsec),
            "HSFE": step_term(steps, places=config.steps.places, pixel_arcsec=instrument.pixel_arcsec),
            "LSFE-S": chromatic[method].error_term(),
            "LSFE-C1": ErrorTerm(arcsec=sigma_c1, uncertainty_arcsec=c1_uncertainty),
            "LSFE-C2": target_survey_term(lab),
        }
        predictions[method] = PredictedTerms(
            budget=combine(terms, stars=config.attitude.stars),
            te_cramer_rao_arcsec=temporal.arcsec(temporal.bound_px[0]),
            causes_arcsec={label: scale * rms_px for label, rms_px in _hsfe_contributions_px(steps).items()},
            single_position_arcsec=scale * rms_over([step.position_rms_px for step in steps]),
            sigma_d_arcsec=sigma_d,
            sigma_dd_arcsec=sigma_dd,
            c1_marking_errors_arcsec=scale * c1_of_survey_px,
            chromatic=chromatic[method],
        )
    return predictions


def coarse_terms(config: BudgetConfig) -> PredictedTerms:
    """Reduced prediction (see the module) of the main centroider.

    Raises
    ------
    StarbenchError
        On light that misses the detector or its windows, or saturates it.
    """
    coarse, hsfe_factor = _reduce_settings(config.model_copy(update={"compare": ()}))
    lab = build_laboratory(coarse)
    check_laboratory(lab)
    terms = predict_terms(lab, draws=COARSE_DRAWS, step_draws=COARSE_DRAWS, coarse=True)[config.centroid]
    budget, hsfe = terms.budget, terms.budget["HSFE"]
    scaled = ErrorTerm(arcsec=hsfe.arcsec * hsfe_factor, uncertainty_arcsec=hsfe.uncertainty_arcsec * hsfe_factor)
    return replace(
        terms,
        budget=combine({**budget.term, "HSFE": scaled}, stars=config.attitude.stars),
        causes_arcsec={cause: hsfe_arcsec * hsfe_factor for cause, hsfe_arcsec in terms.causes_arcsec.items()},
    )


def _reduce_settings(config: BudgetConfig) -> tuple[BudgetConfig, float]:
    """Configuration with a 3 x 3 target, and the factor of its HSFE for the W of the full target (eq. 8, see above)."""
    target = config.target
    if target.rows != target.columns or target.rows <= COARSE_POINTS:
        return config, 1.0
    # an integer number of pixels and a third, so that the three points of a row have three different pixel phases
    pitch = np.floor(target.pitch_px * (target.rows - 1) / (COARSE_POINTS - 1)) - 2.0 / 3.0
    coarse = target.model_copy(update={"rows": COARSE_POINTS, "columns": COARSE_POINTS, "pitch_px": float(pitch)})
    hsfe_factor = np.sqrt((1.0 - 1.0 / target.rows**2) / (1.0 - 1.0 / COARSE_POINTS**2))
    steps = config.steps.model_copy(update={"positions": min(COARSE_POSITIONS, config.steps.positions)})
    return config.model_copy(update={"target": coarse, "steps": steps}), float(hsfe_factor)


def _predict_step_tests(
    lab: BudgetLaboratory, draws: int, defect: NDArray[np.bool_] | None, *, coarse: bool
) -> list[Mapping[str, StepPrediction]]:
    """The step test (ACC18 eq. 8-12) at positions along the detector, by centroider."""
    bench, instrument = lab.bench, lab.instrument
    # the PSF changes slowly over the field, so that every second position suffices; with one PSF for the entire field
    # the S-curve follows the PSF mismatch, which changes fast
    stride = 1 if any(needs_measured_epsf(method) for method in bench.methods) else 2
    predictions = []
    for number, centre_px in enumerate(field_positions_px(lab)[: 1 if coarse else None : stride].tolist()):
        predicted = predict_high_frequency(
            bench,
            instrument,
            lab.config.steps,
            psf=cached_psfs(
                lab, bench, f"field position {number}", star_target_directions(bench, instrument, centre_px)
            ),
            hexapod=lab.config.hexapod.model_copy(update={"step_error_arcsec": 0.0} if coarse else {}),
            place_px=centre_px,
            defect=defect,
            draws=draws,
            noise_draws=STEP_NOISE_DRAWS // 3 if coarse else STEP_NOISE_DRAWS,
            seed=lab.config.seed + number,
        )
        predictions.append(predicted.method)
    return predictions


def _hsfe_contributions_px(steps: Sequence[StepPrediction]) -> dict[str, FloatArray]:
    """Contributions (2,) to the RMS of steps [px], RMS over the field positions, by label."""
    contributions_px = {label: [step.cause_px[cause] for step in steps] for cause, label in _CAUSE_LABELS.items()}
    contributions_px["averaged noise"] = [np.hypot(step.temporal_px, step.dark_px) for step in steps]
    contributions_px["roll of the platform"] = [step.roll_px for step in steps]
    return {label: rms_over(steps_px) for label, steps_px in contributions_px.items()}
