"""Pinhole with Brown-Conrady distortion whose focal length and principal point belong to the band.

A lens with lateral colour images the same star at other radii in other bands. To first order that is another focal
length per band, and for a lens with a tilted or decentred element another principal point too; the distortion is shared
(in mm from the band's own principal point). With k the band of a star, everything is as in
`calib.cameras.brown_conrady`:

    x = f_k X/Z,  y = f_k Y/Z
    (x', y') = distortion of (x, y)            `optics.distortion_polynomial`, ideal -> distorted
    column = (W - 1)/2 + x0_k + x'/pitch
    row    = (H - 1)/2 + y0_k + y'/pitch

Parameters: x0, y0 [px] and f [mm] of band 0, then of band 1, and so on; then q1, q2, q3, p1, p2. The derivatives are
those of Brown-Conrady, those by x0, y0 and f standing in the columns of the star's band and zero in the others. Only
the common part of the principal points is degenerate with the attitude; their differences between bands are not.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from calib.cameras.base import CameraModel, Projection, SensorGeometry, checked_vectors
from calib.cameras.brown_conrady import BrownConrady, edge_scales
from optics.arrays import FloatArray
from optics.distortion_polynomial import COEFFICIENTS
from optics.errors import DomainError


@dataclass(frozen=True, slots=True, kw_only=True)
class PerBand(CameraModel):
    """Brown-Conrady camera with a focal length and a principal point per band; see the module.

    Parameters (3 b + 5,): x0, y0 [px], f [mm] of each band; q1 [mm^-2], q2 [mm^-4], q3 [mm^-6], p1, p2 [mm^-1].
    """

    bands: int  # Number of bands b

    def __post_init__(self) -> None:
        if isinstance(self.bands, bool) or not isinstance(self.bands, int | np.integer) or self.bands < 1:
            raise DomainError(f"PerBand.bands = {self.bands!r}; a number of bands, 1 or more, is needed")
        CameraModel.__post_init__(self)

    @classmethod
    def create(
        cls,
        geometry: SensorGeometry,
        *,
        focal_length_mm: ArrayLike,
        x0_px: ArrayLike = 0.0,
        y0_px: ArrayLike = 0.0,
        q1_per_mm2: float = 0.0,
        q2_per_mm4: float = 0.0,
        q3_per_mm6: float = 0.0,
        p1_per_mm: float = 0.0,
        p2_per_mm: float = 0.0,
    ) -> Self:
        """A camera from named parameters.

        Shapes: ``focal_length_mm`` (b,), ``x0_px`` (b,), ``y0_px`` (b,).
        """
        f = np.atleast_1d(np.asarray(focal_length_mm, dtype=np.float64))
        if f.ndim != 1 or f.size == 0 or not np.all(np.isfinite(f) & (f > 0)):
            raise DomainError(f"PerBand: focal_length_mm = {f.tolist()} mm; one positive value per band is needed")
        of_bands = np.empty((len(f), 3))
        for column, (name, values) in enumerate((("x0_px", x0_px), ("y0_px", y0_px))):
            array = np.asarray(values, dtype=np.float64)
            if array.shape not in ((), f.shape):
                raise DomainError(f"PerBand: {name} of shape {array.shape} for {len(f)} bands")
            of_bands[:, column] = array
        of_bands[:, 2] = f
        shared = [q1_per_mm2, q2_per_mm4, q3_per_mm6, p1_per_mm, p2_per_mm]
        return cls(geometry=geometry, parameters=np.concatenate([of_bands.ravel(), shared]), bands=len(f))

    @property
    def parameter_names(self) -> tuple[str, ...]:
        """x0, y0, f of each band, then q1, q2, q3, p1, p2, with their units."""
        of_bands = (f"{name}_band{k}_{unit}" for k in range(self.bands) for name, unit in _PER_BAND)
        return (*of_bands, *COEFFICIENTS)

    @property
    def pinhole_names(self) -> tuple[str, ...]:
        """x0, y0 and f of each band."""
        return self.parameter_names[: 3 * self.bands]

    @property
    def parameter_scales(self) -> FloatArray:
        """Changes that move the image by 1 px in the corner of the detector (3 b + 5,)."""
        of_bands = [[1.0, 1.0, edge_scales(self.geometry, self.parameters[3 * k + 2])[0]] for k in range(self.bands)]
        return np.concatenate([np.ravel(of_bands), edge_scales(self.geometry, 1.0)[1:]])

    def of_band(self, band: int) -> BrownConrady:
        """The camera in one band."""
        if not 0 <= band < self.bands:
            raise DomainError(f"band {band} of a camera with {self.bands} bands; bands are counted from 0")
        pinhole = self.parameters[3 * band : 3 * band + 3]
        return BrownConrady(
            geometry=self.geometry, parameters=np.concatenate([pinhole, self.parameters[3 * self.bands :]])
        )

    def project(self, direction: ArrayLike, band: ArrayLike | None = None) -> FloatArray:
        vector = checked_vectors(direction, 3, "direction")
        out = np.empty((len(vector), 2))
        for k, rows in self._rows(band, len(vector)):
            out[rows] = self.of_band(k).project(vector[rows])
        return out

    def project_jacobian(self, direction: ArrayLike, band: ArrayLike | None = None) -> Projection:
        vector = checked_vectors(direction, 3, "direction")
        pixel = np.empty((len(vector), 2))
        by_direction = np.empty((len(vector), 2, 3))
        by_parameter = np.zeros((len(vector), 2, len(self.parameters)))
        for k, rows in self._rows(band, len(vector)):
            part = self.of_band(k).project_jacobian(vector[rows])
            pixel[rows], by_direction[rows] = part.pixel_px, part.by_direction
            by_parameter[rows, :, 3 * k : 3 * k + 3] = part.by_parameter[:, :, :3]
            by_parameter[rows, :, 3 * self.bands :] = part.by_parameter[:, :, 3:]
        return Projection(pixel, by_direction, by_parameter)

    def unproject(self, pixel_px: ArrayLike, band: ArrayLike | None = None) -> FloatArray:
        pixel = checked_vectors(pixel_px, 2, "pixel_px")
        out = np.empty((len(pixel), 3))
        for k, rows in self._rows(band, len(pixel)):
            out[rows] = self.of_band(k).unproject(pixel[rows])
        return out

    def _rows(self, band: ArrayLike | None, count: int) -> list[tuple[int, slice | NDArray[np.int64]]]:
        """Bands that occur, each with its rows."""
        number = np.asarray(0 if band is None else band)
        if number.dtype.kind not in "iu" or number.shape not in ((), (count,)):
            raise DomainError(
                f"band of shape {number.shape}, {number.dtype}; one whole number or one per star ({count},)"
            )
        if number.size and not (number.min() >= 0 and number.max() < self.bands):
            raise DomainError(
                f"band from {number.min()} to {number.max()} in a camera with {self.bands} bands; counted from 0"
            )
        if number.ndim == 0:
            return [(int(number), slice(None))]
        return [(int(k), np.flatnonzero(number == k)) for k in np.unique(number)]


_PER_BAND = (("x0", "px"), ("y0", "px"), ("focal_length", "mm"))
