"""Stars of reduced frames and windows, points of a target: found where they were drawn."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from star_images import NOISE, frame_of, gaussian_stars, star_field

from calib.measure import reduced_frame
from calib.measure.reduced_frame import FrameReduction, measure_frame
from calib.measure.reduced_windows import dark_subtracted, ring_subtracted
from calib.measure.targets.target_points import common_shift, match_points, search_radius_px


def stack_of(dn, defect=None):
    """Windows (f, n, h, w) whose first pixel is (30, 40), 0.5 DN/e-, offset 100 DN."""
    none = np.zeros(dn.shape, bool)
    noise = {"offset_dn": 100.0, "gain_dn_per_e": 0.5, "read_noise_e": 5.0}
    corner = np.array([[30, 40]])
    return SimpleNamespace(
        dn=dn, defect=none[0] if defect is None else defect, saturated=none, corner_px=corner, **noise
    )


def test_centroids_of_windows_start_near_the_light_whatever_glows_elsewhere():
    """Gravity over the 7 x 7 px around the detection; the upper edge of the window and the defect do not count."""
    light = 3000.0 * gaussian_stars([7.3], [6.8], 0.7, 15, 15)
    dn, defect = 100.0 + 0.5 * light[None], np.zeros((1, 15, 15), bool)
    dn[0, 0, 1, 7], dn[0, 0, 6, 5], defect[0, 6, 5] = 900.0, 4000.0, True
    stamps, _ = ring_subtracted(stack_of(dn, defect), np.array([[37.0, 47.0]]))
    np.testing.assert_allclose(stamps.start_px, [[37.3, 46.8]], atol=0.02)


def test_dark_and_response_are_removed_from_windows():
    """Two frames of a star on a dark pattern of 20 to 60 e-, through a response of 0.9 to 1.1; no noise."""
    rng = np.random.default_rng(3)
    light = 3000.0 * gaussian_stars([7.3], [6.8], 0.7, 15, 15)
    dark, response = rng.uniform(220.0, 260.0, light.shape), rng.uniform(0.9, 1.1, light.shape)
    dn = np.repeat(0.5 * (light * response + dark)[None], 2, axis=0)
    stamps, noise = dark_subtracted(stack_of(dn), dark, response=response)
    np.testing.assert_allclose(stamps.electrons, np.repeat(light, 2, axis=0), atol=1e-9)
    np.testing.assert_allclose(stamps.start_px, [[37.3, 46.8]] * 2, atol=1e-3)
    assert (noise.gain_dn_per_e, noise.offset_dn, noise.quantised) == (0.5, 100.0, True)


@pytest.mark.parametrize("window_px", [7, 11])
def test_a_frame_is_measured_in_the_window_that_was_asked_for(window_px, monkeypatch):
    """At rest as asked, trails of 4 px two pixels more at each side."""
    sizes, find = [], reduced_frame.find_stamps
    monkeypatch.setattr(reduced_frame, "find_stamps", lambda *a, **k: sizes.append(k["size_px"]) or find(*a, **k))
    dn = 100.0 + star_field([30.3], [25.8], 1e4, 1.0, (60, 64)) + np.random.default_rng(4).normal(0.0, 5.0, (60, 64))
    reduction = FrameReduction(
        dark_dn=np.full((60, 64), 100.0),
        noise=NOISE,
        centroid="gaussian",
        window_px=window_px,
        threshold_sigma=8.0,
        background_step_px=1,
    )
    frame = frame_of(np.rint(dn), read_noise_e=5.0, gain_dn_per_e=1.0, offset_dn=100.0)
    np.testing.assert_allclose(measure_frame(frame, reduction).stars.pixel_px, [[30.3, 25.8]], atol=0.03)
    measure_frame(frame, reduction, smear_px=4.0)
    assert sizes == [window_px, window_px + 4]


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
