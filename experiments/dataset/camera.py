"""The camera of a dataset: built from its configuration, cut to the window that is read out."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from experiments.dataset.settings import CameraConfig
from experiments.laboratory.instrument import Instrument, build_instrument
from optics.errors import DomainError
from optics.light.band import TopHat

__all__ = ["known_range_nm", "passband", "windowed_instrument"]

_REACH = 1.02
"""The corner of a detector may lie this much outside the field that the lens was made for."""


def windowed_instrument(config: CameraConfig) -> Instrument:
    """Camera and detector, cut to the middle of the detector.

    Raises
    ------
    ConfigError, DomainError
        Unknown lens or detector, a window larger than the detector or cut from several chips, corners that see beyond
        the lens.
    """
    instrument = build_instrument(config)
    detector, camera = instrument.detector, instrument.camera
    if config.gain_dn_per_e:
        detector = replace(detector, gain_dn_per_e=config.gain_dn_per_e)
    width, height = config.width_px or detector.width_px, config.height_px or detector.height_px
    if (width, height) != (detector.width_px, detector.height_px):
        for key, wanted, most in (("width", width, detector.width_px), ("height", height, detector.height_px)):
            if wanted > most:
                raise DomainError(
                    f"camera.{key}_px = {wanted} px; detector {detector.name!r} has {most} px; set it to at most that"
                )
        if detector.chips > 1:
            raise DomainError(
                f"camera.width_px = {width} px, camera.height_px = {height} px on detector {detector.name!r} of "
                f"{detector.chips} chips; windows are cut from one chip only: set both to 0 or take another detector"
            )
        detector = replace(detector, chip_width_px=width, chip_height_px=height)
        camera = replace(camera, width_px=width, height_px=height, centre_px=np.full(2, np.nan))
    result = replace(instrument, detector=detector, camera=camera)
    _check_corners(result)
    return result


def _check_corners(instrument: Instrument) -> None:
    camera, limit = instrument.camera, instrument.camera.lens.max_field_deg
    corner_mm = math.hypot(camera.width_px, camera.height_px) * camera.pixel_pitch_mm / 2
    corner_deg = math.degrees(math.atan(corner_mm / instrument.focal_length_mm))
    if corner_deg > _REACH * limit:
        share = math.tan(math.radians(limit)) / math.tan(math.radians(corner_deg))
        raise DomainError(
            f"the corners of {camera.width_px} x {camera.height_px} px see {corner_deg:.1f} deg from the axis, lens "
            f"{camera.lens.name!r} is made for {limit:g} deg; set camera.width_px to at most "
            f"{int(camera.width_px * share)} and camera.height_px to at most {int(camera.height_px * share)}"
        )


def known_range_nm(instrument: Instrument) -> tuple[float, float]:
    """Wavelengths that the lens is made for and glasses, coatings and quantum efficiency are known at."""
    ranges = [glass.range_nm for glass in instrument.camera.lens.glasses.values()]
    ranges.append(instrument.camera.lens.wavelength_range_nm)
    if instrument.camera.response is not None:
        ranges.append(instrument.camera.response.range_nm)
    return max(low for low, _ in ranges), min(high for _, high in ranges)


def passband(config: CameraConfig, instrument: Instrument) -> TopHat:
    """The pass band, between its feet.

    Raises
    ------
    DomainError
        It reaches beyond what is known, or is narrower than its edges.
    """
    low, high = known_range_nm(instrument)
    first, last = config.passband_nm if any(config.passband_nm) else (low, high)
    if first < low or last > high:
        raise DomainError(
            f"camera.passband_nm = {first:g} ... {last:g} nm; lens {instrument.camera.lens.name!r} on "
            f"{instrument.detector.name!r} is known for {low:g} ... {high:g} nm"
        )
    if last - first <= 2 * config.edge_nm:
        raise DomainError(
            f"camera.passband_nm is {last - first:g} nm wide; with edges of camera.edge_nm = {config.edge_nm:g} nm at "
            f"least {2 * config.edge_nm:g} nm are needed"
        )
    width = last - first - config.edge_nm
    return TopHat(
        centre_nm=(first + last) / 2, width_nm=width, edge_nm=config.edge_nm, name=f"{first:.0f}-{last:.0f}nm"
    )
