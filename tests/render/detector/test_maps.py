"""The patterns of one chip: their statistics, and that they belong to pixels and not to arrays."""

import dataclasses

import numpy as np

from render.detector.crosstalk import DISPLACEMENTS, neighbour_bits
from render.detector.maps import full_maps, sensor_maps, window_maps
from render.detector.spec import Detector, load_detector
from render.engine import Engine

CHIP = dataclasses.replace(load_detector("cmv4000"), chip_width_px=1024, chip_height_px=512, hot_fraction=0.0)
N = 1024 * 512


def clean(**changes: object) -> Detector:
    return dataclasses.replace(CHIP, **changes)  # type: ignore[arg-type]


def test_standard_deviations_are_those_of_the_data_sheet() -> None:
    """N = 2^19 pixels; a sample standard deviation of N normal values scatters by 1/sqrt(2N) relative."""
    maps = sensor_maps(clean(dead_fraction=0.0, column_pattern_e=0.0))
    tolerance = 4 / np.sqrt(2 * N)
    assert abs(maps.response.std(dtype=float) / 0.01 - 1) < tolerance
    assert abs(maps.response.mean(dtype=float) - 1) < 4 * 0.01 / np.sqrt(N)
    assert abs(maps.offset_dn.std(dtype=float) / (0.30 * 12.0) - 1) < tolerance
    assert abs(np.log(maps.read_noise_e / 13.0).std(dtype=float) / 0.1 - 1) < tolerance
    assert abs(np.median(maps.read_noise_e) / 13.0 - 1) < 4 * 0.1 * np.sqrt(np.pi / 2 / N)
    dark = maps.dark_current_e_per_s
    assert abs(dark.mean(dtype=float) - 125) < 4 * 40 / np.sqrt(N)
    kurtosis = 4.81  # of a log-normal with a relative standard deviation of 0.32
    assert abs(dark.std(dtype=float) / 40 - 1) < 4 * np.sqrt((kurtosis - 1) / 4 / N)
    assert dark.min() > 0
    assert not maps.defect.any()


def test_column_pattern_is_one_value_per_column() -> None:
    maps = sensor_maps(clean(dsnu_e=0.0, dead_fraction=0.0))
    assert np.ptp(maps.offset_dn, axis=0).max() == 0
    assert abs(maps.offset_dn[0].std(dtype=float) / (0.30 * 5.8) - 1) < 4 / np.sqrt(2 * 1024)


def test_defects_are_flagged_and_as_many_as_asked() -> None:
    maps = sensor_maps(clean(hot_fraction=0.01, dead_fraction=0.002))
    expected = N * (0.01 + 0.002 - 0.01 * 0.002)
    assert abs(maps.defect.sum() - expected) < 4 * np.sqrt(expected)
    assert (maps.response[maps.defect] == 0).sum() == (maps.response == 0).sum()
    hot = maps.defect & (maps.response > 0)
    extra = maps.dark_current_e_per_s[hot].mean(dtype=float) - 125
    assert abs(extra - 5000) < 4 * 5000 / np.sqrt(hot.sum())


def test_gap_is_insensitive_silent_and_flagged() -> None:
    maps = sensor_maps(clean(chips=2, gap_px=3))
    gap = np.s_[:, 1024:1027]
    assert maps.response.shape == (512, 2051)
    assert maps.defect[gap].all()
    assert not maps.response[gap].any()
    assert not maps.dark_current_e_per_s[gap].any()
    assert not maps.read_noise_e[gap].any()
    assert (maps.offset_dn[gap] == 40.0).all()
    assert maps.defect[:, :1024].mean() < 1e-3


def test_same_seed_same_chip_other_seed_other_chip() -> None:
    first, again = sensor_maps(clean()), sensor_maps(clean(sensor_seed=4000, full_well_e=5e4))
    other = sensor_maps(clean(sensor_seed=1))
    assert np.array_equal(first.response, again.response)
    assert abs(np.corrcoef(first.response.ravel(), other.response.ravel())[0, 1]) < 4 / np.sqrt(N)


def test_one_pattern_more_leaves_the_others() -> None:
    with_prnu, without = sensor_maps(clean()), sensor_maps(clean(prnu=0.0))
    assert np.array_equal(with_prnu.offset_dn, without.offset_dn)
    assert np.array_equal(with_prnu.read_noise_e, without.read_noise_e)


def test_neighbours_end_at_window_chip_and_array() -> None:
    detector = clean(chips=2)
    column, row = np.arange(1020, 1030)[None], np.arange(-1, 5)[None]
    bits = neighbour_bits(detector, column, row)[0]
    offsets = {(dx, dy): 1 << i for i, (dx, dy) in enumerate(DISPLACEMENTS)}
    everything = sum(offsets.values())
    assert not bits[0].any()  # row -1 is outside
    assert bits[3, 2] == everything
    assert bits[3, 3] == everything - sum(offsets[1, dy] for dy in (-1, 0, 1))  # column 1023, seam to the right
    assert bits[3, 4] == everything - sum(offsets[-1, dy] for dy in (-1, 0, 1))
    assert bits[1, 2] == everything - sum(offsets[dx, -1] for dx in (-1, 0, 1))  # row 0
    assert bits[3, 0] == everything - sum(offsets[-1, dy] for dy in (-1, 0, 1))  # edge of the window


def test_window_beyond_the_edge_continues_its_pixels() -> None:
    chip, types = clean(chip_width_px=64, chip_height_px=48), Engine.active().types
    column, row = np.arange(-3, 67)[None], np.arange(-2, 51)[None]
    window = window_maps(chip, types, column, row)
    for part, whole in zip(window[:4], full_maps(chip, types)[:4], strict=True):
        padded = np.pad(np.array(whole).reshape(48, 64), ((2, 3), (3, 3)), mode="edge")
        assert np.array_equal(np.array(part).reshape(53, 70), padded)
