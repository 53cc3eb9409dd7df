"""What is said before long work."""

import re

import numpy as np
import pytest

from experiments.laboratory.bench.checks import focus_remark
from optics.rays.spots import spot_moments
from render.sensor_file.instrument import build_instrument
from render.sensor_file.tables import InstrumentConfig

WAVELENGTH_NM = np.linspace(500.0, 800.0, 6)


def sensor(defocus_mm):
    chip = {"detector": "cmv4000", "width_px": 1024, "height_px": 1024}
    return build_instrument(InstrumentConfig(lens="star_camera_206mm", defocus_mm=defocus_mm, **chip))


def test_stars_far_out_of_focus_are_told_with_the_focus():
    said = focus_remark(sensor(0.15), WAVELENGTH_NM)
    radius_px, best_px, best_mm = (float(text) for text in re.findall(r"-?\d+\.\d+", said)[:3])
    assert focus_remark(sensor(best_mm), WAVELENGTH_NM) == ""
    corner_deg = np.degrees(np.arctan(512 * np.sqrt(2.0) * 5.5e-3 / 206.25))
    field = corner_deg * np.array([0.0, 0.5, 0.7, 0.9])
    for z, told in ((0.15, radius_px), (best_mm, best_px)):
        spots = spot_moments(sensor(z).camera.focused_lens, field, 0.0 * field, WAVELENGTH_NM)
        square = spots.rms_radius_mm**2 + (spots.x_mm - spots.x_mm.mean(1, keepdims=True)) ** 2
        assert told == pytest.approx(np.sqrt(square.mean()) / 5.5e-3, abs=0.06)
    # geometry alone: a cone of F/2.95, the radius of the blur circle over the square root of 2
    assert radius_px == pytest.approx((0.15 - best_mm) / (2 * 2.95) / np.sqrt(2.0) / 5.5e-3, rel=0.05)
