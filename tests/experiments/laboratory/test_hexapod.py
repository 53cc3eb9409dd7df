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


def test_a_step_along_45_deg_moves_the_image_equally_along_columns_and_rows():
    path = path_of(3)
    seen = turned(np.array([[0.0, 0.0, 1.0]]), path.true_rad)[:, 0]
    np.testing.assert_allclose(np.diff(seen[:, :2], axis=0), 1e-5 / np.sqrt(2.0), rtol=1e-9)


@pytest.mark.parametrize(("direction_deg", "axis"), [(0.0, 0), (90.0, 1)])
def test_directions_count_from_columns_towards_rows(direction_deg, axis):
    path = path_of(2, direction_deg)
    moved = np.diff(turned(np.array([[0.0, 0.0, 1.0]]), path.true_rad)[:, 0, :2], axis=0)[0]
    assert moved[axis] == pytest.approx(1e-5, rel=1e-9)
    assert abs(moved[1 - axis]) < 1e-15


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
