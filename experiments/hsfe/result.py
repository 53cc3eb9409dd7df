"""Record of the step test, and two small studies: S-curves, and what the hexapod leaves."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from calib.measure.epsf import draw_epsf
from experiments.hsfe.settings import Config
from experiments.laboratory.bench import Bench
from experiments.laboratory.collimator_effects import LineOfSight
from experiments.laboratory.hexapod import Hexapod, turned
from experiments.laboratory.high_frequency import HighFrequencyMeasurement, StepPlan
from experiments.laboratory.high_frequency_model import HighFrequencyPrediction
from experiments.laboratory.instrument import Instrument
from experiments.laboratory.known_motion import WalkingPoints
from experiments.laboratory.ray_prediction import bundle_prediction
from experiments.laboratory.readout.centroids import centroiders, noiseless_positions
from experiments.laboratory.readout.noise_model import nominal_noise
from experiments.laboratory.step_statistics import document_rms_px
from optics.arrays import FloatArray
from render.engine.random import Streams
from render.records import EffectivePsf

__all__ = ["Geometry", "Result", "SCurve", "geometry_study", "s_curves"]


PHASES = 101
PATHS = 20


@dataclass(frozen=True, slots=True, kw_only=True)
class SCurve:
    """Error of noiseless centroids of the middle star while it crosses a pixel."""

    phase_px: FloatArray  # (n,) Place of the star in the pixel, along the columns, -0.5 to 0.5
    # (n,) Centroid minus truth, along the columns, by method; averaged over the phase along the rows
    error_px: Mapping[str, FloatArray]


@dataclass(frozen=True, slots=True, kw_only=True)
class Geometry:
    """What hexapods of different quality leave in the document's number, positions known exactly (traced)."""

    label: str  # Which errors
    step_arcsec: float  # Their size
    roll_arcsec: float  # Their size
    motion_px: float  # RMS of the common motion per step against the commanded one, per axis
    document_px: FloatArray  # (2,) RMS over paths of what is left after the mean over the stars is removed


@dataclass(frozen=True, slots=True, kw_only=True)
class Result:
    """Everything the run found."""

    config: Config  # Settings
    instrument: Instrument  # The camera
    measured: HighFrequencyMeasurement  # The test
    # Predicted for drawn paths of the hexapod; and for the common motion seen in the images
    before: HighFrequencyPrediction
    # Predicted for drawn paths of the hexapod; and for the common motion seen in the images
    after: HighFrequencyPrediction
    walking: WalkingPoints  # A short test in which every point moves by a known amount for itself
    curves: SCurve  # S-curves of the middle star
    geometry: tuple[Geometry, ...]  # Hexapods of different quality
    sight: LineOfSight | None  # Of the collimator; None at rest


def s_curves(bench: Bench, instrument: Instrument, psf: Sequence[EffectivePsf], direction: FloatArray) -> SCurve:
    """S-curves of the star in the middle of the target, from its PSF."""
    middle, size = len(direction) // 2, bench.window_px
    along = np.linspace(-0.5, 0.5, PHASES)
    across = np.array([-0.4, -0.2, 0.0, 0.2, 0.4])
    x, y = (v.ravel() for v in np.meshgrid(along, across))
    light = bench.signal_e * np.maximum(draw_epsf(psf[middle], x + size // 2, y + size // 2, (size, size)), 0.0)
    error = {}
    for name, centroider in centroiders(bench, [psf[middle]]).items():
        found, _ = noiseless_positions(
            centroider,
            nominal_noise(instrument),
            light_e=light,
            corner_px=np.zeros((len(x), 2), np.int64),
            psf_index=np.zeros(len(x), np.int64),
        )
        error[name] = (found[:, 0] - x - size // 2).reshape(len(across), -1).mean(0)
    return SCurve(phase_px=along, error_px=error)


def geometry_study(
    bench: Bench, instrument: Instrument, plan: StepPlan, hexapod: Hexapod, direction: FloatArray, streams: Streams
) -> tuple[Geometry, ...]:
    """Common motion and what is left of it, for an ideal hexapod, this one, and ones that are ten times worse."""
    ideal = Hexapod(step_error_arcsec=0.0, roll_error_arcsec=0.0, reading_error_arcsec=0.0)
    ten = 10.0
    cases = {
        "ideal": ideal,
        "this one": hexapod,
        "ten times the step error": replace(hexapod, step_error_arcsec=ten * hexapod.step_error_arcsec),
        "ten times the roll error": replace(hexapod, roll_error_arcsec=ten * hexapod.roll_error_arcsec),
    }
    commanded_rad = plan.path(instrument, ideal, streams.generator("geometry", 0)).commanded_rad  # whatever the errors
    wanted = bundle_prediction(bench, instrument, turned(direction, commanded_rad))[:, :, 0]
    out = []
    for label, case in cases.items():
        motion, left = [], []
        for number in range(1 if case == ideal else PATHS):
            path = plan.path(instrument, case, streams.generator("geometry", number))
            place = bundle_prediction(bench, instrument, turned(direction, path.true_rad))[:, :, 0]
            motion.append(np.diff((place - wanted).mean(1), axis=0))
            left.append(document_rms_px(place))
        out.append(
            Geometry(
                label=label,
                step_arcsec=case.step_error_arcsec,
                roll_arcsec=case.roll_error_arcsec,
                motion_px=float(np.sqrt(np.mean(np.square(motion)))),
                document_px=np.sqrt(np.mean(np.square(left), axis=0)),
            )
        )
    return tuple(out)
