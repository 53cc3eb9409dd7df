"""The instrument as configuration: lens, detector, focus, coatings."""

import math

import numpy as np
import pytest

from optics.lens.perturb import decentre
from optics.rays.entrance_pupil import entrance_pupil
from optics.rays.paraxial import axial_paraxial
from optics.rays.spots import spot_moments
from optics.units import ARCSEC_RAD
from optics.waves.pupil_field import trace_pupil
from optics.waves.wavefront import wavefront
from render.fits.wcs import lens_wcs
from render.sensor_file.instrument import build_instrument, configured_lens, housing_of
from render.sensor_file.tables import InstrumentConfig

INNER_STOP = {"lens": "double_gauss_50mm", "detector": "cmv4000", "absorption": False}


@pytest.fixture(scope="module")
def star_camera():
    return build_instrument(InstrumentConfig())


TRIPLET = {"lens": "docs/examples/triplet_50mm/lens.toml", "detector": "cmv4000", "width_px": 1200, "height_px": 1200}


def test_default_is_the_camera_of_the_publication(star_camera):
    camera = star_camera.camera
    assert (camera.width_px, camera.height_px) == (4096, 2048)
    assert star_camera.focal_length_mm == pytest.approx(206.2, abs=0.1)  # printed with the lens
    assert star_camera.pixel_arcsec == pytest.approx(5.5, abs=0.01)  # ACC18: 5.5 arcsec per pixel
    assert star_camera.pixel_arcsec == pytest.approx(206264.806 * 5.5e-3 / star_camera.focal_length_mm, rel=1e-7)


def test_the_angle_of_a_pixel_is_that_between_traced_bundles_and_that_of_the_world_coordinates():
    """A triplet 0.43 % off its paraxial scale; 5e-5: lateral colour of the wavelength of the world coordinates."""
    sensor = build_instrument(InstrumentConfig(**TRIPLET))
    camera, ends = sensor.camera, np.array([-0.01, 0.01])
    bundles = spot_moments(camera.focused_lens, ends, 0.0 * ends, camera.lens.design_wavelength_nm)
    distance_px = float(np.ptp(bundles.x_mm)) / camera.pixel_pitch_mm
    assert sensor.pixel_arcsec * distance_px == pytest.approx(3600.0 * 0.02, rel=1e-3)  # focus is a part of coma
    scale = np.sqrt(abs(np.linalg.det(lens_wcs(camera, wavelength_nm=650.0).linear)))
    assert sensor.pixel_arcsec * ARCSEC_RAD == pytest.approx(scale, rel=5e-5)
    paraxial_mm = axial_paraxial(camera.lens, camera.lens.design_wavelength_nm).efl_mm
    assert abs(sensor.focal_length_mm / paraxial_mm - 1.0) > 3e-3


def test_coatings_let_more_light_through():
    wavelength = np.array([450.0, 550.0, 700.0, 900.0])
    coated = build_instrument(InstrumentConfig()).camera.response_at(wavelength)
    bare = build_instrument(InstrumentConfig(coating_nm=0.0)).camera.response_at(wavelength)
    assert np.all(coated > bare)
    assert np.argmax(coated / bare) == 1  # most at the coatings' design wavelength of 550 nm
    assert np.all((bare > 0) & (coated < 1))


def test_perturbed_copy_keeps_the_nominal_focal_length(star_camera):
    lens = star_camera.camera.lens
    moved = build_instrument(InstrumentConfig(), decentre(lens, "L2", 0.1))
    assert moved.focal_length_mm == star_camera.focal_length_mm
    at = lens.indices_of("L2")[0]
    assert moved.camera.lens.surfaces[at].position_mm - lens.surfaces[at].position_mm == pytest.approx([0.1, 0, 0])


def test_stopped_down_the_pupil_of_real_rays_shrinks_with_the_square_of_the_f_number():
    wide, narrow = (
        entrance_pupil(build_instrument(InstrumentConfig(**INNER_STOP, f_number=f)).camera.lens, max_field_deg=1.0)
        for f in (4.0, 8.0)
    )
    assert wide.area_mm2 / narrow.area_mm2 == pytest.approx(4.0, rel=0.03)  # each radius is found to 1 %


def test_lens_is_focused_at_its_own_temperature_and_warmed_with_its_housing():
    def chip_behind_the_lens_mm(**settings):
        lens = build_instrument(InstrumentConfig(**INNER_STOP, **settings)).camera.lens
        return float(lens.image_position_mm[2] - lens.surfaces[-1].position_mm[2])

    cold = chip_behind_the_lens_mm()
    for housing, ppm in (("aluminium_6061", 23.6), ("invar_36", 1.3), (100, 100.0)):
        warm = chip_behind_the_lens_mm(lens_temperature_c=60.0, housing=housing)
        assert (warm - cold) / cold == pytest.approx(ppm * 1e-6 * 40.0, rel=0.003), (
            housing
        )  # prescriptions hold at 20 C


def test_housing_of_a_sensor_file_reaches_the_lens():
    """Spacers and rims stated: the chip moves by the rule of spacers; a material alone is the barrel's."""
    table = {
        "material": "titanium_ti6al4v",
        "spacers": {"detector": 100.0},
        "rims_mm": {"L1": (30.0, 0.0)},
        "diameter_mm": 90.0,
    }
    config = InstrumentConfig.model_validate({"lens_temperature_c": 60.0, "housing": table})
    housing = housing_of(config.housing)
    assert (housing.expansion_per_k, housing.diameter_mm) == (pytest.approx(8.6e-6), 90.0)
    assert housing.spacers_per_k == {"detector": pytest.approx(1e-4)}
    gap = [
        float(lens.image_position_mm[2] - lens.surfaces[-1].position_mm[2])
        for lens in (configured_lens(config), configured_lens(InstrumentConfig()))
    ]
    assert gap[0] == pytest.approx(gap[1] * math.exp(1e-4 * 40.0), rel=1e-12)
    assert InstrumentConfig.model_validate({"housing": "invar_36"}).housing.material == "invar_36"
    assert hash(config.housing) != hash(InstrumentConfig().housing)


# --- A measured wavefront


def rms_nm(**settings):
    lens = configured_lens(InstrumentConfig(defocus_mm=0.0, **settings))
    found = wavefront(trace_pupil(lens, [0.0], [0.0], [lens.design_wavelength_nm], order=(12, 32)))
    return found.zernike_nm(11)[5]


def test_coefficients_and_a_map_of_them(tmp_path):
    """Sixth of Noll's polynomials: sqrt(6) (x^2 - y^2)."""
    x, y = np.meshgrid(np.linspace(-1, 1, 33), np.linspace(-1, 1, 33))
    np.save(tmp_path / "map.npy", 50.0 * np.sqrt(6.0) * (x**2 - y**2))
    nominal = rms_nm()
    assert rms_nm(wavefront_zernike_nm=(0, 0, 0, 0, 0, 50.0)) - nominal == pytest.approx(50.0, abs=0.2)
    assert rms_nm(wavefront_map=str(tmp_path / "map.npy")) - nominal == pytest.approx(50.0, abs=0.2)
