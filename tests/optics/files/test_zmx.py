"""Zemax files: every trap that readers of others fell into, in small files that hold it."""

from pathlib import Path

import numpy as np
import pytest
from lens_texts import ZMX_SINGLET as SINGLET
from lens_texts import written as written_text
from refusals import refuses

from optics import EvenAsphere, Rays, load_lens, paraxial, read_lens_file, trace
from optics.errors import ConfigError
from optics.files.report import Status


def written(folder: Path, text: str, name: str = "lens.zmx", encoding: str = "utf-8") -> Path:
    return written_text(folder, text, name, encoding)


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "utf-16-le", "utf-16-be", "iso-8859-1"])
def test_encodings(tmp_path: Path, encoding: str) -> None:
    text = SINGLET.replace("NAME singlet", "NAME µ-Linse é") if encoding != "utf-16-be" else SINGLET
    lens = load_lens(written(tmp_path, text.replace("\n", "\r\n"), encoding=encoding))
    assert len(lens.surfaces) == 2
    assert lens.name == ("singlet" if encoding == "utf-16-be" else "µ-Linse é")


def test_a_singlet_has_the_focal_length_of_the_lens_makers_equation(tmp_path: Path) -> None:
    file = read_lens_file(written(tmp_path, SINGLET))
    n = float(file.lens.glasses["N-BK7"].index(587.6))
    power = (n - 1) * (0.02 + 0.01 - (n - 1) * 0.02 * 0.01 * 5.0 / n)
    assert paraxial(file.lens).efl_mm == pytest.approx(1 / power, rel=1e-12)
    computed = {c.name: c.computed for c in file.report.comparisons}
    assert computed["EFL"] == pytest.approx(1 / power, rel=1e-12)
    assert computed["BFL"] == pytest.approx(paraxial(file.lens).bfl_mm, rel=1e-9)
    assert file.lens.surfaces[0].semi_diameter_mm == pytest.approx(5.0)
    assert file.lens.surfaces[1].semi_diameter_mm == 7.0  # set by hand; the one of surface 1 was solved for


def test_the_focal_length_of_the_report_is_at_the_temperature_of_the_file(tmp_path: Path) -> None:
    """60 C, adjusted: the report said the focal length of 20 C."""
    file = read_lens_file(written(tmp_path, SINGLET.replace("ENVD 2.0E+1 1 0", "ENVD 6.0E+1 1 1")))
    glass, warm = file.lens.glasses["N-BK7"], {"temperature_c": 60.0}
    n = float(glass.relative_index(587.6, **warm))
    power = (n - 1) * (0.02 + 0.01 - (n - 1) * 0.02 * 0.01 * 5.0 / n)
    computed = {c.name: c.computed for c in file.report.comparisons}
    assert computed["EFL"] == pytest.approx(1 / power, rel=1e-12)
    assert abs(n - float(glass.index(587.6))) > 1e-5


def test_every_line_is_reported_once_with_its_number_and_defaults_are_taken(tmp_path: Path) -> None:
    file = read_lens_file(written(tmp_path, SINGLET))
    numbers = [line.line for line in file.report.lines if line.line]
    assert numbers == [n for n, text in enumerate(SINGLET.splitlines(), 1) if text.strip()]
    assert sum(file.report.count.values()) == len(file.report.lines)
    solved = next(line for line in file.report.lines if line.command.startswith("DIAM 7.5"))
    assert solved.status is Status.IGNORED
    assert solved.surface == 1
    assert not file.report.inexact
    defaults = read_lens_file(written(tmp_path, SINGLET)).defaults
    assert defaults.wavelength_nm == pytest.approx([486.1, 587.6, 656.3])  # the fourth is not in use
    assert defaults.wavelength_weight.tolist() == [1.0, 2.0, 1.0]
    assert defaults.field_deg.tolist() == [[0.0, 0.0], [0.0, 3.0]]
    assert defaults.field_weight.tolist() == [1.0, 2.0]
    assert defaults.vignetting[1].tolist() == [0.0, 0.1, 0.0, 0.0, 0.0]
    assert defaults.entrance_pupil_mm == 10.0
    lens = load_lens(tmp_path / "lens.zmx")
    assert (lens.design_wavelength_nm, lens.max_field_deg) == (pytest.approx(587.6), pytest.approx(3.0))


@pytest.mark.parametrize(("unit", "mm"), [("CM", 10.0), ("IN", 25.4), ("METER", 1000.0)])
def test_units_scale_every_length(tmp_path: Path, unit: str, mm: float) -> None:
    asphere = SINGLET.replace("TYPE STANDARD\n  CURV 0.02", "TYPE EVENASPH\n  PARM 2 1E-6\n  CURV 0.02")
    small = load_lens(written(tmp_path, asphere))
    big = load_lens(written(tmp_path, asphere.replace("UNIT MM", f"UNIT {unit}"), "big.zmx"))
    assert paraxial(big).efl_mm == pytest.approx(mm * paraxial(small).efl_mm, rel=1e-12)
    r = np.array([3.0])
    sags = big.surfaces[0].shape.sag(mm * r, 0 * r), small.surfaces[0].shape.sag(r, 0 * r)
    assert sags[0] == pytest.approx(mm * sags[1], rel=1e-12)


def test_lines_that_are_not_there_not_indented_or_unknown(tmp_path: Path) -> None:
    """No VERS, no TYPE, surface data at the margin: each makes another reader fail or drop the surface."""
    bare = SINGLET.replace("VERS 190513 80 123457 L123457\n", "").replace("  TYPE STANDARD\n", "").replace("\n  ", "\n")
    assert load_lens(written(tmp_path, bare)).surfaces[0].shape.curvature == pytest.approx(0.02)
    text = SINGLET.replace("  DISZ 5.0\n", "  DISZ 5.0\n  WARP 3\n") + "EFFL 0 2 0 0 0 0 100 1 0 0\n"
    file = read_lens_file(written(tmp_path, text))
    assert [line.command for line in file.report.inexact] == ["WARP 3"]


def test_obsolete_successor_names_both_and_the_change(tmp_path: Path) -> None:
    """N-SSK5 for a made-up SSK5 of stated index: both names, index, focal length."""
    text = SINGLET.replace("GLAS N-BK7 0 0 1.5 40", "GLAS SSK5 0 0 1.65844 50.88")
    file = read_lens_file(written(tmp_path, text))
    (choice,) = file.report.glasses
    assert (choice.asked, choice.taken) == ("SSK5", "N-SSK5")
    assert choice.status is Status.APPROXIMATED
    assert max(map(abs, choice.change)) < 3e-4
    assert any("SSK5 -> N-SSK5" in str(line) and "EFL" in str(line) for line in file.report.inexact)
    refuses(ConfigError, "strict", read_lens_file, tmp_path / "lens.zmx", strict=True)
    assert read_lens_file(written(tmp_path, SINGLET), strict=True).lens.glasses.keys() == {"N-BK7"}


def test_model_glass_meets_its_numbers_and_v_d_of_zero_is_constant(tmp_path: Path) -> None:
    text = SINGLET.replace("GLAS N-BK7 0 0 1.5 40", "GLAS ___BLANK 1 0 1.5168 64.17")
    lens = load_lens(written(tmp_path, text))
    assert lens.indices(587.5618)[1] == pytest.approx(1.5168 * lens.indices(587.5618)[0], abs=1e-9)
    text = SINGLET.replace("GLAS N-BK7 0 0 1.5 40", "GLAS ___BLANK 1 0 1.5 0")
    file = read_lens_file(written(tmp_path, text))
    assert file.lens.glasses["model-1.5-0"].index([450.0, 900.0]) == pytest.approx([1.5, 1.5], abs=1e-14)
    assert not [line for line in file.report.inexact if "GLAS" in line.command]


def test_an_index_of_the_file_holds_at_any_wavelength_and_for_thin_gases(tmp_path: Path) -> None:
    """Lithography lenses state fused silica at 193 nm, and helium thinner than air, by one index."""
    text = SINGLET
    for number, wave in enumerate(("0.4861", "0.5876", "0.6563"), start=1):
        text = text.replace(f"WAVM {number} {wave}", f"WAVM {number} 0.193304")
    for index in (1.56029, 0.99971):
        stated = text.replace("GLAS N-BK7 0 0 1.5 40", f"GLAS ___BLANK 1 0 {index} 0")
        report = read_lens_file(written(tmp_path, stated)).report
        (glass,) = report.glasses
        assert glass.status is Status.TAKEN
        assert glass.index == pytest.approx([index] * len(glass.index), abs=1e-12)


def test_own_catalogue_in_the_order_of_the_file(tmp_path: Path) -> None:
    """One name in several catalogues: the first that the file lists counts, and the other one is named."""
    for name, b in (("MINE", 1.25), ("YOURS", 1.56)):
        agf = f"NM N-BK7 2 0 0 0\nED 7 0 0 0 0\nCD {b} 0 0 0 0 0\nTD 0 0 0 0 0 0 20\nLD .3 2\n"
        (tmp_path / f"{name}.AGF").write_text(agf, encoding="utf-16")
    for order, n in (("MINE SCHOTT", 1.5), ("YOURS MINE", 1.6), ("SCHOTT MINE", 1.51680)):
        text = SINGLET.replace("GCAT SCHOTT", f"GCAT {order}")
        file = read_lens_file(written(tmp_path, text))
        assert file.report.glasses[0].index[1] == pytest.approx(n, abs=1e-5)
        assert "has a glass of this name too" in file.report.glasses[0].where
        assert not file.report.inexact
    file = read_lens_file(written(tmp_path, SINGLET.replace("GCAT SCHOTT", "GCAT HOYA")))
    assert "does not list" in str(file.report.inexact[0])
    file = read_lens_file(tmp_path / "lens.zmx", glasses={"N-BK7": "N-SK16"})
    assert file.report.glasses[0].taken == "N-SK16"


def test_apertures_are_kept(tmp_path: Path) -> None:
    last = 'DIAM 7 1 0 0 1 ""\n'
    blocks = "  CLAP 1 6 0\n  OBSC 0 2 0\n"
    lens = load_lens(written(tmp_path, SINGLET.replace(last, last + blocks)))
    second = lens.surfaces[1]
    assert (second.inner_semi_diameter_mm, second.semi_diameter_mm) == (1.0, 6.0)

    def arrives(lens_text: str, y: float) -> bool:
        lens = load_lens(written(tmp_path, lens_text))
        rays = Rays.create(x_mm=0.0, y_mm=[y], z_mm=-1.0, direction=[0.0, 0.0, 1.0], wavelength_nm=587.6)
        return bool(trace(lens, rays).ok[0])

    blocked = SINGLET.replace(last, last + "  OBSC 0 2 0\n")
    assert not arrives(blocked, 1.5)
    assert arrives(blocked, 3.0)
    shifted = SINGLET.replace(last, last + "  SQAP 3 1.5 0\n  OBDC 0.0 2.0\n")
    assert not arrives(shifted, -2.0)
    assert arrives(shifted, 2.0)


def test_aspheres(tmp_path: Path) -> None:
    """Even terms from r^2 on, odd terms, extended ones over a radius: sag against the printed polynomial."""
    r = np.array([2.0, 4.0])
    base = 0.02 * r**2 / (1 + np.sqrt(1 - 0.02**2 * r**2 * (1 - 0.5)))
    for lines, polynomial in (
        ("TYPE EVENASPH\n  CONI -0.5\n  PARM 2 1E-5\n  PARM 4 2E-9", 1e-5 * r**4 + 2e-9 * r**8),
        ("TYPE EVENASPH\n  CONI -0.5\n  PARM 1 1E-3\n  PARM 2 1E-5", 1e-3 * r**2 + 1e-5 * r**4),
        ("TYPE ODDASPHE\n  CONI -0.5\n  PARM 3 1E-4\n  PARM 4 2E-6", 1e-4 * r**3 + 2e-6 * r**4),
        ("TYPE XASPHERE\n  CONI -0.5\n  XDAT 1 3\n  XDAT 2 2\n  XDAT 4 1E-4", 1e-4 * (r / 2) ** 4),
        ("TYPE XOSPHERE\n  CONI -0.5\n  XDAT 1 5\n  XDAT 2 2\n  XDAT 5 1E-4", 1e-4 * (r / 2) ** 3),
    ):
        text = SINGLET.replace("TYPE STANDARD\n  CURV 0.02", f"{lines}\n  CURV 0.02")
        shape = load_lens(written(tmp_path, text)).surfaces[0].shape
        assert shape.sag(r, 0 * r) == pytest.approx(base + polynomial, abs=1e-14), lines
    assert isinstance(load_lens(written(tmp_path, SINGLET)).surfaces[0].shape, EvenAsphere) is False


def test_paraxial_and_toroidal_surfaces(tmp_path: Path) -> None:
    ideal = SINGLET.replace("TYPE STANDARD\n  CURV -0.01", "TYPE PARAXIAL\n  PARM 1 40\n  CURV 0.0")
    ideal = ideal.replace("  GLAS N-BK7 0 0 1.5 40 0 0 0 0 0 0\n", "").replace("CURV 0.02", "CURV 0.0")
    rays = Rays.create(x_mm=0.0, y_mm=3.0, z_mm=-1.0, direction=[0.0, 0.0, 1.0], wavelength_nm=587.6)
    end = trace(load_lens(written(tmp_path, ideal)), rays)
    assert float(end.dy / end.dz) == pytest.approx(-3.0 / 40.0, rel=4e-4)
    toroid = SINGLET.replace("TYPE STANDARD\n  CURV 0.02", "TYPE TOROIDAL\n  CURV 0.02")
    shape = load_lens(written(tmp_path, toroid)).surfaces[0].shape
    assert shape.sag(np.array([3.0, 0.0]), np.array([0.0, 3.0])) == pytest.approx([0.0, 50 - np.sqrt(50**2 - 9)])


def test_a_folded_lens_turns_as_the_file_says(tmp_path: Path) -> None:
    """A mirror at 45 deg about x between two coordinate breaks sends the axis to +y, pickup and order flag included."""
    turn = "  TYPE COORDBRK\n  PARM 3 45\n"
    fold = f"SURF 2\n  CURV -0.01\n  DISZ 20\nSURF 3\n{turn}  DISZ 0\nSURF 4\n  DISZ 0\n  GLAS MIRROR 0 0 1.5 40\n"
    fold += f"SURF 5\n{turn}  PPAR 3 3 1.0 0.0 0\n  DISZ -30\nSURF 6\n"
    text = SINGLET[: SINGLET.index("SURF 2")] + fold
    file = read_lens_file(written(tmp_path, text))
    assert file.lens.image_position_mm == pytest.approx([0.0, 30.0, 25.0], abs=1e-12)
    assert [line.command for line in file.report.inexact] == ["clear apertures"]  # mirrors have none in the file
    wrong = read_lens_file(written(tmp_path, text.replace("PARM 3 45\n  PPAR", "PARM 3 44\n  PPAR")))
    assert any("stores 44" in str(line) for line in wrong.report.inexact)


def test_apertures_by_f_number_and_by_the_stop_and_fields_by_height(tmp_path: Path) -> None:
    lens = load_lens(written(tmp_path, SINGLET.replace("ENPD 10.0", "FNUM 8 0")))
    assert paraxial(lens).f_number == pytest.approx(8.0, rel=1e-9)
    lens = load_lens(written(tmp_path, SINGLET.replace("ENPD 10.0", "FLOA")))
    assert lens.surfaces[0].semi_diameter_mm == 7.5
    text = SINGLET.replace("FTYP 0 0 2 3", "FTYP 2 0 2 3")
    file = read_lens_file(written(tmp_path, text))
    assert file.lens.max_field_deg == pytest.approx(np.degrees(np.arctan(3.0 / paraxial(file.lens).efl_mm)), rel=1e-9)


def test_configurations_are_a_list_to_choose_from(tmp_path: Path) -> None:
    text = SINGLET + (
        "BLNK \nMNUM 2 1\n" + 'THIC 2 1 60 0 0 0 1 1 1 0 0 "" 0\nTHIC 2 2 75.5 0 0 0 1 1 1 0 0 "" 0\n'
        'CRVT 1 1 0.02 0 0 0 1 1 1 0 0 "" 0\nCRVT 1 2 0.021 0 0 0 1 1 1 0 0 "" 0\n'
    )
    path = written(tmp_path, text)
    first, second = load_lens(path), load_lens(f"{path}#2")
    assert first.image_position_mm[2] == 65.0
    assert second.image_position_mm[2] == 80.5
    assert second.surfaces[0].shape.curvature == pytest.approx(0.021)
    defaults = read_lens_file(path).defaults
    assert (defaults.configuration, defaults.configurations) == (1, 2)
    refuses(ConfigError, "configuration 3 does not exist", load_lens, f"{path}#3")
