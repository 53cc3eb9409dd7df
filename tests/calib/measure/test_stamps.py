import numpy as np
import pytest
from star_images import gaussian_stars, image_of

from calib.flags import StarFlag
from calib.measure.stamps import coarse_position, extract_stamps, ring_background, stamps_from_windows
from calib.records import NoiseModel
from render.records import WindowStack


def ramp(height=40, width=60, **masks):
    """An image whose electrons are 100 row + column: every pixel says where it is."""
    y, x = np.mgrid[:height, :width]
    noise = NoiseModel(read_noise_e=1.0, gain_dn_per_e=2.0, offset_dn=50.0)
    return image_of(50.0 + 2.0 * (100.0 * y + x), noise, **masks)


def test_window_holds_the_pixels_it_says_and_no_position_gives_none():
    stamps = extract_stamps(ramp(), [30.4], [20.6], background=0.0, size_px=5)
    assert stamps.corner_px.tolist() == [[28, 19]]
    assert stamps.electrons[0, 0, 0] == 1928.0
    assert stamps.electrons[0, 2, 2] == 2130.0
    assert stamps.valid.all()
    assert stamps.flags.tolist() == [0]
    stamps = extract_stamps(ramp(), [], [], background=0.0)
    assert len(stamps) == 0
    assert stamps.electrons.shape == (0, 11, 11)


def test_flags_of_edges_blends_saturated_and_defective_pixels():
    stamps = extract_stamps(ramp(), [1.0, -40.0, 30.0, 33.0], [20.0, 20.0, 20.0, 20.0], background=0.0, size_px=7)
    assert StarFlag(int(stamps.flags[0])) == StarFlag.EDGE
    assert stamps.valid[0].sum() == 5 * 7
    assert stamps.electrons[0, 3, 2] == 2000.0
    assert StarFlag(int(stamps.flags[1])) == StarFlag.EDGE | StarFlag.NO_DATA
    assert not stamps.valid[1].any()
    assert StarFlag(int(stamps.flags[2])) == StarFlag.BLEND
    assert StarFlag(int(stamps.flags[3])) == StarFlag.BLEND
    saturated, valid = np.zeros((40, 60), bool), np.ones((40, 60), bool)
    saturated[20, 30], valid[21, 31] = True, False
    stamps = extract_stamps(ramp(saturated=saturated, valid=valid), [30.0], [20.0], background=0.0, size_px=5)
    assert StarFlag(int(stamps.flags[0])) == StarFlag.SATURATED | StarFlag.DEFECT
    assert (~stamps.valid[0]).sum() == 2
    assert stamps.electrons[0, 2, 2] == 0.0


def test_coarse_position_is_good_to_a_quarter_of_a_pixel():
    rng = np.random.default_rng(1)
    x, y = rng.uniform(4.5, 5.5, (2, 500))
    light = 1e4 * gaussian_stars(x, y, 0.7)
    found_x, found_y = coarse_position(light, np.ones(light.shape, bool))
    assert np.abs(found_x - x).max() < 0.25
    assert np.abs(found_y - y).max() < 0.25


def test_ring_background_ignores_neighbours():
    """40 ring pixels of noise 3: standard error 3/sqrt(40) = 0.47 each, 400 windows."""
    rng = np.random.default_rng(2)
    electrons = rng.normal(25.0, 3.0, (400, 11, 11))
    electrons[:, 0, 3] += 5000.0
    level = ring_background(electrons, np.ones(electrons.shape, bool))
    assert level.mean() == pytest.approx(25.0, abs=5 * 0.47 / 20)
    electrons = np.full((1, 11, 11), 25.0)
    electrons[0, 0, 3] += 0.5
    electrons[0, 1:-1, 1:-1] = 900.0  # the star is no background
    assert ring_background(electrons, np.ones(electrons.shape, bool)) == pytest.approx(25.0, abs=1e-12)


def test_windowed_readout():
    frames, windows = 3, 2
    corner = np.array([[100, 200], [300, 400]])
    expected = 1e4 * gaussian_stars([5.0, 5.3], [5.0, 4.8], 0.7) + 20.0
    dn = np.rint(100.0 + 0.5 * expected)
    defect = np.zeros((windows, 11, 11), bool)
    defect[1, 0, 0] = True
    saturated = np.zeros((frames, windows, 11, 11), bool)
    saturated[2, 0, 5, 5] = True
    pixels = {"dn": np.broadcast_to(dn, saturated.shape), "saturated": saturated, "defect": defect, "corner_px": corner}
    detector = {"gain_dn_per_e": 0.5, "offset_dn": 100.0, "read_noise_e": 4.0}
    stack = WindowStack(**pixels, **detector, exposure_s=0.1, band="V", first_index=0)
    start = corner + np.array([[5.0, 5.0], [5.3, 4.8]])
    stamps, noise = stamps_from_windows(stack, start)
    assert noise.read_noise_e == 4.0
    assert len(stamps) == frames * windows
    assert stamps.corner_px[3].tolist() == [300, 400]
    assert stamps.psf_index.tolist() == [0, 1, 0, 1, 0, 1]
    assert stamps.start_px == pytest.approx(np.tile(start, (3, 1)))
    assert ring_background(stamps.electrons, stamps.valid) == pytest.approx(np.full(6, 20.0), abs=2.0)
    assert StarFlag(int(stamps.flags[4])) == StarFlag.SATURATED
    assert StarFlag(int(stamps.flags[1])) == StarFlag.DEFECT
    assert stamps.flags[0] == 0
