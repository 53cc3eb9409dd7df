"""The temporal-error test from the command line to its report, against closed forms that share no code with it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import map_coordinates

from experiments.harness.config import load_config
from experiments.harness.progress import Progress
from experiments.laboratory.bench.point_laboratory import point_laboratory
from experiments.laboratory.bench.points import point_scene
from experiments.laboratory.temporal_error import target_place
from experiments.temporal.experiment import run as measure
from experiments.temporal.settings import Config
from render.engine.random import Streams

slow = pytest.mark.slow

FRAMES, STARS = 40, 6


@pytest.fixture(scope="module")
def run(tiny_run):
    small = {"target__rows": 2, "target__columns": 3, "target__pitch_px": 45.1, "target__edge_px": 40}
    return tiny_run("temporal", **small, compare=["epsf"], frames=FRAMES, draws=20, brightness__levels=2)


def test_a_run_by_rays_sets_the_levels_and_scatters_as_predicted(engine, tmp_path):
    """Levels set without error are even in magnitudes; 240 positions each: five standard deviations."""
    (tmp_path / "tiny.toml").write_text('base = "cmv4000"\nname = "tiny"\nchip_width_px = 288\nchip_height_px = 256\n')
    target = ["target.rows=2", "target.columns=3", "target.pitch_px=45.1", "target.edge_px=40"]
    light = ["brightness.levels=2", "brightness.setting_error_ratio=0", f"frames={FRAMES}", "draws=20", "compare=[]"]
    sensor = [f"instrument.detector={tmp_path / 'tiny.toml'}", "instrument.diffraction=rays"]
    config = load_config(Config, settings=[*target, *light, *sensor])
    result = measure(config, progress=Progress())
    ends = [config.brightness.lowest_e, config.brightness.highest_e]
    np.testing.assert_allclose([one.signal_e for one in result["levels"]], ends)
    assert result["frames"].stars == STARS
    for one in [*result["levels"], result["nominal"]]:
        for ratio, over in zip(one.ratio[0], one.over_bound[0], strict=True):
            assert ratio.value == pytest.approx(1.0, abs=5.0 * ratio.uncertainty)
            assert ratio.uncertainty < 0.13
            assert over.value > 0.8
    assert result["levels"][0].bound_arcsec[0] > 4.0 * result["levels"][1].bound_arcsec[0]


@pytest.fixture(scope="module")
def laboratory(run):
    """Instrument of the run, and the light of its target."""
    bench, instrument = point_laboratory(run.config, run.config.target)
    light = point_scene(bench, instrument).light(target_place(bench, instrument), Streams(0), "here")
    return instrument, light


def floor_e2(instrument):
    """Variance of a dark pixel [e-^2]: log-normal read noise, dark charge, rounding."""
    chip, config = instrument.detector, instrument.config
    read = chip.read_noise_e**2 * np.exp(2.0 * chip.read_noise_spread**2)
    dark = chip.dark_current_e_per_s * chip.dark_factor(config.chip_temperature_c) * config.exposure_s
    return read + dark + 1.0 / (12.0 * chip.gain_dn_per_e**2)


def bounds_px(run, laboratory):
    """Cramer-Rao bounds (j, 2) of place and flux: Fisher information of Poisson light in normal noise.

    The pixels' light is the sampled PSF read by a cubic spline of SciPy's, its slopes are finite differences.
    """
    (instrument, light), signal = laboratory, run.results["signal_e"]
    index = np.arange(light.light_e.shape[1])
    bounds = []
    for (x, y), corner, psf in zip(light.bundle_px, light.corner_px, light.psf, strict=True):

        def pixels(dx, dy, x=x, y=y, corner=corner, psf=psf):
            middle = (len(psf.values) - 1) / 2
            columns, rows = (index + corner[0] - x - dx), (index + corner[1] - y - dy)
            grid = np.meshgrid(middle + psf.oversampling * rows, middle + psf.oversampling * columns, indexing="ij")
            return signal * map_coordinates(psf.values, grid, order=3, mode="constant")

        h = 0.02
        slopes = [
            (pixels(h, 0.0) - pixels(-h, 0.0)) / (2 * h),
            (pixels(0.0, h) - pixels(0.0, -h)) / (2 * h),
            pixels(0.0, 0.0) / signal,
        ]
        variance = np.maximum(pixels(0.0, 0.0), 0.0) + floor_e2(instrument)
        information = np.array([[(a * b / variance).sum() for b in slopes] for a in slopes])
        bounds.append(np.sqrt(np.diag(np.linalg.inv(information))[:2]))
    return np.array(bounds)


@slow
def test_the_bound_is_that_of_the_fisher_information(run, laboratory):
    assert run.status == 0
    expected = 3.0 * laboratory[0].pixel_arcsec * bounds_px(run, laboratory).mean(0)
    stated = run.results["cramer_rao_arcsec_3sigma"]
    np.testing.assert_allclose([stated["x"], stated["y"]], expected, rtol=0.01)


@slow
def test_the_fit_scatters_as_the_bound_and_the_centre_of_gravity_as_its_own_sum(run, laboratory):
    """Centre of gravity: variance = sum (x - mean)^2 (light + floor) / flux^2, exact to first order in the noise."""
    instrument = laboratory[0]
    light = laboratory[1].light_e[:, 3:10, 3:10]  # it sums 7 x 7 of the 13 x 13 pixels
    index, flux = np.arange(light.shape[1]), light.sum((1, 2))
    gravity = []
    for axis in (2, 1):  # columns are x
        profile = light.sum(3 - axis)
        lever = index - (profile @ index / flux)[:, None]
        variance = (light + floor_e2(instrument)).sum(3 - axis)
        gravity.append(np.sqrt((lever**2 * variance).sum(1)) / flux)
    scale = 3.0 * instrument.pixel_arcsec
    expected = {"epsf": scale * bounds_px(run, laboratory).mean(), "cog": scale * np.mean(gravity)}
    limit = 4.0 / np.sqrt(2.0 * 2 * STARS * FRAMES) + 0.03  # of a standard deviation; one chip against the next
    for method, value in expected.items():
        measured = run.results["temporal_error_arcsec_3sigma"][method]
        assert np.mean([measured[axis]["value"] for axis in "xy"]) == pytest.approx(value, rel=limit)
    predicted = run.results["predicted_linear_arcsec_3sigma"]["cog"]
    np.testing.assert_allclose([predicted[axis] for axis in "xy"], scale * np.mean(gravity, axis=1), rtol=0.01)


@slow
def test_the_verdicts_hold_for_other_seeds_and_notice_a_quarter(run, failing):
    """By rays: noise is what differs. Four verdicts of a false alarm of 1 in 1000 each."""
    instrument = run.config.instrument.model_copy(update={"diffraction": "rays"})
    alarms = []
    for seed in range(3):
        config = run.config.model_copy(update={"seed": seed, "instrument": instrument})
        alarms += failing("temporal", measure(config, progress=Progress()), config)
    assert not alarms

    def scaled(record, factor):
        cells = [[replace(one, value=factor * one.value) for one in row] for row in record.ratio]
        return replace(record, ratio=cells)

    for factor in (0.75, 1.25):
        wrong = {**run.result, "levels": [scaled(one, factor) for one in run.result["levels"]]}
        assert "temporal error over all levels" in " ".join(failing("temporal", wrong, run.config))
