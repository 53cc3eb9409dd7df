"""The detector chain: closed forms, the photon-transfer method of EMVA 1288, windows against frames, and bad input."""

import dataclasses
from functools import partial
from typing import Any

import numpy as np
import pytest
from detectors import ideal_detector
from scipy.ndimage import convolve

from render.detector.readout import expose, expose_windows
from render.detector.spec import Detector, load_detector
from render.engine.random import Streams
from render.records import ExpectedImage, Frame

SHAPE = (256, 512)
N = SHAPE[0] * SHAPE[1]
ideal = partial(ideal_detector, *SHAPE)
SHIPPED = dataclasses.replace(load_detector("cmv4000"), chip_width_px=SHAPE[1], chip_height_px=SHAPE[0])
CROSSTALK = {"crosstalk_horizontal": 0.02, "crosstalk_vertical": 0.03, "crosstalk_diagonal": 0.004}


def flat(electrons: float) -> np.ndarray:
    return np.full(SHAPE, electrons, np.float32)


def shot(expected: Any, detector: Detector, **options: Any) -> Frame:
    settings: dict[str, Any] = {"streams": Streams(42), "exposure_s": 1.0} | options
    return expose(expected, detector, **settings)


def stars(shape: tuple[int, int] = SHAPE) -> np.ndarray:
    rng = np.random.default_rng(3)
    image = rng.uniform(0, 40, shape).astype(np.float32)
    image[rng.integers(0, shape[0], 300), rng.integers(0, shape[1], 300)] += rng.uniform(100, 40000, 300).astype(
        np.float32
    )
    return image


# ---------------------------------------------------------------- closed forms


def test_mean_and_variance_of_the_linear_chain() -> None:
    """K (S + B t + D t) + offset and K^2 (S + B t + D t + r^2) + 1/12, D doubled by 6.5 K; N = 2^17, 4 sigma."""
    detector = ideal(gain_dn_per_e=2.0, read_noise_e=7.0, dark_current_e_per_s=30.0, dark_doubling_c=6.5)
    dn = shot(flat(500.0), detector, exposure_s=2.0, background_e_per_s=10.0, temperature_c=31.5).dn.astype(float)
    electrons = 500 + 2 * 10 + 2 * 60
    variance = 4 * (electrons + 49) + 1 / 12
    assert abs(dn.mean() - (2 * electrons + 100)) < 4 * np.sqrt(variance / N)
    assert abs(dn.var() / variance - 1) < 4 * np.sqrt(2 / N)


def test_twice_the_exposure_twice_the_electrons() -> None:
    image = ExpectedImage(
        electrons=np.repeat(flat(300.0)[:, :, None], 2, axis=2), band=("a", "b"), exposure_s=0.5, diffused=True
    )
    detector = ideal(dark_current_e_per_s=50.0)
    once, twice = (
        expose(image, detector, streams=Streams(1), band="b", exposure_s=t, background_e_per_s=20.0).dn.mean() - 100.0
        for t in (0.5, 1.0)
    )
    assert abs(twice - 2 * once) < 4 * np.sqrt((670 + 4 * 335) / N)
    assert abs(once - 335) < 4 * np.sqrt(335 / N)


def test_nonlinearity_as_defined() -> None:
    """Mean of K x (1 + c1 x/F + c2 (x/F)^2) over a Poisson variate x, from its moments."""
    detector = ideal(nonlinearity=(-0.05, 0.02))
    mean, well = 30000.0, 60000.0
    second, third = mean**2 + mean, mean**3 + 3 * mean**2 + mean
    wanted = mean - 0.05 * second / well + 0.02 * third / well**2 + 100
    assert abs(shot(flat(mean), detector).dn.mean() - wanted) < 4 * np.sqrt(mean / N)


def test_prnu_acts_on_all_light_and_not_on_dark_current() -> None:
    """Variance over many frames' mean image = (prnu * light)^2 + shot / frames."""
    frames = 16
    detector = ideal(prnu=0.05, dark_current_e_per_s=400.0)
    stack = [shot(flat(600.0), detector, frame=i, background_e_per_s=200.0).dn.astype(float) for i in range(frames)]
    variance = np.mean(stack, axis=0).var()
    wanted = (0.05 * 800) ** 2 + 1200 / frames
    assert abs(variance / wanted - 1) < 4 * np.sqrt(2 / N)


# ---------------------------------------------------------------- photon transfer (EMVA 1288)


def photon_transfer(detector: Detector, means: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mean and temporal variance per level, from the difference of two frames, quantisation removed."""
    level, variance = [], []
    for i, mean in enumerate(means):
        first, second = (shot(flat(mean), detector, frame=2 * i + j, exposure_s=0.01).dn.astype(float) for j in (0, 1))
        level.append((first + second).mean() / 2)
        variance.append((first - second).var() / 2 - 1 / 12)
    return np.array(level), np.array(variance)


def test_photon_transfer_gives_back_gain_read_noise_and_full_well() -> None:
    """Linear photon-transfer method: sigma^2 - sigma_dark^2 = K (mu - mu_dark).

    The slope over 20 levels up to 70 % of full well is K; sigma_dark / K is the read noise (EMVA: temporal dark noise);
    the plateau far above saturation, (mu - mu_dark) / K, is the full well. All patterns on, within 1 %.
    """
    detector = dataclasses.replace(
        SHIPPED, gain_dn_per_e=3.0, adc_bits=16, offset_dn=500.0, nonlinearity=(), read_noise_spread=0.05
    )
    means = np.concatenate([[0.0], np.linspace(0.03, 0.7, 20) * detector.full_well_e, [2 * detector.full_well_e]])
    level, variance = photon_transfer(detector, means)
    x, y = level[1:-1] - level[0], variance[1:-1] - variance[0]
    weight = 1 / (y + variance[0]) ** 2
    gain = (weight * x * y).sum() / (weight * x * x).sum()
    assert gain == pytest.approx(detector.gain_dn_per_e, rel=0.01)
    # root mean square over the pixels of a log-normal with median 13 e-, plus dark shot noise
    dark_noise = np.sqrt(13.0**2 * np.exp(2 * 0.05**2) + 125 * 0.01 + detector.hot_fraction * 50)
    assert np.sqrt(variance[0]) / gain == pytest.approx(dark_noise, rel=0.01)
    assert (level[-1] - level[0]) / gain == pytest.approx(detector.full_well_e, rel=0.01)


# ---------------------------------------------------------------- crosstalk


def test_crosstalk_is_the_convolution_and_conserves_charge() -> None:
    """Against scipy on the same charges (gain 1, no read noise: the numbers are the charges, rounded)."""
    image = stars()
    without = shot(image, ideal()).dn.astype(float) - 100
    mixed = shot(image, ideal(**CROSSTALK)).dn.astype(float) - 100
    h, v, d = CROSSTALK.values()
    kernel = np.array([[d, v, d], [h, 1 - 2 * h - 2 * v - 4 * d, h], [d, v, d]])
    wanted = convolve(without, kernel)
    assert np.abs(mixed - wanted)[1:-1, 1:-1].max() <= 0.5 + 0.01  # rounding, and float32 charges up to 4e4
    assert abs(mixed.sum() - without.sum()) < 4 * np.sqrt(N / 12)  # N rounding errors
    assert np.abs(mixed - without).max() > 1000


# ---------------------------------------------------------------- windows


DAMAGE = {"damage_centres_per_px": 3.0, "damage_dark_e_per_s": 500.0}


@pytest.mark.parametrize("changes", [{}, CROSSTALK, DAMAGE])
def test_windows_are_the_crop_of_the_frame_bit_for_bit(changes: dict[str, float]) -> None:
    detector = dataclasses.replace(SHIPPED, chips=2, gap_px=5, **changes)
    image = stars(detector.shape)
    image[22, 37] = 5e4
    height, width = detector.shape
    corners = np.array([[-1, -1], [30, 17], [505, 100], [width - 19, height - 14], [31, 16]])
    padded = np.pad(image, 1)
    stamps = np.stack([padded[y + 1 : y + 16, x + 1 : x + 21] for x, y in corners])
    settings: dict[str, Any] = {
        "streams": Streams(9),
        "exposure_s": 0.2,
        "temperature_c": 31.0,
        "background_e_per_s": 15.0,
        "band": "600 nm",
    }
    windows = expose_windows(stamps, corners, detector, frames=4, first_frame=3, margin_px=1, **settings)
    assert windows.dn.shape == (4, 5, 13, 18)
    for m in range(4):
        frame = expose(image, detector, frame=3 + m, **settings)
        for i, (x, y) in enumerate(windows.corner_px):
            crop = np.s_[y : y + 13, x : x + 18]
            assert np.array_equal(windows.dn[m, i], frame.dn[crop])
            assert np.array_equal(windows.saturated[m, i], frame.saturated[crop])
            assert np.array_equal(windows.defect[i], frame.defect[crop])
    assert windows.saturated.any()
    assert windows.defect.any()


def test_no_windows_is_an_empty_result() -> None:
    empty = expose_windows(
        np.zeros((0, 9, 9)), np.zeros((0, 2), int), SHIPPED, streams=Streams(1), frames=3, exposure_s=1.0
    )
    assert empty.dn.shape == (3, 0, 9, 9)
    assert empty.defect.shape == (0, 9, 9)


# ---------------------------------------------------------------- randomness


def test_threads_do_not_matter() -> None:
    import drjit as dr

    image = stars()
    detector = dataclasses.replace(SHIPPED, **CROSSTALK)
    first = shot(image, detector)
    before = dr.thread_count()
    try:
        dr.set_thread_count(1)
        assert np.array_equal(first.dn, shot(image, detector).dn)
    finally:
        dr.set_thread_count(before)


def test_one_source_of_noise_more_leaves_the_others() -> None:
    """The read noise added to a pixel is the same whatever the light and the patterns are."""
    fine = ideal(gain_dn_per_e=20.0, offset_dn=1000.0)
    noise = []
    for mean, prnu in ((0.0, 0.0), (1000.0, 0.0), (1000.0, 0.02)):
        quiet = shot(flat(mean), dataclasses.replace(fine, prnu=prnu)).dn.astype(float)
        noisy = shot(flat(mean), dataclasses.replace(fine, prnu=prnu, read_noise_e=5.0)).dn.astype(float)
        noise.append(noisy - quiet)
    assert noise[0].std() == pytest.approx(100, rel=4 / np.sqrt(2 * N))
    assert np.abs(noise[1] - noise[0]).max() <= 1  # two roundings
    assert np.abs(noise[2] - noise[0]).max() <= 1


def test_frames_bands_and_seeds_are_uncorrelated() -> None:
    detector = ideal(read_noise_e=10.0)
    first = shot(flat(100.0), detector, frame=0, band="a").dn.astype(float)
    for options in ({"frame": 1}, {"band": "b"}, {"streams": Streams(43)}):
        other = shot(flat(100.0), detector, **{"frame": 0, "band": "a"} | options).dn.astype(float)
        assert abs(np.corrcoef(first.ravel(), other.ravel())[0, 1]) < 4 / np.sqrt(N)


# ---------------------------------------------------------------- saturation and defects


def test_full_well_clips_and_flags() -> None:
    image = flat(100.0)
    image[10, 20] = 1e6
    frame = shot(image, ideal(full_well_e=20000.0))
    assert frame.dn[10, 20] == 20100
    assert frame.saturated[10, 20]
    assert frame.saturated.sum() == 1
    frame = shot(image, ideal(full_well_e=20000.0, **CROSSTALK))  # which takes charge away, and not the flag
    assert frame.dn[10, 20] < 19000
    assert frame.saturated[10, 20]


def test_converter_clips_at_both_ends_and_flags_the_upper() -> None:
    detector = ideal(adc_bits=10, offset_dn=0.0, read_noise_e=20.0)
    dark, bright = shot(flat(0.0), detector), shot(flat(5000.0), detector)
    assert (dark.dn == 0).mean() > 0.4
    assert not dark.saturated.any()
    assert (bright.dn == 1023).all()
    assert bright.saturated.all()


# ---------------------------------------------------------------- records and input


def test_frame_says_what_a_user_knows() -> None:
    image = ExpectedImage(electrons=flat(10.0)[:, :, None], band=("500 nm",), exposure_s=0.25, diffused=True)
    frame = expose(image, SHIPPED, streams=Streams(1), frame=7)
    assert (frame.band, frame.index, frame.exposure_s) == ("500 nm", 7, 0.25)
    assert (frame.gain_dn_per_e, frame.offset_dn, frame.read_noise_e) == (0.30, 40.0, 13.0)
    assert frame.dn.dtype == np.uint16


def test_undiffused_image_is_diffused_here() -> None:
    electrons = np.zeros((*SHAPE, 1), np.float32)
    electrons[100, 100] = 50000
    sharp, soft = (
        expose(
            ExpectedImage(electrons=electrons, band=("v",), exposure_s=1.0, diffused=diffused),
            ideal(full_well_e=1e6),
            streams=Streams(1),
        ).dn.astype(float)
        - 100
        for diffused in (True, False)
    )
    assert sharp[100, 101] == 0
    variance = (1.0 / 5.5) ** 2  # one-dimensional, px^2: what leaves to each side carries half of it
    assert abs(soft[100, 101] / 50000 - variance / 2) < 0.1 * variance / 2
    assert abs(soft.sum() - 50000) < 5 * np.sqrt(50000)


def test_inputs_are_unchanged() -> None:
    image, stamps, corners = stars(), np.full((2, 9, 9), 5.0, np.float32), np.array([[1, 2], [30, 40]])
    kept = image.copy(), stamps.copy(), corners.copy()
    shot(image, dataclasses.replace(SHIPPED, **CROSSTALK))
    expose_windows(stamps, corners, SHIPPED, streams=Streams(1), frames=2, exposure_s=1.0, margin_px=2)
    for now, before in zip((image, stamps, corners), kept, strict=True):
        assert np.array_equal(now, before)


@pytest.mark.parametrize("changes", [{"transfer_line_us": 20.0}, {"blooming": 0.5}, {"lag": 0.1}])
def test_light_of_another_exposure_counts_in_proportion_where_columns_have_effects(changes: dict[str, float]) -> None:
    """Twice the time is twice the expectation: the same bytes. Without light of one column the others have the same."""
    detector, image = ideal(full_well_e=2000.0, **changes), stars()
    before = (
        None
        if "lag" not in changes
        else ExpectedImage(electrons=image[..., None], band=("band",), exposure_s=1.0, diffused=True)
    )
    expected = ExpectedImage(electrons=image[..., None], band=("band",), exposure_s=1.0, diffused=True)
    doubled = ExpectedImage(electrons=2.0 * image[..., None], band=("band",), exposure_s=2.0, diffused=True)
    one, two = (shot(light, detector, exposure_s=2.0, before=before) for light in (expected, doubled))
    assert np.array_equal(one.dn, two.dn)
    plain = shot(doubled, ideal(full_well_e=2000.0), exposure_s=2.0)
    assert not np.array_equal(one.dn, plain.dn)
