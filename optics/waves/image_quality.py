"""Metrics of diffraction images: Strehl ratio, encircled energy, MTF, also through focus.

Parameters of all: ``field``, traced pupils (`optics.waves.pupil_field.trace_pupil`); ``at``, numbers of field and
wavelength.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import RegularGridInterpolator
from scipy.optimize import minimize

from optics.arrays import FloatArray
from optics.waves.pupil_field import ComplexArray, PupilField
from optics.waves.pupil_grid import plane_waves, pupil_grid


def peak(field: PupilField, *, at: tuple[int, int] = (0, 0)) -> tuple[float, float, float]:
    """Brightest point of the image: x, y [mm] and intensity [fraction of the light per mm^2].

    By a simplex from the best point of a grid of half the Airy radius about the mean landing point.
    """
    step_mm = 0.25 * float(field.wavelength_nm[at[1]]) * 1e-6 / max(float(np.hypot(field.l, field.m)[at].max()), 1e-6)
    mean_x, mean_y = field.centroid_mm(at)
    grid = step_mm * np.arange(-20.0, 21.0)
    image = field.intensity(mean_x + grid, mean_y + grid, at=at)
    row, column = np.unravel_index(int(image.argmax()), image.shape)

    def darkness(p: FloatArray) -> float:
        return -float(field.intensity(p[:1], p[1:], at=at)[0, 0]) / float(image.max())

    start = np.array([mean_x + grid[column], mean_y + grid[row]])
    simplex = start + step_mm * np.array([[0.0, 0.0], [0.5, 0.0], [0.0, 0.5]])
    options = {"initial_simplex": simplex, "xatol": 1e-4 * step_mm, "fatol": 1e-11}
    optimum = minimize(darkness, start, method="Nelder-Mead", options=options)
    return float(optimum.x[0]), float(optimum.x[1]), -float(optimum.fun) * float(image.max())


def strehl(field: PupilField, *, at: tuple[int, int] = (0, 0)) -> float:
    """Strehl ratio: peak of the image over the peak of the same pupil with the same amplitudes and zero phase.

    Parameters
    ----------
    field : PupilField
        Traced pupils (`optics.waves.pupil_field.trace_pupil`).
    at : (int, int)
        Field and wavelength.

    Returns
    -------
    float
        Ratio, 0 to 1.
    """
    return peak(field, at=at)[2] / perfect_peak(field, at=at)


def perfect_peak(field: PupilField, *, at: tuple[int, int] = (0, 0)) -> float:
    """Intensity [fraction of the light per mm^2] of the brightest point for the same pupil without phase errors."""
    amplitude = plane_waves(field, at)[0]
    return field.frequency_per_mm(at) ** 2 * float(amplitude.sum()) ** 2 / float(field.area_mm2[at].sum())


def strehl_through_focus(field: PupilField, focus_mm: ArrayLike, *, at: tuple[int, int] = (0, 0)) -> FloatArray:
    """Strehl ratios at shifts of the image plane along the light.

    Parameters
    ----------
    field : PupilField
        Traced pupils (`optics.waves.pupil_field.trace_pupil`).
    focus_mm : (n,)
        Shifts [mm], positive away from the lens.
    at : (int, int)
        Field and wavelength.

    Returns
    -------
    (n,) array
        Ratios, 0 to 1.
    """
    return np.array([strehl(field.shifted(float(z)), at=at) for z in np.atleast_1d(np.asarray(focus_mm, float))])


def transfer_function(
    field: PupilField, frequency: ArrayLike, *, at: tuple[int, int] = (0, 0), size: int = 256
) -> ComplexArray:
    """Optical transfer function (f,), whose modulus is the MTF, at frequencies (f, 2) [cycles/mm] in the image plane.

    The autocorrelation of the pupil in direction cosines, with phase and amplitude there as polynomials of the twelfth
    degree fitted to the rays, on a grid whose cells at the rim count in part. Error for a perfect lens: 3e-5
    from a tenth of the cutoff on with 256 cells, 5e-4 with 64.

    Parameters
    ----------
    field : PupilField
        Traced pupils (`optics.waves.pupil_field.trace_pupil`).
    frequency : (f, 2)
        Frequencies; 0 beyond the cutoff.
    at : (int, int)
        Field and wavelength.
    size : int
        Cells across the pupil.

    Returns
    -------
    (f,) complex array
        1 at frequency 0.
    """
    grid = pupil_grid(field, at, size=size)
    padded = np.zeros((2 * size, 2 * size), complex)
    padded[:size, :size] = grid.field
    autocorrelation = np.fft.fftshift(np.fft.ifft2(np.abs(np.fft.fft2(padded)) ** 2)) * grid.cell
    autocorrelation[size, size] = 1.0  # the squared coverage of cells at the rim is less than their light
    shifts = (np.arange(2 * size) - size) * float(grid.frequency_x[1] - grid.frequency_x[0])
    interpolator = RegularGridInterpolator((shifts, shifts), autocorrelation, bounds_error=False, fill_value=0.0)
    return np.asarray(interpolator(np.atleast_2d(np.asarray(frequency, float))[:, ::-1]))


def encircled_energy(
    field: PupilField,
    radius_mm: ArrayLike,
    *,
    at: tuple[int, int] = (0, 0),
    centre_mm: Sequence[float] | None = None,
) -> FloatArray:
    """Fraction of all light within circles (r,).

    Integrates the image over the rings between the circles, by Gauss points along the radius and evenly in azimuth, as
    many as a band-limited image needs.

    Parameters
    ----------
    field : PupilField
        Pupils, sampled for windows as large as the largest circle.
    radius_mm : (r,)
        Radii.
    at : (int, int)
        Field and wavelength.
    centre_mm : (float, float), optional
        Centre; the centroid of all light if left out.

    Returns
    -------
    (r,) array
        Shares, 0 to 1.
    """
    amplitude, fx, fy, phase = plane_waves(field, at)
    mean_x, mean_y = field.centroid_mm(at)
    dx, dy = (0.0, 0.0) if centre_mm is None else (centre_mm[0] - mean_x, centre_mm[1] - mean_y)
    highest = float(np.hypot(fx, fy).max())
    coefficient = amplitude * np.exp(2j * np.pi * (phase + fx * dx + fy * dy))
    edges, inverse = np.unique(np.atleast_1d(np.asarray(radius_mm, float)), return_inverse=True)
    enclosed, inner, light = [], 0.0, 0.0
    for outer in edges:
        node, weight = np.polynomial.legendre.leggauss(8 + math.ceil(4.0 * highest * (outer - inner)))
        ring = inner + 0.5 * (outer - inner) * (1.0 + node)
        count = 16 + 4 * math.ceil(np.pi * highest * outer)
        angle = 2.0 * np.pi * np.arange(count) / count
        for r, area in zip(ring, 0.5 * (outer - inner) * weight * 2.0 * np.pi * ring, strict=True):
            wave = np.exp(2j * np.pi * (np.outer(r * np.cos(angle), fx) + np.outer(r * np.sin(angle), fy)))
            light += float(area) * float((np.abs(wave @ coefficient) ** 2).mean())
        enclosed.append(light)
        inner = outer
    return np.array(enclosed)[inverse] * field.frequency_per_mm(at) ** 2 / float(field.area_mm2[at].sum())
