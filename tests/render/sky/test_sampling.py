"""Stars of many attitudes at once are those that are looked up attitude by attitude."""

import numpy as np
from fields import star_catalog
from scipy.spatial.transform import Rotation

from render.catalogue.index import build_index
from render.sky.field import field_of, field_of_view
from render.sky.sampling import sample_sky


def test_same_stars_as_one_by_one(bench):
    catalogue = star_catalog(20000)
    index, view = build_index(catalogue), field_of_view(bench.camera_of("star_tracker_26mm"), margin_px=0.0)
    attitudes = Rotation.random(20, rng=np.random.default_rng(1))
    sample = sample_sky(index, view, attitudes)
    assert (sample.summed(np.ones(len(sample.row))) > 0).any()
    for number, attitude in enumerate(attitudes):
        one, mine = field_of(index, view, attitude), sample.frame == number
        order = np.argsort(sample.row[mine])
        np.testing.assert_array_equal(sample.row[mine][order], np.sort(one.row))
        np.testing.assert_allclose(sample.pixel_px[mine][order], one.pixel_px[np.argsort(one.row)], atol=1e-8)
