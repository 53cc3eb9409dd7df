"""JSON of results: valid whatever is in it, complete, and criteria that NaN cannot pass."""

import enum
import json
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from refusals import refuses

from experiments.harness.config import ExperimentConfig
from experiments.harness.summary import Criterion, Measured, dumps, summary
from optics.errors import DomainError


class Colour(enum.Enum):
    RED = "red"


@dataclass(frozen=True, slots=True)
class Record:
    array: np.ndarray
    name: str


class Config(ExperimentConfig):
    width_nm: float = 100.0


def refuse_constant(name):
    raise AssertionError(f"{name} is no JSON")


def test_every_type_and_no_nan():
    value = {
        "nan": float("nan"),
        "array": np.array([[1.0, np.nan], [np.inf, -0.5]]),
        "float32": np.float32(0.5),
        "int64": np.int64(7),
        "bool": np.bool_(True),
        "record": Record(array=np.arange(3, dtype=np.uint16), name="x"),
        "measured": Measured(value=1.0, unit="px"),
        "enum": Colour.RED,
        Colour.RED: 1,
        "path": Path("/somewhere/of/one/machine/lens.toml"),
        "set": {3, 1, 2},
        "none": None,
        "model": Config(),
        500: "number as key",
    }
    assert json.loads(dumps(value), parse_constant=refuse_constant) == {
        "nan": None,
        "array": [[1.0, None], [None, -0.5]],
        "float32": 0.5,
        "int64": 7,
        "bool": True,
        "record": {"array": [0, 1, 2], "name": "x"},
        "measured": {"value": 1.0, "unit": "px", "uncertainty": None, "n": None},
        "enum": "red",
        "red": 1,
        "path": "lens.toml",
        "set": [1, 2, 3],
        "none": None,
        "model": {"seed": 1, "width_nm": 100.0},
        "500": "number as key",
    }


def test_doubles_survive_to_the_last_bit():
    numbers = np.random.default_rng(3).normal(size=200) * 10.0 ** np.arange(-100, 100)
    assert json.loads(dumps(numbers)) == numbers.tolist()


@pytest.mark.parametrize(
    ("value", "relation", "limit", "passed"),
    [
        (1.0, "<=", 1.0, True),
        (1.0, "<", 1.0, False),
        (1.0, ">=", 1.0, True),
        (0.9, ">=", 1.0, False),
        (1.1, ">", 1.0, True),
        (math.nan, "<=", 1.0, False),
        (math.nan, ">=", 1.0, False),
        (math.inf, "<=", 1.0, False),
    ],
)
def test_criterion(value, relation, limit, passed):
    assert Criterion(name="n", value=value, limit=limit, relation=relation).passed is passed


@pytest.mark.parametrize(
    ("value", "passed"), [(1.2, True), (0.8, True), (1.3, False), (0.7, False), (-1.0, False), (math.nan, False)]
)
def test_criterion_about_a_value(value, passed):
    one = Criterion(name="n", value=value, limit=0.25, about=1.0)
    assert one.passed is passed
    assert one.demand == "1 ± 0.25"
    (written,) = summary("demo", Config(), {}, [one])["criteria"]
    assert (written["limit"], written["about"], written["passed"]) == (0.25, 1.0, passed)


def test_criterion_that_means_nothing_is_refused():
    refuses(DomainError, "relation", Criterion, name="n", value=1.0, limit=1.0, relation="==")
    refuses(DomainError, "NaN", Criterion, name="n", value=1.0, limit=math.nan)
    refuses(DomainError, "says nothing", Criterion, name="n", value=1.0, limit=1.0, relation=">=", about=1.0)


def test_summary_holds_what_it_always_holds():
    criteria = [Criterion(name="bias", value=np.float64("nan"), limit=0.01, unit="px")]
    content = summary("demo", Config(seed=4), {"bias_px": np.nan}, criteria)
    assert list(content) == ["experiment", "seed", "config", "results", "criteria"]
    assert content["seed"] == 4
    assert content["config"] == {"seed": 4, "width_nm": 100.0}
    assert content["results"] == {"bias_px": None}
    assert content["criteria"] == [{"name": "bias", "value": None, "limit": 0.01, "unit": "px", "passed": False}]
