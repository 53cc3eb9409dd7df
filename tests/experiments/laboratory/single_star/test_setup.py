"""What of a single-star bench can be refused before anything is rendered."""

import numpy as np
import pytest
from refusals import refuses

from experiments.harness.config import load_config
from experiments.laboratory.devices.turntable import build_turntable
from experiments.laboratory.single_star.settings import SingleStarConfig, TurntableConfig
from experiments.laboratory.single_star.setup import build_table, check_table, grid_px
from optics.errors import ConfigError, DomainError


def _table(**changes) -> TurntableConfig:
    settings = {"axes": "xy", "reading_noise_arcsec": (0.3,), "non_orthogonality_arcsec": (5.0,)}
    return TurntableConfig(**(settings | changes))


def test_readings_average() -> None:
    table = build_turntable("xy", reading_noise_arcsec=(0.3, 0.4)).averaged(9)
    np.testing.assert_allclose(table.reading_noise_arcsec, [0.1, 0.4 / 3])


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        (["grid.columns=1"], "cover 0% of the detector's width"),
        (["grid.edge_px=900"], "at least 50% of both"),
        (["grid.edge_px=3000"], "leaves no area"),
        (["grid.columns=150"], "places lie 27 px apart"),
    ],
)
def test_grids_that_do_not_do(settings: list[str], words: str, star_camera) -> None:
    refuses(DomainError, words, lambda: grid_px(load_config(SingleStarConfig, settings=settings), star_camera))


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"axes": "xx"}, "two_axis.axes = 'xx': neighbouring axes are the same"),
        ({"axes": "x-x"}, "two_axis.axes = 'x-x': neighbouring axes are the same"),
        ({"axes": "xq"}, "two_axis.axes: .*'xq'; letters x, y, z"),
        ({"axes": "x"}, "2 axes are needed, 1 given"),
        ({"reading_noise_arcsec": (1, 2, 3)}, "3 values where 2 are needed"),
        ({"non_orthogonality_arcsec": (1, 2)}, "2 values where 1"),
    ],
)
def test_tables_that_do_not_do(changes, words: str) -> None:
    refuses(ConfigError, words, lambda: check_table("two_axis", _table(**changes), 2))


def test_one_number_stands_for_all_axes() -> None:
    table = build_table(_table(axes="xyz", reading_noise_arcsec=(0.7,)))
    np.testing.assert_array_equal(table.reading_noise_arcsec, [0.7, 0.7, 0.7])
