"""Space motion, parallax, deflection and aberration against astropy and ERFA, to 0.1 mas or better."""

import warnings

import erfa
import numpy as np
import pytest
from astropy import units as u
from astropy.coordinates import GCRS, SkyCoord
from astropy.time import Time
from fields import star_catalog

from optics.stellar_aberration import aberrated
from render.catalogue.motion import deflected, directions_at, earth_observer, propagate
from render.catalogue.record import MAS_RAD, direction_from_angles

LIGHT_KM_PER_S = 299792.458

# J2000 (SIMBAD): ra, dec [deg], pm_ra cos dec, pm_dec [mas/year], parallax [mas], radial velocity [km/s]
FAST = [
    ("Barnard's star", 269.452077, 4.693365, -801.55, 10362.39, 546.98, -110.5),
    ("Kapteyn's star", 77.919107, -45.018432, 6491.22, -5708.61, 254.20, 245.05),
    ("61 Cyg A", 316.724742, 38.749417, 4164.21, 3249.61, 286.01, -65.94),
    ("Proxima", 217.428953, -62.679484, -3781.74, 769.47, 768.07, -20.6),
    ("Sirius", 101.287155, -16.716116, -546.01, -1223.07, 379.21, -5.5),
    ("Polaris", 37.954561, 89.264109, 44.48, -11.85, 7.54, -16.42),
]


def random_stars(count=2000, seed=5, **changes):
    """Stars all over the sky with motions, parallaxes and velocities as near stars have them."""
    rng = np.random.default_rng(seed)
    ra, dec = rng.uniform(0, 2 * np.pi, count), np.arcsin(rng.uniform(-1, 1, count))
    fields = {
        "direction": direction_from_angles(ra, dec),
        "proper_motion_rad_per_year": rng.normal(0, 500, (count, 2)) * MAS_RAD,
        "parallax_rad": rng.uniform(1, 300, count) * MAS_RAD,
        "radial_velocity_km_per_s": rng.normal(0, 50, count),
    }
    return star_catalog(count, **fields | changes)


def fast_stars():
    table = np.array([row[1:] for row in FAST])
    return star_catalog(
        len(table),
        epoch_year=2000.0,
        direction=direction_from_angles(*np.radians(table[:, :2]).T),
        proper_motion_rad_per_year=table[:, 2:4] * MAS_RAD,
        parallax_rad=table[:, 4] * MAS_RAD,
        radial_velocity_km_per_s=table[:, 5],
    )


def year(epoch):
    return Time(epoch, format="jyear", scale="tdb")


def as_skycoord(catalog, **extra):
    motion = catalog.proper_motion_rad_per_year / MAS_RAD
    return SkyCoord(
        catalog.ra_rad * u.rad,
        catalog.dec_rad * u.rad,
        distance=(1000.0 * MAS_RAD / catalog.parallax_rad) * u.pc,
        pm_ra_cosdec=motion[:, 0] * u.mas / u.yr,
        pm_dec=motion[:, 1] * u.mas / u.yr,
        radial_velocity=catalog.radial_velocity_km_per_s * u.km / u.s,
        obstime=year(catalog.epoch_year),
        **extra,
    )


def unit(coordinates):
    v = coordinates.cartesian.xyz.value.T
    return v / np.linalg.norm(v, axis=1)[:, None]


def apart_mas(a, b):
    return np.linalg.norm(a - b, axis=1) / MAS_RAD


@pytest.mark.parametrize("stars", [random_stars, fast_stars])
@pytest.mark.parametrize("years", [-25.0, 10.0, 50.0])
def test_space_motion_as_astropy(stars, years):
    catalog = stars()
    expected = unit(as_skycoord(catalog).apply_space_motion(year(catalog.epoch_year + years)))
    found = directions_at(catalog, catalog.epoch_year + years)
    assert apart_mas(found, expected).max() < 0.01


def test_all_of_the_record_moves_as_astropy():
    catalog = random_stars()
    moved = propagate(catalog, 2036.0)
    expected = as_skycoord(catalog).apply_space_motion(year(2036.0))
    assert apart_mas(moved.direction, unit(expected)).max() < 0.01
    motion = np.stack([expected.pm_ra_cosdec.to_value(u.mas / u.yr), expected.pm_dec.to_value(u.mas / u.yr)], 1)
    np.testing.assert_allclose(moved.proper_motion_rad_per_year / MAS_RAD, motion, atol=0.01)
    np.testing.assert_allclose(moved.parallax_rad / MAS_RAD, 1e3 / expected.distance.to_value(u.pc), rtol=2e-6)
    np.testing.assert_allclose(moved.radial_velocity_km_per_s, expected.radial_velocity.to_value(u.km / u.s), atol=1e-3)
    assert moved.epoch_year == 2036.0
    assert catalog.epoch_year == 2016.0


def test_unknown_motion_stays_and_stays_unknown():
    catalog = random_stars(
        10,
        proper_motion_rad_per_year=np.full((10, 2), np.nan),
        parallax_rad=np.full(10, np.nan),
        radial_velocity_km_per_s=np.full(10, np.nan),
    )
    moved = propagate(catalog, 2050.0)
    assert apart_mas(moved.direction, catalog.direction).max() < 1e-6
    for name in ("proper_motion_rad_per_year", "parallax_rad", "radial_velocity_km_per_s"):
        assert np.isnan(getattr(moved, name)).all()
    assert apart_mas(directions_at(catalog, 2050.0), catalog.direction).max() < 1e-6


def test_stars_at_the_poles_move():
    catalog = random_stars(2, direction=[[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]], proper_motion_rad_per_year=[[1e-6, 0]] * 2)
    moved = directions_at(catalog, 2017.0)
    np.testing.assert_allclose(moved[:, :2], [[0.0, 1e-6]] * 2, atol=1e-10)  # ra 0: east is +y


@pytest.mark.parametrize("speed", [0.0, 8.0, 30.0, 0.3 * LIGHT_KM_PER_S])
def test_aberration_as_erfa(speed):
    stars = random_stars()
    beta = speed / LIGHT_KM_PER_S * np.array([0.6, -0.48, 0.64])
    far = 1e12  # au from the Sun, whose potential erfa.ab counts in
    expected = erfa.ab(stars.direction, beta, far, np.sqrt(1 - beta @ beta))
    assert apart_mas(aberrated(stars.direction, beta * LIGHT_KM_PER_S), expected).max() < 1e-6


def test_deflection_as_erfa():
    stars = random_stars()
    place = np.array([0.3, -0.9, 0.2])
    distance = np.linalg.norm(place)
    expected = erfa.ldsun(stars.direction, place / distance, distance)
    away = stars.direction @ place / distance > -np.cos(np.radians(1.0))  # not in the Sun's face
    assert apart_mas(deflected(stars.direction, place), expected)[away].max() < 1e-4  # erfa's 2 G M / c^2 has 12 digits


def test_deflection_at_right_angles_and_at_the_edge():
    place = np.array([0.0, 0.0, -1.0])  # the Sun stands at +z
    side = deflected([[1.0, 0.0, 0.0]], place)[0]
    assert side[2] / MAS_RAD == pytest.approx(-4.07, abs=0.01)  # 4.07 mas away from the Sun
    angle = np.radians(959.6 / 3600)
    edge = deflected([[np.sin(angle), 0.0, np.cos(angle)]], place)[0]
    assert (np.arctan2(edge[0], edge[2]) - angle) / MAS_RAD == pytest.approx(1751, abs=3)  # Einstein's 1.75"
    assert np.isfinite(deflected([[0.0, 0.0, 1.0]], place)).all()


@pytest.mark.parametrize("epoch", [2016.3, 2026.5, 2040.0])
def test_all_together_as_erfa(epoch):
    catalog, observer = fast_stars(), earth_observer(epoch)
    motion = catalog.proper_motion_rad_per_year
    dates = (*erfa.epj2jd(catalog.epoch_year), *erfa.epj2jd(epoch))
    ra, dec, pm_ra, pm_dec, parallax, velocity = erfa.pmsafe(
        catalog.ra_rad,
        catalog.dec_rad,
        motion[:, 0] / np.cos(catalog.dec_rad),
        motion[:, 1],
        catalog.parallax_rad / MAS_RAD / 1e3,
        catalog.radial_velocity_km_per_s,
        *dates,
    )
    r = erfa.pmpx(ra, dec, pm_ra, pm_dec, parallax, velocity, 0.0, observer.position_au)
    distance = np.linalg.norm(observer.from_sun_au)
    r = erfa.ldsun(r, observer.from_sun_au / distance, distance)
    beta = observer.velocity_km_per_s / LIGHT_KM_PER_S
    r = erfa.ab(r, beta, distance, np.sqrt(1 - beta @ beta))
    assert apart_mas(directions_at(catalog, epoch, observer), r).max() < 0.001


def test_as_astropy_sees_it_from_the_earth():
    catalog, epoch = random_stars(), 2026.5
    moved = propagate(catalog, epoch)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # Earth orientation: no matter for GCRS
        expected = SkyCoord(
            moved.ra_rad * u.rad, moved.dec_rad * u.rad, distance=(1000.0 * MAS_RAD / moved.parallax_rad) * u.pc
        ).transform_to(GCRS(obstime=year(epoch)))
    found = directions_at(catalog, epoch, earth_observer(epoch))
    # astropy takes the star where it was when its light passed the barycentre: motion times 8 min, 0.03 mas here
    assert apart_mas(found, unit(expected)).max() < 0.1


def test_satellite_adds_its_own():
    earth = earth_observer(2026.5)
    satellite = earth.moved(position_km=[7000.0, 0.0, 0.0], velocity_km_per_s=[0.0, 7.5, 0.0])
    np.testing.assert_allclose((satellite.position_au - earth.position_au) * 149597870.7, [7000, 0, 0], rtol=1e-6)
    np.testing.assert_allclose((satellite.from_sun_au - earth.from_sun_au) * 149597870.7, [7000, 0, 0], rtol=1e-6)
    np.testing.assert_allclose(satellite.velocity_km_per_s - earth.velocity_km_per_s, [0, 7.5, 0], atol=1e-12)
