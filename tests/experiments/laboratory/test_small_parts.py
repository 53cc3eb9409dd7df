"""Parts of the laboratory that whole sessions use without noticing their numbers."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.special import gamma
from scipy.stats import chi2

from experiments.laboratory.distortion_model import DistortionPrediction, camera_projector
from experiments.laboratory.distortion_statistics import camera_terms
from experiments.laboratory.readout.psf_grid import PsfGrid
from experiments.laboratory.single_star.measure import window_strip_e
from experiments.laboratory.single_star.star import SingleStar
from experiments.laboratory.temporal_error import scatter_interval, target_place, temporal_error_arcsec
from optics.light.band import TopHat
from optics.light.spectrum import Blackbody
from render.records import EffectivePsf


@pytest.mark.parametrize(("reference", "count"), [("nominal", 0), ("aligned", 4), ("calibrated", 8)])
def test_what_a_camera_explains_is_kept_whole_and_nothing_else(reference, count):
    """Brown and Conrady's terms, written in real coordinates; a projector has the trace of its dimension."""
    place = np.random.default_rng(1).uniform(-1.0, 1.0, (40, 2))
    projector = camera_projector(place, reference)
    terms = camera_terms(place, reference).reshape(80, count)
    np.testing.assert_allclose(projector @ terms, terms, atol=1e-12)
    assert np.trace(projector) == pytest.approx(count)
    np.testing.assert_allclose(projector @ projector, projector, atol=1e-12)


def test_the_nearest_psf_of_a_grid():
    place = np.array([[10.0, 10.0], [50.0, 10.0], [10.0, 40.0]])
    psf = EffectivePsf(values=np.ones((9, 9)), oversampling=2)
    grid = PsfGrid(psfs=(psf,) * 3, place_px=place)
    assert grid.nearest(np.array([12.0, 31.0, 9.0, 60.0]), np.array([9.0, 10.0, 26.0, 0.0])).tolist() == [0, 1, 2, 1]


def test_three_times_the_mean_over_the_stars_and_how_well_it_is_known():
    """Drawn standard deviations of 5 stars in 20 frames: scatter over runs as stated; frames times stars behind it."""
    rng, true = np.random.default_rng(2), np.array([0.02, 0.05])
    drawn = [
        temporal_error_arcsec((true * rng.standard_normal((20, 5, 2))).std(0, ddof=1), 4.0, 20) for _ in range(1000)
    ]
    for axis in range(2):
        values = np.array([one[axis].value for one in drawn])
        assert values.mean() == pytest.approx(12.0 * true[axis] * (1.0 - 1.0 / (4 * 19)), rel=0.01)
        told = np.sqrt(np.mean([one[axis].uncertainty ** 2 for one in drawn]))
        assert told == pytest.approx(values.std(), rel=4.0 / np.sqrt(2000))
        assert drawn[0][axis].n == 100


def test_the_target_stands_in_the_middle_of_the_first_chip(star_camera, bench_of):
    direction = target_place(bench_of(rows=3, columns=3), star_camera)
    tangent = direction[:, :2] / direction[:, 2:] * star_camera.focal_length_mm / star_camera.camera.pixel_pitch_mm
    pixel = tangent + np.array(star_camera.camera.centre_px)
    chip = star_camera.detector
    middle = [(chip.chip_width_px - 1) / 2, (chip.chip_height_px - 1) / 2]
    np.testing.assert_allclose(pixel[4], middle, atol=1e-6)
    elsewhere = target_place(bench_of(rows=3, columns=3), star_camera, (700.0, 300.0))
    tangent = elsewhere[4, :2] / elsewhere[4, 2] * star_camera.focal_length_mm / star_camera.camera.pixel_pitch_mm
    np.testing.assert_allclose(tangent + np.array(star_camera.camera.centre_px), [700.0, 300.0], atol=1e-6)


def test_surveys_average_what_one_chip_does_not_freeze():
    """Var = frozen + (one - frozen) / N, of standard deviations 5 and 3: 9 + 16 / N."""
    given = {
        "mean_px": {},
        "bundle_px": None,
        "position_px": {},
        "point_px": {},
        "marking_px": 0.0,
        "pixel_arcsec": 4.0,
    }
    one, frozen = ({"cog": {"nominal": np.full((3, 2), value)}} for value in (5.0, 3.0))
    prediction = DistortionPrediction(scatter_px=one, frozen_px=frozen, **given)
    for surveys in (1, 4, 16):
        np.testing.assert_allclose(
            prediction.of_surveys_px("cog", "nominal", surveys), np.sqrt(9.0 + 16.0 / surveys), rtol=1e-12
        )


def test_windows_of_a_strip_stand_in_its_middle_a_pixel_apart():
    dn = 100.0 + 0.5 * np.arange(27.0).reshape(1, 3, 3, 3)
    defect = np.zeros((3, 3, 3), bool)
    defect[2, 1, 1] = True
    stack = SimpleNamespace(dn=dn, offset_dn=100.0, gain_dn_per_e=0.5, defect=defect)
    strip = window_strip_e(stack, np.array([2, 0]), 5)
    assert strip.shape == (6, 12)
    np.testing.assert_array_equal(strip[1:4, 1:4], [[18, 19, 20], [21, np.nan, 23], [24, 25, 26]])
    np.testing.assert_array_equal(strip[1:4, 7:10], np.arange(9).reshape(3, 3))
    assert np.isfinite(strip).sum() == 17


def test_a_star_has_the_colour_of_its_lamp_behind_its_band(star_camera):
    """Planck photons, 500 to 700 nm: B ~ 1 / (x^4 (exp(c2 / x T) - 1)); electrons as asked."""
    star = SingleStar(
        azimuth_deg=0.0,
        elevation_deg=0.0,
        spectrum=Blackbody(temperature_k=4000.0),
        band=TopHat(centre_nm=600.0, width_nm=200.0, edge_nm=1.0),
        signal_e=5000.0,
    )
    seen = star.seen(np.array([[0.0, 0.0, 1.0]]), star_camera)
    wave, rate = seen.wavelength_nm, seen.photon_rate[0]
    mean = (rate * wave).sum() / rate.sum()
    fine = np.linspace(500.0, 700.0, 20001)
    planck = 1.0 / (fine**4 * np.expm1(1.438776877e7 / (fine * 4000.0)))
    assert mean == pytest.approx((planck * fine).sum() / planck.sum(), abs=0.3)
    spread = np.sqrt((planck * (fine - mean) ** 2).sum() / planck.sum())
    assert np.sqrt((rate * (wave - mean) ** 2).sum() / rate.sum()) == pytest.approx(spread, rel=0.02)


def test_intervals_of_standard_deviations_are_those_of_chi_square():
    """Ten frames of one star: nine degrees of freedom (scipy); no interval where the error is not known."""
    c4 = np.sqrt(2.0 / 9.0) * gamma(5.0) / gamma(4.5)
    low, high = scatter_interval(np.array([2.0, 2.0, 2.0]), np.array([np.sqrt(1 / c4**2 - 1), np.inf, 0.0]))
    np.testing.assert_allclose([low[0], high[0]], 2.0 * c4 * np.sqrt(9.0 / chi2.isf([0.025, 0.975], 9)), rtol=1e-6)
    assert np.isnan([*low[1:], *high[1:]]).all()
