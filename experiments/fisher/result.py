"""What the experiment on star vectors gives, as numbers and records."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from experiments.fisher.bench import BenchRun
from experiments.fisher.coverage import CoveragePoint
from experiments.fisher.degrees_of_freedom import SameDataPoint
from experiments.fisher.field_of_view import FieldPoint
from experiments.fisher.precision import DigitsPoint
from experiments.fisher.settings import Config
from experiments.fisher.table_noise import TablePoint
from experiments.laboratory.instrument import Instrument

__all__ = ["Result"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Result:
    """The whole run."""

    config: Config  # Settings
    instrument: Instrument  # Camera under test
    bench: BenchRun  # Rendered: calibration, acquisitions, evaluations
    field_sweep: Sequence[FieldPoint]  # Pixel method against Fisher on ideal cameras
    coverage: Sequence[CoveragePoint]  # Of the confidence interval
    same_data: Sequence[SameDataPoint]  # Calibrating and evaluating with the same data
    digits: Sequence[DigitsPoint]  # Numerics of 1 - R
    table_sweep: Sequence[TablePoint]  # What is measured on other tables
