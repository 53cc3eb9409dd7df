"""Shells complete ``starbench``: real ones, where they are installed."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from experiments.__main__ import COMMANDS, main
from experiments.harness.completion import SHELLS, script

ROOT = Path(__file__).parents[3]
BASH = """
source {script}
complete_line() {{
    COMP_LINE="$*"; COMP_POINT=${{#COMP_LINE}}
    local IFS=$' \\t'; COMP_WORDS=($COMP_LINE); [[ $COMP_LINE == *' ' ]] && COMP_WORDS+=("")
    COMP_CWORD=$(( ${{#COMP_WORDS[@]}} - 1 )); COMPREPLY=()
    compopt() {{ echo "compopt $1 $2"; }}
    _starbench_completion "$(command -v starbench)" "${{COMP_WORDS[COMP_CWORD]}}"
    printf '%s\\n' "${{COMPREPLY[@]}}"
}}
{typed}
"""


@pytest.fixture
def shell(tmp_path):
    """Lines of what a shell prints, with ``starbench`` of this tree in its path."""
    (tmp_path / "starbench").write_text(
        f'#!/bin/sh\nexec "{sys.executable}" -c "import sys; from experiments.__main__ import console; '
        'sys.exit(console())" "$@"\n'
    )
    (tmp_path / "starbench").chmod(0o755)

    def run(name, line, **texts):
        (tmp_path / "script").write_text(script(name))
        (tmp_path / "line").write_text(line.format(script=tmp_path / "script", **texts))
        environment = {**os.environ, "PATH": f"{tmp_path}:{os.environ['PATH']}", "PYTHONPATH": str(ROOT)}
        options = {"bash": ["--norc"], "zsh": ["-f"], "fish": ["--no-config"]}[name]
        command = [shutil.which(name), *options, str(tmp_path / "line")]
        done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
        assert done.stderr == ""
        return done.stdout.split("\n")

    return run


SOON = {
    "starbench do": ["doctor"],
    "starbench chromatic --set instrument.exp": ["compopt -o nospace", "instrument.exposure_s="],
}
LATER = {
    "starbench chromatic --se": ["--seed", "--sensor", "--set"],
    "starbench chromatic --config ": ["compopt -o default"],
    "starbench chromatic --out o": ["compopt -o dirnames"],
    "starbench --al": ["--all"],
    "starbench doctor --j": ["--json"],
    "starbench lens co": ["convert"],
}


@pytest.mark.skipif(shutil.which("bash") is None, reason="needs bash")
@pytest.mark.parametrize("expected", [SOON, pytest.param(LATER, marks=pytest.mark.slow)], ids=["first", "all"])
def test_bash(shell, expected):
    typed = "\n".join(f'complete_line "{line}"; echo ---' for line in expected)
    answers = "\n".join(shell("bash", BASH, typed=typed)).split("---")
    found = [sorted(filter(None, answer.split("\n"))) for answer in answers[: len(expected)]]
    assert found == list(expected.values())


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("fish") is None, reason="needs fish")
def test_fish(shell):
    line = "source {script}\ncomplete -C 'starbench acf --set sky.sta'\necho ---\ncomplete -C 'starbench do'\n"
    first, second = "\n".join(shell("fish", line)).split("---")
    assert first.strip().startswith("sky.stars_per_frame=")
    assert second.strip().startswith("doctor\t")


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("zsh") is None, reason="needs zsh")
def test_zsh(shell):
    line = """
    autoload -U compinit; compinit -D -u; source {script}
    compadd() {{ print -l -- "compadd $*"; }}
    _describe() {{ local name=$3; print -l -- "describe ${{(P)name}}" "$@"; }}
    words=(starbench chromatic --set instrument.exp); CURRENT=4; _starbench_completion
    """
    text = "\n".join(shell("zsh", line))
    assert "describe instrument.exposure_s=:" in text
    assert text.rstrip().endswith("-S")  # what stands before the empty suffix: no space is put behind the key


@pytest.mark.parametrize("name", SHELLS)
def test_the_command_prints_what_a_shell_reads(name, capsys):
    assert main(["completion", name]) == 0
    assert capsys.readouterr().out == script(name)


def test_every_command_has_completion_and_an_unknown_shell_is_a_line(capsys):
    assert set(COMMANDS) == {"completion", "doctor", "frame", "lens"}
    assert main(["completion", "tcsh"]) == 2
    assert "'bash', 'zsh', 'fish'" in capsys.readouterr().err
