"""Criteria that several tests share."""

import numpy as np
import pytest

from experiments.laboratory.criteria import pixel_angle
from experiments.laboratory.instrument import build_instrument
from experiments.laboratory.settings import InstrumentConfig

IDEAL = """
name = "ideal"
source = "by hand"
design_wavelength_nm = 550.0
max_field_deg = 2.0

[[surface]]
element = "stop"
medium = "air"
stop = true
radius_mm = inf
thickness_mm = {stop_mm}
semi_diameter_mm = 5.0

[[surface]]
element = "lens"
medium = "air"
kind = "paraxial"
focal_length_mm = 100.0
thickness_mm = {image_mm}
semi_diameter_mm = 40.0
"""


@pytest.mark.parametrize(("stop_mm", "off_mm"), [(40.0, 0.0), (40.0, 5.0), (100.0, 5.0), (150.0, -5.0)])
def test_pixel_angle_away_from_the_focus(tmp_path, stop_mm, off_mm):
    """By hand: a chief ray of slope t meets a thin lens at s t, leaves it with t - s t / f, and the plane f + d behind
    it at t (f + d (1 - s / f)); telecentric with s = f."""
    file = tmp_path / "ideal.toml"
    file.write_text(IDEAL.format(stop_mm=stop_mm, image_mm=100.0 + off_mm))
    chip = {"detector": "cmv4000", "width_px": 256, "height_px": 256}
    criterion = pixel_angle(
        build_instrument(InstrumentConfig(lens=str(file), absorption=False, defocus_mm=0.0, **chip))
    )
    by_hand = 1.0 + off_mm / 100.0 * (1.0 - stop_mm / 100.0)
    assert criterion.about == pytest.approx(by_hand, abs=1e-6)
    assert criterion.value == pytest.approx(by_hand, abs=1e-6)


def test_pixel_angle_of_a_lens_whose_plane_is_not_at_its_paraxial_focus():
    """maksutov_1300mm: 1.1 mm before it, which is 0.4 % of the scale; aberrations leave a quarter of a percent."""
    chip = {"detector": "cmv4000", "width_px": 256, "height_px": 256}
    instrument = build_instrument(InstrumentConfig(lens="maksutov_1300mm", absorption=False, defocus_mm=0.0, **chip))
    criterion = pixel_angle(instrument)
    assert criterion.passed
    assert abs(criterion.value - 1.0) > criterion.limit  # what the focal length alone says
    assert np.sign(criterion.about - 1.0) == np.sign(criterion.value - 1.0)
