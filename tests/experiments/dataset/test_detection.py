"""Detections laid beside the truth, and the bound of centroids against closed forms."""

from types import SimpleNamespace

import numpy as np
import pytest
from measured_frames import measured_frame

from calib.flags import StarFlag
from experiments.dataset.detection import MatchedStars, compare_frame, detection, joined
from experiments.dataset.truth import FLAGS


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


def test_stars_and_detections_are_paired_one_to_one():
    stars = truth([10.0, 30.0, 50.0, 51.5], [10.0, 30.0, 50.0, 50.0])
    flags = [0, int(StarFlag.BLEND), 0, int(StarFlag.SPIKE)]
    found = measured_frame([[10.4, 9.8], [50.3, 50.1], [80.0, 80.0], [20.0, 60.0]], flags=flags)
    one = compare_frame(7, found, stars, width_px=101, height_px=101)
    assert one.matched.tolist() == [True, False, True, False]
    assert one.fit.tolist() == [True, False, False, False]
    assert one.blend_flagged.tolist() == [False, False, True, False]
    np.testing.assert_allclose(one.error_px[0], [0.4, -0.2])
    assert np.isnan(one.error_px[1]).all()
    assert one.false.tolist() == [7, 7]
    assert one.false_spike.tolist() == [False, True]
    assert one.radius_px[2] == pytest.approx(0.0)


def test_what_has_no_light_is_no_star_and_an_empty_frame_is_one():
    dark = truth([10.0, 20.0], [10.0, 20.0], flags=FLAGS["no_light"][0])
    one = compare_frame(0, measured_frame([]), dark, width_px=64, height_px=64)
    assert len(one.magnitude) == 0
    other = compare_frame(1, measured_frame([[5.0, 5.0]]), truth([], []), width_px=64, height_px=64)
    both = joined([one, other])
    assert both.frames == 2
    assert both.false.tolist() == [1]


COUNT = 6000


def drawn_stars(rng, *, worse=1.0, frames=100):
    """Stars of 4 to 10 mag; beyond 8 mag they are found half as often with every magnitude."""
    magnitude = rng.uniform(4.0, 10.0, COUNT)
    snr = 1e3 * 10 ** (-0.4 * (magnitude - 4.0))
    found = rng.random(COUNT) < np.minimum(1.0, 2.0 ** (8.0 - magnitude))
    flags = np.zeros(COUNT, np.int32)
    flags[:300] = FLAGS["blended"][0]
    flags[300:310] = FLAGS["off_edge"][0]
    return MatchedStars(
        magnitude=magnitude,
        snr=snr,
        electrons=np.full(COUNT, 1e3),
        flags=flags,
        matched=found,
        fit=found & (np.arange(COUNT) % 10 > 0),
        blend_flagged=found & (np.arange(COUNT) < 150),
        error_px=worse * 0.01 * rng.standard_normal((COUNT, 2)) + [0.5, -0.5],
        smear_px=np.zeros(COUNT),
        position_px=rng.uniform(0.0, 1000.0, (COUNT, 2)),
        radius_px=np.full(COUNT, 10.0),
        false=rng.integers(0, frames, 260),
        false_spike=np.arange(260) < 60,
        frames=frames,
    )


BOUND = SimpleNamespace(at=lambda electrons, place, radius: np.full((len(electrons), 2), 0.01))


def told(stars, **changes):
    given = {"empty_frames": 50, "empty_detections": 90, "wcs_misses": np.array([0.01, 0.3]), "cosmic_rays": False}
    return detection(stars, BOUND, example=None, **(given | changes))


def test_shares_of_drawn_stars():
    found = told(drawn_stars(np.random.default_rng(1)))
    one = found["detection"]
    # ten times the noise is 9 mag: four magnitudes for certain, of the fifth 1 / (2 log 2)
    assert one.bright_share == pytest.approx((4.0 + 0.5 / np.log(2.0)) / 5.0, abs=4.0 * np.sqrt(0.053 / 5000))
    assert one.magnitude_of_half == pytest.approx(9.0, abs=0.15)
    assert (one.false_all, one.false_not_flagged, one.false_in_empty_frames) == (2.6, 2.0, 1.8)
    assert one.false_excess == pytest.approx(0.2 / np.sqrt(201 / 1e4 + 91 / 2500))
    assert told(drawn_stars(np.random.default_rng(1)), cosmic_rays=True)["detection"].false_excess is None
    assert (one.wcs_max_error_px, one.wcs_judged_px) == (0.3, 0.3)
    for share in found["magnitudes"]:
        low = float(share.bin.split()[0])
        expected = 1.0 if low < 8 else 2.0 ** (8.0 - low) / (2.0 * np.log(2.0))  # mean of 2^-x over a magnitude
        assert share.share_found.value == pytest.approx(expected, abs=4.0 * 0.5 / np.sqrt(share.stars))
        assert share.low <= share.share_found.value <= share.high
        # a Wilson interval of one standard deviation
        p, n = share.share_found.value, share.stars
        assert share.high - share.low == pytest.approx(2.0 * np.sqrt(p * (1 - p) / n), abs=2.0 / n)
    assert sum(share.stars for share in found["magnitudes"]) == COUNT - 10
    by_name = {group.flag: group for group in found["flags"]}
    assert set(by_name) == {"blended", "off_edge", "none"}
    assert (by_name["blended"].stars, by_name["none"].stars) == (300, COUNT - 310)
    assert by_name["blended"].share_blend == pytest.approx(0.5, abs=0.12)
    assert by_name["none"].share_fit == pytest.approx(0.9 * by_name["none"].share_found, abs=0.02)


@pytest.mark.parametrize("worse", [1.0, 1.3])
def test_errors_of_drawn_centroids_over_their_bound(worse):
    """A median absolute deviation tells the scatter to 1.17 / sqrt(2 n); a common offset is none."""
    found = told(drawn_stars(np.random.default_rng(2), worse=worse))
    for bin_ in found["centroids"]:
        error = bin_.error_px
        assert error.uncertainty == pytest.approx(error.value * np.sqrt(1.3604 / (2 * bin_.stars)))
        assert abs(error.value - 0.01 * worse) < 4.0 * error.uncertainty
        assert (bin_.bound_px, bin_.ratio) == (0.01, pytest.approx(error.value / 0.01))
    one = found["detection"]
    assert one.bound_ratio.value == pytest.approx(worse, abs=4.0 * worse * one.bound_ratio.uncertainty)
    assert bool(one.bound_ratio.value < one.bound_limit) is (worse == 1.0)
    assert one.bound_ratio.n <= sum(bin_.stars for bin_ in found["centroids"])
