"""Turntable calibration from a laboratory's own frames: every series is a pose of the table."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from experiments.harness.pivot import Pivot
from experiments.harness.plotting import PALETTE, new_figure
from experiments.harness.quantities import Outcome, Quantities
from experiments.harness.summary import Criterion
from experiments.laboratory import point_figures
from experiments.laboratory.own_frames.experiment import FramesTest
from experiments.laboratory.own_frames.folder import FrameFolder
from experiments.laboratory.single_star.own_frames import POSES, PoseCalibration, calibrate_poses, fit_criteria

__all__ = ["own_frames", "reduce"]


def reduce(folder: FrameFolder, methods: Sequence[str], config: Any = None) -> PoseCalibration:
    """Joint calibration from all poses of a folder; errors as of `calibrate_poses`."""
    return calibrate_poses(folder, methods, ("calibration", "evaluation"))


def _describe(q: Quantities, reduced: PoseCalibration, methods: Sequence[str]) -> None:
    solution = reduced.calibration.solution
    q.axis("unknown", list(solution.names), "Unknown")
    place = "unknowns[unknown]"
    q.add("found", solution.value, "Value", dims="unknown", error=solution.sigma, key="value", json=place)
    q.add("poses", len(reduced.series), "Poses")
    q.add("map_error_arcsec", reduced.map_error_arcsec, "Error of the line of sight", unit="arcsec", format=".4f")
    rms = np.sqrt((reduced.residual_px**2).mean(0))
    q.add("residual_px", rms, "Residual, RMS", unit="px", dims="axis", format=".4f")
    sigma = np.sqrt(np.einsum("nii->ni", reduced.data.covariance_px2).mean(0))
    q.add("centroid_px", sigma, "Centroid, stated", unit="px", dims="axis", format=".4f")
    q.add("coverage", reduced.coverage, "Part of the detector visited", format=".2f")
    points = {"unit": "px", "dims": "series axis", "format": ".4f", "json": ""}
    q.add("place_px", reduced.data.pixel_px, "Image", key="{axis}_px", **points)
    q.add("left_px", reduced.residual_px, "Residual", key="residual_{axis}_px", **points)


def _headline(outcome: Outcome) -> Mapping[str, Any]:
    focal = outcome.quantity("found", unknown="focal_length_mm")
    return {"Focal length [mm]": focal, "Error of the line of sight, RMS": outcome.quantity("map_error_arcsec")}


def _tables(outcome: Outcome) -> Mapping[str, Pivot]:
    return {"unknowns": _UNKNOWNS, "residuals": _RESIDUALS, "poses": _POSES}


_UNKNOWNS = Pivot(
    rows="unknown",
    columns="found",
    caption="Unknowns of the joint calibration, each in the unit that its name ends with.",
    note="One standard deviation by the stated noise. Star: direction in the laboratory, the table's frame at zero "
    "angles; theta: installation (cam from table top) by ACF17; lean: 90° minus the angle of neighbouring axes.",
)
_RESIDUALS = Pivot(
    rows="axis",
    columns="residual_px centroid_px",
    caption="Residuals at the angles as read, and the stated error of a centroid.",
)
_POSES = Pivot(rows="series", across="axis", columns="frames place_px left_px", caption="Images of the poses.")


def _arrows(outcome: Outcome) -> Figure:
    """Residuals as arrows over the detector."""
    reduced, folder = outcome.result.reduced, outcome.result.folder
    figure, panel = new_figure(aspect_ratio=0.7)
    error, reach = reduced.residual_px * folder.settings.pixel_arcsec, 0.06 * folder.width_px
    longest = point_figures.arrows(panel, reduced.data.pixel_px, error, longest_px=reach, color=PALETTE[0], width=0.004)
    point_figures.detector_outline(panel, folder.width_px, folder.height_px)
    panel.set(xlabel="column [px]", ylabel="row [px]", title=f"longest {longest:.2f}″")
    return figure


def _criteria(outcome: Outcome) -> list[Criterion]:
    return fit_criteria(outcome.result.reduced, outcome.result.folder)


own_frames = FramesTest(
    title="Turntable calibration",
    layout=POSES,
    reduce=reduce,
    describe=_describe,
    headline=_headline,
    tables=_tables,
    figures={"residuals": (_arrows, "Residuals of the images at the angles as read.")},
    criteria=_criteria,
    show=("unknowns",),
    series="Pose",
)
