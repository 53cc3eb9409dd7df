"""Tables of the distortion test, for the report and as ECSV files."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from experiments.harness.pivot import Pivot
from experiments.harness.quantities import Outcome
from experiments.laboratory.distortion_statistics import REFERENCES

__all__ = ["tables"]


def tables(outcome: Outcome) -> Mapping[str, Pivot]:
    """Tables by file name."""
    config, beside = outcome.config, ""
    if "published_arcsec" in outcome.data:
        x, y = outcome.values("published_arcsec")
        beside = f"; published for σC1: {x}″ in x, {y}″ in y"
    coordinates = "; ".join(f"{name}: {text}" if name != "nominal" else text for name, text in REFERENCES.items())
    every = Pivot(
        rows="method reference number axis",
        columns="one_survey_arcsec all_surveys_arcsec predicted_arcsec",
        caption=f"The document's three numbers (3 σ){beside}.",
        note=f"*Coordinates*: how surveyed places become pixels; nominal: {coordinates}. *All surveys*: RMS and "
        f"scatter over {config.surveys} independent surveys of the same target, same frames.",
    )
    return {
        "distortion": replace(every, where={"method": config.methods[:1]}),
        "centroiders": every,
        "map": Pivot(
            rows="reference axis",
            columns="map_uncorrected_arcsec map_one_survey_arcsec map_all_surveys_arcsec",
            caption="The true map (3 σ of its RMS over the whole detector, shift and roll taken out): before and after "
            "the correction.",
        ),
        "wide_field": Pivot(
            rows="number axis",
            columns="wide_measured_arcsec wide_predicted_arcsec wide_marking_arcsec",
            caption="A lens whose distortion decides the numbers (3 σ): one survey, shift, roll and scale fitted.",
        ),
        "forecasts": Pivot(
            rows="forecast",
            hidden="forecast",
            columns="forecast_points forecast_order distortion_left_arcsec errors_carried_arcsec map_error_arcsec",
            caption="Map error (3 σ, mean square of both axes) to be expected of other grids and polynomials.",
        ),
        "points": Pivot(
            rows="point",
            across="axis",
            columns="nominal_px measured_px light_px ray_trace_px d_px left_px",
            caption=f"All points, {outcome.names('method')[0]}, {config.reference}.",
        ),
    }
