"""The pupil on a regular grid of directions: fast images and transfer functions of smooth wavefronts.

Rays sample a pupil irregularly, and each is a separate plane wave of the image. Phase and amplitude of a clear pupil
are smooth: polynomials of degree twelve, fitted to some hundred rays, give them on a regular grid of direction cosines,
and the field in the image is a product of three matrices ("matrix Fourier transform", Soummer et al. 2007, Opt. Express
15, 15935). Cells at the rim have partial weight.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import NDArray

from optics.arrays import FloatArray
from optics.errors import DomainError
from optics.field_map import polynomial_basis
from optics.records import freeze_all
from optics.waves.pupil_field import PupilField, phasor, squared_modulus

DEGREE = 12
PER_CELL = 6
"""Points along a cell at the rim, which give the fraction of it that is inside."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PupilGrid:
    """Field over the pupil of one star and wavelength."""

    frequency_x: FloatArray  # (n,) Direction cosines times index over wavelength [cycles/mm], even steps
    frequency_y: FloatArray  # (n,)
    # (n, n) Rows along y, phases about the mean landing point; the integral of ``|field|^2`` over the pupil is 1
    field: NDArray[np.complex64]
    mean_mm: FloatArray  # (2,) Mean landing point, which is the centroid of all light

    def __post_init__(self) -> None:
        freeze_all(self, frequency_x=("n",), frequency_y=("n",), mean_mm=(2,))

    @property
    def cell(self) -> float:
        """Area of a cell [cycles^2/mm^2]."""
        return float((self.frequency_x[1] - self.frequency_x[0]) * (self.frequency_y[1] - self.frequency_y[0]))

    def intensity(self, x_mm: FloatArray, y_mm: FloatArray) -> FloatArray:
        """Fraction of the light per mm^2 (Y, X) at columns and rows about `mean_mm`.

        The image repeats itself every 1 / step of the frequencies, so that points have to lie well within half of that.
        """
        left = phasor(np.outer(y_mm, self.frequency_y - self.frequency_y.mean()), np.complex64)
        right = phasor(np.outer(self.frequency_x - self.frequency_x.mean(), x_mm), np.complex64)
        return squared_modulus(left @ self.field @ right) * self.cell**2


def plane_waves(field: PupilField, at: tuple[int, int]) -> tuple[FloatArray, ...]:
    """Amplitude, direction cosines times index over wavelength [1/mm], phase [turns] about the mean landing point."""
    lit = field.lit(at)
    wave_mm = float(field.wavelength_nm[at[1]]) * 1e-6
    scale = field.frequency_per_mm(at)
    mean_x, mean_y = field.centroid_mm(at)
    l, m, x, y, path = (v[at][lit] for v in (field.l, field.m, field.x_mm, field.y_mm, field.path_mm))  # noqa: E741
    amplitude = field.area_mm2[at][lit] * np.sqrt(field.jacobian[at][lit])
    phase = path / wave_mm + scale * (l * (mean_x - x) + m * (mean_y - y))
    return amplitude, l * scale, m * scale, phase - phase.mean()


def pupil_grid(field: PupilField, at: tuple[int, int] = (0, 0), *, size: int = 256) -> PupilGrid:
    """Pupil of one field and wavelength on a grid of ``size`` cells along each side; `DomainError` if it has holes."""
    _, fx, fy, phase = plane_waves(field, at)
    lit = field.lit(at)
    if not lit.all():
        raise DomainError(
            f"field {at[0]}, wavelength {at[1]}: {np.count_nonzero(~lit)} rays are lost inside the pupil; a regular "
            "grid needs a clear pupil"
        )
    jacobian = field.jacobian[at].ravel()
    outline = _outline(field, at)
    centre = 0.5 * (outline.min(1) + outline.max(1))
    rim = outline - centre[:, None]
    reach = float(np.hypot(*rim).max()) * (1.0 + 2.0 / size)
    weight = np.sqrt(field.area_mm2[at].ravel() * jacobian)[:, None]
    design_matrix = polynomial_basis((np.stack([fx, fy], axis=-1) - centre) / reach, DEGREE) * weight
    values = np.stack([phase, 1.0 / np.sqrt(jacobian)], axis=-1) * weight
    coefficients = np.zeros((2, DEGREE + 1, DEGREE + 1))
    terms = np.add.outer(np.arange(DEGREE + 1), np.arange(DEGREE + 1)) <= DEGREE  # as of `polynomial_basis`
    coefficients[:, terms] = np.linalg.solve(design_matrix.T @ design_matrix, design_matrix.T @ values).T
    side = (2.0 * np.arange(size) + 1.0) / size - 1.0
    polynomials = legendre.legvander(side, DEGREE)
    turns, amplitude = polynomials @ coefficients.transpose(0, 2, 1) @ polynomials.T
    coverage = _coverage(rim / reach, side)
    light = float((coverage * amplitude**2).sum()) * (2.0 * reach / size) ** 2
    return PupilGrid(
        frequency_x=centre[0] + reach * side,
        frequency_y=centre[1] + reach * side,
        field=phasor(turns, np.complex64) * (coverage * amplitude / math.sqrt(light)).astype(np.float32),
        mean_mm=np.array(field.centroid_mm(at)),
    )


def _coverage(rim: FloatArray, side: FloatArray) -> FloatArray:
    """Fraction of every cell (rows, columns) inside an outline (2, arms) about the origin."""
    order = np.argsort(np.arctan2(rim[1], rim[0]))
    azimuth, radius = np.arctan2(rim[1], rim[0])[order], np.hypot(*rim)[order]

    def rim_radius(x: FloatArray, y: FloatArray) -> FloatArray:
        return np.asarray(np.interp(np.arctan2(y, x), azimuth, radius, period=2.0 * np.pi))

    distance, half = np.sqrt(np.add.outer(side**2, side**2)), 0.5 * (side[1] - side[0])
    coverage = np.asarray(distance < radius.min(), np.float64)
    middle = 0.5 * (radius.max() + radius.min())
    row, column = np.nonzero(np.abs(distance - middle) < 0.5 * np.ptp(radius) + 2 * half)
    edge = rim_radius(side[column], side[row])
    coverage[row, column] = distance[row, column] < edge
    cut = np.abs(distance[row, column] - edge) < 2.0 * half
    row, column = row[cut], column[cut]
    offset = half * ((2.0 * np.arange(PER_CELL) + 1.0) / PER_CELL - 1.0)
    dx, dy = (v.ravel() for v in np.meshgrid(offset, offset))
    x, y = side[column][:, None] + dx, side[row][:, None] + dy
    coverage[row, column] = (np.hypot(x, y) < rim_radius(x, y)).mean(1)
    return coverage


def _outline(field: PupilField, at: tuple[int, int]) -> FloatArray:
    """Direction cosines (2, arms) times index over wavelength [1/mm] at the rim, extrapolated from the outer rings."""
    beyond = (1.0 - field.ring[-1]) / (field.ring[-1] - field.ring[-2])
    return np.stack([v[at][-1] + beyond * (v[at][-1] - v[at][-2]) for v in (field.l, field.m)]) * (
        field.frequency_per_mm(at)
    )
