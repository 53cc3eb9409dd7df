"""Parts of the laboratory that whole sessions use without noticing their numbers."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import norm

from experiments.laboratory.bench.centroid_methods import has_matched_epsf
from experiments.laboratory.bench.point_bench import motion_method
from experiments.laboratory.bench.readout.search import SEARCH_PX, find_star
from experiments.laboratory.single_star.star import SingleStar
from experiments.laboratory.temporal_error import star_target_directions
from optics.errors import DomainError
from optics.light.band import TopHat
from optics.light.spectrum import Blackbody


def test_the_target_stands_in_the_middle_of_the_first_chip(star_camera, bench_of):
    direction = star_target_directions(bench_of(rows=3, columns=3), star_camera)
    tangent = direction[:, :2] / direction[:, 2:] * star_camera.focal_length_mm / star_camera.camera.pixel_pitch_mm
    pixel = tangent + np.array(star_camera.camera.centre_px)
    chip = star_camera.detector
    middle = [(chip.chip_width_px - 1) / 2, (chip.chip_height_px - 1) / 2]
    np.testing.assert_allclose(pixel[4], middle, atol=1e-6)
    elsewhere = star_target_directions(bench_of(rows=3, columns=3), star_camera, (700.0, 300.0))
    tangent = elsewhere[4, :2] / elsewhere[4, 2] * star_camera.focal_length_mm / star_camera.camera.pixel_pitch_mm
    np.testing.assert_allclose(tangent + np.array(star_camera.camera.centre_px), [700.0, 300.0], atol=1e-6)


def test_a_star_has_the_colour_of_its_lamp_behind_its_band(star_camera):
    """Planck photons, 500 to 700 nm: B ~ 1 / (x^4 (exp(c2 / x T) - 1)); electrons as asked."""
    star = SingleStar(
        azimuth_deg=0.0,
        elevation_deg=0.0,
        spectrum=Blackbody(temperature_k=4000.0),
        band=TopHat(centre_nm=600.0, width_nm=200.0, edge_nm=1.0),
        signal_e=5000.0,
    )
    seen = star.field(np.array([[0.0, 0.0, 1.0]]), star_camera)
    wave, rate = seen.wavelength_nm, seen.photon_rate[0]
    mean = (rate * wave).sum() / rate.sum()
    fine = np.linspace(500.0, 700.0, 20001)
    planck = 1.0 / (fine**4 * np.expm1(1.438776877e7 / (fine * 4000.0)))
    assert mean == pytest.approx((planck * fine).sum() / planck.sum(), abs=0.3)
    spread = np.sqrt((planck * (fine - mean) ** 2).sum() / planck.sum())
    assert np.sqrt((rate * (wave - mean) ** 2).sum() / rate.sum()) == pytest.approx(spread, rel=0.02)


def test_only_the_own_reference_psf_is_a_place_s_own():
    assert [has_matched_epsf(one) for one in ("epsf", "epsf_reference", "epsf_measured", "cog")] == [True] + 3 * [False]
    assert (motion_method(["cog", "epsf"]), motion_method(["gaussian", "cog"])) == ("epsf", "gaussian")


def spot(x, y, sigma, height, width):
    """Light 1 of a Gaussian image at a place, integrated over pixels."""
    row, column = (np.diff(norm.cdf(np.arange(n + 1) - 0.5, at, sigma)) for at, n in ((y, height), (x, width)))
    return row[:, None] * column


class Windows:
    """A reader without noise: offset 100, 0.5 DN/e-, and a pixel that glows."""

    def expose(self, light, corner, *, frames, label):
        dn = 100.0 + 0.5 * np.broadcast_to(light, (frames, *np.shape(light)))
        dn = dn + 4000.0 * (np.indices((SEARCH_PX, SEARCH_PX)).sum(0) == 3)
        off = np.zeros(np.shape(light), bool)
        return SimpleNamespace(dn=dn, gain_dn_per_e=0.5, defect=off, saturated=np.broadcast_to(off, dn.shape))


def test_a_star_is_found_off_the_middle_and_at_the_corners():
    """Less the dark frame, whose glow is far above the star; a window beyond the edge is moved inside."""
    rng, place = np.random.default_rng(1), np.array([[61.3, 22.8], [2.2, 3.1], [77.4, 66.9]])
    for one in place:
        light = 5000.0 * spot(one[0], one[1], 1.2, 70, 80) + rng.normal(0.0, 2.0, (70, 80))
        found = find_star(Windows(), light, one[None] + [[9.0, -7.0]])
        np.testing.assert_allclose(found[0], one, atol=0.1)
    with pytest.raises(DomainError, match="not detected within 24 px of column 40"):
        find_star(Windows(), rng.normal(0.0, 60.0, (70, 80)), np.array([[40.0, 30.0]]))
    with pytest.raises(DomainError, match="smaller than the search window"):
        find_star(Windows(), np.zeros((40, 80)), np.array([[20.0, 20.0]]))
