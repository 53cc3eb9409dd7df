"""Every term predicted without frames, for every centroider, by `experiments.laboratory`.

For sweeps a cheaper prediction is used (`coarse_terms`): the main centroider alone, a target of 3 x 3 points over the
same area, filters with the PSF of its middle point, half the positions of the step test on an ideal platform at one
place, fewer draws, the same everywhere. The star mean that eq. 8 removes takes 1/W of an independent error; the pixel
term is scaled from W = 9 to the target's own number of stars.
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
    Laboratory,
    build_laboratory,
    check_laboratory,
    grid_streams,
    marking,
    places_px,
    psfs,
    rendered_once,
)
from experiments.budget.settings import Config
from experiments.laboratory.bench.centroid_methods import needs_measured_epsf
from experiments.laboratory.bench.epsf_session import predicted_epsfs
from experiments.laboratory.devices.targets import grid_directions
from experiments.laboratory.distortion_model import marking_errors, predict_distortion
from experiments.laboratory.high_frequency_model import predict_high_frequency
from experiments.laboratory.temporal_error import predict_temporal, target_place
from optics.arrays import FloatArray
from render.detector.maps import sensor_maps

STEP_NOISE_DRAWS = 60
"""Noisy copies of each window of the step test: their mean is then good to an eighth of the noise of a frame."""

SESSIONS = 8
"""Drawn sets of frames from which a PSF is built: its scatter is then known to a quarter."""

COARSE_POINTS, COARSE_POSITIONS, COARSE_DRAWS = 3, 6, 60
"""Points along a side of the target, positions of the step test and noisy copies of `coarse_terms`."""

_CAUSES = {"S-curve": "s_curve", "PRNU": "prnu", "offset pattern": "pattern", "defects": "defects"}


@dataclass(frozen=True, slots=True, kw_only=True)
class PredictedTerms:
    """A budget without frames."""

    budget: ErrorBudget  # The terms
    bound_te_arcsec: FloatArray  # (2,) Cramer-Rao bound of the temporal error
    causes_arcsec: Mapping[str, FloatArray]  # (2,) What is in the HSFE, 3 sigma
    single_arcsec: FloatArray  # (2,) HSFE of one position, without temporal noise
    left_arcsec: FloatArray  # (2,) sigma_Dd, left by the polynomial, 3 sigma
    found_arcsec: FloatArray  # (2,) sigma_d, before the fit, 3 sigma
    # (2,) sigma_C1 of a perfect camera and frames without noise: what the polynomial takes of the marking errors
    marking_alone_arcsec: FloatArray
    chromatic: ChromaticTerm  # Table 1


def predict_terms(
    lab: Laboratory,
    *,
    draws: int = 200,
    step_draws: int = 200,
    coarse: bool = False,
) -> dict[str, PredictedTerms]:
    """Predict every term, by centroider."""
    instrument, seed = lab.instrument, lab.config.seed
    psf = psfs(lab, lab.bench, "place 0", target_place(lab.bench, instrument))
    if any(needs_measured_epsf(method) for method in lab.bench.methods):
        built = predicted_epsfs(lab.bench, instrument, psf, seed=seed, sessions=2 if coarse else SESSIONS)
        lab = lab.with_epsf(built[0], built)
    defect = None if coarse else sensor_maps(instrument.detector).defect
    scale = 3.0 * instrument.pixel_arcsec
    temporal = predict_temporal(lab.bench, instrument, psf=psf, draws=draws, defect=defect, seed=seed)
    steps = _step_predictions(lab, step_draws, defect, coarse=coarse)
    name = "chromatic, coarse" if coarse else "chromatic"
    traced = rendered_once(lab, lab.filtered, name, lambda: trace_target(lab, coarse=coarse))
    chromatic = predicted_terms(lab, traced, draws=draws, defect=defect)
    distortion = _distortion(lab, draws, defect)
    alone = _marking_alone_px(lab)
    # the document's mean over standard deviations of N frames
    short = small_sample_factor(lab.config.frames)
    found = {}
    for method in lab.bench.methods:
        te = ErrorTerm(
            arcsec=short * temporal.sampled_error(method).arcsec,
            uncertainty_arcsec=short * temporal.sampled_error(method).uncertainty_arcsec,
        )
        places = [one[method] for one in steps]
        number, spread = (v * scale for v in distortion[method])
        term = {
            "TE": te,
            "HSFE": step_term(places, places=lab.config.steps.places, pixel_arcsec=instrument.pixel_arcsec),
            "LSFE-S": chromatic[method].value(),
            "LSFE-C1": ErrorTerm(arcsec=number[2], uncertainty_arcsec=spread[2]),
            "LSFE-C2": marking(lab),
        }
        found[method] = PredictedTerms(
            budget=combine(term, stars=lab.config.attitude.stars),
            bound_te_arcsec=temporal.arcsec(temporal.bound_px[0]),
            causes_arcsec=_causes_arcsec(places, instrument.pixel_arcsec),
            single_arcsec=scale * rms_over([one.position_rms_px for one in places]),
            left_arcsec=number[1],
            found_arcsec=number[0],
            marking_alone_arcsec=alone * scale,
            chromatic=chromatic[method],
        )
    return found


def coarse_terms(config: Config) -> PredictedTerms:
    """A budget predicted cheaply (see the module), of the main centroider.

    Raises
    ------
    StarbenchError
        On light that misses the detector or its windows, or saturates it.
    """
    few, factor = _coarse(config.model_copy(update={"compare": ()}))
    lab = build_laboratory(few)
    check_laboratory(lab)
    terms = predict_terms(lab, draws=COARSE_DRAWS, step_draws=COARSE_DRAWS, coarse=True)[config.centroid]
    budget, hsfe = terms.budget, terms.budget["HSFE"]
    scaled = ErrorTerm(arcsec=hsfe.arcsec * factor, uncertainty_arcsec=hsfe.uncertainty_arcsec * factor)
    return replace(
        terms,
        budget=combine({**budget.term, "HSFE": scaled}, stars=config.attitude.stars),
        causes_arcsec={name: value * factor for name, value in terms.causes_arcsec.items()},
    )


def _coarse(config: Config) -> tuple[Config, float]:
    """Configuration with a 3 x 3 target, and the factor of the pixel term."""
    target = config.target
    if target.rows != target.columns or target.rows <= COARSE_POINTS:
        return config, 1.0
    # a third of a pixel, so that three points are at three different places of their pixels
    pitch = np.floor(target.pitch_px * (target.rows - 1) / (COARSE_POINTS - 1)) - 2.0 / 3.0
    few = target.model_copy(update={"rows": COARSE_POINTS, "columns": COARSE_POINTS, "pitch_px": float(pitch)})
    factor = np.sqrt((1.0 - 1.0 / target.rows**2) / (1.0 - 1.0 / COARSE_POINTS**2))
    steps = config.steps.model_copy(update={"positions": min(COARSE_POSITIONS, config.steps.positions)})
    return config.model_copy(update={"target": few, "steps": steps}), float(factor)


def _step_predictions(
    lab: Laboratory, draws: int, defect: NDArray[np.bool_] | None, *, coarse: bool
) -> list[Mapping[str, StepPrediction]]:
    """The step test at places along the detector, by centroider."""
    bench, instrument, found = lab.bench, lab.instrument, []
    # the field changes slowly, but not what one PSF for all of it does to the S-curve
    every = 1 if any(needs_measured_epsf(method) for method in bench.methods) else 2
    for number, middle in enumerate(places_px(lab)[: 1 if coarse else None : every]):
        predicted = predict_high_frequency(
            bench,
            instrument,
            lab.config.steps,
            psf=psfs(lab, bench, f"place {number}", target_place(bench, instrument, middle.tolist())),
            hexapod=lab.config.hexapod.model_copy(update={"step_error_arcsec": 0.0} if coarse else {}),
            place_px=middle.tolist(),
            defect=defect,
            draws=draws,
            noise_draws=STEP_NOISE_DRAWS // 3 if coarse else STEP_NOISE_DRAWS,
            seed=lab.config.seed + number,
        )
        found.append(predicted.method)
    return found


def _causes_arcsec(places: Sequence[StepPrediction], pixel_arcsec: float) -> dict[str, FloatArray]:
    """Causes of the HSFE, 3 sigma, RMS over places."""
    parts = {label: [one.cause_px[key] for one in places] for label, key in _CAUSES.items()}
    parts["averaged noise"] = [np.hypot(one.temporal_px, one.dark_px) for one in places]
    parts["roll of the platform"] = [one.roll_px for one in places]
    return {label: 3.0 * pixel_arcsec * rms_over(values) for label, values in parts.items()}


def _distortion(
    lab: Laboratory, draws: int, defect: NDArray[np.bool_] | None
) -> dict[str, tuple[FloatArray, FloatArray]]:
    """sigma_d, sigma_Dd, sigma_C1 (3, 2) [px], and the scatter of their RMS over the surveys of a chip and a run."""
    bench, grid = lab.bench, lab.config.grid
    direction = grid_directions(grid, lab.instrument, grid_streams(lab))
    predicted = predict_distortion(
        bench,
        lab.instrument,
        grid,
        direction,
        psf=psfs(lab, bench, "grid", direction),
        order=grid.order,
        references=(grid.reference,),
        noise_draws=2 * draws,
        defect=defect,
        seed=lab.config.seed,
    )
    return {
        method: (
            predicted.mean_px[method][grid.reference],
            predicted.of_surveys_px(method, grid.reference, grid.surveys),
        )
        for method in bench.methods
    }


def _marking_alone_px(lab: Laboratory) -> FloatArray:
    """sigma_C1 (2,) [px] of marking errors alone."""
    grid = lab.config.grid
    direction = grid_directions(grid, lab.instrument, grid_streams(lab))
    return expected_numbers(marking_errors(grid, lab.instrument, direction), grid.order, grid.reference).rms_px[2]
