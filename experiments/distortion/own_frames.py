"""Distortion error of a laboratory's own frames (ACC18 eq. 17-30): every series is a session."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from experiments.harness.drawings import arrows
from experiments.harness.quantities import Quantities
from experiments.harness.sections import Section, col
from experiments.laboratory.distortion_error import grid_residual_px
from experiments.laboratory.distortion_statistics import LABELS, Reference, distortion_statistics
from experiments.reduce.folder import FrameFolder
from experiments.reduce.frames_toml import Layout
from experiments.reduce.road import POINTS, POINTS_CAPTION, FramesTest, Reduced, points_of
from experiments.reduce.series import reduce_series
from optics.arrays import FloatArray
from optics.errors import DomainError

__all__ = ["own_frames", "reduce"]

PLACE = "distortion_arcsec_3sigma[method][reference]"
DIMS = "method reference axis"


@dataclass(frozen=True, slots=True, kw_only=True)
class Grid:
    """Distortion error (3 sigma) of n target points by method, reference and axis."""

    references: Sequence[str]  # How target coordinates become pixels; without an earlier session none is "calibrated"
    sigma_d_arcsec: FloatArray = col(LABELS[0], "arcsec", ".3f", DIMS, json=f"{PLACE}.sigma_d")
    sigma_left_arcsec: FloatArray = col(LABELS[1], "arcsec", ".3f", DIMS, json=f"{PLACE}.sigma_Dd")
    sigma_c1_arcsec: FloatArray = col(LABELS[2], "arcsec", ".3f", DIMS, json=f"{PLACE}.sigma_C1")
    order: int = col("Order of the polynomial", shown=False)
    # First method, last reference
    nominal_px: FloatArray = col("Target", "px", ".2f", "point axis", json="")
    found_arcsec: FloatArray = col("Residual", "arcsec", ".3f", "point axis", json="")
    left_arcsec: FloatArray = col("Left after the polynomial", "arcsec", ".3f", "point axis", json="")


def reduce(folder: FrameFolder, methods: Sequence[str], config: Any) -> Reduced:
    """Distortion error of a target with stated coordinates; one session "test" and at most one "earlier"."""
    if folder.nominal_px is None:
        raise DomainError("distortion needs the coordinates of the target: points_px or target in place of points")
    by_session = {s: [one for one in folder.series if one.settings.session == s] for s in ("earlier", "test")}
    if len(by_session["test"]) != 1 or len(by_session["earlier"]) > 1:
        raise DomainError(
            f"{len(by_session['test'])} series with session 'test' and {len(by_session['earlier'])} with 'earlier'; "
            "distortion needs one, and at most one"
        )
    series = [reduce_series(folder, one, methods) for session in by_session.values() for one in session]
    references: tuple[Reference, ...] = ("nominal", "aligned", "calibrated")
    references = references[: 1 + len(series)]
    place = (folder.nominal_px - folder.centre_px) / (0.5 * np.hypot(folder.width_px, folder.height_px))
    rows, scale = [], folder.settings.pixel_arcsec
    for method in methods:
        earlier, test = (one.points.mean_px(method) for one in (series[0], series[-1]))
        residuals = [grid_residual_px(folder.nominal_px, place, earlier, test, one)[0] for one in references]
        rows.append([distortion_statistics(place, d, config.order) for d in residuals])
    sigma = {
        name: 3.0 * scale * np.array([[getattr(one, f"{name}_px") for one in row] for row in rows])
        for name in ("sigma_d", "sigma_left", "sigma_c1")
    }
    grid = Grid(
        references=references,
        sigma_d_arcsec=sigma["sigma_d"],
        sigma_left_arcsec=sigma["sigma_left"],
        sigma_c1_arcsec=sigma["sigma_c1"],
        order=config.order,
        nominal_px=folder.nominal_px,
        found_arcsec=scale * rows[0][-1].d_px,
        left_arcsec=scale * rows[0][-1].left_px,
    )
    return series, {"grid": grid, **points_of(folder, series[-1], methods[0])}


def _axes(q: Quantities, grid: Grid) -> None:
    q.axis("reference", list(grid.references), "Reference")


own_frames = FramesTest(
    title="Distortion error",
    layout=Layout(),
    reduce=reduce,
    sections={
        "grid": Section(
            record=Grid,
            axes=_axes,
            table="distortion",
            rows=DIMS,
            columns="sigma_d_arcsec sigma_left_arcsec sigma_c1_arcsec",
            caption="Distortion error (ACC18 eq. 17-30, 3 σ).",
            note="*nominal*: stated coordinates as they are; *aligned*: shift, roll and scale fitted; *calibrated*: a "
            "camera model from the earlier session.",
            figures={"residuals": arrows("nominal_px", "found_arcsec", "left_arcsec", frame="frame_size_px")},
        ),
        **POINTS,
    },
    head={"Left after the polynomial (3 σ)": ("sigma_left_arcsec", {"method": 0, "reference": -1})},
    captions={
        "residuals": "Residuals with the last of the references: before and after the polynomial.",
        **POINTS_CAPTION,
    },
    series="Session",
)
