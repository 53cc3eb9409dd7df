"""The numbers of the distortion test, each described once; arcsec, 3 sigma."""

from __future__ import annotations

from typing import Any

import numpy as np

from experiments.distortion.result import Result
from experiments.harness.quantities import Quantities, Quantity
from experiments.laboratory.distortion_statistics import LABELS, REFERENCES
from experiments.laboratory.point_quantities import point_quantities
from experiments.laboratory.point_scene import point_signal
from experiments.laboratory.published import ACC18_ARCSEC, is_published_sensor
from experiments.laboratory.signal import add_signal
from optics.arrays import FloatArray

__all__ = ["describe"]


def describe(result: Result) -> Quantities:
    """Quantities of a run: the document's numbers, the true map, forecasts, point by point."""
    config = result.config
    q = point_quantities(config.methods)
    add_signal(q, point_signal(config, result.instrument))
    q.axis("reference", list(REFERENCES), "Coordinates")
    q.axis("number", ["sigma_d", "sigma_left", "sigma_c1"], "Number", names=LABELS)
    _numbers(q, result)
    if is_published_sensor(config):
        published, place = ACC18_ARCSEC["LSFE-C1"], "published_sigma_c1_arcsec_3sigma"
        q.add("published_arcsec", published, "Published σC1", unit="arcsec", dims="axis", json=place)
    marking = 3.0 * config.target.marking_error_arcsec
    removed = np.sqrt((result.terms - 1) / (config.target.rows * config.target.columns - 1))
    for name, value, label, json in (
        ("marking_arcsec", marking, "Marking error", "marking_error"),
        # what k terms remove of pure noise at W points: sqrt((k - 1) / (W - 1)) of it
        ("noise_removed_arcsec", marking * removed, "Marking error alone", "sigma_c1_of_marking_error_alone"),
    ):
        q.add(name, value, label, unit="arcsec", format=".2f", json=f"{json}_arcsec_3sigma")
    if is_published_sensor(config):
        value, place = ACC18_ARCSEC["LSFE-C2"][0], "published_marking_error_arcsec_3sigma"
        q.add("published_marking_arcsec", value, "Published marking error", unit="arcsec", format=".2f", json=place)
    _maps(q, result)
    _forecasts(q, result)
    _points(q, result)
    _wide(q, result)
    q.add("points", config.target.rows * config.target.columns, "Points")
    q.add("frames", result.measured.frames, "Frames")
    q.add("pixel_arcsec", result.instrument.pixel_arcsec, "Angle of a pixel", unit="arcsec")
    return q


def _numbers(q: Quantities, result: Result) -> None:
    """Found, left and removed, by centroider and coordinates: of the survey that counts, of all surveys, predicted."""
    methods, measured, scale = result.config.methods, result.measured, result.scale
    statistics = [[measured.statistics(m, r) for r in REFERENCES] for m in methods]
    one = scale * np.array([[[s.sigma_d_px, s.sigma_left_px, s.sigma_c1_px] for s in row] for row in statistics])
    every = scale * np.array([[measured.over_surveys(m, r) for r in REFERENCES] for m in methods])
    expected, scatter = (
        scale * np.array([[of[m][r] for r in REFERENCES] for m in methods])
        for of in (result.predicted.mean_px, result.predicted.scatter_px)
    )
    of_surveys = scale * np.array(
        [[result.predicted.of_surveys_px(m, r, result.config.surveys) for r in REFERENCES] for m in methods]
    )
    rms, spread = np.sqrt((every**2).mean(2)), every.std(2, ddof=1)
    place = "methods_arcsec_3sigma[method][reference][number]."
    all_surveys = {"error": spread, "json": f"{place}over_surveys", "json_error": f"{place}scatter_of_surveys"}
    angle: dict[str, Any] = {"unit": "arcsec", "dims": "method reference number axis"}
    q.add("one_survey_arcsec", one, "One survey", **angle, format=".3f", json=f"{place}one_survey")
    q.add("all_surveys_arcsec", rms, "All surveys", **angle, **all_surveys)
    q.add(
        "predicted_arcsec",
        expected,
        "Predicted",
        **angle,
        error=of_surveys,
        json=f"{place}predicted",
        json_error=f"{place}predicted_scatter_over_surveys",
    )
    q.add("predicted_scatter_arcsec", scatter, "Predicted scatter from survey to survey", **angle, json="")
    _counting(q, result, every[0, list(REFERENCES).index(result.config.reference), :, 2])


def _counting(q: Quantities, result: Result, every: FloatArray) -> None:
    """sigma_C1 by the centroider and the coordinates that count, and of every survey (q, 2)."""
    part = {"method": result.config.methods[0], "reference": result.config.reference, "number": "sigma_c1"}
    place = "sigma_c1_arcsec_3sigma."
    for name, json in (("one_survey", "one_survey"), ("all_surveys", "over_surveys"), ("predicted", "predicted")):
        one = Quantity.of(q.dataset.sel(part), f"{name}_arcsec")
        places = {"json": place + json, "json_error": f"{place}scatter_of_surveys"}
        q.add(f"c1_{name}_arcsec", one.values, "σC1", unit="arcsec", dims="axis", error=one.error, **places)
    q.add("survey_c1_arcsec", every, "σC1, 3 σ", unit="arcsec", dims="survey axis", json="")
    if not is_published_sensor(result.config):
        return
    above = 100.0 * (every >= np.array(ACC18_ARCSEC["LSFE-C1"])).mean(0)
    q.add("surveys_above_published", above, "Surveys that reach the published value", unit="%", dims="axis", json="")


def _maps(q: Quantities, result: Result) -> None:
    """True error of the correction over the whole detector."""
    maps = [result.maps[reference] for reference in REFERENCES]
    for name, label, json, px in (
        ("uncorrected", "Distortion", "uncorrected", [one.first.uncorrected_rms_px for one in maps]),
        ("one_survey", "Left, one survey", "one_survey", [one.first.rms_px for one in maps]),
        ("all_surveys", "Left, all surveys", "over_surveys", [np.sqrt((one.rms_px**2).mean(0)) for one in maps]),
    ):
        described = {"unit": "arcsec", "dims": "reference axis", "format": ".3f", "key": f"{name}_arcsec"}
        place = f"true_map_arcsec_3sigma[reference].{json}"
        q.add(f"map_{name}_arcsec", result.scale * np.array(px), label, **described, json=place)


def _forecasts(q: Quantities, result: Result) -> None:
    """Map errors to be expected of other grids and polynomials, per axis and as the mean square of both axes."""
    forecasts, place = result.forecast, "forecasts[forecast]."
    for name, label, numbers in (
        ("points", "Points", [one.points for one in forecasts]),
        ("order", "Order", [one.order for one in forecasts]),
    ):
        q.add(f"forecast_{name}", numbers, label, dims="forecast", key=name, json=place + name)
    for name, label, json, px in (
        ("distortion_left", "Distortion left", "distortion_left_arcsec_3sigma", [one.bias_px for one in forecasts]),
        ("errors_carried", "Errors carried in", "errors_carried_arcsec_3sigma", [one.noise_px for one in forecasts]),
        ("map_error", "Map error", "", [one.rms_px for one in forecasts]),
    ):
        axes = result.scale * np.array(px)
        at = json and place + json
        q.add(f"{name}_axes_arcsec", axes, label, unit="arcsec", dims="forecast axis", json=at)
        both = np.sqrt((axes**2).mean(1))
        q.add(f"{name}_arcsec", both, label, unit="arcsec", dims="forecast", format=".4f", json="")
    here = result.scale * result.forecast_here.rms_px
    q.add("forecast_arcsec", here, "Map error, forecast", unit="arcsec", dims="axis", json="forecast_map_arcsec_3sigma")


def _points(q: Quantities, result: Result) -> None:
    """Every target point, by the centroider and the coordinates that count."""
    first, light = result.config.methods[0], result.measured.light
    s = result.measured.statistics(first, result.config.reference)
    q.axis("point", np.arange(len(light)) + 1, "Point")
    for name, label, values in (
        ("nominal", "Nominal", light.nominal_px),
        ("measured", "Measured", result.measured.session_px[first][1]),
        ("light", "Light", light.photon_px),
        ("ray_trace", "Ray trace", result.predicted.bundle_px),
        ("d", "d", s.d_px),
        ("left", "Left", s.left_px),
    ):
        q.add(f"{name}_px", values, label, unit="px", dims="point axis", key=f"{name}_{{axis}}_px", json="")


def _wide(q: Quantities, result: Result) -> None:
    """The test on the wide field: one survey, shift, roll and scale fitted."""
    wide = result.wide
    scale, place = wide.measured.arcsec_3sigma, "wide_field_arcsec_3sigma[number][axis]"
    angle: dict[str, Any] = {"unit": "arcsec", "dims": "number axis", "format": ".3f"}
    q.add("wide_measured_arcsec", scale * wide.numbers_px, "Measured", **angle, json=f"{place}.measured")
    q.add(
        "wide_predicted_arcsec",
        scale * wide.expected_px,
        "Prescription",
        unit="arcsec",
        dims="number axis",
        error=scale * wide.scatter_px,
        json=f"{place}.predicted",
        json_error=f"{place}.predicted_scatter",
    )
    q.add(
        "wide_marking_arcsec", scale * wide.marking_px, "Marking errors alone", **angle, json=f"{place}.marking_alone"
    )
