"""Single-star simulator: a collimated star in a fixed direction of the laboratory."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from optics.arrays import FloatArray
from optics.errors import DomainError
from optics.light.band import Band, band_nodes
from optics.light.spectrum import Sed
from optics.rays.spots import collecting_area_mm2
from optics.units import DEG_RAD, RAD_DEG
from render.records import StarField
from render.sensor_file.instrument import Instrument

NODES = 16


def star_direction(azimuth_deg: ArrayLike, elevation_deg: ArrayLike) -> FloatArray:
    """Unit vectors (..., 3) in the laboratory: +Z at azimuth 0, azimuth towards +X, elevation towards +Y.

    The part of FISHER23 eq. 1, whose print does not show the order of its axes.
    """
    azimuth, elevation = (np.asarray(v, float) * DEG_RAD for v in (azimuth_deg, elevation_deg))
    azimuth, elevation = np.broadcast_arrays(azimuth, elevation)
    level = np.cos(elevation)
    return np.stack([np.sin(azimuth) * level, np.sin(elevation), np.cos(azimuth) * level], axis=-1)


def star_angles_deg(direction: ArrayLike) -> FloatArray:
    """Azimuth and elevation (..., 2) [deg] of directions (..., 3); the inverse of `star_direction`."""
    v = np.asarray(direction, float)
    azimuth = np.arctan2(v[..., 0], v[..., 2])
    elevation = np.arctan2(v[..., 1], np.hypot(v[..., 0], v[..., 2]))
    return np.stack([azimuth, elevation], axis=-1) * RAD_DEG


@dataclass(frozen=True, slots=True, kw_only=True)
class SingleStar:
    """A collimated star; the collimator of the single-star bench is free of colour and of divergence."""

    azimuth_deg: float  # Where it stands in the laboratory (`star_direction`)
    elevation_deg: float
    spectrum: Sed  # Its light
    band: Band  # What the simulator's filter lets through
    signal_e: float  # Electrons per exposure on the axis of the camera

    def __post_init__(self) -> None:
        if not (np.isfinite(self.signal_e) and self.signal_e > 0):
            raise DomainError(f"SingleStar.signal_e = {self.signal_e:g} e-; it must be positive")

    @property
    def direction(self) -> FloatArray:
        """Unit vector (3,) in the laboratory."""
        return star_direction(self.azimuth_deg, self.elevation_deg)

    def seen(self, direction_cam: FloatArray, instrument: Instrument) -> StarField:
        """The star as the camera sees it."""
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
