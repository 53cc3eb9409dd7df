"""Frames of the detector without stars, their mean, and its subtraction."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from calib.measure.image import subtract_dark
from calib.records import NoiseModel, SensorImage
from render.detector.readout import expose
from render.engine.random import Streams
from render.records import Frame
from render.sensor_file.instrument import Instrument


def empty_frame(
    instrument: Instrument, number: int, *, streams: Streams, sky_e: float = 0.0, label: str = "", flat_e: float = 0.0
) -> Frame:
    """A frame of even light [e-] without stars: background ``sky_e``, lamp ``flat_e``; ``label`` names the streams."""
    config = instrument.config
    return expose(
        np.full(instrument.detector.shape, flat_e, np.float32),
        instrument.detector,
        streams=streams,
        frame=number,
        exposure_s=config.exposure_s,
        temperature_c=config.chip_temperature_c,
        background_e_per_s=sky_e / config.exposure_s,
        band=label,
    )


def mean_dark_frame(instrument: Instrument, frames: int, *, streams: Streams, label: str = "") -> NDArray[np.float32]:
    """Mean of frames without light [DN] under the conditions of the instrument."""
    total = np.zeros(instrument.detector.shape, np.uint32)
    for number in range(frames):
        total += empty_frame(instrument, number, streams=streams, label=label).dn
    return np.asarray(total / frames, np.float32)


def dark_subtracted_frame(frame: Frame, dark_dn: NDArray[np.float32], noise: NoiseModel) -> SensorImage:
    """A frame minus the mean dark frame, with the noise that this leaves (`readout.noise_model.true_noise`)."""
    return replace(subtract_dark(frame, dark_dn), noise=noise)
