"""What the turntable calibration gives, before anybody writes about it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from experiments.laboratory.instrument import Instrument
from experiments.laboratory.single_star.measure import Measurement
from experiments.laboratory.single_star.settings import TableConfig
from experiments.turntable.bound import Bound, FieldPoint
from experiments.turntable.lenses import LensPoint
from experiments.turntable.reduce import Reduction
from experiments.turntable.settings import Config
from experiments.turntable.study import Coordinates, LeanPoint, MonteCarlo, ReadingPoint
from experiments.turntable.traced import TracedMap

__all__ = ["CAUSES", "Case", "Result"]

CAUSES = ("model", "centroids", "readings", "leans", "everything")
"""What the error of a calibration is split into; see `Case.split`."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Case:
    """One table.

    Attributes
    ----------
    name : str
        "two-axis" or "three-axis".
    config : TableConfig
        Its settings.
    measurement : Measurement
        The rendered run.
    reductions : dict of str to Reduction
        ``estimated``: non-orthogonality an unknown; ``ignored``: table taken as square; ``known``: taken as it is.
    split : dict of str to Reduction
        Reductions of data with one error at a time (`CAUSES`): true images and angles, leans known, so that only the
        camera model can err; rendered centroids; noisy readings; leans taken as zero; everything, leans estimated.
    coordinates : Coordinates
        The bench with the model of ``split["model"]`` as its camera: the truth of the Monte-Carlo.
    bound : Bound
        Cramer-Rao bound, leans unknown.
    knowledge : dict of str to Bound
        Bounds if something were known that is not.
    shares : dict of str to float
        Map error that each cause of noise makes [arcsec, RMS length]; squares add up.
    monte_carlo : MonteCarlo
        Many runs on coordinates.
    """

    name: str
    config: TableConfig
    measurement: Measurement
    reductions: Mapping[str, Reduction]
    split: Mapping[str, Reduction]
    coordinates: Coordinates
    bound: Bound
    knowledge: Mapping[str, Bound]
    shares: Mapping[str, float]
    monte_carlo: MonteCarlo


@dataclass(frozen=True, slots=True, kw_only=True)
class Result:
    """The whole run.

    Attributes
    ----------
    config : Config
        Settings.
    instrument : Instrument
        Camera under test.
    traced : TracedMap
        Its truth.
    cases : sequence of Case
        Two-axis table, three-axis table.
    reading_sweep, lean_sweep
        On the two-axis table.
    centroid_bound_arcsec : float
        Bound of the map error there with perfect readings.
    field_sweep : sequence of FieldPoint
        Ideal cameras.
    field_sigma_px : float
        Error of an image in that sweep.
    lenses : sequence of LensPoint
        What the camera model leaves of traced lenses.
    runtime_s, peak_memory_mb : float
        Cost.
    """

    config: Config
    instrument: Instrument
    traced: TracedMap
    cases: Sequence[Case]
    reading_sweep: Sequence[ReadingPoint]
    lean_sweep: Sequence[LeanPoint]
    centroid_bound_arcsec: float
    field_sweep: Sequence[FieldPoint]
    field_sigma_px: float
    lenses: Sequence[LensPoint]
    runtime_s: float
    peak_memory_mb: float
