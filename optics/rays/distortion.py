"""Distortion and plate scale: chief-ray positions against the ideal f tan(field)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from optics.arrays import FloatArray
from optics.errors import DomainError
from optics.lens.system import LensSystem
from optics.rays.chief_ray import chief_ray_points
from optics.records import freeze_alike
from optics.units import DEG_RAD


@dataclass(frozen=True, slots=True, kw_only=True)
class DistortionMap:
    """Chief-ray positions against the ideal f tan(field) on a grid of fields."""

    field_x_deg: FloatArray  # (n, n) Fields
    field_y_deg: FloatArray  # (n, n)
    ideal_x_mm: FloatArray  # (n, n) Ideal positions, from the chief ray of field 0
    ideal_y_mm: FloatArray  # (n, n)
    x_mm: FloatArray  # (n, n) Real positions
    y_mm: FloatArray  # (n, n)
    focal_length_mm: float  # f of the ideal positions

    def __post_init__(self) -> None:
        freeze_alike(self, "field_x_deg", "field_y_deg", "ideal_x_mm", "ideal_y_mm", "x_mm", "y_mm", shape=("n", "m"))

    @property
    def relative(self) -> FloatArray:
        """Radial distortion: displacement along the radius over the ideal radius, (n, n); 0 at the centre."""
        x = self.focal_length_mm * np.tan(self.field_x_deg * DEG_RAD)
        y = -self.focal_length_mm * np.tan(self.field_y_deg * DEG_RAD)
        r2 = x * x + y * y
        along = (self.x_mm - self.ideal_x_mm) * x + (self.y_mm - self.ideal_y_mm) * y
        return np.divide(along, r2, out=np.zeros_like(r2), where=r2 > 0)


def plate_scale_mm(lens: LensSystem, wavelength_nm: float | None = None) -> float:
    """Plate scale: chief-ray displacement per tan(field) at field 0, mean of x and y.

    Equal to the paraxial focal length only if the image plane is the paraxial focal plane.

    Parameters
    ----------
    lens : LensSystem
        The lens.
    wavelength_nm : float, optional
        Wavelength; the design wavelength if left out.

    Returns
    -------
    float
        Focal length [mm]; errors as `optics.rays.chief_ray.chief_ray_points`.
    """
    step = lens.max_field_deg / 100.0
    x, y = chief_ray_points(lens, [step, -step, 0.0, 0.0], [0.0, 0.0, step, -step], wavelength_nm)
    return float((x[0] - x[1] - y[2] + y[3]) / (4.0 * np.tan(step * DEG_RAD)))


def distortion_map(
    lens: LensSystem,
    *,
    count: int = 11,
    max_field_deg: float | None = None,
    wavelength_nm: float | None = None,
    focal_length_mm: float | None = None,
) -> DistortionMap:
    """Distortion on a square grid of fields, regular in tan(field).

    Parameters
    ----------
    lens : LensSystem
        The lens.
    count : int
        Points per side.
    max_field_deg : float, optional
        Field angle at the corners of the grid; that of the lens if left out.
    wavelength_nm : float, optional
        Wavelength; the design wavelength if left out.
    focal_length_mm : float, optional
        f of the ideal lens; the plate scale at that wavelength (`plate_scale_mm`) if left out.

    Returns
    -------
    DistortionMap
        Image points of the lens and of the ideal lens [mm].

    Raises
    ------
    DomainError
        If ``count`` is below 2.
    ConvergenceError
        As `optics.rays.chief_ray.chief_ray_points`.
    """
    if count < 2:
        raise DomainError(f"distortion grid of {count} x {count} points; at least 2 x 2 is needed")
    focal = plate_scale_mm(lens, wavelength_nm) if focal_length_mm is None else focal_length_mm
    corner = lens.max_field_deg if max_field_deg is None else max_field_deg
    side = np.linspace(-1.0, 1.0, count) * np.tan(corner * DEG_RAD) / np.sqrt(2.0)
    tx, ty = np.meshgrid(side, side)
    fx, fy = np.degrees(np.arctan(tx)), np.degrees(np.arctan(ty))
    x, y = chief_ray_points(lens, fx, fy, wavelength_nm)
    x0, y0 = chief_ray_points(lens, 0.0, 0.0, wavelength_nm)
    return DistortionMap(
        field_x_deg=fx,
        field_y_deg=fy,
        ideal_x_mm=x0 + focal * tx,
        ideal_y_mm=y0 - focal * ty,
        x_mm=x,
        y_mm=y,
        focal_length_mm=focal,
    )
