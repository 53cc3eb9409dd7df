"""The documents: their links lead somewhere, their code runs."""

import ast
import doctest
import math
import os
import re
import runpy
import subprocess
import sys
from importlib import import_module
from importlib.util import find_spec, module_from_spec, spec_from_file_location
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).resolve().parents[1]
PAGES = sorted([*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")])


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_relative_links_lead_to_files_and_named_scripts_are_there(page):
    targets = re.findall(r"\]\((?!https?:)([^)#]+)", page.read_text(encoding="utf-8"))
    missing = [target for target in targets if not (page.parent / target).exists()]
    assert not missing
    named = re.findall(r"\b(?:tests|benchmarks)/[\w/]+\.py", page.read_text(encoding="utf-8"))
    assert [path for path in named if not (ROOT / path).exists()] == []


def test_pictures_have_a_text_instead():
    """Of pages and notebooks; the build looks at those of the gallery and of finished pages."""
    sources = [*PAGES, *(ROOT / "docs" / "notebooks").glob("*.ipynb"), *(ROOT / "experiments").rglob("*.md")]
    assert [page.name for page in sources if re.search(r"!\[\s*\]", page.read_text(encoding="utf-8"))] == []


def test_faults_of_finished_pages_are_found(tmp_path):
    """Every fault once, and nothing that is no fault."""
    (tmp_path / "sub").mkdir()
    good = '<h1 id="top"></h1><img src="a.png" alt="a"><a href="../index.html#here"></a><a href="https://a.org/b"></a>'
    (tmp_path / "sub" / "good.html").write_text(good)
    (tmp_path / "sub" / "a.png").touch()
    bad = '<p id="here"><img src="sub/a.png" alt=" "><a href="sub/good.html#gone"></a><a href="lost.html"></a>'
    (tmp_path / "index.html").write_text(f'{bad}<a href="http://a.org"></a><a href="#here"></a><a href="#no"></a>')
    faults = runpy.run_path(str(ROOT / "docs" / "_ext" / "site_check.py"))["faults"]
    assert faults(tmp_path.resolve()) == [
        "index.html: no text instead of the picture sub/a.png",
        "index.html: #no leads to no place in that page",
        "index.html: http://a.org is no https address",
        "index.html: lost.html leads to no file",
        "index.html: sub/good.html#gone leads to no place in that page",
    ]


@pytest.mark.parametrize("page", sorted((ROOT / "docs" / "theory").glob("*.md")), ids=lambda page: page.stem)
def test_every_equation_has_its_source_and_its_function(page):
    """In the section that it stands in."""
    sections = re.split(r"^#+ ", page.read_text(encoding="utf-8"), flags=re.M)
    bare = [text for text in sections if "$$" in text and not ("`" in text and re.search(r"\*Source:|\beq\. \d", text))]
    assert [text.splitlines()[0] for text in bare] == []


def scripts(page):
    """Python blocks of a page."""
    return re.findall(r"```python\n(.*?)```", (ROOT / page).read_text(encoding="utf-8"), re.S)


def run_script(source, folder):
    """Standard output of a script that is run in a folder of its own."""
    (folder / "script.py").write_text(source, encoding="utf-8")
    done = subprocess.run(
        [sys.executable, "-W", "error::UserWarning", "script.py"],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=False,
        timeout=600,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def numbers(text):
    return np.array([float(value) for value in re.findall(r"-?\d+\.\d*(?:e-?\d+)?", text)])


def test_the_ten_lines_are_ten_and_the_same_everywhere():
    script = scripts("README.md")[0]
    statements = [node for node in ast.parse(script).body if not isinstance(node, ast.Import | ast.ImportFrom)]
    assert len(statements) <= 10
    assert not any(";" in line.split("#")[0] for line in script.splitlines())
    assert script == block("docs/library.md", "find_stars")


@pytest.mark.slow
def test_the_ten_lines_find_the_attitude(tmp_path):
    """Lost in space, and in the same process as without tetra3rs, the attitude known to 0.1 deg."""
    before, lost, after = re.split(r"^(identified = .*\n)", scripts("README.md")[0], flags=re.M)
    known = lost.replace("observation.sky)", "observation.sky, near=attitude_from_angles(83.7, -1.1, 30.2))")
    assert "near=attitude" in known
    ways = [lost, known] if find_spec("tetra3rs") else [known]
    said = run_script(before + "".join(way + after for way in ways), tmp_path).splitlines()
    assert len(said) == len(ways)
    for line in said:
        error, sigma = map(numbers, line.split("predicted"))
        assert error.shape == sigma.shape == (3,)
        assert (np.abs(error) < 5.0 * sigma).all()
        # the bound of 200 stars of 0.05 px: 44.3 arcsec x 0.05 / sqrt(200), and for the roll over half the field
        assert 0.1 < sigma[0] < 0.4
        assert sigma[2] == pytest.approx(sigma[0] / 0.1, rel=0.5)
    assert (tmp_path / "orion.png").stat().st_size > 20_000


@pytest.mark.slow
def test_the_script_with_stars_of_ones_own_runs_and_measures(tmp_path):
    said = run_script(block("docs/library.md", "StarRenderer"), tmp_path)
    errors = [float(value) for value in re.findall(r"error ([+-][\d.]+)", said)]
    assert len(errors) == 10  # every star, nothing else
    assert max(map(abs, errors)) < 0.1  # a Gaussian on a spot with coma; a slip of half a pixel would show
    assert (tmp_path / "frame.fits").exists()


def block(page, name):
    """The Python block of a page that imports a name."""
    return next(script for script in scripts(page) if re.search(rf"^from .*\b{name}\b", script, re.M))


def run_block(name, **names):
    """Names that the block of the library page has defined which imports a name."""
    exec(block("docs/library.md", name), names)
    return names


def test_the_library_page_predicts_a_sensor_of_its_file(capsys, monkeypatch):
    monkeypatch.chdir(ROOT)
    names = run_block("predict_sensor")
    shown = dict(line.split() for line in capsys.readouterr().out.splitlines()[:5])
    assert names["prediction"].value("false_alarms_per_frame") == pytest.approx(0.1, rel=1e-3)
    assert float(shown["snr"]) < math.sqrt(float(shown["electrons_e"]))  # photon noise alone
    median = np.median(names["prediction"].attitude.across_arcsec)
    assert median == pytest.approx(names["prediction"].value("attitude_cross_arcsec"), rel=0.01)


def test_the_triad_of_the_library_page_is_a_quarter_turn_and_its_focus_the_best(capsys):
    """By hand: about +X by -90 deg; the first direction gives x and z, the second y, each by its own noise."""
    names = run_block("triad", np=np)
    assert capsys.readouterr().out
    np.testing.assert_allclose(names["attitude"].rotation.as_rotvec(degrees=True), [-90.0, 0.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(names["attitude"].covariance_rad2, np.eye(3) * (2e-5) ** 2, atol=1e-16)
    names = run_block("best_focus_shift_mm")
    assert names["defocus_mm"] == pytest.approx(0.01, abs=0.02)


def test_the_metrics_of_the_library_page_are_those_of_its_series(capsys):
    error = np.random.default_rng(4).normal(0.5, 0.2, (20, 1000))
    run_block("ecss_metrics", error_arcsec=error)
    metrics, limit = capsys.readouterr().out.splitlines()
    assert ast.literal_eval(metrics)["AME"] == pytest.approx(np.quantile(error, 0.997), rel=1e-9)
    assert float(limit) == pytest.approx(0.05 ** (1.0 / 93.0))


def test_the_detector_of_the_library_page_is_as_drawn():
    """0.25 DN/e-, read noise 5 e-, PRNU 1 %, DSNU 3 e-: each within five standard errors, which are small."""
    rng, shape = np.random.default_rng(2), (8, 60, 80)
    response, offset = 1.0 + 0.01 * rng.standard_normal(shape[1:]), 3.0 * rng.standard_normal(shape[1:])
    names = {
        name: np.rint(100.2 + 0.25 * (rng.poisson(level * response, shape) + offset + rng.normal(0.0, 5.0, shape)))
        for name, level in (("dark_frames", 0.0), ("dim_frames", 2000.0), ("bright_frames", 9000.0))
    }
    exec(block("docs/library.md", "fixed_pattern") + "pattern = fixed_pattern(flats[-1], dark, transfer)", names)
    transfer, pattern = names["transfer"], names["pattern"]
    for value, error, true in (
        (transfer.gain_dn_per_e, transfer.gain_error_dn_per_e, 0.25),
        (transfer.read_noise_e, transfer.read_noise_error_e, 5.0),
        (pattern.prnu, pattern.prnu_error, 0.01),
        (pattern.dsnu_e, pattern.dsnu_error_e, 3.0),
    ):
        assert abs(value - true) < 5.0 * error < 0.2 * true


def test_the_light_of_stars_of_the_library_page_is_as_drawn():
    """Zero point 15, extinction 0.3, vignetting 0.4 at the corner, scatter 0.01: each within five standard errors."""
    rng, airmass = np.random.default_rng(8), np.linspace(1.0, 2.0, 6)
    names = {"airmass": airmass, "frame": rng.integers(0, 6, 600), "temperature_k": rng.uniform(3000.0, 1e4, 600)}
    names |= {"magnitude": rng.uniform(3.0, 7.0, 600), "distance": rng.uniform(0.0, 1.0, 600)}
    lost = names["magnitude"] + 0.3 * airmass[names["frame"]] + 0.4 * names["distance"] ** 2
    names["flux_e"] = 10.0 ** (0.4 * (15.0 - lost + 0.01 * rng.standard_normal(600)))
    names["flux_error_e"] = 1e-3 * names["flux_e"]
    exec(block("docs/library.md", "fit_photometry"), names)
    light = names["light"]
    assert abs(light.above_mag - 15.0) < 5.0 * light.above_error_mag < 0.05
    assert abs(light.extinction_mag - 0.3) < 5.0 * light.extinction_error_mag < 0.05
    assert abs(light.vignetting_at(1.0) - 0.4) < 5.0 * light.vignetting_error_at(1.0) < 0.05


def test_the_error_terms_of_the_library_page_are_those_of_drawn_centroids(capsys):
    """0.02 px of noise at 5.5 arcsec; half of a filter shift of 0.24 px; a cubic distortion that is removed."""
    rng = np.random.default_rng(6)
    grid = np.stack(np.meshgrid(np.linspace(-0.9, 0.9, 8), np.linspace(-0.45, 0.45, 6)), -1).reshape(-1, 2)
    filter_px = rng.uniform(0, 1000, (4, 9, 1, 2)) + np.array([[0.0, 0.1], [0.0, 0.0], [0.24, 0.0]])
    nominal_px = 1000.0 * grid
    test_px = nominal_px + 3.0 * grid**3 + 0.02 * rng.standard_normal(grid.shape)
    names = {
        "centroid_px": 0.02 * rng.standard_normal((50, 40, 2)),
        "step_px": 0.02 * rng.standard_normal((12, 40, 2)),
        "sigma_px": np.full((12, 40, 2), 1e-6),
        "frames": np.full(12, 10),
        "filter_px": filter_px,
        "nominal_px": nominal_px,
        "position": grid,
        "earlier_px": test_px,
        "test_px": test_px,
    }
    for name in ("temporal_error", "high_frequency_error", "band_pairs", "deleted_rms_px", "stellar_chromatic_shift"):
        exec(block("docs/library.md", name), names)
    assert names["te"].arcsec == pytest.approx([0.33, 0.33], rel=0.05)
    lines = capsys.readouterr().out.splitlines()
    assert numbers(lines[1]) == pytest.approx([0.33 * 2**0.5] * 2, rel=0.15)
    assert numbers(lines[2]) == pytest.approx([0.02] * 2, rel=0.15)
    assert numbers(lines[4].split(" ", 1)[1]) == pytest.approx([0.12, 0.0], abs=1e-9)
    left_out = np.reshape(numbers(" ".join(lines[8:])), (2, 2))
    assert (left_out[0] > 0.02).all()
    assert (left_out < 0.1).all()
    assert 5e-5 < abs(names["shift_mm"][0, 1, 0]) < 2e-3
    assert abs(names["shift_mm"][0, 0]).max() < 1e-12


def test_the_light_of_the_library_page_is_by_source(capsys):
    names = run_block("SkySimulator")
    means = ast.literal_eval(capsys.readouterr().out)
    seen = names["seen"]
    assert set(means) == {"stars", "sky", "dark"}
    assert means["stars"] + means["sky"] == pytest.approx(seen.light.electrons.mean(), rel=1e-4)
    assert (names["again"].dn != seen.frame.dn).mean() > 0.5


def test_pages_of_sensor_and_detector_files_are_those_of_their_models():
    spec = spec_from_file_location("make_sensor_file_page", ROOT / "docs" / "make_sensor_file_page.py")
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    for page, text in ((module.PAGE, module.page()), (module.DETECTOR_PAGE, module.detector_page())):
        assert page.read_text(encoding="utf-8") == text, "run python docs/make_sensor_file_page.py"


EXAMPLES = [
    path.relative_to(ROOT)
    for room in ("optics", "render", "calib", "experiments")
    for path in sorted((ROOT / room).rglob("*.py"))
    if ">>>" in path.read_text(encoding="utf-8")
]


@pytest.mark.parametrize("path", EXAMPLES, ids=str)
def test_examples_of_docstrings_run(path):
    module = import_module(".".join(path.with_suffix("").parts))
    with np.printoptions(legacy=False):  # other packages may have asked for spaces in arrays
        assert doctest.testmod(module, globs={**vars(module), "np": np}).failed == 0


def test_every_page_stands_in_a_table_of_contents():
    """Pages that no toctree names are in no menu, and a warning of the build."""
    pages = {page.relative_to(ROOT / "docs").with_suffix("").as_posix() for page in PAGES if page.parent != ROOT}
    named = set()
    for page in (ROOT / "docs").rglob("*.md"):
        for body in re.findall(r"```\{toctree\}\n(.*?)```", page.read_text(encoding="utf-8"), re.S):
            rows = [row.strip() for row in body.splitlines() if row.strip() and not row.startswith(":")]
            named |= {(page.parent / row).resolve().relative_to(ROOT / "docs").as_posix() for row in rows}
    assert pages - named == {"index"}


@pytest.mark.parametrize("path", sorted((ROOT / "docs" / "gallery").glob("plot_*.py")), ids=lambda path: path.name)
def test_a_script_of_the_gallery_is_short(path):
    """What it shows takes 30 lines at most; the text above them, comments and empty lines do not count."""
    source = path.read_text(encoding="utf-8")
    title = ast.parse(source).body[0]
    code = [line for line in source.splitlines()[title.end_lineno :] if line.strip() and not line.startswith("#")]
    assert isinstance(title, ast.Expr)
    assert len(code) <= 30
