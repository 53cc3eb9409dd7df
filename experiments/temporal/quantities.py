"""The numbers of the temporal-error test, each described once."""

from __future__ import annotations

from typing import Any

import numpy as np

from experiments.harness.quantities import Quantities
from experiments.harness.summary import Measured
from experiments.laboratory.collimator_effects import add_line_of_sight
from experiments.laboratory.point_quantities import point_quantities
from experiments.laboratory.point_scene import point_signal
from experiments.laboratory.published import ACC18_ARCSEC, is_published_sensor
from experiments.laboratory.signal import add_signal
from experiments.laboratory.temporal_error import TemporalMeasurement, TemporalPrediction, small_sample_factor
from experiments.temporal.result import Result

__all__ = ["describe", "ratio"]


def ratio(
    measured: TemporalMeasurement, predicted: TemporalPrediction, method: str, level: int
) -> tuple[Measured, Measured]:
    """Measured over predicted (drawn noise, small-sample factor included), x and y.

    The uncertainty holds the N frames, the finite draws and the difference from chip to chip.
    """
    c4 = small_sample_factor(measured.frames)
    expected, spread = predicted.sampled_te_arcsec(method, level) * c4, predicted.te_uncertainty_arcsec(method, level)
    out = []
    for axis, one in enumerate(measured.te_arcsec(method, level)):
        value = one.value / float(expected[axis])
        error = value * np.hypot((one.uncertainty or 0.0) / one.value, spread[axis] * c4 / expected[axis])
        out.append(Measured(value=value, uncertainty=float(error), n=one.n))
    return out[0], out[1]


def describe(result: Result) -> Quantities:
    """Quantities of a run: at the signal of the source, at every level, star by star."""
    methods = result.config.methods
    q = point_quantities(methods)
    _nominal(q, result)
    _levels(q, result)
    if is_published_sensor(result.config):
        published, place = ACC18_ARCSEC["TE"], "published_arcsec_3sigma"
        q.add("published_arcsec", published, "Published", unit="arcsec", dims="axis", json=place)
        faint, place = [result.published_level_e[m] for m in methods], "signal_that_gives_the_published_e"
        label = "Signal that gives the published error"
        q.add("published_signal_e", faint, label, unit="e-", dims="method axis", json=place)
    signal = point_signal(result.config, result.instrument)
    add_signal(q, signal)
    magnitude = [signal.magnitude_of(level) for level in result.measured.levels_e]
    described = {"unit": "mag", "dims": "level", "format": ".2f", "key": "magnitude_mag"}
    q.add("level_magnitude_mag", magnitude, "V", **described, json="levels[level].magnitude_mag")
    _stars(q, result)
    if result.sight is not None:
        add_line_of_sight(q, result.sight)
    q.add("frames", result.measured.frames, "Frames")
    q.add("stars", len(result.measured.light), "Stars")
    q.add("pixel_arcsec", result.measured.pixel_arcsec, "Angle of a pixel", unit="arcsec")
    return q


def _errors(measured: TemporalMeasurement, predicted: TemporalPrediction) -> tuple[tuple[Any, ...], ...]:
    """Name, label and format of each temporal error, its places in the summary, and (method, level) -> (x, y)."""
    return (
        ("dark_arcsec", "Dark sub.", "", "temporal_error", "measured", measured.te_arcsec),
        ("raw_arcsec", "Raw", "", "raw", "raw", lambda method, level: measured.te_arcsec(method, level, "raw")),
        ("influence_arcsec", "Influence", ".4f", "predicted_linear", "linear", predicted.te_arcsec),
        ("drawn_arcsec", "Drawn noise", ".4f", "predicted", "predicted", predicted.sampled_te_arcsec),
    )


def _nominal(q: Quantities, result: Result) -> None:
    """At the signal of the source, by every centroider."""
    methods, measured, predicted = result.config.methods, result.nominal, result.predicted_nominal
    for name, label, format, json, _, of in _errors(measured, predicted):
        described = {"unit": "arcsec", "dims": "method axis", "format": format, "json": f"{json}_arcsec_3sigma"}
        q.add(name, [of(m, 0) for m in methods], label, **described)
    q.add("ratio", [ratio(measured, predicted, m, 0) for m in methods], "Ratio", dims="method axis")
    bound, place = predicted.bound_te_arcsec(), "cramer_rao_arcsec_3sigma"
    q.add("bound_arcsec", bound, "Cramér-Rao", unit="arcsec", dims="axis", json=place)


def _levels(q: Quantities, result: Result) -> None:
    """Against signal (ACC18 Fig. 5)."""
    methods, measured, predicted = result.config.methods, result.measured, result.predicted
    levels = range(len(measured.levels_e))
    q.axis("level", measured.levels_e, "Signal", unit="e-", format=".0f", key="signal_e")
    q.add("level_signal_e", measured.levels_e, "Signal", unit="e-", dims="level", json="levels[level].signal_e")
    for name, label, format, _, json, of in _errors(measured, predicted):
        described = {"unit": "arcsec", "dims": "level method axis", "format": format, "key": name}
        values = [[of(m, n) for m in methods] for n in levels]
        q.add(f"level_{name}", values, label, **described, json=f"levels[level].methods[method].{json}")
    bound = [predicted.bound_te_arcsec(n) for n in levels]
    described = {"unit": "arcsec", "dims": "level axis", "key": "cramer_rao_arcsec"}
    q.add("level_bound_arcsec", bound, "Cramér-Rao", **described, json="levels[level].cramer_rao")
    ratios = [[ratio(measured, predicted, m, n) for m in methods] for n in levels]
    q.add("level_ratio", ratios, "Measured / predicted", dims="level method axis", json="")


def _stars(q: Quantities, result: Result) -> None:
    """Every star at the signal of the source, by the centroider that counts."""
    first, nominal, predicted = result.config.methods[0], result.nominal, result.predicted_nominal
    q.axis("star", np.arange(len(nominal.light)) + 1, "Star")
    for key, label, values in (
        ("light", "Light", nominal.light.photon_px),
        ("sigma", "Measured σ", nominal.sigma_px["dark"][first][0]),
        ("predicted", "Predicted σ", predicted.sampled_px[first][0]),
        ("bound", "Cramér-Rao σ", predicted.bound_px[0]),
    ):
        q.add(f"star_{key}_px", values, label, unit="px", dims="star axis", key=f"{key}_{{axis}}_px", json="")
