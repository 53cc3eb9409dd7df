"""Stars of reduced frames and windows, points of a target: found where they were drawn."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import norm

from calib.measure import reduced_frame
from calib.measure.reduced_frame import FrameReduction, measure_frame
from calib.measure.reduced_windows import ring_subtracted
from calib.measure.targets.target_points import common_shift, match_points, search_radius_px
from calib.records import NoiseModel


def spot(x, y, sigma, height, width):
    """Light 1 of a Gaussian image at a place, integrated over pixels."""
    row, column = (np.diff(norm.cdf(np.arange(n + 1) - 0.5, at, sigma)) for at, n in ((y, height), (x, width)))
    return row[:, None] * column


def test_centroids_of_windows_start_near_the_light_whatever_glows_elsewhere():
    """Gravity over the 7 x 7 px around the detection; the upper edge of the window and the defect do not count."""
    light = 3000.0 * spot(7.3, 6.8, 0.7, 15, 15)
    dn, defect = 100.0 + 0.5 * light[None, None], np.zeros((1, 15, 15), bool)
    dn[0, 0, 1, 7], dn[0, 0, 6, 5], defect[0, 6, 5] = 900.0, 4000.0, True
    stack = SimpleNamespace(
        dn=dn,
        defect=defect,
        saturated=np.zeros(dn.shape, bool),
        corner_px=np.array([[30, 40]]),
        offset_dn=100.0,
        gain_dn_per_e=0.5,
        read_noise_e=5.0,
    )
    stamps, _ = ring_subtracted(stack, np.array([[37.0, 47.0]]))
    np.testing.assert_allclose(stamps.start_px, [[37.3, 46.8]], atol=0.02)


@pytest.mark.parametrize("window_px", [7, 11])
def test_a_frame_is_measured_in_the_window_that_was_asked_for(window_px, monkeypatch):
    """At rest as asked, trails of 4 px two pixels more at each side."""
    seen = []
    real = reduced_frame.find_stamps
    monkeypatch.setattr(reduced_frame, "find_stamps", lambda *a, **k: seen.append(k["size_px"]) or real(*a, **k))
    noise = NoiseModel(read_noise_e=5.0)
    dn = (1e4 * spot(30.3, 25.8, 1.0, 60, 64) + np.random.default_rng(4).normal(0.0, 5.0, (60, 64))) + 100.0
    made = FrameReduction(
        dark_dn=np.full((60, 64), 100.0),
        noise=noise,
        centroid="gaussian",
        window_px=window_px,
        threshold_sigma=8.0,
        background_step_px=1,
    )
    off = np.zeros(dn.shape, bool)
    told = {"read_noise_e": 5.0, "gain_dn_per_e": 1.0, "offset_dn": 100.0, "exposure_s": 1.0, "index": 0, "band": ""}
    frame = SimpleNamespace(dn=dn, defect=off, saturated=off, **told)
    found = measure_frame(frame, made).stars
    np.testing.assert_allclose([found.x_px, found.y_px], [[30.3], [25.8]], atol=0.03)
    measure_frame(frame, made, smear_px=4.0)
    assert seen == [window_px, window_px + 4]


def test_common_shift_is_what_most_detections_agree_on():
    rng = np.random.default_rng(1)
    offset = np.concatenate([rng.normal([31.0, -12.0], 0.5, (25, 2)), rng.uniform(-80, 80, (60, 2))])
    assert common_shift(offset) == pytest.approx([31.0, -12.0], abs=0.5)
    assert common_shift(np.full((3, 2), 500.0)) == pytest.approx([0, 0])


def test_points_of_a_displaced_target_are_matched_in_their_order():
    """Shifted by (31, -12) px in any order, with false detections; a radius by the target's size and its pitch."""
    rng, nominal = np.random.default_rng(2), 40.0 * np.indices((3, 4)).reshape(2, -1).T + 100.0
    moved = nominal + np.array([31.0, -12.0]) + rng.normal(0.0, 0.3, nominal.shape)
    shown = np.vstack([moved, [[5.0, 5.0], [300.0, 20.0]]])
    words = {"match_px": 4.0, "where": "here", "unseen": "expose longer", "merged": "move apart"}
    np.testing.assert_array_equal(match_points(shown[rng.permutation(len(shown))], nominal, **words), shown[:-2])
    assert search_radius_px(nominal) == 4.0
    assert search_radius_px(4.0 * nominal) == pytest.approx(0.03 * 4.0 * np.hypot(40.0, 60.0))
