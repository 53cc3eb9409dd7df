"""``starbench lens``: the page of a file, conversion, and one line for whatever is wrong."""

import math
from pathlib import Path
from types import SimpleNamespace

import pytest
from lens_texts import ZMX_DOUBLET

from experiments.__main__ import main
from experiments.lens.tables import _prescription
from optics import load_lens

AR = """
[coating.ar]
kind = "quarter_wave"
design_wavelength_nm = 600.0
"""


@pytest.fixture
def lens(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "my lens.zmx"
    path.write_text(ZMX_DOUBLET, encoding="utf-16")
    return path


def test_convert_there_and_back(lens: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["lens", "convert", lens.name, "lens.toml"]) == 0
    out = capsys.readouterr().out
    assert "SSK5 -> N-SSK5" in out
    assert "EFL" in out
    assert main(["lens", "convert", "--strict", lens.name, "strict.toml"]) == 2
    assert "strict = true refuses any approximation" in capsys.readouterr().err
    assert main(["lens", "convert", "lens.toml", "again.seq"]) == 0
    assert load_lens(lens.parent / "again.seq").surfaces[2].shape.curvature == pytest.approx(-0.004, rel=1e-15)


def test_the_page_holds_prescription_figures_and_every_line(lens: Path) -> None:
    assert main(["lens", "show", lens.name]) == 0
    page = (lens.parent / "my lens.html").read_text(encoding="utf-8")
    assert page.count("<figure") >= 6
    for text in ("doublet &lt;b&gt;", "N-SSK5", "GLAS SSK5 0 0 1.65844 50.88", "line by line", "EFL"):
        assert text in page, text
    assert "http://" not in page.replace("http://www.w3.org", "").replace("http://purl.org", "")
    assert "<b>" not in page.split("<h1>")[1].split("</h1>")[0]


def test_every_setting_of_a_surface_is_in_the_prescription() -> None:
    aperture = {"kind": "circle", "radius_mm": 2.0, "obscures": True}
    rows = [
        {"kind": "asphere", "radius_mm": math.inf, "coefficients": [1e-5, 2], "aperture": aperture, "stop": True},
        {"kind": "sphere", "radius_mm": 12.5, "thickness_mm": 3.0, "tilt": {"x_deg": 0.5}, "semi_diameter_mm": 4.0},
    ]
    listed = _prescription(SimpleNamespace(file=SimpleNamespace(tables={"surface": rows}, labels=None))).rows
    assert listed[0][:4] == ("0 stop", "asphere", "∞", "0")
    assert listed[0][-1] == "coefficients [1e-05, 2], aperture circle that obscures, radius_mm 2"
    assert listed[1] == ("1", "sphere", "12.5", "3", "", "4", "", "tilt {x_deg 0.5}")


def test_ghosts_are_listed_with_the_budget_of_the_light(lens: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Three surfaces, two of a window and the detector make 15 pairs."""
    arguments = ["lens", "ghosts", lens.name, "--field", "1", "--rows", "2"]
    assert main([*arguments, "--window", "N-BK7:0.5:1.0"]) == 0
    said = capsys.readouterr().out
    assert "15 pairs of surfaces" in said
    assert "dust of level 300: 0.02538 % of a surface" in said
    listed = [line.split() for line in said.splitlines() if line.strip()[:1].isdigit()]
    assert len(listed) == 2
    assert float(listed[0][2]) < float(listed[1][2])
    shares = [float(part.split()[-2]) for part in said.splitlines()[-1].split(":")[1].split(",")]
    assert sum(shares) == pytest.approx(100.0, abs=0.05)  # four digits each


def test_formats_without_coatings_say_so(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source = tmp_path / "coated.toml"
    assert main(["lens", "convert", "star_tracker_26mm", str(source)]) == 0
    assert "left out" not in capsys.readouterr().out
    source.write_text('default_coating = "ar"\n' + source.read_text() + AR)
    for name, left_out in (("again.toml", False), ("new.zmx", True)):
        assert main(["lens", "convert", str(source), str(tmp_path / name)]) == 0
        assert ("coatings are left out" in capsys.readouterr().out) == left_out
    known = load_lens(source).surfaces[0].coating
    assert known == load_lens(tmp_path / "again.toml").surfaces[0].coating is not None


def test_thermal_matrix_and_the_spacer_that_holds_the_focus(capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["lens", "thermal", "star_camera_206mm", "--housing", "titanium_ti6al4v", "--athermal", "L6"]
    assert main(arguments) == 0
    said = capsys.readouterr().out
    matrix = {line[:26].strip(): line[26:].split() for line in said.splitlines() if line.startswith(("mean", "across"))}
    assert float(matrix["mean"][0]) == pytest.approx(6.46, rel=0.03)  # um/K over 20 K; dn/dT grows by 2 % to its end
    assert float(matrix["across, +x less -x"][2]) == pytest.approx(-float(matrix["across, +y less -y"][3]))
    (solved,) = (line.split() for line in said.splitlines() if line.startswith("  L6"))
    assert float(solved[1]) == 33.76
