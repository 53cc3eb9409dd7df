"""Sweeps and comparisons as part of a declaration: ``--sweep KEY=LOW:HIGH:POINTS`` and several ``--sensor``.

``experiment = with_what_if(Experiment(..., predict="module:predict", swept=(...)))`` gives both to any experiment that
predicts its numbers without frames; the work is in `experiments.harness.what_if`.
"""

from __future__ import annotations

import math
from dataclasses import replace
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any, ClassVar

from pydantic import Field, create_model, model_validator

from experiments.harness.config import ExperimentConfig
from experiments.harness.experiment import Experiment
from experiments.harness.range import SweepRange, parse_sweep

MOST_POINTS, MOST_SENSORS = 400, 7


class SweptConfig(ExperimentConfig):
    """A configuration of which one or two numbers may be swept."""

    NOT_SWEPT: ClassVar[frozenset[str]] = frozenset()
    """Tables that say nothing of the prediction."""

    sweep: tuple[str, ...] = Field(
        default=(),
        max_length=2,
        description="KEY=LOW:HIGH:POINTS[:log] or KEY=A,B,C of a key of the sensor; two: a map",
    )

    @model_validator(mode="after")
    def _sweeps(self) -> SweptConfig:
        ranges = self.sweep_ranges
        if len({axis.key for axis in ranges}) < len(ranges):
            raise ValueError(f"--sweep: {ranges[0].key} is swept twice")
        points = math.prod(len(axis.values) for axis in ranges)
        if points > MOST_POINTS:
            raise ValueError(f"--sweep: {points} points; at most {MOST_POINTS} together")
        return self

    @property
    def sweep_ranges(self) -> tuple[SweepRange, ...]:
        """Keys that are swept, with their values."""
        return tuple(parse_sweep(text, type(self), self.NOT_SWEPT) for text in self.sweep)


def with_what_if(declared: Experiment, *, renders: bool = False) -> Experiment:
    """The experiment with ``--sweep``, and with several ``--sensor`` next to each other.

    ``renders`` says that the prediction renders too (PSFs), so that the backend has to be ready.
    """

    def instead(config: Any) -> Experiment | None:
        if config.sweep:
            return _sweep(declared, renders)
        return declared.instead(config) if declared.instead is not None else None

    option = "KEY=LOW:HIGH:POINTS[:log] or KEY=A,B,C: predict over a range of any numeric setting; two give a map."
    return replace(
        declared,
        options={**declared.options, "sweep": ("sweep", option)},
        instead=instead,
        comparison=_comparison(declared, renders),
    )


def _sweep(declared: Experiment, renders: bool) -> Experiment:
    return Experiment(
        name=declared.name,
        config=declared.config,
        run=lambda config, *, progress: _what_if("run_sweep", declared, config, progress=progress),
        sections=partial(_what_if, "sweep_sections"),
        report=Path(__file__).with_name("what_if.md"),
        show=("sweep",),
        renders=lambda _: renders,
    )


def _comparison(declared: Experiment, renders: bool) -> Experiment:
    sensor: Any = declared.config
    sensors = Field(
        default_factory=lambda: (sensor(),), min_length=1, max_length=MOST_SENSORS, description="sensors to compare"
    )
    return Experiment(
        name=declared.name,
        config=create_model(
            "ComparisonConfig",
            __base__=_Comparison,
            __module__=sensor.__module__,
            sensors=(tuple[sensor, ...], sensors),
        ),
        run=lambda config, *, progress: _what_if("run_comparison", declared, config.sensors, progress=progress),
        sections=partial(_what_if, "comparison_sections"),
        report=Path(__file__).with_name("comparison.md"),
        show=("sensors", "requirements"),
        renders=lambda _: renders,
    )


def _what_if(name: str, *arguments: Any, **options: Any) -> Any:
    """Call a function of `experiments.harness.what_if`, which is slow to import."""
    return getattr(import_module("experiments.harness.what_if"), name)(*arguments, **options)


class _Comparison(ExperimentConfig):
    """A configuration per sensor."""

    sensors: tuple[Any, ...]

    @model_validator(mode="after")
    def _no_sweep(self) -> _Comparison:
        if any(sensor.sweep for sensor in self.sensors):
            raise ValueError("a sweep is of one sensor: give one --sensor, or no --sweep")
        return self
