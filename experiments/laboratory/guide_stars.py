"""Guide stars of a sensor: detectable catalogue stars, alone in their window, in the sensor's own magnitudes."""

from __future__ import annotations

import numpy as np

from calib.attitude.tracker import GuideCatalogue, guide_catalogue
from experiments.laboratory.sensor_prediction import CameraPrediction
from optics.arrays import FloatArray
from optics.units import RAD_ARCSEC
from render.catalogue.record import StarCatalog
from render.catalogue.temperature import star_temperature


def guide_stars(
    prediction: CameraPrediction,
    stars: StarCatalog,
    direction: FloatArray,
    *,
    brightest_mag: float,
    faintest_mag: float,
    throughput: float = 1.0,
) -> GuideCatalogue:
    """Guide stars among ``stars`` at unit vectors (n, 3); magnitudes of quoted stars of the same electrons."""
    state, config = prediction.state, prediction.config
    axis, kelvin = np.zeros(len(stars)), star_temperature(stars, config.catalogue.temperature)
    rate = state.electrons_per_s(stars.magnitude, kelvin, axis) * throughput
    zero = state.electrons_per_s(np.zeros(1), np.array([config.star.temperature_k]), np.zeros(1))[0]
    return guide_catalogue(
        stars.id,
        direction,
        -2.5 * np.log10(rate / zero),
        faintest_mag=faintest_mag,
        brightest_mag=brightest_mag,
        apart_rad=config.window_px * state.pixel_arcsec / RAD_ARCSEC,
    )
