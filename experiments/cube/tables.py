"""Tables of the cube-mirror experiment, for the report and as ECSV files."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from experiments.cube.budget import PUBLISHED_ARCSEC
from experiments.cube.result import eq14_arcsec, sensor_error_arcsec, sigma1_arcsec
from experiments.harness.summary import Measured
from experiments.harness.tables import Cell, Column, Table
from optics.units import RAD_ARCSEC

if TYPE_CHECKING:
    from experiments.cube.result import Result
    from experiments.cube.trim import FaceTrim

__all__ = ["LEAST_MOVE_DEG", "PUBLISHED_TRIMS", "all_tables", "published_rates"]

PUBLISHED_TRIMS = {
    "XY": (
        (181.400, 0.550, 4.912, 19.429),
        (181.390, 0.540, 5.282, 12.243),
        (181.390, 0.532, 6.307, 5.181),
        (181.395, 0.531, 2.385, 3.558),
        (181.398, 0.530, 0.034, 2.404),
        (181.398, 0.528, 0.057, 0.771),
        (181.398, 0.528, 0.057, 0.771),
    ),
    "YZ": (
        (91.400, -0.070, 12.575, 20.226),
        (91.380, -0.050, 11.729, 2.557),
        (91.385, -0.050, 1.326, 1.323),
        (91.386, -0.050, 0.857, 1.897),
        (91.386, -0.048, 0.320, 0.442),
    ),
}
"""CUBE09 Table 1: large angle, small angle [deg], offsets x, y [px] without their signs."""

LEAST_MOVE_DEG = 0.005
"""Angles are printed to 0.001 deg: a rate from a smaller move means little."""


def published_rates() -> NDArray[np.float64]:
    """Motion of the spot per 0.001 deg (n, 2) [px], for every move of an angle in Table 1 of at least `LEAST_MOVE_DEG`.

    The offsets have no signs: the first column takes both on one side of the aperture, the second on opposite sides.
    """
    rates = []
    for trims in PUBLISHED_TRIMS.values():
        for before, after in pairwise(trims):
            for axis in (0, 1):
                steps = abs(after[axis] - before[axis]) / 0.001
                if steps > LEAST_MOVE_DEG / 0.001 - 0.1:
                    old, new = before[2 + axis], after[2 + axis]
                    rates.append((abs(old - new) / steps, (old + new) / steps))
    return np.array(rates)


def _trims(result: Result) -> Table:
    rows: list[tuple[Cell, ...]] = []
    for trim in result.shown.trims:
        for number, row in enumerate(trim.rows):
            x, y = (
                Measured(value=float(v), uncertainty=float(s)) for v, s in zip(row.offset_px, row.sigma_px, strict=True)
            )
            rows.append((trim.face, number + 1, row.inner_deg, row.outer_deg, x, y))
    return Table(
        columns=(
            "Face",
            Column(name="Trim", key="trim"),
            Column(name="Inner", unit="deg", key="inner_deg", format=".4f"),
            Column(name="Outer", unit="deg", key="outer_deg", format=".4f"),
            Column(name="Offset x", unit="px", key="offset_x_px"),
            Column(name="Offset y", unit="px", key="offset_y_px"),
        ),
        rows=rows,
        caption="Trims of the shown bench, as in CUBE09 Table 1: spot minus aperture, from the pictures.",
        note="One standard deviation from the two circle fits. One pixel on the screen is "
        f"{sigma1_arcsec(result):.2f} arcsec of the face.",
    )


def _published_trims(result: Result) -> Table:
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


def _budget(result: Result) -> Table:
    rows: list[tuple[Cell, ...]] = []
    for row in result.budget:
        cells: list[Cell] = [row.label, PUBLISHED_ARCSEC.get(row.name)]
        for axis in range(3):
            cells.append(float(row.predicted_arcsec[axis]))
            cells.append(
                Measured(value=float(row.measured_arcsec[axis]), uncertainty=float(row.uncertainty_arcsec[axis]))
            )
        cells.append(row.ratio)
        rows.append(tuple(cells))
    columns: list[Column | str] = ["Term", Column(name="CUBE09", unit="″", key="published_arcsec", format=".2f")]
    for letter in "xyz":
        columns.append(Column(name=f"{letter} pred.", unit="″", key=f"predicted_{letter}_arcsec", format=".2f"))
        columns.append(Column(name=f"{letter} meas.", unit="″", key=f"measured_{letter}_arcsec"))
    columns.append(Column(name="Ratio", key="predicted_over_measured", format=".3f"))
    return Table(
        columns=columns,
        rows=rows,
        caption="Error of R_sp, 1 sigma per axis of the cube frame: predicted by geometry, measured on benches.",
        note=f"{len(result.truths)} rendered benches; RMS about the truth, bars for their stratified "
        "misalignments. Predictions contain the noise of pictures "
        "and sun sensor. Ratio: predicted over measured, over the axes on which the term acts. Eq. 14 with the right "
        f"eq. 13 is {eq14_arcsec(result):.2f} arcsec for every axis.",
    )


def _benches(result: Result) -> Table:
    rows: list[tuple[Cell, ...]] = []
    for name, case in result.cases.items():
        for truth, bench in zip(result.truths, case.bench, strict=True):
            rows.append((name, truth.number, *(float(e) for e in bench.error_arcsec), *_counts(bench.trims)))
    return Table(
        columns=(
            "Case",
            Column(name="Bench", key="bench"),
            *(Column(name=f"Error {axis}", unit="″", key=f"error_{axis}_arcsec") for axis in "xyz"),
            Column(name="Settings, first face", key="settings_first"),
            Column(name="Settings, second face", key="settings_second"),
        ),
        rows=rows,
        caption="Error of R_sp, bench by bench.",
    )


def _counts(trims: Sequence[FaceTrim]) -> tuple[int, int]:
    """Settings of the table for the first and the last face."""
    return len(trims[0].rows), len(trims[-1].rows)


def _sensor(result: Result) -> Table:
    sensor = result.shown.sensor
    truth = result.truths[0]
    sigma = np.sqrt(np.diag(sensor.covariance_rad2)) * RAD_ARCSEC
    error = sensor_error_arcsec(result)
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


def all_tables(result: Result) -> Mapping[str, Table]:
    """All tables by file name."""
    return {
        "trims": _trims(result),
        "published_trims": _published_trims(result),
        "budget": _budget(result),
        "sensor": _sensor(result),
        "benches": _benches(result),
    }
