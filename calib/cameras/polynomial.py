"""Bivariate polynomial of settable degree, ideal -> measured.

For a direction (X, Y, Z) in cam, a = X/Z and b = Y/Z. With h half the longer side of the detector [mm] and f0 a fixed
nominal focal length, u = a f0/h and v = b f0/h span about [-1, 1]. L_i are Legendre polynomials:

    column = (W - 1)/2 + x_a + f a/pitch + c1 u + c2 v + sum over 2 <= i + j <= degree of cx_ij L_i(u) L_j(v)
    row    = (H - 1)/2 + y_a + f b/pitch - c1 v + c2 u + sum over 2 <= i + j <= degree of cy_ij L_i(u) L_j(v)

Parameters: f [mm]; c1 (stretch) and c2 (shear) [px]; all cx_ij, then all cy_ij [px]. Products of Legendre polynomials
are orthogonal over the square, so that the terms are hardly correlated under even star cover, the problem is well
conditioned at any degree, and a higher degree hardly changes the lower terms. f is therefore the best focal length over
the whole field, not the one on the axis.

Gauge. A camera of unknown attitude can be turned without any star moving, so three combinations of polynomial terms
mean nothing, and are left out. A turn about the boresight moves the image by (-v, u): the linear terms are kept
symmetric (the antisymmetric one is missing). A small turn (w_x, w_y) about the other axes moves it by
(f/pitch) (w_y, -w_x) and, less, by terms quadratic in (u, v): with the quadratic terms free, the constant (x_a, y_a),
``anchor_px``, is a fixed property of the record and no parameter. It says which direction is called +Z. Parameters of
two calibrations are comparable for the same anchor and nominal focal length; line-of-sight maps with the best rotation
removed always are.

Derivatives, with P_ij = L_i(u) L_j(v), l = f h/(f0 pitch) and the sums taken over the terms above:

    d column / d u = l + c1 + sum of cx_ij L_i'(u) L_j(v),   d column / d v = c2 + sum of cx_ij L_i(u) L_j'(v)
    d row / d u    = c2 + sum of cy_ij L_i'(u) L_j(v),       d row / d v    = l - c1 + sum of cy_ij L_i(u) L_j'(v)
    d u / d (X, Y, Z) = (f0/h) (1, 0, -a)/Z,                 d v / d (X, Y, Z) = (f0/h) (0, 1, -b)/Z
    d pixel / d f = (a, b)/pitch,  d pixel / d c1 = (u, -v),  d pixel / d c2 = (v, u)
    d column / d cx_ij = d row / d cy_ij = P_ij

Beyond the detector the polynomial extrapolates and means little; where it folds, `unproject` gives NaN.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike

from calib.cameras.base import CameraModel, Projection, SensorGeometry, checked_vectors
from calib.cameras.brown_conrady import from_image, ideal_image
from calib.cameras.inversion import PlaneMap, invert_plane
from optics.arrays import FloatArray
from optics.errors import DomainError
from optics.records import freeze

CHUNK = 512
"""Directions handled together: their arrays stay in the processor's cache."""

HIGHEST_DEGREE = 15


class _Legendre(NamedTuple):
    """Legendre polynomials 0 .. degree and their derivatives at n points, (degree + 1, n)."""

    value: FloatArray
    slope: FloatArray


@dataclass(frozen=True, slots=True, kw_only=True)
class Polynomial(CameraModel):
    """Polynomial camera, ideal -> measured; see the module.

    Attributes
    ----------
    geometry : SensorGeometry
        The detector.
    parameters : (p,)
        f [mm], stretch, shear [px], cx_ij, cy_ij [px]; p = (degree + 1)(degree + 2) - 3.
    degree : int
        Highest degree, 1 .. 15.
    nominal_focal_length_mm : float
        Scales the basis; not a parameter.
    anchor_px : (2,)
        Constant term minus the centre of the detector [px]: which direction is called +Z; not a parameter.
    """

    degree: int
    nominal_focal_length_mm: float
    anchor_px: FloatArray

    def __post_init__(self) -> None:
        degree = self.degree
        if isinstance(degree, bool) or not isinstance(degree, int | np.integer) or not 1 <= degree <= HIGHEST_DEGREE:
            raise DomainError(f"Polynomial.degree = {degree!r}; a whole number from 1 to {HIGHEST_DEGREE} is needed")
        if not (np.isfinite(self.nominal_focal_length_mm) and self.nominal_focal_length_mm > 0):
            raise DomainError(
                f"Polynomial.nominal_focal_length_mm = {self.nominal_focal_length_mm} mm; it must be positive"
            )
        freeze(self, "anchor_px", shape=(2,))
        CameraModel.__post_init__(self)

    @classmethod
    def create(
        cls,
        geometry: SensorGeometry,
        *,
        focal_length_mm: float,
        degree: int = 5,
        nominal_focal_length_mm: float | None = None,
        anchor_px: ArrayLike = (0.0, 0.0),
    ) -> Self:
        """An undistorted camera of this family, to start a fit from.

        Parameters
        ----------
        geometry : SensorGeometry
            The detector.
        focal_length_mm : float
            Focal length [mm].
        degree : int
            Degree of the polynomial.
        nominal_focal_length_mm : float, optional
            Scale of the basis; the focal length if left out.
        anchor_px : (2,)
            Pixel of the constant term minus the centre of the detector.

        Raises
        ------
        DomainError
            On a focal length that is not positive, or a degree out of range.
        """
        if not (np.isfinite(focal_length_mm) and focal_length_mm > 0):
            raise DomainError(f"Polynomial: focal_length_mm = {focal_length_mm} mm; it must be positive")
        nominal = focal_length_mm if nominal_focal_length_mm is None else nominal_focal_length_mm
        parameters = np.zeros(max(0, (degree + 1) * (degree + 2) - 3))
        parameters[:1] = focal_length_mm
        return cls(
            geometry=geometry,
            parameters=parameters,
            degree=degree,
            nominal_focal_length_mm=nominal,
            anchor_px=np.asarray(anchor_px, dtype=np.float64),
        )

    @property
    def terms(self) -> tuple[tuple[int, int], ...]:
        """Degrees (i, j) of the terms of degree 2 and higher, along columns and rows."""
        return tuple((total - j, j) for total in range(2, self.degree + 1) for j in range(total + 1))

    @property
    def parameter_names(self) -> tuple[str, ...]:
        """f, stretch, shear, cx_i_j and cy_i_j, with their units."""
        high = tuple(f"{c}_{i}_{j}_px" for c in ("cx", "cy") for i, j in self.terms)
        return ("focal_length_mm", "stretch_px", "shear_px", *high)

    @property
    def pinhole_names(self) -> tuple[str, ...]:
        """f; the principal point is held by the gauge."""
        return ("focal_length_mm",)

    @property
    def parameter_scales(self) -> FloatArray:
        """Changes that move the image by 1 px in the corner of the detector (p,)."""
        scales = np.ones(len(self.parameters))
        scales[0] = self.geometry.pixel_pitch_mm * abs(self.parameters[0]) / self.geometry.half_diagonal_mm
        return scales

    @property
    def half_side_mm(self) -> float:
        """Half the longer side of the detector [mm]."""
        return 0.5 * self.geometry.pixel_pitch_mm * max(self.geometry.width_px, self.geometry.height_px)

    def project(self, direction: ArrayLike, band: ArrayLike | None = None) -> FloatArray:
        vector = checked_vectors(direction, 3, "direction")
        pixel = np.empty((len(vector), 2))
        cx, cy = self._coefficients()
        f, per = self.parameters[0], self.nominal_focal_length_mm / self.half_side_mm
        offset = self.geometry.centre_px + self.anchor_px
        for start in range(0, len(vector), CHUNK):
            rows = slice(start, start + CHUNK)
            a, b, _ = ideal_image(vector[rows], f)
            with np.errstate(over="ignore", invalid="ignore"):  # directions close to 90 deg from the boresight
                lu, lv = _legendre(a * per, self.degree), _legendre(b * per, self.degree)
                pixel[rows, 0] = offset[0] + np.sum(lu.value * (cx @ lv.value), axis=0)
                pixel[rows, 1] = offset[1] + np.sum(lu.value * (cy @ lv.value), axis=0)
        return pixel

    def project_jacobian(self, direction: ArrayLike, band: ArrayLike | None = None) -> Projection:
        vector = checked_vectors(direction, 3, "direction")
        pixel = np.empty((len(vector), 2))
        by_direction = np.empty((len(vector), 2, 3))
        by_parameter = np.zeros((len(vector), 2, len(self.parameters)))
        coefficients = self._coefficients()
        for start in range(0, len(vector), CHUNK):
            rows = slice(start, start + CHUNK)
            with np.errstate(over="ignore", invalid="ignore"):
                self._fill(vector[rows], coefficients, (pixel[rows], by_direction[rows], by_parameter[rows]))
        return Projection(pixel, by_direction, by_parameter)

    def unproject(self, pixel_px: ArrayLike, band: ArrayLike | None = None) -> FloatArray:
        pixel = checked_vectors(pixel_px, 2, "pixel_px")
        f, per = self.parameters[0], self.nominal_focal_length_mm / self.half_side_mm
        if f <= 0:
            return np.full((len(pixel), 3), np.nan)
        per_px = self.geometry.pixel_pitch_mm * per / f  # pixels to (u, v) of the pinhole
        image = (pixel - (self.geometry.centre_px + self.anchor_px)) * per_px
        cx, cy = (per_px * c for c in self._coefficients())
        reach = _one_to_one_reach(cx, cy)
        u, v = invert_plane(
            lambda x, y: _plane(x, y, cx, cy),
            image[:, 0],
            image[:, 1],
            safe=lambda x, y: np.maximum(np.abs(x), np.abs(y)) < reach,
        )
        return from_image(u / per, v / per, 1.0)

    def _coefficients(self) -> tuple[FloatArray, FloatArray]:
        """Coefficients (degree + 1, degree + 1) of L_i(u) L_j(v) in column and row, linear terms included [px]."""
        size = self.degree + 1
        cx, cy = np.zeros((size, size)), np.zeros((size, size))
        f, stretch, shear = self.parameters[:3]
        linear = f * self.half_side_mm / (self.nominal_focal_length_mm * self.geometry.pixel_pitch_mm)
        cx[1, 0], cx[0, 1] = linear + stretch, shear
        cy[1, 0], cy[0, 1] = shear, linear - stretch
        if self.terms:
            i, j = np.array(self.terms).T
            cx[i, j], cy[i, j] = np.split(self.parameters[3:], 2)
        return cx, cy

    def _fill(
        self,
        vector: FloatArray,
        coefficients: tuple[FloatArray, FloatArray],
        out: tuple[FloatArray, FloatArray, FloatArray],
    ) -> None:
        """Fill pixels and derivatives of directions (n, 3)."""
        pixel, by_direction, by_parameter = out
        per = self.nominal_focal_length_mm / self.half_side_mm
        a, b, inverse = ideal_image(vector, self.parameters[0])
        u, v = a * per, b * per
        lu, lv = _legendre(u, self.degree), _legendre(v, self.degree)
        offset = self.geometry.centre_px + self.anchor_px
        for row, c in enumerate(coefficients):
            value, along_u, along_v = _series(c, lu, lv)
            pixel[:, row] = offset[row] + value
            along_u, along_v = along_u * (per * inverse), along_v * (per * inverse)
            by_direction[:, row, 0], by_direction[:, row, 1] = along_u, along_v
            by_direction[:, row, 2] = -(along_u * a + along_v * b)
        per_pitch = 1.0 / self.geometry.pixel_pitch_mm
        by_parameter[:, 0, 0], by_parameter[:, 1, 0] = a * per_pitch, b * per_pitch
        by_parameter[:, 0, 1], by_parameter[:, 1, 1] = u, -v
        by_parameter[:, 0, 2], by_parameter[:, 1, 2] = v, u
        if self.terms:
            i, j = np.array(self.terms).T
            basis = (lu.value[i] * lv.value[j]).T
            by_parameter[:, 0, 3 : 3 + len(i)] = basis
            by_parameter[:, 1, 3 + len(i) :] = basis


def _legendre(x: FloatArray, degree: int) -> _Legendre:
    """Values and slopes: (k + 1) L_{k+1} = (2k + 1) x L_k - k L_{k-1}, L'_{k+1} = L'_{k-1} + (2k + 1) L_k."""
    value, slope = np.empty((degree + 1, len(x))), np.empty((degree + 1, len(x)))
    value[0], slope[0] = 1.0, 0.0
    value[1], slope[1] = x, 1.0
    for k in range(1, degree):
        value[k + 1] = ((2 * k + 1) * x * value[k] - k * value[k - 1]) / (k + 1)
        slope[k + 1] = slope[k - 1] + (2 * k + 1) * value[k]
    return _Legendre(value, slope)


def _series(c: FloatArray, lu: _Legendre, lv: _Legendre) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Sum of c_ij L_i(u) L_j(v), and its derivatives by u and v, each (n,)."""
    over_v = c @ lv.value
    return (
        np.einsum("in,in->n", lu.value, over_v),
        np.einsum("in,in->n", lu.slope, over_v),
        np.einsum("in,in->n", lu.value, c @ lv.slope),
    )


def _plane(u: FloatArray, v: FloatArray, cx: FloatArray, cy: FloatArray) -> PlaneMap:
    """The polynomial as a map of the plane."""
    degree = len(cx) - 1
    out = np.empty((6, len(u)))
    for start in range(0, len(u), CHUNK):
        rows = slice(start, start + CHUNK)
        lu, lv = _legendre(u[rows], degree), _legendre(v[rows], degree)
        out[0, rows], out[2, rows], out[3, rows] = _series(cx, lu, lv)
        out[1, rows], out[4, rows], out[5, rows] = _series(cy, lu, lv)
    return PlaneMap(*out)


def _one_to_one_reach(cx: FloatArray, cy: FloatArray) -> float:
    """Half side of a square in (u, v) on which the map is certainly one-to-one; 0 where that cannot be shown. On |u|,
    |v| <= rho with rho >= 1, |L_i| and |L_i'| are largest at rho."""
    degree = len(cx) - 1
    ex, ey = cx.copy(), cy.copy()
    ex[1, 0] -= 1.0
    ey[0, 1] -= 1.0
    for rho in (1.5, 1.25, 1.05):
        value, slope = (table[:, 0] for table in _legendre(np.array([rho]), degree))
        bound = [[slope @ np.abs(e) @ value, value @ np.abs(e) @ slope] for e in (ex, ey)]
        if np.sqrt(np.sum(np.square(bound))) < 1.0:
            return rho
    return 0.0
