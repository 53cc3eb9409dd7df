"""What the experiment on star vectors gives, before anybody writes about it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from experiments.fisher.bench import BenchRun
from experiments.fisher.coverage import CoveragePoint
from experiments.fisher.field import FieldPoint
from experiments.fisher.limits import DigitsPoint, TablePoint
from experiments.fisher.same import SamePoint
from experiments.fisher.settings import Config
from experiments.laboratory.instrument import Instrument

__all__ = ["Result"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Result:
    """The whole run.

    Attributes
    ----------
    config : Config
        Settings.
    instrument : Instrument
        Camera under test.
    bench : BenchRun
        Rendered: calibration, acquisitions, evaluations.
    field_sweep : sequence of FieldPoint
        Pixel method against Fisher on ideal cameras.
    coverage : sequence of CoveragePoint
        Of the confidence interval.
    same_data : sequence of SamePoint
        Calibrating and evaluating with the same data.
    digits : sequence of DigitsPoint
        Numerics of 1 - R.
    table_sweep : sequence of TablePoint
        What is measured on other tables.
    runtime_s, peak_memory_mb : float
        Cost.
    """

    config: Config
    instrument: Instrument
    bench: BenchRun
    field_sweep: Sequence[FieldPoint]
    coverage: Sequence[CoveragePoint]
    same_data: Sequence[SamePoint]
    digits: Sequence[DigitsPoint]
    table_sweep: Sequence[TablePoint]
    runtime_s: float
    peak_memory_mb: float
