"""Record of the temporal-error test, and the signal that the published number belongs to."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from experiments.laboratory.bench import Bench
from experiments.laboratory.collimator_effects import LineOfSight
from experiments.laboratory.instrument import Instrument
from experiments.laboratory.known_motion import ShakenTarget
from experiments.laboratory.published import ACC18_ARCSEC
from experiments.laboratory.temporal_error import TemporalMeasurement, TemporalPrediction, predict_temporal
from experiments.temporal.settings import Config
from optics.arrays import FloatArray
from render.records import EffectivePsf

__all__ = ["Result", "published_levels"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Result:
    """Everything the run found."""

    config: Config  # Settings
    instrument: Instrument  # The camera
    measured: TemporalMeasurement  # At the levels of the brightness control
    nominal: TemporalMeasurement  # At the signal of the source
    predicted: TemporalPrediction  # At the levels of the brightness control
    predicted_nominal: TemporalPrediction  # At the signal of the source
    shaken: ShakenTarget  # At the signal of the source, the target moved by a known amount while frames were taken
    sight: LineOfSight | None  # Of the collimator; None at rest
    # (2,) Signal at which each centroider would show the published numbers, x and y, by prediction; NaN outside 50 to
    # 2e4. Empty for another sensor than the published one
    published_level_e: Mapping[str, FloatArray]


def published_levels(
    bench: Bench, instrument: Instrument, psf: Sequence[EffectivePsf], place_px: Sequence[float] | None
) -> dict[str, FloatArray]:
    """Signal (2,) [e-] at which each centroider has the published temporal error, by the influence function.

    Between a few levels ln(TE) is interpolated in ln(signal), along which it bends but little.
    """
    few = np.geomspace(50.0, 20000.0, 9)
    found = predict_temporal(bench, instrument, psf=psf, levels_e=few, place_px=place_px, draws=0)
    out = {}
    for method in bench.methods:
        te = np.stack([found.te_arcsec(method, level) for level in range(len(few))])
        out[method] = np.array([_crossing(few, te[:, axis], wanted) for axis, wanted in enumerate(ACC18_ARCSEC["TE"])])
    return out


def _crossing(signal_e: FloatArray, te_arcsec: FloatArray, wanted: float) -> float:
    """Signal at which a falling curve has a value, from bright to faint; NaN where it never has."""
    for low in range(len(signal_e) - 2, -1, -1):  # a threshold may leave nothing of a faint star
        above, below = te_arcsec[low], te_arcsec[low + 1]
        if below < wanted <= above:
            part = np.log(wanted / below) / np.log(above / below)
            return float(signal_e[low + 1] * (signal_e[low] / signal_e[low + 1]) ** part)
    return float("nan")
