"""The instrument under test, as configuration: which lens, which detector, how focused, how cold."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from experiments.laboratory.settings import InstrumentConfig
from optics.lens.prescription import load_lens
from optics.lens.system import LensSystem
from optics.light.transmission import QuarterWave
from render.camera import Camera, build_camera
from render.detector.spec import Detector, load_detector

__all__ = ["Instrument", "build_instrument"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Instrument:
    """A camera with the detector that reads it out.

    Attributes
    ----------
    config : InstrumentConfig
        What it was built from.
    camera : Camera
        Lens, geometry, response.
    detector : Detector
        Noise and conversion.
    focal_length_mm : float
        Paraxial, at the design wavelength.
    """

    config: InstrumentConfig
    camera: Camera
    detector: Detector
    focal_length_mm: float

    @property
    def pixel_arcsec(self) -> float:
        """Angle of a pixel on the axis."""
        return float(np.degrees(self.camera.pixel_pitch_mm / self.focal_length_mm) * 3600.0)


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
    from optics.rays.paraxial import axial_paraxial

    nominal = load_lens(config.lens)
    chip = load_detector(config.detector) if detector is None else detector
    coating = QuarterWave(design_wavelength_nm=config.coating_nm) if config.coating_nm > 0 else None
    camera = build_camera(
        nominal if lens is None else lens,
        chip,
        defocus_mm=config.defocus_mm,
        coating=coating,
        absorption=config.absorption,
    )
    focal_length = axial_paraxial(nominal, nominal.design_wavelength_nm).efl_mm
    return Instrument(config=config, camera=camera, detector=chip, focal_length_mm=float(focal_length))
