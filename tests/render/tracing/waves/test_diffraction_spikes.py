"""Far images of bright stars against closed forms of apertures, sums of plane waves and the balance of the light."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from fields import star_field
from scipy.special import j0, j1

from optics.frames import field_direction
from optics.lens.apertures import Spider
from optics.lens.ideal_lens import ideal_lens
from optics.lens.system import LensSystem
from render.camera import Camera, FarLight
from render.tracing.tracer import TracedStars, Tracer
from render.tracing.waves import direct_sums
from render.tracing.waves.diffraction_spikes import FarImage, far_image

FOCAL_MM, F_NUMBER, PITCH_MM, WAVE_NM = 100.0, 4.0, 0.005, 600.0
UNIT_PX = WAVE_NM * 1e-6 * F_NUMBER / PITCH_MM
RADIUS_MM = 0.5 * FOCAL_MM / F_NUMBER
HOLE_MM, VANE_MM = 4.0, 0.5
BLACK = {"inner_semi_diameter_mm": HOLE_MM, "apertures": (Spider(arms=2, width_mm=VANE_MM, angle_deg=90.0),)}


def camera_of(far: FarLight | None = None, **stop: object) -> Camera:
    lens: LensSystem = ideal_lens(focal_length_mm=FOCAL_MM, f_number=F_NUMBER, design_wavelength_nm=WAVE_NM)
    lens = lens.with_surfaces({lens.stop_index: replace(lens.surfaces[lens.stop_index], **stop)})
    return Camera(
        lens=lens, width_px=401, height_px=301, pixel_pitch_mm=PITCH_MM, charge_diffusion_px=0.3, far=far,
        diffraction="exact_waves",
    )  # fmt: skip


def known(**stop: object) -> FarImage:
    found = far_image(Tracer(camera_of(**stop)).planner, WAVE_NM)
    assert found is not None
    return found


def star(camera: Camera, electrons: float, place_deg: tuple[float, float] = (0.02, 0.01)) -> TracedStars:
    tracer = Tracer(camera)
    field = star_field(field_direction(*place_deg), [580.0, 600.0, 620.0], electrons / tracer.pupil.area_mm2 / 3.0)
    return tracer.render(field, exposure_s=1.0)


def test_light_beyond_a_radius_of_a_round_aperture() -> None:
    """J0^2 + J1^2 at pi r / (lambda N), in disks of 20 to 80 px."""
    far, reach = known(), 90
    edges = np.arange(-reach, reach + 2) - 0.5
    pixels = far.pixels(edges, edges, np.array([WAVE_NM]), np.ones(1))
    distance = np.hypot(*np.meshgrid(*[np.arange(-reach, reach + 1)] * 2))
    assert far.unit_px(WAVE_NM) == pytest.approx(UNIT_PX, rel=0.03)  # of the disk that holds the aperture
    for radius, worst in ((20, 0.05), (40, 0.06), (80, 0.1)):
        inside = distance <= radius
        v = np.pi * np.sqrt(inside.sum() / np.pi) / UNIT_PX
        steps = np.linspace(-0.5, 0.5, 41)  # rings cross the ragged edge of the disk
        ring = np.mean([j0(v + 3.0 * s) ** 2 + j1(v + 3.0 * s) ** 2 for s in steps])
        assert 1.0 - pixels[inside].sum() == pytest.approx(ring, rel=worst)


@pytest.mark.slow
def test_spike_of_a_vane() -> None:
    """Pixels along the spike of two vanes across a hole: circle less circle less two rectangles, transformed."""
    far = known(**BLACK)
    radius, hole, width = (v / RADIUS_MM / 2.0 for v in (RADIUS_MM, HOLE_MM, VANE_MM))  # diameter 1: per lambda N
    middle, half = 0.5 * (radius + hole), 0.5 * (radius - hole)

    def amplitude(x, y):
        r = np.hypot(x, y)
        rings = [a * j1(2.0 * np.pi * a * r) / r for a in (radius, hole)]
        vanes = 2.0 * half * np.sinc(2.0 * half * y) * width * np.sinc(width * x)
        return rings[0] - rings[1] - 2.0 * np.cos(2.0 * np.pi * middle * y) * vanes

    area = np.pi * (radius**2 - hole**2) - 4.0 * half * width
    part = (np.arange(24) + 0.5) / 24 - 0.5
    for columns, rows, worst in (
        ((20, 40), (-2, 3), 0.05),
        ((40, 70), (-2, 3), 0.1),
        ((70, 100), (-2, 3), 0.2),
        ((-2, 3), (30, 60), 0.05),
        ((25, 45), (25, 45), 0.05),
    ):
        x, y = ((np.arange(*v)[:, None] + part).ravel() / UNIT_PX for v in (columns, rows))
        light = np.sum(amplitude(*np.meshgrid(x, y)) ** 2) / area / UNIT_PX**2 / 24**2
        edges = [np.arange(v[0], v[1] + 1) - 0.5 for v in (columns, rows)]
        got = far.pixels(edges[0], edges[1], np.array([WAVE_NM]), np.ones(1)).sum()
        assert got == pytest.approx(light, rel=worst)
    assert far.spikes > 3.0 * far.fall


@pytest.mark.parametrize("stop", [{}, pytest.param(BLACK, marks=pytest.mark.slow)])
def test_bright_star_ends_far_out_and_light_balances(stop) -> None:
    far = FarLight(ends_e=2.0, saturated_e=1e5)
    bright, plain = star(camera_of(far, **stop), 4e6), star(camera_of(**stop), 4e6)
    for one in (bright, plain):
        t = one.truth
        parts = (t.electrons_image, t.electrons_vignetted, t.electrons_off_edge, t.electrons_beyond)
        assert sum(float(p[0, 0]) for p in parts) == pytest.approx(float(t.electrons_in[0, 0]), rel=1e-9)
        assert float(t.electrons_image[0, 0]) == pytest.approx(float(one.electrons.sum(dtype=float)), rel=1e-6)
    through = bright.truth.electrons_image + bright.truth.electrons_off_edge + bright.truth.electrons_beyond
    assert bright.truth.electrons_beyond[0, 0] < 1e-3 * through[0, 0] < plain.truth.electrons_beyond[0, 0]
    core = plain.electrons > 0.0
    assert np.array_equal(bright.electrons[core], plain.electrons[core])
    twice = star(camera_of(far, **stop), 8e6)
    lit = bright.electrons > 0.0
    assert np.count_nonzero(twice.electrons) >= np.count_nonzero(lit)
    np.testing.assert_allclose(twice.electrons[lit], 2.0 * bright.electrons[lit], rtol=1e-5)
    faint = star(camera_of(far, **stop), 2e4)
    assert faint.truth.electrons_beyond == star(camera_of(**stop), 2e4).truth.electrons_beyond


def test_far_image_continues_the_sum_of_plane_waves() -> None:
    """Against a stamp three times as wide as its own: rings of 10 to 27 px, mean of sectors of 45 deg."""
    camera = camera_of(FarLight(ends_e=0.05, saturated_e=1e9))
    got = star(camera, 1e6).electrons[..., 0]

    before = direct_sums.WING
    try:
        direct_sums.WING = 2e-5 / 27.0
        exact = star(replace(camera, far=None), 1e6).electrons[..., 0]
    finally:
        direct_sums.WING = before
    y, x = np.indices(got.shape)
    middle = [float((v * exact).sum() / exact.sum()) for v in (x, y)]
    distance, angle = np.hypot(x - middle[0], y - middle[1]), np.arctan2(y - middle[1], x - middle[0])
    for low, high in ((10, 15), (15, 20), (20, 27)):
        for sector in range(8):
            some = (distance > low) & (distance < high) & (np.floor((angle / np.pi + 1.0) * 4.0) == sector)
            assert got[some].sum() == pytest.approx(exact[some].sum(), rel=0.06)
