"""Every experiment of the package, by its name on the command line: what --help says of it, and that this works."""

import re
import shlex
from itertools import pairwise
from pathlib import Path

import pytest

from experiments.__main__ import main as starbench
from experiments.harness.config import load_config
from experiments.harness.registry import declared, experiment_names

ROOT = Path(__file__).parents[3]
TIME = r"\d+ (s|min|minutes|h)"


def test_experiments_alone_are_listed(capsys):
    """Packages with settings and an experiment; neither commands nor the laboratory."""
    assert starbench(["--names"]) == 0
    assert capsys.readouterr().out.split() == sorted(
        path.parent.name for path in ROOT.glob("experiments/*/settings.py") if path.parent.name != "laboratory"
    )


@pytest.mark.parametrize("name", experiment_names())
def test_help_says_what_it_answers_how_long_it_takes_and_how_it_is_used(name, capsys):
    experiment = declared(name)
    assert experiment.name == name
    assert starbench([name, "--help"]) == 0
    printed = capsys.readouterr().out
    assert experiment_names()[name] in " ".join(printed.split())
    assert re.search(rf"Takes {TIME} \(--quick: {TIME}\) on two cores", printed)
    examples = re.findall(rf"^ +python -m experiments\.{name} (.+)\n +(\S.*)$", printed, re.M)
    assert len(examples) >= 2
    for line, does in examples:
        assert len(does) > len("--quick")
        words = shlex.split(line)
        options = set(re.findall(r"^  (--[\w-]+)", printed, re.M))
        assert {word for word in words if word.startswith("--")} <= options
        settings = [value for option, value in pairwise(words) if option == "--set"]
        load_config(experiment.config, settings=settings)
