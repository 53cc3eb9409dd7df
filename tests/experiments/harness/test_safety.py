"""Nothing of the user's is lost or hidden: folders of other runs, read-only homes, modules of the same name."""

import os
import shutil
import subprocess
import sys
from dataclasses import replace
from importlib import import_module
from pathlib import Path

import pytest

from experiments.__main__ import main as starbench
from experiments.harness.cli import command
from experiments.harness.registry import declared

ROOT = Path(__file__).parents[3]


@pytest.fixture(scope="module")
def main(in_words):
    """The command."""
    return command(in_words)


@pytest.fixture(scope="module")
def earlier(main, tmp_path_factory):
    """A run with seed 3."""
    folder = tmp_path_factory.mktemp("earlier") / "out"
    assert main(["--quick", "--seed", "3", "--out", str(folder)]) in (0, 1)
    return folder


@pytest.fixture
def folder(earlier, tmp_path):
    """A copy of it."""
    shutil.copytree(earlier, tmp_path / "out")
    return tmp_path / "out"


def contents(folder):
    return {path.name: path.read_bytes() for path in folder.glob("*.*")}


def test_a_run_with_other_settings_is_kept(main, folder, capsys):
    before = contents(folder)
    assert main(["--quick", "--seed", "4", "--set", "label=b", "--out", str(folder)]) == 2
    printed = capsys.readouterr().err
    assert "holds a run with label = " in printed or "holds a run with seed = 3, this one has 4" in printed
    assert "1 more difference" in printed
    assert "--force" in printed
    assert contents(folder) == before


@pytest.mark.parametrize("arguments", [("--seed", "3"), ("--seed", "4", "--force")])
def test_the_same_settings_replace_and_force_replaces_others(main, folder, arguments):
    before = contents(folder)["provenance.json"]
    assert main(["--quick", *arguments, "--out", str(folder)]) in (0, 1)
    assert contents(folder)["provenance.json"] != before


def test_a_run_of_another_experiment_is_kept(in_words, folder, capsys):
    other = command(replace(in_words, name="photon_noise"))
    assert other(["--quick", "--seed", "3", "--out", str(folder)]) == 2
    assert "holds a run of shot_noise" in capsys.readouterr().err


def test_an_empty_name_is_no_folder(main, capsys):
    assert main(["--out", ""]) == 2
    assert "--out is empty" in capsys.readouterr().err


@pytest.mark.parametrize("name", ["temporal", "skycal", "budget", "dataset"])
def test_frames_is_a_number_wherever_there_is_one(name, capsys):
    config = import_module(f"experiments.{name}.settings").experiment.config
    assert starbench([name, "-h"]) == 0
    options = capsys.readouterr().out
    number = config.model_fields.get("frames") is not None and config.model_fields["frames"].annotation is int
    assert ("--frames" in options) == (number or "frames" in declared(name).options)
    if number:
        assert starbench([name, "--frames", "61", "--defaults", "all"]) == 0
        assert "\nframes = 61\n" in capsys.readouterr().out
        assert starbench([name, "--frames", "mine"]) == 2
        assert "frames = 'mine'" in capsys.readouterr().err


def run_python(*arguments, cwd=ROOT, **environment):
    return subprocess.run(
        [sys.executable, *arguments],
        cwd=cwd,
        env={**os.environ, "PYTHONPATH": str(ROOT), **environment},
        capture_output=True,
        text=True,
        check=False,
        timeout=120,
    )


@pytest.mark.skipif(not Path("/proc/self").exists(), reason="needs a folder that nobody can write")
def test_a_home_that_cannot_be_written_stops_nothing():
    program = "import os; from render.engine import Engine; print(Engine.start('llvm').types.Float64(2.0) * 3.0)"
    done = run_python("-c", f"{program}; print(os.environ['HOME'])", HOME="/proc/none")
    assert (done.returncode, done.stdout, done.stderr) == (0, "[6]\n/proc/none\n", "")


@pytest.mark.parametrize("hidden", ["optics.py", "render/__init__.py"])
def test_a_module_that_hides_ours_is_named_in_one_line(hidden, tmp_path):
    (tmp_path / hidden).parent.mkdir(exist_ok=True)
    (tmp_path / hidden).touch()
    done = run_python("-m", "experiments", "chromatic", "--help", cwd=tmp_path)
    assert done.returncode == 2
    assert done.stderr == (
        f"error: {tmp_path / hidden} hides the package {hidden[:6]!r} of starbench; rename it or start elsewhere\n"
    )
    (tmp_path / "script.py").write_text("from calib import find_stars\n", encoding="utf-8")
    done = run_python("script.py", cwd=tmp_path)
    assert done.stderr.splitlines()[-1].startswith(f"ImportError: {tmp_path / hidden} hides")
