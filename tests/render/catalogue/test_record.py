"""The catalogue record: what it keeps, what it refuses."""

import numpy as np
from fields import star_catalog

from render.catalogue.record import direction_from_angles


def test_axes_of_icrs():
    angles = np.radians([[0.0, 0.0], [90.0, 0.0], [0.0, 90.0], [180.0, 0.0], [270.0, 0.0]])
    vectors = direction_from_angles(*angles.T)
    np.testing.assert_allclose(vectors, [[1, 0, 0], [0, 1, 0], [0, 0, 1], [-1, 0, 0], [0, -1, 0]], atol=1e-15)


def test_angles_come_back():
    rng = np.random.default_rng(1)
    ra, dec = rng.uniform(0, 2 * np.pi, 1000), rng.uniform(-np.pi / 2, np.pi / 2, 1000)
    dec[:2] = np.pi / 2 - 1e-9, -np.pi / 2 + 1e-9
    catalog = star_catalog(1000, direction=direction_from_angles(ra, dec))
    np.testing.assert_allclose(catalog.dec_rad, dec, atol=1e-15)
    np.testing.assert_allclose(catalog.ra_rad * np.cos(dec), ra * np.cos(dec), atol=1e-14)


def test_what_is_left_out_is_not_known():
    catalog = star_catalog()
    assert np.isnan(catalog.parallax_rad).all()
    assert catalog.proper_motion_rad_per_year.shape == (5, 2)
    assert np.isnan(catalog.proper_motion_rad_per_year).all()
    assert np.isfinite(catalog.magnitude).all()


def test_select_keeps_rows_together():
    catalog = star_catalog(b_v_mag=np.arange(5.0))
    chosen = catalog.select([3, 1])
    assert chosen.id.tolist() == [3, 1]
    assert chosen.b_v_mag.tolist() == [3.0, 1.0]
    assert catalog.select(catalog.b_v_mag > 2).id.tolist() == [3, 4]
    assert len(catalog.select([])) == 0
    assert len(catalog.select(np.zeros(5, bool))) == 0
    assert catalog.row_of(2) == 2
