"""CODE V files: commands in any spelling, units, decentres and the tricks that files of others hold."""

from pathlib import Path

import numpy as np
import pytest
from lens_texts import SEQ_SINGLET as SINGLET
from lens_texts import written as written_text

from optics import load_lens, paraxial, read_lens_file
from optics.files.report import Status


def written(folder: Path, text: str) -> Path:
    return written_text(folder, text, "lens.seq", "iso-8859-1")


def test_a_singlet_in_capitals_or_not_by_radii_curvatures_or_unknown(tmp_path: Path) -> None:
    file = read_lens_file(written(tmp_path, SINGLET))
    n = float(file.lens.glasses["N-BK7"].index(587.6))
    power = (n - 1) * (0.02 + 0.01 - (n - 1) * 0.02 * 0.01 * 5.0 / n)
    assert paraxial(file.lens).efl_mm == pytest.approx(1 / power, rel=1e-12)
    assert not file.report.inexact
    assert file.lens.surfaces[1].semi_diameter_mm == 7.0
    lower = load_lens(written(tmp_path, SINGLET.lower()))
    assert paraxial(lower).efl_mm == paraxial(file.lens).efl_mm
    curved = SINGLET.replace("RDM;", "RDM N;").replace("S  50.0", "S  0.02").replace("S  -100.0", "S  -0.01")
    assert paraxial(load_lens(written(tmp_path, curved))).efl_mm == pytest.approx(1 / power, rel=1e-12)
    file = read_lens_file(written(tmp_path, SINGLET.replace("RDM;", "")))
    assert "RDM" in str(file.report.inexact[0])
    curved = SINGLET.replace("RDM;", "").replace("S  50.0", "S  0.02").replace("S  -100.0", "S  -0.01")
    assert paraxial(load_lens(written(tmp_path, curved))).efl_mm == pytest.approx(paraxial(file.lens).efl_mm)


def test_every_command_is_reported_with_its_line_and_defaults_are_taken(tmp_path: Path) -> None:
    file = read_lens_file(written(tmp_path, SINGLET))
    lines = {line.line for line in file.report.lines}
    assert lines == set(range(1, 21)) - {9}  # line 9 goes on from line 8
    edge = next(line for line in file.report.lines if "EDG" in line.command)
    assert (edge.status, edge.surface) == (Status.IGNORED, 2)
    defaults = read_lens_file(written(tmp_path, SINGLET)).defaults
    assert defaults.field_deg.tolist() == [[0.0, 0.0], [0.0, 3.0]]
    assert defaults.wavelength_weight.tolist() == [1.0, 2.0, 1.0]
    # the pupil is cut by 0.2 at its top and 0.1 at its bottom: an ellipse 0.85 high, 0.05 down
    assert defaults.vignetting[1] == pytest.approx([0.0, -0.05, 0.0, 0.15, 0.0])


@pytest.mark.parametrize(("unit", "mm"), [("C", 10.0), ("I", 25.4)])
def test_units(tmp_path: Path, unit: str, mm: float) -> None:
    big = load_lens(written(tmp_path, SINGLET.replace("DIM M", f"DIM {unit}")))
    small = load_lens(written(tmp_path, SINGLET))
    assert paraxial(big).efl_mm == pytest.approx(mm * paraxial(small).efl_mm, rel=1e-12)


@pytest.mark.parametrize("code", ["517642", "517.642", "1.5170:64.2", "51700.6420"])
def test_glass_by_its_code(tmp_path: Path, code: str) -> None:
    file = read_lens_file(written(tmp_path, SINGLET.replace("NBK7_SCHOTT", code)))
    assert float(next(iter(file.lens.glasses.values())).index(587.5618)) == pytest.approx(1.517, abs=1e-12)
    assert file.report.glasses[0].status is Status.APPROXIMATED


def test_glasses_of_the_file(tmp_path: Path) -> None:
    private = "PRV\n PWL 700.0 600.0 &\n 500.0 400.0\n 'MY' 1.50608 1.50878 1.5138 1.52525\nEND\nSO 0.0 0.1e14"
    text = SINGLET.replace("SO 0.0 0.1e14", private).replace("NBK7_SCHOTT", "'MY'")
    glass = load_lens(written(tmp_path, text)).glasses["MY"]
    assert glass.index([400.0, 500.0, 600.0, 700.0]) == pytest.approx([1.52525, 1.5138, 1.50878, 1.50608], abs=2e-4)
    laurent = "PRV\n 'MY' LAU 2.25 0.0 0.01\nEND\nSO 0.0 0.1e14"
    text = SINGLET.replace("SO 0.0 0.1e14", laurent).replace("NBK7_SCHOTT", "'MY'")
    glass = load_lens(written(tmp_path, text)).glasses["MY"]
    assert float(glass.index(500.0)) == pytest.approx(np.sqrt(2.25 + 0.04))


def test_aspheres_and_commands_that_name_their_surface(tmp_path: Path) -> None:
    lines = "SI 0.0 0.0\nASP S1\nK S1 -0.5\nA S1 1e-5; C S1 -2e-10\nTHI S2 55.5"
    lens = load_lens(written(tmp_path, SINGLET.replace("SI 0.0 0.0", lines)))
    r = np.array([2.0, 4.0])
    base = 0.02 * r**2 / (1 + np.sqrt(1 - 0.02**2 * r**2 * 0.5))
    expected = base + 1e-5 * r**4 - 2e-10 * r**8
    assert lens.surfaces[0].shape.sag(r, 0 * r) == pytest.approx(expected, abs=1e-14)
    assert lens.image_position_mm[2] == 60.5


def folded(commands: str, thickness: float = -30.0) -> str:
    mirror = f"S 0 20\nS 0 {thickness} REFL\n{commands}\nSI 0.0 0.0"
    return SINGLET.replace("SI 0.0 0.0", mirror)


def test_a_bent_axis_and_a_surface_that_turns_alone(tmp_path: Path) -> None:
    """ADE is left-handed: -45 deg sends the axis to +y. BEN turns what follows with it, DAR leaves it."""
    bent = load_lens(written(tmp_path, folded("ADE -45; BEN")))
    assert bent.image_position_mm == pytest.approx([0.0, 30.0, 85.0], abs=1e-12)
    alone = load_lens(written(tmp_path, folded("ADE -20; DAR")))
    assert alone.image_position_mm == pytest.approx([0.0, 0.0, 55.0], abs=1e-12)
    carried = load_lens(written(tmp_path, folded("YDE 2; ADE 10; CDE 90")))
    angle = np.radians(10.0)
    assert carried.image_position_mm == pytest.approx(
        [0.0, 2.0 - 30.0 * np.sin(angle), 85.0 - 30.0 * np.cos(angle)], abs=1e-12
    )


def test_rev_undoes_a_decentre(tmp_path: Path) -> None:
    there = "S 0 0\nYDE 2; XDE 1; ADE 7; BDE 5; CDE 3\nS 0 0\nREV\nYDE 2; XDE 1; ADE 7; BDE 5; CDE 3\nS 0 10\nSI 0 0"
    lens = load_lens(written(tmp_path, SINGLET.replace("SI 0.0 0.0", there)))
    assert lens.image_position_mm == pytest.approx([0.0, 0.0, 75.0], abs=1e-12)
    assert lens.image_rotation == pytest.approx(np.eye(3), abs=1e-12)


def test_zoom_positions_and_pickups(tmp_path: Path) -> None:
    text = SINGLET.replace("GO\n", "ZOO 2\nZOO THI S2 60 75\nPIK THI S2 THI S1 12.0 0\nGO\n")
    path = written(tmp_path, text)
    assert load_lens(path).image_position_mm[2] == 65.0
    assert load_lens(f"{path}#2").image_position_mm[2] == 80.0
    report = read_lens_file(f"{path}#2").report
    assert "pickup gives 60, the file stores 75" in str(report.inexact[0])
