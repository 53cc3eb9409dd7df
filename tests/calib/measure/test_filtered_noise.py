"""Noise of cameras that nobody designed for stars: as many false detections as are stated."""

import io

import numpy as np
import pytest
from PIL import Image
from scipy.ndimage import convolve

from calib.measure.detection import detect, detection_noise
from calib.measure.image import sensor_image
from optics.errors import DomainError

COLOUR = np.array([[1.0, 2.0, 1.0], [2.0, 4.0, 2.0], [1.0, 2.0, 1.0]]) / 4.0
GREEN = np.array([[0.0, 1.0, 0.0], [1.0, 4.0, 1.0], [0.0, 1.0, 0.0]]) / 4.0


def colour_camera(rng, light=0.0, *, shape=(700, 700), jpeg=None):
    """Mean of the colours of a camera at high gain: a sky of 2 DN, read noise 4 DN, a black level that cuts half of the
    pixels off, bilinear interpolation of the Bayer pattern, 8 bit, JPEG."""
    raw = rng.normal(2.0 - 4.0, 4.0, shape) + light
    row, column = np.indices(shape)
    masks = ((row % 2 == 0) & (column % 2 == 0), (row + column) % 2 == 1, (row % 2 == 1) & (column % 2 == 1))
    planes = [convolve(raw * mask, GREEN if k == 1 else COLOUR) for k, mask in enumerate(masks)]
    image = np.clip(np.rint(np.stack(planes, axis=-1)), 0, 255).astype(np.uint8)
    if jpeg:
        packed = io.BytesIO()
        Image.fromarray(image).save(packed, "JPEG", quality=jpeg)
        image = np.asarray(Image.open(packed))
    return image.mean(axis=2)


@pytest.mark.parametrize("jpeg", [pytest.param(None, marks=pytest.mark.slow), 90])
def test_false_detections_are_as_many_as_stated(jpeg):
    """At 4 sigma, where they can be counted: half of the number to 1.3 times; white noise would call these 7 sigma."""
    rng = np.random.default_rng(7)
    found, stated, white = 0, 0.0, 0
    for _ in range(3):
        image = sensor_image(colour_camera(rng, jpeg=jpeg))
        noise = detection_noise(image)
        assert min(noise.pixel_correlation) > 0.2
        found += len(detect(image, threshold_sigma=4.0, noise=noise))
        stated += float(noise.false_alarms(4.0))
        white += int(noise.limit(4.0) > 7.0)
    assert 0.45 * stated - 3.0 * np.sqrt(stated) < found < 1.3 * stated + 3.0 * np.sqrt(stated)
    assert white == 3


def test_stars_in_such_noise_are_found(sky):
    rng = np.random.default_rng(2)
    x, y = rng.uniform(20, 680, (2, 60))
    light = sum(500.0 * sky.gaussian([a], [b], 1.0, 700, 700)[0] for a, b in zip(x, y, strict=True))
    stars = detect(sensor_image(colour_camera(rng, light)), threshold_sigma=5.0)
    nearest = np.hypot(stars.x_px - x[:, None], stars.y_px - y[:, None]).min(axis=1)
    assert (nearest < 1.0).sum() >= 57
    assert len(stars) <= 62


def test_white_noise_stays_white(sky):
    """Nothing measured, nothing changed: the limit is the threshold, with stars in the frame too."""
    rng = np.random.default_rng(4)
    x, y = rng.uniform(10, 502, (2, 80))
    light = sum(2000.0 * sky.gaussian([a], [b], 0.8, 512, 512)[0] for a, b in zip(x, y, strict=True))
    noise = detection_noise(sensor_image(rng.normal(100.0, 5.0, (512, 512)) + light))
    assert noise.white
    assert float(noise.limit(5.0)) == 5.0
    assert "white" in str(noise)
    limit = noise.threshold(0.2)
    assert float(noise.false_alarms(limit)) == pytest.approx(0.2)
    with pytest.raises(DomainError, match="false detections"):
        noise.threshold(1e9)


def test_correlated_normal_noise_is_measured():
    """Neighbours averaged 3 x 3: the filter leaves more of it; the ratio is that of sums over both kernels."""
    rng = np.random.default_rng(5)
    box = np.ones((3, 3)) / 3.0
    smooth = convolve(rng.normal(0.0, 10.0, (700, 700)), box) + 500.0
    noise = detection_noise(sensor_image(smooth))
    kernel = np.exp(-0.5 * (np.arange(-6, 7) / (2.0 / 2.3548)) ** 2)
    kernel = np.outer(kernel, kernel)
    expected = np.sqrt((convolve(kernel, box, mode="constant") ** 2).sum() / (kernel**2).sum())
    assert noise.scale == pytest.approx(expected, rel=0.02)
    assert noise.pixel_correlation == pytest.approx((2 / 3, 2 / 3), abs=0.02)
