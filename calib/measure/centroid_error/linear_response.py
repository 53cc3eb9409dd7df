"""Covariance of a centroid from the variance of pixels, through the estimator's linear response.

To first order a centroid moves by the sum over the pixels of g x disturbance, with g its derivative by the pixel. This
holds for any smooth estimator, also with a wrong noise model; not for a threshold in the noise.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calib.measure.centroiders.centre_of_gravity import CentreOfGravity
from calib.measure.centroiding.maximum_likelihood import LikelihoodFit
from calib.measure.centroiding.registry import Centroider
from calib.records import NoiseModel, Stamps
from optics.arrays import FloatArray


def linear_response(centroider: Centroider, stamps: Stamps, noise: NoiseModel, light_e: FloatArray) -> FloatArray:
    """Derivatives (n, 2, h, w) of centroids by the signal of each pixel [px per e-]; 0 for pixels that are not valid.

    Of a centre of gravity and of fits (`calib.measure.centroiding.maximum_likelihood.fit_response`) in closed form, of
    others by differences. ``light_e`` (n, h, w) is noiseless light in place of that of the stamps, ``noise`` the model
    handed to the estimator.
    """
    if isinstance(centroider, LikelihoodFit | CentreOfGravity):
        return centroider.response(replace(stamps, electrons=light_e), noise)
    count, height, width = light_e.shape
    step_e = np.maximum(1e-3 * light_e.sum((1, 2)), 1e-3)
    pixels = height * width
    raised = np.repeat(light_e[:, None], pixels + 1, axis=1).reshape(count, pixels + 1, pixels)
    raised[:, np.arange(pixels), np.arange(pixels)] += step_e[:, None]
    copies = stamps.select(np.repeat(np.arange(count), pixels + 1))
    copies = replace(copies, electrons=raised.reshape(-1, height, width))
    position_px = centroider.measure(copies, noise).pixel_px.reshape(count, pixels + 1, 2)
    gain = (position_px[:, :-1] - position_px[:, -1:]) / step_e[:, None, None]
    gain = np.where(stamps.valid.reshape(count, pixels, 1), gain, 0.0)
    return np.ascontiguousarray(np.moveaxis(gain, 2, 1)).reshape(count, 2, height, width)


def centroid_covariance(gain_px_per_e: FloatArray, variance_e2: FloatArray) -> FloatArray:
    """Covariance (n, 2, 2) of centroids with the response (n, 2, h, w) to independent pixels of variance (n, h, w)."""
    return np.asarray(np.einsum("nahw,nhw,nbhw->nab", gain_px_per_e, variance_e2, gain_px_per_e))


def centroid_variance(gain_px_per_e: FloatArray, variance_e2: FloatArray) -> FloatArray:
    """Variance of x and y (n, 2), the diagonal of the covariance."""
    return np.asarray(np.einsum("nahw,nhw->na", gain_px_per_e**2, variance_e2))


def tight(centroider: Centroider) -> Centroider:
    """The centroider with its iterations carried on, where it has a tolerance: differences need more digits."""
    return replace(centroider, tolerance=1e-6) if hasattr(centroider, "tolerance") else centroider  # type: ignore[type-var]
