"""Rendered and predicted flights of small sensors, and the sensor of a control loop by frames."""

import json

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from small_sensors import RAYS, sensor

from experiments.flight import experiment
from experiments.flight.frames import FlightCamera, build_tracker
from experiments.flight.loop import by_frames
from experiments.flight.prediction import build_budget
from experiments.flight.scenario import build_flight
from experiments.flight.settings import FlightConfig
from experiments.harness.progress import Progress
from optics.attitude import attitude_error_arcsec
from render.motion.trajectory import SampledAttitude

SMALL = {**sensor(1024, **RAYS), "dark_frames": 6}


IDEAL = {"kind": "ideal", "focal_length_mm": 26.0, "f_number": 2.0, "psf_fwhm_px": 1.8, "max_field_deg": 15.0}
SMALL_IDEAL = SMALL["instrument"] | {"lens": IDEAL, "width_px": 700, "height_px": 700}


@pytest.fixture(scope="module")
def flown():
    """Two rendered segments of a small sensor, and the sensor at the end of its life by prediction."""
    pytest.importorskip("tetra3rs")
    settings = {
        "centroid": "windowed", "window_px": 11, "dark_frames": 2, "rates_deg_per_s": [0.0, 0.05, 50.0],
        "frames": {"segments": 2, "frames": 4, "switched": 2, "thermal_states": 1, "cosmic_rays": "leo_quiet"},
        "temperature": {"eclipse_k": 0}, "life": {"years": 5.0, "darkened_glass": 0.2},
    }  # fmt: skip
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(experiment, "ORBIT_SAMPLES", 5)
        patch.setattr(experiment, "COVERAGE_ATTITUDES", 50)
        return experiment.run(FlightConfig(**SMALL | settings | {"instrument": SMALL_IDEAL}), progress=Progress())


def test_a_small_flight_is_predicted_and_measured(flown):
    mission, terms = flown["mission"], {term.term: term for term in flown["terms"]}
    segments = [segment for segment in flown["segments"] if segment.status != "blinded"]
    assert segments
    assert mission.period_s == pytest.approx(5801.2, abs=0.1)
    assert mission.rate_deg_per_s == pytest.approx(0.01)
    assert mission.wrong_attitudes == 0
    assert mission.solved_percent.value > 70.0
    assert mission.acquired_lower_limit <= mission.acquired_fraction.value
    assert terms["temporal_noise"].ratio[0].value == pytest.approx(1.0, abs=0.8)  # of 16 frames at most
    for segment in segments:
        assert np.abs(segment.error_arcsec[:2]).max() < 5.0 * terms["total"].predicted_arcsec[0]
        for k in range(2):  # residual aberration of 20 m/s: up to 0.014 arcsec
            predicted = segment.predicted_aberration_arcsec[k]
            assert segment.aberration_arcsec[k].value == pytest.approx(predicted, abs=1e-3)
    assert [metric.metric for metric in flown["metrics"]] == ["AME", "MME", "RME"]
    assert flown["metrics"][0].measured_arcsec[0] >= flown["metrics"][2].measured_arcsec[0]


def test_predictions_of_a_small_flight_follow_rate_age_and_temperature(flown):
    rest, turning, fast = flown["rates"]
    assert (rest.trail_px, turning.trail_px) == (0.0, pytest.approx(0.825, abs=1e-3))
    assert (turning.noise_arcsec > rest.noise_arcsec).all()
    assert np.isnan(fast.noise_arcsec).all()  # the trail is longer than the window
    begin, end = flown["ageing"]
    assert end.electrons_e == pytest.approx(0.8 * begin.electrons_e)
    assert end.limiting_magnitude_mag < begin.limiting_magnitude_mag
    (uniform,) = flown["thermal_sensitivity"]
    assert uniform.state == "uniform"
    assert uniform.corner_px_per_k > 0.01
    assert uniform.attitude_arcsec_per_k[0] > 0.0
    assert [sample.mean_k for sample in flown["history"]] == pytest.approx(
        [0.5 + np.cos(np.radians(40.0 + 90.0 * k)) for k in range(5)], abs=1e-6
    )


def test_a_boresight_towards_the_earth_is_unavailable():
    settings = {"predict_only": True, "attitude": {"law": "nadir", "off_zenith_deg": 170}, "life": {"years": 0}}
    config = FlightConfig(**SMALL | settings | {"instrument": SMALL_IDEAL})
    result = experiment.run(config, progress=Progress())
    assert result["mission"].available_percent == 0.0
    assert (result["terms"], result["metrics"], result["segments"]) == (None, None, None)


@pytest.mark.slow
def test_the_quick_run_measures_what_is_predicted(quick_run_of):
    """Its sample is small: terms are held to what it can tell, the closed form of the aberration to a part in 100."""
    terms = json.loads((quick_run_of("flight") / "summary.json").read_text())["results"]["terms"]
    ratio, error = (terms["ratio"][part] for part in ("value", "uncertainty"))
    assert ratio["aberration"]["across"] == pytest.approx(1.0, abs=0.01)
    for name in ("temporal_noise", "total"):
        assert ratio[name]["across"] == pytest.approx(1.0, abs=0.15 + 4.0 * error[name]["across"])


@pytest.mark.slow
def test_angular_acceleration_biases_the_attitude_of_rendered_frames(engine):
    """By a t^2 / 24: 6 arcsec for a trail of 0.4 px; the noise is 0.2 arcsec."""
    config = FlightConfig(
        **SMALL, temperature={"offset_k": 0, "mean_k": 0, "eclipse_k": 0}, attitude={"law": "inertial"}
    )
    camera = FlightCamera(build_budget(config, build_flight(config)))
    tracker, time = build_tracker(camera), np.linspace(99.0, 101.0, 801)
    aim, growth = camera.flight.trajectory.attitude(100.0), np.radians(1.0)
    turned = Rotation.from_rotvec(-0.5 * growth * np.outer((time - 100.0) ** 2, [0.0, 1.0, 0.0])) * aim
    path = SampledAttitude(samples_s=time, attitudes=turned)
    velocity = camera.flight.velocity_km_per_s(100.0)
    light = camera.simulator.expected(path, start_s=99.9, velocity_km_per_s=velocity)
    reading = tracker(camera.read(light, 100.0, 0, "growth"), 100.0, velocity_km_per_s=velocity, near=aim)
    error = attitude_error_arcsec(reading.attitude, aim)
    expected = np.degrees(growth * config.instrument.exposure_s**2 / 24.0) * 3600.0
    np.testing.assert_allclose(error[:2], [0.0, -expected], atol=0.1 * expected)


@pytest.mark.slow
def test_a_frame_full_of_cosmic_rays_is_solved_lost_in_space(engine):
    """Some 95 tracks among 30 guide stars, most of them brighter: without their shape none of such frames is solved."""
    pytest.importorskip("tetra3rs")
    camera = FlightCamera(
        build_budget(config := FlightConfig(**SMALL, frames={"cosmic_rays": "solar_flare"}), build_flight(config))
    )
    tracker, time = build_tracker(camera), 1000.0
    frame = camera.read(camera.expected(time, np.zeros(5)), time, 0, "flare")
    assert len(camera.simulator.hits(0, "flare")) > 60
    reading = tracker(frame, time, velocity_km_per_s=camera.flight.velocity_km_per_s(time))
    assert reading.mode == "acquisition"
    error = attitude_error_arcsec(reading.attitude, camera.flight.trajectory.attitude(time))
    assert (np.abs(error) < 6.0 * reading.sigma_arcsec).all()


@pytest.mark.slow
def test_the_sensor_by_frames_errs_as_it_states(engine):
    sensor = by_frames(
        FlightConfig(**SMALL, tracker={"alignment_arcsec": [0, 0, 0]}, temperature={"offset_k": 0, "mean_k": 0})
    )
    attitude = Rotation.from_euler("x", -60, degrees=True)
    reading = sensor(attitude, np.zeros(3), 0.1)
    assert reading.ok
    assert (np.abs(attitude_error_arcsec(reading.attitude, attitude)) < 6.0 * reading.sigma_arcsec).all()
