"""Predicted images of target points: the closed form of a singlet, the cone of a defocused beam."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from experiments.laboratory.bench.ray_prediction import bundle_prediction, expected_spots
from optics.glass.catalogue import Glass
from optics.glass.dispersion import Dispersion
from optics.lens.shapes.plane import Plane
from optics.lens.shapes.sphere import Sphere
from optics.lens.system import LensSystem, Surface
from render.camera import Camera

N_LAMBDA = Glass(
    name="flint", source="made up", dispersion=Dispersion.sellmeier((1.25,), (0.02,)), range_nm=(300.0, 1100.0)
)
RADIUS_MM, GAP_MM, IMAGE_MM = 60.0, 20.0, 112.0


def dispersion(wavelength_nm):
    square = (np.asarray(wavelength_nm) * 1e-3) ** 2
    return np.sqrt(1 + 1.25 * square / (square - 0.02))


@pytest.fixture(scope="module")
def singlet():
    """A thin plano-convex lens behind a stop: an instrument whose lateral colour is a closed form."""

    def surface(z, medium, shape, **more):
        return Surface(shape=shape, position_mm=np.array([0.0, 0.0, z]), medium=medium, **more)

    thin = 1e-9
    lens = LensSystem(
        name="singlet",
        source="test",
        surfaces=(
            surface(0.0, "air", Plane(), semi_diameter_mm=0.01, is_stop=True),
            surface(GAP_MM, "flint", Sphere(radius_mm=RADIUS_MM), semi_diameter_mm=30.0),
            surface(GAP_MM + thin, "air", Plane(), semi_diameter_mm=30.0),
        ),
        glasses={"flint": N_LAMBDA},
        image_position_mm=np.array([0.0, 0.0, GAP_MM + thin + IMAGE_MM]),
        design_wavelength_nm=600.0,
        max_field_deg=8.0,
    )
    camera = Camera(lens=lens, width_px=4096, height_px=2048, pixel_pitch_mm=5.5e-3)
    return SimpleNamespace(camera=camera, focal_length_mm=112.0, config=SimpleNamespace(exposure_s=0.1, defocus_mm=0.0))


def chief_height_mm(tangent, wavelength_nm):
    """Stop, gap, thin lens of power (n - 1) / R, image plane; the glass's index counts relative to air."""
    height = GAP_MM * tangent
    return height + IMAGE_MM * (tangent - height * (dispersion(wavelength_nm) - 1) / RADIUS_MM)


def band_mean(bench, function):
    """Mean over the light of each filter: a dense trapezoid with the lamp's Planck spectrum in photons."""
    means = []
    for band in bench.filters:
        w = np.linspace(band.centre_nm - 60, band.centre_nm + 60, 24001)
        edge = np.clip((50 - np.abs(w - band.centre_nm)) / 10 + 0.5, 0, 1)  # 100 nm wide, 10 nm edges
        light = edge / w**4 / np.expm1(1.4387769e7 / (w * 3000.0))
        means.append((light * function(w)).sum() / light.sum())
    return np.array(means)


def test_lateral_colour_of_a_singlet_near_the_axis_is_the_closed_form(singlet, bench_of):
    bench = bench_of()
    angle = np.radians(0.01)
    direction = np.array([[[np.sin(angle), 0, np.cos(angle)], [0, -np.sin(angle), np.cos(angle)]]])
    real = bundle_prediction(bench, singlet, direction)
    per_tangent = band_mean(bench, lambda w: chief_height_mm(1.0, w)) / 5.5e-3
    tangent = direction[..., :2] / direction[..., 2:]
    expected = tangent[:, :, None, :] * (per_tangent - per_tangent[1])[:, None]
    # the filter's edges are linear here; the nodes of the prediction may round them by some 1e-5
    assert np.abs(real - real[:, :, 1:2] - expected).max() < 2e-4 * np.abs(expected).max()


def test_spot_radius_of_a_defocused_lens(star_camera, bench_of):
    """Far out of focus the spot is a cut through the cone of an F/2.95 beam, filled evenly in sin^2 of its angle."""
    bench = bench_of(rows=1, columns=1)
    axis = np.array([[[0.0, 0.0, 1.0]]])
    radius = [
        expected_spots(bench, replace(star_camera, camera=replace(star_camera.camera, defocus_mm=d)), axis)[1]
        for d in (-1.0, 1.0)
    ]
    steepest = (0.5 / 2.95) ** 2
    rms_tangent = np.sqrt(-np.log1p(-steepest) / steepest - 1)  # mean of s / (1 - s) over s = 0 ... steepest
    # the mean of both sides takes out where the focus of each filter is
    assert np.mean(radius, axis=0) == pytest.approx(rms_tangent / 5.5e-3, rel=3e-3)
