"""Tables of the distortion test, for the report and as ECSV files."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from experiments.distortion.evaluate import one_survey, over_surveys
from experiments.distortion.result import PUBLISHED_ARCSEC
from experiments.harness.summary import Measured
from experiments.harness.tables import Cell, Column, Table
from experiments.laboratory.distortion_statistics import REFERENCES
from experiments.laboratory.point_settings import METHOD_NAMES

if TYPE_CHECKING:
    from experiments.distortion.result import Result

__all__ = ["LABELS", "all_tables"]

LABELS = ("σδ, found", "σΔδ, left", "σC1, removed")


def _main(result: Result, methods: tuple[str, ...]) -> Table:
    rows: list[tuple[Cell, ...]] = []
    for method in methods:
        for reference in REFERENCES:
            one, (mean, spread) = one_survey(result, method, reference), over_surveys(result, method, reference)
            expected = result.scale * result.predicted.mean_px[method][reference]
            for n, label in enumerate(LABELS):
                for axis, letter in enumerate("xy"):
                    rows.append(
                        (
                            METHOD_NAMES[method],
                            reference,
                            label,
                            letter,
                            float(one[n, axis]),
                            Measured(value=float(mean[n, axis]), uncertainty=float(spread[n, axis])),
                            float(expected[n, axis]),
                        )
                    )
    return Table(
        columns=(
            "Centroider",
            "Coordinates",
            "Number",
            "Axis",
            Column(name="One survey", unit="″", key="one_survey_arcsec", format=".3f"),
            Column(name="All surveys", unit="″", key="all_surveys_arcsec"),
            Column(name="Predicted", unit="″", key="predicted_arcsec", format=".3f"),
        ),
        rows=rows,
        caption=f"The document's three numbers (3 σ); published for σC1: {PUBLISHED_ARCSEC[0]}″ in x, "
        f"{PUBLISHED_ARCSEC[1]}″ in y.",
        note="*Coordinates*: how surveyed places become pixels; nominal: "
        + "; ".join(f"{name}: {text}" if name != "nominal" else text for name, text in REFERENCES.items())
        + f". *All surveys*: RMS and scatter over {result.config.surveys} independent surveys of the same target, same "
        "frames.",
    )


def _maps(result: Result) -> Table:
    rows: list[tuple[Cell, ...]] = []
    for reference, one in result.maps.items():
        seen = np.sqrt((one.rms_px**2).mean(0))
        for axis, letter in enumerate("xy"):
            values = (one.first.uncorrected_rms_px[axis], one.first.rms_px[axis], seen[axis])
            rows.append((reference, letter, *(float(result.scale * v) for v in values)))
    return Table(
        columns=(
            "Coordinates",
            "Axis",
            Column(name="Distortion", unit="″", key="uncorrected_arcsec", format=".3f"),
            Column(name="Left, one survey", unit="″", key="one_survey_arcsec", format=".3f"),
            Column(name="Left, all surveys", unit="″", key="all_surveys_arcsec", format=".3f"),
        ),
        rows=rows,
        caption="The true map (3 σ of its RMS over the whole detector, shift and roll taken out): before and after the "
        "correction.",
    )


def _forecasts(result: Result) -> Table:
    rows: list[tuple[Cell, ...]] = [
        (
            one.points,
            one.order,
            *(float(np.sqrt(((result.scale * v) ** 2).mean())) for v in (one.bias_px, one.noise_px, one.rms_px)),
        )
        for one in result.forecast
    ]
    return Table(
        columns=(
            Column(name="Points", key="points"),
            Column(name="Order", key="order"),
            Column(name="Distortion left", unit="″", key="distortion_left_arcsec", format=".4f"),
            Column(name="Errors carried in", unit="″", key="errors_carried_arcsec", format=".4f"),
            Column(name="Map error", unit="″", key="map_error_arcsec", format=".4f"),
        ),
        rows=rows,
        caption="Map error (3 σ, mean square of both axes) to be expected of other grids and polynomials.",
    )


def _points(result: Result) -> Table:
    first, reference = result.config.methods[0], result.config.reference
    s = result.measured.statistics(first, reference)
    light = result.measured.light
    rows: list[tuple[Cell, ...]] = []
    for n in range(len(light)):
        values = [
            *light.nominal_px[n],
            *result.measured.session_px[first][1, n],
            *light.photon_px[n],
            *result.predicted.bundle_px[n],
            *s.d_px[n],
            *s.left_px[n],
        ]
        rows.append((n + 1, *(float(v) for v in values)))
    names = (
        ("Nominal", "nominal"),
        ("Measured", "measured"),
        ("Light", "light"),
        ("Ray trace", "ray_trace"),
        ("d", "d"),
        ("Left", "left"),
    )
    columns = [Column(name=f"{name} {a}", unit="px", key=f"{key}_{a}_px") for name, key in names for a in "xy"]
    return Table(columns=("Point", *columns), rows=rows, caption=f"All points, {METHOD_NAMES[first]}, {reference}.")


def all_tables(result: Result) -> Mapping[str, Table]:
    """Tables of the result by file name."""
    return {
        "distortion": _main(result, result.config.methods[:1]),
        "centroiders": _main(result, result.config.methods),
        "map": _maps(result),
        "forecasts": _forecasts(result),
        "points": _points(result),
    }
