"""Mean and variance of pixels, predicted and measured on many frames of the detector chain.

The standard error of a mean over pixels comes from the measured scatter of the pixels; four are allowed.
"""

import dataclasses

import numpy as np
import pytest
from numpy.typing import NDArray

from optics.arrays import FloatArray
from render.detector.noise import PixelNoise, damage_moments, damage_steps
from render.detector.readout import expose_windows
from render.detector.spec import Detector, load_detector
from render.engine.random import Streams

SHEET = dataclasses.replace(load_detector("cmv4000"), hot_fraction=0.0, nonlinearity=())
CHIPS = {
    "as the data sheet says": SHEET,
    "read noise differs": dataclasses.replace(SHEET, read_noise_spread=0.4),
    "damaged": dataclasses.replace(SHEET, damage_centres_per_px=3.0, damage_dark_e_per_s=15000.0),
    "damage known in part": dataclasses.replace(
        SHEET, damage_centres_per_px=3.0, damage_dark_e_per_s=15000.0, damage_known_e_per_s=40000.0
    ),
    "coarse converter": dataclasses.replace(SHEET, gain_dn_per_e=0.1, offset_dn=20.0),
}
FRAMES, WINDOWS, SIDE = 60, 40, 24
CONDITIONS = {"exposure_s": 0.1, "temperature_c": 0.0}
LIGHT = 400.0


@pytest.fixture(scope="module", params=list(CHIPS))
def chip(request: pytest.FixtureRequest) -> Detector:
    return CHIPS[request.param]


def pixels(chip: Detector, light_e: float, seed: int) -> FloatArray:
    """Electrons above the offset (frames, pixels) of pixels that are not in the map of defects."""
    corner = np.stack(np.meshgrid(np.arange(8) * 200 + 7, np.arange(5) * 300 + 11), axis=-1).reshape(-1, 2)
    stack = expose_windows(
        np.full((WINDOWS, SIDE, SIDE), light_e), corner, chip, streams=Streams(seed), frames=FRAMES, **CONDITIONS
    )
    return np.asarray((stack.dn[:, ~stack.defect].astype(float) - chip.offset_dn) / chip.gain_dn_per_e)


@pytest.fixture(scope="module")
def dark(chip: Detector) -> FloatArray:
    return pixels(chip, 0.0, 1)


@pytest.fixture(scope="module")
def lit(chip: Detector) -> FloatArray:
    return pixels(chip, LIGHT, 2)


def same_mean(values: FloatArray, expected: float) -> None:
    assert abs(values.mean() - expected) < 4.0 * values.std(ddof=1) / np.sqrt(values.size)


def test_temporal_variance(chip: Detector, dark: FloatArray, lit: FloatArray) -> None:
    """N = 23040 pixels of 60 frames, without light and with it: good to 0.1 to 0.7 %."""
    for values, light_e in ((dark, 0.0), (lit, LIGHT)):
        same_mean(values.var(0, ddof=1), float(PixelNoise.of(chip, **CONDITIONS).temporal_e2(light_e)))


def test_variance_of_means_less_dark_frames(chip: Detector, dark: FloatArray, lit: FloatArray) -> None:
    """Means of 4 frames less means of 3 dark frames, 15 times."""
    means = lit.reshape(15, 4, -1).mean(1) - dark[:45].reshape(15, 3, -1).mean(1)
    expected = PixelNoise.of(chip, **CONDITIONS).temporal_e2(LIGHT, frames=4, dark_frames=3)
    same_mean(means.var(0, ddof=1), float(expected))


def test_dark_charge(chip: Detector, dark: FloatArray) -> None:
    """The mean of dark pixels; the columns' common offsets are subtracted by a detector without current."""
    cold = dataclasses.replace(chip, dark_current_e_per_s=0.0, damage_centres_per_px=0.0)
    if chip.damage_known_e_per_s < 1e7:
        pytest.skip("the two chips do not have the same pixels left")
    same_mean(dark.mean(0) - pixels(cold, 0.0, 3).mean(0), PixelNoise.of(chip, **CONDITIONS).dark_e)


def test_patterns(chip: Detector, dark: FloatArray, lit: FloatArray) -> None:
    """Variances over the pixels of dark frames, and of what light adds."""
    noise = PixelNoise.of(chip, **CONDITIONS)
    level = dark.mean(0) - dark.mean()
    same_mean(level**2, noise.offset_e**2 + noise.column_e**2 + float(noise.temporal_e2(0.0, frames=FRAMES)))
    gained = lit.mean(0) - dark.mean(0)
    expected = noise.response_e2(LIGHT) + noise.temporal_e2(LIGHT, frames=FRAMES, dark_frames=FRAMES)
    same_mean((gained - gained.mean()) ** 2, float(expected))


def test_pixels_differ_by_as_much_as_stated(chip: Detector, dark: FloatArray) -> None:
    """Covariance of the variances of even and of odd frames: their own errors are independent and leave it as it is."""
    even, odd = (dark[k::2].var(0, ddof=1) for k in (0, 1))
    product = (even - even.mean()) * (odd - odd.mean())
    noise = PixelNoise.of(chip, **CONDITIONS)
    same_mean(product, noise.floor_e4)


def drawn(number: int, centres: float, mean: float, below: float) -> NDArray[np.float64]:
    rng = np.random.default_rng(7)
    count = rng.poisson(centres, number)
    total = np.zeros(number)
    total[count > 0] = rng.gamma(count[count > 0], mean)
    return total[total < below]


@pytest.mark.parametrize("below", [1e7, 9.0, 2.0])
@pytest.mark.parametrize("centres", [0.2, 3.0, 40.0])
def test_moments_of_damage(centres: float, below: float) -> None:
    """Drawn compound Poisson variates, those below a limit; 10^6 pixels."""
    below *= centres if below < 1e6 else 1.0
    some = drawn(1_000_000, centres, 1.5, below)
    chip = dataclasses.replace(
        SHEET, damage_centres_per_px=centres, damage_dark_e_per_s=1.5, damage_known_e_per_s=below
    )
    mean, variance = damage_moments(chip)
    same_mean(some, mean)
    same_mean((some - mean) ** 2, variance)
    value, share = damage_steps(chip)  # the shares of some limits, with the steps of the values
    for limit in np.quantile(some, [0.3, 0.6, 0.9]):
        assert share[value <= limit].sum() == pytest.approx((some <= limit).mean(), abs=0.03)


@pytest.mark.parametrize(("centres", "dark"), [(0.0, 0.0), (20.0, 0.0), (0.0, 1.5)])
def test_no_damage(centres: float, dark: float) -> None:
    chip = dataclasses.replace(SHEET, damage_centres_per_px=centres, damage_dark_e_per_s=dark)
    assert damage_moments(chip) == (0.0, 0.0)


def test_dark_current_follows_the_temperature() -> None:
    warm, cold = (PixelNoise.of(SHEET, temperature_c=t, exposure_s=0.2) for t in (6.5, 0.0))
    assert warm.dark_e == pytest.approx(2.0 * cold.dark_e)  # 6.5 K double it
    assert warm.read_e2 == cold.read_e2
