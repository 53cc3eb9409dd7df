"""Displacement damage: moments of the compound law, the published factor, temperature, and windows."""

import dataclasses
from typing import Any

import numpy as np
import pytest

from render.detector.displacement_damage import aged, damage_factor
from render.detector.maps import sensor_maps
from render.detector.spec import load_detector

NEW = dataclasses.replace(load_detector("cmv4000"), chip_width_px=1024, chip_height_px=512, dark_reference_c=26.85)
N = 1024 * 512


def increase(**options: Any) -> np.ndarray:
    """Dark current that the damage adds [e-/s], float64."""
    old = dataclasses.replace(NEW, dark_current_e_per_s=0.0, dark_spread_e_per_s=0.0, hot_fraction=0.0)
    return sensor_maps(aged(old, **options)).dark_current_e_per_s.astype(float)


@pytest.mark.parametrize(("dose", "volume"), [(100.0, 40.0), (2000.0, 90.0)])
def test_mean_is_the_published_factor(dose: float, volume: float) -> None:
    """1.9e5 e-/s per cm3 and MeV/g at 300 K, a week after; 0.095 and 4.3 centres per pixel; N = 2^19, 4 sigma."""
    found = increase(displacement_dose_tev_per_g=dose, depleted_volume_um3=volume)
    wanted = 1.9e5 * (dose * 1e6) * (volume * 1e-12)
    detector = aged(NEW, displacement_dose_tev_per_g=dose, depleted_volume_um3=volume)
    number, each = detector.damage_centres_per_px, detector.damage_dark_e_per_s
    assert abs(found.mean() - wanted) < 4 * each * np.sqrt(2 * number / N)
    # compound Poisson of exponentials: variance 2 n e^2, fourth central moment 24 n e^4 + 3 variance^2
    error = np.sqrt((24 * number + 8 * number**2) / N) * each**2
    assert abs(found.var() - 2 * number * each**2) < 4 * error
    hit = 1 - np.exp(-number)
    assert abs((found > 0).mean() - hit) < 4 * np.sqrt(hit * (1 - hit) / N)


def test_more_dose_keeps_the_hot_pixels() -> None:
    less, more = (increase(displacement_dose_tev_per_g=d, depleted_volume_um3=50.0) for d in (100.0, 300.0))
    assert np.all(more >= less)
    assert (more > less).any()


def test_temperature() -> None:
    """Doubles every 8.5 K about 300 K (0.63 eV), falls with annealing; right at the temperature that was asked for."""
    assert damage_factor(26.85 + 4.25) / damage_factor(26.85 - 4.25) == pytest.approx(2.0, rel=0.01)
    assert damage_factor(20.0, annealed_s=5e6) < 0.75 * damage_factor(20.0)
    cold = aged(NEW, displacement_dose_tev_per_g=100.0, depleted_volume_um3=50.0, temperature_c=-20.0)
    there = cold.damage_dark_e_per_s * cold.dark_factor(-20.0) * cold.damage_centres_per_px
    assert there == pytest.approx(damage_factor(-20.0) * 100.0 * 50.0, rel=1e-12)


def test_unknown_defects_and_known_ones() -> None:
    dose: dict[str, float] = {"displacement_dose_tev_per_g": 300.0, "depleted_volume_um3": 50.0}
    before = sensor_maps(NEW)
    unknown, known = (
        sensor_maps(aged(NEW, **dose)),
        sensor_maps(aged(dataclasses.replace(NEW, damage_known_e_per_s=5000.0), **dose)),
    )
    assert np.array_equal(unknown.defect, before.defect)
    added = known.dark_current_e_per_s.astype(float) - before.dark_current_e_per_s
    surely = np.abs(added - 5000.0) > 1.0
    assert np.array_equal((known.defect & ~before.defect)[surely], ((added > 5000.0) & ~before.defect)[surely])
    assert np.array_equal(known.offset_dn, before.offset_dn)
