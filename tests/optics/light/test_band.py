"""Bands: shape of the trapezoid, exactness and order of the nodes, the limit of a narrow line."""

from itertools import pairwise

import numpy as np
import pytest
from scipy.integrate import quad

from optics.light.band import Band, TabulatedBand, TopHat, band_nodes
from optics.light.spectrum import Blackbody

STAR = Blackbody(temperature_k=6000.0)


def curve(seed: int, points: int = 60) -> TabulatedBand:
    """A jagged filter curve with many more points than nodes."""
    value = np.random.default_rng(seed).uniform(0.2, 0.9, points)
    value[[0, -1]] = 0.0
    return TabulatedBand(name="jagged", source="test", wavelength_nm=np.linspace(520.0, 700.0, points), value=value)


def exact(band: Band, power: int) -> float:
    """Integral of ((l - 600) / 100)^power times the band, piece by piece with scipy."""
    edges = band.breakpoints_nm
    return sum(
        quad(lambda wave: ((wave - 600.0) / 100.0) ** power * float(band.transmission(wave)), low, high)[0]
        for low, high in pairwise(edges)
    )


def test_top_hat_is_half_at_its_width_and_straight_between() -> None:
    band = TopHat(centre_nm=600.0, width_nm=100.0, edge_nm=10.0, peak=0.9)
    wave = np.array([540.0, 545.0, 546.0, 550.0, 554.0, 555.0, 600.0, 645.0, 650.0, 655.0, 700.0])
    expected = 0.9 * np.array([0.0, 0.0, 0.1, 0.5, 0.9, 1.0, 1.0, 1.0, 0.5, 0.0, 0.0])
    assert band.transmission(wave) == pytest.approx(expected, abs=1e-14)
    assert band.breakpoints_nm == pytest.approx([545.0, 555.0, 645.0, 655.0])
    assert band.name == "600/100"
    assert isinstance(band, Band)


def test_area_of_a_top_hat_and_nodes_over_leading_axes() -> None:
    bands = [TopHat(centre_nm=600.0, width_nm=100.0, edge_nm=e) for e in (0.0, 5.0, 60.0, 100.0)]
    nodes = band_nodes(bands, 8)
    assert nodes.integrate(np.ones((4, 8))) == pytest.approx(np.full(4, 100.0), rel=1e-13)
    assert nodes.name == ("600/100",) * 4
    nodes = band_nodes([TopHat(centre_nm=500.0, width_nm=100.0), TopHat(centre_nm=600.0, width_nm=50.0)], 4)
    assert nodes.integrate(np.ones((7, 2, 4))) == pytest.approx(np.tile([100.0, 50.0], (7, 1)))
    with pytest.raises(ValueError, match="read-only"):
        nodes.weight_nm[0, 0] = 1.0


@pytest.mark.parametrize(
    ("band", "count"),
    [*((TopHat(centre_nm=640.0, width_nm=120.0), n) for n in (1, 2, 5, 9)), *((curve(3), n) for n in (2, 6, 12))],
)
def test_bands_are_exact_to_degree_2k_minus_1_and_no_further(band: Band, count: int) -> None:
    nodes = band_nodes([band], count)
    slack = {"rel": 1e-12} if isinstance(band, TopHat) else {"rel": 1e-9, "abs": 1e-9}
    x = (nodes.wavelength_nm - 600.0) / 100.0
    for power in range(2 * count):
        assert float(nodes.integrate(x**power)[0]) == pytest.approx(exact(band, power), **slack)
    assert float(nodes.integrate(x ** (2 * count))[0]) != pytest.approx(exact(band, 2 * count), rel=1e-9)
    assert (nodes.weight_nm > 0.0).all()
    assert (np.diff(nodes.wavelength_nm) > 0.0).all()


def test_a_narrow_band_is_its_line() -> None:
    """The error of the centre value falls with the square of the width."""
    centre, errors = 600.0, []
    for width in (8.0, 4.0, 2.0):
        nodes = band_nodes([TopHat(centre_nm=centre, width_nm=width, edge_nm=0.5 * width)], 6)
        mean = float(nodes.integrate(STAR.photon_density(nodes.wavelength_nm))[0]) / width
        errors.append(mean / float(STAR.photon_density(centre)) - 1.0)
    assert errors[0] / errors[1] == pytest.approx(4.0, rel=0.01)
    assert errors[1] / errors[2] == pytest.approx(4.0, rel=0.01)
    assert (4.0 * errors[2] - errors[1]) / 3.0 == pytest.approx(0.0, abs=1e-9)  # width to zero (Richardson)


def test_a_table_of_a_trapezoid_is_the_trapezoid() -> None:
    hat = TopHat(centre_nm=800.0, width_nm=90.0, edge_nm=20.0)
    table = TabulatedBand(
        name="same", source="test", wavelength_nm=np.array([700.0, 745.0, 765.0, 835.0, 855.0, 900.0]),
        value=np.array([0.0, 0.0, 1.0, 1.0, 0.0, 0.0]),
    )  # fmt: skip
    wave = np.linspace(690.0, 910.0, 111)
    assert table.transmission(wave) == pytest.approx(hat.transmission(wave), abs=1e-14)
    pair = band_nodes([hat, table], 9)
    assert pair.wavelength_nm[0] == pytest.approx(pair.wavelength_nm[1], abs=1e-10)
