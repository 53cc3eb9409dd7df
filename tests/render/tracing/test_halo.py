"""Halos of scattered light: their integral, their law, and the balance of the light."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from fields import star_field

from optics.frames import field_direction
from optics.lens.ideal_lens import ideal_lens
from optics.light.bsdf import ABg, polished
from render.camera import Camera, FarLight
from render.tracing.tracer import TracedStars, Tracer

PITCH_MM, FOCAL_MM = 0.01, 50.0
PER_PX = PITCH_MM / FOCAL_MM


@pytest.fixture(scope="module")
def camera() -> Camera:
    lens = ideal_lens(focal_length_mm=FOCAL_MM, f_number=2.0)
    return Camera(
        lens=lens, width_px=701, height_px=701, pixel_pitch_mm=PITCH_MM, charge_diffusion_px=0.4, diffraction="rays",
        far=FarLight(ends_e=1e-4, saturated_e=1e9),
    )  # fmt: skip


def star(camera: Camera, electrons: float) -> TracedStars:
    tracer = Tracer(camera)
    field = star_field(field_direction(0.01, -0.02), 600.0, electrons / tracer.pupil.area_mm2)
    return tracer.render(field, exposure_s=1.0)


@pytest.mark.parametrize("slope", [-4.0, -6.0])
def test_integral_is_the_tis_and_light_balances(engine, camera, slope):
    """A narrow law: nearly all of its light lies on the detector."""
    law = polished(0.03, shoulder=8.0 * PER_PX, slope=slope)
    plain, made = star(camera, 1e8), star(replace(camera, scatter=law), 1e8)
    truth = made.truth
    assert float(truth.electrons_in[0, 0]) == pytest.approx(float(plain.truth.electrons_in[0, 0]), rel=1e-12)
    parts = (truth.electrons_image, truth.electrons_vignetted, truth.electrons_off_edge, truth.electrons_beyond)
    assert sum(float(p[0, 0]) for p in (*parts, truth.electrons_scattered)) == pytest.approx(
        float(truth.electrons_in[0, 0]), rel=1e-9
    )
    assert float(truth.electrons_scattered[0, 0]) == pytest.approx(0.03 * float(truth.electrons_in[0, 0]), rel=1e-6)
    drawn = float(made.halo.sum(dtype=float)) / float(truth.electrons_scattered[0, 0])
    beyond = (1.0 + (350.0 / 8.0) ** 2) ** (0.5 * slope + 1.0)  # of an endless plane, outside a disk of 350 px
    assert drawn == pytest.approx(1.0 - beyond, abs=1e-3)
    np.testing.assert_allclose(made.electrons - made.halo, 0.97 * plain.electrons, rtol=1e-5, atol=2.0)


def test_a_pixel_holds_radiance_times_solid_angle(engine, camera):
    law = ABg(a=1e-4, b=1e-5, g=2.0)
    made = star(replace(camera, scatter=law), 1e8)
    x, y = (float(v[0, 0]) for v in (made.truth.photon_x_px, made.truth.photon_y_px))
    for column, row in ((500, 300), (360, 200), (352, 349)):
        beta = np.hypot(column - x, row - y) * PER_PX
        expected = 1e8 * law.a / (law.b + beta**2) * PER_PX**2
        assert float(made.halo[row, column, 0]) == pytest.approx(expected, rel=2e-3)
