"""Hot pixels against stars that stand still and stars that move; trails against rows of stars."""

from pathlib import Path

import numpy as np
import pytest
from star_images import gaussian_stars

from calib import detect, detection_noise, find_hot_pixels, read_images, sensor_image, without_pixels
from calib.flags import StarFlag, has_flag

SIDE = 256
REAL = Path(__file__).parents[4] / "shared" / "real"


def frames(count, *, moving, rng):
    """Stars of sigma 0.5 px to 80 sigma, 30 hot pixels of 5 to 40 sigma, five of which blink, four dead ones."""
    place = rng.permutation(SIDE * SIDE)[:34]
    row, column = np.divmod(place, SIDE)
    level = np.concatenate([rng.uniform(50.0, 400.0, 25), np.full(5, 200.0), np.full(4, -120.0)])
    on = np.ones((count, 34))
    on[:, 25:30] = (np.arange(count)[:, None] + np.arange(5)) % 2
    x, y = rng.uniform(8, SIDE - 8, (2, 40))
    flux = rng.uniform(100.0, 2000.0, 40)
    out = []
    for k in range(count):
        drift = 7.3 * k if moving else 0.0
        stars = gaussian_stars((x + drift) % SIDE, (y + 0.6 * drift) % SIDE, 0.5, SIDE, SIDE)
        light = np.tensordot(flux, stars, axes=1)
        light[row, column] += level * on[k]
        out.append(sensor_image(rng.normal(500.0, 10.0, (SIDE, SIDE)) + light))
    truth = np.zeros((SIDE, SIDE), bool)
    truth[row, column] = True
    return out, truth, (row[25:30], column[25:30])


@pytest.mark.parametrize("moving", [True, False])
def test_hot_pixels_are_told_from_stars(moving):
    images, truth, blink = frames(8, moving=moving, rng=np.random.default_rng(3))
    found = find_hot_pixels(images)
    assert (found.mask & ~truth).sum() <= 1
    assert (found.mask & truth).sum() >= 32
    assert found.blinking[blink].sum() == 5
    assert found.dead.sum() == 4
    assert "blink" in str(found)
    for image in images:
        table = detect(without_pixels(image, found.mask), threshold_sigma=6.0)
        at = np.clip(np.rint(table.pixel_px).astype(int), 0, SIDE - 1)
        assert truth[at[:, 1], at[:, 0]].sum() <= 2  # next to a star


def test_a_satellite_is_no_row_of_stars():
    """A trail of 4.5 sigma, broken by noise; five stars in a row stay stars, and so do stars next to the trail."""
    rng = np.random.default_rng(8)
    row, column = np.indices((300, 300))
    across = (row - 40.0) * np.cos(0.4) - (column - 20.0) * np.sin(0.4)
    trail = 9.0 * np.exp(-0.5 * (across / 0.9) ** 2) * ((column > 40) & (column < 200))
    x, y = np.array([60.0, 90, 120, 150, 180, 250, 20]), np.array([220.0, 232, 244, 256, 268, 30, 150])
    stars = 800.0 * gaussian_stars(x, y, 0.8, 300, 300).sum(axis=0)
    table = detect(sensor_image(rng.normal(500.0, 5.0, (300, 300)) + trail + stars), threshold_sigma=4.5)
    member = has_flag(table.flags, StarFlag.TRAIL)
    on_line = np.abs((table.y_px - 40) * np.cos(0.4) - (table.x_px - 20) * np.sin(0.4)) < 3.0
    assert member.sum() > 10
    assert on_line[member].all()
    assert (~member & ~on_line).sum() >= 7
    assert not table.fit[member].any()


@pytest.mark.slow
@pytest.mark.skipif(not REAL.is_dir(), reason="eight frames of a real camera, github.com/esa/tetra3, test_data")
def test_eight_real_frames():
    """12 bit in the upper ones of 16; by another code 87 hot pixels, a satellite of 26 pieces, 1584 and 2041 stars."""
    images = list(read_images(sorted(REAL.glob("*.tiff"))))
    assert "12 bit in steps of 16" in str(images[0].conversion)
    hot = find_hot_pixels(images)
    assert 75 < hot.mask.sum() < 100
    trails, count = [], {5.0: 0, 6.0: 0}
    for image in (without_pixels(image, hot.mask) for image in images):
        noise = detection_noise(image)
        assert 1.0 <= noise.scale < 1.15  # stars too faint to be found, structure of 8 px
        for sigma in count:
            stars = detect(image, threshold_sigma=sigma, noise=noise)
            member = has_flag(stars.flags, StarFlag.TRAIL)
            count[sigma] += int((~member).sum())
        trails.append(int(member.sum()))
    assert sorted(trails)[:-1] == [0] * 7
    assert max(trails) > 15
    assert count[6.0] == pytest.approx(1584, rel=0.07)
    assert count[5.0] == pytest.approx(2041, rel=0.07)
