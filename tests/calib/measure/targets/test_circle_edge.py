"""Edges of disks to a fraction of a pixel, sharp and soft, straight and at an angle."""

import numpy as np
import pytest
from scipy.special import erf

from calib.measure.targets.circle_edge import edge_crossings, sample_spokes
from calib.measure.targets.circle_fit import fit_circle


def disk(centre, radius, soft, size=120, fine=4, to_plane=None):
    """Disk with an edge like an error function, averaged over fine x fine points of each pixel."""
    offset = (np.arange(fine) + 0.5) / fine - 0.5
    row, column = np.meshgrid(*[(np.arange(size)[:, None] + offset).ravel()] * 2, indexing="ij")
    points = np.column_stack([column.ravel(), row.ravel()])
    plane = points if to_plane is None else to_plane(points)
    away = np.hypot(*(plane - centre).T).reshape(size * fine, size * fine)
    value = 0.5 * (1 - erf((away - radius) / (np.sqrt(2) * soft)))
    return value.reshape(size, fine, size, fine).mean((1, 3))


@pytest.mark.parametrize(("soft", "half_width", "level"), [(0.7, 1.5, 0.5), (6.0, 6.0, 0.5), (6.0, 6.0, 0.2)])
def test_centre_of_a_disk(soft, half_width, level):
    centre = np.array([58.37, 61.82])
    image, start = disk(centre, 30.0, soft), [58.0, 62.0]
    for _ in range(2):
        spokes = sample_spokes(image, start, np.arange(5.0, 52.0, 0.5))
        edge = edge_crossings(spokes, level, rising=False, half_width=half_width)
        fit = fit_circle(edge.point, sigma=edge.sigma)
        start = fit.centre
    assert fit.centre == pytest.approx(centre, abs=6e-3)


def test_seen_at_an_angle():
    """A circle on a plane in perspective: measured in the plane it keeps its centre."""
    homography = np.array([[20.0, 0.0, 60.0], [0.0, 21.0, 60.0], [0.12, 0.0, 1.0]])
    homography[0] += 60 * homography[2]
    homography[1] += 60 * homography[2]
    homography[:, 2] -= [60.0, 60.0, 0.0]

    def project(matrix, points):
        lifted = np.column_stack([points, np.ones(len(points))]) @ matrix.T
        return lifted[:, :2] / lifted[:, 2:]

    centre = np.array([0.13, -0.08])
    back = np.linalg.inv(homography)
    image = disk(centre, 1.9, 0.04, to_plane=lambda points: project(back, points))
    spokes = sample_spokes(image, [0.0, 0.0], np.arange(0.8, 2.4, 0.02), to_pixel=lambda p: project(homography, p))
    edge = edge_crossings(spokes, 0.5, rising=False, half_width=0.07)
    assert fit_circle(edge.point).centre == pytest.approx(centre, abs=4e-4)


def test_stated_errors_are_the_scatter():
    """60 noisy disks, white noise: the mean square pull of the centre is 1 to 3 sqrt(2 / 120) = 0.39."""
    rng = np.random.default_rng(9)
    clean, centre = disk(np.array([60.3, 59.8]), 30.0, 4.0), np.array([60.3, 59.8])
    pulls = []
    for _ in range(60):
        image = clean + 0.05 * rng.standard_normal(clean.shape)
        spokes = sample_spokes(image, [60.0, 60.0], np.arange(10.0, 50.0, 1.0), spokes=60, rays=2)
        edge = edge_crossings(spokes, 0.5, rising=False, half_width=4.0)
        fit = fit_circle(edge.point, sigma=edge.sigma)
        pulls.append((fit.centre - centre) / fit.sigma[:2])
    assert np.mean(np.square(pulls)) == pytest.approx(1.0, abs=0.39)


def test_spokes_without_an_edge_give_no_point():
    image = disk(np.array([60.0, 60.0]), 30.0, 1.0)
    image[:, :60] = 0.0
    spokes = sample_spokes(image, [60.0, 60.0], np.arange(5.0, 45.0, 0.5))
    edge = edge_crossings(spokes, 0.5, rising=False, half_width=2.0)
    assert 40 <= len(edge) <= 62
    assert edge.point[:, 0].min() > 59.0
    assert len(edge.outside([60.0, 60.0], 31.0)) == 0
