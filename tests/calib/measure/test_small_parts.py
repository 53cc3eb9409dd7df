"""Parts of the measuring room that larger tests use without noticing their numbers."""

import numpy as np
import pytest
from star_images import image_of

from calib.flags import StarFlag
from calib.measure.background import _clipped_statistics
from calib.measure.centroid_error.prediction import CentroidErrors
from calib.measure.detection.matched_filter import _flag_maxima
from calib.measure.epsf.build import _Grid
from calib.measure.targets.circle_fit import _circles, _distances


def test_errors_of_a_centroider_add_in_quadrature():
    part = {name: np.array([[value, 0.0]]) for name, value in (("noise", 2.0), ("pattern", 3.0), ("phase", 6.0))}
    given = {f"{name}_px": value for name, value in part.items()}
    errors = CentroidErrors(electrons=np.array([1.0, 2.0]), bound_px=given["noise_px"], peak=np.ones(1), **given)
    np.testing.assert_allclose(errors.total_px, [[7.0, 0.0]])


def test_level_of_coarse_numbers_and_of_crowded_cells():
    """Noise of one step of the converter: 40 cells of 4096 normal numbers, five standard errors of their mean."""
    rng, quantum = np.random.default_rng(6), 10.0
    light = rng.normal(300.0, quantum, (40, 4096))
    error = quantum / np.sqrt(light.size)
    for cells, step, own in ((light, 0.0, 0.0), (quantum * np.rint(light / quantum), quantum, 1.0 / 12.0)):
        level, _ = _clipped_statistics(cells, 3.0, step)
        assert level.mean() == pytest.approx(300.0, abs=5 * error * np.sqrt(1.0 + own))
    # bertin and Arnouts 1996, sec. 7.1; a skewed cell of which nothing is clipped, and its mirror, which is none
    skewed = 300.0 + 10.0 * np.linspace(0.0, 1.0, 101) ** 2
    mean, median = skewed.mean(), np.median(skewed)
    level, _ = _clipped_statistics(np.stack([skewed, 600.0 - skewed]), 3.0, 0.0)
    np.testing.assert_allclose(level, [2.5 * median - 1.5 * mean, 600.0 - mean], rtol=1e-9)
    # of whole numbers the median lies within its group: 40 skewed cells, whose levels scatter by 0.4
    rng = np.random.default_rng(0)
    fine = 300.0 + 3.0 * rng.standard_normal((40, 4096)) + rng.exponential(5.0, (40, 4096))
    coarse, smooth = (_clipped_statistics(cells, 3.0, q)[0] for cells, q in ((np.rint(fine), 1.0), (fine, 0.0)))
    assert (coarse - smooth).mean() == pytest.approx(0.0, abs=0.2)


def test_distances_from_circles_through_three_points_each():
    rng = np.random.default_rng(1)
    centre, radius = rng.uniform(-50.0, 50.0, (5, 2)), rng.uniform(5.0, 20.0, 5)
    angle = rng.uniform(0.0, 2.0 * np.pi, (5, 3))
    sets = centre[:, None] + radius[:, None, None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    circles = _circles(np.concatenate([sets, [[[0.0, 0.0], [1.0, 2.0], [2.0, 4.0]]]]))
    np.testing.assert_allclose(circles[:5], np.column_stack([centre, radius]), rtol=1e-6)
    point = np.array([[3.0, 7.0], [-20.0, 11.0]])
    expected = np.abs(np.linalg.norm(point - centre[:, None], axis=2) - radius[:, None])
    np.testing.assert_allclose(_distances(circles, point)[:5], expected, rtol=1e-6)
    assert np.isinf(_distances(circles, point)[5]).all()  # on a line


def test_a_quadratic_psf_costs_nothing_and_a_cubic_its_third_differences():
    grid = _Grid(window=5, oversampling=2)
    y, x = np.mgrid[: grid.size, : grid.size].astype(float)
    smooth, cubic = 1.0 + x - 2.0 * y + x**2 + 3.0 * x * y - y**2, 2.0 * x**3
    assert abs(smooth.ravel() @ grid.penalty() @ smooth.ravel()) < 1e-6
    assert cubic.ravel() @ grid.penalty() @ cubic.ravel() == pytest.approx(12.0**2 * grid.size * (grid.size - 3))


@pytest.mark.parametrize("at", [(0, 4), (4, 0), (8, 4), (4, 8)])
def test_a_defect_beside_a_star_on_the_border_is_flagged(at):
    """Rationale: the 3 x 3 pixels around a maximum end at the border. Expected: the neighbour along it counts."""
    light, valid = np.ones((9, 9)), np.ones((9, 9), bool)
    along = (at[0], at[1] + 1) if at[0] in (0, 8) else (at[0] + 1, at[1])
    valid[along] = False
    given = {"light": light, "regions": np.ones((9, 9), np.int64), "filtered": light, "spike_fraction": 0.9}
    for usable, flagged in ((valid, True), (valid | True, False)):
        image = image_of(light, valid=usable)
        _, flags = _flag_maxima(image, **given, x=np.array([at[1]]), y=np.array([at[0]]))
        assert bool(flags[0] & int(StarFlag.DEFECT)) is flagged
        assert flags[0] & int(StarFlag.EDGE)
