"""Coatings: against the code `tmm`, closed forms of films, energy, and what files say of them."""

import numpy as np
import pytest
from lens_texts import PLATE, coated

from optics import get_glass, lens_transmission, read_lens_file
from optics.glass.coating import BARE, Film, QuarterWave, Stack, TabulatedCoating

WAVES = np.array([420.0, 550.0, 780.0])
ANGLES = np.radians([0.0, 20.0, 45.0, 70.0])
THREE = Stack(films=tuple(Film(thickness_nm=d, index=n) for d, n in ((99.6, 1.38), (134.0, 2.05), (80.0, 1.63))))
LOSSY = Stack(films=(Film(thickness_nm=60.0, index=2.1), Film(thickness_nm=12.0, index=0.8, extinction=3.0)))


@pytest.mark.reference
@pytest.mark.parametrize("stack", [BARE, THREE, LOSSY])
@pytest.mark.parametrize("from_glass", [False, True])
def test_stacks_are_those_of_tmm(stack: Stack, from_glass: bool) -> None:
    """S. Byrnes, `tmm`, arXiv:1603.02720; to 1e-12, from both sides, beyond the critical angle as well."""
    tmm = pytest.importorskip("tmm")
    films = stack.films[::-1] if from_glass else stack.films
    n = [1.0, *(film.index + 1j * film.extinction for film in films), 1.6]
    n = [n[-1], *n[1:-1], n[0]] if from_glass else n
    d = [np.inf, *(film.thickness_nm for film in films), np.inf]
    for angle in ANGLES:
        got = stack.split(WAVES, n[0], n[-1], np.cos(angle))
        for at, wave in enumerate(WAVES):
            for of in "sp":
                known = tmm.coh_tmm(of, n, d, angle, wave)
                assert getattr(got, f"reflectance_{of}")[at] == pytest.approx(known["R"], abs=1e-12)
                assert getattr(got, f"transmittance_{of}")[at] == pytest.approx(known["T"], abs=1e-12)


def test_magnesium_fluoride_on_crown_and_the_v_coat() -> None:
    """One quarter wave: ((n1^2 - n) / (n1^2 + n))^2; two of them: ((n1^2 n - n2^2) / (n1^2 n + n2^2))^2."""
    crown, film = float(get_glass("N-BK7").index(550.0)), float(get_glass("MgF2").index(550.0))
    assert float(QuarterWave().reflectance(550.0, crown)) == pytest.approx(
        ((film**2 - crown) / (film**2 + crown)) ** 2, rel=1e-12
    )
    low, high = 1.38, 1.70
    pair = Stack(films=tuple(Film(thickness_nm=550.0 / 4.0 / n, index=n) for n in (low, high)))
    expected = ((low**2 * crown - high**2) / (low**2 * crown + high**2)) ** 2
    assert float(pair.reflectance(550.0, crown)) == pytest.approx(expected, rel=1e-12)


def test_no_p_light_is_reflected_at_brewsters_angle_and_energy_is_kept() -> None:
    cosine = np.cos(np.arctan(1.5))
    assert float(BARE.split(550.0, 1.0, 1.5, cosine).reflectance_p) == pytest.approx(0.0, abs=1e-16)
    for stack in (BARE, THREE):
        got = stack.split(WAVES[:, None], 1.0, 1.5, np.cos(ANGLES))
        assert got.reflectance + got.transmittance == pytest.approx(1.0, abs=1e-13)
    lossy = LOSSY.split(WAVES, 1.0, 1.5)
    assert ((lossy.reflectance + lossy.transmittance) < 0.95).all()


def test_tables_are_linear_between_entries_and_hold_beyond_the_last_angle() -> None:
    table = TabulatedCoating(
        source="test",
        wavelength_nm=np.array([400.0, 800.0]),
        angle_deg=np.array([0.0, 40.0]),
        reflectance_s=np.array([[0.0, 0.02], [0.04, 0.06]]),
        reflectance_p=np.zeros((2, 2)),
    )
    got = table.split(600.0, 1.0, 1.5, np.cos(np.radians([0.0, 10.0, 40.0, 60.0])))
    assert got.reflectance_s == pytest.approx([0.01, 0.02, 0.05, 0.05], abs=1e-15)
    assert got.transmittance_p == pytest.approx(np.ones(4))
    inside = np.cos(np.arcsin(np.sin(np.radians(10.0)) / 1.5))  # from glass: 10 deg in air
    assert table.split(600.0, 1.5, 1.0, np.array([inside, 0.1])).reflectance_s == pytest.approx([0.02, 1.0])


def test_lens_files_name_coatings_of_surfaces_and_of_all() -> None:
    table = {"kind": "table", "source": "test", "wavelength_nm": [400.0, 700.0], "reflectance": [[0.01, 0.01]]}
    lossy = {**table, "transmittance": [[0.97, 0.97]]}
    surfaces = [{**PLATE[0], "coating": "lossy"}, PLATE[1]]
    lens = coated(coating={"one": table, "lossy": lossy}, default_coating="one", surface=surfaces)
    given = lens_transmission(lens, 550.0, absorption=False, coating=QuarterWave())
    assert float(given) == pytest.approx(0.97 * 0.99, rel=1e-13)
    film = [{"material": "MgF2", "thickness_nm": 550.0 / 4.0 / float(get_glass("MgF2").index(550.0))}]
    stack = coated(coating={"ar": {"kind": "stack", "source": "test", "film": film}}, default_coating="ar")
    quarter = coated(coating={"ar": {"kind": "quarter_wave", "design_wavelength_nm": 550.0}}, default_coating="ar")
    bare = coated(default_coating="bare")
    known = lens_transmission(coated(), 600.0, coating=QuarterWave())
    assert float(lens_transmission(stack, 600.0)) == pytest.approx(float(known), rel=1e-14)
    assert float(lens_transmission(quarter, 600.0)) == pytest.approx(float(known), rel=1e-14)
    assert lens_transmission(bare, 600.0, coating=QuarterWave()) < known


def test_zemax_coatings_are_taken_or_named(tmp_path) -> None:  # type: ignore[no-untyped-def]
    surface = "SURF {}\n  TYPE STANDARD\n  CURV 0.0\n{}  DISZ {}\n"
    text = "MODE SEQ\nNAME plate\nUNIT MM\nENPD 10\nFTYP 0 0 1 1\nXFLN 0\nYFLN 0\nWAVM 1 0.6 1\nPWAV 1\n"
    glass = "  GLAS N-BK7 0 0 1.5168 64.17\n  DIAM 10 1\n"
    text += surface.format(0, "", "INFINITY") + surface.format(1, "  STOP\n  COAT AR\n" + glass, 5)
    text += surface.format(2, "  COAT I.98\n  DIAM 10 1\n", 50) + surface.format(3, "  COAT HEAR1\n", 0)
    path = tmp_path / "plate.zmx"
    path.write_text(text)
    read = read_lens_file(path)
    index = float(get_glass("N-BK7").index(600.0))
    expected = 0.98 * (1.0 - float(QuarterWave(design_wavelength_nm=600.0).reflectance(600.0, index)))
    assert float(lens_transmission(read.lens, 600.0, absorption=False)) == pytest.approx(expected, rel=1e-12)
    messages = {entry.command: entry.message for entry in read.report.lines if entry.command.startswith("COAT")}
    assert "quarter wave of MgF2 at 600 nm" in messages["COAT AR"]
    assert "'HEAR1' is defined in a file of the program" in messages["COAT HEAR1"]
