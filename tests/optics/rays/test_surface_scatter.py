"""Scatter of lens surfaces: against closed forms of light and throughput, and a Monte Carlo that goes forward."""

from dataclasses import replace

import numpy as np
import pytest
from lens_texts import table_lens
from made_lens import made_coating

from optics import load_lens
from optics.frames import field_direction, light_direction, polar_direction
from optics.light.bsdf import polished
from optics.rays.entrance_pupil import launch_disks
from optics.rays.ghosts import entrance_radius_mm, ghost_irradiance
from optics.rays.surface_scatter import imaging_rays, scattered_irradiance, scattering_surfaces
from optics.rays.trace import OK, Rays, trace

TRACKER = load_lens("star_tracker_26mm")


def loss_free(lens):
    return replace(lens, surfaces=tuple(replace(surface, coating=made_coating()) for surface in lens.surfaces))


def test_a_bright_sky_gives_pi_sin2_of_the_marginal_ray() -> None:
    """Irradiance on the axis of a lens without losses under a sky of radiance 1: pi sin^2 u', Abbe or not."""
    lens = loss_free(load_lens("star_camera_206mm"))
    rays = imaging_rays(lens, field_direction(0.0, 0.0)[None], absorption=False, rings=8, arms=16)
    _, arrived = axial_fan(lens)
    sine = np.abs(arrived.dx[arrived.status == OK]).max()
    assert rays.irradiance.item() == pytest.approx(np.pi * sine**2, rel=3e-3)


def test_narrow_scatter_ends_on_the_detector_whole() -> None:
    """Light on the detector, summed over it, is TIS times that of the image, surface by surface."""
    lens, tis = loss_free(TRACKER), 0.01
    law = polished(tis, 0.004, -4.0)
    field = np.degrees(np.arctan(np.geomspace(3e-4, 0.18, 60)))
    imaging = imaging_rays(lens, field_direction(field, 0.0 * field), absorption=False, rings=4, arms=8)
    numbers = scattering_surfaces(lens)
    found = scattered_irradiance(imaging, polar_direction(0.0), {"rough": dict.fromkeys(numbers, law.bsdf)})
    radius = np.concatenate([[0.0], imaging.x_mm])
    light = np.concatenate([found["rough"][:1], found["rough"]])
    flux = np.trapezoid(2.0 * np.pi * radius[:, None] * light, radius, axis=0)
    radius, arrived = axial_fan(lens)
    beam = np.pi * radius[arrived.status == OK].max() ** 2
    # n = 6 glass-air surfaces and cemented ones alike; what misses the detector or is cut by rims: a per cent
    np.testing.assert_allclose(flux, tis * beam, rtol=0.025)


def axial_fan(lens):
    """Heights of rays along the axis of the lens, and these rays on the detector."""
    disk = launch_disks(lens, field_direction(0.0, 0.0)[None], [lens.design_wavelength_nm])
    radius, along = np.linspace(0.0, disk.radius_mm.item(), 20001), [0.0, 0.0, 1.0]
    wave = lens.design_wavelength_nm
    start = Rays.create(x_mm=radius, y_mm=0.0, z_mm=disk.z_mm, direction=along, wavelength_nm=wave)
    return radius, trace(lens, start)


@pytest.mark.slow
def test_a_monte_carlo_that_goes_forward_finds_the_same() -> None:
    """Rays of a source at 20 deg, scattered at random behind the first lens, counted on the detector."""
    lens, half, count, number = loss_free(TRACKER), 3.0, 1_000_000, 1
    law, source = polished(0.02, 0.3, -1.5), polar_direction(20.0)
    node, weight = np.polynomial.legendre.leggauss(4)
    x, y = np.meshgrid(node, node)
    scale = half / 25.6
    imaging = imaging_rays(
        lens, field_direction(np.degrees(np.arctan(scale * x.ravel())), np.degrees(np.arctan(scale * y.ravel()))),
        absorption=False, rings=6, arms=16,
    )  # fmt: skip
    light = scattered_irradiance(imaging, source, {"rough": {number: law.bsdf}})["rough"].sum(axis=1)
    expected = float(light @ np.outer(weight, weight).ravel() / 4.0)

    rng = np.random.default_rng(5)
    radius, direction = 1.2 * entrance_radius_mm(lens), light_direction(source)
    r, phi = radius * np.sqrt(rng.random(count)), 2.0 * np.pi * rng.random(count)
    start = Rays.create(
        x_mm=r * np.cos(phi) - 5.0 * direction[0] / direction[2], y_mm=r * np.sin(phi),
        z_mm=-5.0, direction=direction, wavelength_nm=lens.design_wavelength_nm,
    )  # fmt: skip
    on_surfaces: list[Rays] = []
    trace(lens, start, lambda _, rays: on_surfaces.append(rays))
    here = on_surfaces[number]
    # a hemisphere behind the surface is left by most; directions within 35 deg of the axis reach the detector
    cosine = 1.0 - (1.0 - np.cos(np.radians(38.0))) * rng.random(count)
    turn = 2.0 * np.pi * rng.random(count)
    sine = np.sqrt(1.0 - cosine**2)
    away = np.stack([sine * np.cos(turn), sine * np.sin(turn), cosine], axis=1)
    shape = lens.surfaces[number].shape
    curvature = 1.0 / shape.radius_mm
    normal = np.stack([-here.x * curvature, -here.y * curvature, 1.0 - here.z * curvature], axis=1)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    came = np.stack([here.dx, here.dy, here.dz], axis=1)
    apart = away - came
    apart -= normal * (apart * normal).sum(axis=1, keepdims=True)
    solid = 2.0 * np.pi * (1.0 - np.cos(np.radians(38.0)))
    share = law.bsdf(np.linalg.norm(apart, axis=1)) * (away * normal).sum(axis=1) * solid
    z = lens.surfaces[number].position_mm[2]
    rest = replace(
        lens, surfaces=tuple(replace(s, is_stop=at == 0) for at, s in enumerate(lens.surfaces[number + 1 :]))
    )
    on = trace(
        rest,
        Rays.create(
            x_mm=here.x, y_mm=here.y, z_mm=here.z + z, direction=away, wavelength_nm=lens.design_wavelength_nm
        ),
    )  # fmt: skip
    hit = (here.status == OK) & (on.status == OK) & (np.abs(on.x) < half) & (np.abs(on.y) < half)
    flux = np.where(hit, share, 0.0) * np.pi * radius**2 * source[2] / (2.0 * half) ** 2
    sigma = flux.std() / np.sqrt(count)
    assert sigma < 0.02 * expected
    assert flux.mean() == pytest.approx(expected, abs=4.0 * sigma)


def plate_lens():
    """A plane plate of index 1.5 in front of the detector, nothing else: bare glass, closed form."""
    return table_lens(
        {"stop": True, "thickness_mm": 1.0, "medium": "air", "semi_diameter_mm": 10.0},
        {"thickness_mm": 2.0, "medium": "N-BK7", "semi_diameter_mm": 30.0},
        {"thickness_mm": 5.0, "medium": "air", "semi_diameter_mm": 30.0},
        max_field_deg=20.0,
    )


def test_the_ghost_of_a_plane_plate_is_r2_t2() -> None:
    lens = plate_lens()
    index = lens.indices(lens.design_wavelength_nm)[2] / lens.indices(lens.design_wavelength_nm)[0]
    reflectance = ((index - 1.0) / (index + 1.0)) ** 2
    through = (1.0 - reflectance) ** 2

    def ghost(pair: tuple[int, int], detector: float) -> tuple[float, float]:
        settings = {"detector_reflectance": detector, "absorption": False, "rings": 60, "arms": 240}
        return ghost_irradiance(lens, polar_direction(0.0), (2.0, 2.0), **settings)[pair]

    value, error = ghost((2, 1), 0.0)
    assert value == pytest.approx(reflectance**2 * through, abs=2.0 * error)
    assert error < 0.04 * value
    # the detector sends 0.3 of what passes back, the far face of the plate returns R of it
    value, error = ghost((3, 2), 0.3)
    assert value == pytest.approx(0.3 * reflectance * through, abs=2.0 * error)


def test_scatter_grows_with_the_law_and_falls_with_the_angle() -> None:
    imaging = imaging_rays(TRACKER, field_direction([-5.0, 0.0, 5.0], [0.0, 0.0, 0.0]))
    numbers = scattering_surfaces(TRACKER)

    def light(angle_deg: float, tis: float) -> np.ndarray:
        law = polished(tis, 0.01, -2.0)
        return scattered_irradiance(imaging, polar_direction(angle_deg), {"rough": dict.fromkeys(numbers, law.bsdf)})[
            "rough"
        ].sum(axis=1)

    np.testing.assert_allclose(light(30.0, 2e-3), 2.0 * light(30.0, 1e-3), rtol=1e-12)
    means = [light(angle, 1e-3).mean() for angle in (30.0, 50.0, 75.0)]
    assert (np.diff(means) < 0.0).all()
    # a source on the side of +x comes in under the angle of the points at +x
    near = light(16.0, 1e-3)
    assert near[2] > near[1] > near[0]
