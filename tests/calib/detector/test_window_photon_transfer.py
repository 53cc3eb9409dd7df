"""Photon transfer of windows, and frames with common noise, on drawn frames."""

from __future__ import annotations

import numpy as np
import pytest
from transfer_pulls import assert_unit_pulls, transfer_pulls

from calib.detector.window_photon_transfer import common_noise, window_photon_transfer

GAIN, READ, SIGMA = 0.25, 12.0, 1.1


def windows(rng, *, frames=25, points=9, size=13, dsnu_e=12.0, spread=0.3, flicker=0.05, motion_px=0.03):
    """Spots of 1000 e- in the brightest pixel, read noise and offsets as of the CMV4000, that move and flicker."""
    row, column = np.indices((size, size)) - size // 2
    shape = (frames, points, size, size)
    offset = rng.normal(0.0, dsnu_e, shape[1:])
    read = READ * np.exp(spread * rng.standard_normal(shape[1:]) - spread**2)
    at = rng.normal(0.0, motion_px, (frames, 1, 1, 1, 2))
    spot = np.exp(-((column - at[..., 0]) ** 2 + (row - at[..., 1]) ** 2) / (2 * SIGMA**2))
    light = np.broadcast_to(1000.0 * rng.uniform(1 - flicker, 1 + flicker, (frames, 1, 1, 1)) * spot, shape)
    electrons = rng.poisson(light) + offset + read * rng.standard_normal(shape)
    return np.rint(200.0 + GAIN * electrons).clip(0, 65535).astype(np.uint16)


@pytest.mark.parametrize(
    ("trials", "options"),
    [
        (100, {"points": 2, "size": 11}),
        pytest.param(
            100,
            {"points": 2, "size": 11, "dsnu_e": 0.0, "spread": 0.0, "flicker": 0.0, "motion_px": 0.0},
            marks=pytest.mark.slow,
        ),
        pytest.param(400, {}, marks=pytest.mark.slow),
        pytest.param(400, {"frames": 8}, marks=pytest.mark.slow),
    ],
)
def test_gain_and_read_noise_of_windows_have_the_errors_that_they_state(trials, options):
    """The pixels' scatter alone would give 1.13 to 1.20: the projection correlates the residuals of a window."""
    rng, pulls = np.random.default_rng(2), []
    for _ in range(trials):
        dn = windows(rng, **options)
        found = window_photon_transfer([dn], [np.ones(dn.shape[1:], bool)], offset_dn=200.0)
        pulls.append(transfer_pulls(found, GAIN, READ))
    assert_unit_pulls(pulls)


def test_frames_of_independent_noise_have_none_in_common_and_a_copy_with_noise_has_most():
    rng, usable = np.random.default_rng(2), np.ones((4, 11, 11), bool)
    dn = np.rint(100 + 3 * rng.standard_normal((12, 4, 11, 11)))
    assert (found := common_noise(dn, usable, false_alarm=1e-3)).correlation < found.limit
    dn[7] = np.rint(dn[2] + 1.5 * rng.standard_normal(dn[2].shape))  # correlation 1 / sqrt(1.25)
    found = common_noise(dn, usable, false_alarm=1e-3)
    assert found.frames == (2, 7)
    assert found.correlation == pytest.approx(1 / np.sqrt(1.25), abs=0.1)
    assert common_noise(dn[:3], usable, false_alarm=1e-3) is None


def test_common_noise_alarms_no_more_often_than_stated():
    """66 pairs of twelve frames with 121 pixels: the fraction of 100 that pass the limit of 20 % for all of them."""
    rng, usable = np.random.default_rng(3), np.ones((1, 11, 11), bool)
    found = [common_noise(rng.normal(1e4, 100.0, (12, 1, 11, 11)), usable, false_alarm=0.2) for _ in range(100)]
    passed = np.mean([pair.correlation > pair.limit for pair in found])
    # the limit of a scatter that is measured itself, from 66 pairs, is a little wide
    assert 0.02 < passed < 0.2 + 4.0 * np.sqrt(0.2 * 0.8 / 100)
