"""Dispersion formulas: printed n_d and v_d of one published material per formula, and identities between formulas."""

from pathlib import Path

import numpy as np
import pytest

from optics.glass.agf import read_agf
from optics.glass.catalogue import get_glass
from optics.glass.dispersion import AGF_FORMULAS, FORMULAS, Dispersion
from optics.glass.index_database import read_material
from optics.glass.model_glass import glass_code, model_glass

LINES = np.array([587.5618, 486.1327, 656.2725])

# formula, coefficients and range [um] of one material each, with the n_d and v_d that its catalogue prints
PUBLISHED = [
    (1, "2.2801838 -0.010066273 0.010889844 1.6359759e-4 -5.1283993e-7 2.6440349e-7", 0.365, 2.3, 1.519747, 63.653311),
    (2, "1.34533359 0.00997743871 0.209073176 0.0470450767 0.937357162 111.886764", 0.32, 2.5, 1.62004, 36.37),
    (3, "2.2596285 0.0311097853 0.0010251756 -5.94355286e-4 4.49796618e-7 -4.128528e-9", 0.34, 2, 2.367678, 15.282309),
    (5, "1.47444837 0.0103147698 2.6742387e-4", 0.334, 2.325, 1.493724, 64.358478),
    (6, "0.8559 0.00345744 0.8391 0.019881 0.0009 0.038809 0.6845 49.070025", 0.21, 2.2, 1.658643, 48.541403),
    (7, "2.7405 0.0184 0.0179 0.0155", 0.22, 1.06, 1.670737, 52.593907),
    (8, "2.81418 0.87968 0.09253764 0.00711", 0.45, 4.0, 2.003385, 12.424016),
    (9, "3.1399 1.3786 0.02941 3.861 225.9009", 0.22, 5.0, 2.154291, 50.733102),
    (12, "2.54662904 -0.0122972332 0.0187464623 4.60296583e-4 7.85351066e-7 1.72720972e-6 -1.33476806e-4", 0.4, 0.7,
     1.612660, 44.461379),
    (13, "3.22566311 -0.0126719158 -1.22584245e-4 0.0306900263 6.49958511e-4 1.0629994e-5 1.20774149e-6", 0.365, 2.0,
     1.820980, 42.656702),
]  # fmt: skip


def agf(path: Path, formula: int, coefficients: str, low: float, high: float, nd: float, vd: float) -> str:
    return f"NM G{formula} {formula} 0 {nd} {vd}\nED 7 8 2.5 0 0\nCD {coefficients}\nLD {low} {high}\n"


def test_formulas_of_agf_files_give_the_printed_index_and_abbe_number(tmp_path: Path) -> None:
    path = tmp_path / "mine.agf"
    path.write_text("CC test\n" + "".join(agf(path, *row) for row in PUBLISHED), encoding="utf-16")
    catalogue = read_agf(path)
    for formula, *_, nd, vd in PUBLISHED:
        d, f, c = catalogue.glass(f"g{formula}").dispersion.index(LINES)
        assert d == pytest.approx(nd, abs=6e-6), formula
        assert (d - 1.0) / (f - c) == pytest.approx(vd, rel=3e-4), formula


def test_formulas_without_an_example_reduce_to_others() -> None:
    wave = np.linspace(400.0, 1000.0, 7)
    schott = [2.28, -0.01, 0.0109, 1.6e-4, -5e-7, 2.6e-7]
    assert Dispersion("extended", (*schott, 0.0, 0.0)).index(wave) == pytest.approx(
        Dispersion("schott", tuple(schott)).index(wave), abs=1e-15
    )
    # B2 / (l^2 - L) = (B2 / L) (l^2 / (l^2 - L) - 1)
    split = Dispersion("shifted_sellmeier", (0.2 - 0.01 / 0.04, 1.0, 0.01, 0.01 / 0.04, 0.04))
    assert Dispersion("sellmeier2", (0.2, 1.0, 0.1, 0.01, 0.2)).index(wave) == pytest.approx(split.index(wave))
    assert {name for name, _ in AGF_FORMULAS.values()} <= set(FORMULAS)


def test_agf_lines_that_go_on_and_thicknesses_that_differ(tmp_path: Path) -> None:
    path = tmp_path / "two.agf"
    path.write_text(
        "NM Q 13 0 1.82098 42.6567\nCD 3.22566311 -0.0126719158 -1.22584245e-4 0.0306900263\n6.49958511e-4\n"
        "1.0629994e-5 1.20774149e-6\nTD 0 0 0 0 0 0 20\nLD .365 2.0\nIT .5 .81 10\nIT .6 .9 5\nIT .7 .5 10\n"
        "NM Q 2 0 1.5 60\nCD 1.25 0\nLD .4 .7\n",
        encoding="iso-8859-1",
    )
    catalogue = read_agf(path)
    glass = catalogue.glass("q")
    assert float(glass.index(587.5618)) == pytest.approx(1.82098, abs=6e-6)
    assert glass.dndt is None
    assert glass.internal_transmittance([500.0, 600.0], 5.0) == pytest.approx([0.9, 0.9])


def test_materials_of_refractiveindex_info(tmp_path: Path) -> None:
    """Sapphire: the ordinary index at the sodium line is 1.7681; a table of water-like indices is followed to 1e-5."""
    path = tmp_path / "sapphire.yml"
    path.write_text(
        "REFERENCES: 'Malitson <i>1972</i>'\nDATA:\n  - type: formula 1\n    wavelength_range: 0.20 5.0\n"
        "    coefficients: 0 1.4313493 0.0726631 0.65054713 0.1193242 5.3414021 18.028251\n"
        "  - type: tabulated k\n    data: |\n        0.5 1e-8\n        0.6 1e-8\nCONDITIONS:\n    temperature: 293\n",
        encoding="utf-8",
    )
    glass = read_material(path)
    assert float(glass.index(589.3)) == pytest.approx(1.7681, abs=5e-5)
    assert float(glass.index(700.0)) == pytest.approx(float(get_glass("sapphire").index(700.0)), abs=1e-12)
    # Beer-Lambert with the absorption coefficient 4 pi k / lambda
    assert float(glass.internal_transmittance(500.0, 20.0)) == pytest.approx(np.exp(-4 * np.pi * 1e-8 * 20 / 500e-6))
    wave = np.linspace(0.4, 1.0, 13)
    rows = "".join(f"        {w} {1.32 + 3.1e-3 / w**2}\n" for w in wave)
    path.write_text(f"DATA:\n  - type: tabulated n\n    data: |\n{rows}", encoding="utf-8")
    assert read_material(path, "w").index(555.0) == pytest.approx(1.32 + 3.1e-3 / 0.555**2, abs=1e-5)


def test_a_model_glass_meets_its_two_numbers_and_lies_near_real_glasses() -> None:
    d, f, c = model_glass("m", 1.6204, 36.37).dispersion.index(LINES)
    assert d == pytest.approx(1.6204, abs=1e-12)
    assert (d - 1.0) / (f - c) == pytest.approx(36.37, abs=1e-9)
    wave = np.linspace(420.0, 1000.0, 30)
    for name in ("N-BK7", "F2", "N-LAK9", "N-SF6"):
        real = get_glass(name)
        near = model_glass(name, real.nd or 0.0, real.vd or 0.0).index(wave)
        assert np.abs(near - real.index(wave)).max() < 9e-4, name
    assert model_glass("m", 1.5, 0.0).index([400.0, 900.0]) == pytest.approx([1.5, 1.5], abs=1e-15)
    assert glass_code("517.642") == glass_code("517642") == pytest.approx((1.517, 64.2))
    assert glass_code("51764") is None
