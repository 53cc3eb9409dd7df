"""ACC18's chromatic statistic and calibrations on hand-made fields; uncertainties on drawn centroids."""

from __future__ import annotations

import numpy as np
import pytest

from calib.accuracy import chromatic


@pytest.fixture
def field():
    """Places (4, 25, 2) of the target's points from the centre, and a generator."""
    grid = np.stack(np.meshgrid(np.arange(-2, 3) * 150.0, np.arange(-2, 3) * 150.0), axis=-1).reshape(25, 2)
    centres = np.array([[-1600, -570], [1600, -570], [-1600, 570], [1600, 570.0]])
    return centres[:, None] + grid


def test_pairs_and_shifts_put_the_longer_wavelength_first():
    assert chromatic.band_pairs((500.0, 600.0, 800.0), 1) == [("600-500", 1, 0), ("800-600", 2, 1)]
    assert chromatic.band_pairs((800.0, 600.0, 500.0), 1) == [("800-600", 0, 1), ("600-500", 1, 2)]
    assert chromatic.band_pairs((500.0, 600.0, 800.0), 0) == [("600-500", 1, 0), ("800-500", 2, 0)]
    assert chromatic.band_pairs((656.3, 486.1), 0) == [("656.3-486.1", 0, 1)]
    position = np.zeros((4, 25, 3, 2))
    position[..., 0, :], position[..., 2, :] = [1.0, 2.0], [10.0, 20.0]
    found = chromatic.shifts(position, chromatic.band_pairs((500.0, 600.0, 800.0), 1))
    assert np.all(found["600-500"] == [-1.0, -2.0])
    assert np.all(found["800-600"] == [10.0, 20.0])


def test_eq_16_of_an_odd_field_of_a_constant_and_of_a_point(field):
    odd = field * 1e-4 + field * (field**2).sum(-1, keepdims=True) * 1e-11
    assert np.abs(odd).max() > 0.2
    assert chromatic.table1(odd) == pytest.approx([0, 0], abs=1e-15)
    assert chromatic.table1(odd + np.array([0.24, -0.1])) == pytest.approx([0.12, -0.05], abs=1e-15)
    one = np.zeros((4, 25, 2))
    one[2, 7] = [200.0, -400.0]
    assert chromatic.table1(one) == pytest.approx([1.0, -2.0])  # 200 / (2 * 4 * 25)
    assert chromatic.table1(np.stack([one, 2 * one])) == pytest.approx(np.array([[1.0, -2.0], [2.0, -4.0]]))


def test_rms_is_per_axis():
    shift = np.zeros((4, 25, 2))
    shift[:, :, 0] = 0.3 * np.where(np.arange(25) % 2, 1, -1)
    shift[:2, :, 1] = 0.4
    assert chromatic.rms_shift_px(shift) == pytest.approx([0.3, 0.4 / np.sqrt(2)])


def test_calibration_of_a_pure_offset_and_of_a_pure_scale(field):
    left = chromatic.after_calibration(np.broadcast_to([0.2, -0.1], field.shape), field)
    assert np.abs(left["as found"] - [0.2, -0.1]).max() == 0
    assert np.abs(left["principal point"]).max() < 1e-14
    # the four positions lie symmetrically: no scale looks like an offset
    assert np.abs(left["focal length"] - [0.2, -0.1]).max() < 1e-14
    assert np.abs(left["both"]).max() < 1e-14
    left = chromatic.after_calibration(1e-4 * field, field)
    assert np.abs(left["principal point"] - 1e-4 * field).max() < 1e-14
    assert np.abs(left["focal length"]).max() < 1e-14
    assert np.abs(left["both"]).max() < 1e-14


def test_calibration_of_both_on_one_side_of_the_field(field):
    """Away from symmetry the two parameters mix; fitted together they still find each its own."""
    place = field[:1] + np.array([5000.0, 3000.0])
    left = chromatic.after_calibration(1e-4 * place + [0.2, -0.1], place)
    assert np.abs(left["both"]).max() < 1e-12
    assert np.abs(left["focal length"]).max() > 1e-3
    assert np.abs(left["principal point"]).max() > 1e-3


def test_calibration_leaves_the_cubic(field):
    """What is left is orthogonal to what was fitted, and is the cubic minus its own best scale."""
    squared = (field**2).sum(-1, keepdims=True)
    cubic = 1e-11 * squared * field
    left = chromatic.after_calibration(cubic + 3e-5 * field + [0.05, 0.02], field)["both"]
    scale = (squared**2).sum() / squared.sum()  # sum(r^3 r) / sum(r r)
    assert np.abs(left - 1e-11 * (squared - scale) * field).max() < 1e-13
    assert (left * field).sum() == pytest.approx(0, abs=1e-9)
    assert left.sum((0, 1)) == pytest.approx([0, 0], abs=1e-11)


def test_sigma_of_a_shift_is_that_of_its_point():
    """Noise of points differs by three, and patterns add: pulls of variance 1, whatever the scatter of the others."""
    rng = np.random.default_rng(5)
    noise = rng.uniform(0.5, 1.5, (4, 9, 3, 2))
    pattern = 1e-4 * rng.standard_normal((200, *noise.shape))  # the noise of a mean is twice as large
    count, pairs = np.full(noise.shape[:3], 30), [("800-600", 2, 1)]
    pulls = []
    for number in range(400):
        run = 1.1e-3 * noise * rng.standard_normal((30, *noise.shape))  # 10 % more than predicted
        sigma = chromatic.shift_sigma(run.std(0, ddof=1), count, pattern, pairs, variance_fraction=noise**2)["800-600"]
        pulls.append(chromatic.shifts(run.mean(0) + pattern[number % 200], pairs)["800-600"] / sigma)
    # 400 pulls of 72 points: the largest and least of their variances, and the mean
    square = np.square(pulls).mean(0)
    assert np.abs(square - 1.0).max() < 4.5 * np.sqrt(2.0 / 400)
    assert abs(square.mean() - 1.0) < 4.5 * np.sqrt(2.0 / (400 * 72))


def test_sigma_of_eq_16_is_the_scatter_of_its_mean():
    """Noise of points, motion that the points of a place share, patterns: 4000 drawn means of each."""
    rng, common = np.random.default_rng(6), 5e-4
    noise = 1e-3 * rng.uniform(0.5, 1.5, (4, 9, 3, 2))
    pattern = 1e-4 * rng.standard_normal((200, *noise.shape))
    pairs = [("800-600", 2, 1)]
    moved = noise * rng.standard_normal((4000, *noise.shape)) + common * rng.standard_normal((4000, 4, 1, 3, 2))
    drawn = chromatic.table1(
        chromatic.shifts(moved / np.sqrt(30) + np.tile(pattern, (20, 1, 1, 1, 1)), pairs)["800-600"]
    )
    stated = chromatic.table1_sigma(
        np.hypot(noise, common), np.full(noise.shape[:3], 30), pattern, pairs, common_px=common / np.sqrt(30)
    )
    assert stated["800-600"] == pytest.approx(drawn.std(0), rel=4.5 / np.sqrt(2 * 4000))


def test_a_line_of_sight_that_moves_all_points_leaves_fewer_independent_pulls():
    """Pulls of two bands with a common part: the scatter of their mean square over runs is sqrt(2 / independent)."""
    rng, points, own, common = np.random.default_rng(2), 4, 0.03, 0.03
    shape = (1, 4, points, 2)
    sigma = np.full(shape, np.sqrt(2.0 * (own**2 + common**2)))
    runs = []
    for _ in range(10_000):
        noise = [own * rng.standard_normal(shape) + common * rng.standard_normal((1, 4, 1, 2)) for _ in range(2)]
        runs.append((((noise[0] - noise[1]) / sigma) ** 2).mean())
    count = chromatic.independent_shifts(sigma.size, points, common, sigma)
    assert np.std(runs) == pytest.approx(np.sqrt(2.0 / count), rel=4.0 / np.sqrt(20_000))
    assert chromatic.independent_shifts(sigma.size, points, 0.0, sigma) == 4 * points * 2


def test_the_term_is_the_largest_entry_of_each_axis():
    """ACC18: 0.12 px of 5.5 arcsec in one axis, 7e-3 px in the other."""
    term = chromatic.chromatic_error(
        np.array([[-1e-4, 7e-3], [-0.12, 5e-3]]), np.array([[1.0, 2.0], [3.0, 4.0]]) * 1e-3, 5.5, 30
    )
    np.testing.assert_allclose(term.arcsec, [0.66, 0.0385])
    np.testing.assert_allclose(term.uncertainty_arcsec, [5.5 * 3e-3, 5.5 * 2e-3])
    assert term.n == 30
