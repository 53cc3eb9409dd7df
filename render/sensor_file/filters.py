"""Filters of the laboratory: trapezoids or measured curves, named by their nominal centres."""

from __future__ import annotations

from dataclasses import dataclass

from optics.errors import DomainError
from optics.light.band import TabulatedBand, TopHat
from optics.light.band_file import load_band
from render.sensor import StarSensor
from render.sensor_file.tables import FilterConfig, PassbandConfig


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MeasuredFilter(TabulatedBand):
    """A measured curve with a nominal centre."""

    centre_nm: float  # What the filter is called by


Filter = TopHat | MeasuredFilter


def _measured(file: str, name: str, centre_nm: float | None = None) -> MeasuredFilter:
    curve = load_band(file, name)
    wave, value = curve.wavelength_nm, curve.value
    middle = float((wave * value).sum() / value.sum()) if centre_nm is None else centre_nm
    return MeasuredFilter(name=curve.name, source=curve.source, wavelength_nm=wave, value=value, centre_nm=middle)


def interference_filters(config: FilterConfig) -> tuple[Filter, ...]:
    """The filters of a configuration, named by their centres."""
    if config.files:
        pairs = zip(config.files, config.centres_nm, strict=True)
        return tuple(_measured(file, f"{centre:g} nm", centre) for file, centre in pairs)
    return tuple(
        TopHat(centre_nm=centre, width_nm=config.width_nm, edge_nm=config.edge_nm, name=f"{centre:g} nm")
        for centre in config.centres_nm
    )


def open_band(config: PassbandConfig, sensor: StarSensor, name: str = "") -> Filter:
    """The pass band of a configuration: the transmission of an open place of the filter wheel."""
    if config.file:
        curve = _measured(config.file, name)
        sensor.check_band("passband.file", curve)
        return curve
    everything = not any(config.range_nm)
    try:
        return sensor.passband(None if everything else config.range_nm, edge_nm=config.edge_nm, name=name)
    except DomainError as error:
        raise DomainError(f"passband.{error}") from None
