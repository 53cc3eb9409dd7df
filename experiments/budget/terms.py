"""The terms of one instrument: predicted without frames, and measured in the virtual laboratory.

Each term has one meaning and one code for both (`experiments.laboratory`); here they become numbers of the budget, 3
sigma in arcsec. Where the document's test is one sample of something random (one path of the platform, one survey of
the target), the measurement is repeated and its RMS taken, so that its uncertainty is small against 10 %.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from experiments.budget.chromatic import ChromaticTerm, measured_term, predicted_term, trace_target
from experiments.budget.combine import Budget, Value, combine
from experiments.budget.laboratory import Laboratory
from experiments.laboratory.bench import Bench
from experiments.laboratory.centroid_methods import needs_epsf
from experiments.laboratory.distortion_error import measure_distortion
from experiments.laboratory.distortion_model import predict_distortion
from experiments.laboratory.hexapod import Hexapod
from experiments.laboratory.high_frequency import StepPlan, measure_high_frequency
from experiments.laboratory.high_frequency_model import predict_high_frequency
from experiments.laboratory.point_scene import PointScene, point_scene
from experiments.laboratory.targets import GridTarget, grid_directions
from experiments.laboratory.temporal_error import measure_temporal, predict_temporal, target_place
from optics.arrays import FloatArray
from render.detector.maps import sensor_maps
from render.engine.random import Streams
from render.records import EffectivePsf

__all__ = ["Measurement", "PredictedTerms", "Psfs", "measure_terms", "predict_terms"]


STEP_NOISE_DRAWS = 60
"""Noisy copies of each window of the step test: their mean is then good to an eighth of the noise of a frame."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PredictedTerms:
    """A budget without frames.

    Attributes
    ----------
    budget : Budget
        The terms.
    bound_te_arcsec : (2,)
        Cramer-Rao bound of the temporal error.
    causes_arcsec : dict of str to (2,)
        What is in the HSFE, 3 sigma.
    single_arcsec : (2,)
        HSFE of one position, without temporal noise.
    left_arcsec, found_arcsec : (2,)
        sigma_Dd (left by the polynomial) and sigma_d (found), 3 sigma.
    chromatic : ChromaticTerm
        Table 1.
    window_px : int
        Window around a point.
    """

    budget: Budget
    bound_te_arcsec: FloatArray
    causes_arcsec: Mapping[str, FloatArray]
    single_arcsec: FloatArray
    left_arcsec: FloatArray
    found_arcsec: FloatArray
    chromatic: ChromaticTerm
    window_px: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Measurement:
    """A budget from frames.

    Attributes
    ----------
    budget : Budget
        The terms.
    single_arcsec : (2,)
        HSFE of one position against the truth, without temporal noise.
    left_arcsec, found_arcsec : (2,)
        sigma_Dd and sigma_d, 3 sigma, RMS over the surveys.
    one_survey_arcsec : (2,)
        sigma_C1 of the first survey alone: what a laboratory that surveys once would print.
    survey_scatter_arcsec : (2,)
        Standard deviation of that from survey to survey.
    places_arcsec : (q, 2)
        HSFE of every place.
    chromatic : ChromaticTerm
        Table 1.
    """

    budget: Budget
    single_arcsec: FloatArray
    left_arcsec: FloatArray
    found_arcsec: FloatArray
    one_survey_arcsec: FloatArray
    survey_scatter_arcsec: FloatArray
    places_arcsec: FloatArray
    chromatic: ChromaticTerm


class Psfs:
    """PSFs of target points, rendered once for all settings that share lens, focus, light, diffusion and window."""

    def __init__(self) -> None:
        self._known: dict[str, Any] = {}

    def of(self, lab: Laboratory, bench: Bench, what: str, direction: FloatArray) -> tuple[EffectivePsf, ...]:
        """PSFs of points (j, 3), by the name of the target."""
        return self.once(lab, bench, what, lambda: point_scene(bench, lab.instrument).psfs(direction))

    def once(self, lab: Laboratory, bench: Bench, what: str, make: Callable[[], Any]) -> Any:
        """Anything that depends on the light alone."""
        config = lab.config
        keys = (config.instrument, config.moved, config.target, config.source, config.filters, config.grid)
        light = [part.model_copy(update={"signal_e": 1.0}) if part is config.source else part for part in keys]
        key = repr((what, light, config.detector.diffusion_sigma_um, bench.window_px, bench.methods))
        if key not in self._known:
            self._known[key] = make()
        return self._known[key]


def step_plan(lab: Laboratory) -> StepPlan:
    """The step test of a configuration."""
    steps = lab.config.steps
    return StepPlan(positions=steps.positions, step_px=steps.step_px, direction_deg=steps.direction_deg)


def platform(lab: Laboratory) -> Hexapod:
    """The hexapod of a configuration."""
    return Hexapod(**lab.config.hexapod.model_dump())


def grid_target(lab: Laboratory) -> GridTarget:
    """The grid target of a configuration."""
    grid = lab.config.grid
    return GridTarget(
        rows=grid.rows,
        columns=grid.columns,
        edge_px=grid.edge_px,
        jitter_px=grid.jitter_px,
        marking_error_arcsec=grid.marking_error_arcsec,
        roll_arcmin=grid.roll_arcmin,
    )


def places_px(lab: Laboratory) -> FloatArray:
    """Middles (q, 2) [px] of the target in the step test: along the detector, the first in the middle of chip one."""
    detector, target = lab.instrument.detector, lab.config.target
    first = np.array([(detector.chip_width_px - 1) / 2, (detector.chip_height_px - 1) / 2])
    half = (target.columns - 1) * target.pitch_px / 2 + 100.0
    low, high = half, lab.instrument.camera.width_px - 1 - half
    # fractions of a pixel apart too, so that the places do not see the same S-curve
    steps = np.modf(np.arange(1, lab.config.steps.places) * 0.618)[0]
    others = [[low + (high - low) * s, first[1] + 0.37 * (k + 1)] for k, s in enumerate(steps)]
    return np.array([first.tolist(), *others])


def predict_terms(
    lab: Laboratory,
    *,
    psfs: Psfs | None = None,
    draws: int = 200,
    step_draws: int = 200,
    ideal_platform: bool = False,
) -> PredictedTerms:
    """Predict every term.

    Parameters
    ----------
    lab : Laboratory
        The laboratory.
    psfs : Psfs, optional
        Where PSFs are kept between calls.
    draws : int
        Noisy copies behind the temporal term, half of those behind the distortion term.
    step_draws : int
        Drawn chips behind the pixel term.
    ideal_platform : bool
        Whether the step test is predicted for equal steps instead of drawn ones.
    """
    psfs = psfs or Psfs()
    bench, instrument, seed = lab.bench, lab.instrument, lab.config.seed
    method, scale = bench.methods[0], 3.0 * instrument.pixel_arcsec
    place = target_place(bench, instrument)
    psf = psfs.of(lab, bench, "place 0", place)
    temporal = predict_temporal(bench, instrument, psf=psf, draws=draws, seed=seed)
    te = Value(arcsec=temporal.sampled_te_arcsec(method), uncertainty_arcsec=temporal.te_uncertainty_arcsec(method))
    hsfe, causes, single = _predicted_steps(lab, psfs, step_draws, ideal_platform=ideal_platform)
    traced = psfs.once(lab, lab.filtered, "chromatic", lambda: trace_target(lab))
    chromatic = predicted_term(lab, traced, draws=draws)
    found, scatter = _predicted_distortion(lab, psfs, draws, seed)
    budget = combine(
        {
            "TE": te,
            "HSFE": hsfe,
            "LSFE-S": chromatic.value(),
            "LSFE-C1": Value(arcsec=found[2] * scale, uncertainty_arcsec=scatter[2] * scale),
            "LSFE-C2": marking(lab),
        },
        stars=lab.config.attitude.stars,
    )
    return PredictedTerms(
        budget=budget,
        bound_te_arcsec=temporal.bound_te_arcsec(),
        causes_arcsec=causes,
        single_arcsec=single,
        left_arcsec=found[1] * scale,
        found_arcsec=found[0] * scale,
        chromatic=chromatic,
        window_px=bench.window_px,
    )


def marking(lab: Laboratory) -> Value:
    """The marking error of the target, an input."""
    return Value(arcsec=np.full(2, 3.0 * lab.config.grid.marking_error_arcsec))


def _predicted_steps(
    lab: Laboratory, psfs: Psfs, draws: int, *, ideal_platform: bool
) -> tuple[Value, dict[str, FloatArray], FloatArray]:
    """HSFE, its causes and the error of one position: RMS over every second place of the test.

    For equal steps the first place alone. The uncertainty is the scatter of the measured number: other chips, other
    noise, other paths.
    """
    bench, instrument = lab.bench, lab.instrument
    method, scale = bench.methods[0], 3.0 * instrument.pixel_arcsec
    places = places_px(lab)[:: 2 if not ideal_platform else len(places_px(lab))]  # the field changes slowly
    found, scatters = [], []
    for number, middle in enumerate(places):
        direction = target_place(bench, instrument, middle.tolist())
        one = predict_high_frequency(
            bench,
            instrument,
            step_plan(lab),
            psf=psfs.of(lab, bench, f"place {number}", direction),
            hexapod=replace(platform(lab), step_error_arcsec=0.0) if ideal_platform else platform(lab),
            place_px=middle.tolist(),
            draws=draws,
            noise_draws=noise_draws(lab, STEP_NOISE_DRAWS // 3 if ideal_platform else STEP_NOISE_DRAWS),
            seed=lab.config.seed + number,
        ).method[method]
        found.append(one)
        scatters.append(one.document_px * one.scatter_px)
    parts = {label: [getattr(one, name) for one in found] for label, name in _STEP_PARTS.items()}
    parts |= {label: [one.cause_px[key] for one in found] for label, key in _CAUSES.items()}
    parts |= {"noise": [np.hypot(one.temporal_px, one.dark_px) for one in found]}
    mean = {label: np.sqrt(np.mean(np.square(values), axis=0)) for label, values in parts.items()}
    whole = mean["document"]
    spread = np.sqrt(np.square(scatters).mean(0) / lab.config.steps.places) / np.maximum(whole, 1e-300)
    causes = {label: mean[label] * scale for label in _CAUSES}
    causes |= {"averaged noise": mean["noise"] * scale, "roll of the platform": mean["roll"] * scale}
    return Value(arcsec=whole * scale, uncertainty_arcsec=spread * scale), causes, mean["single"] * scale


def noise_draws(lab: Laboratory, wanted: int) -> int:
    """Noisy copies behind mean centroids; a fit of the true PSF has no bias that noise could change."""
    return 0 if needs_epsf(lab.bench.methods[0]) else wanted


_STEP_PARTS = {"document": "document_px", "single": "single_px", "roll": "roll_px"}
_CAUSES = {"S-curve": "s_curve", "PRNU": "prnu", "offset pattern": "pattern", "defects": "defects"}


def _predicted_distortion(lab: Laboratory, psfs: Psfs, draws: int, seed: int) -> tuple[FloatArray, FloatArray]:
    """sigma_d, sigma_Dd, sigma_C1 (3, 2) [px], and the scatter of their RMS over the surveys of a chip and a run."""
    bench, grid, target = lab.bench, lab.config.grid, grid_target(lab)
    direction = grid_directions(target, lab.instrument, _grid_streams(lab).generator("target"))
    predicted = predict_distortion(
        bench,
        lab.instrument,
        target,
        direction,
        psf=psfs.of(lab, bench, "grid", direction),
        order=grid.order,
        references=(grid.reference,),
        noise_draws=noise_draws(lab, 2 * draws),
        defect=sensor_maps(lab.instrument.detector).defect,
        seed=seed,
    )
    method = bench.methods[0]
    spread = predicted.of_surveys_px(method, grid.reference, grid.surveys)
    return predicted.mean_px[method][grid.reference], spread


def _grid_streams(lab: Laboratory) -> Streams:
    """The target is one piece of hardware: the same for prediction and measurement."""
    return Streams(lab.config.seed).child("budget", "grid")


def measure_terms(
    lab: Laboratory,
    *,
    advance: Callable[[], None] = lambda: None,
    streams: Streams | None = None,
) -> Measurement:
    """Run the virtual laboratory for every term.

    Parameters
    ----------
    lab : Laboratory
        The laboratory.
    advance : callable
        Called after every piece of work (`steps_of` of them).
    streams : Streams, optional
        Root of the noise; from the seed of the configuration if left out.

    Raises
    ------
    DomainError
        On points that are not detected, saturated or off the detector.
    """
    root = streams or Streams(lab.config.seed).child("budget", "measured")
    bench, instrument = lab.bench, lab.instrument
    method, scale = bench.methods[0], 3.0 * instrument.pixel_arcsec
    scene = point_scene(bench, instrument)
    temporal = measure_temporal(bench, instrument, streams=root.child("TE"), scene=scene)
    advance()
    te = temporal.te_arcsec(method)
    hsfe, single, places = _measured_steps(lab, scene, root.child("HSFE"), advance)
    chromatic = measured_term(lab, root.child("LSFE-S"), advance=advance)
    grid = lab.config.grid
    distortion = measure_distortion(
        bench,
        instrument,
        grid_target(lab),
        order=grid.order,
        surveys=grid.surveys,
        streams=_grid_streams(lab),
        scene=scene,
        advance=advance,
    )
    every = distortion.over_surveys(method, grid.reference) * scale
    found = np.sqrt((every**2).mean(0))
    spread = every.std(0, ddof=1) if len(every) > 1 else np.full((3, 2), np.nan)
    budget = combine(
        {
            "TE": _of_measured(te),
            "HSFE": hsfe,
            "LSFE-S": chromatic.value(),
            "LSFE-C1": Value(
                arcsec=found[2],
                uncertainty_arcsec=spread[2] / np.sqrt(len(every)),
                n=len(every) * grid.rows * grid.columns,
            ),
            "LSFE-C2": marking(lab),
        },
        stars=lab.config.attitude.stars,
    )
    return Measurement(
        budget=budget,
        single_arcsec=single,
        left_arcsec=found[1],
        found_arcsec=found[0],
        one_survey_arcsec=every[0, 2],
        survey_scatter_arcsec=spread[2],
        places_arcsec=places,
        chromatic=chromatic,
    )


def steps_of(lab: Laboratory) -> int:
    """How often `measure_terms` calls ``advance``."""
    return 1 + lab.config.steps.places * lab.config.steps.positions + 4 + 2


def _of_measured(pair: Sequence[Any]) -> Value:
    return Value(
        arcsec=np.array([one.value for one in pair]),
        uncertainty_arcsec=np.array([one.uncertainty for one in pair]),
        n=int(pair[0].n),
    )


def _measured_steps(
    lab: Laboratory, scene: PointScene, streams: Streams, advance: Callable[[], None]
) -> tuple[Value, FloatArray, FloatArray]:
    """HSFE over all places (RMS), of one position, and of every place (q, 2)."""
    method, scale = lab.bench.methods[0], 3.0 * lab.instrument.pixel_arcsec
    squares, errors, single, count = [], [], [], 0
    for number, place in enumerate(places_px(lab)):
        found = measure_high_frequency(
            lab.bench,
            lab.instrument,
            platform(lab),
            step_plan(lab),
            place_px=place.tolist(),
            split=False,
            streams=streams.child(f"place {number}"),
            scene=scene,
            advance=advance,
        )
        pair = found.document_arcsec(method)
        squares.append([one.value**2 for one in pair])
        errors.append([2.0 * one.value * (one.uncertainty or 0.0) for one in pair])
        single.append((found.single_px(method) * scale) ** 2)
        count += int(pair[0].n or 0)
    mean = np.mean(squares, axis=0)
    value = np.sqrt(mean)
    spread = np.sqrt((np.array(errors) ** 2).sum(0)) / len(errors) / np.maximum(2.0 * value, 1e-300)
    return (
        Value(arcsec=value, uncertainty_arcsec=spread, n=count),
        np.sqrt(np.mean(single, axis=0)),
        np.sqrt(np.array(squares)),
    )
