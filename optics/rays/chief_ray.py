"""Chief rays by real rays: image points of stars; also for perturbed lenses.

Fields are angles of the star in cam (`optics.frames.field_direction`), positions are millimetres in the image plane
(lens frame axes: x along increasing column, y against increasing row).
"""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from optics.arrays import NUMPY, BoolArray, FloatArray
from optics.errors import ConvergenceError
from optics.frames import field_direction, light_direction
from optics.lens.measured import MeasuredLens
from optics.lens.system import LensSystem
from optics.rays.program import compile_lens
from optics.rays.ray_aiming import aim_at_stop, without_apertures, without_obscurations
from optics.rays.trace import OK, Rays, trace_program


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
        return _measured_points(lens, lens.measured, field_direction(fx, fy), wave)
    direction = light_direction(field_direction(fx, fy))
    aimed = aim_at_stop(lens, direction, wave)

    def require(valid: BoolArray, failure: str) -> None:
        if not valid.all():
            at = np.unravel_index(int(np.argmin(valid)), valid.shape)
            raise ConvergenceError(
                f"lens {lens.name!r}: the chief ray of field ({fx[at]:.6g}, {fy[at]:.6g}) deg at {wave[at]:g} nm "
                f"{failure}"
            )

    require(aimed.converged, "does not reach the centre of the stop")
    program, theta = compile_lens(lens)
    start = Rays.create(x_mm=aimed.x_mm, y_mm=aimed.y_mm, z_mm=aimed.z_mm, direction=direction, wavelength_nm=wave)
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        out = trace_program(without_apertures(program), NUMPY.parameters(theta), start, NUMPY)
        require(out.status == OK, "misses a surface or is totally reflected behind the stop")
        if blocked == "refuse":
            stopped = trace_program(without_obscurations(program), NUMPY.parameters(theta), start, NUMPY)
            first = int(stopped.failed_at[stopped.status != OK].min(initial=len(lens.surfaces)))
            require(stopped.status == OK, f"is stopped by the rim of {lens.label(first)}")
    return out.x, out.y


def _measured_points(
    lens: LensSystem, measured: MeasuredLens, v_cam: FloatArray, wave: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Image points by the camera model of a measured lens."""
    position = measured.position_mm(v_cam, wave)
    if np.isnan(position).any():
        raise ConvergenceError(
            f"lens {lens.name!r} was measured up to {lens.max_field_deg:g} deg from the axis; the direction lies "
            "beyond the field in which its distortion is one-to-one"
        )
    return position[..., 0], -position[..., 1]
