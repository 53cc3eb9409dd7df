"""Noise of cameras that nobody designed for stars: as many false detections as are stated."""

import io

import numpy as np
import pytest
from PIL import Image
from scipy.ndimage import convolve
from star_images import star_field

from calib import detect, detection_noise, find_hot_pixels, sensor_image, without_pixels
from calib.measure.detection.filtered_noise import measure_noise

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


def test_white_noise_stays_white():
    """Nothing measured, nothing changed: the limit is the threshold, with stars in the frame too."""
    rng = np.random.default_rng(4)
    x, y = rng.uniform(10, 502, (2, 80))
    light = star_field(x, y, 2000.0, 0.8, (512, 512))
    noise = detection_noise(sensor_image(rng.normal(100.0, 5.0, (512, 512)) + light))
    assert noise.white
    assert float(noise.limit(5.0)) == 5.0
    assert "white" in str(noise)
    limit = noise.threshold(0.2)
    assert float(noise.false_alarms(limit)) == pytest.approx(0.2)


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


def degraded(rng, kind, shape=(512, 512)):
    """A sky of 2000 DN without stars, as cameras and places spoil it."""
    row, column = np.indices(shape)
    level = np.full(shape, 2000.0)
    if kind == "twilight":  # 1 to 4 times the level: 8 times the noise within a cell of the background
        level = 2000.0 * (1.0 + 3.0 * column / shape[1]) * (1.0 + 0.5 * row / shape[0])
    if kind == "trees":  # a dark silhouette with a rough edge over a quarter of the frame
        level = np.where(row > 384 + 10.0 * np.sin(column / 9.0), 60.0, level)
    dn = rng.poisson(level).astype(float)
    if kind == "8 bit":
        dn = np.clip(np.rint((dn - 2000.0) / 30.0), 0, 255)
    return dn


@pytest.mark.parametrize("kind", ["twilight", "trees", "8 bit", "hot pixels"])
def test_spoilt_frames_have_as_many_false_detections_as_stated(kind):
    """Poisson errors of 4 frames, and a sixth for what quantiles tell; at 3.7 sigma, where there are enough of them.
    Along the edge of a silhouette there are as many again, which nothing states: trees count 50 px away from it."""
    rng = np.random.default_rng(11)
    hot = rng.integers(0, 512, (2, 60))
    images = []
    for _ in range(4):
        dn = degraded(rng, kind)
        if kind == "hot pixels":
            dn[hot[0], hot[1]] += 900.0
        images.append(sensor_image(dn, saturation_dn=65535.0))
    if kind == "hot pixels":
        mask = find_hot_pixels(images).mask
        assert mask[hot[0], hot[1]].mean() > 0.95
        images = [without_pixels(one, mask) for one in images]
    noises = [detection_noise(one) for one in images]
    tables = [detect(one, threshold_sigma=3.7, noise=noise) for one, noise in zip(images, noises, strict=True)]
    found = sum(int(((np.abs(one.y_px - 384) > 50.0) | (kind != "trees")).sum()) for one in tables)
    stated = sum(float(noise.false_alarms(3.7)) for noise in noises) * (1.0 if kind != "trees" else 1.0 - 100.0 / 512.0)
    assert abs(found - stated) < 4.0 * np.sqrt(stated) + stated / 6.0


def random_stars(count, sigma_px, seed, size=512):
    rng = np.random.default_rng(seed)
    x, y = rng.uniform(8, size - 9, (2, count))
    flux = np.exp(rng.uniform(np.log(3e3), np.log(1e5), count))
    return x, y, star_field(x, y, flux, sigma_px, (size, size))


def spots(sigma_px):
    x, y = (axis.ravel() for axis in np.meshgrid(np.arange(10) * 24 + 20.3, np.arange(10) * 24 + 19.8))
    return x, y, star_field(x, y, 3e4, sigma_px, (256, 256))


def beside(structure):
    """Fifteen stars of SNR 17 in the left half of a frame whose right half holds a structure."""
    x, y = np.random.default_rng(4).uniform([[10], [10]], [[210], [497]], (2, 15))
    return x, y, star_field(x, y, 1500.0, 0.9, (507, 507)) + structure


ROW, COLUMN = np.indices((507, 507))
SCENES = {
    "150 stars": random_stars(150, 1.1, 1),
    "600 stars": random_stars(600, 1.1, 600),
    "1000 stars": random_stars(1000, 1.1, 1000),
    "1000 broad stars": random_stars(1000, 2.0, 1000),
    "sharp spots": spots(1.1),
    "broad spots": spots(2.0),
    "bar": beside(320.0 * (np.abs(COLUMN - 260 - 0.1 * ROW) < 25)),
    "roof": beside(np.where(COLUMN > 250, 2000.0 * (1.0 + np.sin(ROW / 3.0) * np.sin(COLUMN / 5.0)), 0.0)),
    "limb": beside(3e4 * (np.hypot(ROW - 253, COLUMN - 620) < 300)),
    "soft limb": beside(1e4 / (1.0 + np.exp((330.0 - COLUMN) / 6.0))),
    "glow": beside(5e3 * np.exp(-np.hypot(ROW - 253, COLUMN - 500) / 60.0)),
}


@pytest.mark.reference
@pytest.mark.parametrize("scene", SCENES)
def test_stars_at_any_density_and_beside_structure_are_found_as_by_sep(scene):
    sep = pytest.importorskip("sep")
    x, y, light = SCENES[scene]
    rng = np.random.default_rng(2)
    dn = rng.poisson(light + 100.0) + rng.normal(0.0, 5.0, light.shape)
    stars = detect(sensor_image(dn, gain_dn_per_e=1.0, offset_dn=0.0, read_noise_e=5.0))
    sky = sep.Background(dn)
    extracted = sep.extract(dn - sky.back(), 5.0, err=sky.globalrms)

    def completeness(x_px, y_px):
        return np.mean(np.hypot(x_px - x[:, None], y_px - y[:, None]).min(axis=1, initial=99.0) < 1.5)

    assert completeness(stars.x_px, stars.y_px) >= completeness(extracted["x"], extracted["y"]) - 0.03


def test_a_frame_without_pixels_between_its_structure_counts_as_white():
    """Every 9 x 9 px hold a value beyond any limit that the search tries: no tile tells a noise."""
    ratio = np.zeros((300, 300))
    ratio[::4, ::4] = 1e6
    assert measure_noise(ratio, np.ones(ratio.shape, bool), fwhm_px=2.0).white


@pytest.mark.parametrize("scale", [1e-12, 1e-3, 1e6])
def test_the_scale_of_the_numbers_does_not_matter(scale):
    *_, light = random_stars(40, 1.1, 5, size=200)
    dn = np.random.default_rng(3).normal(100.0, 3.0, light.shape) + light
    stars, scaled = detect(sensor_image(dn)), detect(sensor_image(scale * dn))
    np.testing.assert_allclose(np.hypot(scaled.x_px - stars.x_px, scaled.y_px - stars.y_px), 0.0, atol=1e-9)
    assert len(stars) > 35
