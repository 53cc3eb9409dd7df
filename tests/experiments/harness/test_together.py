"""All experiments in one go: the page links what exists and says what failed."""

import json
import sys

import pytest

from experiments.__main__ import main
from experiments.harness import together
from experiments.harness.together import read_entry, write_index

KNOWN = {"alpha": "The first.", "beta": "The <second>."}


def run_all(arguments):
    return main(["--all", *arguments])


def result(folder, *passed, runtime_s=12.0):
    """A folder as an experiment leaves it, with criteria that hold or do not."""
    folder.mkdir(parents=True)
    criteria = [
        {"name": f"number {k}", "value": 1, "limit": 2, "unit": "", "passed": ok} for k, ok in enumerate(passed)
    ]
    (folder / "summary.json").write_text(json.dumps({"criteria": criteria}))
    (folder / "provenance.json").write_text(json.dumps({"runtime_s": runtime_s, "quick": True}))
    (folder / "report.html").write_text("report")


@pytest.fixture
def scripted(monkeypatch, tmp_path):
    """Runs a stand-in process for each experiment that exits as told; gives the commands that were started."""
    codes, started = {}, []

    def run(command, check):
        assert check is False
        started.append(command)
        name = command[3]
        code, passed = codes[name]
        if passed is not None:
            result(tmp_path / "out" / name, *passed)
        return type("Done", (), {"returncode": code})()

    monkeypatch.setattr(together.subprocess, "run", run)
    monkeypatch.setattr(together, "found", lambda: KNOWN)
    return codes, started


def test_page_links_reports_and_names_failures(tmp_path, scripted, capsys):
    codes, started = scripted
    codes |= {"alpha": (0, (True, True)), "beta": (1, (True, False))}
    assert run_all(["--out", str(tmp_path / "out"), "--quick", "--seed", "7"]) == 1
    page = (tmp_path / "out" / "index.html").read_text(encoding="utf-8")
    assert '<a href="alpha/report.html">' in page
    assert "2 of 2 criteria hold" in page
    assert "1 of 2 criteria hold; not: number 1" in page
    assert "The &lt;second&gt;." in page
    assert "12 s" in page
    assert "quick runs" in page
    assert started[0] == [
        *(sys.executable, "-m", "experiments", "alpha", "--out", str(tmp_path / "out" / "alpha")),
        *("--quick", "--seed", "7", "--backend", "auto"),
    ]
    assert "index.html" in capsys.readouterr().out


def test_run_without_result_is_said_and_not_linked(tmp_path, scripted):
    codes, _ = scripted
    codes |= {"alpha": (2, None), "beta": (0, (True,))}
    assert run_all(["--out", str(tmp_path / "out")]) == 3
    page = (tmp_path / "out" / "index.html").read_text(encoding="utf-8")
    assert "alpha/report.html" not in page
    assert "no result (exit code 2)" in page


def test_interrupt_stops_the_rest(tmp_path, scripted):
    codes, started = scripted
    codes |= {"alpha": (130, None)}
    assert run_all(["--out", str(tmp_path / "out")]) == 130
    assert len(started) == 1


def test_names_choose(tmp_path, scripted):
    codes, started = scripted
    codes |= {"beta": (0, (True,))}
    assert run_all(["--out", str(tmp_path / "out"), "beta"]) == 0
    assert [command[3] for command in started] == ["beta"]


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["alhpa"], "unknown experiment 'alhpa'; did you mean alpha?"),
        (["--seed", "-1"], "-1"),
        (["--out", "file/below"], "cannot be written"),
        (["--out", "mine"], "not written by this program"),
        (["--unheard"], "--unheard"),
    ],
)
def test_bad_input(tmp_path, monkeypatch, capsys, scripted, arguments, expected):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "file").touch()
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "index.html").write_text("<h1>thesis</h1>")
    assert run_all(arguments) == 2
    said = capsys.readouterr().err
    assert expected in said
    assert said.count("\n") == 1
    assert scripted[1] == []
    assert (tmp_path / "mine" / "index.html").read_text() == "<h1>thesis</h1>"


def test_page_is_replaced_and_nothing_else_left(tmp_path):
    result(tmp_path / "alpha", True)
    for _ in range(2):
        write_index([read_entry(tmp_path / "alpha", name="alpha", about="", status=0)], tmp_path)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["alpha", "index.html"]
