"""Attitude laws, temperatures and tables of a flight."""

import numpy as np
import pytest

from experiments.flight.scenario import build_flight
from experiments.flight.settings import FlightConfig
from render.motion.trajectory import trail_of_rate


@pytest.mark.parametrize(("law", "rate_deg_per_s"), [("inertial", 0.0), ("turn", 0.01), ("nadir", 360.0 / 5801.2318)])
def test_attitude_laws_turn_as_they_say(law, rate_deg_per_s):
    path = build_flight(FlightConfig(attitude={"law": law})).trajectory
    turned = path.attitude([1000.0, 1001.0])
    assert np.degrees((turned[1] * turned[0].inv()).magnitude()) == pytest.approx(rate_deg_per_s, rel=1e-5, abs=1e-9)
    if law == "turn":
        assert trail_of_rate(path.rate(1000.0)) == (pytest.approx(0.01), pytest.approx(20.0))


def test_known_velocity_by_correction():
    flights = {name: build_flight(FlightConfig(aberration={"corrected": name})) for name in ("all", "earth", "none")}
    true = flights["all"].velocity_km_per_s(700.0)
    orbital = flights["all"].orbit.state(700.0)[1]
    assert np.linalg.norm(flights["all"].known_velocity_km_per_s(700.0) - true) == pytest.approx(0.020)
    np.testing.assert_allclose(true - flights["earth"].known_velocity_km_per_s(700.0), orbital, atol=1e-12)
    assert flights["none"].known_velocity_km_per_s(700.0) is None


def test_the_eclipse_cools_the_lens_and_light_comes_from_tables(tmp_path):
    table = tmp_path / "sun.csv"
    table.write_text("angle_deg,e_per_px_s\n0,1000\n180,0\n")
    config = FlightConfig(
        temperature={"mean_k": 0, "offset_k": 0, "eclipse_k": -2}, straylight={"sun_file": str(table)}
    )
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
