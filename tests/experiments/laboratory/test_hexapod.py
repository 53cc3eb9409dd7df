"""The hexapod moves the image as told, and errs as stated."""

from __future__ import annotations

import numpy as np
import pytest

from experiments.laboratory.devices.hexapod import step_path, turned
from experiments.laboratory.settings.tables import HexapodConfig, StepConfig
from optics.units import ARCSEC_RAD

IDEAL = HexapodConfig(step_error_arcsec=0.0, roll_error_arcsec=0.0, reading_error_arcsec=0.0)
PIXEL_ARCSEC = 1e-5 / ARCSEC_RAD


def path_of(positions, direction_deg=45.0, hexapod=IDEAL, seed=0):
    """Steps of 1e-5 rad."""
    steps = StepConfig(positions=positions, step_px=1.0, direction_deg=direction_deg)
    return step_path(hexapod, steps, PIXEL_ARCSEC, np.random.default_rng(seed))


@pytest.mark.parametrize(
    ("direction_deg", "step"), [(0.0, (1.0, 0.0)), (45.0, (0.5**0.5, 0.5**0.5)), (90.0, (0.0, 1.0))]
)
def test_directions_count_from_columns_towards_rows(direction_deg, step):
    image = turned(np.array([[0.0, 0.0, 1.0]]), path_of(3, direction_deg).true_rad)[:, 0, :2]
    np.testing.assert_allclose(np.diff(image, axis=0), 1e-5 * np.tile(step, (2, 1)), rtol=1e-9, atol=1e-15)


def test_the_middle_of_the_path_is_at_rest():
    path = path_of(12)
    np.testing.assert_allclose(path.commanded_rad.mean(0), 0.0, atol=1e-18)


def test_errors_have_the_stated_size():
    hexapod = HexapodConfig(step_error_arcsec=0.4, roll_error_arcsec=2.0, reading_error_arcsec=0.1)
    paths = [path_of(200, hexapod=hexapod, seed=seed) for seed in range(20)]
    commanded, true, read = (
        np.concatenate([getattr(path, f"{name}_rad") for path in paths]) for name in ("commanded", "true", "read")
    )
    margin = 4.0 / np.sqrt(2.0 * 4000)
    np.testing.assert_allclose((true - commanded).std(0) / ARCSEC_RAD, (0.4, 0.4, 2.0), rtol=margin)
    np.testing.assert_allclose((read - true).std(0) / ARCSEC_RAD, 0.1, rtol=margin)
