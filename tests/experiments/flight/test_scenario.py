"""Attitude laws, temperatures and tables of a flight."""

import numpy as np
import pytest
from pydantic import ValidationError
from refusals import refuses

from experiments.flight.scenario import build_flight, build_orbit
from experiments.flight.settings import Config, OrbitConfig
from optics.errors import DomainError
from render.motion.trajectory import trail_of_rate


@pytest.mark.parametrize(("law", "rate_deg_per_s"), [("inertial", 0.0), ("turn", 0.01), ("nadir", 360.0 / 5801.2318)])
def test_attitude_laws_turn_as_they_say(law, rate_deg_per_s):
    path = build_flight(Config(attitude={"law": law})).trajectory
    turned = path.attitude([1000.0, 1001.0])
    assert np.degrees((turned[1] * turned[0].inv()).magnitude()) == pytest.approx(rate_deg_per_s, rel=1e-5, abs=1e-9)
    if law == "turn":
        assert trail_of_rate(path.rate(1000.0)) == (pytest.approx(0.01), pytest.approx(20.0))


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
    dark = flight.shadowed(time)
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
    assert "\n" not in refuses(DomainError, message, lambda: build_flight(Config(temperature={"file": str(table)})))


def test_elements_with_a_wrong_checksum_are_refused():
    pytest.importorskip("sgp4")
    with pytest.raises(DomainError, match=r"orbit\.tle: two-line elements: .*checksum"):
        build_orbit(OrbitConfig(tle=("1 25544U" + " " * 60 + "5", "2 25544" + " " * 61 + "5")), 2016.0)


def test_orbits_below_the_ground_and_half_laws_are_refused():
    refuses(ValidationError, "greater than or equal to 100", Config, orbit={"perigee_km": -20.0})
    refuses(ValidationError, "give both, or neither", Config, attitude={"law": "table"})
