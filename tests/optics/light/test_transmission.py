"""Transmission of a lens: closed forms for plates and films, energy lost in glass, and a lens taken apart."""

from types import SimpleNamespace

import numpy as np
import pytest
from made_lens import made_coating, made_glass

from optics import Glass, QuarterWave, get_glass
from optics.light.transmission import AxialLayout, axial_layout, lens_transmission

LINES = np.array([450.0, 550.0, 650.0])


def plate(glass: Glass, thickness_mm: float = 10.0) -> AxialLayout:
    return AxialLayout(media=(glass, None), thickness_mm=np.array([thickness_mm, 0.0]))


def test_film_against_a_sum_over_reflections() -> None:
    """Airy sum of the amplitudes bounced inside the film, term by term."""
    n_film, n_glass, design, wave = 1.38, 1.7, 550.0, np.linspace(400.0, 1000.0, 13)
    front, back = (1.0 - n_film) / (1.0 + n_film), (n_film - n_glass) / (n_film + n_glass)
    turn = np.exp(1j * np.pi * design / wave)
    amplitude = np.full(wave.shape, front, dtype=complex)
    for bounce in range(200):
        amplitude += (1.0 - front**2) * back * turn * (-front * back * turn) ** bounce
    coating = QuarterWave(design_wavelength_nm=design, film=made_glass(n_film))
    assert coating.reflectance(wave, np.full(13, n_glass)) == pytest.approx(np.abs(amplitude) ** 2, rel=1e-12)


def test_absorption_and_reflection_multiply_and_cement_is_uncoated() -> None:
    crown, flint = get_glass("N-BK7"), get_glass("F2")
    doublet = AxialLayout(media=(crown, flint, None), thickness_mm=np.array([8.0, 3.0, 100.0]))
    coating = made_coating(0.01)
    cement = ((crown.index(LINES) - flint.index(LINES)) / (crown.index(LINES) + flint.index(LINES))) ** 2
    inside = crown.internal_transmittance(LINES, 8.0) * flint.internal_transmittance(LINES, 3.0)
    assert lens_transmission(doublet, LINES, coating=coating) == pytest.approx(
        0.99**2 * (1 - cement) * inside, rel=1e-13
    )
    assert lens_transmission(plate(made_glass(1.5)), LINES, absorption=False) == pytest.approx([0.96**2] * 3, rel=1e-13)


def test_a_stop_in_air_costs_nothing_and_a_lens_is_read_along_its_vertices() -> None:
    glass = get_glass("N-SF6")
    at = lambda z, medium: SimpleNamespace(  # noqa: E731
        position_mm=np.array([0.0, 0.0, z]), medium=medium, coating=None, mirror=False
    )
    lens = SimpleNamespace(
        surfaces=(at(0.0, "air"), at(2.0, "N-SF6"), at(14.5, "air")),
        glasses={"N-SF6": glass},
        image_position_mm=np.array([0.0, 0.0, 100.0]),
    )
    layout = axial_layout(lens)
    assert layout.media == (None, glass, None)
    assert layout.thickness_mm == pytest.approx([2.0, 12.5, 85.5])
    assert lens_transmission(lens, LINES) == pytest.approx(lens_transmission(plate(glass, 12.5), LINES), rel=1e-14)
