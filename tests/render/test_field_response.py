"""Stars through a sensor over its field: light, colour and trails by other sums."""

import numpy as np
import pytest
from scipy.constants import c, h, k

from optics.light.magnitudes import band_photon_rate
from optics.light.spectrum import Blackbody
from optics.rays.spots import trace_spots
from render.field_response import COLD_K, HOT_K, field_response
from render.sensor_file.load import load_star_sensor


def response(lens, window_px=None, defocus_mm=0.0):
    options = {"diffraction": "rays", "absorption": False, "defocus_mm": defocus_mm}
    sensor = load_star_sensor(lens, "cmv4000", window_px=window_px, **options)
    return field_response(sensor, sensor.passband((500.0, 800.0)), magnitude_system="G")


@pytest.fixture(scope="module")
def tracker():
    return response("star_tracker_26mm", 1800)


def test_electrons_by_hand(tracker):
    """Photons of a 6th magnitude star through the band, times throughput at its middle and pupil area.

    The throughput changes by some 10 % about its value at the middle: 6 % is what this sum can promise.
    """
    photons = float(band_photon_rate(Blackbody(temperature_k=5800.0), 6.0, [tracker.band], system="G")[0])
    throughput = float(tracker.sensor.camera.response_at(np.linspace(500.0, 800.0, 61)).mean())
    area = np.pi / 4.0 * (tracker.performance.focal_length_mm / tracker.performance.f_number) ** 2
    electrons = tracker.electrons_per_s(np.array([6.0]), np.array([5800.0]), np.zeros(1))
    assert electrons[0] == pytest.approx(photons * throughput * area, rel=0.06)


def planck(wavelength_nm, kelvin):
    """Photons, up to a factor."""
    metre = np.asarray(wavelength_nm) * 1e-9
    return metre**-4 / np.expm1(h * c / (metre * k * kelvin))


def test_shift_of_hot_against_cold_stars(tracker):
    """Means of the rays, weighted by black bodies of SciPy's constants."""
    wave, field = tracker.light.wavelength_nm[0], tracker.performance.field_deg
    spots = trace_spots(tracker.sensor.camera.focused_lens, field, np.zeros_like(field), wave, order=(32, 64))
    area = spots.area_mm2.sum(-1)
    x = (spots.area_mm2 * spots.rays.x).sum(-1) / area

    def place(kelvin):
        weight = planck(wave, kelvin) / planck(wave, 5800.0) * tracker.fraction * area
        return (weight * x).sum(1) / weight.sum(1)

    kelvin = tracker.temperatures_k
    cold, hot = (kelvin[np.abs(np.log(kelvin / t)).argmin()] for t in (COLD_K, HOT_K))
    moved_px = (place(hot) - place(cold)) / 0.0055
    assert tracker.hot_against_cold_px == pytest.approx(np.abs(moved_px).max(), rel=0.05)
    read = [tracker.colour_shift_px(np.full(5, t), tracker.radius_px) for t in (hot, cold)]
    np.testing.assert_allclose(
        read[0] - read[1], tracker.colour_px[kelvin == hot][0] - tracker.colour_px[kelvin == cold][0]
    )


def test_width_of_a_trail_by_hand(tracker):
    """A uniform trail of length L adds L²/12 along it: L²/24 to the mean of both axes."""
    moved = tracker.moving(np.array([3.0, 4.0]))
    assert (moved.fwhm_px**2 - tracker.fwhm_px**2) / 2.3548**2 == pytest.approx(25.0 / 24.0, rel=1e-4)


def test_the_field_of_view_is_that_of_a_pinhole_for_a_lens_that_hardly_distorts(tracker):
    half = 900.0 * 0.0055 / tracker.sensor.focal_length_mm * np.array([1.0, np.sqrt(2.0)])
    expected = 2.0 * np.degrees(np.arctan(half))
    assert tracker.field_of_view_deg == pytest.approx((expected[0], expected[0], expected[1]), rel=5e-3)


@pytest.mark.slow
def test_electrons_of_a_lens_that_vignettes_follow_the_traced_beams():
    """double_gauss_50mm loses 43 % of a beam at the corner, from a kink near the axis on; five fields were 3 % off."""
    state = response("double_gauss_50mm")
    camera, wave = state.sensor.camera, state.light.wavelength_nm[0]
    radius_px = np.linspace(0.0, state.radius_px[-1], 38)
    field_deg = np.degrees(np.arctan(radius_px * camera.pixel_pitch_mm / state.sensor.focal_length_mm))
    area = trace_spots(camera.focused_lens, field_deg, 0.0 * field_deg, wave, order=(20, 40)).area_mm2.sum(-1)
    traced = (area * np.cos(np.radians(field_deg))[:, None]) @ state.fraction
    electrons = state.electrons_per_s(np.zeros(38), np.full(38, 5800.0), radius_px)
    ratio = (electrons / electrons[0]) / (traced / traced[0])
    assert ratio == pytest.approx(1.0, abs=3e-3)
    assert np.average(ratio, weights=radius_px) == pytest.approx(1.0, abs=3e-4)
