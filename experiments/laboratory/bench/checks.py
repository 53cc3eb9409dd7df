"""Checks before long work: target points outside the camera's field, stars far out of focus."""

from __future__ import annotations

import math

import numpy as np

from experiments.laboratory.bench.point_bench import Bench
from experiments.laboratory.bench.ray_prediction import expected_spots
from optics.arrays import FloatArray
from optics.errors import DomainError
from optics.frames import field_angles_deg
from optics.rays.best_focus import best_focus_shift_mm
from render.sensor import StarSensor
from render.sensor_file.instrument import Instrument

WINDOW_RADII = 4.0
"""Least width of a window in RMS radii of the spot."""
DEFOCUSED_PX, DEFOCUSED_RATIO = 2.5, 1.5
"""RMS radius of a spot, and its ratio to the radius in best focus, above which a defocus is taken for a mistake."""


def check_light(bench: Bench, instrument: Instrument, direction: FloatArray) -> None:
    """Refuse a target whose light does not reach the detector, or exceeds the windows."""
    position, radius_px, _ = expected_spots(bench, instrument, direction)
    dark = ~np.isfinite(position).all(axis=(2, 3))
    if dark.any():
        raise DomainError(
            f"no light of {int(dark.sum())} of {dark.size} target points gets through lens "
            f"{instrument.camera.lens.name!r}; check its clear apertures or raise target.edge_px"
        )
    widest = float(radius_px.max())
    if WINDOW_RADII * widest > bench.window_px:
        window = 2 * math.ceil((WINDOW_RADII * widest - 1.0) / 2.0) + 1
        field_x, field_y = field_angles_deg(direction.reshape(-1, 3))
        waves = [band.centre_nm for band in bench.filters]
        best = best_focus_shift_mm(instrument.camera.lens, field_x, field_y, waves)
        raise DomainError(
            f"the image of a target point has an RMS radius of {widest:.1f} px, for which window_px = "
            f"{bench.window_px} is too small (at least four RMS radii); best focus for these filters is at "
            f"instrument.defocus_mm = {best:.3f} mm (it is {instrument.camera.defocus_mm:g} mm), or set "
            f"window_px = {window}"
        )


def focus_remark(sensor: StarSensor, wavelength_nm: FloatArray, weight: FloatArray | None = None) -> str:
    """Warning for stars far out of focus, such as at a lens file's own image plane; empty otherwise."""
    focus = sensor.focus_curve(wavelength_nm, np.ones(len(wavelength_nm)) if weight is None else weight)
    radius_px, best_px = (float(focus.rms_mm(z)) / sensor.camera.pixel_pitch_mm for z in (0.0, focus.best_mm))
    if not (radius_px > DEFOCUSED_PX and radius_px > DEFOCUSED_RATIO * best_px):
        return ""
    return (
        f"stars are far out of focus: {radius_px:.1f} px RMS radius, {best_px:.1f} px with instrument.defocus_mm = "
        f"{sensor.camera.defocus_mm + float(focus.best_mm):.3f} (it is {sensor.camera.defocus_mm:g})"
    )
