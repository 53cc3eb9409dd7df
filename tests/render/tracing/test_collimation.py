"""Light of a collimator that is not quite parallel: against turned stars, and rays from a point at a distance."""

from dataclasses import replace

import numpy as np
import pytest

from optics.light.collimation import Collimation
from optics.rays.pupil_sampling import gauss_disk
from optics.rays.trace import Rays, trace
from render.camera import launch_disk
from render.forward import StarRenderer
from render.tracing.tracer import Tracer

LINES = ((500.0, 0.0), (700.0, 0.0))
SLOPES = np.array([[1e-4, -2e-5], [-3e-5, 5e-5]])
VERGENCE = np.array([2e-6, -1e-6])


def behind(stars, slope=(0.0, 0.0), vergence=0.0):
    shape = stars.wavelength_nm.shape
    error = Collimation(
        wavelength_nm=stars.wavelength_nm,
        slope_rad=np.broadcast_to(np.reshape(slope, (-1, 1, 2)), (*shape, 2)),
        vergence_per_mm=np.broadcast_to(np.reshape(vergence, (-1, 1)), shape),
    )
    return replace(stars, collimation=error)


@pytest.mark.parametrize("name", ["star_camera_206mm", "star_tracker_26mm"])
def test_slopes_of_a_band_are_turned_stars(engine, bench, name):
    camera = bench.camera_of(name, film=False)
    width, height, _, reach = bench.geometry[name]
    x, y = (width - 1) / 2 * (1 + reach * np.array([-0.5, 0.1])), (height - 1) / 2 * (1 + reach * np.array([0.3, 0.6]))
    stars = bench.stars_at(camera, x, y, bands=LINES)
    seen = Tracer(camera).bundle_means(behind(stars, SLOPES))
    for band, slope in enumerate(SLOPES):
        turned = stars.direction + np.append(slope, 0.0)
        turned = turned / np.linalg.norm(turned, axis=1, keepdims=True)
        means = Tracer(camera).bundle_means(replace(stars, direction=turned))[:, band]
        # apertures are looked for along the undisturbed beam
        np.testing.assert_allclose(seen[:, band], means, atol=1e-9 if name == "star_camera_206mm" else 1e-4)


@pytest.mark.slow
def test_vergence_is_a_source_at_a_distance(engine, bench):
    """Through Mitsuba's plugins; the oracle traces straight lines from the point itself."""
    camera = bench.camera_of("star_camera_206mm", film=False)
    stars = bench.stars_at(camera, 3000.0, 600.0, bands=LINES)
    renderer = StarRenderer(camera)
    still = renderer.render(stars).truth.variance_x_px2[0]
    truth = renderer.render(behind(stars, vergence=VERGENCE)).truth
    pupil, disk = launch_disk(camera), gauss_disk(8, 24)
    x, y = pupil.x_mm + pupil.radius_mm * disk.x, pupil.y_mm + pupil.radius_mm * disk.y
    plane = np.stack([x, y, np.full_like(x, pupil.z_mm)], axis=-1)
    travel = stars.direction[0] * [1.0, -1.0, 1.0]
    for band, vergence in enumerate(VERGENCE):
        point = [pupil.x_mm, pupil.y_mm, pupil.z_mm] - travel / vergence
        way = (plane - point) * np.sign(vergence)
        way = way / np.linalg.norm(way, axis=-1, keepdims=True)
        wave = stars.wavelength_nm[band, 0]
        rays = trace(camera.lens, Rays.create(x_mm=x, y_mm=y, z_mm=pupil.z_mm, direction=way, wavelength_nm=wave))
        mean, power = (disk.weight * rays.x).sum(), (disk.weight * rays.x**2).sum()
        column = camera.centre_px[0] + mean / camera.pixel_pitch_mm
        assert truth.bundle_x_px[0, band] == pytest.approx(column, abs=1e-7)
        spread = (power - mean**2) / camera.pixel_pitch_mm**2
        assert truth.variance_x_px2[0, band] == pytest.approx(spread, rel=1e-3)
        assert abs(spread / still[band] - 1.0) > 0.1  # otherwise nothing would be seen
