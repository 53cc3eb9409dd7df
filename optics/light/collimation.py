"""Deviation of the light behind a collimator from the plane waves of its point sources."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from optics.arrays import FloatArray
from optics.errors import DomainError
from optics.glass.absolute_index import Environment
from optics.glass.air import air_index
from optics.glass.catalogue import Glass
from optics.records import freeze, freeze_all

AIR_STEP_K = 0.5
"""Of the derivative of the index of air by the temperature."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Collimation:
    """Error of collimated light against wavelength, the same for all points of a target; b bands, k wavelengths."""

    wavelength_nm: FloatArray  # (b, k) Increasing in each band; linear in between, constant beyond
    # (b, k, 2) Deviation of the direction towards a source along X and Y of cam: a wedge, air, decollimation off the
    # axis of the beam
    slope_rad: FloatArray
    # (b, k) Reciprocal distance from the launch disk of the camera to the source; positive where light diverges
    vergence_per_mm: FloatArray

    def __post_init__(self) -> None:
        sizes: dict[str, int] = {}
        wavelength = freeze(self, "wavelength_nm", shape=("b", "k"), sizes=sizes)
        freeze_all(self, slope_rad=("b", "k", 2), vergence_per_mm=("b", "k"), sizes=sizes)
        if np.any(np.diff(wavelength, axis=1) <= 0.0):
            raise DomainError("Collimation.wavelength_nm: wavelengths that increase in each band are needed")

    def at(self, wavelength_nm: FloatArray) -> FloatArray:
        """Slopes along X and Y [rad] and vergence [1/mm] (b, m, 3) at other wavelengths (b, m) of the same bands."""
        values = np.concatenate([self.slope_rad, self.vergence_per_mm[..., None]], axis=2)
        bands = zip(wavelength_nm, self.wavelength_nm, values, strict=True)
        return np.array([np.stack([np.interp(x, knots, v) for v in value.T], axis=-1) for x, knots, value in bands])


def wedge_deviation_rad(
    angle_rad: float, glass: Glass, wavelength_nm: FloatArray, environment: Environment
) -> FloatArray:
    """Deviation of a ray by a prism, by Snell's law at both faces; the first is met squarely."""
    outside = air_index(wavelength_nm, environment.temperature_c, environment.pressure_hpa)
    return np.asarray(np.arcsin(glass.absolute_index(wavelength_nm) / outside * np.sin(angle_rad)) - angle_rad)


def air_deviation_rad(path_m: float, wavelength_nm: FloatArray, environment: Environment) -> FloatArray:
    """Apparent angle of a source towards the warm side, per 1 K/m across the path: path times -dn/dT."""
    cold, warm = (
        air_index(wavelength_nm, environment.temperature_c + kelvin, environment.pressure_hpa)
        for kelvin in (-AIR_STEP_K, AIR_STEP_K)
    )
    return np.asarray(path_m * (cold - warm) / (2.0 * AIR_STEP_K))


def decollimated(light: tuple[Any, Any, Any], x_mm: Any, y_mm: Any, error: tuple[Any, Any, Any], sqrt: Any) -> Any:
    """Unit vectors of rays through points of the launch disk for imperfectly collimated light.

    Exact for a point source at a finite distance; written once for NumPy and Dr.Jit. ``light`` are direction cosines
    (dx, dy, dz) of collimated light, ``error`` is (slope along X_cam, slope along Y_cam, vergence).
    """
    slope_x, slope_y, vergence = error
    dx = light[0] + slope_x + vergence * x_mm
    dy = light[1] - slope_y + vergence * y_mm
    length = sqrt(dx * dx + dy * dy + light[2] * light[2])
    return dx / length, dy / length, light[2] / length
