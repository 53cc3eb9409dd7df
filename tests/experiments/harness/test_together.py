"""All experiments in one go: the page links what exists and says what failed."""

import json
import sys

import pytest

from experiments.__main__ import main
from experiments.harness import together

KNOWN = {"alpha": "The first.", "beta": "The <second>."}


@pytest.fixture
def scripted(monkeypatch, tmp_path):
    """``runs``: exit status and passed criteria of each experiment, whose processes are stood in for; ``started``."""
    monkeypatch.chdir(tmp_path)
    runs, started = {}, []

    def run(command, check):
        assert check is False
        started.append(command)
        name = command[3]
        code, passed = runs[name]
        if passed is not None:
            folder = tmp_path / "out" / name
            folder.mkdir(parents=True)
            criteria = [{"name": f"number {k}", "passed": ok} for k, ok in enumerate(passed)]
            (folder / "summary.json").write_text(json.dumps({"criteria": criteria}))
            (folder / "provenance.json").write_text(json.dumps({"runtime_s": 12.0, "quick": True}))
        return type("Done", (), {"returncode": code})()

    monkeypatch.setattr(together.subprocess, "run", run)
    monkeypatch.setattr(together, "experiment_names", lambda: KNOWN)
    return runs, started


def test_page_links_reports_and_names_failures(tmp_path, scripted, capsys):
    runs, started = scripted
    runs |= {"alpha": (0, (True, True)), "beta": (1, (True, False, None))}
    assert main(["--quick", "--all", "--seed", "0"]) == 1
    page = (tmp_path / "out" / "index.html").read_text(encoding="utf-8")
    assert '<a href="alpha/report.html">' in page
    assert "2 of 2 criteria hold" in page
    assert "1 of 2 criteria hold; not: number 1; 1 not judged" in page
    assert "The &lt;second&gt;." in page
    assert "12 s" in page
    assert "quick runs" in page
    assert started[0] == [
        *(sys.executable, "-m", "experiments", "alpha", "--out", "out/alpha"),
        *("--quick", "--seed", "0", "--backend", "auto"),
    ]
    assert "index.html" in capsys.readouterr().out
    together.write_index(
        [together.read_entry(tmp_path / "out" / "alpha", 0) | {"name": "alpha", "about": ""}], tmp_path
    )
    assert sorted(path.name for path in tmp_path.iterdir()) == ["index.html", "out"]


@pytest.mark.parametrize(
    ("runs", "words", "status", "ran", "printed"),
    [
        ({"alpha": (2, None), "beta": (0, (True,))}, [], 3, ["alpha", "beta"], "no result (exit code 2)"),
        ({"alpha": (130, None)}, [], 130, ["alpha"], "no result (exit code 130)"),
        ({"beta": (0, (True,))}, ["beta"], 0, ["beta"], "1 of 1"),
    ],
)
def test_what_runs_and_what_is_said(tmp_path, scripted, runs, words, status, ran, printed):
    scripted[0].update(runs)
    assert main(["all", *words]) == status
    assert [command[3] for command in scripted[1]] == ran
    page = (tmp_path / "out" / "index.html").read_text(encoding="utf-8")
    assert printed in page
    assert ("alpha/report.html" in page) == ("alpha" in ran and status == 0)


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["alhpa"], "unknown experiment 'alhpa'; did you mean alpha?"),
        (["--out", "file/below"], "cannot be written"),
        (["--out", "mine"], "not written by this program"),
    ],
)
def test_bad_input(tmp_path, capsys, scripted, arguments, expected):
    (tmp_path / "file").touch()
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "index.html").write_text("<h1>thesis</h1>")
    assert main(["all", *arguments]) == 2
    printed = capsys.readouterr().err
    assert expected in printed
    assert printed.count("\n") == 1
    assert scripted[1] == []
    assert (tmp_path / "mine" / "index.html").read_text() == "<h1>thesis</h1>"
