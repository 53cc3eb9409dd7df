"""The terms of one instrument and one centroider: predicted without frames, measured in the virtual laboratory.

`predict` and `measure` fill these records, one for each centroider; the frames are the same for all. Where the
document's test is one sample of something random (one path of the platform, one survey of the target), the measurement
is repeated and its RMS taken, so that its uncertainty is small against 10 %.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from experiments.budget.chromatic import ChromaticTerm
from experiments.budget.combine import Budget, Value
from experiments.budget.laboratory import Laboratory
from experiments.laboratory.bench import Bench
from experiments.laboratory.centroid_methods import has_own_epsf
from experiments.laboratory.hexapod import Hexapod
from experiments.laboratory.high_frequency import StepPlan
from experiments.laboratory.point_scene import point_scene
from experiments.laboratory.targets import GridTarget
from optics.arrays import FloatArray
from render.engine.random import Streams
from render.records import EffectivePsf

__all__ = [
    "Measurement",
    "PredictedTerms",
    "Psfs",
    "grid_streams",
    "grid_target",
    "marking",
    "places_px",
    "platform",
    "step_plan",
]


@dataclass(frozen=True, slots=True, kw_only=True)
class PredictedTerms:
    """A budget without frames."""

    budget: Budget  # The terms
    bound_te_arcsec: FloatArray  # (2,) Cramer-Rao bound of the temporal error
    causes_arcsec: Mapping[str, FloatArray]  # (2,) What is in the HSFE, 3 sigma
    single_arcsec: FloatArray  # (2,) HSFE of one position, without temporal noise
    left_arcsec: FloatArray  # (2,) sigma_Dd (left by the polynomial) and sigma_d (found), 3 sigma
    found_arcsec: FloatArray  # (2,) sigma_Dd (left by the polynomial) and sigma_d (found), 3 sigma
    # (2,) sigma_C1 of a perfect camera and frames without noise: what the polynomial takes of the marking errors
    marking_alone_arcsec: FloatArray
    chromatic: ChromaticTerm  # Table 1
    window_px: int  # Window around a point


@dataclass(frozen=True, slots=True, kw_only=True)
class Measurement:
    """A budget from frames."""

    budget: Budget  # The terms
    single_arcsec: FloatArray  # (2,) HSFE of one position against the truth, without temporal noise
    left_arcsec: FloatArray  # (2,) sigma_Dd and sigma_d, 3 sigma, RMS over the surveys
    found_arcsec: FloatArray  # (2,) sigma_Dd and sigma_d, 3 sigma, RMS over the surveys
    # (2,) sigma_C1 of the first survey alone: what a laboratory that surveys once would print
    one_survey_arcsec: FloatArray
    survey_scatter_arcsec: FloatArray  # (2,) Standard deviation of that from survey to survey
    # (2,) Scatter of the surveyed coordinates about the true ones, 3 sigma, over points and surveys
    surveyed_arcsec: FloatArray
    places_arcsec: FloatArray  # (q, 2) HSFE of every place
    chromatic: ChromaticTerm  # Table 1


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
        keys = (
            *(config.instrument, config.moved, config.target, config.source, config.filters, config.grid),
            config.collimator,
        )
        scale = {"signal_e": None, "magnitude_mag": None}
        light = [part.model_copy(update=scale) if part is config.source else part for part in keys]
        own = all(has_own_epsf(method) for method in bench.methods)  # PSFs of a target may not be needed
        key = repr((what, light, config.detector.diffusion_sigma_um, bench.window_px, own))
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


def marking(lab: Laboratory) -> Value:
    """The marking error of the target, an input."""
    return Value(arcsec=np.full(2, 3.0 * lab.config.grid.marking_error_arcsec))


def grid_streams(lab: Laboratory) -> Streams:
    """The target is one piece of hardware: the same for prediction and measurement."""
    return Streams(lab.config.seed).child("budget", "grid")
