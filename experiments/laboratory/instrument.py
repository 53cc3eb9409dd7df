"""The instrument under test, as configuration: which lens, which detector, how focused, how cold."""

from __future__ import annotations

from dataclasses import dataclass

from experiments.laboratory.settings import InstrumentConfig
from optics.lens.prescription import load_lens
from optics.lens.system import LensSystem
from optics.rays.paraxial import axial_paraxial
from render.detector.noise import PixelNoise
from render.detector.spec import Detector
from render.sensor import StarSensor, load_star_sensor

__all__ = ["Instrument", "build_instrument"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Instrument(StarSensor):
    """A star sensor that was configured.

    Attributes
    ----------
    config : InstrumentConfig
        What it was built from.
    camera, detector, focal_length_mm
        As in `StarSensor`; the focal length is that of the configured lens, perturbed or not.
    """

    config: InstrumentConfig

    def pixel_noise(self, detector: Detector | None = None) -> PixelNoise:
        """Noise of a pixel in one exposure, of the own detector or of another one under its conditions."""
        config = self.config
        return PixelNoise.of(
            self.detector if detector is None else detector,
            temperature_c=config.chip_temperature_c,
            exposure_s=config.exposure_s,
        )


def build_instrument(
    config: InstrumentConfig, lens: LensSystem | None = None, detector: Detector | None = None
) -> Instrument:
    """Instrument of a configuration.

    Parameters
    ----------
    config : InstrumentConfig
        The configuration.
    lens : LensSystem, optional
        In place of the configured one, e.g. a perturbed copy.
    detector : Detector, optional
        In place of the configured one, e.g. with another read noise.

    Raises
    ------
    ConfigError, DomainError
        What lens and detector files raise.
    """
    nominal = load_lens(config.lens)
    sensor = load_star_sensor(
        nominal if lens is None else lens,
        config.detector if detector is None else detector,
        defocus_mm=config.defocus_mm,
        coating_nm=config.coating_nm,
        absorption=config.absorption,
    )
    return Instrument(
        config=config,
        camera=sensor.camera,
        detector=sensor.detector,
        focal_length_mm=float(axial_paraxial(nominal, nominal.design_wavelength_nm).efl_mm),
    )
