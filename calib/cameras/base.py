"""The interface of all camera models: directions in cam to pixels and back, with derivatives.

A direction v = (X, Y, Z) in ``cam`` (+Z boresight, +X along increasing column, +Y along increasing row) has the ideal,
undistorted image (X/Z, Y/Z). A model turns the ideal image into the measured pixel; every model is written in that
direction, **ideal -> measured**, and inverted numerically. A projection depends on the direction of v alone, not on its
length, so that its derivative by v annihilates v:

    pixel = project(v; theta),   A = d pixel / d v (2 x 3),   A v = 0.

The derivatives of the inverse follow from the implicit function theorem: with d pixel = A dv + B dtheta and dv
perpendicular to v,

    dv = A^T (A A^T)^-1 (d pixel - B dtheta).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from optics.arrays import FloatArray
from optics.errors import DomainError, unknown_name
from optics.records import freeze


@dataclass(frozen=True, slots=True, kw_only=True)
class SensorGeometry:
    """Size of a detector.

    Attributes
    ----------
    width_px, height_px : int
        Columns and rows.
    pixel_pitch_mm : float
        Distance of pixel centres [mm], the same along rows and columns.

    Raises
    ------
    DomainError
        On a size or pitch that is not positive.
    """

    width_px: int
    height_px: int
    pixel_pitch_mm: float

    def __post_init__(self) -> None:
        for name in ("width_px", "height_px"):
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, int | np.integer) or value < 1:
                raise DomainError(f"SensorGeometry.{name} = {value!r}; a positive number of pixels is needed")
        if not (np.isfinite(self.pixel_pitch_mm) and self.pixel_pitch_mm > 0):
            raise DomainError(f"SensorGeometry.pixel_pitch_mm = {self.pixel_pitch_mm} mm; it must be positive")

    @property
    def centre_px(self) -> FloatArray:
        """Centre of the detector (column, row), (2,)."""
        return np.array([(self.width_px - 1) / 2, (self.height_px - 1) / 2])

    @property
    def corners_px(self) -> FloatArray:
        """Outer corners of the corner pixels (4, 2), counted around the detector from the first pixel."""
        right, bottom = self.width_px - 0.5, self.height_px - 0.5
        return np.array([[-0.5, -0.5], [right, -0.5], [right, bottom], [-0.5, bottom]])

    @property
    def half_diagonal_mm(self) -> float:
        """Distance of a corner from the centre [mm]."""
        return 0.5 * self.pixel_pitch_mm * float(np.hypot(self.width_px, self.height_px))

    def grid_px(self, count: int) -> FloatArray:
        """Regular grid of count x count positions (count^2, 2) between the centres of the corner pixels, row by row.

        Raises
        ------
        DomainError
            If ``count`` is below 2.
        """
        if count < 2:
            raise DomainError(f"SensorGeometry.grid_px: count = {count}; at least 2 points per side are needed")
        column = np.linspace(0.0, self.width_px - 1.0, count)
        row = np.linspace(0.0, self.height_px - 1.0, count)
        x, y = np.meshgrid(column, row)
        return np.stack([x.ravel(), y.ravel()], axis=1)

    def contains(self, pixel_px: ArrayLike, *, margin_px: float = 0.0) -> NDArray[np.bool_]:
        """Which positions (n, 2) lie on the detector, or at most ``margin_px`` outside it; false for NaN."""
        pixel = np.asarray(pixel_px, dtype=np.float64)
        low = -0.5 - margin_px
        high = np.array([self.width_px, self.height_px]) - 0.5 + margin_px
        return np.asarray(np.all((pixel >= low) & (pixel <= high), axis=1))


class Projection(NamedTuple):
    """Pixels with their derivatives; plain arrays, not copied, since fits ask for many."""

    pixel_px: FloatArray  # (n, 2) Positions
    # (n, 2, 3) Derivative by the components of the direction as handed in, whatever its length
    by_direction: FloatArray
    by_parameter: FloatArray  # (n, 2, p) Derivative by the model's parameters


class Unprojection(NamedTuple):
    """Directions with their derivatives."""

    direction: FloatArray  # (n, 3) Unit vectors in cam
    by_pixel: FloatArray  # (n, 3, 2) Derivative by the pixel; perpendicular to the direction
    # (n, 3, p) Derivative by the model's parameters, the pixel held; perpendicular to the direction
    by_parameter: FloatArray


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraModel(ABC):
    """A camera: a record of its parameters, and the projection they describe.

    Attributes
    ----------
    geometry : SensorGeometry
        The detector.
    parameters : (p,)
        All parameters in one vector, ordered and named as `parameter_names`.
    """

    geometry: SensorGeometry
    parameters: FloatArray

    def __post_init__(self) -> None:
        freeze(self, "parameters", shape=(len(self.parameter_names),))

    @property
    @abstractmethod
    def parameter_names(self) -> tuple[str, ...]:
        """Names of the parameters (p), each ending in its unit."""

    @property
    @abstractmethod
    def pinhole_names(self) -> tuple[str, ...]:
        """Names of those parameters that an undistorted camera has too."""

    @property
    @abstractmethod
    def parameter_scales(self) -> FloatArray:
        """Change of each parameter that moves the image by about 1 px where it acts most (p,); for step sizes."""

    @abstractmethod
    def project(self, direction: ArrayLike, band: ArrayLike | None = None) -> FloatArray:
        """Pixels (n, 2) of directions (n, 3) in cam.

        Parameters
        ----------
        direction : (n, 3)
            Directions; their length does not matter.
        band : int or (n,) int, optional
            Band of each, for models that know bands; 0 if left out.

        Returns
        -------
        (n, 2)
            (column, row), also beyond the detector's edge; NaN for directions behind the camera (Z <= 0), and for all
            of them if the focal length is not positive.

        Raises
        ------
        DomainError
            On NaN or infinite directions, a wrong shape, a band the model does not have.
        """

    @abstractmethod
    def project_jacobian(self, direction: ArrayLike, band: ArrayLike | None = None) -> Projection:
        """Pixels and their derivatives; arguments and errors of `project`."""

    @abstractmethod
    def unproject(self, pixel_px: ArrayLike, band: ArrayLike | None = None) -> FloatArray:
        """Unit vectors in cam (n, 3) that are imaged at pixels (n, 2); the inverse of `project`.

        Parameters
        ----------
        pixel_px : (n, 2)
            (column, row).
        band : int or (n,) int, optional
            As in `project`.

        Returns
        -------
        (n, 3)
            The solution connected with the axis; NaN where there is none, that is beyond the place where the distortion
            folds the image over.

        Raises
        ------
        DomainError
            On NaN or infinite pixels, a wrong shape, a band the model does not have.
        """

    @property
    def pixel_angle_rad(self) -> float:
        """Angle of a pixel in the middle of the detector [rad]."""
        ray = self.unproject(self.geometry.centre_px + np.array([[-0.5, 0.0], [0.5, 0.0]]))
        return float(np.linalg.norm(ray[1] - ray[0]))

    def with_parameters(self, parameters: ArrayLike) -> Self:
        """The same camera with other parameters (p,).

        Raises
        ------
        DomainError
            On a wrong number of them, or one that is not finite.
        """
        return replace(self, parameters=np.asarray(parameters, dtype=np.float64))

    def value(self, name: str) -> float:
        """One parameter by its name.

        Raises
        ------
        ConfigError
            On an unknown name.
        """
        if name not in self.parameter_names:
            raise unknown_name("camera parameter", name, self.parameter_names)
        return float(self.parameters[self.parameter_names.index(name)])

    def visible(
        self, direction: ArrayLike, band: ArrayLike | None = None, *, margin_px: float = 0.0
    ) -> NDArray[np.bool_]:
        """Mask of the directions (n, 3) imaged on the detector, or at most ``margin_px`` outside it.

        A direction far outside the field, where the model folds over, may have a pixel inside the detector; it is not
        visible.
        """
        vector = checked_vectors(direction, 3, "direction")
        pixel = self.project(vector, band)
        inside = self.geometry.contains(pixel, margin_px=margin_px)
        if np.any(inside):
            chosen = None if band is None else np.broadcast_to(np.asarray(band), inside.shape)[inside]
            unprojected = self.unproject(pixel[inside], chosen)
            unit = vector[inside] / np.linalg.norm(vector[inside], axis=1, keepdims=True)
            inside[inside] = np.linalg.norm(unprojected - unit, axis=1) < 1e-9  # NaN compares false
        return inside


def checked_vectors(values: ArrayLike, columns: int, name: str) -> FloatArray:
    """Finite float64 array (n, columns), or one clear line."""
    try:
        array = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise DomainError(f"{name}: not convertible to an array of float64 ({error})") from None
    if array.ndim != 2 or array.shape[1] != columns:
        raise DomainError(f"{name}: shape {array.shape} where (n, {columns}) is needed")
    if not np.isfinite(array).all():
        row = int(np.argmin(np.isfinite(array).all(axis=1)))
        raise DomainError(f"{name}: row {row} is {array[row].tolist()}; finite values are needed")
    return array


def unproject_jacobian(model: CameraModel, pixel_px: ArrayLike, band: ArrayLike | None = None) -> Unprojection:
    """Directions of pixels with their derivatives, by the implicit function theorem; for every camera model.

    Shapes: ``pixel_px`` (n, 2), ``band`` (n,), returns (n, 3).
    """
    direction = model.unproject(pixel_px, band)
    finite = np.asarray(np.isfinite(direction).all(axis=1))
    if not finite.all():
        direction = np.where(finite[:, None], direction, [0.0, 0.0, 1.0])
    _, a, b = model.project_jacobian(direction, band)
    xx = np.einsum("ni,ni->n", a[:, 0], a[:, 0])
    xy = np.einsum("ni,ni->n", a[:, 0], a[:, 1])
    yy = np.einsum("ni,ni->n", a[:, 1], a[:, 1])
    determinant = xx * yy - xy * xy
    by_pixel = np.empty((len(direction), 3, 2))
    by_pixel[:, :, 0] = (yy[:, None] * a[:, 0] - xy[:, None] * a[:, 1]) / determinant[:, None]
    by_pixel[:, :, 1] = (xx[:, None] * a[:, 1] - xy[:, None] * a[:, 0]) / determinant[:, None]
    by_parameter = -(by_pixel @ b)
    if not finite.all():
        for array in (direction, by_pixel, by_parameter):
            array[~finite] = np.nan
    return Unprojection(direction, by_pixel, by_parameter)
