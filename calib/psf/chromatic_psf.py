"""A mixture PSF as a table over wavelength: a PSF at every node, which reproduces the PSF of each colour class."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.optimize import least_squares

from calib.photometry.spectral_response import WAVELENGTHS_NM, blackbody_photons
from calib.psf.gaussian_mixture import REFERENCE_CLASS, MixturePsf
from optics.arrays import FloatArray
from optics.lens.measured import GaussianMixture

PSF_NODES = (5, 4)
"""Columns and rows of positions on the detector."""
PSF_WAVES_NM = (500.0, 800.0)
CLASS_K = (3400.0, 4880.0, 6330.0, 10500.0)
"""Colour temperatures of the classes of the PSF: means of the brightest stars (G < 7) of the sky."""
MODEL_ERROR = 0.02
"""Error of the logarithm of a width or fraction by the model of three Gaussians in four classes."""
CORE_SLOPE, WIDTH_SLOPE = 3.0, 0.3
"""Prior standard deviations of the change of the logarithms of core and width from node to node."""
NARROWEST_PX = 0.05


def mixture_table(psf: MixturePsf, pitch_mm: float, response: FloatArray) -> GaussianMixture:
    """The PSF of a measured lens; ``response`` (w,) is the camera's, at
    `calib.photometry.spectral_response.WAVELENGTHS_NM`."""
    at_nodes = psf_of_wavelengths(psf, response)
    width, height = psf.size_px
    x, y = (np.linspace(0.0, n - 1.0, count) for n, count in ((width, PSF_NODES[0]), (height, PSF_NODES[1])))
    position = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    reference = np.full(len(position), REFERENCE_CLASS)
    # (nodes, 3, quantity, positions)
    components = np.array([node.components(position, reference) for node in at_nodes])
    fraction, along_x, along_y = components.transpose(2, 0, 3, 1).reshape(3, len(at_nodes), len(y), len(x), 3)
    variance = [np.maximum(sigma, NARROWEST_PX) ** 2 * pitch_mm**2 for sigma in (along_x, along_y)]
    return GaussianMixture(
        wavelength_nm=np.array(PSF_WAVES_NM),
        y_mm=(y - (height - 1.0) / 2.0) * pitch_mm,
        x_mm=(x - (width - 1.0) / 2.0) * pitch_mm,
        share=fraction / fraction.sum(axis=-1, keepdims=True),
        offset_mm=np.zeros((*fraction.shape, 2)),
        covariance_mm2=np.stack([*variance, np.zeros_like(fraction)], axis=-1),
    )


def psf_of_wavelengths(psf: MixturePsf, response: FloatArray) -> list[MixturePsf]:
    """A PSF (its reference class) for each node, of which spectra of the four classes are mixed to the measured PSFs.

    Core and width of a class are strongly correlated: both are fitted together, with the covariance of the PSF's fit.
    """
    rates = np.stack([blackbody_photons(temperature) * response for temperature in CLASS_K])
    hats = np.stack([np.interp(WAVELENGTHS_NM, PSF_WAVES_NM, row) for row in np.eye(len(PSF_WAVES_NM))])
    light = rates @ hats.T / rates.sum(axis=1)[:, None]  # (4, nodes) Fraction of a class's light at a node
    measured = np.array([0, 3, *np.arange(12, 18)])
    covariance = psf.covariance[np.ix_(measured, measured)]
    free = np.diag(covariance) > 0.0  # parameters of classes without stars are left out
    root = np.linalg.cholesky(np.linalg.inv(covariance[np.ix_(free, free)] + MODEL_ERROR**2 * np.eye(int(free.sum()))))
    count, outer = len(PSF_WAVES_NM), float(np.exp(psf.value[1]))
    at = REFERENCE_CLASS
    others = np.arange(len(CLASS_K)) != at

    def of_classes(p: FloatArray) -> FloatArray:
        """Logarithms of core over middle and of the middle's width of the classes, in the order of the PSF."""
        inner = np.exp(p[:count])
        core, middle = inner / (1.0 + inner + outer), 1.0 / (1.0 + inner + outer)
        ratio = np.log(light @ core) - np.log(light @ middle)
        width = 0.5 * np.log(light @ (middle * np.exp(2.0 * p[count:])) / (light @ middle))
        return np.concatenate([[ratio[at], width[at]], (width - width[at])[others], (ratio - ratio[at])[others]])

    def misfit(p: FloatArray) -> FloatArray:
        prior = np.concatenate([np.diff(p[:count]) / CORE_SLOPE, np.diff(p[count:]) / WIDTH_SLOPE])
        return np.concatenate([root.T @ (of_classes(p) - psf.value[measured])[free], prior])

    start = np.repeat(psf.value[[0, 3]], count)
    fitted = least_squares(misfit, start, bounds=(start - 3.0, start + 3.0)).x
    nodes = []
    for core, width in fitted.reshape(2, count).T:
        value = psf.value.copy()
        value[0], value[3:5] = core, psf.value[3:5] + width - psf.value[3]
        nodes.append(replace(psf, value=value))
    return nodes
