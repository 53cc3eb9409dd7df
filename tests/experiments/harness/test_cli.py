"""The command line from end to end: exit codes, one clear line, complete output, nothing left after an interruption."""

import json
import os
import re
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from astropy.table import Table as AstropyTable
from refusals import refuses
from scipy.io import netcdf_file

from experiments import run_experiment
from experiments.__main__ import main as starbench
from experiments.harness.cli import command
from experiments.harness.registry import experiment_names
from optics.errors import ConfigError

ROOT = Path(__file__).parents[3]
SCRIPT = Path(__file__).parents[1] / "shot_noise.py"


FILES = ["levels.ecsv", "report.html", "results.nc", "summary.json"]


def names(folder):
    return sorted(path.name for path in folder.iterdir())


@pytest.fixture(scope="module")
def output(shot_noise, tmp_path_factory):
    """One complete run that several tests read."""
    folder = tmp_path_factory.mktemp("run") / "shot_noise"
    status = shot_noise.main(["--out", str(folder), "--seed", "3", "--set", "label=<b>7 & 8</b>"])
    return status, folder


def test_run_writes_everything(output):
    status, folder = output
    assert status == 0
    assert names(folder) == sorted(["frames", "provenance.json", *FILES])
    assert names(folder.parent) == ["shot_noise"]
    text = (folder / "provenance.json").read_text()
    record = json.loads(text)
    assert [record[key] for key in ("program", "seed", "quick")] == ["starbench", 3, False]
    assert record["packages"]["numpy"] == np.__version__
    assert 0 < record["stages_s"]["draw"] < record["runtime_s"]
    assert 10 < record["peak_memory_mb"] < 1e5
    assert sorted(record["files"]) == ["frames/variance.npy", *FILES]
    assert str(folder) not in text
    assert str(ROOT) not in text


def test_quantities_are_read_back_by_other_programs(output):
    """ECSV by astropy, netCDF by SciPy's own reader, and the array that the experiment saved itself."""
    folder = output[1]
    saved = np.load(folder / "frames" / "variance.npy").tolist()
    levels = json.loads((folder / "summary.json").read_text())["results"]["levels"]
    assert levels["variance_e2"]["value"] == saved
    assert AstropyTable.read(folder / "levels.ecsv", format="ascii.ecsv")["variance_e2"].tolist() == saved
    with netcdf_file(folder / "results.nc", mmap=False) as data:
        variable = data.variables["levels.variance_e2"]
        assert variable.data.tolist() == saved
        assert variable.long_name == b"Variance"
        assert variable.ancillary_variables == b"levels.variance_e2_error"
        assert variable.dimensions == ("level",)


def test_report_stands_alone_and_is_escaped(output):
    text = (output[1] / "report.html").read_text(encoding="utf-8")
    assert re.findall(r'(?:src|href)="(?!#|data:)([^"]+)"', text) == []
    for tag in ("section", "div", "p", "figure", "table", "tr", "td", "dl", "details", "nav", "footer", "a", "svg"):
        assert len(re.findall(rf"<{tag}[ >]", text)) == text.count(f"</{tag}>"), tag
    assert "@import" not in text
    assert not re.search(r"url\((?!#)", text)
    assert "<script" not in text
    ids = re.findall(r'\bid="([^"]+)"', text)
    assert len(ids) == len(set(ids))
    assert "&lt;b&gt;7 &amp; 8&lt;/b&gt;" in text
    assert "<b>7" not in text
    assert text.count("<svg") == 4  # two drawings, one of them for narrow screens too, and an equation
    assert text.count("data:image/png;base64,") == 1


def test_same_seed_same_bytes_also_from_python(shot_noise, tmp_path, output):
    run = run_experiment(shot_noise.experiment, {"label": "<b>7 & 8</b>"}, seed=3, out=tmp_path / "again")
    for name in ("summary.json", "results.nc", "levels.ecsv", "frames/variance.npy"):
        assert (tmp_path / "again" / name).read_bytes() == (output[1] / name).read_bytes()

    def drawings(folder):
        return re.findall(r"<svg.*?</svg>", (folder / "report.html").read_text(encoding="utf-8"), flags=re.DOTALL)

    assert drawings(tmp_path / "again") == drawings(output[1])
    written = AstropyTable.read(output[1] / "levels.ecsv")
    assert (run.table("levels")["variance_e2"] == written["variance_e2"]).all()
    assert run.draw("draw").axes
    assert "1 criteria met" in repr(run)
    refuses(ConfigError, "chromatic", run_experiment, "chromatik")
    refuses(ConfigError, "name a folder", run_experiment, "dataset")
    refuses(ConfigError, "known: levels", run.table, "stars")
    refuses(ConfigError, "did you mean draw", run.draw, "drow")


def test_failed_criterion_is_exit_1_and_still_written(in_words, tmp_path, capsys):
    out = tmp_path / "out"
    assert command(in_words)(["--quick", "--out", str(out), "--set", "limit_sigma=1e-6"]) == 1
    assert "the criterion does not hold." in capsys.readouterr().out
    assert json.loads((out / "summary.json").read_text())["criteria"][0]["passed"] is False


def test_quick_yields_to_the_user(in_words, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    main = command(in_words)
    assert main(["--quick"]) in (0, 1)
    assert main(["--quick", "--out", "b", "--set", "samples=3000"]) in (0, 1)
    a, b = (json.loads((tmp_path / at / "summary.json").read_text())["config"] for at in ("out/shot_noise", "b"))
    assert (a["samples"], b["samples"]) == (2000, 3000)
    assert a["bands"][1]["name"] == b["bands"][1]["name"] == "quick"


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["--set", "smaples=3"], "did you mean 'samples'"),
        (["--seed", "-1"], "-1"),
        (["--backend", "gpu"], "'auto', 'llvm', 'cuda'"),
        (["--config", "absent.toml"], "absent.toml: no such file"),
        (["--set", "mean_e=[1e13]"], "lower it"),  # noticed by the run only
        (["--sensor", "a.toml", "--sensor", "b.toml"], "shot_noise takes one sensor"),
    ],
)
def test_bad_input_is_one_line_and_exit_2(shot_noise, tmp_path, capsys, monkeypatch, arguments, expected):
    monkeypatch.chdir(tmp_path)
    assert shot_noise.main(arguments) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    assert printed.err.startswith("error: ")
    assert printed.err.count("\n") == 1
    assert expected in printed.err
    assert names(tmp_path) == []


def test_unwritable_output_is_found_before_the_work(shot_noise, tmp_path, capsys):
    def never(config, *, progress):
        raise AssertionError("the work began")

    main = command(replace(shot_noise.experiment, run=never))
    (tmp_path / "file").touch()
    assert main(["--out", str(tmp_path / "file" / "below")]) == 2
    assert capsys.readouterr().err.count("\n") == 1


def test_fault_of_the_program_is_not_mistaken_for_a_failed_criterion(shot_noise, tmp_path, capsys):
    def broken(outcome, width="full"):
        raise ZeroDivisionError

    levels = replace(shot_noise.SECTIONS["levels"], figures={"draw": broken})
    main = command(replace(shot_noise.experiment, sections={**shot_noise.SECTIONS, "levels": levels}))
    assert main(["--out", str(tmp_path / "out")]) == 3
    assert "ZeroDivisionError" in capsys.readouterr().err
    assert names(tmp_path) == []


def test_interruption_leaves_nothing_behind(tmp_path):
    process = subprocess.Popen(
        [sys.executable, str(SCRIPT), "--out", str(tmp_path / "deep" / "out"), "--set", "pause_s=30"],
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert process.stderr.readline() == "drawing\n"
    process.send_signal(signal.SIGINT)
    printed = process.communicate(timeout=60)
    assert process.returncode == 130
    assert "interrupted; nothing was written" in printed[1]
    assert "Traceback" not in printed[1]
    assert names(tmp_path) == []


def test_unknown_experiment_schema_and_version(shot_noise, capsys):
    assert starbench(["tempral"]) == 2
    assert "temporal" in capsys.readouterr().err
    assert starbench(["--version"]) == 0
    assert capsys.readouterr().out.startswith("starbench")
    assert shot_noise.main(["--schema"]) == 0
    schema = json.loads(capsys.readouterr().out)
    assert schema["properties"]["samples"]["description"] == "pixels per level"
    assert schema["additionalProperties"] is False


def test_listing_imports_nothing_heavy():
    program = (
        "import runpy, sys\n"
        "sys.argv = ['experiments']\n"
        "try:\n    runpy.run_module('experiments', run_name='__main__')\n"
        "except SystemExit as end:\n    assert end.code == 0\n"
        "heavy = {'numpy', 'mitsuba', 'matplotlib', 'astropy', 'pydantic', 'rich'} & set(sys.modules)\n"
        "assert not heavy, heavy\n"
    )
    done = subprocess.run([sys.executable, "-c", program], cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    for name in experiment_names():
        assert name in done.stdout


@pytest.mark.parametrize(
    ("name", "advice"), [("camra", "did you mean camera?"), ("lens", "python -m experiments lens")]
)
def test_python_m_of_no_experiment_names_what_was_meant(name, advice):
    done = subprocess.run([sys.executable, "-m", f"experiments.{name}"], capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert advice in done.stderr
    assert done.stderr.count("\n") == 1
