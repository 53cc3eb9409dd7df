"""Tables of the step test, for the report and as ECSV files."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from experiments.harness.summary import Measured
from experiments.harness.tables import Cell, Column, Table
from experiments.hsfe.evaluate import ratio, three_sigma
from experiments.hsfe.result import PUBLISHED_ARCSEC
from experiments.laboratory.high_frequency import CAUSES
from experiments.laboratory.point_settings import METHOD_NAMES
from experiments.laboratory.step_statistics import step_residual_px

if TYPE_CHECKING:
    from experiments.hsfe.result import Result

__all__ = ["CAUSE_NAMES", "all_tables"]

CAUSE_NAMES = {
    "s_curve": "S-curve",
    "prnu": "response (PRNU)",
    "pattern": "offset pattern (DSNU)",
    "defects": "masked defects",
}


def _main(result: Result) -> Table:
    rows: list[tuple[Cell, ...]] = []
    for method in result.config.methods:
        document, model = result.measured.document_arcsec(method), result.after.method[method]
        predicted, scatter, halved, single, expected = (
            three_sigma(result, value)
            for value in (
                model.document_px,
                model.scatter_px,
                result.measured.halved_px(method),
                result.measured.single_px(method),
                model.single_px,
            )
        )
        for axis, letter in enumerate("xy"):
            rows.append(
                (
                    METHOD_NAMES[method],
                    letter,
                    document[axis].value,
                    Measured(value=float(predicted[axis]), uncertainty=float(scatter[axis])),
                    ratio(result, method)[axis].value,
                    float(halved[axis]),
                    float(single[axis]),
                    float(expected[axis]),
                )
            )
    return Table(
        columns=(
            "Centroider",
            "Axis",
            Column(name="Document", unit="″", key="document_arcsec", format=".3f"),
            Column(name="Predicted", unit="″", key="predicted_arcsec"),
            Column(name="Ratio", key="ratio", format=".3f"),
            Column(name="Over √2", unit="″", key="halved_arcsec", format=".3f"),
            Column(name="One position", unit="″", key="one_position_arcsec", format=".3f"),
            Column(name="Predicted", unit="″", key="one_position_predicted_arcsec", format=".3f"),
        ),
        rows=rows,
        caption=f"HSFE (3 σ) of one star; published {PUBLISHED_ARCSEC[0]}″ in x and {PUBLISHED_ARCSEC[1]}″ in y.",
        note="*Document*: RMS difference of neighbouring positions, as printed (eq. 9-12), temporal noise included. "
        "*Over √2*: the same without temporal noise, divided by √2, as if neighbours erred independently. *One "
        "position*: what a star really errs by, mean centroid against the truth, common motion and temporal noise "
        "removed. Predicted ± : from chip to chip.",
    )


def _causes(result: Result) -> Table:
    rows: list[tuple[Cell, ...]] = []
    measured = result.measured
    for method in result.config.methods:
        model = result.after.method[method]
        for cause in CAUSES:
            values = (
                measured.cause_px(method, cause),
                measured.cause_px(method, cause, alone=False),
                model.cause_px[cause],
                measured.cause_single_px(method, cause),
                model.cause_single_px[cause],
            )
            means = [float(np.sqrt((three_sigma(result, v) ** 2).mean())) for v in values]
            rows.append((METHOD_NAMES[method], CAUSE_NAMES[cause], *means))
        for label, value, expected in (
            ("temporal noise / √N", measured.temporal_px(method), model.temporal_px),
            ("noise of the dark frames", None, model.dark_px),
            ("roll of the hexapod", measured.motion_px, model.roll_px),
            ("in quadrature", measured.quadrature_px(method), model.document_px),
            ("everything together", measured.document_px(method), model.document_px),
        ):
            shown = [
                None if v is None else float(np.sqrt((three_sigma(result, v) ** 2).mean())) for v in (value, expected)
            ]
            rows.append((METHOD_NAMES[method], label, shown[0], None, shown[1], None, None))
    return Table(
        columns=(
            "Centroider",
            "Cause",
            Column(name="Alone", unit="″", key="alone_arcsec", format=".4f"),
            Column(name="Switched off", unit="″", key="off_arcsec", format=".4f"),
            Column(name="Predicted", unit="″", key="predicted_arcsec", format=".4f"),
            Column(name="Alone, one position", unit="″", key="one_position_arcsec", format=".4f"),
            Column(name="Predicted", unit="″", key="one_position_predicted_arcsec", format=".4f"),
        ),
        rows=rows,
        caption="What each cause contributes (3 σ, mean square of both axes), to the document's figure and to "
        "the error of one position.",
        note="*Alone*: a detector with only this cause against one with none. *Switched off*: everything against "
        "everything but this. Same random streams in all runs; what does not cancel is taken away.",
    )


def _hexapods(result: Result) -> Table:
    return Table(
        columns=(
            "Hexapod",
            Column(name="Step error", unit="″", key="step_error_arcsec", format=".1f"),
            Column(name="Roll error", unit="″", key="roll_error_arcsec", format=".1f"),
            Column(name="Common motion", unit="px", key="common_motion_px", format=".4f"),
            Column(name="Left, x", unit="px", key="left_x_px", format=".5f"),
            Column(name="Left, y", unit="px", key="left_y_px", format=".5f"),
        ),
        rows=[
            (g.label, g.step_arcsec, g.roll_arcsec, g.motion_px, float(g.document_px[0]), float(g.document_px[1]))
            for g in result.geometry
        ],
        caption="Errors of the hexapod by ray trace: the common motion they make in a step, and what is left in the "
        "document's figure (1 σ) after the mean over the stars is removed.",
    )


def _steps(result: Result) -> Table:
    """Residuals of eq. 7-8 of the first method."""
    first = result.config.methods[0]
    left = step_residual_px(result.measured.mean_px["all"][first])
    truth = step_residual_px(result.measured.photon_px)
    rows: list[tuple[Cell, ...]] = [
        (k + 1, j + 1, *(float(v) for v in (*left[k, j], *truth[k, j])))
        for k in range(left.shape[0])
        for j in range(left.shape[1])
    ]
    columns = [
        Column(name=f"{name} {axis}", unit="px", key=f"{key}_{axis}_px")
        for name, key in (("Residual", "residual"), ("True", "true"))
        for axis in "xy"
    ]
    return Table(columns=("Step", "Star", *columns), rows=rows, caption=f"Residuals (eq. 7-8), {METHOD_NAMES[first]}.")


def all_tables(result: Result) -> Mapping[str, Table]:
    """Tables of the result by file name."""
    return {
        "hsfe": _main(result),
        "causes": _causes(result),
        "hexapods": _hexapods(result),
        "residuals": _steps(result),
    }
