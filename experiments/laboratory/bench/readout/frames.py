"""Frames of the detector without stars, and noise models of a reduction."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from calib.records import NoiseModel
from render.detector.readout import expose
from render.detector.readout import mean_dark_frame as detector_mean_dark_frame
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
    config = instrument.config
    return detector_mean_dark_frame(
        instrument.detector,
        frames,
        streams=streams,
        exposure_s=config.exposure_s,
        temperature_c=config.chip_temperature_c,
        band=label,
    )


def nominal_noise(instrument: Instrument) -> NoiseModel:
    """Noise stated by the readout: gain, offset, read noise of the median pixel (`render.records.Frame`)."""
    chip = instrument.detector
    return NoiseModel(
        read_noise_e=chip.read_noise_e, gain_dn_per_e=chip.gain_dn_per_e, offset_dn=chip.offset_dn, quantised=True
    )


def true_noise(instrument: Instrument, *, dark_frames: int | None = None) -> NoiseModel:
    """Noise as measured on dark frames: read noise is the noise of a pixel without light.

    It includes the spread of read noise over the pixels, dark charge, and noise of the subtracted mean dark frame.
    """
    pixel = instrument.pixel_noise()
    temporal_e2 = float(pixel.temporal_e2(0.0, dark_frames=dark_frames)) - pixel.rounding_e2
    return replace(nominal_noise(instrument), read_noise_e=float(np.sqrt(temporal_e2)))
