"""Transmission of rays along their own paths: the fit, the kernel and the balance of light against traced paths."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from fields import star_field

from optics.frames import field_direction
from optics.glass.coating import Film, QuarterWave, Stack
from optics.lens_file import load_lens
from optics.rays.entrance_pupil import launch_disks, star_rays
from optics.rays.ghosts import trace_ghost
from optics.rays.pupil_sampling import gauss_disk
from optics.rays.trace import OK
from render.camera import Camera, PathLosses
from render.records import StarField
from render.tracing.pupil.points import TablePoints
from render.tracing.tracer import Tracer

WAVE_NM = np.array([[520.0, 640.0]])
FIELDS_DEG = ((0.0, 0.0), (2.5, -4.0), (6.0, 5.0))
STACK = Stack(films=(Film(thickness_nm=95.0, index=1.38), Film(thickness_nm=120.0, index=2.1)))


def camera_of(losses: PathLosses | None, **settings: object) -> Camera:
    camera = Camera(
        lens=load_lens("star_tracker_26mm"), width_px=800, height_px=800, pixel_pitch_mm=0.011, charge_diffusion_px=0.4
    )
    return replace(camera, losses=losses, **settings)  # type: ignore[arg-type]


def stars() -> StarField:
    return star_field([field_direction(*place) for place in FIELDS_DEG], WAVE_NM, [30.0, 50.0])


@pytest.mark.parametrize("losses", [PathLosses(coating=QuarterWave()), PathLosses(coating=STACK, absorption=False)])
def test_kernel_has_the_transmission_of_each_ray(losses: PathLosses) -> None:
    """Against paths traced one by one, at rays that the fit does not know, on the axis and at 8 deg."""
    camera = camera_of(losses)
    planner, lens, light = Tracer(camera).planner, camera.focused_lens, stars()
    points = 0.7 * np.random.default_rng(3).uniform(-0.7, 0.7, (2, 40, 2))
    pupil = TablePoints(points, np.full(40, 1 / 40))
    kernel = planner.kernel(light.direction)
    every = np.arange(3, dtype=np.uint32)
    got, arrived = kernel.transmitted(pupil, WAVE_NM, every), kernel.land(pupil, WAVE_NM, every)[2]
    assert arrived.sum() > 100
    for s, star in enumerate(light.direction):
        for k, wave in enumerate(WAVE_NM[0]):
            disk = replace(gauss_disk(5, 8), x=points[k, :, 0], y=points[k, :, 1], weight=np.ones(40))
            rays = star_rays(planner.pupil, disk, star, wave, ambient_index=lens.indices(wave)[0])
            out = trace_ghost(lens, None, rays, np.ones(40), coating=losses.coating, absorption=losses.absorption)
            lit = arrived[s, 0, k] & (out.rays.status == OK)
            expected = out.weight / losses.along_axis(lens, wave)
            assert np.abs(np.asarray(got)[s, 0, k] - expected)[lit].max() < 3e-5
            assert np.ptp(expected[lit]) > 3e-4


def test_light_of_stars_and_balance() -> None:
    """By rays and waves; the light that arrives against a quadrature on NumPy."""
    losses = PathLosses(coating=QuarterWave())
    lens = camera_of(losses).focused_lens
    expected = []
    for star in stars().direction:
        shares = []
        for wave in WAVE_NM[0]:
            disks = launch_disks(lens, star[None], [wave])
            points = gauss_disk(40, 160)
            disk = replace(
                Tracer(camera_of(None)).pupil, x_mm=disks.x_mm.item(), y_mm=disks.y_mm.item(),
                z_mm=float(disks.z_mm), radius_mm=disks.radius_mm.item(),
            )  # fmt: skip
            rays = star_rays(disk, points, star, wave, ambient_index=lens.indices(wave)[0])
            out = trace_ghost(lens, None, rays, points.weight, coating=losses.coating)
            clear = points.weight[out.rays.status == OK].sum()
            shares.append(1.0 - out.weight.sum() / clear / losses.along_axis(lens, wave))
        expected.append(shares)
    for diffraction in ("rays", "exact_waves"):
        truth = Tracer(camera_of(losses, diffraction=diffraction)).render(stars(), exposure_s=1.0).truth
        assert truth.electrons_absorbed is not None
        assert truth.electrons_beyond is not None
        parts = (truth.electrons_image, truth.electrons_vignetted, truth.electrons_off_edge, truth.electrons_beyond)
        balance = sum(parts) + truth.electrons_hidden + truth.electrons_absorbed
        assert np.abs(balance / truth.electrons_in - 1.0).max() < 1e-9
        clear = truth.electrons_in - truth.electrons_vignetted
        assert (truth.electrons_absorbed / clear)[:, 0] == pytest.approx(np.array(expected) @ [0.375, 0.625], abs=3e-5)


def test_nothing_where_all_rays_lose_alike() -> None:
    """Mirrors without coatings."""
    lens = load_lens("hubble_57m")
    camera = Camera(lens=lens, width_px=64, height_px=64, pixel_pitch_mm=0.015, losses=PathLosses())
    assert Tracer(camera).planner.transmission(WAVE_NM) is None
