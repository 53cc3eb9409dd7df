"""Ends and step of a converter from drawn readings."""

from __future__ import annotations

import numpy as np

from calib.detector.adc_range import converter_range


def readings(seed=1, top=65535, step=1):
    noise = np.random.default_rng(seed).normal(90.0, 12.0, (4, 5000))
    return (np.rint(noise / step) * step).clip(0, top).astype(np.uint16)


def test_ends_and_step_of_a_converter():
    found = converter_range(readings(), false_alarm=1e-3)
    assert (found.step_dn, found.zero_fraction) == (1, 0.0)
    assert found.top_count <= found.top_limit
    found = converter_range(readings(top=110), false_alarm=1e-3)
    assert found.top_dn == 110
    assert found.top_count > 3 * found.top_limit
    dark = converter_range([np.array([0, 0, 7], np.uint16), np.array([9], np.uint16)], false_alarm=1e-3)
    assert dark.zero_fraction == 0.5
    found = converter_range(readings(step=4), false_alarm=1e-3)
    assert found.step_dn == 4
    assert found.top_count <= found.top_limit
    assert converter_range([np.full(9, 5)], false_alarm=1e-3).step_dn == 1
