"""Distortion error of a laboratory's own frames (ACC18 eq. 17-30): every series is a session."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from calib.accuracy.distortion import (
    HIGHEST_ORDER,
    LABELS,
    OrderComparison,
    Reference,
    compare_orders,
    deleted_rms_px,
    distortion_statistics,
    grid_residual_px,
)
from experiments.harness.drawings import arrows
from experiments.harness.quantities import Outcome, Quantities
from experiments.harness.sections import Section, above, below, col
from experiments.reduce.folder import FrameFolder
from experiments.reduce.frames_toml import FolderLayout
from experiments.reduce.pipeline import POINTS, POINTS_CAPTION, FramesTest, Reduced, tabulate_points
from experiments.reduce.series import reduce_series
from optics.arrays import FloatArray
from optics.errors import DomainError

DIMS = "method reference axis"
OVER_BEST = 2.0
"""Ratio to the error of the best order above which the order is wrong, and not a target of few points."""


@dataclass(frozen=True, slots=True, kw_only=True)
class GridNumbers:
    """Distortion error (3 sigma) of n target points by method, reference and axis."""

    references: Sequence[str]  # Conversions of coordinates to pixels; "calibrated" needs an earlier session
    sigma_d_arcsec: FloatArray = col(LABELS[0], "arcsec", ".3f", DIMS)
    sigma_dd_arcsec: FloatArray = col(LABELS[1], "arcsec", ".3f", DIMS)
    sigma_c1_arcsec: FloatArray = col(LABELS[2], "arcsec", ".3f", DIMS)
    point_deleted_arcsec: FloatArray = col("A point left out", "arcsec", ".3f", DIMS)
    # The larger of both; NaN where the remaining rows or columns do not determine the polynomial
    row_deleted_arcsec: FloatArray = col("A row or column left out", "arcsec", ".3f", DIMS)
    order: int = col("Order of the polynomial", shown=False)
    # First method, last reference
    nominal_px: FloatArray = col("Target", "px", ".2f", "point axis")
    residual_before_arcsec: FloatArray = col("Residual", "arcsec", ".3f", "point axis")
    residual_after_arcsec: FloatArray = col("After the polynomial", "arcsec", ".3f", "point axis")


@dataclass(frozen=True, slots=True, kw_only=True)
class PolynomialOrder:
    """A polynomial of another order for the same points, first method, last reference; 3 sigma, both axes."""

    order: int = col("Order", format="d")
    residual_arcsec: float = col("After the polynomial", "arcsec", ".3f")
    point_deleted_arcsec: float = col("A point left out", "arcsec", ".3f")
    row_deleted_arcsec: float = col("A row or column left out", "arcsec", ".3f")


@dataclass(frozen=True, slots=True, kw_only=True)
class OrderChoice:
    """Order of the polynomial against target and lens."""

    tested_order: int = col("Highest order that the other rows and columns determine where one is left out")
    best_order: int = col("Order with the smallest error at points left out")
    over_best: float = col("Error at points left out over that of the best order", format=".3g")


def tabulate_orders(comparison: OrderComparison, scale: float) -> list[PolynomialOrder]:
    """A record per order, in units of ``scale`` [arcsec/px]."""
    errors = (scale * error for error in (comparison.residual_px, comparison.point_px, comparison.line_px))
    return [
        PolynomialOrder(order=int(order), residual_arcsec=residual, point_deleted_arcsec=point, row_deleted_arcsec=line)
        for order, residual, point, line in zip(comparison.order, *errors, strict=True)
    ]


def reduce(folder: FrameFolder, methods: Sequence[str], config: Any) -> Reduced:
    """Distortion error of a target with stated coordinates; one session "test" and at most one "earlier"."""
    if folder.nominal_px is None:
        raise DomainError("distortion needs the coordinates of the target: points_px or target in place of points")
    by_session = {
        session: [series for series in folder.series if series.settings.session == session]
        for session in ("earlier", "test")
    }
    if len(by_session["test"]) != 1 or len(by_session["earlier"]) > 1:
        raise DomainError(
            f"{len(by_session['test'])} series with session 'test' and {len(by_session['earlier'])} with 'earlier'; "
            "distortion needs one, and at most one"
        )
    reduced = [reduce_series(folder, series, methods) for session in by_session.values() for series in session]
    references: tuple[Reference, ...] = ("nominal", "aligned", "calibrated")
    references = references[: 1 + len(reduced)]
    position = (folder.nominal_px - folder.centre_px) / (0.5 * np.hypot(folder.width_px, folder.height_px))
    rows, scale = [], 3.0 * folder.settings.pixel_arcsec
    for method in methods:
        earlier, test = (session.points.mean_px(method) for session in (reduced[0], reduced[-1]))
        residuals = [grid_residual_px(folder.nominal_px, position, earlier, test, r)[0] for r in references]
        rows.append([distortion_statistics(position, d, config.order) for d in residuals])
    offset = [reduced[-1].points.mean_px(m) - folder.nominal_px for m in methods]
    deleted = scale * np.array(
        [[deleted_rms_px(position, offset_px, config.order, r) for r in references] for offset_px in offset]
    )
    comparison = compare_orders(position, offset[0], references[-1], highest=min(config.order + 2, HIGHEST_ORDER))
    sigma = scale * np.array([[statistics.sigma_px for statistics in row] for row in rows])
    grid = GridNumbers(
        references=references,
        sigma_d_arcsec=sigma[:, :, 0],
        sigma_dd_arcsec=sigma[:, :, 1],
        sigma_c1_arcsec=sigma[:, :, 2],
        point_deleted_arcsec=deleted[:, :, 0],
        row_deleted_arcsec=deleted[:, :, 1],
        order=config.order,
        nominal_px=folder.nominal_px,
        residual_before_arcsec=scale / 3.0 * rows[0][-1].d_px,
        residual_after_arcsec=scale / 3.0 * rows[0][-1].residual_px,
    )
    choice = OrderChoice(
        tested_order=comparison.tested_order,
        best_order=comparison.best_order,
        over_best=comparison.over_best(config.order),
    )
    sections = {"grid": grid, "orders": tabulate_orders(comparison, scale), "choice": choice}
    return reduced, {**sections, **tabulate_points(folder, reduced[-1], methods[0])}


def _axes(quantities: Quantities, grid: GridNumbers) -> None:
    quantities.axis("reference", list(grid.references), "Reference")


def _tested_advice(outcome: Outcome) -> str:
    order = outcome.result["grid"].order
    return (
        f"with a row or a column left out, the others do not determine a polynomial of order {order}: between them the "
        f"map may be anything, and no residual shows it; {order + 2} rows and columns are needed, or a lower order"
    )


def _order_advice(outcome: Outcome) -> str:
    best, order = outcome.result["choice"].best_order, outcome.result["grid"].order
    why = "the polynomial follows errors of the points" if order > best else "the lens has more than it can follow"
    return f"order {best} is nearer to points that the fit has not seen: {why}; take --set order={best}"


own_frames = FramesTest(
    title="Distortion error",
    layout=FolderLayout(),
    reduce=reduce,
    sections={
        "grid": Section(
            record=GridNumbers,
            axes=_axes,
            table="distortion",
            rows=DIMS,
            columns="sigma_d_arcsec sigma_dd_arcsec sigma_c1_arcsec point_deleted_arcsec row_deleted_arcsec",
            caption="Distortion error (ACC18 eq. 17-30, 3 σ), and error of the map at points left out of the "
            "fit (3 times its RMS).",
            note="*nominal*: stated coordinates unchanged; *aligned*: shift, roll and scale fitted; *calibrated*: a "
            "camera model from the earlier session. *Left out*: camera and polynomial fitted without the point, or "
            "without its row or column (the larger; none: the others do not determine the polynomial there).",
            figures={
                "residuals": arrows(
                    "nominal_px", "residual_before_arcsec", "residual_after_arcsec", frame="frame_size_px"
                )
            },
        ),
        "orders": Section(
            record=PolynomialOrder,
            dim="other_order",
            along="order",
            caption="Other orders of the polynomial: fit residuals, and error at points left out of the fit.",
        ),
        "choice": Section(
            record=OrderChoice,
            verdicts=[
                above(
                    "tested_order",
                    "grid.order",
                    title="highest order of the polynomial that the target tests",
                    advice=_tested_advice,
                ),
                below(
                    "over_best",
                    OVER_BEST,
                    title="error at points left out, over that of the best order",
                    advice=_order_advice,
                ),
            ],
        ),
        **POINTS,
    },
    head={
        "After the polynomial (3 σ)": ("sigma_dd_arcsec", {"method": 0, "reference": -1}),
        "Map, at points left out": ("grid.point_deleted_arcsec", {"method": 0, "reference": -1}),
        "Map, at rows left out": ("grid.row_deleted_arcsec", {"method": 0, "reference": -1}),
    },
    captions={
        "residuals": "Residuals with the last of the references: before and after the polynomial.",
        **POINTS_CAPTION,
    },
    series="Session",
)
