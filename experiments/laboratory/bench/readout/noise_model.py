"""Pixel noise as known to a reduction: from the data sheet, or from dark frames."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calib.records import NoiseModel
from render.sensor_file.instrument import Instrument


def nominal_noise(instrument: Instrument) -> NoiseModel:
    """Noise stated by the readout: gain, offset, read noise of the median pixel (`render.records.Frame`)."""
    chip = instrument.detector
    return NoiseModel(
        read_noise_e=chip.read_noise_e, gain_dn_per_e=chip.gain_dn_per_e, offset_dn=chip.offset_dn, quantised=True
    )


def true_noise(instrument: Instrument, *, dark_frames: int | None = None) -> NoiseModel:
    """Noise as measured on dark frames: the read noise holds everything but the light.

    Read noise with its spread over the pixels, dark charge, and the noise of the mean dark frame that was subtracted.
    """
    pixel = instrument.pixel_noise()
    temporal_e2 = float(pixel.temporal_e2(0.0, dark_frames=dark_frames)) - pixel.rounding_e2
    return replace(nominal_noise(instrument), read_noise_e=float(np.sqrt(temporal_e2)))
