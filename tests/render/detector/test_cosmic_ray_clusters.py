"""Groups of pixels that hold the charge of cosmic rays: every pixel in one, no charge lost."""

import numpy as np
import pytest

from render.detector.cosmic_ray_clusters import charge_clusters
from render.detector.cosmic_rays import cosmic_ray_hits
from render.detector.spec import load_detector
from render.engine.random import Streams


def test_every_struck_pixel_is_in_one_cluster_and_no_charge_is_lost():
    detector = load_detector("cmv4000")
    hits = cosmic_ray_hits(detector, "deep_space_solar_minimum", streams=Streams(3), frame=0, exposure_s=20.0)
    clusters, strong = charge_clusters(hits), hits.charge_e >= 1.0
    assert 50 < len(clusters) <= len(hits)
    assert sum(one.charge_e for one in clusters) == pytest.approx(hits.charge_e[strong].sum(), rel=1e-9)
    pixels = np.concatenate([one.pixels for one in clusters], axis=1)
    assert {*zip(*pixels.tolist(), strict=True)} == {*zip(hits.row[strong], hits.column[strong], strict=True)}
    assert pixels.shape[1] == np.count_nonzero(strong) == np.count_nonzero(hits.hit_mask)
    for one in clusters:
        column, row, columns, rows = one.box_px
        assert (column, row) == (one.pixels[1].min(), one.pixels[0].min())
        assert (columns, rows) == (np.ptp(one.pixels[1]) + 1, np.ptp(one.pixels[0]) + 1)
        assert column <= one.x_px <= column + columns - 1
