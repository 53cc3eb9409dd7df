"""Stars of many attitudes at once are those that are looked up attitude by attitude."""

import numpy as np
from refusals import refuses
from scipy.spatial.transform import Rotation

from optics.errors import ConfigError
from render.catalogue.index import build_index
from render.catalogue.record import StarCatalog
from render.sky.field import field_of, field_of_view
from render.sky.sampling import sample_sky


def test_same_stars_as_one_by_one(bench):
    rng = np.random.default_rng(1)
    v = rng.normal(size=(20000, 3))
    catalogue = StarCatalog(
        name="random",
        source="made up",
        epoch_year=2016.0,
        magnitude_system="G",
        id=np.arange(len(v)),
        direction=v / np.linalg.norm(v, axis=1)[:, None],
        magnitude=rng.uniform(0, 10, len(v)),
    )
    index, view = build_index(catalogue), field_of_view(bench.camera_of("star_tracker_26mm"), margin_px=0.0)
    attitudes = Rotation.random(20, rng=rng)
    sample = sample_sky(index, view, attitudes)
    assert (sample.summed(np.ones(len(sample.row))) > 0).any()
    for number, attitude in enumerate(attitudes):
        one, mine = field_of(index, view, attitude), sample.frame == number
        order = np.argsort(sample.row[mine])
        np.testing.assert_array_equal(sample.row[mine][order], np.sort(one.row))
        np.testing.assert_allclose(sample.pixel_px[mine][order], one.pixel_px[np.argsort(one.row)], atol=1e-8)
    refuses(ConfigError, "several attitudes", lambda: sample_sky(index, view, attitudes[0]))
