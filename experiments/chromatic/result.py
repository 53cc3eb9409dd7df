"""Records of the chromatic test: what one lens shows, and all of a run."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from experiments.chromatic.measure import Measurement
from experiments.chromatic.model import Solution
from experiments.chromatic.settings import Config
from experiments.chromatic.stars import StellarShift
from experiments.laboratory.instrument import Instrument
from optics.arrays import FloatArray

__all__ = ["Evaluation", "Result"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Evaluation:
    """Reduction of one lens's measurement; pairs of bands are keys such as "800-600".

    Attributes
    ----------
    measurement : Measurement
        The frames' centroids and the truth.
    shift_px, photon_shift_px, bundle_shift_px, predicted_shift_px : dict of str to (p, j, 2)
        Shifts of eq. 15: measured, of the noiseless light, of the traced bundle, by ray trace alone.
    shift_sigma_px : dict of str to (p, j, 2)
        Standard deviation of a measured shift: frames and predicted fixed pattern.
    table1_px, table1_sigma_px, photon_table1_px, bundle_table1_px, predicted_table1_px : dict of str to (2,)
        Eq. 16 of each, with the standard deviation of the measured.
    method_table1_px : dict of str to dict of str to (2,)
        Eq. 16 by every centroider.
    residual_px, photon_residual_px : dict of str to dict of str to float
        RMS length of the shift as found and after calibration of the band: of the measured, of the noiseless light.
    largest_pull : float
        Largest |measured - photon| / sigma of all points, pairs and axes.
    chi2 : float
        Mean of ((measured - photon) / sigma)^2 over all points, pairs and axes; ``chi2_n`` of them.
    truth_bias_px : (2,)
        Largest and RMS distance of the mean centroid from the photon centroid.
    """

    measurement: Measurement
    shift_px: Mapping[str, FloatArray]
    photon_shift_px: Mapping[str, FloatArray]
    bundle_shift_px: Mapping[str, FloatArray]
    predicted_shift_px: Mapping[str, FloatArray]
    shift_sigma_px: Mapping[str, FloatArray]
    table1_px: Mapping[str, FloatArray]
    table1_sigma_px: Mapping[str, FloatArray]
    photon_table1_px: Mapping[str, FloatArray]
    bundle_table1_px: Mapping[str, FloatArray]
    predicted_table1_px: Mapping[str, FloatArray]
    method_table1_px: Mapping[str, Mapping[str, FloatArray]]
    residual_px: Mapping[str, Mapping[str, float]]
    photon_residual_px: Mapping[str, Mapping[str, float]]
    largest_pull: float
    chi2: float
    chi2_n: int
    truth_bias_px: tuple[float, float]


@dataclass(frozen=True, slots=True, kw_only=True)
class Result:
    """Everything the run found.

    Attributes
    ----------
    config : Config
        Settings.
    instrument : Instrument
        The centred camera.
    pairs : sequence of (str, int, int)
        Pairs of bands.
    centred, moved : Evaluation
        The lens as designed; with the element of ``chosen`` moved.
    paraxial_px : (p, j, b, 2)
        Paraxial lateral colour of the centred lens.
    solutions : sequence of Solution
        The movement of each element, decentre and tilt, that gives the published number.
    chosen : Solution
        The one that was rendered.
    stellar : StellarShift
        Stars through the full pass band.
    field_shift_px : dict of str to (g, 2)
        Shifts between the filters at the stars' places, by ray trace.
    moved_stellar : StellarShift
        The same stars through the lens with the moved element.
    star_e : float
        Electrons of a V = 7.5 star of the reference temperature through the full pass band.
    runtime_s, peak_memory_mb : float
        Of the process up to the end of the run.
    """

    config: Config
    instrument: Instrument
    pairs: Sequence[tuple[str, int, int]]
    centred: Evaluation
    moved: Evaluation
    paraxial_px: FloatArray
    solutions: Sequence[Solution]
    chosen: Solution
    stellar: StellarShift
    field_shift_px: Mapping[str, FloatArray]
    moved_stellar: StellarShift
    star_e: float
    runtime_s: float
    peak_memory_mb: float
