"""Wavefront error of a lens at one field and wavelength: map, RMS, Zernike coefficients; measured maps to be added.

The error of a ray is its optical path to a reference point of the image, measured on a sphere about that point (in the
sum of plane waves: of infinite radius), minus the mean over the pupil. Positive: the light is late.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import RectBivariateSpline

from optics.arrays import FloatArray
from optics.errors import DomainError
from optics.records import freeze, freeze_alike, freeze_all
from optics.waves.pupil_field import PupilField
from optics.waves.zernike import ZernikeOrder, fit_zernikes, zernike_numbers, zernikes


@dataclass(frozen=True, slots=True, kw_only=True)
class Wavefront:
    """Wavefront error over the pupil."""

    x: FloatArray  # (p,) Points of the pupil, its centre 0 and its largest radius 1; axes as in the lens frame
    y: FloatArray  # (p,)
    weight: FloatArray  # (p,) Fraction of the light, sum 1
    error_nm: FloatArray  # (p,) Optical path less its mean
    wavelength_nm: float  # Vacuum wavelength

    def __post_init__(self) -> None:
        freeze_alike(self, "x", "y", "weight", "error_nm", shape=("p",))

    @property
    def rms_nm(self) -> float:
        """Root mean square."""
        return math.sqrt(float(self.weight @ self.error_nm**2))

    @property
    def rms_waves(self) -> float:
        """Root mean square in wavelengths."""
        return self.rms_nm / self.wavelength_nm

    @property
    def peak_to_valley_nm(self) -> float:
        """Largest less smallest error at the sampled points."""
        return float(np.ptp(self.error_nm))

    @property
    def marechal(self) -> float:
        """Strehl ratio exp(-(2 pi sigma)^2) of small errors (Mahajan 1983, J. Opt. Soc. Am. 73, 860)."""
        return math.exp(-((2.0 * math.pi * self.rms_waves) ** 2))

    def zernike_nm(self, count: int = 37, order: ZernikeOrder = "noll") -> FloatArray:
        """Coefficients (count,) [nm] of the error (`optics.waves.zernike`)."""
        return fit_zernikes(self.x, self.y, self.error_nm, self.weight, count, order)


def wavefront(
    field: PupilField,
    *,
    at: tuple[int, int] = (0, 0),
    point_mm: tuple[float, float] | None = None,
    radius_mm: float = math.inf,
) -> Wavefront:
    """Wavefront error at one field and wavelength.

    Parameters
    ----------
    field : PupilField
        Traced pupils (`optics.waves.pupil_field.trace_pupil`).
    at : (int, int)
        Field and wavelength.
    point_mm : (float, float), optional
        Reference point in the image plane; the one with the smallest error (tilt removed) if left out.
    radius_mm : float
        Of the reference sphere; infinite as in the sum of plane waves. Ray-tracing programs put it into the exit pupil.

    Returns
    -------
    Wavefront
        Its error over the pupil, with RMS and Zernike coefficients.

    Raises
    ------
    DomainError
        No light there.
    """
    lit = field.lit(at)
    weight = field.area_mm2[at][lit] / field.area_mm2[at].sum()
    x, y, l, m, path = (v[at][lit] for v in (field.x_mm, field.y_mm, field.l, field.m, field.path_mm))  # noqa: E741
    index = float(field.index[at[1]])

    def error(px: float, py: float) -> FloatArray:
        dx, dy = x - px, y - py
        along = l * dx + m * dy
        if math.isinf(radius_mm):
            to_sphere = -along
        else:  # along the ray from the image to the sphere, then by its radius to the reference point
            to_sphere = radius_mm - along - np.sqrt(radius_mm**2 - (dx * dx + dy * dy - along * along))
        value = path + index * to_sphere
        return np.asarray(value - weight @ value)

    if point_mm is None:
        px, py = field.centroid_mm(at)
        for _ in range(4):  # the error changes by n (l, m) times the shift of the point, nearly
            slopes = np.stack([l - weight @ l, m - weight @ m]) * index
            shift = np.linalg.lstsq((slopes * np.sqrt(weight)).T, -error(px, py) * np.sqrt(weight), rcond=None)[0]
            px, py = px + float(shift[0]), py + float(shift[1])
        point_mm = px, py
    u, v = field.unit_pupil(at)
    return Wavefront(
        x=u[lit],
        y=v[lit],
        weight=weight,
        error_nm=error(*point_mm) * 1e6,
        wavelength_nm=float(field.wavelength_nm[at[1]]),
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class PathMap:
    """Measured wavefront error over the pupil, on a grid of its square."""

    x: FloatArray  # (c,) Columns and rows of the grid, ascending, in radii of the pupil
    y: FloatArray  # (c,)
    error_nm: FloatArray  # (r, c) Optical path added there

    def __post_init__(self) -> None:
        sizes: dict[str, int] = {}
        freeze_all(self, x=("c",), y=("r",), sizes=sizes)
        error_nm = freeze(self, "error_nm", shape=("r", "c"), sizes=sizes, finite=False)
        masked = np.argwhere(~np.isfinite(error_nm))
        if len(masked):
            raise DomainError(
                f"wavefront map: {len(masked)} of {error_nm.size} values are not finite, the first at row "
                f"{masked[0][0]}, column {masked[0][1]}; fill the points masked by the interferometer (outside the "
                "pupil the mean of neighbours suffices)"
            )
        for name in ("x", "y"):
            grid = getattr(self, name)
            if len(grid) < 4 or not np.all(np.diff(grid) > 0.0):
                raise DomainError(f"wavefront map: {name} must ascend and have at least 4 values, it has {len(grid)}")

    def __call__(self, x: ArrayLike, y: ArrayLike) -> FloatArray:
        """Error [nm] at points of the unit disk, by bicubic splines."""
        px, py = np.asarray(x, float), np.asarray(y, float)
        for name, points, grid in (("x", px, self.x), ("y", py, self.y)):
            if points.size and (points.min() < grid[0] or points.max() > grid[-1]):
                raise DomainError(
                    f"wavefront map reaches {name} = {grid[0]:g} ... {grid[-1]:g} of the pupil's radius, rays lie at "
                    f"{points.min():.3f} ... {points.max():.3f}; a map of the whole pupil is needed"
                )
        return np.asarray(RectBivariateSpline(self.y, self.x, self.error_nm).ev(py, px))

    def added_to(self, field: PupilField) -> PupilField:
        """Pupils with this map added to the optical paths; landing points of the rays stay."""
        fields, waves = field.area_mm2.shape[:2]
        errors = [[self(*field.unit_pupil((f, w))) for w in range(waves)] for f in range(fields)]
        return field.with_path(1e-6 * np.array(errors))


def zernike_map(coefficients_nm: ArrayLike, order: ZernikeOrder = "noll", *, size: int = 129) -> PathMap:
    """Map of measured Zernike coefficients [nm], the first terms of an order.

    Parameters
    ----------
    coefficients_nm : (n,)
        Coefficients [nm].
    order : {"noll", "ansi", "fringe"}
        Their numbering.
    size : int
        Points across the map.

    Returns
    -------
    PathMap
        For the pupil of a `trace_pupil`.

    Raises
    ------
    DomainError
        Coefficients that are not finite.
    """
    values = np.atleast_1d(np.asarray(coefficients_nm, float))
    zernike_numbers(len(values), order)
    if not np.all(np.isfinite(values)):
        raise DomainError(f"Zernike coefficient {int(np.argmax(~np.isfinite(values)))} of {len(values)} is not finite")
    grid = np.linspace(-1.05, 1.05, size)
    x, y = np.meshgrid(grid, grid)
    return PathMap(x=grid, y=grid, error_nm=np.tensordot(values, zernikes(x, y, len(values), order), 1))
