"""Angles of a pixel, and the default settings."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from calib.cameras import BrownConrady, SensorGeometry
from experiments.fisher.accuracy import _angles_per_pixel, check_config
from experiments.fisher.settings import FisherConfig


def test_angle_of_a_pixel_by_focal_length_and_by_the_field(star_camera) -> None:
    """The last one is the angle between the directions of the outer edges over the number of pixels."""
    camera = star_camera.camera
    geometry = SensorGeometry(
        width_px=camera.width_px, height_px=camera.height_px, pixel_pitch_mm=camera.pixel_pitch_mm
    )
    model = BrownConrady.create(geometry, focal_length_mm=200.0)
    angles = _angles_per_pixel(SimpleNamespace(instrument=star_camera, model=model))
    middle = (camera.height_px - 1) / 2
    left, right = model.unproject([[-0.5, middle], [camera.width_px - 0.5, middle]])
    expected = [camera.pixel_pitch_mm / 200.0, np.arccos(left @ right) / camera.width_px]
    assert [list(angles.values())[i] for i in (0, 2)] == pytest.approx(np.array(expected) * 648000 / np.pi, rel=1e-6)


def test_defaults_are_accepted_without_rendering() -> None:
    assert check_config(FisherConfig()).pixel_arcsec == pytest.approx(5.5005, abs=1e-3)
