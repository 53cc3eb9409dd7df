"""Shells complete ``starbench``: a real one, and what click answers it."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from experiments.__main__ import COMMANDS, main

ROOT = Path(__file__).parents[2]
BASH = """
source script
COMP_WORDS=(starbench chromatic --set instrument.exp); COMP_CWORD=3
_starbench_completion starbench
printf '%s\\n' "${COMPREPLY[@]}"
"""


@pytest.fixture
def environment(tmp_path):
    """``starbench`` of this tree in the path."""
    (tmp_path / "starbench").write_text(
        f'#!/bin/sh\nexec "{sys.executable}" -c "import sys; from experiments.__main__ import console; '
        'sys.exit(console())" "$@"\n'
    )
    (tmp_path / "starbench").chmod(0o755)
    return {**os.environ, "PATH": f"{tmp_path}:{os.environ['PATH']}", "PYTHONPATH": str(ROOT)}


@pytest.mark.skipif(shutil.which("bash") is None, reason="needs bash")
def test_bash(environment, tmp_path, capsys):
    assert main(["completion", "bash"]) == 0
    (tmp_path / "script").write_text(capsys.readouterr().out)
    done = subprocess.run(
        ["bash", "--norc", "-c", BASH], cwd=tmp_path, env=environment, capture_output=True, text=True, check=False
    )
    assert (done.stdout, done.stderr) == ("instrument.exposure_s=\n", "")


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("starbench do", {"plain,doctor"}),
        pytest.param(
            "starbench chromatic --se", {"plain,--seed", "plain,--sensor", "plain,--set"}, marks=pytest.mark.slow
        ),
    ],
)
def test_answers(environment, line, expected):
    words = {"COMP_WORDS": line, "COMP_CWORD": str(len(line.split(" ")) - 1), "_STARBENCH_COMPLETE": "bash_complete"}
    done = subprocess.run(
        ["starbench"], env={**environment, **words}, capture_output=True, text=True, check=False, cwd=ROOT
    )
    assert set(done.stdout.split("\n")) - {""} == expected


def test_every_command_loads_and_an_unknown_shell_is_a_line(capsys):
    for name in COMMANDS:
        assert main([name, "--help"]) == 0
    capsys.readouterr()
    assert main(["completion", "tcsh"]) == 2
    said = capsys.readouterr().err
    assert "'bash', 'zsh', 'fish'" in said
    assert said.count("\n") == 1
