"""The numbers of the chromatic test, each described once."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from experiments.chromatic.result import Result
from experiments.harness.quantities import Quantities
from experiments.harness.summary import Measured
from experiments.laboratory.centroid_methods import MethodLabels
from experiments.laboratory.chromatic_error import ChromaticReduction, rms
from experiments.laboratory.collimator_effects import add_chromatic_effect
from experiments.laboratory.published import ACC18_ARCSEC, ACC18_TABLE1_PX, is_published_sensor
from experiments.laboratory.signal import add_signal
from optics.arrays import FloatArray

__all__ = ["describe"]

XY = ["x", "y"]
RULES = ("one third of half the RMS filter shift", "one third of half the largest filter shift")


def describe(result: Result) -> Quantities:
    """Quantities of a run: of both lenses, of the movements that were searched, of single points, of stars."""
    q, config = Quantities(), result.config
    q.axis("lens", ["centred", "moved"], "Lens", names=["centred", result.chosen.label])
    q.axis("pair", [name for name, _, _ in result.pairs], "Bands", unit="nm", key="bands")
    q.axis("axis", XY, "Axis", names=["X", "Y"])
    own, reference = "PSF of each filter", "PSF of the reference filter"
    q.axis("method", result.bench.methods, "Centroider", names=MethodLabels(own=own, reference=reference))
    steps = list(result.centred.residual_px[result.pairs[0][0]])
    q.axis("step", [step.replace(" ", "_") for step in steps], "Calibration", names=steps)
    q.axis("band", [f"{centre:g}" for centre in config.filters.centres_nm], "Band", unit="nm")
    _table1(q, result)
    _statistics(q, result)
    _methods(q, result)
    _movements(q, result)
    _points(q, result)
    _stars(q, result)
    radius_um = result.centred.measurement.rms_spot_um
    q.add("rms_spot_um", radius_um, "RMS spot radius", unit="um", dims="band", format=".1f")
    add_signal(q, result.signal)
    q.add("pixel_arcsec", result.instrument.pixel_arcsec, "Angle of a pixel", unit="arcsec")
    if result.collimator is not None:
        add_chromatic_effect(q, result.collimator)
    return q


def _places(name: str, moved: str = "measured.") -> dict[str, str]:
    """Where ``summary.json`` has a quantity of the centred lens, and of the one with the moved element."""
    return {"centred": name, "moved": f"decentre_solution.{moved}{name}"}


def _of_both(result: Result, part: Callable[[ChromaticReduction], Any]) -> FloatArray:
    """A part of the reduction, by pair of bands if it is so, for both lenses."""
    found = [part(one) for one in (result.centred, result.moved)]
    return np.array([[v[name] for name, _, _ in result.pairs] if isinstance(v, dict) else v for v in found])


def _table1(q: Quantities, result: Result) -> None:
    """ACC18's statistic (eq. 16) and the error that the document makes of it."""
    found = result.centred.measurement.nominal_px
    count = result.config.frames * found.shape[0] * found.shape[1]
    entry = {"unit": "px", "dims": "lens pair axis"}
    nothing = (np.nan, np.nan)
    if is_published_sensor(result.config):
        published = [ACC18_TABLE1_PX.get(name, nothing) for name, _, _ in result.pairs]
        q.add("published_px", published, "Published", unit="px", dims="pair axis", format=".4f", json="")
    q.add(
        "table1_px",
        _of_both(result, lambda e: e.table1_px),
        "Measured",
        **entry,
        error=_of_both(result, lambda e: e.table1_sigma_px),
        key="measured_px",
        json=_places("table1_px"),
        json_error=_places("table1_sigma_px"),
    )
    q.add("table1_n", [count, count], "Frames behind an entry", dims="lens", json=_places("table1_n"))
    for name, label, key, part in (
        ("predicted", "Ray trace", "ray_trace_px", lambda e: e.predicted_table1_px),
        ("photon", "Noiseless light", "photon_px", lambda e: e.photon_table1_px),
        ("bundle", "Traced bundles", "bundle_px", lambda e: e.bundle_table1_px),
    ):
        place = f"{name}_table1_px"
        q.add(place, _of_both(result, part), label, **entry, format=".5f", key=key, json=_places(place))
    q.add(
        "lsfe_arcsec",
        [[_lsfe(result, one, axis, count) for axis in range(2)] for one in (result.centred, result.moved)],
        "Chromatic LSFE, 3 σ",
        dims="lens axis",
        json=_places("lsfe_s_arcsec_3sigma", moved=""),
    )
    if is_published_sensor(result.config):
        of = ACC18_ARCSEC["LSFE-S"]
        q.add("published_lsfe_arcsec", of, "Published", unit="arcsec", dims="axis", json="")


def _lsfe(result: Result, evaluation: ChromaticReduction, axis: int, count: int) -> Measured:
    """ACC18's chromatic LSFE, 3 sigma: the largest entry of Table 1, divided by 3, times 3, as an angle."""
    scale = result.instrument.pixel_arcsec
    name = max(evaluation.table1_px, key=lambda n: abs(evaluation.table1_px[n][axis]))
    value, sigma = abs(evaluation.table1_px[name][axis]), evaluation.table1_sigma_px[name][axis]
    return Measured(value=float(value * scale), unit="arcsec", uncertainty=float(sigma * scale), n=count)


def _statistics(q: Quantities, result: Result) -> None:
    """Of the shifts of single points, of both lenses."""
    q.add(
        "rms_shift_px",
        _of_both(result, lambda e: {name: rms(shift) for name, shift in e.shift_px.items()}),
        "RMS shift",
        unit="px",
        dims="lens pair axis",
        json=_places("rms_shift_px"),
    )
    for name, label, place, part in (
        ("residual_px", "RMS shift", "residual", lambda e: _steps(e.residual_px)),
        ("photon_residual_px", "RMS shift, no noise", "photon_residual", lambda e: _steps(e.photon_residual_px)),
    ):
        json = _places(f"{place}_after_calibration_px")
        values = _of_both(result, part)
        q.add(name, values, label, unit="px", dims="lens pair step", format=".4f", key="{step}_px", json=json)
    for name, place, label, unit, part in (
        ("largest_error_px", "truth_bias_px.max", "Largest error", "px", lambda e: e.truth_bias_px[0]),
        ("rms_error_px", "truth_bias_px.rms", "RMS error", "px", lambda e: e.truth_bias_px[1]),
        ("mean_squared_pull", "mean_squared_pull", "Mean squared pull", "", lambda e: e.chi2),
        ("largest_pull", "largest_pull", "Largest pull", "sigma", lambda e: e.largest_pull),
    ):
        q.add(name, _of_both(result, part), label, unit=unit, dims="lens", json=_places(place))


def _steps(residual: Mapping[str, Mapping[str, float]]) -> dict[str, list[float]]:
    return {pair: list(steps.values()) for pair, steps in residual.items()}


def _methods(q: Quantities, result: Result) -> None:
    """By every centroider, on the same frames."""
    measured, methods = result.centred.measurement, result.bench.methods
    error = [np.sqrt(((measured.mean_px[m] - measured.photon_px) ** 2).mean()) for m in methods]
    q.add(
        "method_noise_px",
        [np.sqrt((measured.sigma_px[m] ** 2).mean()) for m in methods],
        "Noise",
        unit="px",
        dims="method",
        format=".4f",
        key="noise_px",
        json="",
    )
    q.add("method_error_px", error, "RMS error", unit="px", dims="method", format=".4f", key="rms_bias_px", json="")
    q.add(
        "method_table1_px",
        _of_both(result, lambda e: [[e.method_table1_px[m][name] for name, _, _ in result.pairs] for m in methods]),
        "Table 1",
        unit="px",
        dims="lens method pair axis",
        json=_places("method_table1_px", moved=""),
    )


def _movements(q: Quantities, result: Result) -> None:
    """The movement that was rendered, and those of all elements."""
    chosen, solutions, every = result.chosen, result.solutions, "decentre_solution.all_elements[solution]"
    for name, label, part in (
        ("element", "Element", lambda s: s.element),
        ("kind", "Movement", lambda s: s.kind),
        ("amount", "Amount", lambda s: s.amount),
        ("unit", "Unit", lambda s: s.unit),
    ):
        q.add(f"moved_{name}", part(chosen), label, json=f"decentre_solution.{name}")
        values = [part(s) for s in solutions]
        q.add(f"solution_{name}", values, label, dims="solution", format=".1f", key="", json=f"{every}.{name}")
    shown = [s.shown_unit for s in solutions]
    q.add("solution_shown_unit", shown, "Unit", dims="solution", key="", json="")
    q.add("wanted_px", result.config.decentre.wanted_px, "Wanted", unit="px", json="decentre_solution.wanted_px")
    q.add(
        "solution_table1_px",
        [[s.table1_px[name] for name, _, _ in result.pairs] for s in solutions],
        "Table 1",
        unit="px",
        dims="solution pair axis",
        format=".4f",
        key="mean_{pair}_px",
        json=f"{every}.table1_px",
    )
    q.add(
        "solution_boresight_px",
        [s.boresight_px for s in solutions],
        "Image moves",
        unit="px",
        dims="solution axis",
        format=".1f",
        key="boresight_px",
        json=f"{every}.boresight_px",
    )


def _points(q: Quantities, result: Result) -> None:
    """Shift of every point (eq. 15), and what it is made of."""
    measured = result.centred.measurement
    q.add(
        "nominal_px",
        measured.nominal_px,
        "Nominal",
        unit="px",
        dims="position point axis",
        key="nominal_{axis}_px",
        json="",
    )
    shift = {"unit": "px", "dims": "lens pair position point axis", "json": ""}
    for name, label, part in (
        ("measured", "Measured shift", lambda e: e.shift_px),
        ("sigma", "Uncertainty", lambda e: e.shift_sigma_px),
        ("photon", "Noiseless light", lambda e: e.photon_shift_px),
        ("bundle", "Ray bundle", lambda e: e.bundle_shift_px),
        ("predicted", "Ray-trace prediction", lambda e: e.predicted_shift_px),
    ):
        q.add(f"{name}_shift_px", _of_both(result, part), label, **shift, key=f"{name}_{{axis}}_px")
    place = measured.nominal_px - result.instrument.camera.centre_px
    outward = place / np.linalg.norm(place, axis=-1, keepdims=True)
    for name, label, position in (
        ("paraxial", "Paraxial", result.paraxial_px),
        ("chief", "Chief ray", measured.chief_px),
        ("bundle", "All rays", measured.bundle_px),
    ):
        shifts = np.stack([position[..., high, :] - position[..., low, :] for _, high, low in result.pairs])
        radial = (shifts * outward).sum(-1).mean((1, 2))
        q.add(f"radial_{name}_px", radial, label, unit="px", dims="pair", format="+.4f", key=f"{name}_px", json="")
        if name == "paraxial":
            key = "paraxial_{axis}_px"
            dims = "pair position point axis"
            q.add("paraxial_shift_px", shifts, "Paraxial prediction", unit="px", dims=dims, key=key, json="")


def _stars(q: Quantities, result: Result) -> None:
    """Stars through the full pass band, and the rule of one third."""
    config, both = result.config.stars, (result.stellar, result.moved_stellar)
    centred, moved = both
    length = [np.linalg.norm(shift, axis=-1) for shift in result.field_shift_px.values()]
    q.add("reference_k", config.reference_k, "Reference star", unit="K", json="stellar.reference_k")
    kelvin = {"unit": "K", "format": ".0f"}
    q.axis("temperature", centred.temperature_k, "Temperature", **kelvin, key="temperature_k")
    place = {"dims": "temperature", "json": "stellar.temperature_k"}
    q.add("temperature_k", centred.temperature_k, "Temperature", **kelvin, **place)
    star = {"unit": "px", "format": ".4f"}
    q.add(
        "star_rms_px",
        [one.rms_px for one in both],
        "RMS shift",
        **star,
        dims="lens temperature",
        key="rms_px",
        json={"centred": "stellar.rms_shift_px", "moved": "stellar.moved_element.rms_shift_px"},
    )
    q.add(
        "star_max_px",
        centred.max_px,
        "Largest shift",
        **star,
        dims="temperature",
        key="max_px",
        json="stellar.max_shift_px",
    )
    q.add(
        "moved_star_mean_px",
        moved.mean_px,
        "Mean shift",
        **star,
        dims="temperature component",
        json="stellar.moved_element.mean_shift_px",
    )
    name = "most_different_rms_px"
    places = {"centred": f"stellar.{name}", "moved": f"stellar.moved_element.{name}"}
    apart = [one.most_different_rms_px for one in both]
    q.add(name, apart, "RMS distance of the two most different stars", **star, dims="lens", json=places)
    q.axis("rule", [rule.replace(" ", "_") for rule in RULES], "Rule", names=RULES)
    third = [max(np.sqrt((v**2).mean()) for v in length) / 6.0, max(v.max() for v in length) / 6.0]
    q.add("third_px", third, "A third of half the filter shift", **star, dims="rule", json="stellar.one_third_rule_px")
    q.add("star_e", result.star_e, "Star of V = 7.5", unit="e-", format=".0f", json="signal_of_v7_5_star_e")
