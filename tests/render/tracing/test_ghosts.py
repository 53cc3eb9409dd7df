"""Ghosts in rendered images: places, light and shape against the paths they are."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from optics.errors import DomainError
from optics.frames import field_direction
from optics.glass.coating import QuarterWave
from optics.lens.without_glass import ideal_lens
from optics.lens_file import load_lens
from optics.rays.ghosts import find_ghosts, with_cover_glass
from render.camera import Camera, PathLosses
from render.forward import StarRenderer
from render.records import StarField
from render.tracing.ghosts import GhostLight

WAVE_NM = np.array([[600.0]])
STAR = field_direction(0.55, 0.3)


@pytest.fixture(scope="module", params=["ideal", pytest.param("star_camera_206mm", marks=pytest.mark.slow)])
def camera(request):
    ideal = request.param == "ideal"
    bare = ideal_lens(focal_length_mm=100.0, f_number=4.0) if ideal else load_lens(request.param)
    lens = with_cover_glass(bare, "N-BK7", 0.5, 1.0)
    losses = PathLosses(coating=QuarterWave(design_wavelength_nm=550.0))
    return Camera(
        lens=lens, width_px=1024, height_px=900, pixel_pitch_mm=0.0055, charge_diffusion_px=0.3, losses=losses,
        diffraction="rays",
    )  # fmt: skip


def stars(rate: float, direction: np.ndarray = STAR) -> StarField:
    return StarField(
        direction=direction[None], wavelength_nm=WAVE_NM, photon_rate=np.full((1, 1, 1), rate), band=("v",)
    )


def test_ghosts_lie_where_paths_land_with_their_light(engine, camera):
    """The images of two ghosts, one in a window of its own: centroid, light, width; truth equal to `find_ghosts`."""
    renderer = StarRenderer(camera, ghosts=GhostLight(least_e=0.2))
    renderer.render(stars(2e3))
    truth, light = renderer.ghost_truth, renderer.ghost_electrons[..., 0]
    known = find_ghosts(camera.focused_lens, STAR, wavelength_nm=600.0, coating=camera.losses.coating)
    assert len(truth) >= 2
    whole = renderer.traced.truth
    electrons = float((whole.electrons_image + whole.electrons_off_edge + whole.electrons_beyond)[0, 0])
    for g in range(len(truth)):
        row = np.flatnonzero((known.back == truth.back[g]) & (known.forward == truth.forward[g]))[0]
        x, y = camera.to_pixel(known.x_mm[row], known.y_mm[row])
        assert np.hypot(truth.x_px[g] - x, truth.y_px[g] - y) < 1e-6
        assert truth.electrons[g] == pytest.approx(known.flux[row] * electrons, rel=1e-6)
        assert truth.radius_px[g] == pytest.approx(np.sqrt(2.0) * known.rms_mm[row] / 0.0055, rel=1e-6)
    assert float(light.sum(dtype=float)) == pytest.approx(truth.electrons_image.sum(), rel=1e-5)
    inside = truth.electrons_image > 0.999 * truth.electrons
    assert inside.any()
    centre = [float((v * light).sum() / light.sum()) for v in np.indices(light.shape)[::-1]]
    if inside.all():
        expected = [np.average(v, weights=truth.electrons) for v in (truth.x_px, truth.y_px)]
        assert np.hypot(*np.subtract(centre, expected)) < 0.05


@pytest.mark.slow
def test_faint_stars_have_none_and_light_scales(engine, camera):
    renderer = StarRenderer(camera, ghosts=GhostLight(least_e=0.2))
    renderer.render(stars(1e-2))
    assert len(renderer.ghost_truth) == 0
    assert not renderer.ghost_electrons.any()
    bright, without = renderer.render(stars(2e3)), StarRenderer(camera).render(stars(2e3))
    once = renderer.ghost_electrons
    np.testing.assert_allclose(bright.electrons, without.electrons + once, rtol=1e-6)
    same = StarRenderer(camera, ghosts=GhostLight(least_e=0.4))
    same.render(stars(4e3))
    np.testing.assert_allclose(same.ghost_electrons, 2.0 * once, rtol=1e-4, atol=1e-7)


@pytest.mark.slow
def test_wide_ghosts_are_disks_with_all_their_light(engine, camera):
    """Pixels of a quarter of the pitch: ghosts wider than 150 px."""
    fine = replace(camera, pixel_pitch_mm=0.001, width_px=3000, height_px=3000, centre_px=np.full(2, np.nan))
    renderer = StarRenderer(fine, ghosts=GhostLight(least_e=0.05))
    renderer.render(stars(1e4, field_direction(0.05, 0.0)))
    truth = renderer.ghost_truth
    wide = (truth.radius_px > 150.0) & (truth.radius_px < 1000.0)
    assert wide.any()
    assert truth.electrons_image[wide] == pytest.approx(truth.electrons[wide], rel=1e-3)


def test_bad_settings():
    with pytest.raises(DomainError, match="least_e"):
        GhostLight(least_e=0.0)
    with pytest.raises(DomainError, match="reflectance"):
        GhostLight(least_e=1.0, detector_reflectance=1.5)
