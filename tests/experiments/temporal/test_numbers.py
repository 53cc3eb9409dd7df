"""Numbers of the temporal-error test from drawn positions, without frames."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from experiments.laboratory.bench.signal import Signal
from experiments.laboratory.temporal_error import TemporalMeasurement, TemporalPrediction
from experiments.temporal.experiment import tabulate_level, tabulate_stars

FRAMES, STARS, PIXEL_ARCSEC = 30, 50, 4.0
TRUE_PX = np.array([[[0.02, 0.03]] * STARS, [[0.05, 0.08]] * STARS])  # two levels
LEVELS_E = np.array([8000.0, 2000.0])


@pytest.fixture(scope="module")
def records():
    """Measured standard deviations of FRAMES normal positions, and the prediction they were drawn from."""
    drawn = np.random.default_rng(3).standard_normal((FRAMES, 2, STARS, 2)) * TRUE_PX
    light = SimpleNamespace(photon_px=np.arange(2.0 * STARS).reshape(STARS, 2))
    measured = TemporalMeasurement(
        levels_e=LEVELS_E,
        frames=FRAMES,
        pixel_arcsec=PIXEL_ARCSEC,
        sigma_px={"cog": drawn.std(0, ddof=1)},
        light=light,
        position_px={"cog": drawn.swapaxes(0, 1)},
        motion_px2=np.zeros((2, 2, 2)),
    )
    none = {"cog": np.zeros_like(TRUE_PX)}
    predicted = TemporalPrediction(
        levels_e=LEVELS_E,
        pixel_arcsec=PIXEL_ARCSEC,
        linear_px={"cog": 1.1 * TRUE_PX},
        device_px={"cog": 0.1 * TRUE_PX},
        sampled_px={"cog": TRUE_PX},
        draws=201,
        bound_px=0.5 * TRUE_PX,
        common_px=none,
        frames=FRAMES,
    )
    return measured, predicted


@pytest.mark.parametrize("level", [0, 1])
def test_ratios_leave_out_the_small_sample_factor(records, level):
    """3 sigma in arcsec; a ratio of 1 to 1/sqrt(2 n f); its error from frames, draws and chips."""
    star = Signal(signal_e=8000.0, magnitude_mag=5.0, temperature_k=6000.0)
    found = tabulate_level(*records, ["cog"], star, level)
    true = 3.0 * PIXEL_ARCSEC * TRUE_PX[level, 0]
    assert found.signal_e == LEVELS_E[level]
    assert tabulate_level(*records, ["cog"], star).signal_e == LEVELS_E[0]
    assert found.magnitude_mag == pytest.approx(5.0 + (0.0, 2.5 * np.log10(4.0))[level])
    np.testing.assert_allclose(found.predicted_arcsec[0], true)
    np.testing.assert_allclose(found.predicted_linear_arcsec[0], 1.1 * true)
    np.testing.assert_allclose(found.cramer_rao_arcsec, 0.5 * true)
    chance = 1.0 / np.sqrt(2.0 * (FRAMES - 1) * STARS)
    for one, over, seen, value in zip(
        found.ratio[0], found.over_cramer_rao[0], found.measured_arcsec[0], true, strict=True
    ):
        assert one.value == pytest.approx(1.0, abs=4.0 * chance)
        assert over.value == pytest.approx(2.0 * one.value)
        assert seen.value == pytest.approx(one.value * value * (1.0 - 1.0 / (4.0 * (FRAMES - 1))), rel=1e-3)
        apart = np.hypot(0.1, 1.0 / np.sqrt(2.0 * 200)) / np.sqrt(STARS)  # chips and draws of STARS stars
        assert one.uncertainty == pytest.approx(np.hypot(chance, apart), rel=0.05)
        assert over.uncertainty == pytest.approx(2.0 * chance, rel=0.05)
        assert one.n == FRAMES * STARS


def test_star_by_star(records):
    every = tabulate_stars(*records, "cog")
    assert len(every) == STARS
    pulls = np.array(
        [[(m.value - p) / m.uncertainty for m, p in zip(s.sigma_px, s.predicted_px, strict=True)] for s in every]
    )
    assert np.sqrt((pulls**2).mean()) == pytest.approx(1.0, abs=4.0 / np.sqrt(4 * STARS))
    np.testing.assert_allclose([s.cramer_rao_px for s in every], 0.5 * TRUE_PX[0])
    np.testing.assert_array_equal([s.light_px for s in every], records[0].light.photon_px)
