"""The list of broken equations cannot rot: what it breaks is there, and what should notice is there."""

import ast
import runpy
from collections import Counter
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
MUTANTS = runpy.run_path(str(ROOT / "benchmarks" / "mutants.py"))
LIST = MUTANTS["read_list"]()


def test_every_equation_stands_where_it_is_broken():
    for mutant in LIST:
        broken = mutant.broken((ROOT / mutant.file).read_text(encoding="utf-8"))
        ast.parse(broken)
        assert mutant.new in broken, mutant.name


def test_what_should_notice_is_there():
    for mutant in LIST:
        assert mutant.tests, mutant.name
        assert all((ROOT / test).is_file() for test in mutant.tests), mutant.name
        assert all((ROOT / "experiments" / name / "__main__.py").is_file() for name in mutant.experiments), mutant.name


def test_sixty_equations_of_all_rooms_each_once():
    assert len({mutant.name for mutant in LIST}) == len(LIST) >= 60
    rooms = Counter(mutant.file.split("/")[0] for mutant in LIST)
    assert all(rooms[room] >= 10 for room in ("optics", "render", "calib", "experiments"))


def test_an_equation_that_is_gone_or_stands_twice_is_refused():
    with pytest.raises(ValueError, match=f"{LIST[0].name}: .* occurs 0 times in {LIST[0].file}"):
        LIST[0].broken("x = 1\n")
    with pytest.raises(ValueError, match="occurs 2 times"):
        LIST[0].broken(f"{LIST[0].old}\n{LIST[0].old}\n")
