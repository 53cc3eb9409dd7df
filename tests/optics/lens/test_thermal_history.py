"""Temperatures over time: the exact answer of a first-order body, and what lies between the rows of a table."""

import numpy as np
import pytest

from optics.lens.thermal_history import ThermalHistory, first_order_response


def test_first_order_response_to_a_step_and_to_a_square_wave():
    time = 7.0 * np.arange(200)
    warmed = np.where(time > 0.0, 2.0, 0.0)
    np.testing.assert_allclose(
        first_order_response(warmed, step_s=7.0, constant_s=90.0), 2.0 * (1.0 - np.exp(-time / 90.0)), rtol=1e-12
    )
    # on for a and off for b: the hottest is (1 - exp(-a)) / (1 - exp(-a - b)), times in time constants
    wave = np.tile(np.repeat([1.0, 0.0], [300, 700]), 12)
    response = first_order_response(wave, step_s=0.01, constant_s=1.0)[-1000:]
    hottest = (1.0 - np.exp(-3.0)) / (1.0 - np.exp(-10.0))
    assert response.max() == pytest.approx(hottest, rel=1e-9)
    assert response.min() == pytest.approx(hottest * np.exp(-7.0), rel=1e-9)


def test_states_are_linear_between_rows_and_constant_beyond():
    table = ThermalHistory(time_s=[0.0, 10.0], values_k=np.array([np.zeros(5), np.arange(5.0)]))
    np.testing.assert_allclose(table.at([-1.0, 2.5, 99.0]), np.outer([0.0, 0.25, 1.0], np.arange(5.0)))
    assert table.at(5.0).shape == (5,)
