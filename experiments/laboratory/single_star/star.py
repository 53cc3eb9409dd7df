"""Single-star simulator: a collimated star in a fixed direction of the laboratory."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib.calibration.star_bench import star_direction
from optics.arrays import FloatArray
from optics.errors import DomainError
from optics.light.band import Band, band_nodes
from optics.light.spectrum import Sed
from optics.rays.vignetting import collecting_area_mm2
from render.records import StarField
from render.sensor_file.instrument import Instrument

NODES = 16


@dataclass(frozen=True, slots=True, kw_only=True)
class SingleStar:
    """A collimated star; the collimator of the single-star bench is free of colour and of divergence."""

    azimuth_deg: float  # Direction in the laboratory (`star_direction`)
    elevation_deg: float
    spectrum: Sed
    band: Band  # Of the simulator's filter
    signal_e: float  # Electrons per exposure on the axis of the camera

    def __post_init__(self) -> None:
        if not (np.isfinite(self.signal_e) and self.signal_e > 0):
            raise DomainError(f"SingleStar.signal_e = {self.signal_e:g} e-; it must be positive")

    @property
    def direction(self) -> FloatArray:
        """Unit vector (3,) in the laboratory."""
        return star_direction(self.azimuth_deg, self.elevation_deg)

    def field(self, direction_cam: FloatArray, instrument: Instrument) -> StarField:
        """Star field of the star at directions (n, 3) in cam, n orientations of the camera."""
        nodes = band_nodes([self.band], NODES)
        shape = nodes.weight_nm * nodes.transmission * self.spectrum.photon_density(nodes.wavelength_nm)
        camera = instrument.camera
        area = collecting_area_mm2(camera.lens) * instrument.config.exposure_s
        collected = float((shape * camera.response_at(nodes.wavelength_nm)).sum() * area)
        if not collected > 0:
            raise DomainError(
                f"band {self.band.name!r} of the star simulator and the response of {instrument.detector.name!r} have "
                "no wavelength in common; choose another pass band"
            )
        rate = np.repeat(shape[None] * (self.signal_e / collected), len(direction_cam), axis=0)
        return StarField(
            direction=direction_cam, wavelength_nm=nodes.wavelength_nm, photon_rate=rate, band=(self.band.name,)
        )
