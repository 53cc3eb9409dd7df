"""The hexapod moves the image as told, and errs as stated."""

from __future__ import annotations

import numpy as np
import pytest

from experiments.laboratory.devices.hexapod import Hexapod, step_path, turned
from optics.errors import DomainError
from optics.units import ARCSEC_RAD

IDEAL = Hexapod(step_error_arcsec=0.0, roll_error_arcsec=0.0, reading_error_arcsec=0.0)


def test_a_step_along_45_deg_moves_the_image_equally_along_columns_and_rows():
    path = step_path(IDEAL, np.random.default_rng(0), positions=3, step_rad=1e-5, direction_deg=45.0)
    seen = turned(np.array([[0.0, 0.0, 1.0]]), path.true_rad)[:, 0]
    np.testing.assert_allclose(np.diff(seen[:, :2], axis=0), 1e-5 / np.sqrt(2.0), rtol=1e-9)


@pytest.mark.parametrize(("direction_deg", "axis"), [(0.0, 0), (90.0, 1)])
def test_directions_count_from_columns_towards_rows(direction_deg, axis):
    path = step_path(IDEAL, np.random.default_rng(0), positions=2, step_rad=1e-5, direction_deg=direction_deg)
    moved = np.diff(turned(np.array([[0.0, 0.0, 1.0]]), path.true_rad)[:, 0, :2], axis=0)[0]
    assert moved[axis] == pytest.approx(1e-5, rel=1e-9)
    assert abs(moved[1 - axis]) < 1e-15


def test_the_middle_of_the_path_is_at_rest():
    path = step_path(IDEAL, np.random.default_rng(0), positions=12, step_rad=1e-5, direction_deg=45.0)
    np.testing.assert_allclose(path.commanded_rad.mean(0), 0.0, atol=1e-18)


def test_errors_have_the_stated_size():
    hexapod = Hexapod(step_error_arcsec=0.4, roll_error_arcsec=2.0, reading_error_arcsec=0.1)
    count = 4000
    path = step_path(hexapod, np.random.default_rng(1), positions=count, step_rad=1e-6, direction_deg=45.0)
    margin = 4.0 / np.sqrt(2.0 * count)
    went = (path.true_rad - path.commanded_rad).std(0) / ARCSEC_RAD
    np.testing.assert_allclose(went, (0.4, 0.4, 2.0), rtol=margin)
    np.testing.assert_allclose((path.read_rad - path.true_rad).std(0) / ARCSEC_RAD, 0.1, rtol=margin)


def test_one_position_is_no_step():
    with pytest.raises(DomainError, match="positions = 1; at least 2"):
        step_path(IDEAL, np.random.default_rng(0), positions=1, step_rad=1e-6, direction_deg=0.0)


def test_a_negative_error_is_refused():
    with pytest.raises(DomainError, match=r"Hexapod\.roll_error_arcsec = -1"):
        Hexapod(roll_error_arcsec=-1.0)
