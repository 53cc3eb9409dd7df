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
from optics.records import freeze
from optics.waves.pupil_field import PupilField

DEGREE = 12
PER_CELL = 6
"""Points along a cell at the rim, which tell the part of it that is inside."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PupilGrid:
    """Field over the pupil of one star and wavelength."""

    frequency_x: FloatArray  # (n,) Direction cosines times index over wavelength [cycles/mm], even steps
    frequency_y: FloatArray  # (n,)
    # (n, n) Rows along y, phases about the mean landing point; the integral of ``|field|^2`` over the pupil is 1
    field: NDArray[np.complex64]
    mean_mm: FloatArray  # (2,) Mean landing point, which is the centroid of all light

    def __post_init__(self) -> None:
        for name in ("frequency_x", "frequency_y"):
            freeze(self, name, shape=("n",), sizes={})
        freeze(self, "mean_mm", shape=(2,), sizes={})

    @property
    def cell(self) -> float:
        """Area of a cell [cycles^2/mm^2]."""
        return float((self.frequency_x[1] - self.frequency_x[0]) * (self.frequency_y[1] - self.frequency_y[0]))

    def intensity(self, x_mm: FloatArray, y_mm: FloatArray) -> FloatArray:
        """Share of the light per mm^2 (Y, X) at columns and rows about `mean_mm`.

        The image repeats itself every 1 / step of the frequencies, so that points have to lie well within half of that.
        """
        left = _turned(np.outer(y_mm, self.frequency_y - self.frequency_y.mean()))
        right = _turned(np.outer(self.frequency_x - self.frequency_x.mean(), x_mm))
        u = left @ self.field @ right
        return np.asarray((u.real.astype(np.float64) ** 2 + u.imag.astype(np.float64) ** 2) * self.cell**2)


def _turned(turns: FloatArray) -> NDArray[np.complex64]:
    """exp(2 pi i turns)."""
    angle = (2.0 * np.pi * (turns - np.rint(turns))).astype(np.float32)
    result = np.empty(turns.shape, np.complex64)
    np.cos(angle, out=result.real)
    np.sin(angle, out=result.imag)
    return result


def plane_waves(field: PupilField, at: tuple[int, int]) -> tuple[FloatArray, ...]:
    """Amplitude, direction cosines times index over wavelength [1/mm], phase [turns] about the mean landing point."""
    lit = field.area_mm2[at] > 0.0
    if not lit.any():
        raise DomainError(f"field {at[0]}, wavelength {at[1]}: no light reaches the image plane")
    wave_mm = float(field.wavelength_nm[at[1]]) * 1e-6
    scale = float(field.index[at[1]]) / wave_mm
    mean = [float(v[at]) for v in field.mean_mm]
    l, m, x, y, path = (v[at][lit] for v in (field.l, field.m, field.x_mm, field.y_mm, field.path_mm))  # noqa: E741
    amplitude = field.area_mm2[at][lit] * np.sqrt(field.jacobian[at][lit])
    phase = path / wave_mm + scale * (l * (mean[0] - x) + m * (mean[1] - y))
    return amplitude, l * scale, m * scale, phase - phase.mean()


def pupil_grid(field: PupilField, at: tuple[int, int] = (0, 0), *, size: int = 256) -> PupilGrid:
    """Pupil of one field and wavelength on a grid.

    Shapes: ``at`` (int, int).
    """
    _, fx, fy, phase = plane_waves(field, at)
    lit = field.area_mm2[at] > 0.0
    if not lit.all():
        raise DomainError(
            f"field {at[0]}, wavelength {at[1]}: {np.count_nonzero(~lit)} rays are lost inside the pupil; a regular "
            "grid needs a clear pupil"
        )
    jacobian = field.jacobian[at].ravel()
    rim_x, rim_y = _rim(field, at)
    centre = np.array([0.5 * (v.min() + v.max()) for v in (rim_x, rim_y)])
    rim = np.stack([rim_x, rim_y], axis=-1) - centre
    reach = float(np.hypot(*rim.T).max()) * (1.0 + 2.0 / size)
    u, v = (fx - centre[0]) / reach, (fy - centre[1]) / reach
    root = np.sqrt(field.area_mm2[at].ravel() * jacobian)
    order = np.add.outer(np.arange(DEGREE + 1), np.arange(DEGREE + 1)) <= DEGREE
    terms = legendre.legvander2d(u, v, [DEGREE, DEGREE])[:, order.ravel()] * root[:, None]
    wanted = np.stack([phase, 1.0 / np.sqrt(jacobian)], axis=-1) * root[:, None]
    coefficients = np.zeros((2, DEGREE + 1, DEGREE + 1))
    coefficients[:, order] = np.linalg.solve(terms.T @ terms, terms.T @ wanted).T
    side = (2.0 * np.arange(size) + 1.0) / size - 1.0
    along = legendre.legvander(side, DEGREE)
    turns, amplitude = along @ coefficients.transpose(0, 2, 1) @ along.T
    inside = _inside(rim / reach, side)
    light = float((inside * amplitude**2).sum()) * (2.0 * reach / size) ** 2
    return PupilGrid(
        frequency_x=centre[0] + reach * side,
        frequency_y=centre[1] + reach * side,
        field=_turned(turns) * (inside * amplitude / math.sqrt(light)).astype(np.float32),
        mean_mm=np.array([float(v[at]) for v in field.mean_mm]),
    )


def _inside(rim: FloatArray, side: FloatArray) -> FloatArray:
    """Part of every cell (rows, columns) inside an outline (arms, 2) about the origin."""
    angle = np.arctan2(rim[:, 1], rim[:, 0])
    order = np.argsort(angle)
    turn, radius = angle[order], np.hypot(*rim.T)[order]
    from_centre, half = np.sqrt(np.add.outer(side**2, side**2)), 0.5 * (side[1] - side[0])
    inside = np.asarray(from_centre < radius.min(), np.float64)
    row, column = np.nonzero(
        np.abs(from_centre - 0.5 * (radius.max() + radius.min())) < 0.5 * np.ptp(radius) + 2 * half
    )
    distance = from_centre[row, column]
    reach = np.interp(np.arctan2(side[row], side[column]), turn, radius, period=2.0 * np.pi)
    inside[row, column] = distance < reach
    cut = np.abs(distance - reach) < 2.0 * half
    row, column = row[cut], column[cut]
    part = half * ((2.0 * np.arange(PER_CELL) + 1.0) / PER_CELL - 1.0)
    dx, dy = (v.ravel() for v in np.meshgrid(part, part))
    px, py = side[column][:, None] + dx, side[row][:, None] + dy
    edge = np.interp(np.arctan2(py, px), turn, radius, period=2.0 * np.pi)
    inside[row, column] = (np.hypot(px, py) < edge).mean(1)
    return inside


def _rim(field: PupilField, at: tuple[int, int]) -> tuple[FloatArray, FloatArray]:
    """Direction cosines (arms,) times index over wavelength [1/mm] at the rim, beyond the outermost ring."""
    scale = float(field.index[at[1]]) / (float(field.wavelength_nm[at[1]]) * 1e-6)
    out = (1.0 - field.ring[-1]) / (field.ring[-1] - field.ring[-2])
    l, m = (scale * (v[at][-1] + out * (v[at][-1] - v[at][-2])) for v in (field.l, field.m))  # noqa: E741
    return l, m
