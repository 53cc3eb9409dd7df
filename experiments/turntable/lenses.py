"""How well the camera model can describe a lens at all: fitted to noise-free rays, no table, no noise."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from calib.calibration.calibrate import calibrate
from calib.calibration.free_attitudes import FreeAttitudes
from calib.calibration.observations import Observations
from calib.cameras.line_of_sight import line_of_sight_map
from experiments.laboratory.instrument import Instrument, build_instrument
from experiments.laboratory.settings import InstrumentConfig
from experiments.laboratory.single_star.reduce import start_model
from experiments.turntable.settings import Config
from experiments.turntable.traced import TracedMap, traced_map
from optics.lens.perturb import decentre

__all__ = ["LensPoint", "lens_points"]

DECENTRE_MM = 0.1
MODEL_SIGMA_PX = 1e-3
"""Weight of the rays; the same for all, so that it does not matter."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LensPoint:
    """What Brown-Conrady leaves of a traced lens."""

    label: str  # Which lens
    field_deg: float  # Full field along the diagonal
    rms_arcsec: float  # Line-of-sight error of the best fit over the detector, length
    max_arcsec: float  # Line-of-sight error of the best fit over the detector, length
    max_px: float  # The largest one on the detector, on the axis's scale


def lens_points(config: Config, instrument: Instrument, traced: TracedMap) -> list[LensPoint]:
    """The lens as it is, with its first element decentred, and a wide lens."""
    lens = instrument.camera.lens
    element = lens.elements[0]
    moved = replace(
        instrument, camera=replace(instrument.camera, lens=decentre(lens, element, DECENTRE_MM / 2, DECENTRE_MM))
    )
    points = [_point(f"{lens.name}, as designed", instrument, traced)]
    label = f"{lens.name}, {element} decentred by {1e3 * DECENTRE_MM * np.hypot(0.5, 1.0):.0f} µm"
    points.append(_point(label, moved, traced_map(config, moved)))
    wide = build_instrument(InstrumentConfig(lens="star_tracker_26mm", detector="cmv4000", defocus_mm=0.0))
    points.append(_point(f"{wide.camera.lens.name}, as designed", wide, traced_map(config, wide)))
    return points


def _point(label: str, instrument: Instrument, traced: TracedMap) -> LensPoint:
    count = len(traced.pixel_px)
    camera = instrument.camera
    inside = np.all((traced.pixel_px > -1) & (traced.pixel_px < (camera.width_px, camera.height_px)), axis=1)
    observations = Observations.isotropic(
        pixel_px=traced.pixel_px[inside],
        direction=traced.direction[inside],
        frame=np.zeros(count, np.int64)[inside],
        sigma_px=MODEL_SIGMA_PX,
    )
    found = calibrate(observations, start_model(instrument, None), FreeAttitudes())
    line = line_of_sight_map(found.model, np.array(traced.direction[inside]), traced.pixel_px[inside])
    cosine = float((traced.direction[inside] @ traced.direction[inside].T).min())
    return LensPoint(
        label=label,
        field_deg=float(np.degrees(np.arccos(cosine))),
        rms_arcsec=line.rms_arcsec,
        max_arcsec=line.max_arcsec,
        max_px=line.max_arcsec / instrument.pixel_arcsec,
    )
