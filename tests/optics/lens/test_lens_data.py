"""The built-in lenses against the figures printed with them, and the prescription reader against bad files."""

from dataclasses import replace

import numpy as np
import pytest
from lens_texts import MINIMAL, loaded

from optics import Environment, EvenAsphere, field_direction, list_lenses, load_lens, paraxial, spot_moments
from optics.lens.system import AMBIENT
from optics.rays import chief_ray, distortion, lateral_colour, pupil_sampling, trace
from optics.rays.entrance_pupil import entrance_pupil, star_rays

PIXEL_MM = 5.5e-3
STAR_CAMERA = "star_camera_206mm"


def printed_sampling() -> pupil_sampling.PupilSamples:
    """Rings at r = 0, 1/23, ..., 1 weighted by r: the coarse rule that the printed lateral colours follow.
    It gives the rim more than its share; the converged integral differs by up to 0.005 px (next test)."""
    r, phi = np.arange(1, 24) / 23.0, 2.0 * np.pi * np.arange(24) / 24
    weight = np.repeat(r, 24)
    return pupil_sampling.PupilSamples(
        x=np.outer(r, np.cos(phi)).ravel(), y=np.outer(r, np.sin(phi)).ravel(), weight=weight / weight.sum()
    )


@pytest.mark.parametrize(("wavelength", "printed"), [(500.0, 206.230), (600.0, 206.237), (800.0, 206.286)])
def test_star_camera_focal_length_in_the_image_plane_and_f_number(wavelength, printed):
    assert distortion.plate_scale_mm(load_lens(STAR_CAMERA), wavelength) == pytest.approx(printed, abs=0.0006)
    assert paraxial(load_lens(STAR_CAMERA)).f_number == pytest.approx(2.95, abs=0.005)


PRINTED_COLOUR = {
    500.0: [0.008, 0.038, 0.075, 0.143],
    700.0: [0.076, 0.125, 0.144, 0.151],
    800.0: [0.163, 0.277, 0.328, 0.361],
}


@pytest.mark.parametrize("wavelength", PRINTED_COLOUR)
def test_star_camera_lateral_colour_of_the_bundle_mean(wavelength):
    lens, field = load_lens(STAR_CAMERA), [1.2, 2.2, 2.8, 3.5]
    zero = np.zeros(4)
    spots = spot_moments(lens, field, zero, [wavelength, 600.0], samples=printed_sampling())
    np.testing.assert_allclose(
        (spots.x_mm[:, 0] - spots.x_mm[:, 1]) / PIXEL_MM, PRINTED_COLOUR[wavelength], atol=5.5e-4
    )
    converged = lateral_colour.lateral_colour(lens, field, zero, wavelength)[0][:, 0] / PIXEL_MM
    np.testing.assert_allclose(converged, PRINTED_COLOUR[wavelength], atol=5e-3)


def test_star_camera_spot_radii():
    """Printed to 0.1 um from an unknown sampling of the pupil; the converged integral is met within 0.25 um."""
    spots = spot_moments(load_lens(STAR_CAMERA), [0.0, 3.5], [0.0, 0.0], [500.0, 600.0, 700.0, 800.0])
    printed = [[0.7, 2.3, 1.5, 6.0], [2.3, 3.2, 1.3, 4.9]]
    np.testing.assert_allclose(1e3 * spots.rms_radius_mm, printed, atol=0.25)


def test_star_camera_distortion():
    """Printed with the design: -0.028 % (-0.64 px) at 3.5 deg; chief rays give half of that, -0.0140 % (-0.32 px).
    batoid and optiland agree with the half (test_reference_trace); the printed figure has a factor 2 of unknown origin.
    """
    lens = load_lens(STAR_CAMERA)
    grid = distortion.distortion_map(lens, count=3)
    assert 100.0 * grid.relative[0, 0] == pytest.approx(-0.0140, abs=5e-5)
    x, _ = chief_ray.chief_ray_points(lens, 3.5, 0.0)
    ideal = distortion.plate_scale_mm(lens) * np.tan(np.radians(3.5))
    assert (float(x) - ideal) / PIXEL_MM == pytest.approx(-0.32, abs=5e-3)
    assert (float(x) - ideal) / PIXEL_MM * 2.0 == pytest.approx(-0.64, abs=5e-3)


@pytest.mark.parametrize(
    ("glass", "n_d", "nu"),
    [
        ("167125-471", 1.67125, 47.1),
        ("169842-301", 1.69842, 30.1),
        ("160266-384", 1.60266, 38.4),
        ("165953-570", 1.65953, 57.0),
        ("171740-481", 1.71740, 48.1),
    ],
)
def test_double_gauss_glasses_have_the_printed_index_and_dispersion(glass, n_d, nu):
    blue, yellow, red = load_lens("double_gauss_50mm").glasses[glass].index([486.1327, 587.5618, 656.2725])
    assert yellow == pytest.approx(n_d, abs=1e-8)
    assert (yellow - 1.0) / (blue - red) == pytest.approx(nu, abs=1e-5)


@pytest.mark.parametrize("name", list_lenses())
def test_every_lens_has_named_elements_a_source_and_apertures(name):
    lens = load_lens(name)
    assert lens.source
    assert len(lens.elements) >= 2
    assert all(np.isfinite(s.semi_diameter_mm) for s in lens.surfaces)
    assert all(s.element for s in lens.surfaces if not s.is_stop)
    assert all(glass.dndt is not None and glass.cte_per_k is not None for glass in lens.glasses.values())


@pytest.mark.parametrize("temperature", [-30.0, 20.0, 55.0])
def test_indices_in_vacuum_are_the_absolute_ones_of_the_glass(temperature):
    lens = load_lens("star_tracker_26mm", environment=Environment(temperature_c=temperature, pressure_hpa=0.0))
    waves = np.array([500.0, 650.0, 850.0])
    for surface, index in zip(lens.surfaces, lens.indices(waves)[1:], strict=True):
        if surface.medium == AMBIENT:
            np.testing.assert_array_equal(index, 1.0)
        else:
            expected = lens.glasses[surface.medium].absolute_index(waves, temperature_c=temperature)
            np.testing.assert_allclose(index, expected, rtol=1e-15)


def test_tilt_decentre_asphere_and_own_glass_from_a_file(tmp_path):
    text = MINIMAL.replace("radius_mm = 50.0\n", "radius_mm = 50.0\nasphere = [1e-6]\ntilt_deg = [1.0, 0.0]\n", 1)
    text = text.replace("N-BK7", "mine") + (
        'decentre_mm = [0.0, 0.5]\n[glass.mine]\nsource = "test"\nB = [1.25]\nC = [0.01]\nrange_nm = [400, 900]\n'
    )
    lens = loaded(tmp_path, text)
    assert isinstance(lens.surfaces[1].shape, EvenAsphere)
    # turned about +x: the surface's axis z leans towards -y
    np.testing.assert_allclose(lens.surfaces[1].rotation[:, 2], [0.0, -np.sin(np.radians(1)), np.cos(np.radians(1))])
    assert lens.surfaces[2].position_mm.tolist() == [0.0, 0.5, 5.0]
    assert lens.wavelength_range_nm == (400.0, 900.0)


def test_star_camera_beam_needs_the_printed_clear_apertures():
    """Printed with the design to 0.1 mm, some rounded up: semi-diameters that the unvignetted 3.5 deg beam needs."""
    lens = load_lens(STAR_CAMERA)
    phi = np.linspace(0.0, 2.0 * np.pi, 721)
    rim = pupil_sampling.PupilSamples(x=np.cos(phi), y=np.sin(phi), weight=np.full(phi.size, 1.0 / phi.size))
    wide = lens.with_surfaces({0: replace(lens.surfaces[0], semi_diameter_mm=35.0 * (1.0 + 1e-9))})
    waves = np.array([500.0, 600.0, 700.0, 850.0])
    rays = star_rays(entrance_pupil(lens), rim, field_direction(np.full(4, 3.5), 0.0), waves)
    points = trace.trace_path(wide, rays)[2:-1]
    needed = np.hypot(points[..., 0], points[..., 1]).max(axis=(1, 2))
    printed = [35.2, 34.9, 33.5, 33.6, 34.4, 33.5, 25.7, 23.7, 21.1, 13.8, 13.4]
    np.testing.assert_allclose(needed, printed, atol=0.1)
