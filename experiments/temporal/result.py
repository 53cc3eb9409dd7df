"""Record of the temporal-error test, and the signal that the published number belongs to."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from experiments.laboratory.bench import Bench
from experiments.laboratory.instrument import Instrument
from experiments.laboratory.published import ACC18_ARCSEC
from experiments.laboratory.temporal_error import TemporalMeasurement, TemporalPrediction, predict_temporal
from experiments.temporal.settings import Config
from optics.arrays import FloatArray
from render.records import EffectivePsf

__all__ = ["Result", "level_for"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Result:
    """Everything the run found.

    Attributes
    ----------
    config : Config
        Settings.
    instrument : Instrument
        The camera.
    measured, predicted : TemporalMeasurement, TemporalPrediction
        At the levels of the brightness control.
    nominal, predicted_nominal : TemporalMeasurement, TemporalPrediction
        At the signal of the source.
    published_level_e : dict of str to (2,)
        Signal at which each centroider would show the published numbers, x and y, by prediction; NaN outside 50 to 2e4.
    """

    config: Config
    instrument: Instrument
    measured: TemporalMeasurement
    nominal: TemporalMeasurement
    predicted: TemporalPrediction
    predicted_nominal: TemporalPrediction
    published_level_e: Mapping[str, FloatArray]


def level_for(
    bench: Bench,
    instrument: Instrument,
    psf: Sequence[EffectivePsf],
    place_px: Sequence[float] | None,
    method: str,
) -> FloatArray:
    """Signal (2,) [e-] that gives the published temporal error, by the influence function on a few levels.

    Between them ln(TE) is interpolated in ln(signal), along which it bends but little.
    """
    few = np.geomspace(50.0, 20000.0, 9)
    one = replace(bench, methods=(method,), window_px=bench.window_px)
    found = predict_temporal(one, instrument, psf=psf, levels_e=few, place_px=place_px, draws=0)
    te = np.stack([found.te_arcsec(method, level) for level in range(len(few))])
    out = np.full(2, np.nan)
    for axis, wanted in enumerate(ACC18_ARCSEC["TE"]):
        for low in range(len(few) - 2, -1, -1):  # from bright to faint: a threshold may leave nothing of a faint star
            above, below = te[low, axis], te[low + 1, axis]
            if below < wanted <= above:
                part = np.log(wanted / below) / np.log(above / below)
                out[axis] = few[low + 1] * (few[low] / few[low + 1]) ** part
                break
    return out
