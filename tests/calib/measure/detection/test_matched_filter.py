import numpy as np
import pytest
from star_images import image_of, noisy, star_field

from calib import StarTable, detect
from calib.flags import StarFlag, has_flag


def field(x, y, flux, sigma=0.7):
    """A noisy image of stars at (x, y) on a background of 10 e-."""
    return noisy(star_field(x, y, flux, sigma, (200, 300)) + 10.0, 5.0, np.random.default_rng(1))


def grid(seed=3):
    rng = np.random.default_rng(seed)
    x, y = np.meshgrid(np.arange(20, 290, 30.0), np.arange(20, 190, 30.0))
    return (x + rng.uniform(-0.5, 0.5, x.shape)).ravel(), (y + rng.uniform(-0.5, 0.5, y.shape)).ravel()


def test_every_star_and_nothing_else_and_of_none_an_empty_table():
    x, y = grid()
    flux = np.geomspace(1000.0, 50000.0, len(x))
    stars = detect(image_of(field(x, y, flux)))
    assert len(stars) == len(x)
    distance = np.hypot(stars.x_px[:, None] - x, stars.y_px[:, None] - y)
    nearest = distance.argmin(axis=1)
    assert sorted(nearest) == list(range(len(x)))
    assert distance.min(axis=1).max() < 0.3
    assert np.all(stars.flags == 0)
    assert np.all(np.diff(stars.flux_e) <= 0), "brightest first"
    assert np.allclose(stars.flux_e / flux[nearest], 1.0, atol=0.35)
    stars = detect(image_of(np.random.default_rng(1).normal(10.0, 5.0, (256, 256))), threshold_sigma=7.0)
    assert isinstance(stars, StarTable)
    assert len(stars) == 0
    assert stars.covariance.shape == (0, 3, 3)
    assert "x_px" in stars.to_table().colnames


def test_saturated_star_is_one_flagged_star():
    electrons = field([100.2], [100.4], 3e6, sigma=1.5)
    saturated = electrons > 20000.0
    electrons[saturated] = 20000.0
    stars = detect(image_of(electrons, saturated=saturated))
    burnt = stars.select(has_flag(stars.flags, StarFlag.SATURATED))
    assert len(burnt) == 1
    assert burnt.x_px[0] == pytest.approx(100.2, abs=1.5)
    assert burnt.y_px[0] == pytest.approx(100.4, abs=1.5)


@pytest.mark.parametrize(("x", "y"), [(0.0, 100.0), (299.0, 100.0), (150.0, 0.0), (150.0, 199.0)])
def test_stars_on_each_border_are_flagged(x, y):
    assert has_flag(detect(image_of(field([x], [y], 8000.0))).flags, StarFlag.EDGE).tolist() == [True]


def test_blend_spike_edge_and_defect_are_flagged():
    electrons = field([50.0, 53.5, 150.0, 0.0, 250.0], [50.0, 50.0, 150.0, 100.0, 50.0], 8000.0)
    electrons[20, 200] += 5000.0
    valid = np.ones(electrons.shape, bool)
    valid[50, 251] = False
    stars = detect(image_of(electrons, valid=valid))

    def flags_at(x, y):
        distance = np.hypot(stars.x_px - x, stars.y_px - y)
        assert distance.min() < 0.8
        return StarFlag(int(stars.flags[distance.argmin()]))

    assert flags_at(50.0, 50.0) == StarFlag.BLEND
    assert flags_at(53.5, 50.0) == StarFlag.BLEND
    assert flags_at(150.0, 150.0) == StarFlag(0)
    assert flags_at(0.0, 100.0) & StarFlag.EDGE
    assert flags_at(200.0, 20.0) & StarFlag.SPIKE
    assert flags_at(250.0, 50.0) & StarFlag.DEFECT
    assert len(stars) == 6


def test_maxima_are_those_of_a_search_of_every_pixel():
    """Against a plain loop over all pixels; a plateau counts once."""
    from calib.measure.detection.matched_filter import _local_maxima

    rng = np.random.default_rng(8)
    values = rng.integers(0, 30, (40, 60)).astype(float)  # many equal neighbours
    values[10, 20:23] = 99.0
    y, x = _local_maxima(values, values > 20)
    found = set(zip(y.tolist(), x.tolist(), strict=True))
    padded = np.pad(values, 1, constant_values=-np.inf)
    for row in range(40):
        for column in range(60):
            around = padded[row : row + 3, column : column + 3].ravel()
            here = values[row, column]
            highest = here > 20 and here > around[:4].max() and here >= around[5:].max()
            assert ((row, column) in found) == highest
    assert {(10, 20)} == {place for place in found if values[place] == 99.0}
