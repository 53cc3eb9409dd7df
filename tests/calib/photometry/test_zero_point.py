"""Zero points, colour, vignetting and extinction of drawn stars, against the numbers they were drawn with."""

from __future__ import annotations

import numpy as np
import pytest

from calib.photometry.zero_point import COLOUR_KNOTS, fit_photometry, noiseless_zero_point, scatter_at

TERMS = [0.1, 0.08, 0.05, 0.0, -0.07, -0.15, -0.4]
AIRMASS = np.array([1.1, 1.15, 1.2, 1.5, 1.55, 1.6])


def stars(seed, count=900, scatter=0.06):
    """Zero point 15.2 above the atmosphere, extinction 0.3, vignetting 0.4 u^2 + 0.08 u^4."""
    rng = np.random.default_rng(seed)
    magnitude, colour = rng.uniform(4.0, 7.5, count), rng.uniform(0.45, 1.85, count)
    u2, frame = rng.uniform(0.0, 1.0, count), rng.integers(0, 6, count)
    term = np.interp(colour, COLOUR_KNOTS, TERMS)
    brightness = 15.2 - 0.3 * AIRMASS[frame] + term - 0.4 * u2 - 0.08 * u2**2
    flux = 10.0 ** (-0.4 * (magnitude - brightness + scatter * rng.standard_normal(count)))
    return {"magnitude": magnitude, "colour": colour, "u2": u2, "frame": frame, "flux_e": flux}


def fitted(seed, airmass=AIRMASS, **options):
    drawn = stars(seed, **options)
    return fit_photometry(**drawn, frames=6, flux_error_e=0.01 * drawn["flux_e"], airmass=airmass)


def test_light_gives_zero_points_colour_vignetting_and_with_airmass_extinction():
    fit = fitted(7)
    np.testing.assert_allclose(fit.scatter_mag, 0.06, rtol=0.25)
    np.testing.assert_allclose(fit.colour_mag, TERMS, atol=0.05)
    np.testing.assert_allclose(fit.zero_point_mag, 15.2 - 0.3 * AIRMASS, atol=4.0 * fit.zero_point_error_mag.max())
    fit = fitted(7, airmass=None)
    assert np.isnan(fit.extinction_mag)
    assert fit.above_mag == pytest.approx(fit.zero_point_mag.mean())


def test_pulls_of_forty_nights():
    """Root mean square of 40 pulls of a right standard deviation: 1 within 4 / sqrt(80)."""
    fits = [fitted(seed, count=300) for seed in range(40)]
    pulls = np.array(
        [
            [
                (fit.extinction_mag - 0.3) / fit.extinction_error_mag,
                (fit.vignetting_at(1.0) - 0.48) / fit.vignetting_error_at(1.0),
                (fit.above_mag - 15.2) / fit.above_error_mag,
            ]
            for fit in fits
        ]
    )
    rms = np.sqrt((pulls**2).mean(axis=0))
    np.testing.assert_allclose(rms[:2], 1.0, atol=4.0 / np.sqrt(80.0))
    assert 0.4 < rms[2] < 1.0 + 4.0 / np.sqrt(80.0)  # the larger of two errors is stated


def test_noiseless_zero_points_and_scatter_by_airmass():
    drawn = stars(3, scatter=0.0)
    drawn["flux_e"] = 10.0 ** (-0.4 * (drawn["magnitude"] - 14.0 - 0.1 * (drawn["colour"] - 1.0) + 0.5 * drawn["u2"]))
    del drawn["frame"]
    assert noiseless_zero_point(**drawn) == pytest.approx((14.0, 0.5))
    mass = np.array([1.0, 1.2, 1.4, 1.6])
    assert scatter_at(mass, 0.05 * mass, 2.0) == pytest.approx(0.1)
    assert scatter_at(mass[:3], 0.05 * mass[:3], 2.0) == pytest.approx(0.06)
    assert scatter_at(np.full(4, np.nan), 0.05 * mass, np.nan) == pytest.approx(0.065)
