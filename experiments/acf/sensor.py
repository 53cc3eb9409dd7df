"""The camera of a sensor file for this experiment: a Brown-Conrady model of its chief rays."""

from __future__ import annotations

from typing import Any

import numpy as np

from calib.cameras.base import SensorGeometry
from calib.cameras.brown_conrady import BrownConrady
from calib.cameras.fit import fit_to_map
from optics.distortion_polynomial import COEFFICIENTS
from optics.frames import field_angles_deg
from optics.rays.chief_ray import chief_ray_points
from render.sensor_file.instrument import build_instrument
from render.sensor_file.tables import InstrumentConfig

POINTS = 15
"""Along each side of the detector; seven would determine the four unknowns."""


def camera_settings(config: InstrumentConfig) -> dict[str, Any]:
    """Table ``camera`` of the experiment: focal length and radial distortion fitted to chief rays over the detector."""
    instrument = build_instrument(config)
    instrument.check_field()
    camera = instrument.camera
    geometry = SensorGeometry(
        width_px=camera.width_px, height_px=camera.height_px, pixel_pitch_mm=camera.pixel_pitch_mm
    )
    x_px, y_px = geometry.grid_px(POINTS).T
    direction = camera.nominal_direction(x_px, y_px, instrument.focal_length_mm)
    lens = camera.focused_lens
    x_mm, y_mm = chief_ray_points(lens, *field_angles_deg(direction), blocked="follow")
    pixel = camera.centre_px + np.column_stack([x_mm, -y_mm]) / camera.pixel_pitch_mm
    if lens.measured is not None:  # a camera model of this experiment, at its reference wavelength
        x0_px, y0_px = lens.measured.principal_point_mm / camera.pixel_pitch_mm
        distortion = dict(zip(COEFFICIENTS, lens.measured.distortion.tolist(), strict=True))
        fitted = {"focal_length_mm": lens.measured.focal_length_mm, **distortion}
    else:
        x0_px = y0_px = 0.0
        start = BrownConrady.create(geometry, focal_length_mm=instrument.focal_length_mm)
        free = ("focal_length_mm", "q1_per_mm2", "q2_per_mm4", "q3_per_mm6")
        model = fit_to_map(start, direction, pixel, free=free, turn=False).model
        fitted = {"p1_per_mm": 0.0, "p2_per_mm": 0.0, **{name: model.value(name) for name in free}}
    return {
        "width_px": camera.width_px,
        "height_px": camera.height_px,
        "pixel_pitch_um": 1e3 * camera.pixel_pitch_mm,
        "x0_px": float(x0_px),
        "y0_px": float(y0_px),
        **fitted,
    }
