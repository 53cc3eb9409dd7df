"""The chromatic test from end to end: what it writes, and whether frames, truth and prediction agree as they must."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from astropy.table import Table

from experiments.chromatic.settings import Config

SMALL = {
    "frames": 4,
    "dark_frames": 10,
    "target.rows": 2,
    "target.columns": 2,
    "stars.grid": 2,
    "stars.temperatures_k": "[3000, 5800, 30000]",
    "compare": '["cog"]',
    "instrument.diffraction": "rays",
}


@pytest.fixture(scope="module")
def outcome(tiny_run, small_detector):
    """One small run through the command line."""
    settings = {key.replace(".", "__"): value for key, value in SMALL.items()}
    return tiny_run("chromatic", **settings, seed=5, instrument__detector=small_detector)


@pytest.fixture(scope="module")
def summary(outcome):
    return json.loads((outcome.folder / "summary.json").read_text(encoding="utf-8"))


@pytest.fixture(scope="module")
def result(outcome):
    return outcome.result


@pytest.mark.slow
def test_all_criteria_hold(outcome, summary):
    assert [one["name"] for one in summary["criteria"] if one["passed"] is False] == []
    assert outcome.status == 0


@pytest.mark.slow
def test_eq_16_from_the_points_table(outcome, summary):
    """The table of single shifts must give Table 1 by plain arithmetic: mean of all points, halved."""
    points = Table.read(outcome.folder / "points.ecsv", format="ascii.ecsv")
    assert len(points) == 2 * 2 * 4 * 4  # lenses, pairs, positions, points
    for name, entry in summary["results"]["table1_px"].items():
        mine = points[(points["lens"] == "centred") & (points["bands"] == name)]
        for axis in "xy":
            assert np.mean(mine[f"measured_{axis}_px"]) / 2 == pytest.approx(entry[axis], abs=1e-12)
            rms = np.sqrt(np.mean(np.square(mine[f"measured_{axis}_px"])))
            assert rms == pytest.approx(summary["results"]["rms_shift_px"][name][axis])


@pytest.mark.slow
def test_lsfe_is_the_largest_entry_in_arcseconds(summary):
    """ACC18: divided by 3, times 3 sigma, times 5.5 arcsec per pixel."""
    results = summary["results"]
    for axis in "xy":
        largest = max(abs(entry[axis]) for entry in results["table1_px"].values())
        assert results["lsfe_s_arcsec_3sigma"][axis]["value"] == pytest.approx(largest * 5.5, rel=2e-3)
    moved = results["decentre_solution"]["lsfe_s_arcsec_3sigma"]["x"]
    assert abs(moved["value"] - 0.66) < 4 * moved["uncertainty"]  # what ACC18 publishes for 0.12 px
    assert moved["uncertainty"] < 0.02


@pytest.mark.slow
def test_prediction_agrees_with_the_noiseless_pixels(result):
    """First moments of rendered pixels alias what a spot passes at one cycle per pixel: up to some 1e-2 px a point."""
    for lens in result["points"]:
        assert np.abs(lens.predicted_shift_px).max((1, 2)).min() > 0.03
        assert np.abs(lens.pixels_shift_px - lens.predicted_shift_px).max() < 0.1


@pytest.mark.slow
def test_moved_element_gives_the_published_mean_in_the_noiseless_pixels(result):
    (solved,) = (s for s in result["elements"] if s.amount == result["movement"].amount)
    assert solved.table1_px[1] == pytest.approx([0.12, 0.0], abs=1e-6)
    # the trace on NumPy weighs rays equally: their transmissions move the mean by 0.06 %
    assert result["table1"][1].predicted_table1_px[1] == pytest.approx([0.12, 0.0], abs=1e-4)
    for one, wanted in zip(result["table1"][1].pixels_table1_px[1], [0.12, 0.0], strict=True):
        assert one.uncertainty < 0.01
        assert one.value == pytest.approx(wanted, abs=4 * one.uncertainty)
    assert result["movement"].kind == "decentre"
    others = [abs(s.amount) for s in result["elements"] if s.kind == "decentre" and np.isfinite(s.amount)]
    assert abs(result["movement"].amount) == min(others)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("section", "column", "title"),
    [("table1", "table1_px", "ACC18 Table 1"), ("points", "measured_shift_px", "Shift of single points")],
)
def test_a_quarter_of_the_shift_is_noticed(outcome, failing, section, column, title):
    """Rationale: frames of another lens. Expected: the verdict on that number, and no other, does not hold."""
    centred, moved = outcome.result[section]
    shifted = np.vectorize(lambda one: replace(one, value=1.25 * one.value))(getattr(moved, column))
    result = {**outcome.result, section: [centred, replace(moved, **{column: shifted})]}
    (name,) = failing("chromatic", result, outcome.config)
    assert name.startswith(title)


def test_defaults_are_the_published_run():
    config = Config()
    assert (config.target.rows, config.target.columns, config.frames) == (5, 5, 30)
    assert config.filters.centres_nm == (500.0, 600.0, 800.0)
    assert (config.filters.reference_nm, config.filters.width_nm) == (600.0, 100.0)
    assert config.decentre.wanted_px == 0.12
