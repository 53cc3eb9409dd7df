"""LSFE-T: what a housing and a glass do to the scale of an image, in closed form where there is one."""

from types import SimpleNamespace

import numpy as np
import pytest

from experiments.budget import thermal
from experiments.budget.experiment import axes
from experiments.budget.laboratory import build_laboratory
from experiments.budget.settings import BudgetConfig
from experiments.budget.thermal import GRID, THERMAL, field_directions, thermal_term, with_lens_offset
from experiments.harness.config import load_config
from experiments.harness.quantities import Outcome
from experiments.harness.sections import described, judged
from experiments.laboratory.bench.ray_prediction import bundle_prediction
from render.engine.random import Streams

QUICK = ["compare=[]", "frames=10", "dark_frames=20"]


def test_the_image_grows_as_focal_length_and_housing_say(engine):
    """Per kelvin 33e-6 in aluminium and 25e-6 in titanium: figures of the lens that were found apart from this code."""
    for housing, expected in (("aluminium_6061", 33.0), ("titanium_ti6al4v", 25.0), ("invar_36", 21.0)):
        lab = build_laboratory(load_config(BudgetConfig, settings=[*QUICK, f"instrument.housing={housing}"]))
        direction = field_directions(lab)
        cold, warm = (
            bundle_prediction(end.bench, end.instrument, direction[None])[0, :, 0]
            for end in (with_lens_offset(lab, -1.0), with_lens_offset(lab, 1.0))
        )
        radius = cold - cold.mean(0)
        growth = ((warm - cold) * radius).sum() / (2.0 * (radius**2).sum()) * 1e6
        assert growth == pytest.approx(expected, abs=1.5)  # of the chief ray; coma adds one to the mean of all light


@pytest.mark.parametrize("flipped", [False, True])
def test_verdict_notices_a_lens_that_is_warmed_the_wrong_way(engine, monkeypatch, flipped):
    """Rationale: traced images with noise for frames. Expected: growth with temperature, or the verdict fails."""
    lab = build_laboratory(load_config(BudgetConfig, settings=[*QUICK, "thermal.stability_k=3"]))
    noise = np.random.default_rng(3)

    def exact(lab, cold_warm, direction, streams):
        if flipped:
            cold_warm = cold_warm[::-1]
        traced = [bundle_prediction(end.bench, end.instrument, direction[None])[0, :, 0] for end in cold_warm]
        return [traced_px + 0.005 * noise.standard_normal(traced_px.shape) for traced_px in traced]

    monkeypatch.setattr(thermal, "_measure_centroids", exact)
    term = thermal_term(lab, Streams(5))
    measured_ppm_per_k = [axis.value for axis in term.measured_scale_ppm_per_k]
    np.testing.assert_allclose(measured_ppm_per_k, -33.0 if flipped else 33.0, atol=3.0)
    np.testing.assert_allclose(term.scale_ppm_per_k, term.paraxial_ppm_per_k, atol=2.0)
    section, result = {"thermal": THERMAL}, {"thermal": term}
    outcome = Outcome(config=lab.config, result=result, data=described(section, axes(lab.config), result).dataset)
    (criterion,) = judged(section, outcome)
    assert criterion.passed is not flipped


@pytest.mark.slow
def test_frames_show_the_growth(engine):
    settings = [*QUICK, "thermal.stability_k=3", "instrument.diffraction=rays"]
    lab = build_laboratory(load_config(BudgetConfig, settings=settings))
    term = thermal_term(lab, Streams(5))
    seen, sigma = (
        np.array([getattr(m, part) for m in term.measured_scale_ppm_per_k]) for part in ("value", "uncertainty")
    )
    assert np.all(np.abs(seen - term.scale_ppm_per_k) < 4.0 * sigma)
    assert np.all(sigma < 0.15 * term.scale_ppm_per_k)
    # the paraxial chief ray shares no trace with the mean of all light, to which coma adds as the focus changes
    np.testing.assert_allclose(term.scale_ppm_per_k, term.paraxial_ppm_per_k, atol=2.0)
    # a field that grows about its middle: RMS per axis is the growth times the half width over root three
    half = np.array([lab.instrument.camera.width_px, lab.instrument.camera.height_px]) / 2.0
    expected = half / np.sqrt(3.0) * term.scale_ppm_per_k * 1e-6 * 3.0 * lab.instrument.pixel_arcsec
    np.testing.assert_allclose(term.predicted_arcsec, expected, rtol=0.04)  # eight and six cells a side
    for one, wanted in zip(term.measured_arcsec, expected, strict=True):
        assert one.value == pytest.approx(wanted, abs=5.0 * one.uncertainty)


def test_stars_are_spread_over_the_detector_at_all_fractions_of_a_pixel(star_camera):
    camera = star_camera.camera
    direction = field_directions(SimpleNamespace(instrument=star_camera))
    tangent = star_camera.focal_length_mm * direction[:, :2] / direction[:, 2:] / camera.pixel_pitch_mm
    pixel = tangent + np.array(camera.centre_px)
    size = np.array([camera.width_px, camera.height_px]) / GRID
    cell = np.floor((pixel + 0.5) / size).astype(int)
    assert len(set(map(tuple, cell))) == GRID[0] * GRID[1]
    assert (cell >= 0).all() and (cell < GRID).all()  # noqa: PT018
    centre = (cell + 0.5) * size - 0.5
    assert ((pixel - centre) >= -1e-6).all()
    assert ((pixel - centre) < 1.0).all()
    # cell centres have one pixel phase per row; spread evenly they leave at most gaps of a few over the number of stars
    fractions = np.sort(np.mod(pixel, 1.0), axis=0)
    assert np.diff(fractions, axis=0).max() < 4.0 / len(pixel)
