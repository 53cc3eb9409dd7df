"""Orbit, attitude laws, temperatures and tables, against closed forms and another code."""

import numpy as np
import pytest
from pydantic import ValidationError

from experiments.flight.orbit import EARTH_RADIUS_KM, build_orbit
from experiments.flight.scenario import build_flight, trail_of_rate
from experiments.flight.settings import Config, OrbitConfig
from optics.errors import DomainError


@pytest.fixture(scope="module")
def orbit():
    return build_orbit(OrbitConfig(perigee_km=700.0, eccentricity=0.3, perigee_deg=50.0), 2024.3)


def test_an_elliptic_orbit_moves_by_newtons_law(orbit):
    """Second differences of the position are the attraction of the Earth; the velocity its first differences."""
    step, time = 0.5, np.linspace(0.0, orbit.period_s, 40)
    before, place, after = (orbit.state(time + shift)[0] for shift in (-step, 0.0, step))
    distance = np.linalg.norm(place, axis=1)
    pull = -398600.4418 * place / distance[:, None] ** 3
    np.testing.assert_allclose((after - 2.0 * place + before) / step**2, pull, atol=2e-6)
    np.testing.assert_allclose((after - before) / (2.0 * step), orbit.state(time)[1], atol=1e-5)
    assert distance.min() == pytest.approx(EARTH_RADIUS_KM + 700.0, rel=1e-3)
    assert np.abs(place @ orbit.pole).max() < 1e-6
    assert np.degrees(np.arccos(orbit.pole[2])) == pytest.approx(97.8, abs=1e-9)


def test_two_line_elements_fly_as_sgp4_and_astropy_have_them():
    """Of the space station; SGP4's axes turned to icrs by astropy with its own Earth orientation."""
    pytest.importorskip("sgp4")
    from astropy import units as u
    from astropy.coordinates import GCRS, TEME, CartesianDifferential, CartesianRepresentation
    from astropy.time import Time
    from sgp4.api import Satrec

    lines = (
        "1 25544U 98067A   19343.69339541  .00001764  00000-0  38792-4 0  9991",
        "2 25544  51.6439 211.2001 0007417  17.6667  85.6398 15.50103472202482",
    )
    orbit, satellite = build_orbit(OrbitConfig(tle=lines), 2016.0), Satrec.twoline2rv(*lines)
    time = Time(satellite.jdsatepoch, satellite.jdsatepochF, format="jd") + 3000.0 * u.s
    _, place, velocity = satellite.sgp4(time.jd1, time.jd2)
    seen = CartesianRepresentation(place * u.km, differentials=CartesianDifferential(velocity * u.km / u.s))
    true = TEME(seen, obstime=time).transform_to(GCRS(obstime=time)).cartesian
    np.testing.assert_allclose(orbit.state(3000.0)[0], true.xyz.to_value(u.km), atol=3e-3)  # 0.1 arcsec
    np.testing.assert_allclose(orbit.state(3000.0)[1], true.differentials["s"].d_xyz.to_value(u.km / u.s), atol=4e-6)
    assert orbit.period_s == pytest.approx(86400.0 / 15.501, rel=1e-4)
    assert orbit.epoch_year == pytest.approx(2019.9376, abs=1e-3)
    with pytest.raises(DomainError, match="checksum"):
        build_orbit(OrbitConfig(tle=(lines[0][:-1] + "5", lines[1])), 2016.0)


def test_the_sun_is_where_astropy_has_it(orbit):
    from astropy.coordinates import get_sun
    from astropy.time import Time

    sun = get_sun(Time(2024.3, format="jyear")).cartesian.xyz.value
    assert np.degrees(np.arccos(sun @ orbit.sun / np.linalg.norm(sun))) < 0.02  # aberration, light time


def test_half_of_a_low_noon_orbit_lies_in_the_shadow_that_its_height_makes():
    """Sun in the plane of a circular orbit: asin(R / r) / pi of it lies in the cylinder of the shadow."""
    sun = build_orbit(OrbitConfig(), 2024.2164).sun  # near the equinox: the Sun is in the equator
    node = float(np.degrees(np.arctan2(sun[1], sun[0])))
    orbit = build_orbit(OrbitConfig(perigee_km=600.0, inclination_deg=90.0, node_deg=node), 2024.2164)
    share = orbit.shadowed(np.linspace(0.0, orbit.period_s, 4001)).mean()
    assert share == pytest.approx(np.arcsin(EARTH_RADIUS_KM / (EARTH_RADIUS_KM + 600.0)) / np.pi, abs=2e-3)


@pytest.mark.parametrize("law", ["inertial", "turn", "nadir"])
def test_attitude_laws_turn_as_they_say(law):
    flight = build_flight(Config(attitude={"law": law}))
    rate, towards = trail_of_rate(flight.trajectory.rate(1000.0))
    times = np.array([1000.0, 1001.0])
    turn = flight.trajectory.attitude(times)
    angle = np.degrees((turn[1] * turn[0].inv()).magnitude())
    if law == "inertial":
        assert angle == pytest.approx(0.0, abs=1e-9)
    elif law == "turn":
        assert (rate, towards) == (pytest.approx(0.01), pytest.approx(20.0))
        assert angle == pytest.approx(0.01, rel=1e-6)
        # a star in the middle trails towards 20 deg from columns to rows
        star = turn[1].apply(turn[0].inv().apply([0.0, 0.0, 1.0]))
        assert np.degrees(np.arctan2(star[1], star[0])) == pytest.approx(20.0, abs=0.01)
    else:
        assert angle == pytest.approx(360.0 / flight.period_s, rel=1e-5)
        zenith = np.array(flight.orbit.state(times)[0])
        zenith /= np.linalg.norm(zenith, axis=1)[:, None]
        boresight = turn.as_matrix()[:, 2]
        np.testing.assert_allclose((boresight * zenith).sum(1), np.cos(np.radians(30.0)), atol=1e-6)


def test_the_known_velocity_leaves_out_what_it_is_told_to():
    flights = {name: build_flight(Config(aberration={"corrected": name})) for name in ("all", "earth", "none")}
    true = flights["all"].velocity_km_per_s(700.0)
    own = flights["all"].orbit.state(700.0)[1]
    assert np.linalg.norm(flights["all"].known_velocity_km_per_s(700.0) - true) == pytest.approx(0.020)
    np.testing.assert_allclose(true - flights["earth"].known_velocity_km_per_s(700.0), own, atol=1e-12)
    assert flights["none"].known_velocity_km_per_s(700.0) is None


def test_the_eclipse_cools_the_lens_and_light_comes_from_tables(tmp_path):
    table = tmp_path / "sun.csv"
    table.write_text("angle_deg,e_per_px_s\n0,1000\n180,0\n")
    config = Config(temperature={"mean_k": 0, "offset_k": 0, "eclipse_k": -2}, straylight={"sun_file": str(table)})
    flight = build_flight(config)
    time = np.linspace(0.0, flight.period_s, 200)
    dark = flight.orbit.shadowed(time)
    state = flight.thermal.at(time)[:, 0]
    assert 0.1 < dark.mean() < 0.45
    assert -2.0 < state.min() < -1.0
    assert state[dark].mean() < state[~dark].mean()
    light = flight.background_e_per_s(time)
    np.testing.assert_allclose(light[~dark], 1000.0 * (1.0 - flight.angles_deg(time)["sun"][~dark] / 180.0))
    assert not light[dark].any()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("time_s,mean_k\n0,1\n3000,2\n2000,1\n9000,0\n", "2000 in row 3 is not above 3000"),
        ("time_s,mean_k\n0,1\n9000,2\n", "a gap of 9000 s"),
        ("time_s,mean_k\n10,1\n200,2\n", "runs from 10 to 200 s; the orbit lasts"),
        ("time_s,mean_c\n0,1\n9000,2\n", "no column mean_k"),
        ("time_s,mean_k\n0,1\n9000\n", "every row needs 2 numbers"),
    ],
)
def test_tables_with_gaps_or_time_that_runs_backwards_are_told_in_a_line(tmp_path, text, message):
    table = tmp_path / "t.csv"
    table.write_text(text)
    with pytest.raises(DomainError, match=message) as caught:
        build_flight(Config(temperature={"file": str(table)}))
    assert "\n" not in str(caught.value)


def test_orbits_below_the_ground_and_half_laws_are_refused():
    with pytest.raises(ValidationError, match="greater than or equal to 100"):
        Config(orbit={"perigee_km": -20.0})
    with pytest.raises(ValidationError, match="give both, or neither"):
        Config(attitude={"law": "table"})


def test_a_refined_grid_of_psfs_is_linear_between_its_nodes():
    from experiments.laboratory.bench.readout.psf_grid import PsfGrid, refined
    from render.records import EffectivePsf

    x, y = np.meshgrid([0.0, 10.0, 20.0], [0.0, 8.0])
    shape = np.arange(81.0).reshape(9, 9) + 1.0
    psfs = tuple(
        EffectivePsf(values=(1.0 + a + 3.0 * b) * shape, oversampling=4) for a, b in zip(x.flat, y.flat, strict=True)
    )
    found = refined(PsfGrid(psfs=psfs, place_px=np.column_stack([x.ravel(), y.ravel()])), 4)
    assert len(found.psfs) == 9 * 5
    for psf, (a, b) in zip(found.psfs, found.place_px, strict=True):
        np.testing.assert_allclose(psf.values, (1.0 + a + 3.0 * b) * shape)
    assert {tuple(one) for one in found.place_px} >= {(2.5, 2.0), (20.0, 8.0), (17.5, 6.0)}
