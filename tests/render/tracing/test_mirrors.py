"""Telescopes in the renderer: light that passes vanes and a secondary, the same picture forwards and backwards."""

import re
import tomllib
from pathlib import Path

import numpy as np
import pytest

from optics.lens.prescription import lens_from_table
from optics.rays.chief_ray import chief_ray_points
from render.camera import Camera
from render.tracing.tracer import Tracer

PAGE = Path(__file__).resolve().parents[3] / "docs" / "lens_file.md"
RITCHEY_CHRETIEN = tomllib.loads(re.search(r"```toml\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.S)[1])
PITCH_MM = 5e-3


def telescope(which):
    shadow, m1, m2 = RITCHEY_CHRETIEN["surface"]
    if which == "cassegrain":
        return lens_from_table(RITCHEY_CHRETIEN, where="page")
    if which == "prime focus":  # one mirror
        alone = {**m1, "conic": -1.0, "radius_mm": -800.0, "thickness_mm": -400.0}
        return lens_from_table({**RITCHEY_CHRETIEN, "surface": [shadow, alone]}, where="prime")
    flat = {"kind": "plane", "medium": "mirror", "tilt_deg": [40.0, 15.0], "carry": "bend", "thickness_mm": -50.0}
    m2 = {**m2, "thickness_mm": m2["thickness_mm"] - 50.0}
    return lens_from_table({**RITCHEY_CHRETIEN, "surface": [shadow, m1, m2, flat]}, where="folded")


def camera_of(which, size=600):
    return Camera(
        lens=telescope(which),
        width_px=size,
        height_px=size,
        pixel_pitch_mm=PITCH_MM,
        charge_diffusion_px=0.3,
        diffraction="rays",
    )


slow = [pytest.param(which, marks=pytest.mark.slow) for which in ("cassegrain", "folded")]
every_telescope = pytest.mark.parametrize("which", ["prime focus", *slow])


@every_telescope
def test_stars_are_where_numpy_rays_land_and_as_bright_as_the_open_area(engine, bench, which):
    camera = camera_of(which)
    stars = bench.stars_at(camera, [299.5, 500.2], [299.5, 120.7], bands=((600.0, 0.0),), nodes=1)
    traced = Tracer(camera, sobol_log2_rays=16).render(stars, exposure_s=1.0)
    truth = traced.truth
    assert set(traced.sampling) == {"sobol"}
    for star in range(2):
        x, y, weight = bench.bundle(camera, stars, star, 0, rings=300, arms=400, stagger=True)
        mean = bench.mean_of(x, y, weight)
        # 2^16 Sobol points behind vanes: 2e-3 of the spot's half width, a pixel off the axis
        assert np.hypot(truth.bundle_x_px[star, 0] - mean[0], truth.bundle_y_px[star, 0] - mean[1]) < 2e-3
    # on the axis: the mirror, less the shadow, less four vanes of 1 mm between the two
    open_mm2 = np.pi * (25.0**2 - 10.0**2) - 4 * 1.0 * 15.0
    arrived = (truth.electrons_image + truth.electrons_off_edge)[0, 0]
    assert arrived / stars.photon_rate.sum(axis=(1, 2))[0] == pytest.approx(open_mm2, rel=1e-3)
    chief_x, chief_y = chief_ray_points(camera.lens, *np.degrees(np.arctan(np.divide(
        [[0.0, 200.7], [0.0, -178.8]], 400.0 / PITCH_MM))))  # fmt: skip
    np.testing.assert_allclose(truth.chief_x_px[:, 0], 299.5 + chief_x / PITCH_MM, atol=1e-6)
    np.testing.assert_allclose(truth.chief_y_px[:, 0], 299.5 - chief_y / PITCH_MM, atol=1e-6)
    # the picture is not mirrored: a star to the right stands right, one above stands above
    assert truth.chief_x_px[1, 0] > 490
    assert truth.chief_y_px[1, 0] < 130


@pytest.mark.slow
@every_telescope
def test_light_that_goes_backwards_finds_the_star_s_ball(mi, bench, which):
    camera = camera_of(which)
    stars = bench.stars_at(camera, 470.2, 180.7, bands=((600.0, 0.0),), nodes=1)
    whole = Tracer(camera, sobol_log2_rays=14).render(stars, exposure_s=1.0).truth
    small = bench.window(camera, 16, whole.bundle_x_px[0, 0], whole.bundle_y_px[0, 0])
    truth = Tracer(small, sobol_log2_rays=14).render(stars, exposure_s=1.0).truth
    ball = bench.distant_ball(stars.direction[0], 2.0 * PITCH_MM / 400.0)  # 4 px across
    image = bench.path_image(mi, small, {"ball": ball}, spp=4096, scene_unit_mm=1000.0, wavelength_nm=600.0)
    index = np.arange(16)
    at = index @ image.sum(0) / image.sum(), index @ image.sum(1) / image.sum()
    # some 4 x 3 px hit by 4096 rays each, of which six tenths get through: standard error 0.01 px
    assert at[0] == pytest.approx(truth.bundle_x_px[0, 0], abs=0.04)
    assert at[1] == pytest.approx(truth.bundle_y_px[0, 0], abs=0.04)
