"""Detections laid beside the truth, and the bound of centroids against closed forms."""

import numpy as np
import pytest

from calib.flags import StarFlag
from calib.records import NoiseModel, StarTable
from experiments.dataset.detection import centroid_bound, compare_frame, joined
from experiments.dataset.truth import FLAGS
from experiments.laboratory.readout.reduction import MeasuredFrame
from render.records import EffectivePsf


def gaussian_psf(sigma, oversampling=4, half=8):
    from scipy.special import erf

    at = np.arange(-half * oversampling, half * oversampling + 1) / oversampling
    line = 0.5 * (erf((at + 0.5) / (np.sqrt(2) * sigma)) - erf((at - 0.5) / (np.sqrt(2) * sigma)))
    return EffectivePsf(values=np.outer(line, line), oversampling=oversampling)


def table(x, y, flags=None):
    n = len(x)
    return StarTable(
        x_px=np.array(x, float),
        y_px=np.array(y, float),
        flux_e=np.full(n, 1000.0),
        background_e=np.zeros(n),
        covariance=np.tile(np.eye(3) * 1e-2, (n, 1, 1)),
        chi2=np.full(n, np.nan),
        iterations=np.zeros(n, np.int64),
        flags=np.zeros(n, np.uint32) if flags is None else np.array(flags, np.uint32),
    )


def measured(x, y, flags=None):
    stars = table(x, y, flags)
    return MeasuredFrame(stars=stars, fit=stars.flags == 0, detected_px=np.column_stack([x, y]).astype(float))


def truth(x, y, flags=0):
    n = len(x)
    return {
        "photon_x_px": np.array(x, float),
        "photon_y_px": np.array(y, float),
        "magnitude": np.linspace(3, 8, n),
        "snr": np.full(n, 20.0),
        "electrons": np.full(n, 1e3),
        "smear_x_px": np.zeros(n),
        "smear_y_px": np.zeros(n),
        "flags": np.broadcast_to(np.int32(flags), n).copy(),
    }


def test_bound_of_a_wide_gaussian_is_its_width_over_the_root_of_its_electrons():
    """No noise but photons, sigma 1.5 px: sqrt(sigma^2 + 1/12) / sqrt(N), the same at every phase."""
    bound = centroid_bound(
        [gaussian_psf(1.5)],
        np.zeros(1),
        noise=NoiseModel(read_noise_e=1e-3, gain_dn_per_e=1.0, offset_dn=0.0),
        background_e=0.0,
        window_px=15,
        electrons=(1e3, 1e5),
    )
    rng = np.random.default_rng(3)
    sigma = bound.at(np.full(50, 4e4), rng.uniform(0, 100, (50, 2)), np.full(50, 7.0))
    np.testing.assert_allclose(sigma, np.sqrt(1.5**2 + 1 / 12) / 200, rtol=0.01)


def test_bound_in_background_grows_as_the_background_over_the_flux():
    """Read noise s, sigma w: sqrt(8 pi) w^2 s / N for faint stars (Winick 1986, J. Opt. Soc. Am. A 3, 1809)."""
    width, noise = 1.5, 30.0
    bound = centroid_bound(
        [gaussian_psf(width)],
        np.zeros(1),
        noise=NoiseModel(read_noise_e=noise, gain_dn_per_e=1.0, offset_dn=0.0),
        background_e=0.0,
        window_px=15,
        electrons=(100.0, 200.0),
    )
    sigma = bound.at(np.array([100.0]), np.array([[7.3, 9.1]]), np.zeros(1))
    np.testing.assert_allclose(sigma, np.sqrt(8 * np.pi) * (width**2 + 1 / 12) * noise / 100.0, rtol=0.03)


def test_stars_and_detections_are_paired_one_to_one():
    stars = truth([10.0, 30.0, 50.0, 51.5], [10.0, 30.0, 50.0, 50.0])
    found = measured(
        [10.4, 50.3, 80.0, 20.0], [9.8, 50.1, 80.0, 60.0], [0, int(StarFlag.BLEND), 0, int(StarFlag.SPIKE)]
    )
    one = compare_frame(7, found, stars, width_px=101, height_px=101)
    assert one.matched.tolist() == [True, False, True, False]
    assert one.fit.tolist() == [True, False, False, False]
    assert one.blend_seen.tolist() == [False, False, True, False]
    np.testing.assert_allclose(one.error_px[0], [0.4, -0.2])
    assert np.isnan(one.error_px[1]).all()
    assert one.false.tolist() == [7, 7]
    assert one.false_spike.tolist() == [False, True]
    assert one.radius_px[2] == pytest.approx(0.0)


def test_what_has_no_light_is_no_star_and_an_empty_frame_is_one():
    dark = truth([10.0, 20.0], [10.0, 20.0], flags=FLAGS["no_light"][0])
    one = compare_frame(0, measured([], []), dark, width_px=64, height_px=64)
    assert len(one.magnitude) == 0
    other = compare_frame(1, measured([5.0], [5.0]), truth([], []), width_px=64, height_px=64)
    both = joined([one, other])
    assert both.frames == 2
    assert both.false.tolist() == [1]
