"""Stars of the camera's charts: where they are put, and which detection is whose."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.distance import pdist

from calib.measure.reduced_frame import MeasuredFrame
from experiments.camera.frames import MATCH_PX, _scattered


@pytest.mark.parametrize(("width", "height", "count"), [(1024, 1024, 100), (4096, 2048, 300), (200, 150, 400)])
def test_places_are_two_windows_apart_and_from_the_edge(width, height, count):
    window = 13
    place = _scattered(width, height, count, window, np.random.default_rng(1))
    assert pdist(place, "chebyshev").min() >= 2.0 * window - 1e-9
    assert place.min() >= window - 0.5
    assert (place.max(0) <= np.array([width, height]) - 0.5 - window).all()
    most = (width // (3 * window)) * (height // (3 * window))
    assert min(count, most) * 0.8 <= len(place) <= max(count, 1) * 1.05
    # all over the detector: quarters hold a quarter each
    for axis, size in enumerate((width, height)):
        assert np.mean(place[:, axis] < size / 2) == pytest.approx(0.5, abs=0.1)


def found(places, sharp=()):
    """A frame's detections at places; those whose numbers are named are too sharp for a star."""
    places = np.reshape(np.array(places, float), (-1, 2))
    flagged = np.isin(np.arange(len(places)), sharp)
    return SimpleNamespace(detected_px=places, stars=SimpleNamespace(sharp=flagged))


def test_detections_belong_to_the_nearest_star_once():
    stars = np.array([[10.0, 10.0], [30.0, 10.0], [50.0, 10.0], [np.nan, np.nan], [52.0, 10.0]])
    seen = found([[30.4, 10.3], [10.0, 10.0 + 0.9 * MATCH_PX], [51.2, 10.0], [90.0, 90.0], [80.0, 80.0]], sharp=(4,))
    partner, false = MeasuredFrame.matched(seen, stars, 13.0, MATCH_PX)
    assert partner.tolist() == [1, 0, -1, -1, 2]  # of two stars that merge, the nearer has it
    assert false == 1  # the other is too sharp for a star
    far = found([[10.0, 10.0 + 1.1 * MATCH_PX]])
    assert MeasuredFrame.matched(far, stars, 13.0, MATCH_PX)[0].max() == -1
    assert MeasuredFrame.matched(far, stars, 13.0, MATCH_PX)[1] == (1 if 1.1 * MATCH_PX > 13.0 else 0)
    assert MeasuredFrame.matched(found([]), stars, 13.0, MATCH_PX)[1] == 0
    assert MeasuredFrame.matched(seen, np.full((2, 2), np.nan), 13.0, MATCH_PX)[1] == 4
