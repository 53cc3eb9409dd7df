"""What the turntable calibration gives, before anybody writes about it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from experiments.laboratory.instrument import Instrument
from experiments.turntable.bound import FieldPoint
from experiments.turntable.case import Case
from experiments.turntable.lenses import LensPoint
from experiments.turntable.monte_carlo import LeanPoint, ReadingPoint
from experiments.turntable.settings import Config
from experiments.turntable.traced import TracedMap

__all__ = ["Result"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Result:
    """The whole run."""

    config: Config  # Settings
    instrument: Instrument  # Camera under test
    traced: TracedMap  # Its truth
    cases: Sequence[Case]  # Two-axis table, three-axis table
    reading_sweep: Sequence[ReadingPoint]  # On the two-axis table
    lean_sweep: Sequence[LeanPoint]  # On the two-axis table
    centroid_bound_arcsec: float  # Bound of the map error there with perfect readings
    field_sweep: Sequence[FieldPoint]  # Ideal cameras
    field_sigma_px: float  # Error of an image in that sweep
    lenses: Sequence[LensPoint]  # What the camera model leaves of traced lenses
