"""Sun, Earth and Moon from an orbit about the Earth: directions, angles from a boresight, the Earth's shadow."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from optics.arrays import FloatArray
from render.bodies.solar_system import solar_system
from render.catalogue.motion import Observer, earth_observer
from render.motion.orbit import limb_angle_deg

MOON_KM = 384_400.0
"""Mean distance from the Earth."""


@dataclass(frozen=True, kw_only=True, eq=False)
class OrbitView:
    """Bodies about an Earth orbit at an epoch, at rest during a revolution: the Sun moves by 0.07 deg in 100 min."""

    earth: Observer  # Centre of the Earth
    sun: FloatArray  # (3,) Direction from the Earth
    moon: FloatArray  # (3,) Direction from the Earth

    def angles_deg(self, boresight: FloatArray, position_km: FloatArray) -> dict[str, FloatArray]:
        """Angles (...,) from directions (..., 3) at positions (..., 3) to ``sun``, limb of the ``earth``, ``moon``."""
        to_moon = MOON_KM * self.moon - position_km
        moon = to_moon / np.linalg.norm(to_moon, axis=-1, keepdims=True)
        return {
            "sun": np.degrees(np.arccos(np.clip(boresight @ self.sun, -1.0, 1.0))),
            "earth": limb_angle_deg(boresight, position_km),
            "moon": np.degrees(np.arccos(np.clip((boresight * moon).sum(-1), -1.0, 1.0))),
        }


def orbit_view(epoch_year: float) -> OrbitView:
    """Bodies at a Julian year; `DomainError` outside 1900 ... 2100."""
    earth = earth_observer(epoch_year)
    assert earth.from_sun_au is not None
    return OrbitView(
        earth=earth,
        sun=-earth.from_sun_au / np.linalg.norm(earth.from_sun_au),
        moon=np.array(solar_system(epoch_year, bodies=("moon",)).direction[0]),
    )
