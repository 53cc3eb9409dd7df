"""The camera of a dataset: built from its configuration, cut to the window that is read out."""

from __future__ import annotations

from dataclasses import replace

from experiments.dataset.settings import CameraConfig
from experiments.laboratory.instrument import Instrument, build_instrument
from optics.errors import DomainError
from optics.light.band import TopHat

__all__ = ["passband", "windowed_instrument"]


def windowed_instrument(config: CameraConfig) -> Instrument:
    """Camera and detector, cut to the middle of the detector.

    Raises
    ------
    ConfigError, DomainError
        Unknown lens or detector, a window larger than the detector or cut from several chips, corners that see beyond
        the lens.
    """
    instrument = build_instrument(config)
    detector = instrument.detector
    if config.gain_dn_per_e:
        instrument = replace(instrument, detector=replace(detector, gain_dn_per_e=config.gain_dn_per_e))
    try:
        instrument = instrument.windowed(config.width_px or detector.width_px, config.height_px or detector.height_px)
        instrument.check_field()
    except DomainError as error:
        raise DomainError(f"camera.width_px, camera.height_px: {error}") from None
    return instrument


def passband(config: CameraConfig, instrument: Instrument) -> TopHat:
    """The pass band, between its feet.

    Raises
    ------
    DomainError
        It reaches beyond what is known, or is narrower than its edges.
    """
    try:
        return instrument.passband(config.passband_nm if any(config.passband_nm) else None, edge_nm=config.edge_nm)
    except DomainError as error:
        raise DomainError(f"camera: {error}") from None
