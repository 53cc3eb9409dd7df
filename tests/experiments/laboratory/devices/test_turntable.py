"""The turntable as a device: setting, readings, their noise."""

import numpy as np

from experiments.laboratory.devices.turntable import build_turntable
from optics.units import ARCSEC_RAD
from render.engine.random import Streams


def test_nothing_wrong_with_it_reads_what_was_asked() -> None:
    angle = np.random.default_rng(0).uniform(-1, 1, (5, 2))
    table = build_turntable("yx")
    true = table.set(angle, Streams(1))
    np.testing.assert_array_equal(true, angle)
    np.testing.assert_array_equal(table.read(true, Streams(1)), angle)


def test_noise_of_setting_and_reading() -> None:
    """N = 20000: a standard deviation is known to 1 / sqrt(2 N) = 0.5 %, four of those are allowed."""
    table = build_turntable("xy", reading_noise_arcsec=(0.3, 0.4), setting_noise_arcsec=2.0)
    asked = np.zeros((20000, 2))
    true = table.set(asked, Streams(3))
    error = (table.read(true, Streams(3)) - true) / ARCSEC_RAD
    np.testing.assert_allclose(error.std(0), [0.3, 0.4], rtol=0.02)
    np.testing.assert_allclose(true.std(0) / ARCSEC_RAD, [2.0, 2.0], rtol=0.02)
    together = np.column_stack([error, true / ARCSEC_RAD])
    assert np.abs(np.corrcoef(together.T) - np.eye(4)).max() < 4 / np.sqrt(20000)


def test_noise_depends_on_nothing_but_its_place() -> None:
    table = build_turntable("xy", reading_noise_arcsec=1.0)
    long, short = (table.read(np.zeros((n, 2)), Streams(3)) for n in (9, 4))
    np.testing.assert_array_equal(long[:4], short)
    assert not np.array_equal(short, table.read(np.zeros((4, 2)), Streams(3), call=1))


def test_steps_and_encoder_wave() -> None:
    table = build_turntable(
        "xy", step_arcsec=(10.0, 0.0), encoder_amplitude_arcsec=(2.0, 0.0), encoder_cycles=(3.0, 1.0)
    )
    asked = np.array([[14.0, 14.0], [16.0, 16.0]]) * ARCSEC_RAD
    np.testing.assert_allclose(table.set(asked, Streams(0)) / ARCSEC_RAD, [[10, 14], [20, 16]], atol=1e-9)
    angle = np.array([[np.pi / 6, np.pi / 6]])  # sin(3 * 30 deg) = 1
    np.testing.assert_allclose((table.read(angle, Streams(0)) - angle) / ARCSEC_RAD, [[2.0, 0.0]], atol=1e-9)
