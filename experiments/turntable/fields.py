r"""Principal point against line of sight, over the field of view: bounds of ideal cameras on perfect tables.

A shift of the principal point moves every image by (1, 0); a turn of the installation moves it by (1 + t_x^2, t_x t_y)
with t the tangents of the field angles. Their difference is of second order in the field: the error of the principal
point of an undistorted camera with known star is :math:`\sigma / \sqrt{n \langle t^4 \rangle}` [px] for images of
standard deviation sigma at n positions, while that of the line of sight does not depend on the field.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from calib.calibration.star_bench import StarBench, aiming_angles
from calib.calibration.table_bound import TableBound, table_bound
from calib.cameras import BrownConrady, SensorGeometry
from calib.cameras.base import CameraModel
from experiments.harness.drawings import curves
from experiments.harness.sections import Section, col
from experiments.laboratory.devices.turntable import build_turntable
from optics.arrays import FloatArray
from optics.units import RAD_ARCSEC

SWEEP_PX, SWEEP_PITCH_MM = 2048, 0.0055
SWEEP_SENSOR = SensorGeometry(width_px=SWEEP_PX, height_px=SWEEP_PX, pixel_pitch_mm=SWEEP_PITCH_MM)
SWEEP_SIDE = 13
"""Cameras of the field sweep: pixels along each side, their pitch, positions along each side."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PrincipalPointBound:
    """Bounds for a camera of a square field, all unknowns; rolled: quarter turns of a third axis between positions."""

    field_deg: float = col("Full field of view", "deg", "g")
    principal_point_sigma_px: float = col("σ(x₀)", "px", ".3g")
    principal_point_sigma_arcsec: float = col("Principal point, two axes", "arcsec", ".3g")
    principal_point_inflation: float = col("inflated", "", ".0f")  # Over the bound with all else known
    principal_point_sigma_rolled_px: float = col("σ(x₀), rolled", "px", ".3g")
    principal_point_sigma_rolled_arcsec: float = col("Principal point, three axes", "arcsec", ".3g")
    map_sigma_arcsec: float = col("Map, RMS length", "arcsec", ".4f")
    map_sigma_rolled_arcsec: float = col("Map, rolled", "arcsec", ".4f")
    line_of_sight_sigma_arcsec: float = col("Line of sight per axis, two axes", "arcsec", ".3g")
    line_of_sight_sigma_rolled_arcsec: float = col("Line of sight per axis, three axes", "arcsec", ".3g")
    single_image_sigma_arcsec: float = col("A single image", "arcsec", ".3g")
    principal_point_ratio: float = col("Principal point over line of sight", "", ".0f")


def field_sweep(fields_deg: Sequence[float], sigma_px: float) -> list[PrincipalPointBound]:
    """Bounds over the field for images of standard deviation ``sigma_px`` per axis."""
    points = []
    for field in fields_deg:
        model = BrownConrady.of_field(SWEEP_SENSOR, field)
        full, rolled = (ideal_bound(model, axes, sigma_px) for axes in ("xy", "xyz"))
        scale = float(SWEEP_PITCH_MM / model.value("focal_length_mm") * RAD_ARCSEC)
        per_axis = 1.0 / float(np.sqrt(2.0))  # From the RMS length of two axes
        points.append(
            PrincipalPointBound(
                field_deg=float(field),
                principal_point_sigma_px=full.of("x0_px"),
                principal_point_sigma_arcsec=full.of("x0_px") * scale,
                principal_point_inflation=full.inflation("x0_px"),
                principal_point_sigma_rolled_px=rolled.of("x0_px"),
                principal_point_sigma_rolled_arcsec=rolled.of("x0_px") * scale,
                map_sigma_arcsec=full.map_sigma_arcsec,
                map_sigma_rolled_arcsec=rolled.map_sigma_arcsec,
                line_of_sight_sigma_arcsec=full.map_sigma_arcsec * per_axis,
                line_of_sight_sigma_rolled_arcsec=rolled.map_sigma_arcsec * per_axis,
                single_image_sigma_arcsec=sigma_px * scale,
                principal_point_ratio=full.of("x0_px") * scale / (full.map_sigma_arcsec * per_axis),
            )
        )
    return points


def ideal_bound(model: CameraModel, axes: str, sigma_px: float) -> TableBound:
    """Bound of an ideal camera on a perfect table; a third axis makes quarter turns."""
    bench = StarBench(table=build_turntable(axes), star=np.array([0.0, 0.0, 1.0]), installation=Rotation.identity())
    direction = model.unproject(model.geometry.grid_px(SWEEP_SIDE))
    angle = aiming_angles(bench, direction, np.asarray(np.arange(len(direction)) % 4 * (np.pi / 2), np.float64))
    covariance: FloatArray = np.tile(np.eye(2) * sigma_px**2, (len(direction), 1, 1))
    return table_bound(model, bench, angle, covariance, direction, leans=False)


FIELDS = Section(
    record=PrincipalPointBound,
    dim="field",
    along="field_deg",
    table="field_sweep",
    columns="principal_point_sigma_px principal_point_sigma_arcsec principal_point_inflation map_sigma_arcsec "
    "principal_point_sigma_rolled_px map_sigma_rolled_arcsec",
    caption="Bound of principal point and line of sight over the field (Cramér–Rao).",
    note=f"Ideal cameras of {SWEEP_PX} × {SWEEP_PX} px, {SWEEP_SIDE} × {SWEEP_SIDE} positions, perfect tables. "
    "Inflated: over the standard deviation with everything else known. Rolled: quarter turns of a third axis between "
    "positions.",
    figures={
        "field_curves": curves(
            "field",
            lines="principal_point_sigma_arcsec principal_point_sigma_rolled_arcsec line_of_sight_sigma_arcsec "
            "line_of_sight_sigma_rolled_arcsec single_image_sigma_arcsec",
            log="xy",
            y="1 σ per axis",
        )
    },
)
