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
    ("value", "demand", "passed"),
    [
        (1.0, {"relation": "<="}, True),
        (1.0, {"relation": "<"}, False),
        (1.0, {"relation": ">="}, True),
        (1.1, {"relation": ">"}, True),
        (math.nan, {"relation": "<="}, False),
        (math.nan, {"relation": ">="}, False),
        *((value, {"limit": 0.25, "about": 1.0}, True) for value in (1.2, 0.8)),
        *((value, {"limit": 0.25, "about": 1.0}, False) for value in (1.3, 0.7, -1.0, math.nan)),
    ],
)
def test_criterion(value, demand, passed):
    one = Criterion(**{"name": "n", "value": value, "limit": 1.0} | demand)
    assert one.passed is passed
    (written,) = summary("demo", Config(), {}, {}, [one])["criteria"]
    assert (written["limit"], written["passed"]) == (one.limit, passed)
    if "about" in demand:
        assert (written["about"], one.demand) == (1.0, "1 ± 0.25")


def test_criterion_that_means_nothing_is_refused():
    refuses(DomainError, "relation", Criterion, name="n", value=1.0, limit=1.0, relation="==")
    refuses(DomainError, "NaN", Criterion, name="n", value=1.0, limit=math.nan)
    refuses(DomainError, "says nothing", Criterion, name="n", value=1.0, limit=1.0, relation=">=", about=1.0)


def test_summary_holds_what_it_always_holds():
    criteria = [Criterion(name="bias", value=np.float64("nan"), limit=0.01, unit="px")]
    content = summary("demo", Config(seed=4), {"star": {"bias_px": np.nan}}, {}, criteria)
    assert list(content) == ["experiment", "seed", "config", "results", "coordinates", "criteria"]
    assert content["seed"] == 4
    assert content["config"] == {"seed": 4, "width_nm": 100.0}
    assert content["results"] == {"star": {"bias_px": None}}
    assert content["criteria"] == [{"name": "bias", "value": None, "limit": 0.01, "unit": "px", "passed": False}]
