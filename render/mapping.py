"""The map of directions to pixels that a camera really has: bundle means of stars of one colour, traced."""

from __future__ import annotations

import numpy as np

from optics.errors import ConvergenceError
from render.catalogue.temperature import TYPICAL_TEMPERATURE_K
from render.records import PixelMap
from render.sensor import StarSensor
from render.sky.star_light import StarLight, star_light
from render.tracing.tracer import Tracer

__all__ = ["pixel_map"]


GRID = 17
REACH = 0.985
"""Share of the detector's half-width that the grid spans: the rays of its outermost stars stay on the detector."""


def pixel_map(
    sensor: StarSensor,
    light: StarLight | None = None,
    *,
    temperature_k: float = TYPICAL_TEMPERATURE_K,
) -> PixelMap:
    """Photon-weighted mean of the rays of stars on a grid over the detector.

    Parameters
    ----------
    sensor : StarSensor
        The camera.
    light : StarLight, optional
        Of the pass band; all that lens and detector are known for if left out.
    temperature_k : float
        Colour of the stars: a lens puts stars of other colours elsewhere.

    Raises
    ------
    ConvergenceError
        No light on most of the grid.
    """
    camera, focal_mm = sensor.camera, sensor.focal_length_mm
    half = REACH * np.array([camera.width_px, camera.height_px]) / 2
    x, y = np.meshgrid(*(np.linspace(-h, h, GRID) for h in half))
    direction = camera.nominal_direction((x + camera.centre_px[0]).ravel(), (y + camera.centre_px[1]).ravel(), focal_mm)
    light = star_light([sensor.passband()]) if light is None else light
    pixel = Tracer(camera).bundle_means(light.stars(direction, 5.0, temperature_k))[:, 0]
    seen = np.isfinite(pixel).all(axis=1)
    if np.count_nonzero(seen) < GRID**2 // 2:
        raise ConvergenceError(
            f"lens {camera.lens.name!r}: light reaches {np.count_nonzero(seen)} of {GRID**2} places of the detector; "
            "a smaller window is needed to calibrate it"
        )
    return PixelMap(
        direction=direction[seen],
        pixel_px=pixel[seen],
        width_px=camera.width_px,
        height_px=camera.height_px,
        pixel_pitch_mm=camera.pixel_pitch_mm,
        focal_length_mm=focal_mm,
    )
