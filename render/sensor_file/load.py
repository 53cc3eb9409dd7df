"""A star sensor by the names of lens and detector, or from its sensor file."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

from optics.errors import ConfigError
from optics.lens.system import LensSystem
from render.detector.spec import Detector
from render.sensor import StarSensor, build_star_sensor
from render.sensor_file.file import SensorFile, complete_sensor, in_best_focus
from render.sensor_file.filters import open_band
from render.sensor_file.instrument import build_instrument


def load_star_sensor(
    lens: str | Path | LensSystem, detector: str | Path | Detector | None = None, **hardware: Any
) -> StarSensor:
    """Star sensor of a sensor file, or of a lens and a detector.

    Parameters
    ----------
    lens : str, path or LensSystem
        Built-in lens (`optics.list_lenses`), TOML file, or a lens, e.g. one with a decentred element. Without
        ``detector``: a sensor file.
    detector : str, path or Detector, optional
        Built-in detector, TOML file, or a detector.
    **hardware
        With lens and detector: ``window_px``, ``defocus_mm``, ``coating_nm``, ``absorption``, ``diffraction``
        (`render.sensor.build_star_sensor`). A sensor file states all of them.

    Returns
    -------
    StarSensor
        Camera, detector and focal length; of a sensor file also its pass band, exposure and temperature, which
        `render.observe` takes where it is given no others.

    Raises
    ------
    ConfigError, DomainError
        A file that cannot be read, a key or value that is not allowed, an unknown lens or detector, a glass without
        transmittance, a window larger than the detector.

    Examples
    --------
    >>> sensor = load_star_sensor("star_tracker_26mm", "cmv4000", window_px=1024)
    >>> print(f"{sensor.pixel_arcsec:.1f} arcsec per pixel, {sensor.field_deg[0]:.1f} deg")
    44.3 arcsec per pixel, 12.5 deg
    """
    if detector is not None:
        return build_star_sensor(lens, detector, **hardware)
    if isinstance(lens, LensSystem) or not str(lens).endswith(".toml"):
        raise ConfigError(f"lens {getattr(lens, 'name', lens)!r} without a detector: give that too, or a sensor file")
    if hardware:
        raise ConfigError(f"{', '.join(hardware)} with sensor file {lens}: state them in the file")
    config = SensorFile.model_validate(complete_sensor(lens))
    sensor = build_instrument(in_best_focus(config.instrument, config.passband))
    return replace(sensor, band=open_band(config.passband, sensor))
