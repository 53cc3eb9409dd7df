"""Jitter: power against the spectrum, closed-form rates against differences of attitudes, keys."""

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.signal import welch
from scipy.spatial.transform import Rotation

from render.engine.random import Streams
from render.motion.jitter import JitterSpectrum, jittered
from render.motion.trajectory import ConstantRate

ARCSEC = np.pi / 180 / 3600
BASE = ConstantRate(
    initial=Rotation.from_euler("zyx", [0.3, -0.4, 1.0]), rate_rad_per_s=np.array([1e-3, -2e-3, 5e-3]), end_s=400.0
)
SPECTRUM = JitterSpectrum(
    frequency_hz=np.array([0.05, 1.0, 8.0]),
    psd_arcsec2_per_hz=np.array([[4.0, 4.0, 0.01], [2.0, 0.1, 0.1], [0.0, 0.0, 0.0]]),
)


def test_power_is_the_integral_of_the_spectrum():
    def density(f, axis):
        return np.exp(np.interp(np.log(f), np.log(SPECTRUM.frequency_hz), np.log(SPECTRUM.psd_arcsec2_per_hz[axis])))

    motion = jittered(BASE, SPECTRUM, streams=Streams(3))
    for axis in (0, 1):
        expected = sum(quad(density, a, b, args=(axis,))[0] for a, b in ((0.05, 1.0), (1.0, 8.0)))
        assert SPECTRUM.rms_arcsec[axis] ** 2 == pytest.approx(expected, rel=1e-9)
        drawn = 0.5 * (motion.amplitude_rad[axis] ** 2).sum() / ARCSEC**2
        assert drawn == pytest.approx(expected, rel=1e-12)
    assert SPECTRUM.rms_arcsec[2] == 0.0


@pytest.mark.slow
def test_spectrum_of_the_motion():
    """Welch's estimate in bands of two octaves; 400 s in overlapping segments of 20 s: N = 39, 10 % at the lowest."""
    motion = jittered(BASE, SPECTRUM, streams=Streams(8))
    offset = motion.offset_rad(np.arange(8000) * 0.05) / ARCSEC
    frequency, power = welch(offset, fs=20.0, nperseg=400, axis=0, detrend=False)
    for low, high in ((0.2, 0.8), (0.8, 3.2), (3.2, 7.5)):
        band = (frequency >= low) & (frequency < high)
        edges = np.array([frequency[band][0] - 0.025, frequency[band][-1] + 0.025])
        expected = SPECTRUM.power_arcsec2(edges)[:2, 0]
        assert power[band].sum(0)[:2] * 0.05 == pytest.approx(expected, rel=0.3)
    assert not offset[:, 2].any()


def test_rate_is_the_derivative_of_the_attitude():
    large = JitterSpectrum(frequency_hz=np.array([0.1, 2.0]), psd_arcsec2_per_hz=np.full((3, 2), 4e8))  # some degrees
    for spectrum, tolerance in ((SPECTRUM, 1e-9), (large, 1e-6)):
        motion = jittered(BASE, spectrum, streams=Streams(5), frame=7)
        times, h = np.linspace(1.0, 399.0, 13), 1e-4
        step = (motion.attitude(times + h) * motion.attitude(times - h).inv()).as_rotvec()
        assert np.abs(-step / (2 * h) - motion.rate(times)).max() < tolerance
        turned = (motion.attitude(times) * BASE.attitude(times).inv()).as_rotvec()
        assert -turned == pytest.approx(motion.offset_rad(times), abs=1e-12)
        assert motion.attitude(5.0).single
        assert motion.rate(5.0).shape == (3,)


def test_keys():
    times = np.linspace(0.0, 10.0, 7)
    first, again, other, frame = (
        jittered(BASE, SPECTRUM, streams=streams, frame=number).offset_rad(times)
        for streams, number in ((Streams(3), 0), (Streams(3), 0), (Streams(4), 0), (Streams(3), 1))
    )
    assert np.array_equal(first, again)
    assert np.abs(first - other).max() > 0.1 * ARCSEC
    assert np.abs(first - frame).max() > 0.1 * ARCSEC
