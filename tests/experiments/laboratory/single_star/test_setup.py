"""What of a single-star bench can be refused before anything is rendered."""

import numpy as np

from experiments.laboratory.devices.turntable import build_turntable
from experiments.laboratory.single_star.settings import TurntableConfig
from experiments.laboratory.single_star.setup import build_table


def _table(**changes) -> TurntableConfig:
    settings = {"axes": "xy", "reading_noise_arcsec": (0.3,), "non_orthogonality_arcsec": (5.0,)}
    return TurntableConfig(**(settings | changes))


def test_readings_average() -> None:
    table = build_turntable("xy", reading_noise_arcsec=(0.3, 0.4)).averaged(9)
    np.testing.assert_allclose(table.reading_noise_arcsec, [0.1, 0.4 / 3])


def test_one_number_stands_for_all_axes() -> None:
    table = build_table(_table(axes="xyz", reading_noise_arcsec=(0.7,)))
    np.testing.assert_array_equal(table.reading_noise_arcsec, [0.7, 0.7, 0.7])
