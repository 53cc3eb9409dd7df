"""Temporal, high-frequency and distortion error on a small camera: measured against predicted and truth."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib.accuracy.temporal import small_sample_factor
from experiments.laboratory.bench.points import point_scene, read_points
from experiments.laboratory.distortion_error import measure_distortion
from experiments.laboratory.distortion_model import predict_distortion
from experiments.laboratory.high_frequency import measure_high_frequency, switched
from experiments.laboratory.high_frequency_model import predict_high_frequency
from experiments.laboratory.settings.tables import GridTargetConfig, HexapodConfig, StepConfig
from experiments.laboratory.temporal_error import measure_temporal, predict_temporal, star_target_directions
from optics.errors import DomainError
from render.engine.random import Streams

IDEAL = HexapodConfig(step_error_arcsec=0.0, roll_error_arcsec=0.0, reading_error_arcsec=0.0)
PLACE = (700.0, 700.0)


@pytest.fixture(scope="module")
def bench(bench_of):
    made = bench_of(rows=2, columns=3, methods=("epsf", "cog", "gaussian"), frames=40, dark_frames=40)
    return replace(made, target=made.target.model_copy(update={"pitch_px": 40.4}))


@pytest.fixture(scope="module")
def scene(engine, bench, small_camera):
    return point_scene(bench, small_camera)


@pytest.fixture(scope="module")
def psf(scene, small_camera):
    return scene.psfs(star_target_directions(scene.bench, small_camera, PLACE))


@pytest.fixture(scope="module")
def steps(scene, bench, small_camera):
    plan = StepConfig(positions=3, step_px=0.25)
    few = replace(bench, frames=8)
    return measure_high_frequency(
        few,
        small_camera,
        IDEAL,
        plan,
        place_px=PLACE,
        streams=Streams(3),
        scene=scene,
    )


def test_temporal_error_agrees_with_its_prediction(bench, scene, small_camera, psf):
    measured = measure_temporal(bench, small_camera, levels_e=[3000.0], place_px=PLACE, streams=Streams(1), scene=scene)
    predicted = predict_temporal(bench, small_camera, psf=psf, levels_e=[3000.0], place_px=PLACE, draws=0)
    c4, samples = small_sample_factor(bench.frames), 2 * 6 * bench.frames
    for method in bench.methods:
        ratio = measured.sigma_px[method][0].mean() / (c4 * predicted.linear_px[method][0].mean())
        assert ratio == pytest.approx(1.0, abs=4.0 / np.sqrt(2.0 * samples) + 0.02)  # 2 %: one chip against the next
    assert np.all(predicted.bound_px[0] < predicted.linear_px["cog"][0])
    np.testing.assert_allclose(predicted.bound_px[0], predicted.linear_px["epsf"][0], rtol=0.02)


def test_saturated_stars_are_refused(scene, bench, small_camera):
    with pytest.raises(DomainError, match=r"200000 e- per frame: saturated at 6 of 6 places.*lower signal_e"):
        measure_temporal(bench, small_camera, levels_e=[2e5], place_px=PLACE, streams=Streams(1), scene=scene)


def test_faint_stars_are_refused(small_camera, bench, engine):
    faint = replace(bench, signal_e=30.0)
    with pytest.raises(DomainError, match="detected"):
        measure_temporal(faint, small_camera, place_px=PLACE, streams=Streams(1))


def test_the_image_steps_as_told(steps):
    step_px = np.diff(steps.photon_px, axis=0).mean(1)
    np.testing.assert_allclose(step_px, 0.25 / np.sqrt(2.0), rtol=0.01)  # distortion and field change the scale
    assert steps.motion_px.max() < 1e-3


def test_the_s_curve_is_that_of_the_sampled_psf(steps, bench, small_camera, psf):
    predicted = predict_high_frequency(
        replace(bench, frames=8), small_camera, StepConfig(positions=3, step_px=0.25), psf=psf, place_px=PLACE, draws=20
    )
    for method in ("cog", "gaussian"):
        seen = steps.effect_px(method, "s_curve")[0]
        assert np.abs(seen).max() > 5e-3
        np.testing.assert_allclose(seen, predicted.method[method].s_curve_px, atol=2e-3)
    assert np.abs(steps.effect_px("epsf", "s_curve")[0]).max() < 5e-4


@pytest.mark.slow
def test_faint_fits_are_biased_by_noise_as_predicted(bench, small_camera, psf):
    """On frames of a chip without patterns: to first order in the noise such a fit is right to 5e-4 px."""
    clean = replace(small_camera, detector=switched(small_camera.detector, ()))
    faint, plan = replace(bench, frames=1000, signal_e=400.0, methods=("epsf",)), StepConfig(positions=3, step_px=0.25)
    of = predict_high_frequency(faint, clean, plan, psf=psf, place_px=PLACE, draws=2, noise_draws=200).method["epsf"]
    seen = measure_high_frequency(
        faint, clean, IDEAL, plan, place_px=PLACE, split=False, subtraction="raw", streams=Streams(4)
    )
    error = seen.mean_px("epsf") - seen.photon_px
    assert np.sqrt((of.s_curve_px**2).mean()) > 3e-3
    # sizes agree; the noise of the frames and of the draws, 2e-3 px each, makes 0.1 of it
    assert (error * of.s_curve_px).sum() / (of.s_curve_px**2).sum() == pytest.approx(1.0, abs=0.3)


def test_a_cause_alone_and_switched_off_agree(steps):
    (alone, one), (off, other) = (steps.effect_px("epsf", "prnu", alone=which) for which in (True, False))
    assert 5e-4 < np.sqrt((alone**2).mean()) < 0.02
    noise = np.hypot(one, other) / np.sqrt(8)
    assert np.all(np.abs(alone - off) < 6.0 * noise + 2e-4)  # sigma of 8 frames is itself uncertain by a quarter


def test_switching_a_cause_off_keeps_the_other_patterns(small_camera):
    chip = switched(small_camera.detector, ("prnu",))
    assert (chip.prnu, chip.dsnu_e, chip.hot_fraction) == (small_camera.detector.prnu, 0.0, 0.0)
    assert chip.sensor_seed == small_camera.detector.sensor_seed


def test_raw_frames_keep_the_pattern_and_dark_subtraction_takes_it(scene, bench, small_camera):
    light = scene.light(star_target_directions(bench, small_camera, PLACE), Streams(5), "here")
    error = {}
    for subtraction in ("dark", "raw"):
        frames = read_points(light, bench, small_camera, streams=Streams(5), subtraction=subtraction)
        error[subtraction] = np.sqrt(((frames.mean_px("epsf") - light.photon_px) ** 2).mean())
    assert error["raw"] > error["dark"]


@pytest.mark.slow
def test_distortion_numbers_agree_with_prediction(small_camera, bench_of, engine):
    bench = bench_of(methods=("epsf",), frames=10, window_px=15, signal_e=6000.0)
    target = GridTargetConfig(edge_px=60.0)
    measured = measure_distortion(bench, small_camera, target, surveys=150, streams=Streams(2))
    predicted = predict_distortion(bench, small_camera, target, measured.direction, psf=measured.light.psf)
    for reference in ("aligned", "calibrated"):
        seen = np.sqrt((measured.over_surveys("epsf", reference) ** 2).mean(0))
        apart = np.abs(seen - predicted.mean_px["epsf"][reference])
        np.testing.assert_array_less(apart, 4.0 * predicted.of_surveys_px("epsf", reference, 150))
    assert np.abs(predicted.bundle_px - measured.light.bundle_px).max() < 1e-4
