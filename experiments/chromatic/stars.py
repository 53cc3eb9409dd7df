"""Stars through the full pass band: how far their colour really shifts them, against ACC18's rule of one third."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from experiments.laboratory.instrument import Instrument
from experiments.laboratory.settings import StarsConfig
from optics.arrays import FloatArray
from optics.light.band import Band, band_nodes
from optics.light.spectrum import Blackbody
from render.forward import StarRenderer
from render.records import StarField

__all__ = ["StellarShift", "stellar_shift"]


NODES = 48


@dataclass(frozen=True, slots=True, kw_only=True)
class StellarShift:
    """Chromatic shift of stars."""

    temperature_k: FloatArray  # (t,) Effective temperatures
    direction: FloatArray  # (g, 3) Field points, unit vectors in cam
    position_px: FloatArray  # (g, 2) Field points (photon centroid of the reference star)
    shift_px: FloatArray  # (t, g, 2) Photon centroid minus that of the reference star at the same place

    @property
    def rms_px(self) -> FloatArray:
        """RMS length of the shift over the field, per temperature."""
        return np.asarray(np.sqrt((self.shift_px**2).sum(2).mean(1)))

    @property
    def max_px(self) -> FloatArray:
        """Largest shift over the field, per temperature."""
        return np.asarray(np.linalg.norm(self.shift_px, axis=2).max(1))

    @property
    def mean_px(self) -> FloatArray:
        """Mean shift over the field (t, 2): what a signed mean keeps."""
        return np.asarray(self.shift_px.mean(1))

    @property
    def most_different_rms_px(self) -> float:
        """RMS distance over the field of the two stars that differ most, whatever the reference."""
        apart = self.shift_px[:, None] - self.shift_px[None]
        return float(np.sqrt((apart**2).sum(-1).mean(-1)).max())


def stellar_shift(config: StarsConfig, band: Band, instrument: Instrument) -> StellarShift:
    """Render every colour at every field point and compare the truth."""
    camera = instrument.camera
    fraction = (np.arange(config.grid) + 0.5) / config.grid
    x, y = np.meshgrid(fraction * camera.width_px - 0.5, fraction * camera.height_px - 0.5)
    place = camera.nominal_direction(x.ravel(), y.ravel(), instrument.focal_length_mm)
    temperatures: Sequence[float] = [*config.temperatures_k, config.reference_k]
    nodes = band_nodes([band], NODES)
    light = nodes.weight_nm * nodes.transmission
    spectra = [light * Blackbody(temperature_k=t).photon_density(nodes.wavelength_nm) for t in temperatures]
    rate = np.stack([spectrum / spectrum.sum() for spectrum in spectra])
    stars = StarField(
        direction=np.tile(place, (len(temperatures), 1)),
        wavelength_nm=nodes.wavelength_nm,
        photon_rate=np.repeat(rate, len(place), axis=0),
        band=("full",),
    )
    by_rays = replace(camera, diffraction="rays")  # which tell the mean of all light of diffraction images too
    truth = StarRenderer(by_rays).render(stars).truth
    assert truth is not None
    position = np.stack([truth.photon_x_px, truth.photon_y_px], axis=-1).reshape(len(temperatures), len(place), 2)
    return StellarShift(
        temperature_k=np.array(config.temperatures_k),
        direction=place,
        position_px=position[-1],
        shift_px=position[:-1] - position[-1],
    )
