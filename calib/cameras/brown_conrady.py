"""Pinhole with Brown-Conrady distortion: one focal length, one principal point, five coefficients.

Ideal -> distorted, in mm from the principal point (ACF17, eq. 3 and 4). For a direction (X, Y, Z) in cam, a = X/Z and
b = Y/Z:

    x = f a,  y = f b                          ideal image [mm]
    (x', y') = distortion of (x, y)            `optics.distortion_polynomial`
    column = (W - 1)/2 + x0 + x'/pitch
    row    = (H - 1)/2 + y0 + y'/pitch

Parameters: x0, y0 [px], the principal point minus the centre of the detector; f [mm]; q1, q2, q3 [mm^-2, mm^-4, mm^-6];
p1, p2 [mm^-1], p1 belonging to 2 x^2 + r^2 in x. A pinhole is the same with the distortion zero and held.

Derivatives, with G = d(x', y')/d(x, y) (2 x 2, symmetric) and s = x^2 + y^2:

    d pixel / d (X, Y, Z) = (f / (Z pitch)) G [[1, 0, -a], [0, 1, -b]]
    d pixel / d (x0, y0)  = identity
    d pixel / d f         = G (a, b) / pitch
    d pixel / d q_k       = s^k (x, y) / pitch,  k = 1, 2, 3
    d pixel / d p1        = (2 x^2 + s, 2 x y) / pitch
    d pixel / d p2        = (2 x y, 2 y^2 + s) / pitch

The principal point and a turn of the camera by (x0 pitch / f) about the row axis differ only by second-order terms, and
so do the tangential coefficients: over small fields they are nearly degenerate with the attitude and with one another.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import ArrayLike

from calib.cameras.base import CameraModel, Projection, SensorGeometry, checked_vectors
from calib.cameras.distortion import distort_jacobian, undistort
from optics.arrays import FloatArray
from optics.distortion_polynomial import COEFFICIENTS, distort
from optics.errors import DomainError
from optics.units import DEG_RAD

CHUNK = 2048
"""Directions handled together: their arrays stay in the processor's cache."""

NAMES = ("x0_px", "y0_px", "focal_length_mm", *COEFFICIENTS)


@dataclass(frozen=True, slots=True, kw_only=True)
class BrownConrady(CameraModel):
    """Pinhole with Brown-Conrady distortion, ideal -> distorted; see the module.

    Attributes
    ----------
    geometry : SensorGeometry
        The detector.
    parameters : (8,)
        x0, y0 [px], f [mm], q1 [mm^-2], q2 [mm^-4], q3 [mm^-6], p1, p2 [mm^-1].
    """

    @classmethod
    def create(
        cls,
        geometry: SensorGeometry,
        *,
        focal_length_mm: float,
        x0_px: float = 0.0,
        y0_px: float = 0.0,
        q1_per_mm2: float = 0.0,
        q2_per_mm4: float = 0.0,
        q3_per_mm6: float = 0.0,
        p1_per_mm: float = 0.0,
        p2_per_mm: float = 0.0,
    ) -> Self:
        """A camera from named parameters.

        Raises
        ------
        DomainError
            On a focal length that is not positive, or a value that is not finite.
        """
        if not (np.isfinite(focal_length_mm) and focal_length_mm > 0):
            raise DomainError(f"BrownConrady: focal_length_mm = {focal_length_mm} mm; it must be positive")
        values = [x0_px, y0_px, focal_length_mm, q1_per_mm2, q2_per_mm4, q3_per_mm6, p1_per_mm, p2_per_mm]
        return cls(geometry=geometry, parameters=np.array(values, dtype=np.float64))

    @classmethod
    def of_field(cls, geometry: SensorGeometry, field_deg: float) -> Self:
        """An undistorted camera whose detector is as wide as a field [deg], edge to edge."""
        half_mm = geometry.width_px * geometry.pixel_pitch_mm / 2
        return cls.create(geometry, focal_length_mm=float(half_mm / np.tan(field_deg * DEG_RAD / 2)))

    @property
    def parameter_names(self) -> tuple[str, ...]:
        """x0, y0, f, q1, q2, q3, p1, p2, with their units."""
        return NAMES

    @property
    def pinhole_names(self) -> tuple[str, ...]:
        """x0, y0 and f."""
        return NAMES[:3]

    @property
    def parameter_scales(self) -> FloatArray:
        """Changes that move the image by 1 px in the corner of the detector (8,)."""
        return np.concatenate([[1.0, 1.0], edge_scales(self.geometry, self.parameters[2])])

    def project(self, direction: ArrayLike, band: ArrayLike | None = None) -> FloatArray:
        vector = checked_vectors(direction, 3, "direction")
        x0, y0, f = self.parameters[:3].tolist()
        pitch = self.geometry.pixel_pitch_mm
        centre = self.geometry.centre_px
        pixel = np.empty((len(vector), 2))
        for start in range(0, len(vector), CHUNK):
            rows = slice(start, start + CHUNK)
            a, b, _ = ideal_image(vector[rows], f)
            with np.errstate(over="ignore", invalid="ignore"):  # directions close to 90 deg from the boresight
                x, y = distort(f * a, f * b, self.parameters[3:])
            pixel[rows, 0] = x / pitch + (centre[0] + x0)
            pixel[rows, 1] = y / pitch + (centre[1] + y0)
        return pixel

    def project_jacobian(self, direction: ArrayLike, band: ArrayLike | None = None) -> Projection:
        vector = checked_vectors(direction, 3, "direction")
        offset = self.geometry.centre_px + self.parameters[:2]
        pixel = np.empty((len(vector), 2))
        by_direction = np.empty((len(vector), 2, 3))
        by_parameter = np.empty((len(vector), 2, 8))
        by_parameter[:, :, :2] = np.eye(2)
        pitch = self.geometry.pixel_pitch_mm
        for start in range(0, len(vector), CHUNK):
            rows = slice(start, start + CHUNK)
            out = (pixel[rows], by_direction[rows], by_parameter[rows, :, 2:])
            with np.errstate(over="ignore", invalid="ignore"):
                fill_jacobian(vector[rows], self.parameters[2:], offset, pitch, out)
        return Projection(pixel, by_direction, by_parameter)

    def unproject(self, pixel_px: ArrayLike, band: ArrayLike | None = None) -> FloatArray:
        pixel = checked_vectors(pixel_px, 2, "pixel_px")
        image = (pixel - (self.geometry.centre_px + self.parameters[:2])) * self.geometry.pixel_pitch_mm
        x, y = undistort(image[:, 0], image[:, 1], self.parameters[3:])
        return from_image(x, y, self.parameters[2])

    def to_opencv(self) -> tuple[FloatArray, FloatArray]:
        """OpenCV's camera matrix (3, 3) and distortion coefficients (5,): k1, k2, p1, p2, k3.

        OpenCV distorts in the same direction and with the same pixel convention, but in units of the focal length, and
        its p1 belongs to 2 x y in x, its p2 to r^2 + 2 x^2: the two tangential coefficients change their roles.
        """
        x0, y0, f, q1, q2, q3, p1, p2 = self.parameters.tolist()
        centre = self.geometry.centre_px
        scale = f / self.geometry.pixel_pitch_mm
        matrix = np.array([[scale, 0.0, centre[0] + x0], [0.0, scale, centre[1] + y0], [0.0, 0.0, 1.0]])
        return matrix, np.array([q1 * f**2, q2 * f**4, p2 * f, p1 * f, q3 * f**6])

    @classmethod
    def from_opencv(cls, geometry: SensorGeometry, camera_matrix: ArrayLike, coefficients: ArrayLike) -> Self:
        """A camera from OpenCV's camera matrix (3, 3) and 4 or 5 distortion coefficients.

        Raises
        ------
        DomainError
            On unequal focal lengths, skew, coefficients this model does not have, or wrong shapes.
        """
        matrix = np.asarray(camera_matrix, dtype=np.float64)
        given = np.ravel(np.asarray(coefficients, dtype=np.float64))
        if matrix.shape != (3, 3) or given.size < 4:
            raise DomainError(
                f"camera matrix {matrix.shape} and {given.size} coefficients; (3, 3) and 4 or 5 are needed"
            )
        if np.any(given[5:]):
            raise DomainError(
                "OpenCV coefficients beyond k3 (rational, thin prism, tilt) have no place in BrownConrady"
            )
        fx, fy = matrix[0, 0], matrix[1, 1]
        if abs(fx - fy) > 1e-9 * abs(fx) or matrix[0, 1] != 0:
            raise DomainError(
                f"OpenCV camera matrix with fx = {fx:.6g} px, fy = {fy:.6g} px, skew {matrix[0, 1]:.3g} px; "
                "BrownConrady has one focal length and no skew: calibrate with CALIB_FIX_ASPECT_RATIO"
            )
        f = fx * geometry.pixel_pitch_mm
        k1, k2, p1, p2 = given[:4].tolist()
        k3 = float(given[4]) if given.size > 4 else 0.0
        x0, y0 = (matrix[:2, 2] - geometry.centre_px).tolist()
        return cls.create(
            geometry,
            focal_length_mm=float(f),
            x0_px=x0,
            y0_px=y0,
            q1_per_mm2=k1 / f**2,
            q2_per_mm4=k2 / f**4,
            q3_per_mm6=k3 / f**6,
            p1_per_mm=p2 / f,
            p2_per_mm=p1 / f,
        )


def edge_scales(geometry: SensorGeometry, focal_length_mm: float) -> FloatArray:
    """Changes of f, q1, q2, q3, p1, p2 that move the image by 1 px in the corner of the detector (6,)."""
    pitch, r = geometry.pixel_pitch_mm, geometry.half_diagonal_mm
    tangential = pitch / (3.0 * r**2)
    return np.array(
        [pitch * abs(focal_length_mm) / r, pitch / r**3, pitch / r**5, pitch / r**7, tangential, tangential]
    )


def ideal_image(vector: FloatArray, focal_length_mm: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """X/Z, Y/Z and 1/Z of directions (n, 3); NaN behind the camera, and everywhere if f is not positive."""
    z = vector[:, 2]
    valid = (z > 0) & (focal_length_mm > 0)
    inverse = np.divide(1.0, z, out=np.full(z.shape, np.nan), where=valid)
    return vector[:, 0] * inverse, vector[:, 1] * inverse, inverse


def from_image(x: FloatArray, y: FloatArray, focal_length_mm: float) -> FloatArray:
    """Unit vectors (n, 3) whose ideal images are x, y [mm]; NaN everywhere if f is not positive."""
    out = np.empty((len(x), 3))
    out[:, 0], out[:, 1], out[:, 2] = x, y, focal_length_mm if focal_length_mm > 0 else np.nan
    out /= np.sqrt(np.einsum("ni,ni->n", out, out))[:, None]
    return out


def fill_jacobian(
    vector: FloatArray,
    parameters: FloatArray,
    offset_px: FloatArray,
    pitch_mm: float,
    out: tuple[FloatArray, FloatArray, FloatArray],
) -> None:
    """Fill pixels (n, 2) and derivatives (n, 2, 3), (n, 2, 6) by f, q1, q2, q3, p1, p2 of directions (n, 3).

    Shapes: ``vector`` (n, 3), ``parameters`` (6,), ``offset_px`` (2,).
    """
    pixel, by_direction, by_parameter = out
    f = float(parameters[0])
    a, b, inverse = ideal_image(vector, f)
    x, y = f * a, f * b
    at = distort_jacobian(x, y, parameters[1:])
    per_pitch = 1.0 / pitch_mm
    pixel[:, 0] = at.x * per_pitch + offset_px[0]
    pixel[:, 1] = at.y * per_pitch + offset_px[1]
    scale = inverse * (f * per_pitch)
    for row, (along_x, along_y) in enumerate(((at.xx, at.xy), (at.yx, at.yy))):
        by_direction[:, row, 0] = along_x * scale
        by_direction[:, row, 1] = along_y * scale
        radial = along_x * a + along_y * b
        by_direction[:, row, 2] = -radial * scale
        by_parameter[:, row, 0] = radial * per_pitch
    s = x * x + y * y
    x_px, y_px = x * per_pitch, y * per_pitch
    power_x, power_y = x_px, y_px
    for k in (1, 2, 3):
        power_x, power_y = power_x * s, power_y * s
        by_parameter[:, 0, k] = power_x
        by_parameter[:, 1, k] = power_y
    s_px, cross = s * per_pitch, 2.0 * x * y_px
    by_parameter[:, 0, 4] = 2.0 * x * x_px + s_px
    by_parameter[:, 1, 4] = cross
    by_parameter[:, 0, 5] = cross
    by_parameter[:, 1, 5] = 2.0 * y * y_px + s_px
