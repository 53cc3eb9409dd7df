"""Chief rays, plate scale and distortion, by real rays; also for perturbed lenses.

Fields are angles of the star in cam (`optics.frames.field_direction`), positions are millimetres in the image plane
(lens frame axes: x along increasing column, y against increasing row).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from optics.arrays import NUMPY, BoolArray, FloatArray
from optics.errors import ConvergenceError, DomainError
from optics.frames import field_direction, light_direction
from optics.lens.system import LensSystem
from optics.rays.aim import aim_at_stop, without_apertures, without_holes
from optics.rays.program import compile_lens
from optics.rays.trace import OK, Rays, trace_program
from optics.records import freeze
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
        for name in ("field_x_deg", "field_y_deg", "ideal_x_mm", "ideal_y_mm", "x_mm", "y_mm"):
            freeze(self, name, shape=("n", "m"), sizes={})

    @property
    def relative(self) -> FloatArray:
        """Radial distortion: displacement along the radius over the ideal radius, (n, n); 0 at the centre."""
        x = self.focal_length_mm * np.tan(self.field_x_deg * DEG_RAD)
        y = -self.focal_length_mm * np.tan(self.field_y_deg * DEG_RAD)
        r2 = x * x + y * y
        along = (self.x_mm - self.ideal_x_mm) * x + (self.y_mm - self.ideal_y_mm) * y
        return np.divide(along, r2, out=np.zeros_like(r2), where=r2 > 0)


def chief_ray_points(
    lens: LensSystem,
    field_x_deg: ArrayLike,
    field_y_deg: ArrayLike,
    wavelength_nm: ArrayLike | None = None,
    *,
    blocked: Literal["refuse", "follow"] = "refuse",
) -> tuple[FloatArray, FloatArray]:
    """Intersections of chief rays (through the centre of the stop) with the image plane.

    Parameters
    ----------
    lens : LensSystem
        The lens.
    field_x_deg, field_y_deg, wavelength_nm : array
        Broadcastable field angles [deg] and wavelengths [nm] (design wavelength if left out).
    blocked : {"refuse", "follow"}
        What to do with a ray that the rim of an aperture stops: refuse it, or follow it as if there were none, for a
        map that reaches beyond the field. A hole in the middle of an aperture never counts.

    Returns
    -------
    x_mm, y_mm : array
        Points of the image plane [mm].

    Raises
    ------
    ConvergenceError
        If no ray passes the centre of the stop, or it misses a surface, is totally reflected or, where requested,
        stopped by a rim.
    """
    wave = lens.design_wavelength_nm if wavelength_nm is None else wavelength_nm
    fx, fy, wave = np.broadcast_arrays(*(np.asarray(v, float) for v in (field_x_deg, field_y_deg, wave)))
    lens.check_wavelength(wave)
    if lens.measured is not None:
        return _measured_points(lens, fx, fy, wave)
    direction = light_direction(field_direction(fx, fy))
    aimed = aim_at_stop(lens, direction, wave)

    def complain(bad: BoolArray, what: str) -> None:
        if bad.any():
            at = np.unravel_index(int(np.argmax(bad)), bad.shape)
            raise ConvergenceError(
                f"lens {lens.name!r}: the chief ray of field ({fx[at]:.6g}, {fy[at]:.6g}) deg at {wave[at]:g} nm {what}"
            )

    complain(~aimed.found, "does not reach the centre of the stop")
    program, theta = compile_lens(lens)
    start = Rays.create(x_mm=aimed.x_mm, y_mm=aimed.y_mm, z_mm=aimed.z_mm, direction=direction, wavelength_nm=wave)
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        out = trace_program(without_apertures(program), NUMPY.parameters(theta), start, NUMPY)
        complain(out.status != OK, "misses a surface or is totally reflected behind the stop")
        if blocked == "refuse":
            stopped = trace_program(without_holes(program), NUMPY.parameters(theta), start, NUMPY)
            first = int(stopped.failed_at[stopped.status != OK].min(initial=len(lens.surfaces)))
            complain(stopped.status != OK, f"is stopped by the rim of {lens.label(first)}")
    return out.x, out.y


def _measured_points(
    lens: LensSystem, fx: FloatArray, fy: FloatArray, wave: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Places that the camera model of a measured lens tells."""
    assert lens.measured is not None
    place = lens.measured.place_mm(field_direction(fx, fy), wave)
    if np.isnan(place).any():
        raise ConvergenceError(
            f"lens {lens.name!r} was measured up to {lens.max_field_deg:g} deg from the axis; the direction lies "
            "beyond the field in which its distortion is one-to-one"
        )
    return place[..., 0], -place[..., 1]


def plate_scale_mm(lens: LensSystem, wavelength_nm: float | None = None) -> float:
    """Plate scale [mm]: chief-ray displacement per tan(field) at field 0, mean of x and y.

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
        Focal length [mm].
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
        Field angle at the corners of the grid; the lens's own if left out.
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
        If chief rays cannot be found.
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
