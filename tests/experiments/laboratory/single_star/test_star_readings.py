"""Windows around a star: centroids that scatter as predicted, and stars that cannot be measured."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calib.calibration.star_bench import StarBench
from calib.measure.epsf.bspline import smeared_epsfs
from experiments.laboratory.devices.turntable import build_turntable
from experiments.laboratory.single_star.acquisition import TableMotion, acquire, visit_once
from experiments.laboratory.single_star.measure import measure, traced_map
from experiments.laboratory.single_star.settings import SingleStarConfig, TurntableConfig
from experiments.laboratory.single_star.setup import camera_under_test
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
    field = star.field(direction, small_camera)
    expected = StarRenderer(camera, exposure_s=small_camera.config.exposure_s).render(field)
    psfs = [row[0] for row in render_epsf(epsf_tracer(camera), field, half_size_px=7)]
    return expected, psfs, star, direction


def _truth(expected: ExpectedImage) -> np.ndarray:
    return np.column_stack([expected.truth.bundle_x_px, expected.truth.bundle_y_px])


PLAN = WindowPlan(size_px=13, frames=10, dark_frames=20)


def test_the_star_collects_what_it_should(visited) -> None:
    expected = visited[0]
    np.testing.assert_allclose(expected.truth.electrons_in.max(), 12000.0, rtol=2e-3)


def test_centroids_scatter_as_predicted(visited, small_camera) -> None:
    """64 places, two axes: N = 128; a standard deviation is known to 6.3 %, three of those are allowed."""
    expected, psfs = visited[:2]
    found = read_windows(expected, _truth(expected), psfs, small_camera, PLAN, streams=Streams(8))
    error = found.position_px - _truth(expected)
    pulls = error / np.sqrt(np.einsum("nii->ni", found.covariance_px2))
    assert np.sqrt((pulls**2).mean()) == pytest.approx(1.0, abs=0.19)
    # temporal noise: 9 degrees of freedom at 64 places and two axes, N = 1152: 2.1 %
    ratio = np.sqrt((found.temporal_px**2).mean() / (found.predicted_temporal_px**2).mean())
    assert ratio == pytest.approx(1.0, abs=0.063)


def test_stars_that_are_not_there_or_too_bright(visited, small_camera) -> None:
    expected, psfs = visited[:2]
    with pytest.raises(DomainError, match="not detected"):
        read_windows(expected, np.add(_truth(expected), [150.0, 0.0]), psfs, small_camera, PLAN, streams=Streams(8))
    bright = replace(expected, electrons=expected.electrons * 20.0)
    with pytest.raises(DomainError, match="saturated"):
        read_windows(bright, _truth(expected), psfs, small_camera, PLAN, streams=Streams(8))


@pytest.mark.slow
@pytest.mark.parametrize("rate_rad_per_s", [0.0, 2e-3])
def test_single_frames_of_an_acquisition_scatter_as_predicted(rate_rad_per_s, visited, small_camera) -> None:
    """64 places, two axes, at rest and with a streak of some pixels: N = 128, RMS of a pull within 4 / sqrt(2 N)."""
    expected, psfs, star, direction = visited
    table = build_turntable("xy")
    bench = StarBench(table=table, star=np.array([0.0, 0.0, 1.0]), installation=Rotation.identity())
    motion = TableMotion(rate_rad_per_s=rate_rad_per_s, samples=6 if rate_rad_per_s else 1)
    places = visit_once(bench, direction, np.zeros(64), motion, 8, Streams(3))
    values = np.array([psf.values for psf in psfs])
    along = places.directions(bench, small_camera.config.exposure_s)
    rays = small_camera.focal_length_mm / small_camera.camera.pixel_pitch_mm * along[:, :, :2] / along[:, :, 2:]
    smeared = smeared_epsfs(values, rays - rays.mean(1, keepdims=True)) if rate_rad_per_s else list(psfs)
    where = {"window_px": 13, "dark_frames": 4, "streams": Streams(3)}
    taken = acquire("drawn", places, bench, star, smeared, _truth(expected), small_camera, **where)
    pulls = (taken.position_px - taken.bundle_px) / np.sqrt(np.diagonal(taken.covariance_px2, axis1=1, axis2=2))
    assert taken.lost == 0
    assert np.sqrt((pulls**2).mean()) == pytest.approx(1.0, abs=4.0 / np.sqrt(256))
    if not rate_rad_per_s:
        dim = replace(star, signal_e=10.0)
        with pytest.raises(DomainError, match="gives a position at"):
            acquire("dim", places, bench, dim, smeared, _truth(expected), small_camera, **where)
        with pytest.raises(DomainError, match="falls into the window"):
            acquire("off", places, bench, star, smeared, _truth(expected) + 40.0, small_camera, **where)


def test_a_rendered_table_and_the_traced_lens(small_detector) -> None:
    """Nine places: centroids within 5 sigma of the rays, and the traced map where the camera puts the axis."""
    settings = {"instrument": {"detector": str(small_detector), "diffraction": "rays"}, "frames": 2, "dark_frames": 2}
    config = SingleStarConfig.model_validate({**settings, "grid": {"columns": 4, "rows": 3}})
    instrument, calls = camera_under_test(config), []
    table = TurntableConfig(axes="xy", reading_noise_arcsec=(0.3,), non_orthogonality_arcsec=(5.0,))
    found = measure(config, instrument, table, Streams(2), advance=lambda: calls.append(1))
    assert len(calls) == 4
    pulls = (found.readings.position_px - found.bundle_px) / found.readings.sigma_px
    assert np.abs(pulls).max() < 5.0
    assert found.pose_data.reading_rad == pytest.approx(found.visits.true_rad, abs=1e-5)
    traced = traced_map(config, instrument)
    nearest = np.argmax(traced.direction[:, 2])
    axis_px = np.array([instrument.camera.width_px - 1, instrument.camera.height_px - 1]) / 2 + [12.0, -8.0]
    slope_px = instrument.focal_length_mm / instrument.camera.pixel_pitch_mm * traced.direction[nearest, :2]
    assert traced.pixel_px[nearest] == pytest.approx(axis_px + slope_px, abs=1.0)
