"""The chromatic test on a small camera; its uncertainties on many simulated cameras."""

from dataclasses import replace

import numpy as np
import pytest

from experiments.laboratory.chromatic_error import measure_chromatic
from optics.rays.spots import trace_spots
from render.engine.random import Streams
from render.sensor_file.instrument import build_instrument
from render.sensor_file.tables import InstrumentConfig


@pytest.fixture(scope="module")
def small_camera(tmp_path_factory):
    """The default lens, by rays, in front of few pixels: patterns of a whole chip would take most of the time."""
    path = tmp_path_factory.mktemp("chip") / "few.toml"
    path.write_text('base = "cmv4000"\nname = "few"\nchip_width_px = 640\nchip_height_px = 512\n')
    return build_instrument(InstrumentConfig(detector=str(path), diffraction="rays"))


def quick_measure(bench, instrument, seed):
    return measure_chromatic(bench, instrument, Streams(seed).child("test"), advance=lambda: None)


def with_sensor(instrument, sensor_seed, **changes):
    return replace(instrument, detector=replace(instrument.detector, sensor_seed=sensor_seed, **changes))


@pytest.fixture(scope="module")
def measured(engine, bench_of, small_camera):
    return quick_measure(bench_of(rows=1, columns=2, frames=2, dark_frames=2), small_camera, 1)


def test_record_of_every_position_point_and_filter(measured, small_camera):
    """Shapes as documented; spots at 800 nm are those of the lens's diagram at the points."""
    for of in (measured.mean_px, measured.sigma_px):
        assert of["epsf"].shape == measured.noise_px.shape == (4, 2, 3, 2)
    assert np.abs(measured.mean_px["epsf"] - measured.photon_px).max() < 0.1
    assert measured.pattern_px["epsf"].shape[1:] == (4, 2, 3, 2)
    direction = measured.direction.reshape(-1, 3)
    field = np.degrees(np.arctan(direction[:, :2] / direction[:, 2:])).T
    spots = trace_spots(small_camera.camera.focused_lens, *field, np.array([800.0]), order=(12, 24))
    x, y, light = spots.rays.x, spots.rays.y, spots.area_mm2
    total = light.sum(-1, keepdims=True)
    square = sum((light * (v - (light * v).sum(-1, keepdims=True) / total) ** 2).sum(-1) for v in (x, y))
    assert measured.rms_spot_um[2] == pytest.approx(1e3 * np.sqrt(square / total[..., 0]).mean(), rel=0.02)


SENSORS = 16


@pytest.mark.slow
def test_effect_of_the_fixed_pattern_is_predicted(engine, bench_of, small_camera, traced_once):
    """The prediction draws response patterns; here 16 sensors are made, and their mean centroids scatter.

    16 points x 2 axes x 16 sensors, against 48 predicted patterns for each of those: the relative standard deviation of
    their variances is sqrt(2 / 512) and sqrt(2 / 24576), together 6.3 %; four of them are allowed. The filters do not
    count, the pattern is common to them. The temporal part is taken off.
    """
    bench = bench_of(frames=40, dark_frames=100)
    place, temporal, predicted, noise = [], [], [], []
    for seed in range(SENSORS):
        camera = with_sensor(small_camera, 2000 + seed, prnu=0.05)
        measured = quick_measure(bench, camera, seed)
        place.append(measured.mean_px["epsf"] - measured.photon_px)
        temporal.append((measured.sigma_px["epsf"] ** 2 / measured.frames_used[..., None]).mean())
        predicted.append((measured.pattern_px["epsf"] ** 2).mean((0, 1, 2)))
        noise.append(measured.sigma_px["epsf"] ** 2 / measured.noise_px**2)
    found = np.var(place, axis=0, ddof=1).mean((0, 1)) - np.mean(temporal)  # (b, 2)
    spread = np.sqrt(2 / (32 * SENSORS) + 2 / (32 * 48 * SENSORS))
    assert found.mean() > 10 * np.mean(temporal)
    assert abs(found.mean() / np.mean(predicted) - 1) < 4 * spread
    # the noise of every point, of 16 x 39 differences
    assert np.abs(np.mean(noise, axis=0) - 1.0).max() < 4.5 * np.sqrt(2.0 / (SENSORS * 39))
