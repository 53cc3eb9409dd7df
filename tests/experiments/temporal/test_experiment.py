"""The temporal-error test from the command line to its report, against closed forms that share no code with it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import map_coordinates

from experiments.harness.progress import Progress
from experiments.laboratory.temporal_error import temporal_error_arcsec
from experiments.temporal.settings import experiment
from render.sensor import StarSensor

pytestmark = pytest.mark.slow

FRAMES, STARS = 40, 6


@pytest.fixture(scope="module")
def run(tiny_run):
    small = {"target__rows": 2, "target__columns": 3, "target__pitch_px": 45.1, "target__edge_px": 40}
    return tiny_run("temporal", **small, compare=["epsf"], frames=FRAMES, draws=20, brightness__levels=2)


def floor_e2(instrument):
    """Variance of a dark pixel [e-^2]: log-normal read noise, dark charge, rounding."""
    chip, config = instrument.detector, instrument.config
    read = chip.read_noise_e**2 * np.exp(2.0 * chip.read_noise_spread**2)
    dark = chip.dark_current_e_per_s * chip.dark_factor(config.chip_temperature_c) * config.exposure_s
    return read + dark + 1.0 / (12.0 * chip.gain_dn_per_e**2)


def test_the_run_is_complete(run):
    assert run.status == 0
    assert (run.folder / "report.html").stat().st_size > 50_000
    names = {"levels.ecsv", "stars.ecsv", "temporal_error.ecsv", "results.nc", "summary.json", "provenance.json"}
    assert names < {path.name for path in run.folder.iterdir()}


def bounds_px(run):
    """Cramer-Rao bounds (j, 2) of place and flux: Fisher information of Poisson light in normal noise.

    The pixels' light is the sampled PSF read by a cubic spline of SciPy's, its slopes are finite differences.
    """
    light, signal = run.result.nominal.light, run.results["signal_e"]
    index = np.arange(light.light_e.shape[1])
    found = []
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
        variance = np.maximum(pixels(0.0, 0.0), 0.0) + floor_e2(run.result.instrument)
        information = np.array([[(a * b / variance).sum() for b in slopes] for a in slopes])
        found.append(np.sqrt(np.diag(np.linalg.inv(information))[:2]))
    return np.array(found)


def test_the_bound_is_that_of_the_fisher_information(run):
    expected = 3.0 * run.result.instrument.pixel_arcsec * bounds_px(run).mean(0)
    found = run.results["cramer_rao_arcsec_3sigma"]
    np.testing.assert_allclose([found["x"], found["y"]], expected, rtol=0.01)


def test_the_fit_scatters_as_the_bound_and_the_centre_of_gravity_as_its_own_sum(run):
    """Centre of gravity: variance = sum (x - mean)^2 (light + floor) / flux^2, exact to first order in the noise."""
    light = run.result.nominal.light.light_e[:, 3:10, 3:10]  # it sums 7 x 7 of the 13 x 13 pixels
    index, flux = np.arange(light.shape[1]), light.sum((1, 2))
    gravity = []
    for axis in (2, 1):  # columns are x
        profile = light.sum(3 - axis)
        lever = index - (profile @ index / flux)[:, None]
        variance = (light + floor_e2(run.result.instrument)).sum(3 - axis)
        gravity.append(np.sqrt((lever**2 * variance).sum(1)) / flux)
    scale = 3.0 * run.result.instrument.pixel_arcsec
    expected = {"epsf": scale * bounds_px(run).mean(), "cog": scale * np.mean(gravity)}
    limit = 4.0 / np.sqrt(2.0 * 2 * STARS * FRAMES) + 0.03  # of a standard deviation; one chip against the next
    for method, value in expected.items():
        measured = run.results["temporal_error_arcsec_3sigma"][method]
        assert np.mean([measured[axis]["value"] for axis in "xy"]) == pytest.approx(value, rel=limit)
    predicted = run.results["predicted_linear_arcsec_3sigma"]["cog"]
    np.testing.assert_allclose([predicted[axis] for axis in "xy"], scale * np.mean(gravity, axis=1), rtol=0.01)


# What an equation may be mistaken for, and the criterion that has to notice it.


def with_errors(change):
    """Another result of eq. 1-2: ``change`` of its two `Measured`."""
    return lambda sigma_px, pixel_arcsec, frames: change(*temporal_error_arcsec(sigma_px, pixel_arcsec, frames))


def times(factor):
    return with_errors(lambda *both: tuple(replace(one, value=factor * one.value) for one in both))


def of_rms(sigma_px, pixel_arcsec, frames):
    return temporal_error_arcsec(np.sqrt((sigma_px**2).mean(0, keepdims=True)), pixel_arcsec, frames)


@pytest.mark.parametrize(
    ("mutant", "noticed"),
    [
        pytest.param(times(1 / 3), "target that moves", id="one sigma for three"),
        pytest.param(times(2.0), "target that moves", id="doubled"),
        pytest.param(times(1 / np.sqrt(FRAMES)), "target that moves", id="error of the mean"),
        pytest.param(times(np.sqrt(1 - 1 / FRAMES)), "printed equation", id="divisor N for N - 1"),
        pytest.param(with_errors(lambda x, y: (y, x)), "target that moves", id="x and y exchanged"),
        pytest.param(with_errors(lambda x, y: (x, x)), "target that moves", id="x for y"),
        pytest.param(of_rms, "printed equation", id="RMS over the stars for their mean"),
    ],
)
def test_a_wrong_equation_is_noticed(run, broken, failing, mutant, noticed):
    broken(temporal_error_arcsec, mutant)
    assert [name for name in failing("temporal", run.result) if noticed in name]


@pytest.mark.parametrize("axis", [0, 1])
def test_a_shifted_centroid_is_noticed(run, failing, axis):
    nominal = run.result.nominal
    moved = nominal.position_px["cog"] + 0.3 * np.eye(2)[axis]
    result = replace(run.result, nominal=replace(nominal, position_px={**nominal.position_px, "cog": moved}))
    (name,) = failing("temporal", result)
    assert name.startswith("cog: centroid minus noiseless light")


def test_a_wrong_angle_of_a_pixel_is_noticed(run, failing, monkeypatch):
    right = run.result.instrument.pixel_arcsec
    monkeypatch.setattr(StarSensor, "pixel_arcsec", property(lambda self: 1.01 * right))
    assert "angle of a pixel over that of two traced bundles beside the axis" in failing("temporal", run.result)


def test_a_centroid_that_does_not_follow_is_noticed(run, failing):
    """Nine tenths of a motion, as a window that is too tight would show."""
    shaken = run.result.shaken
    seen = shaken.position_px["cog"]
    slow = seen - 0.1 * (seen - np.nanmean(seen, axis=0))
    result = replace(run.result, shaken=replace(shaken, position_px={**shaken.position_px, "cog": slow}))
    (name,) = failing("temporal", result)
    assert name.startswith("cog: temporal error of a target that moves")


def test_no_false_alarm_in_eight_runs(run, failing):
    """Criteria of this kind fail by chance once in a thousand times; there are three of them for each centroider.

    By rays: noise is what differs."""
    instrument = run.result.config.instrument.model_copy(update={"diffraction": "rays"})
    for seed in range(8):
        config = run.result.config.model_copy(update={"seed": seed, "instrument": instrument})
        found = failing("temporal", experiment.run(config, progress=Progress()))
        assert not [name for name in found if any(part in name for part in ("moves", "printed", "minus", "angle"))], (
            seed
        )
