"""Record of the chromatic test."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from experiments.chromatic.perturbation import Solution
from experiments.chromatic.settings import Config
from experiments.chromatic.stars import StellarShift
from experiments.laboratory.bench import Bench
from experiments.laboratory.chromatic_error import ChromaticReduction
from experiments.laboratory.collimator_effects import ChromaticEffect
from experiments.laboratory.instrument import Instrument
from experiments.laboratory.known_motion import WedgedFilter
from experiments.laboratory.signal import Signal
from optics.arrays import FloatArray

__all__ = ["Result"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Result:
    """Everything the run found."""

    config: Config  # Settings
    bench: Bench  # The laboratory with the centred lens
    instrument: Instrument  # The laboratory with the centred lens
    centred: ChromaticReduction  # The lens as designed; with the element of ``chosen`` moved
    moved: ChromaticReduction  # The lens as designed; with the element of ``chosen`` moved
    wedged: WedgedFilter  # The lens as designed with a wedge in one filter
    paraxial_px: FloatArray  # (p, j, b, 2) Paraxial lateral colour of the centred lens
    solutions: Sequence[Solution]  # The movement of each element, decentre and tilt, that gives the published number
    chosen: Solution  # The one that was rendered
    stellar: StellarShift  # Stars through the full pass band
    field_shift_px: Mapping[str, FloatArray]  # (g, 2) Shifts between the filters at the stars' places, by ray trace
    moved_stellar: StellarShift  # The same stars through the lens with the moved element
    star_e: float  # Electrons of a V = 7.5 star of the reference temperature through the full pass band
    # What the collimator adds to Table 1 of the centred lens; None for a perfect one
    collimator: ChromaticEffect | None
    # Of a point behind every filter, and the star that gives as many electrons through the full pass band
    signal: Signal

    @property
    def pairs(self) -> Sequence[tuple[str, int, int]]:
        """Pairs of bands; see `experiments.laboratory.bench.band_pairs`."""
        return self.bench.pairs
