"""The whole catalogue against opticalglass, which reads the makers' own spreadsheets."""

import warnings
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from optics.glass.catalogue import get_glass, list_glasses

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
    absent = ("LITHO", "SCHOTT catalogue of 2018-06-01, radiation")  # crystals, radiation-resistant glasses
    names = [n for n in list_glasses(maker) if not (n.startswith(absent) or get_glass(n).source.startswith(absent))]
    assert len(names) > 90
    assert max(largest_difference(name, catalogue, create) for name in names) < 1e-9


def test_cdgm_editions_agree_within_melt_tolerance(create: Any) -> None:
    """opticalglass carries CDGM's power series of 2018-09, we the Sellmeier fit of 2022-06: different measurements."""
    names = list_glasses("CDGM")
    assert len(names) > 50
    assert max(largest_difference(name, "CDGM", create) for name in names) < 7e-5


def sheet(file: str) -> np.ndarray:
    """A maker's spreadsheet as opticalglass ships it, text where a cell holds none of our numbers."""
    reader = pytest.importorskip("opticalglass.glass")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return np.asarray(reader.xl2df(file), dtype=object)


def number(cell: object) -> float:
    try:
        return float(cell)  # type: ignore[arg-type]
    except (TypeError, ValueError):
        return float("nan")


def test_every_printed_temperature_coefficient_of_schott() -> None:
    """Columns of dn/dT at 1060 nm, e, g, relative then absolute, for -40/-20, 20/40, 60/80 C; printed to 0.1e-6/K."""
    lines, misses = np.array([1060.0, 546.074, 435.8343]), []
    for row in sheet("SCHOTT.xls"):
        if row[0] not in list_glasses("SCHOTT"):
            continue
        glass = get_glass(row[0])
        in_range = lines >= glass.range_nm[0]
        for column, start in ((18, -40.0), (24, 20.0), (30, 60.0)):
            for offset, index in ((0, glass.relative_index), (3, glass.absolute_index)):
                ours = index(lines[in_range], temperature_c=start + 20.0) - index(lines[in_range], temperature_c=start)
                printed = np.array([number(cell) for cell in row[column + offset : column + offset + 3]])[in_range]
                misses.append(np.abs(ours / 20.0 * 1e6 - printed))
    missed = np.concatenate(misses)
    missed = missed[np.isfinite(missed)]
    assert missed.size > 1600
    assert missed.max() < 0.057  # 0.05 of rounding, the rest constants printed to three digits and the air formula


def test_ohara_coefficients_are_those_of_25_celsius() -> None:
    """Seven lines, six temperature steps: rounding alone is 0.025e-6/K on average; taking 20 C would give 0.085."""
    lines = np.array([1013.98, 643.8469, 632.8, 589.29, 546.074, 479.9914, 435.8343])
    names = {str(row[1]).replace(" ", ""): row for row in sheet("OHARA.xlsx")}
    means = {}
    for reference in (25.0, 20.0):
        misses = []
        for name in list_glasses("OHARA"):
            glass = replace(get_glass(name), reference_temperature_c=reference)
            printed = np.array([number(cell) for cell in names[name][112:154]]).reshape(7, 6)
            edges = [glass.relative_index(lines, temperature_c=t) for t in np.arange(-40.0, 81.0, 20.0)]
            misses.append(np.abs(np.diff(edges, axis=0).T / 20.0 * 1e6 - printed))
        means[reference] = float(np.nanmean(misses))
    assert means[25.0] < 0.035
    assert means[20.0] > 2.0 * means[25.0]
