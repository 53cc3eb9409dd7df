"""PSFs on a lattice over the detector: their nodes, the nearest, those between the nodes, means of rays."""

from __future__ import annotations

import numpy as np
import pytest

from optics.light.band import TopHat
from render.psf_lattice import edge_axes, inset_axes, psf_tracer, ray_means_px, refined, render_psf_grid
from render.records import EffectivePsf, PsfGrid
from render.sensor_file.load import load_star_sensor
from render.sky.star_light import star_light
from render.tracing.tracer import Tracer


@pytest.fixture(scope="module")
def sensor():
    return load_star_sensor("star_tracker_26mm", "cmv4000", window_px=200, diffraction="rays")


@pytest.fixture(scope="module")
def light():
    return star_light([TopHat(centre_nm=600.0, width_nm=50.0)], nodes=2)


def test_psfs_of_a_detector(engine, sensor, light):
    """From edge to edge or inset about the axis; a trail widens a PSF by L^2 / 12 along it."""
    columns, rows = axes = edge_axes(sensor.camera, 90.0)
    assert columns.tolist() == rows.tolist() == [-0.5, 99.5, 199.5]
    inset = inset_axes(sensor.camera, 3)
    assert inset[0] == pytest.approx(sensor.camera.centre_px[0] + 0.97 * np.array([-100.0, 0.0, 100.0]))
    still, moved = (
        render_psf_grid(
            sensor, light, temperature_k=5000.0, window_px=9, axes=(columns[1:2], rows), trail_px=trail, margin_px=1,
            tracer=psf_tracer(sensor),
        )
        for trail in (None, np.array([0.0, 3.0]))
    )  # fmt: skip
    assert still.place_px.tolist() == [[99.5, -0.5], [99.5, 99.5], [99.5, 199.5]]
    assert len(axes) == 2
    for psf, trailed in zip(still.psfs, moved.psfs, strict=True):
        variances = []
        for values in (psf.values, trailed.values):
            row = (np.arange(len(values)) - len(values) // 2) / psf.oversampling
            variances.append(values.sum(1) @ row**2 / values.sum())
        assert psf.values.sum() / psf.oversampling**2 == pytest.approx(1.0, abs=1e-3)
        assert variances[1] - variances[0] == pytest.approx(3.0**2 / 12.0, abs=2e-3)


@pytest.mark.parametrize("name", ["star_tracker_26mm", "star_camera_206mm"])
def test_means_of_rays_are_the_truth_of_images(engine, sensor, light, name):
    used = (
        sensor if name == "star_tracker_26mm" else load_star_sensor(name, "cmv4000", window_px=200, diffraction="rays")
    )
    stars = light.stars(used.direction_at(np.array([20.0, 150.0]), np.array([30.0, 90.0])), 5.0, 5000.0)
    truth = Tracer(used.camera).render(stars, exposure_s=1.0).truth
    expected = np.column_stack([truth.bundle_x_px, truth.bundle_y_px])
    np.testing.assert_allclose(ray_means_px(used.camera, stars), expected, atol=1e-4)


def test_the_nearest_psf_of_a_grid():
    position = np.array([[10.0, 10.0], [50.0, 10.0], [10.0, 40.0]])
    psf = EffectivePsf(values=np.ones((9, 9)), oversampling=2)
    grid = PsfGrid(psfs=(psf,) * 3, place_px=position)
    assert grid.nearest(np.array([12.0, 31.0, 9.0, 60.0]), np.array([9.0, 10.0, 26.0, 0.0])).tolist() == [0, 1, 2, 1]


def test_a_refined_grid_of_psfs_is_linear_between_its_nodes():
    x, y = np.meshgrid([0.0, 10.0, 20.0], [0.0, 8.0])
    shape = np.arange(81.0).reshape(9, 9) + 1.0
    psfs = tuple(
        EffectivePsf(values=(1.0 + a + 3.0 * b) * shape, oversampling=4) for a, b in zip(x.flat, y.flat, strict=True)
    )
    fine = refined(PsfGrid(psfs=psfs, place_px=np.column_stack([x.ravel(), y.ravel()])), 4)
    assert len(fine.psfs) == 9 * 5
    for psf, (a, b) in zip(fine.psfs, fine.place_px, strict=True):
        np.testing.assert_allclose(psf.values, (1.0 + a + 3.0 * b) * shape)
    assert {tuple(position) for position in fine.place_px} >= {(2.5, 2.0), (20.0, 8.0), (17.5, 6.0)}
