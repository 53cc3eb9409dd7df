"""Turntable calibration from a laboratory's own frames: every series is a pose of the table."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from experiments.harness.drawings import arrows
from experiments.harness.sections import Section, col
from experiments.harness.summary import Measured, measured
from experiments.reduce.folder import FrameFolder
from experiments.reduce.pipeline import FramesTest, Reduced
from experiments.reduce.poses import FIT, POSES, PoseCalibration, calibrate_poses, fit_record
from optics.arrays import FloatArray


@dataclass(frozen=True, slots=True, kw_only=True)
class PoseUnknown:
    """An unknown of the joint calibration."""

    name: str = col("Unknown")
    estimate: Measured = col("Value")


@dataclass(frozen=True, slots=True, kw_only=True)
class PoseErrors:
    """Errors of the calibration."""

    poses: int = col("Poses")
    map_error_arcsec: float = col("Error of the line of sight", "arcsec", ".4f", shown=False)
    residual_px: FloatArray = col("Residual, RMS", "px", ".4f", "axis")
    centroid_sigma_px: FloatArray = col("Centroid, stated", "px", ".4f", "axis")


@dataclass(frozen=True, slots=True, kw_only=True)
class PoseImage:
    """The star at a pose."""

    position_px: FloatArray = col("Image", "px", ".4f", "axis")
    residual_px: FloatArray = col("Residual", "px", ".4f", "axis")
    residual_arcsec: FloatArray = col("Residuals", "arcsec", ".2f", "axis", shown=False)


def reduce(folder: FrameFolder, methods: Sequence[str], config: Any = None) -> Reduced:
    """Joint calibration from all poses of a folder; raises the errors of `calibrate_poses`."""
    poses = calibrate_poses(folder, methods, ("calibration", "evaluation"))
    return poses.series, {
        "unknowns": tabulate_unknowns(poses),
        "errors": PoseErrors(
            poses=len(poses.series),
            map_error_arcsec=poses.map_error_arcsec,
            residual_px=np.sqrt((poses.residual_px**2).mean(0)),
            centroid_sigma_px=np.sqrt(np.diagonal(poses.data.covariance_px2, axis1=1, axis2=2).mean(0)),
        ),
        "fit": fit_record(poses, folder),
        "poses": [
            PoseImage(
                position_px=position,
                residual_px=residual,
                residual_arcsec=residual * folder.settings.pixel_arcsec,
            )
            for position, residual in zip(poses.data.pixel_px, poses.residual_px, strict=True)
        ],
    }


def tabulate_unknowns(poses: PoseCalibration) -> list[PoseUnknown]:
    """Unknowns in the order of the estimator."""
    solution = poses.calibration.solution
    rows = zip(solution.names, measured(solution.value, solution.sigma), strict=True)
    return [PoseUnknown(name=name, estimate=value) for name, value in rows]


own_frames = FramesTest(
    title="Turntable calibration",
    layout=POSES,
    reduce=reduce,
    sections={
        "unknowns": Section(
            record=PoseUnknown,
            dim="unknown",
            along="name",
            caption="Unknowns of the joint calibration, in the unit at the end of the name.",
            note="One standard deviation by the stated noise. Star: direction in the laboratory, the table's frame at "
            "zero angles; theta: installation (cam from table top) by ACF17; lean: 90° minus the angle of neighbouring "
            "axes.",
        ),
        "errors": Section(
            record=PoseErrors,
            table="residuals",
            rows="axis",
            columns="residual_px centroid_sigma_px",
            caption="Residuals for the angles read, and the stated error of a centroid.",
        ),
        "fit": FIT,
        "poses": Section(
            record=PoseImage,
            dim="series",
            across="axis",
            caption="Images of the poses.",
            figures={"residuals": arrows("position_px", "residual_arcsec", frame="frame_size_px")},
        ),
    },
    head={
        "Focal length [mm]": ("estimate", {"unknown": "focal_length_mm"}),
        "Error of the line of sight, RMS": ("map_error_arcsec", {}),
    },
    captions={"residuals": "Residuals of the images at the angles as read."},
    series="Pose",
)
