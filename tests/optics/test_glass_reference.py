"""The whole catalogue against opticalglass, which reads the makers' own spreadsheets."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
import pytest

from optics.glass import get_glass, list_glasses

pytestmark = pytest.mark.reference

LINES_NM = (365.015, 404.656, 435.835, 486.1327, 546.074, 587.5618, 656.2725, 706.519, 800.0, 852.11, 900.0, 1013.98)


@pytest.fixture(scope="module")
def create() -> Any:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # its spreadsheet readers warn
        factory = pytest.importorskip("opticalglass.glassfactory")
        for name, catalogue in (("N-BK7", "Schott"), ("S-BSL7", "Ohara"), ("H-K9L", "CDGM")):
            factory.create_glass(name, catalogue)
    return factory.create_glass


def largest_difference(name: str, catalogue: str, create: Any) -> float:
    glass = get_glass(name)
    lines = [line for line in LINES_NM if line >= max(glass.range_nm[0], 404.0 if catalogue == "CDGM" else 0.0)]
    other = create(name, catalogue)
    return float(np.abs(glass.index(lines) - np.array([other.rindex(line) for line in lines])).max())


@pytest.mark.parametrize(("maker", "catalogue"), [("SCHOTT", "Schott"), ("OHARA", "Ohara")])
def test_indices_agree_to_one_part_in_1e9(maker: str, catalogue: str, create: Any) -> None:
    names = [name for name in list_glasses(maker) if not name.startswith("LITHO")]  # crystals are not in its tables
    assert len(names) > 90
    assert max(largest_difference(name, catalogue, create) for name in names) < 1e-9


def test_cdgm_editions_agree_within_melt_tolerance(create: Any) -> None:
    """opticalglass carries CDGM's power series of 2018-09, we the Sellmeier fit of 2022-06: different measurements."""
    names = list_glasses("CDGM")
    assert len(names) > 50
    assert max(largest_difference(name, "CDGM", create) for name in names) < 7e-5
