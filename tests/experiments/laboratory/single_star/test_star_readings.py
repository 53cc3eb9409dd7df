"""Windows around a star: centroids that scatter as predicted, and stars that cannot be measured."""

import numpy as np
import pytest

from experiments.laboratory.single_star.star_readings import WindowPlan, read_windows
from optics.errors import DomainError
from render.engine.random import Streams
from render.records import ExpectedImage


@pytest.fixture(scope="module")
def visited(engine, small_camera):
    """A star of 12000 e- at 8 x 8 places of the small camera, with its PSFs."""
    from experiments.laboratory.single_star.star import SingleStar
    from optics.light.band import TopHat
    from optics.light.spectrum import Blackbody
    from render.forward import StarRenderer
    from render.tracing.psf import epsf_tracer, render_epsf

    camera = small_camera.camera
    x, y = np.meshgrid(np.linspace(100, 2970.3, 8), np.linspace(100.4, 1430, 8))
    direction = camera.nominal_direction(x.ravel(), y.ravel(), small_camera.focal_length_mm)
    band = TopHat(centre_nm=600.0, width_nm=100.0, edge_nm=10.0)
    star = SingleStar(
        azimuth_deg=0, elevation_deg=0, spectrum=Blackbody(temperature_k=5800.0), band=band, signal_e=12000.0
    )
    field = star.seen(direction, small_camera)
    expected = StarRenderer(camera, exposure_s=small_camera.config.exposure_s).render(field)
    psfs = [row[0] for row in render_epsf(epsf_tracer(camera), field, half_size_px=7)]
    return expected, psfs


def _truth(expected: ExpectedImage) -> np.ndarray:
    return np.column_stack([expected.truth.bundle_x_px, expected.truth.bundle_y_px])


PLAN = WindowPlan(size_px=13, frames=10, dark_frames=20)


def test_the_star_collects_what_it_should(visited) -> None:
    expected, _ = visited
    np.testing.assert_allclose(expected.truth.electrons_in.max(), 12000.0, rtol=2e-3)


def test_centroids_scatter_as_predicted(visited, small_camera) -> None:
    """64 places, two axes: N = 128; a standard deviation is known to 6.3 %, three of those are allowed."""
    expected, psfs = visited
    found = read_windows(expected, _truth(expected), psfs, small_camera, PLAN, streams=Streams(8))
    error = found.position_px - _truth(expected)
    pulls = error / np.sqrt(np.einsum("nii->ni", found.covariance_px2))
    assert np.sqrt((pulls**2).mean()) == pytest.approx(1.0, abs=0.19)
    # temporal noise: 9 degrees of freedom at 64 places and two axes, N = 1152: 2.1 %
    ratio = np.sqrt((found.temporal_px**2).mean() / (found.predicted_temporal_px**2).mean())
    assert ratio == pytest.approx(1.0, abs=0.063)


def test_a_star_that_is_not_there(visited, small_camera) -> None:
    expected, psfs = visited
    beside = np.add(_truth(expected), [150.0, 0.0])
    with pytest.raises(DomainError, match="not detected"):
        read_windows(expected, beside, psfs, small_camera, PLAN, streams=Streams(8))


def test_a_star_that_is_too_bright(visited, small_camera) -> None:
    expected, psfs = visited
    bright = ExpectedImage(
        electrons=expected.electrons * 20.0, band=expected.band, exposure_s=expected.exposure_s, diffused=True
    )
    with pytest.raises(DomainError, match="saturated"):
        read_windows(bright, _truth(expected), psfs, small_camera, PLAN, streams=Streams(8))
