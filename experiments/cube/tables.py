"""Tables of the cube-mirror experiment, for the report and as ECSV files."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from experiments.cube.published import PUBLISHED_TRIMS
from experiments.harness.pivot import Pivot
from experiments.harness.quantities import Outcome
from experiments.harness.summary import Measured
from experiments.harness.tables import Cell, Column, Table
from optics.units import RAD_ARCSEC

if TYPE_CHECKING:
    from experiments.cube.result import Result

__all__ = ["tables"]


def _published_trims() -> Table:
    rows = [(face, i + 1, *row) for face, trims in PUBLISHED_TRIMS.items() for i, row in enumerate(trims)]
    return Table(
        columns=(
            "Face",
            Column(name="Trim", key="trim"),
            Column(name="Inner", unit="deg", key="inner_deg", format=".3f"),
            Column(name="Outer", unit="deg", key="outer_deg", format=".3f"),
            Column(name="|x|", unit="px", key="offset_x_px", format=".3f"),
            Column(name="|y|", unit="px", key="offset_y_px", format=".3f"),
        ),
        rows=rows,
        caption="CUBE09 Table 1 as printed, its columns named as its text names them.",
    )


def _budget(outcome: Outcome) -> Table:
    """Prediction and measurement stand side by side, axis by axis."""
    columns: list[Column | str] = ["Term", Column(name="CUBE09", unit="″", key="published_arcsec", format=".2f")]
    for axis in "xyz":
        columns.append(Column(name=f"{axis} pred.", unit="″", key=f"predicted_{axis}_arcsec", format=".2f"))
        columns.append(Column(name=f"{axis} meas.", unit="″", key=f"measured_{axis}_arcsec"))
    columns.append(Column(name="Ratio", key="predicted_over_measured", format=".3f"))
    rows: list[tuple[Cell, ...]] = []
    for row in range(outcome.data.sizes["row"]):
        pairs = [
            (float(outcome.values("predicted", row=row, axis=a)), outcome.value("measured", row=row, axis=a))
            for a in "xyz"
        ]
        cells = [cell for pair in pairs for cell in pair]
        published, ratio = outcome.value("published_arcsec", row=row), outcome.value("predicted_over_measured", row=row)
        rows.append((outcome.value("meaning", row=row), None if np.isnan(published) else published, *cells, ratio))
    return Table(
        columns=columns,
        rows=rows,
        caption="Error of R_sp, 1 sigma per axis of the cube frame: predicted by geometry, measured on benches.",
        note=f"{outcome.value('benches')} rendered benches; RMS about the truth, bars for their stratified "
        "misalignments. Predictions contain the noise of pictures "
        "and sun sensor. Ratio: predicted over measured, over the axes on which the term acts. Eq. 14 with the right "
        f"eq. 13 is {outcome.value('eq14_arcsec'):.2f} arcsec for every axis.",
    )


def _sensor(outcome: Outcome) -> Table:
    result: Result = outcome.result
    sensor = result.shown.sensor
    truth = result.truths[0]
    sigma = np.sqrt(np.diag(sensor.covariance_rad2)) * RAD_ARCSEC
    error = outcome.values("r_sr_error_arcsec")
    rows: list[tuple[Cell, ...]] = [
        (f"R_sr, error about {axis}", "″", 0.0, Measured(value=float(error[i]), uncertainty=float(sigma[i])))
        for i, axis in enumerate("xyz")
    ]
    rows += [
        ("Mask to detector", "mm", truth.sensor.gap_mm, float(sensor.focal_length_mm)),
        ("Foot of the hole, x", "px", float(truth.sensor.offset_px[0]), float(sensor.offset_px[0])),
        ("Foot of the hole, y", "px", float(truth.sensor.offset_px[1]), float(sensor.offset_px[1])),
    ]
    return Table(
        columns=(
            "Unknown",
            "Unit",
            Column(name="True", key="true", format=".5f"),
            Column(name="Found", key="found", format=".5f"),
        ),
        rows=rows,
        caption=f"The sun sensor of the shown bench from {len(result.shown_run.pixel_px)} positions of the table.",
        note=f"Scatter of the spots about the fit: {sensor.sigma_px:.4f} px per axis.",
    )


def tables(outcome: Outcome) -> Mapping[str, Table | Pivot]:
    """All tables by file name."""
    return {
        "trims": Pivot(
            rows="setting",
            hidden="setting",
            across="direction",
            columns="trim_face trim trim_inner_deg trim_outer_deg trim_offset_px",
            caption="Trims of the shown bench, as in CUBE09 Table 1: spot minus aperture, from the pictures.",
            note="One standard deviation from the two circle fits. One pixel on the screen is "
            f"{outcome.value('eq13_arcsec'):.2f} arcsec of the face.",
        ),
        "published_trims": _published_trims(),
        "budget": _budget(outcome),
        "sensor": _sensor(outcome),
        "benches": Pivot(
            rows="case bench",
            across="axis",
            columns="bench_error settings_first settings_second",
            caption="Error of R_sp, bench by bench.",
        ),
    }
