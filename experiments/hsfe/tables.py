"""Tables of the step test, for the report and as ECSV files."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from experiments.harness.pivot import Pivot
from experiments.harness.quantities import Outcome, shown_unit
from experiments.harness.tables import Cell, Column, Table
from optics.arrays import FloatArray

__all__ = ["axes_rms", "tables"]


def tables(outcome: Outcome) -> Mapping[str, Table | Pivot]:
    """Tables by file name."""
    beside = ""
    if "published_arcsec" in outcome.data:
        x, y = outcome.values("published_arcsec")
        beside = f"; published {x}″ in x and {y}″ in y"
    return {
        "hsfe": Pivot(
            rows="method axis",
            columns="document_arcsec predicted_arcsec ratio halved_arcsec one_position_arcsec "
            "one_position_predicted_arcsec",
            plain="document_arcsec ratio",
            caption=f"HSFE (3 σ) of one star{beside}.",
            note="*Document*: RMS difference of neighbouring positions, as printed (eq. 9-12), temporal noise "
            "included. *Over √2*: the same without temporal noise, divided by √2, as if neighbours erred "
            "independently. *One position*: what a star really errs by, mean centroid against the truth, common motion "
            "and temporal noise removed. Predicted ± : from chip to chip.",
        ),
        "causes": _causes(outcome),
        "hexapods": Pivot(
            rows="hexapod",
            hidden="hexapod",
            across="axis",
            columns="hexapod_label step_error_arcsec roll_error_arcsec common_motion_px left_px",
            caption="Errors of the hexapod by ray trace: the common motion they make in a step, and what is left in "
            "the document's figure (1 σ) after the mean over the stars is removed.",
        ),
        "residuals": Pivot(
            rows="step star",
            across="axis",
            columns="residual_px true_px",
            caption=f"Residuals (eq. 7-8), {outcome.names('method')[0]}.",
        ),
    }


def axes_rms(values: FloatArray) -> Any:
    """Root mean square over the axes, which are the last dimension."""
    return np.sqrt((values**2).mean(-1))


def _causes(outcome: Outcome) -> Table:
    """Causes, and below them what they are compared with, by centroider; mean square of both axes."""
    columns = {
        "alone_arcsec": "alone_arcsec",
        "off_arcsec": "off_arcsec",
        "cause_predicted_arcsec": "predicted_arcsec",
        "alone_position_arcsec": "one_position_arcsec",
        "position_predicted_arcsec": "one_position_predicted_arcsec",
    }
    rows: list[tuple[Cell, ...]] = []
    motion = axes_rms(3.0 * outcome.values("pixel_arcsec") * outcome.values("motion_px"))
    for method, label in zip(outcome.config.methods, outcome.names("method"), strict=True):
        mean = {
            name: float(axes_rms(outcome.values(f"{name}_arcsec", method=method)))
            for name in ("temporal", "temporal_predicted", "dark", "roll", "quadrature", "document", "predicted")
        }
        causes = [axes_rms(outcome.values(name, method=method)) for name in columns]
        rows += [
            (label, name, *map(float, cells)) for name, *cells in zip(outcome.names("cause"), *causes, strict=True)
        ]
        for name, found, expected in (
            ("temporal noise / √N", mean["temporal"], mean["temporal_predicted"]),
            ("noise of the dark frames", None, mean["dark"]),
            ("roll of the hexapod", float(motion), mean["roll"]),
            ("in quadrature", mean["quadrature"], mean["predicted"]),
            ("everything together", mean["document"], mean["predicted"]),
        ):
            rows.append((label, name, found, None, expected, None, None))
    heads = [(outcome.quantity(name), key) for name, key in columns.items()]
    return Table(
        columns=(
            "Centroider",
            "Cause",
            *(Column(name=one.label, unit=shown_unit(one.unit), key=key, format=one.format) for one, key in heads),
        ),
        rows=rows,
        caption="What each cause contributes (3 σ, mean square of both axes), to the document's figure and to the "
        "error of one position.",
        note="*Alone*: a detector with only this cause against one with none. *Switched off*: everything against "
        "everything but this. Same random streams in all runs; what does not cancel is taken away.",
    )
