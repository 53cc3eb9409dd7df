"""Catalogues in the formats of astropy and of CDS: units, missing values, presets, mistakes."""

import numpy as np
import pytest
from astropy import units as u
from astropy.table import MaskedColumn, Table
from catalogue_files import plain_table

from render.catalogue.presets import ColumnPreset, get_preset, preset_names
from render.catalogue.read import catalog_from_table, read_catalog
from render.catalogue.record import MAS_RAD

# The Hipparcos Catalogue, ESA SP-1200: HIP, V, ra, dec [deg, J1991.25], parallax, pm_ra, pm_dec [mas], B-V
HIPPARCOS = [
    (32349, -1.44, 101.28854105, -16.71314306, 379.21, -546.01, -1223.08, 0.009),
    (91262, 0.03, 279.23410832, 38.78299311, 128.93, 201.02, 287.46, -0.001),
    (11767, 1.97, 37.94614689, 89.26413805, 7.56, 44.22, -11.74, 0.636),
    (26311, 1.69, 84.05338572, -1.20191725, 2.43, 1.49, -1.06, -0.184),
]


def hipparcos_table(names=("HIP", "Vmag", "RAICRS", "DEICRS", "Plx", "pmRA", "pmDE", "B-V"), with_units=True):
    table = Table(rows=HIPPARCOS, names=names)
    if with_units:
        units = ("", "mag", "deg", "deg", "mas", "mas / yr", "mas / yr", "mag")
        for name, unit in zip(names, units, strict=True):
            if unit:
                table[name].unit = u.Unit(unit)
    return table


def check_hipparcos(catalog, tolerance=1e-8):
    ids, v, ra, dec, parallax, pm_ra, pm_dec, b_v = (np.array(column) for column in zip(*HIPPARCOS, strict=True))
    assert catalog.id.tolist() == ids.tolist()
    np.testing.assert_allclose(np.degrees(catalog.ra_rad), ra, atol=tolerance)
    np.testing.assert_allclose(np.degrees(catalog.dec_rad), dec, atol=tolerance)
    np.testing.assert_allclose(catalog.magnitude, v, atol=1e-6)
    np.testing.assert_allclose(catalog.b_v_mag, b_v, atol=1e-6)
    np.testing.assert_allclose(catalog.parallax_rad / MAS_RAD, parallax, rtol=1e-6)
    np.testing.assert_allclose(catalog.proper_motion_rad_per_year / MAS_RAD, np.stack([pm_ra, pm_dec], 1), rtol=1e-6)
    assert catalog.epoch_year == 1991.25
    assert catalog.magnitude_system == "V"
    assert np.isnan(catalog.radial_velocity_km_per_s).all()
    assert np.isnan(catalog.bp_rp_mag).all()
    assert catalog.effective_temperature_k[1] == pytest.approx(9700, rel=0.02)  # Vega


@pytest.mark.parametrize(
    ("suffix", "form"),
    [
        (".fits", "fits"),
        (".vot", "votable"),
        (".xml", "votable"),
        (".ecsv", "ascii.ecsv"),
        (".csv", "ascii.csv"),
        (".mrt", "ascii.mrt"),
    ],
)
def test_formats(tmp_path, suffix, form):
    file = tmp_path / f"hip{suffix}"
    hipparcos_table().write(file, format=form)
    check_hipparcos(read_catalog(file, "hipparcos"))


def test_units_of_the_file_count(tmp_path):
    table = hipparcos_table()
    table["RAICRS"].unit, table["RAICRS"][:] = u.hourangle, table["RAICRS"] / 15
    table["DEICRS"].unit, table["DEICRS"][:] = u.rad, np.radians(table["DEICRS"])
    table["Plx"].unit, table["Plx"][:] = u.arcsec, table["Plx"] / 1000
    table["pmRA"].unit, table["pmRA"][:] = u.deg / u.yr, table["pmRA"] / 3.6e6
    file = tmp_path / "hip.ecsv"
    table.write(file)
    check_hipparcos(read_catalog(file, "hipparcos"))


def test_units_by_hand_go_before(tmp_path):
    table = hipparcos_table(with_units=False)
    table["Plx"] /= 1000
    file = tmp_path / "hip.csv"
    table.write(file)
    check_hipparcos(read_catalog(file, "hipparcos", units={"parallax": "arcsec"}))


def test_names_in_other_case_and_ones_own(tmp_path):
    names = ("hip", "vmag", "ra", "DE", "plx", "PM_RA", "pm_de", "colour")
    file = tmp_path / "hip.csv"
    hipparcos_table(names, with_units=False).write(file)
    check_hipparcos(read_catalog(file, "hipparcos", columns={"b_v": "colour"}))


BSC_README = """\
V/50                Bright Star Catalogue, 5th Revised Ed.     (Hoffleit+, 1991)
================================================================================
Byte-by-byte Description of file: catalog
--------------------------------------------------------------------------------
   Bytes Format  Units   Label    Explanations
--------------------------------------------------------------------------------
   1-  4  I4     ---     HR       Harvard Revised Number
   6-  7  I2     h       RAh      ?Hours RA, equinox J2000, epoch 2000.0
   8-  9  I2     min     RAm      ?Minutes RA
  10- 13  F4.1   s       RAs      ?Seconds RA
      14  A1     ---     DE-      ?Sign Dec
  15- 16  I2     deg     DEd      ?Degrees Dec
  17- 18  I2     arcmin  DEm      ?Minutes Dec
  19- 20  I2     arcsec  DEs      ?Seconds Dec
  22- 26  F5.2   mag     Vmag     ?Visual Magnitude
  28- 32  F5.2   mag     B-V      ? B-V color in the UBV system
  34- 39  F6.3   arcsec/yr pmRA   *?Annual proper motion in RA J2000
  41- 46  F6.3   arcsec/yr pmDE   ?Annual proper motion in Dec J2000
  48- 52  F5.3   arcsec  Parallax ?Trigonometric parallax
  54- 57  I4     km/s    RadVel   ?Heliocentric Radial Velocity
--------------------------------------------------------------------------------
"""


def test_bright_star_catalogue(tmp_path):
    # HR 2491 Sirius, HR 7001 Vega; HR 92, a nova, has no place in it; HR 1852 Mintaka, 18' south of the equator
    lines = [
        "2491 064508.9-164258 -1.46  0.00 -0.553 -1.205 0.375   -8",
        "7001 183656.3+384701  0.03  0.00  0.202  0.286 0.123  -14",
        "  92                                                     ",
        "1852 053200.4-001757  2.23 -0.22  0.002  0.003 0.014   16",
    ]
    (tmp_path / "ReadMe").write_text(BSC_README)
    (tmp_path / "catalog").write_text("\n".join(lines) + "\n")
    catalog = read_catalog(tmp_path / "catalog", "bright_star", readme=tmp_path / "ReadMe")
    assert catalog.id.tolist() == [2491, 7001, 1852]
    assert "1 rows without a position left out" in catalog.notes
    np.testing.assert_allclose(np.degrees(catalog.ra_rad), [101.287083, 279.234583, 83.001667], atol=1e-6)
    np.testing.assert_allclose(np.degrees(catalog.dec_rad), [-16.716111, 38.783611, -0.299167], atol=1e-6)
    np.testing.assert_allclose(catalog.proper_motion_rad_per_year[0] / MAS_RAD, [-553, -1205])
    np.testing.assert_allclose(catalog.parallax_rad[0] / MAS_RAD, 375)
    np.testing.assert_allclose(catalog.radial_velocity_km_per_s, [-8, -14, 16])
    assert catalog.epoch_year == 2000.0


def test_sexagesimal_text(tmp_path):
    table = Table({"HR": [2491, 7001, 1], "RAJ2000": ["06 45 08.9", "18 36 56.3", ""]})
    table["DEJ2000"], table["Vmag"] = ["-16 42 58", "+38 47 01", ""], [-1.46, 0.03, 5.0]
    file = tmp_path / "bsc.csv"
    table.write(file)
    catalog = read_catalog(file, "bright_star")
    assert catalog.id.tolist() == [2491, 7001]
    np.testing.assert_allclose(np.degrees(catalog.ra_rad), [101.287083, 279.234583], atol=1e-6)
    np.testing.assert_allclose(np.degrees(catalog.dec_rad), [-16.716111, 38.783611], atol=1e-6)


# three lines of os-bright-star-catalog-hip (public domain), of 262 characters each
OPEN_BRIGHT_STAR = """\
 32349  06_45_09.2498525  -16_42_47.315026  1.7678185359  -0.2916993748  379.21  -546.01 -1223.07    -5.5   1.21   1.04   1.58   1.33   1.24   0.4 -1.44 2       A0m...  0.009               48915 2491   α CMa   9 CMa         Sirius CMa BHHAAAAACAAAAACBBBB--BEEEGH
 91262  18_36_56.1859795   38_46_58.775743  4.8735545728   0.6768909262  130.23   200.94   286.23   -20.6   0.26   0.28   0.36   0.32   0.40   0.2  0.03 1       A0Vvar -0.001              172167 7001   α Lyr   3 Lyr           Vega Lyr BHHAAAAACAAAAACBBBB--BEEEGH
    88  00_01_04.5982692  -48_48_35.492919  0.0046977187  -0.8518927495    5.50   -18.36    -5.82          0.26   0.29   0.48   0.46   0.38   0.7  5.71          G8III  0.911              224834 9081   τ Phe                        Phe BHHAAAAACAAAAACB-BB--BEE--H
"""  # noqa: E501


def test_open_bright_star_catalogue(tmp_path):
    file = tmp_path / "os-bright-star-catalog-hip.utf8"
    file.write_text(OPEN_BRIGHT_STAR, encoding="utf-8")
    catalog = read_catalog(file, "open_bright_star")
    assert catalog.id.tolist() == [32349, 91262, 88]
    np.testing.assert_allclose(catalog.ra_rad, [1.7678185359, 4.8735545728, 0.0046977187], rtol=1e-12)
    np.testing.assert_allclose(catalog.dec_rad, [-0.2916993748, 0.6768909262, -0.8518927495], rtol=1e-12)
    assert catalog.magnitude.tolist() == [-1.44, 0.03, 5.71]
    assert catalog.b_v_mag.tolist() == [0.009, -0.001, 0.911]
    np.testing.assert_allclose(catalog.proper_motion_rad_per_year[2] / MAS_RAD, [-18.36, -5.82])
    assert catalog.radial_velocity_km_per_s.tolist()[:2] == [-5.5, -20.6]
    assert np.isnan(catalog.radial_velocity_km_per_s[2])


def test_gaia_archive(tmp_path):
    table = Table(
        {
            "source_id": np.array([4472832130942575872, 19]),
            "ra": [269.4485025254384, 10.0] * u.deg,
            "dec": [4.739420051112412, -5.0] * u.deg,
            "pmra": MaskedColumn([-801.5509783684709, 0], mask=[False, True], unit="mas / yr"),
            "pmdec": MaskedColumn([10362.394206546573, 0], mask=[False, True], unit="mas / yr"),
            "parallax": MaskedColumn([546.975939730948, 0], mask=[False, True], unit="mas"),
            "radial_velocity": MaskedColumn([-110.46822, 0], mask=[False, True], unit="km / s"),
            "phot_g_mean_mag": [8.193974, 9.0] * u.mag,
            "bp_rp": MaskedColumn([2.833697, 0], mask=[False, True], unit="mag"),
            "ref_epoch": [2016.0, 2016.0] * u.yr,
        }
    )
    file = tmp_path / "gaia.vot"
    table.write(file, format="votable")
    catalog = read_catalog(file, "gaia")
    assert catalog.id.tolist() == [4472832130942575872, 19]
    assert catalog.magnitude_system == "G"
    np.testing.assert_allclose(catalog.proper_motion_rad_per_year[0] / MAS_RAD, [-801.5509783, 10362.394206], rtol=1e-8)
    assert catalog.radial_velocity_km_per_s[0] == pytest.approx(-110.46822)
    assert catalog.effective_temperature_k[0] == pytest.approx(3230, rel=0.03)  # Barnard's star, M4 V
    for name in ("proper_motion_rad_per_year", "parallax_rad", "radial_velocity_km_per_s", "bp_rp_mag"):
        assert np.isnan(getattr(catalog, name)[1]).all()


def read_plain(table, **arguments):
    return catalog_from_table(
        table, "plain", name="test", **{"epoch_year": 2000.0, "magnitude_system": "V"} | arguments
    )


def test_bp_and_rp_make_a_colour():
    table = plain_table(bp=np.full(30, 6.5), rp=np.full(30, 5.25))
    assert read_plain(table).bp_rp_mag.tolist() == [1.25] * 30


def test_nan_magnitudes_stay_and_are_counted():
    magnitude = np.full(30, 4.0)
    magnitude[[2, 9]] = np.nan
    catalog = read_plain(plain_table(magnitude=magnitude))
    assert np.isnan(catalog.magnitude).sum() == 2
    assert "2 stars without a magnitude" in catalog.notes


def test_ids_that_are_no_numbers():
    table = plain_table(id=[f"star {i}" for i in range(30)])
    catalog = read_plain(table)
    assert catalog.id.tolist() == list(range(30))
    assert read_plain(plain_table(id=[np.nan, *range(7, 36)])).id.tolist() == [-1, *range(7, 36)]
    gaia = np.ma.array([4611686018427387905, *range(7, 36)], mask=[False] * 29 + [True])
    assert read_plain(plain_table(id=gaia)).id.tolist() == [4611686018427387905, *range(7, 35), -1]
    for odd in (0.5, 1e19, 2.0**53):  # the last one stands for 2^53 + 1 too
        assert read_plain(plain_table(id=[odd, *range(7, 36)])).id.tolist() == list(range(30))
    assert any("row of the file" in note for note in catalog.notes)


def test_stated_units_are_believed():
    # a field of 6 deg at ra 0 in degrees looks like radians; who states the unit is believed
    table = plain_table(ra=np.linspace(0, 6.0, 30), dec=np.linspace(-1.5, 1.5, 30))
    catalog = read_plain(table, units={"ra": "deg", "dec": "deg"})
    assert np.degrees(catalog.ra_rad).max() == pytest.approx(6.0)
    catalog = read_plain(table, units={"ra": "rad", "dec": "rad"})
    assert catalog.ra_rad.max() == pytest.approx(6.0)


def test_presets():
    assert set(preset_names()) == {"hipparcos", "gaia", "bright_star", "open_bright_star", "plain"}
    for name in preset_names():
        assert get_preset(name).source
    own = ColumnPreset(name="mine", source="me", columns={"ra": ("x",)})
    assert get_preset(own) is own
