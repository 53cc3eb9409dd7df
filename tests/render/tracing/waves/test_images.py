"""Diffraction images against the sums of plane waves on NumPy, whose rays, pupils and matrices are its own."""

import math
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from fields import star_field
from scipy.spatial.transform import Rotation

from optics.frames import field_direction
from optics.lens.perturb import decentre
from optics.lens.system import LensSystem
from optics.lens_file import load_lens
from optics.light.collimation import Collimation
from optics.waves.pupil_field import PupilField, trace_pupil
from render.camera import Camera
from render.motion.trajectory import ConstantRate
from render.tracing.motion.exposure import exposure_motion
from render.tracing.tracer import Tracer
from render.tracing.waves.field_grid_build import plan_grid

SIGMA_PX, PITCH_MM = 0.18, 5.5e-3


def camera_of(lens, width=64, height=64, **changes):
    lens = lens if isinstance(lens, LensSystem) else load_lens(lens)
    settings = {"pixel_pitch_mm": PITCH_MM, "charge_diffusion_px": SIGMA_PX, "diffraction": "waves"} | changes
    return Camera(lens=lens, width_px=width, height_px=height, **settings)


def looking_at(camera, field_x_deg, field_y_deg, wavelength_nm, at_px):
    """The camera with its window moved so that the light of a field lands at a pixel position of it."""
    traced = trace_pupil(camera.focused_lens, field_x_deg, field_y_deg, wavelength_nm, order=(12, 32))
    x, y = (float(v[0, 0]) / camera.pixel_pitch_mm for v in traced.mean_mm)
    return replace(camera, centre_px=np.array([at_px[0] - x, at_px[1] + y]))


def pixel_shares(camera, traced: PupilField, weight, sigma_px=SIGMA_PX, margin=6):
    """Light per pixel of a camera's whole image: band-limited samples, the pixel as a product in Fourier space."""
    n = 9
    columns = (np.arange((camera.width_px + 2 * margin) * n) + 0.5) / n - 0.5 - margin
    rows = (np.arange((camera.height_px + 2 * margin) * n) + 0.5) / n - 0.5 - margin
    x = (columns - camera.centre_px[0]) * camera.pixel_pitch_mm
    y = -(rows - camera.centre_px[1]) * camera.pixel_pitch_mm
    light = np.asarray(weight) * traced.area_mm2.sum((2, 3))[0]
    density = (
        sum(part * traced.intensity(x, y, at=(0, k)) for k, part in enumerate(light / light.sum()))
        * camera.pixel_pitch_mm**2
    )
    transfers = []
    for size in density.shape:
        f = np.fft.fftfreq(size, 1.0 / n)
        to_centre = np.exp(2j * np.pi * f * (0.5 - 0.5 / n))
        transfers.append(np.sinc(f) * np.exp(-2.0 * (np.pi * sigma_px * f) ** 2) * to_centre)
    pixels = np.fft.ifft2(np.fft.fft2(density) * transfers[0][:, None] * transfers[1]).real[::n, ::n]
    return pixels[margin:-margin, margin:-margin]


@pytest.mark.parametrize(
    ("name", "field", "sigma_px", "defocus_mm"),
    [
        ("star_camera_206mm", (3.1, 0.9), SIGMA_PX, 0.0),
        pytest.param("star_camera_206mm", (0.0, 0.0), 0.0, 0.0, marks=pytest.mark.slow),
        pytest.param("star_camera_206mm", (0.0, 2.0), SIGMA_PX, 0.03, marks=pytest.mark.slow),
        pytest.param("star_tracker_26mm", (14.0, 5.0), SIGMA_PX, 0.0, marks=pytest.mark.slow),  # vignetted
    ],
)
def test_pixels_are_the_integrals_of_the_plane_wave_sum(engine, name, field, sigma_px, defocus_mm):
    wave, weight = np.array([560.0, 640.0]), np.array([1.0, 0.6])
    camera = camera_of(name, 11, 11, charge_diffusion_px=sigma_px, defocus_mm=defocus_mm)
    camera = looking_at(camera, *field, wave[:1], (5.2, 4.7))
    traced = Tracer(camera).render(star_field(field_direction(*field), wave, weight), exposure_s=1.0)
    pupil = trace_pupil(camera.focused_lens, *field, wave, half_width_mm=0.066)
    expected = pixel_shares(camera, pupil, weight, sigma_px)
    truth = traced.truth
    shares = traced.electrons[..., 0] / (truth.electrons_in - truth.electrons_vignetted)[0, 0]
    assert np.abs(shares - expected).max() < 1e-5
    assert expected.max() > 0.1


@pytest.mark.slow
def test_arcs_of_an_outline_have_rays_enough_at_every_wavelength(engine):
    """The shortest of twelve wavelengths, whose arcs are not as long as the others', as if it were the only one."""
    wave, camera = np.linspace(448.5, 901.8, 12), camera_of("star_tracker_26mm", 33, 33, diffraction="exact_waves")
    field = np.degrees(np.arctan(0.2553)), 0.0
    camera = looking_at(camera, *field, wave[:1], (16.2, 15.7))
    many, alone = (
        Tracer(camera).render(
            star_field(field_direction(*field), waves, [1.0] + [0.0] * (len(waves) - 1)), exposure_s=1.0
        )
        for waves in (wave, wave[:1])
    )
    assert list(many.sampling) == ["arcs"]
    assert np.abs(many.electrons - alone.electrons).max() < 2e-6 * alone.truth.electrons_in.min()


def test_every_electron_is_accounted_for_and_the_rest_is_what_the_rings_hold(engine):
    camera = camera_of("star_camera_206mm", 31, 31)
    traced = Tracer(camera).render(star_field(field_direction(0.0, 0.0), 600.0), exposure_s=2.0)
    truth = traced.truth
    parts = (truth.electrons_image, truth.electrons_vignetted, truth.electrons_off_edge, truth.electrons_beyond)
    assert sum(parts) == pytest.approx(truth.electrons_in, rel=1e-12)
    assert traced.electrons.sum() == pytest.approx(truth.electrons_image[0, 0], rel=1e-6)
    # beyond r an Airy pattern has 2 lambda N / (pi^2 r) of its light, on average over a ring
    lit = np.argwhere(traced.electrons[..., 0] > 0.0)
    radius_mm = np.sqrt(len(lit) / np.pi) * PITCH_MM
    expected = 2.0 * 600e-6 * 2.95 / (np.pi**2 * radius_mm)
    assert truth.electrons_beyond[0, 0] / truth.electrons_in[0, 0] == pytest.approx(expected, rel=0.08)


def test_the_centroid_of_all_light_is_the_mean_of_the_rays_at_every_wavelength(engine):
    """It does not hold for a window: that sees the asymmetric rings of the wings cut off."""
    camera = camera_of("star_camera_206mm", 41, 41)
    for wave in (500.0, 800.0):
        seen = looking_at(camera, 3.3, 0.0, wave, (20.3, 20.0))
        stars = star_field(field_direction(3.3, 0.0), wave)
        truth = Tracer(seen).render(stars, exposure_s=1.0).truth
        rays = Tracer(replace(seen, diffraction="rays")).render(stars, exposure_s=1.0).truth
        assert truth.photon_x_px[0, 0] == pytest.approx(rays.bundle_x_px[0, 0], abs=1e-6)
        assert truth.photon_y_px[0, 0] == pytest.approx(rays.bundle_y_px[0, 0], abs=1e-6)


@pytest.mark.slow
def test_a_trail_is_the_mean_of_still_images(engine):
    camera = camera_of("star_camera_206mm", 36, 36)
    star = field_direction(0.001, 0.0)
    stars = star_field(star, 600.0)
    trajectory = ConstantRate(initial=Rotation.identity(), rate_rad_per_s=np.radians([0.005, -0.008, 0.0]), end_s=1.0)
    motion = exposure_motion(trajectory, start_s=0.0, exposure_s=0.5, camera=camera)
    moving = Tracer(camera).render(stars, exposure_s=0.5, motion=motion)
    still = [
        weight * Tracer(camera).render(stars, exposure_s=0.5, rotation_cam_from_world=rotation).electrons
        for rotation, weight in zip(motion.rotation_cam_from_world, motion.weight, strict=True)
    ]
    assert len(still) > 3
    total = moving.truth.electrons_in[0, 0]
    assert np.abs(moving.electrons - sum(still)).max() < 5e-5 * total  # stamps end where a pixel holds some 1e-5
    assert moving.truth.photon_x_px[0, 0] == pytest.approx(moving.truth.bundle_x_px[0, 0], abs=1e-4)


@pytest.mark.slow
def test_a_hole_in_the_stop_makes_the_amplitude_of_the_disk_less_that_of_the_hole(engine):
    lens = load_lens("star_camera_206mm")
    stop, hole = lens.surfaces[lens.stop_index], 14.0
    pierced = lens.with_surfaces({lens.stop_index: replace(stop, inner_semi_diameter_mm=hole)})
    camera = camera_of(pierced, 13, 13)
    traced = Tracer(camera).render(star_field(field_direction(0.0, 0.0), 600.0), exposure_s=1.0)
    small = lens.with_surfaces({lens.stop_index: replace(stop, semi_diameter_mm=hole)})
    n = 10
    grid = ((np.arange(33 * n) + 0.5) / n - 16.5) * PITCH_MM
    fields, areas = [], []
    for one in (lens, small):
        p = trace_pupil(one, 0.0, 0.0, 600.0, half_width_mm=0.1)
        turns = p.path_mm[0, 0] / 600e-6 - p.l[0, 0] * p.x_mm[0, 0] * p.index / 600e-6
        turns = (turns - p.m[0, 0] * p.y_mm[0, 0] * p.index / 600e-6).ravel()
        weight = (p.area_mm2 * np.sqrt(p.jacobian))[0, 0].ravel() * np.exp(2j * np.pi * (turns - np.rint(turns[0])))
        left, right = (np.exp(2j * np.pi * np.outer(grid, v[0, 0].ravel() * p.index / 600e-6)) for v in (p.m, p.l))
        fields.append((left * weight) @ right.T * (p.index / 600e-6))
        areas.append(p.area_mm2.sum())
    density = np.abs(fields[0] - fields[1]) ** 2 / (areas[0] - areas[1]) * (PITCH_MM / n) ** 2
    f = np.fft.fftfreq(len(grid), 1.0 / n)
    transfer = n * np.sinc(f) * np.exp(-2.0 * (np.pi * SIGMA_PX * f) ** 2) * np.exp(2j * np.pi * f * (0.5 - 0.5 / n))
    expected = np.fft.ifft2(np.fft.fft2(density) * transfer[:, None] * transfer).real[::n, ::n][10:-10, 10:-10]
    truth = traced.truth
    through = 1.0 - truth.electrons_vignetted[0, 0] / truth.electrons_in[0, 0]
    assert through * Tracer(camera).pupil.area_mm2 == pytest.approx(areas[0] - areas[1], rel=1e-6)
    shares = traced.electrons[::-1, :, 0] / (truth.electrons_in - truth.electrons_vignetted)[0, 0]
    assert np.abs(shares - expected).max() < 1e-4 * expected.max()
    assert list(traced.sampling) == ["quadrature"]


@pytest.mark.parametrize(
    ("name", "focal_mm", "decentre_mm", "size_px", "count", "cut"),
    [
        ("star_camera_206mm", 206.2, 0.0, (4096, 2048), 6, False),
        ("star_camera_206mm", 206.2, 0.15, (300, 200), 6, False),
        pytest.param("star_tracker_26mm", 26.0, 0.0, (1862, 1862), 16, True, marks=pytest.mark.slow),
    ],
)
def test_images_interpolated_over_the_field(engine, name, focal_mm, decentre_mm, size_px, count, cut):
    """Images and PSFs, also of a decentred lens, for which mirrored or turned images would be wrong.

    Of the 26 mm lens apertures cut the beams of 7 stars, with kinks over the field that no polynomial follows: there
    the errors are what docs/diffraction.md states.
    """
    tolerance, ray_tolerance = 1e-4, 1e-4 if cut else 1e-5
    parts = 2e-4 if cut else 1e-4
    lens = load_lens(name)
    lens = decentre(lens, "L2", decentre_mm, -decentre_mm / 1.5) if decentre_mm else lens
    camera = camera_of(lens, *size_px)
    camera = replace(camera, centre_px=camera.centre_px + np.array([1.7, -2.4]))
    rng = np.random.default_rng(5)
    x, y = (rng.uniform(60.0, size - 60.0, count) for size in size_px)
    wave = np.array([560.0, 680.0])[: 1 if count < 16 else 2]
    direction = camera.nominal_direction(x, y, focal_mm)
    stars = star_field(direction, wave, rng.uniform(0.2, 1.0, (count, 1, len(wave))))
    tracers = Tracer(camera, by_grid=True), Tracer(replace(camera, diffraction="exact_waves"))
    fast, exact = (tracer.render(stars, exposure_s=1.0) for tracer in tracers)
    if count < 16:
        cells, expected = (tracer.centred_cells(stars, half_size_px=4, cells_per_px=4) for tracer in tracers)
        assert cells == pytest.approx(expected, abs=1e-5)
    assert list(fast.sampling) == ["grid"]
    assert sorted(exact.sampling) == (["arcs", "quadrature"] if cut else ["quadrature"])
    column, row = (np.rint(v[:, 0]).astype(int) for v in (exact.truth.photon_x_px, exact.truth.photon_y_px))
    for i, light in enumerate(exact.truth.electrons_in[:, 0]):
        part = slice(max(row[i] - 6, 0), row[i] + 7), slice(max(column[i] - 6, 0), column[i] + 7)
        ours, theirs = (r.electrons[..., 0][part].astype(float) for r in (fast, exact))
        assert np.abs(ours - theirs).max() < tolerance * light
        grid = np.arange(theirs.shape[1])
        assert (ours.sum(0) @ grid) / ours.sum() == pytest.approx((theirs.sum(0) @ grid) / theirs.sum(), abs=tolerance)
    assert fast.truth.photon_x_px == pytest.approx(exact.truth.photon_x_px, abs=tolerance if cut else 1e-6)
    assert fast.truth.electrons_beyond == pytest.approx(exact.truth.electrons_beyond, rel=0.2)
    rays = Tracer(replace(camera, diffraction="rays")).render(stars, exposure_s=1.0).truth  # the grid traces none
    for key in ("chief_x_px", "chief_y_px", "bundle_x_px", "bundle_y_px"):
        assert getattr(fast.truth, key) == pytest.approx(getattr(rays, key), abs=ray_tolerance)
    for key in ("variance_x_px2", "variance_y_px2", "electrons_in"):
        assert getattr(fast.truth, key) == pytest.approx(getattr(rays, key), rel=parts)


@pytest.mark.slow
def test_a_grid_shares_wavelengths_and_holds_the_light_of_a_collimator(engine):
    """Images of 16 wavelengths come from 7; light that diverges a little and is turned differently at each of them."""
    camera = camera_of("star_camera_206mm", 400, 300, defocus_mm=0.01)
    rng = np.random.default_rng(7)
    wave = np.linspace(553.0, 647.0, 16)[None]
    bent = Collimation(
        wavelength_nm=wave,
        slope_rad=1e-6 * np.stack([wave - 600.0, 0.4 * (600.0 - wave)], axis=-1) / 50.0,
        vergence_per_mm=np.full(wave.shape, 2e-7),
    )
    direction = camera.nominal_direction(rng.uniform(30.0, 370.0, 6), rng.uniform(30.0, 270.0, 6), 206.2)
    stars = replace(star_field(direction, wave, rng.uniform(0.2, 1.0, (6, 1, 16))), collimation=bent)
    fast, exact = (Tracer(replace(camera, diffraction=how), by_grid=True) for how in ("waves", "exact_waves"))
    ours, theirs = (one.render(stars, exposure_s=1.0) for one in (fast, exact))
    assert list(ours.sampling) == ["grid"]
    assert np.abs(ours.electrons - theirs.electrons).max() < 1e-4 * theirs.truth.electrons_in.min()
    assert ours.truth.photon_x_px == pytest.approx(theirs.truth.photon_x_px, abs=1e-5)
    cells, expected = (one.centred_cells(stars, half_size_px=4, cells_per_px=4) for one in (fast, exact))
    assert cells == pytest.approx(expected, abs=1e-5)


def test_a_star_beside_the_detector_costs_nothing_and_is_off_the_edge(engine):
    camera = camera_of("star_camera_206mm", 16, 16)
    traced = Tracer(camera).render(star_field(field_direction(1.0, 0.0), 600.0), exposure_s=1.0)
    assert not traced.sampling
    assert traced.truth.electrons_off_edge == pytest.approx(traced.truth.electrons_in)


@pytest.mark.slow
def test_the_mean_of_rays_keeps_the_symmetry_that_sampling_at_random_breaks(engine):
    """Apertures cut the beams of this lens, whose rays are else Sobol points: 3e-4 px beside the plane of symmetry."""
    camera = camera_of("double_gauss_50mm", 2048, 64)
    truth = Tracer(camera).render(star_field(field_direction(4.0, 0.0), 600.0), exposure_s=1.0).truth
    for y in (truth.bundle_y_px, truth.photon_y_px):
        assert y[0, 0] == pytest.approx(camera.centre_px[1], abs=1e-5)


def test_grid_is_made_where_it_pays():
    """What grids cost against their stars: few stars, or coarse pixels whose images are dear, are summed one by one."""
    wave = np.array([[560.0, 600.0, 640.0]])
    usual, coarse = (
        plan_grid(Tracer(camera_of("star_camera_206mm", *size_px, pixel_pitch_mm=pitch_mm)).planner, wave)
        for size_px, pitch_mm in (((4096, 2048), PITCH_MM), ((512, 256), 44e-3))
    )
    assert (usual.pays(3), usual.pays(10), coarse.pays(10), coarse.pays(40)) == (False, True, False, True)
    assert 10.0 < coarse.image_products / usual.image_products < 50.0  # 61 and 2.9 ms were measured


@pytest.mark.parametrize("angle_deg", [45.0, 12.3])
def test_light_past_a_spider_is_that_of_its_area(engine, tmp_path, angle_deg):
    """The telescope of the documentation: a disk, less a shadow in the middle, less four straight arms."""
    text = (Path(__file__).parents[4] / "docs" / "lens_file.md").read_text(encoding="utf-8")
    path = tmp_path / "telescope.toml"
    toml = re.search(r"```toml\n(name = .Ritchey.*?)```", text, flags=re.DOTALL)[1]
    path.write_text(toml.replace("angle_deg = 45.0", f"angle_deg = {angle_deg}"), encoding="utf-8")
    stars = star_field(np.array([0.0, 0.0, 1.0]), 600.0)
    truth = Tracer(camera_of(load_lens(path))).render(stars, exposure_s=1.0).truth

    def under_arc(radius, y=0.5):  # from -y to y
        return y * math.sqrt(radius**2 - y**2) + radius**2 * math.asin(y / radius)

    area_mm2 = math.pi * (25.0**2 - 10.0**2) - 4.0 * (under_arc(25.0) - under_arc(10.0))
    through = float((truth.electrons_in - truth.electrons_vignetted)[0, 0])
    assert through == pytest.approx(area_mm2, rel=1e-4)
