r"""Pixel-residual method for the accuracy of star vectors: its bias over the field of view, in closed form.

The usual method takes the standard deviation of the residuals of images in pixels, times one angle per pixel.

A camera maps a direction to its image by a map that stretches: at the field angle whose tangent is t a small angle
e across the line of sight becomes, in units of the focal length, (1 + t^2) e along the radius and sqrt(1 + t^2) e
across it. Noise that is equal in all directions on the sphere therefore grows in pixels towards the edge, and its
standard deviation per axis over a field, times the angle of a pixel on the axis, is too large by

.. math:: \frac{\sigma_b}{\sigma} = \sqrt{\tfrac12 \langle (1 + t^2)^2 + (1 + t^2) \rangle}
    = \sqrt{1 + \tfrac32 \langle t^2 \rangle + \tfrac12 \langle t^4 \rangle}

Over a square of half-width a = tan(field/2), evenly covered, <t^2> = 2 a^2/3 and <t^4> = 28 a^4/45:

.. math:: \frac{\sigma_b}{\sigma} = \sqrt{1 + a^2 + \tfrac{14}{45} a^4} \approx 1 + a^2/2

The opposite: noise that is equal everywhere in *pixels* (that of a centroid is) shrinks on the sphere towards the edge.
The Fisher estimate is then the root mean square of the angles over the field, which is below that on the axis; the
pixel method gives the one on the axis:

.. math:: \frac{\sigma_F}{\sigma_{axis}} = \sqrt{\tfrac12 \langle (1 + t^2)^{-2} + (1 + t^2)^{-1} \rangle}
"""

from __future__ import annotations

import numpy as np
from scipy.stats import norm

from optics.arrays import FloatArray
from optics.units import DEG_RAD

NODES = 64
"""Of the Gauss-Legendre rule over half a side."""


def spherical_noise_ratio(field_deg: float) -> float:
    """Pixel method over the truth, noise isotropic on the sphere, square field (see the module)."""
    a2 = _half_width(field_deg) ** 2
    return float(np.sqrt(1.0 + a2 + 14.0 / 45.0 * a2 * a2))


def pixel_noise_ratio(field_deg: float) -> float:
    """Fisher over the noise on the axis, noise isotropic in pixels, square field; by quadrature."""
    nodes, weights = np.polynomial.legendre.leggauss(NODES)
    x = (nodes + 1.0) / 2.0 * _half_width(field_deg)
    stretch = 1.0 + x[:, None] ** 2 + x[None, :] ** 2
    weight = np.outer(weights, weights) / 4.0
    return float(np.sqrt(0.5 * np.sum(weight * (stretch**-2 + stretch**-1))))


def vectors_needed(excess: float) -> float:
    """Star vectors for which the 95 % interval of sigma is as narrow as a bias: 1.96/(2 sqrt n) = excess."""
    return float((norm.isf(0.025) / 2.0 / abs(excess)) ** 2)


def pixel_method_ratio(by_pixel: FloatArray, axis_by_pixel: FloatArray, noise_px2: FloatArray | None = None) -> float:
    """Pixel method over the truth for any camera, with the angle per pixel of the axis.

    Shapes: ``by_pixel`` (n, 3, 2), ``axis_by_pixel`` (3, 2), derivatives of unit vectors by the pixel
    (`calib.cameras.base.unproject_jacobian`); ``noise_px2`` (n, 2, 2), by default equal in all directions on the
    sphere.
    """
    metric = np.swapaxes(by_pixel, 1, 2) @ by_pixel  # angle^2 per pixel^2
    noise = np.linalg.inv(metric) if noise_px2 is None else noise_px2
    axis2 = float(np.sqrt(np.linalg.det(axis_by_pixel.T @ axis_by_pixel)))
    pixels2 = float(np.einsum("nii->", noise))
    return float(np.sqrt(pixels2 * axis2 / np.einsum("nij,nji->", metric, noise)))


def residual_sigma_px(residual_px: FloatArray) -> float:
    """Standard deviation per axis of pixel residuals (n, 2) about their mean, of both axes together [px]."""
    return float(np.sqrt(residual_px.var(0, ddof=1).mean()))


def _half_width(field_deg: float) -> float:
    return float(np.tan(field_deg * DEG_RAD / 2))
