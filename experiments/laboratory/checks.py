"""What is said before long work: target points that the camera cannot see, stars far out of focus."""

from __future__ import annotations

import math

import numpy as np

from experiments.laboratory.bench import Bench
from experiments.laboratory.filter_wheel import open_band
from experiments.laboratory.instrument import Instrument, build_instrument
from experiments.laboratory.ray_prediction import expected_spots
from experiments.laboratory.settings import InstrumentConfig, PassbandConfig
from optics.arrays import FloatArray
from optics.errors import DomainError
from optics.frames import field_angles_deg
from optics.rays.paraxial import axial_paraxial
from optics.rays.performance import FocusCurve, white_focus
from optics.rays.spots import best_focus_shift_mm, trace_spots
from render.camera import Camera
from render.sky.star_light import star_light

__all__ = ["best_defocus_mm", "check_light", "focus_of", "focus_remark"]


RADII = 4.0
"""Least width of a window in RMS radii of the spot."""
WIDE_PX = 2.5
FAR_OUT = 1.5
"""Spots of this RMS radius that are that many times those in the best focus are hardly meant."""
PARTS = (0.0, 0.45, 0.7, 0.87, 1.0)
"""Fields, as parts of the distance from the middle to the corner of the detector."""
NODES = 6
"""Wavelengths of a pass band."""
STAR_K = 5800.0
"""Temperature of the star that is in focus."""


def check_light(bench: Bench, instrument: Instrument, direction: FloatArray) -> None:
    """Refuse a target whose light does not reach the detector, or not the window around its image."""
    position, radius_px, _ = expected_spots(bench, instrument, direction)
    dark = ~np.isfinite(position).all(axis=(2, 3))
    if dark.any():
        raise DomainError(
            f"no light of {int(dark.sum())} of {dark.size} target points gets through lens "
            f"{instrument.camera.lens.name!r}; look at its clear apertures or raise target.edge_px"
        )
    widest = float(radius_px.max())
    if RADII * widest > bench.window_px:
        window = 2 * math.ceil((RADII * widest - 1.0) / 2.0) + 1
        field_x, field_y = field_angles_deg(direction.reshape(-1, 3))
        waves = [band.centre_nm for band in bench.filters]
        best = best_focus_shift_mm(instrument.camera.lens, field_x, field_y, waves)
        raise DomainError(
            f"the image of a target point has an RMS radius of {widest:.1f} px, for which window_px = "
            f"{bench.window_px} is too small (at least four RMS radii); best focus for these filters is at "
            f"instrument.defocus_mm = {best:.3f} mm (it is {instrument.camera.defocus_mm:g} mm), or set "
            f"window_px = {window}"
        )


def focus_of(camera: Camera, wavelength_nm: FloatArray, share: FloatArray) -> FocusCurve:
    """Mean square spot over the detector against the defocus from where it stands; ``share`` weighs wavelengths."""
    lens = camera.focused_lens
    focal_mm = abs(axial_paraxial(lens, lens.design_wavelength_nm).efl_mm)
    corner_mm = 0.5 * math.hypot(camera.width_px, camera.height_px) * camera.pixel_pitch_mm
    field_deg = min(math.degrees(math.atan2(corner_mm, focal_mm)), lens.max_field_deg) * np.array(PARTS)
    return white_focus(trace_spots(lens, field_deg, 0.0 * field_deg, wavelength_nm), share).mean


def best_defocus_mm(config: InstrumentConfig, passband: PassbandConfig) -> float:
    """Defocus of the least mean square spot over the detector, for a star of 5800 K through the pass band."""
    instrument = build_instrument(config.model_copy(update={"defocus_mm": 0.0}))
    camera = instrument.camera
    if camera.lens.measured is not None:
        return 0.0
    light = star_light([open_band(passband, instrument)], nodes=NODES)
    wave = light.wavelength_nm[0]
    rate = light.photon_rate(np.zeros(1), np.array([STAR_K]))[0, 0] * camera.response_at(wave)
    return round(float(focus_of(camera, wave, rate / rate.sum()).best_mm), 5)


def focus_remark(camera: Camera, wavelength_nm: FloatArray, share: FloatArray | None = None) -> str:
    """What to say of a camera whose stars are far out of focus, a lens file's own image plane for one; empty if not."""
    focus = focus_of(camera, wavelength_nm, np.ones(len(wavelength_nm)) if share is None else share)
    radius_px, best_px = (float(focus.rms_mm(z)) / camera.pixel_pitch_mm for z in (0.0, focus.best_mm))
    if not (radius_px > WIDE_PX and radius_px > FAR_OUT * best_px):
        return ""
    return (
        f"stars are far out of focus: {radius_px:.1f} px RMS radius, {best_px:.1f} px with instrument.defocus_mm = "
        f"{camera.defocus_mm + float(focus.best_mm):.3f} (it is {camera.defocus_mm:g})"
    )
