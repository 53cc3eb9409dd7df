"""Angles of a pixel, and mistakes in settings."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from calib.cameras import BrownConrady, SensorGeometry
from experiments.fisher.accuracy import _angles_per_pixel, check_config
from experiments.fisher.settings import Config
from optics.errors import StarbenchError


def test_angle_of_a_pixel_by_focal_length_and_by_the_field(star_camera) -> None:
    """The last one is the angle between the directions of the outer edges over the number of pixels."""
    camera = star_camera.camera
    geometry = SensorGeometry(
        width_px=camera.width_px, height_px=camera.height_px, pixel_pitch_mm=camera.pixel_pitch_mm
    )
    model = BrownConrady.create(geometry, focal_length_mm=200.0)
    found = _angles_per_pixel(SimpleNamespace(instrument=star_camera, model=model))
    middle = (camera.height_px - 1) / 2
    left, right = model.unproject([[-0.5, middle], [camera.width_px - 0.5, middle]])
    expected = [camera.pixel_pitch_mm / 200.0, np.arccos(left @ right) / camera.width_px]
    assert [list(found.values())[i] for i in (0, 2)] == pytest.approx(np.array(expected) * 648000 / np.pi, rel=1e-6)


@pytest.mark.parametrize(
    ("setting", "words"),
    [
        ("table.axes=x", "2 or 3"),
        ("table.axes=xx", "orthogonal"),
        ("table.axes=q", "letters"),
        ("table.axes=xyz", "table.rolls_deg = [0.0]"),
        ("table.reading_noise_arcsec=[0.1,0.1,0.1]", "table.reading_noise_arcsec"),
        ("table.reading_noise_arcsec=[-0.1]", "at least 0"),
        ("evaluation.columns=100", "lower evaluation.columns"),
        ("evaluation.edge_px=5", "evaluation.edge_px = 5 px"),
        ("evaluation.edge_px=900", "evaluation.edge_px"),
        ("grid.edge_px=900", "grid.edge_px"),
        ("dynamic.rate_deg_per_s=5", "smears the image"),
        ("dynamic.samples=2", "dynamic.samples = 2"),
        ("field.field_deg=[3.0,150.0]", "field_deg"),
        ("passband.range_nm=[100,200]", "nm"),
    ],
)
def test_bad_settings_get_one_line(setting: str, words: str, refused_by) -> None:
    assert words in refused_by("fisher", "--set", setting)


def test_defaults_are_accepted_without_rendering() -> None:
    assert check_config(Config()).pixel_arcsec == pytest.approx(5.5005, abs=1e-3)
    with pytest.raises(StarbenchError, match=r"evaluation\.columns or evaluation\.rows"):
        check_config(Config.model_validate({"evaluation": {"columns": 2, "rows": 2}}))
