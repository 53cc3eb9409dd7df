"""The camera as a laboratory would know it: a distortion model fitted to where the traced lens puts a typical star."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from calib.cameras.base import SensorGeometry
from calib.cameras.brown_conrady import BrownConrady
from calib.cameras.fit import MapFit, fit_to_map
from calib.cameras.polynomial import Polynomial
from optics.errors import ConvergenceError

if TYPE_CHECKING:
    from experiments.dataset.scene import Scene
    from render.tracing.tracer import Tracer

__all__ = ["calibrated_camera"]

GRID = 17
REACH = 0.985
"""Share of the detector's half-width that the grid spans: the rays of its outermost stars stay on the detector."""
GOOD_PX = 2e-3
"""A model that follows the lens this closely is good enough: a tenth of what a bright star's centroid is known to."""


def calibrated_camera(scene: Scene, tracer: Tracer, *, temperature_k: float) -> MapFit:
    """Simplest of some distortion models that follows the traced bundle means of one star colour.

    Parameters
    ----------
    scene : Scene
        Camera and band.
    tracer : Tracer
        Of the same camera.
    temperature_k : float
        Colour of the stars of the map.

    Returns
    -------
    MapFit
        The best of the models if none is within `GOOD_PX`.

    Raises
    ------
    ConvergenceError
        No light on most of the grid.
    """
    camera, focal_mm = scene.instrument.camera, scene.instrument.focal_length_mm
    half = REACH * np.array([camera.width_px, camera.height_px]) / 2
    x, y = np.meshgrid(*(np.linspace(-h, h, GRID) for h in half))
    direction = camera.nominal_direction((x + camera.centre_px[0]).ravel(), (y + camera.centre_px[1]).ravel(), focal_mm)
    pixel = tracer.bundle_means(scene.light.stars(direction, 5.0, temperature_k))[:, 0]
    seen = np.isfinite(pixel).all(axis=1)
    if np.count_nonzero(seen) < GRID**2 // 2:
        raise ConvergenceError(
            f"lens {camera.lens.name!r}: light reaches {np.count_nonzero(seen)} of {GRID**2} places of the detector; "
            "a smaller window is needed to calibrate it"
        )
    geometry = SensorGeometry(
        width_px=camera.width_px, height_px=camera.height_px, pixel_pitch_mm=camera.pixel_pitch_mm
    )
    fits: list[MapFit] = []
    models: list[Any] = [
        BrownConrady.create(geometry, focal_length_mm=focal_mm),
        *(Polynomial.create(geometry, focal_length_mm=focal_mm, degree=degree) for degree in (5, 7)),
    ]
    for model in models:
        fits.append(fit_to_map(model, direction[seen], pixel[seen]))
        if fits[-1].max_px < GOOD_PX:
            break
    return min(fits, key=lambda fit: fit.max_px)
