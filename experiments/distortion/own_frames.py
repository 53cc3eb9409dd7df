"""Distortion error of a laboratory's own frames (ACC18 eq. 17-30): every series is a session."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from experiments.harness.pivot import Pivot
from experiments.harness.plotting import PALETTE, new_figure
from experiments.harness.quantities import Outcome, Quantities
from experiments.laboratory import point_figures
from experiments.laboratory.distortion_error import grid_residual_px
from experiments.laboratory.distortion_statistics import LABELS, DistortionStatistics, Reference, distortion_statistics
from experiments.laboratory.own_frames.experiment import FramesTest
from experiments.laboratory.own_frames.figures import POINTS, cloud
from experiments.laboratory.own_frames.folder import FrameFolder
from experiments.laboratory.own_frames.series import SeriesFrames, reduce_series
from experiments.laboratory.own_frames.settings import Layout
from experiments.laboratory.own_frames.tables import add_points, points_table
from optics.arrays import FloatArray
from optics.errors import DomainError

__all__ = ["GridFrames", "own_frames", "reduce"]


@dataclass(frozen=True, slots=True, kw_only=True)
class GridFrames:
    """Distortion error of n target points."""

    pixel_arcsec: float  # Angle of a pixel
    order: int  # Of the polynomial
    nominal_px: FloatArray  # (n, 2) Target coordinates
    place: FloatArray  # (n, 2) The same from the middle, in units of half the diagonal of the frames
    earlier: SeriesFrames | None  # Sessions; without an earlier one there is no reference "calibrated"
    test: SeriesFrames  # Sessions; without an earlier one there is no reference "calibrated"

    @property
    def references(self) -> tuple[Reference, ...]:
        """How the coordinates can become pixels."""
        return ("nominal", "aligned") if self.earlier is None else ("nominal", "aligned", "calibrated")

    @property
    def series(self) -> tuple[SeriesFrames, ...]:
        """Sessions in order."""
        return (self.test,) if self.earlier is None else (self.earlier, self.test)

    def statistics(self, method: str, reference: Reference) -> DistortionStatistics:
        """sigma_d, sigma_Dd and sigma_C1 [px]."""
        if reference not in self.references:
            raise DomainError(f"reference {reference!r} needs a series with session = 'earlier'")
        test = self.test.points.mean_px(method)
        earlier = test if self.earlier is None else self.earlier.points.mean_px(method)
        d, _ = grid_residual_px(self.nominal_px, self.place, earlier, test, reference)
        return distortion_statistics(self.place, d, self.order)


def reduce(folder: FrameFolder, methods: Sequence[str], config: Any) -> GridFrames:
    """Distortion error of a target with stated coordinates; one session "test" and at most one "earlier"."""
    if folder.nominal_px is None:
        raise DomainError("distortion needs the coordinates of the target: points_px or target in place of points")
    by_session = {s: [one for one in folder.series if one.settings.session == s] for s in ("earlier", "test")}
    if len(by_session["test"]) != 1 or len(by_session["earlier"]) > 1:
        raise DomainError(
            f"{len(by_session['test'])} series with session 'test' and {len(by_session['earlier'])} with 'earlier'; "
            "distortion needs one, and at most one"
        )
    earlier = [reduce_series(folder, one, methods) for one in by_session["earlier"]]
    half = 0.5 * np.hypot(folder.width_px, folder.height_px)
    result = GridFrames(
        pixel_arcsec=folder.settings.pixel_arcsec,
        order=config.order,
        nominal_px=folder.nominal_px,
        place=(folder.nominal_px - folder.centre_px) / half,
        earlier=earlier[0] if earlier else None,
        test=reduce_series(folder, by_session["test"][0], methods),
    )
    for reference in result.references:
        result.statistics(methods[0], reference)  # too few points are refused here
    return result


def _describe(q: Quantities, reduced: GridFrames, methods: Sequence[str]) -> None:
    scale = 3.0 * reduced.pixel_arcsec
    q.axis("reference", list(reduced.references), "Reference")
    every = [[reduced.statistics(m, r) for r in reduced.references] for m in methods]
    for name, json, label, field in (
        ("sigma_d_arcsec", "sigma_d", LABELS[0], "sigma_d_px"),
        ("sigma_left_arcsec", "sigma_Dd", LABELS[1], "sigma_left_px"),
        ("sigma_c1_arcsec", "sigma_C1", LABELS[2], "sigma_c1_px"),
    ):
        values = scale * np.array([[getattr(one, field) for one in row] for row in every])
        place = f"distortion_arcsec_3sigma[method][reference].{json}"
        q.add(name, values, label, unit="arcsec", dims="method reference axis", format=".3f", json=place)
    q.add("order", reduced.order, "Order of the polynomial")
    add_points(q, reduced.test, methods[0])


def _headline(outcome: Outcome) -> Mapping[str, Any]:
    at = {"method": outcome.result.methods[0], "reference": outcome.result.reduced.references[-1]}
    return {
        f"Left after the polynomial, {axis} (3 σ)": outcome.quantity("sigma_left_arcsec", axis=axis, **at)
        for axis in "xy"
    }


def _tables(outcome: Outcome) -> Mapping[str, Pivot]:
    grid = Pivot(
        rows="method reference axis",
        columns="sigma_d_arcsec sigma_left_arcsec sigma_c1_arcsec",
        caption=f"Distortion error (ACC18 eq. 17-30, 3 σ), polynomial of order {outcome.result.reduced.order}.",
        note="*nominal*: stated coordinates as they are; *aligned*: shift, roll and scale fitted; *calibrated*: a "
        "camera model from the earlier session.",
    )
    return {"distortion": grid, "points": points_table(outcome)}


def _residuals(outcome: Outcome) -> Figure:
    """Residuals before and after the polynomial as arrows over the detector."""
    reduced, folder = outcome.result.reduced, outcome.result.folder
    statistics = reduced.statistics(outcome.result.methods[0], reduced.references[-1])
    figure, axes = new_figure(1, 2, aspect_ratio=0.5, sharey=True)
    for panel, values, title in ((axes[0], statistics.d_px, "found"), (axes[1], statistics.left_px, "left")):
        error, reach = values * reduced.pixel_arcsec, 0.09 * folder.width_px
        longest = point_figures.arrows(
            panel, reduced.nominal_px, error, longest_px=reach, color=PALETTE[0], width=0.005
        )
        point_figures.detector_outline(panel, folder.width_px, folder.height_px)
        panel.set(xlabel="column [px]", title=f"{title}: longest {longest:.2f}″")
    axes[0].set_ylabel("row [px]")
    return figure


own_frames = FramesTest(
    title="Distortion error",
    layout=Layout(),
    reduce=reduce,
    describe=_describe,
    headline=_headline,
    tables=_tables,
    figures={
        "residuals": (_residuals, "Residuals with the last of the references: before and after the polynomial."),
        "cloud": (cloud, POINTS),
    },
    show=("distortion",),
    series="Session",
)
