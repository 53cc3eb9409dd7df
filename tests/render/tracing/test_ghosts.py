"""Ghosts in rendered images: places, light and shape against the paths they are."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from fields import star_field

from optics.frames import field_direction
from optics.glass.coating import QuarterWave
from optics.lens.ideal_lens import ideal_lens
from optics.lens_file import load_lens
from optics.rays.ghosts import find_ghosts, with_cover_glass
from optics.rays.pupil_sampling import gauss_disk
from render.camera import Camera, PathLosses
from render.forward import StarRenderer
from render.records import StarField, Truth
from render.tracing.ghosts import Ghosting, GhostLight, GhostTruth

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


def stars(rate: float | np.ndarray, direction: np.ndarray = STAR) -> StarField:
    return star_field(direction, WAVE_NM, rate)


def ghosts_of(camera: Camera, least_e: float, field: StarField) -> tuple[GhostTruth, np.ndarray, Truth]:
    """Ghosts of stars, their light, and the truth of the stars."""
    truth = StarRenderer(camera).render(field).truth
    light = np.zeros((camera.height_px, camera.width_px, 1), np.float32)
    return Ghosting(camera, GhostLight(least_e=least_e)).add(light, field.direction, WAVE_NM, truth), light, truth


def test_ghosts_lie_where_paths_land_with_their_light(engine, camera):
    """The images of two ghosts, one in a window of its own: centroid, light, width; truth equal to `find_ghosts`."""
    truth, light, whole = ghosts_of(camera, 0.2, stars(2e3))
    light = light[..., 0]
    known = find_ghosts(camera.focused_lens, STAR, wavelength_nm=600.0, coating=camera.losses.coating)
    assert len(truth) >= 2
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
    none, dark, _ = ghosts_of(camera, 0.2, stars(1e-2))
    assert len(none) == 0
    assert not dark.any()
    once, twice = ghosts_of(camera, 0.2, stars(2e3))[1], ghosts_of(camera, 0.4, stars(4e3))[1]
    np.testing.assert_allclose(twice, 2.0 * once, rtol=1e-4, atol=1e-7)


@pytest.mark.slow
def test_wide_ghosts_are_disks_with_all_their_light(engine, camera):
    """Pixels of a quarter of the pitch: ghosts wider than 150 px."""
    fine = replace(camera, pixel_pitch_mm=0.001, width_px=3000, height_px=3000, centre_px=np.full(2, np.nan))
    truth, _, _ = ghosts_of(fine, 0.05, stars(1e4, field_direction(0.05, 0.0)))
    wide = (truth.radius_px > 150.0) & (truth.radius_px < 1000.0)
    assert wide.any()
    assert truth.electrons_image[wide] == pytest.approx(truth.electrons[wide], rel=1e-3)


def beside(camera: Camera, field: StarField, least_e: float = 0.2, **more) -> tuple[GhostTruth, np.ndarray]:
    """Ghosts by the light on the first surface."""
    light = np.zeros((camera.height_px, camera.width_px, 1), np.float32)
    truth = Ghosting(camera, GhostLight(least_e=least_e)).add_beside(light, field, exposure_s=1.0, **more)
    return truth, light[..., 0]


@pytest.mark.parametrize("radius_rad", [0.0, 0.004])
def test_a_source_beside_the_frame_is_its_points(engine, camera, radius_rad):
    """A point: the same ghosts as by its own image, which rays of the beam alone make. A disk: those of its points."""
    middle, rate = field_direction(0.4, 0.3), 1e5
    alone, light = beside(camera, stars(rate, middle), 0.01, radius_rad=radius_rad)
    if not radius_rad:
        other, drawn, _ = ghosts_of(camera, 0.01, stars(rate, middle))
        drawn = drawn[..., 0]
        keys = [list(zip(one.back, one.forward, strict=True)) for one in (alone, other)]
        rows = [[keys[0].index(key), keys[1].index(key)] for key in keys[1] if key in keys[0]]
        here, there = np.array(rows).T
        bright = other.electrons[there] > 0.05 * other.electrons.max()
        assert bright.sum() >= 2
        np.testing.assert_allclose(alone.electrons[here][bright], other.electrons[there][bright], rtol=0.03)
        apart = np.hypot(alone.x_px[here] - other.x_px[there], alone.y_px[here] - other.y_px[there])
        assert (apart[bright] < 0.02 * other.radius_px[there][bright] + 0.2).all()
    else:
        points = gauss_disk(3, 6)
        towards = middle + radius_rad * np.column_stack([points.x, points.y, 0.0 * points.x])
        towards = towards / np.linalg.norm(towards, axis=1, keepdims=True)
        field = stars((rate * points.weight)[:, None, None], towards)
        drawn = beside(camera, field, 1e-4)[1]
    assert light.sum(dtype=float) == pytest.approx(drawn.sum(dtype=float), rel=0.03)
    for axis in (0, 1):
        first, second = (one.sum(axis=axis, dtype=float).cumsum() / one.sum(dtype=float) for one in (light, drawn))
        np.testing.assert_allclose(first, second, atol=0.03)
