"""Brightness of a target: electrons per frame, and the star of the same signal for this camera."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from experiments.laboratory.settings.tables import SignalConfig
from optics.errors import DomainError
from optics.light.band import Band, band_nodes
from optics.light.magnitudes import photon_rate
from optics.light.spectrum import Blackbody
from optics.rays.vignetting import collecting_area_mm2
from render.sensor_file.instrument import Instrument

NODES = 48


@dataclass(frozen=True, slots=True, kw_only=True)
class Signal:
    """Electrons, and the star of that signal (`signal_of`)."""

    signal_e: float  # Electrons per exposure on the axis
    magnitude_mag: float  # V magnitude of a star with these electrons through the full pass band
    temperature_k: float  # Of the star, a black body

    def magnitude_of(self, signal_e: float) -> float:
        """V magnitude of a star of the same colour with other electrons."""
        return float(self.magnitude_mag - 2.5 * np.log10(signal_e / self.signal_e))

    @property
    def star(self) -> str:
        """Printed description of the star."""
        return f"a star of V = {self.magnitude_mag:.1f}, {self.temperature_k:g} K"


def electrons_of_star(band: Band, instrument: Instrument, *, magnitude: float, temperature_k: float) -> float:
    """Electrons per exposure of a star of V magnitude on the axis, through the camera's pass band."""
    nodes = band_nodes([band], NODES)
    rate = photon_rate(Blackbody(temperature_k=temperature_k), magnitude, wavelength_nm=nodes.wavelength_nm)
    camera = instrument.camera
    detected = nodes.integrate(rate * camera.response_at(nodes.wavelength_nm))
    return float(detected[0] * collecting_area_mm2(camera.lens) * instrument.config.exposure_s)


def signal_of(config: SignalConfig, band: Band, instrument: Instrument, temperature_k: float) -> Signal:
    """Signal of a configuration: electrons from the magnitude if that is configured, else the reverse."""
    zero_e = electrons_of_star(band, instrument, magnitude=0.0, temperature_k=temperature_k)
    if not zero_e > 0:
        raise DomainError(f"band {band.name!r} and the response of the camera have no wavelength in common")
    if config.magnitude_mag is None:
        signal_e = config.default_signal_e if config.signal_e is None else config.signal_e
        magnitude = -2.5 * np.log10(signal_e / zero_e)
    else:
        magnitude = config.magnitude_mag
        signal_e = zero_e * 10.0 ** (-0.4 * magnitude)
    return Signal(signal_e=float(signal_e), magnitude_mag=float(magnitude), temperature_k=temperature_k)
