"""Glass: published indices, Abbe numbers, temperature coefficients and transmittances come out of the coefficients."""

import numpy as np
import pytest

from optics.glass.air import air_index
from optics.glass.catalogue import get_glass, glass_from_table, list_glasses

D, F, C = 587.5618, 486.1327, 656.2725
PRINTED = [name for name in list_glasses() if get_glass(name).nd is not None]

# SCHOTT data table of 2018-06-01: printed indices, not used anywhere in the catalogue file
LINES_NM = (2325.4, 1529.6, 1060.0, 852.11, 706.5188, 632.8, 546.074, 479.9914, 435.8343, 404.6561)
SCHOTT_INDEX = {
    "N-BK7": (1.48921, 1.50091, 1.50669, 1.5098, 1.51289, 1.51509, 1.51872, 1.52283, 1.52668, 1.53024),
    "N-FK51A": (1.46958, 1.47608, 1.47959, 1.48165, 1.48379, 1.48534, 1.48794, 1.49088, 1.49364, 1.49618),
    "N-KZFS4": (1.57535, 1.58971, 1.59739, 1.60199, 1.60688, 1.61049, 1.61664, 1.6238, 1.63071, 1.63723),
    "N-LAK9": (1.65294, 1.66804, 1.67584, 1.68033, 1.68497, 1.68834, 1.69401, 1.70051, 1.70667, 1.71239),
    "F2": (1.58465, 1.59513, 1.6019, 1.60671, 1.61227, 1.61656, 1.62408, 1.6331, 1.64202, 1.65064),
    "N-SF6": (1.74895, 1.76307, 1.77341, 1.78144, 1.79114, 1.79883, 1.81266, 1.8298, 1.84738, 1.86506),
}


def test_catalogue_is_wide_and_every_entry_has_maker_source_and_range() -> None:
    assert len(list_glasses()) >= 40
    assert {get_glass(name).maker for name in list_glasses()} == {"SCHOTT", "OHARA", "CDGM", "generic"}
    for name in list_glasses():
        glass = get_glass(name)
        assert len(glass.source) > 20, name
        assert glass.range_nm[0] <= 540.0, name
        assert glass.range_nm[1] >= 1050.0, name
    assert sorted(sum((list_glasses(m) for m in ("SCHOTT", "OHARA", "CDGM", "generic")), ())) == list(list_glasses())


@pytest.mark.parametrize("name", PRINTED)
def test_printed_index_and_abbe_number(name: str) -> None:
    """Five decimals of nd and two of vd are printed; the fit reproduces the measured lines to 1e-6."""
    glass = get_glass(name)
    nd, nf, nc = (float(glass.index(line)) for line in (D, F, C))
    assert nd == pytest.approx(glass.nd, abs=6e-6)
    if glass.vd is not None:
        slack = 0.005 + glass.vd * 2e-6 / (nf - nc)
        assert abs((nd - 1.0) / (nf - nc) - glass.vd) < slack


def test_obsolete_glasses_give_their_printed_index_and_abbe_number() -> None:
    names = list_glasses(obsolete=True)
    assert len(names) > 150
    assert not set(names) & set(list_glasses())
    for name in names:
        glass = get_glass(name)
        nd, nf, nc = (float(glass.dispersion.index(line)) for line in (D, F, C))
        assert nd == pytest.approx(glass.nd, abs=6e-6), name
        assert glass.vd is None or abs((nd - 1.0) / (nf - nc) - glass.vd) < 0.01, name


@pytest.mark.parametrize("name", SCHOTT_INDEX)
def test_printed_indices_from_blue_to_infrared(name: str) -> None:
    assert get_glass(name).index(LINES_NM) == pytest.approx(SCHOTT_INDEX[name], abs=1.0e-5)


def test_ohara_indices_hold_at_25_celsius() -> None:
    """The printed relative dn/dT of S-FPL51 (OHARA data table 2018-05) around the D line, -40/-20 ... 60/80 C."""
    glass = get_glass("S-FPL51")
    assert glass.reference_temperature_c == 25.0
    edges = np.arange(-40.0, 81.0, 20.0)
    n = np.array([float(glass.relative_index(589.29, temperature_c=t)) for t in edges])
    assert np.diff(n) / 20.0 * 1e6 == pytest.approx([-5.4, -5.7, -5.9, -6.2, -6.4, -6.7], abs=0.06)


def test_fused_silica_gives_the_printed_indices() -> None:
    """Six decimals as listed by makers of fused silica after Malitson 1965."""
    lines = (404.6561, 435.8343, 486.1327, 546.0740, 587.5618, 656.2725, 852.1101, 1013.98)
    printed = (1.469618, 1.466693, 1.463126, 1.460078, 1.458464, 1.456367, 1.452465, 1.450242)
    assert get_glass("fused-silica").index(lines) == pytest.approx(printed, abs=1e-6)


# n^2 = 1 + sum S_i l^2 / (l^2 - l_i^2); S_i, l_i [um] by powers of T [K]: D. B. Leviton and B. J. Frey, Proc. SPIE
# 6273, 62732K (2006), Corning 7980; D. B. Leviton, B. J. Frey and T. J. Madison, Proc. SPIE 6692, 669204 (2007), CaF2
SILICA = (
    (1.10127, -4.94251e-5, 5.27414e-7, -1.59700e-9, 1.75949e-12),
    (1.78752e-5, 4.76391e-5, -4.49019e-7, 1.44546e-9, -1.57223e-12),
    (7.93552e-1, -1.27815e-3, 1.84595e-5, -9.20275e-8, 1.48829e-10),
    (-8.90600e-2, 9.08730e-6, -6.53638e-8, 7.77072e-11, 6.84605e-14),
    (2.97562e-1, -8.59578e-4, 6.59069e-6, -1.09482e-8, 7.85145e-13),
    (9.34454, -7.09788e-3, 1.01968e-4, -5.07660e-7, 8.21348e-10),
)
FLUORIDE = (
    (1.04834, -2.21666e-4, -6.73446e-6, 1.50138e-8, -2.77255e-11),
    (-3.32723e-3, 2.34683e-4, 6.55744e-6, -1.47028e-8, 2.75023e-11),
    (3.72693, 1.49844e-2, -1.47511e-4, 5.54293e-7, -7.17298e-10),
    (7.94375e-2, -2.20758e-4, 2.07862e-6, -9.60254e-9, 1.31401e-11),
    (0.258039, -2.12833e-3, 1.20393e-5, -3.06973e-8, 2.79793e-11),
    (34.0169, 6.26867e-2, -6.14541e-4, 2.31517e-6, -2.99638e-9),
)


@pytest.mark.parametrize(
    ("name", "table", "apart"),
    [("fused-silica", SILICA, 0.06), ("CaF2", FLUORIDE, 0.02), ("CaF2-Daimon", FLUORIDE, 0.02)],
)
def test_change_with_temperature_is_that_of_prisms_in_a_cryostat(
    name: str, table: tuple[tuple[float, ...]], apart: float
) -> None:
    """Another maker's fused silica: 3 to 5 % (SCHOTT's Lithosil below Corning's 7980); crystals: within 2 %."""
    glass, waves = get_glass(name), np.linspace(420.0, 1000.0, 8)

    def measured(celsius: float) -> np.ndarray:
        terms = [np.polynomial.polynomial.polyval(celsius + 273.15, row) for row in table]
        l2 = (waves * 1e-3) ** 2
        return np.asarray(np.sqrt(1.0 + sum(s * l2 / (l2 - r * r) for s, r in zip(terms[:3], terms[3:], strict=True))))

    there = glass.reference_temperature_c
    for celsius in (-100.0, -60.0, -20.0, 0.0):
        change = glass.absolute_index(waves, temperature_c=celsius) - glass.absolute_index(waves)
        assert change == pytest.approx(measured(celsius) - measured(there), rel=apart)


def test_three_independent_measurements_of_calcium_fluoride_agree() -> None:
    """Within 1e-4, as crystals differ (measured: 3.4e-5 and 5.8e-5); Malitson's is at 24 C, 4 K x -1.1e-5/K below."""
    lines, schott = np.linspace(400.0, 1000.0, 25), get_glass("LITHOTEC-CAF2")
    assert schott.index(lines) == pytest.approx(get_glass("CaF2-Daimon").index(lines), abs=1e-4)
    assert get_glass("CaF2").index(lines) == pytest.approx(schott.relative_index(lines, temperature_c=24.0), abs=1e-4)


def test_air_and_vacuum_differ_by_the_index_of_air() -> None:
    glass, lines = get_glass("N-SF11"), np.linspace(400.0, 1000.0, 7)
    assert glass.relative_index(lines) == pytest.approx(glass.index(lines), abs=1e-15)
    ratio = glass.relative_index(lines, medium="vacuum") / glass.relative_index(lines)
    assert ratio == pytest.approx(air_index(lines), abs=1e-15)
    assert glass.relative_index(lines, pressure_hpa=0.0) == pytest.approx(glass.absolute_index(lines), abs=1e-15)


def test_internal_transmittance_follows_the_other_printed_thickness_and_multiplies() -> None:
    """The catalogue file holds SCHOTT's 25 mm column; the 10 mm column is printed beside it, to three decimals."""
    lines = (365.0, 400.0, 420.0, 500.0, 700.0, 1060.0)
    for name, printed in {
        "N-KZFS4": (0.924, 0.979, 0.984, 0.995, 0.998, 0.998),
        "F2": (0.968, 0.994, 0.996, 0.999, 0.999, 0.999),
        "N-LAK9": (0.906, 0.980, 0.988, 0.997, 0.9984, 0.9984),
    }.items():
        assert get_glass(name).internal_transmittance(lines, 10.0) == pytest.approx(printed, abs=6e-4)
    glass, lines = get_glass("N-SF6"), np.array([420.0, 550.0])
    one, two, both = (glass.internal_transmittance(lines, path) for path in (3.0, 8.5, 11.5))
    assert one * two == pytest.approx(both, rel=1e-13)
    assert glass.internal_transmittance(lines, 0.0) == pytest.approx([1.0, 1.0], abs=0.0)


def test_inline_glass_is_a_glass_like_any_other_and_records_are_shared_and_locked() -> None:
    table = {"B": [1.35055424, 0.197575506, 1.09962992], "C": [0.0087628207, 0.0371767201, 90.3866994]}
    glass = glass_from_table("mine", table | {"range_nm": [400, 900], "source": "my own melt"})
    assert glass.index(600.0) == pytest.approx(float(get_glass("N-KZFS4").index(600.0)), abs=0.0)
    assert glass.source == "my own melt"
    glass = get_glass("N-BK7")
    assert get_glass("N-BK7") is glass
    with pytest.raises(ValueError, match="read-only"):
        glass.transmittance.value[0] = 0.5
