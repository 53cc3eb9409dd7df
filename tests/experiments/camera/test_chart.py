"""Chart stars: their positions, and their matches with detections."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.distance import pdist

from calib.measure.reduced_frame import MeasuredFrame
from experiments.camera.frames import MATCH_PX, _jittered_grid


@pytest.mark.parametrize(("width", "height", "count"), [(1024, 1024, 100), (4096, 2048, 300), (200, 150, 400)])
def test_places_are_two_windows_apart_and_from_the_edge(width, height, count):
    window = 13
    position_px = _jittered_grid(width, height, count, window, np.random.default_rng(1))
    assert pdist(position_px, "chebyshev").min() >= 2.0 * window - 1e-9
    assert position_px.min() >= window - 0.5
    assert (position_px.max(0) <= np.array([width, height]) - 0.5 - window).all()
    most = (width // (3 * window)) * (height // (3 * window))
    assert min(count, most) * 0.8 <= len(position_px) <= max(count, 1) * 1.05
    for axis, size in enumerate((width, height)):
        assert np.mean(position_px[:, axis] < size / 2) == pytest.approx(0.5, abs=0.1)


def measured(position_px, sharp=()):
    """Detections of a frame; ``sharp``: rows flagged as too sharp for a star."""
    position_px = np.reshape(np.array(position_px, float), (-1, 2))
    flagged = np.isin(np.arange(len(position_px)), sharp)
    return SimpleNamespace(detected_px=position_px, stars=SimpleNamespace(sharp=flagged))


def test_detections_belong_to_the_nearest_star_once():
    stars = np.array([[10.0, 10.0], [30.0, 10.0], [50.0, 10.0], [np.nan, np.nan], [52.0, 10.0]])
    frame = measured(
        [[30.4, 10.3], [10.0, 10.0 + 0.9 * MATCH_PX], [51.2, 10.0], [90.0, 90.0], [80.0, 80.0]], sharp=(4,)
    )
    partner, false = MeasuredFrame.matched(frame, stars, 13.0, MATCH_PX)
    assert partner.tolist() == [1, 0, -1, -1, 2]  # of two merging stars the nearer one
    assert false == 1  # the other one is flagged
    distant = measured([[10.0, 10.0 + 1.1 * MATCH_PX]])
    assert MeasuredFrame.matched(distant, stars, 13.0, MATCH_PX)[0].max() == -1
    assert MeasuredFrame.matched(distant, stars, 13.0, MATCH_PX)[1] == (1 if 1.1 * MATCH_PX > 13.0 else 0)
    assert MeasuredFrame.matched(measured([]), stars, 13.0, MATCH_PX)[1] == 0
    assert MeasuredFrame.matched(frame, np.full((2, 2), np.nan), 13.0, MATCH_PX)[1] == 4
