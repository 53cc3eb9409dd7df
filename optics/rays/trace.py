"""Sequential ray trace, written once for NumPy and Dr.Jit arrays.

Steps per surface: transformation to its vertex frame, propagation to the vertex plane, intersection, apertures, Snell's
law or reflection in vector form. Points are relative to the current vertex, so that rounding stays at 1e-14 mm for any
length of lens. Light travels towards +z in every vertex frame (`optics.lens.system`), so that path lengths are positive
on both sides of a mirror.

Failed rays continue with meaningless numbers; ``status`` and ``failed_at`` state the first failure in the order
intersection, clear aperture, refraction.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from optics.arrays import NUMPY, ArrayNamespace
from optics.errors import DomainError
from optics.lens.sag_map import SagMap
from optics.lens.shapes.base import Hit, Shape
from optics.lens.system import LensSystem
from optics.rays.program import LensProgram, SurfaceStep, compile_lens

OK, MISSED, TOTAL_REFLECTION, VIGNETTED = 0, 1, 2, 3
MEASURED_STEPS, MEASURED_RESIDUAL_MM = 5, 1e-10
"""Steps towards a surface with a measured deviation, and the last change [mm] beyond which a ray counts as missed."""
STATUS_NAMES = ("ok", "missed", "total reflection", "vignetted")


@dataclass(frozen=True, slots=True, kw_only=True)
class Rays:
    """A bundle of rays; every field is an array of one library and one size.

    Attributes
    ----------
    x, y, z : array
        Points [mm]: in the lens frame before, in the image plane's frame after the trace (there z = 0).
    dx, dy, dz : array
        Unit direction of travel.
    wavelength_nm : array
        Vacuum wavelength [nm].
    opl_mm : array
        Optical path length from the start [mm].
    status : array of int
        `OK`, `MISSED`, `TOTAL_REFLECTION`, `VIGNETTED`.
    failed_at : array of int
        Index of the surface where the status changed, -1 for none.
    """

    x: Any
    y: Any
    z: Any
    dx: Any
    dy: Any
    dz: Any
    wavelength_nm: Any
    opl_mm: Any
    status: Any
    failed_at: Any

    @staticmethod
    def create(
        *, x_mm: ArrayLike, y_mm: ArrayLike, z_mm: ArrayLike = 0.0, direction: ArrayLike, wavelength_nm: ArrayLike
    ) -> Rays:
        """NumPy rays from broadcastable points, directions and wavelengths.

        Parameters
        ----------
        x_mm, y_mm, z_mm : array
            Start points in the lens frame.
        direction : (..., 3)
            Directions of travel; normalised here.
        wavelength_nm : array
            Vacuum wavelengths [nm].

        Raises
        ------
        DomainError
            On NaN, zero directions or rays that do not travel towards the lens.
        """
        d = np.asarray(direction, float)
        if d.shape[-1:] != (3,):
            raise DomainError(f"ray direction has shape {d.shape}; (..., 3) is needed")
        x, y, z, dx, dy, dz, wavelength = np.broadcast_arrays(
            *(np.asarray(v, float) for v in (x_mm, y_mm, z_mm)),
            *np.moveaxis(d, -1, 0),
            np.asarray(wavelength_nm, float),
        )
        norm = np.sqrt(dx * dx + dy * dy + dz * dz)
        if not (np.all(np.isfinite(x + y + z + wavelength)) and np.all(np.isfinite(norm))):
            raise DomainError("ray start, direction or wavelength is not finite")
        if np.any(norm == 0) or np.any(dz <= 0):
            raise DomainError("a ray does not travel towards the lens: direction z must be positive (light travels +z)")
        return Rays(
            x=x.copy(),
            y=y.copy(),
            z=z.copy(),
            dx=dx / norm,
            dy=dy / norm,
            dz=dz / norm,
            wavelength_nm=wavelength.copy(),
            opl_mm=np.zeros(x.shape),
            status=np.zeros(x.shape, np.int32),
            failed_at=np.full(x.shape, -1, np.int32),
        )

    @property
    def ok(self) -> Any:
        """Mask of the rays that arrived."""
        return self.status == OK


Visitor = Callable[[int, Rays], None]
"""What `trace_program` calls with the number of every surface and the rays on it, in its vertex frame."""


def _into_frame(step: SurfaceStep, theta: Any, p: tuple[Any, Any, Any], d: tuple[Any, Any, Any]) -> tuple[Any, Any]:
    """Point and direction in the step's vertex frame."""
    x, y, z = p
    dx, dy, dz = d
    if step.rotation_at >= 0:
        m = theta[step.rotation_at : step.rotation_at + 9]
        x, y, z = m[0] * x + m[1] * y + m[2] * z, m[3] * x + m[4] * y + m[5] * z, m[6] * x + m[7] * y + m[8] * z
        dx, dy, dz = (
            m[0] * dx + m[1] * dy + m[2] * dz,
            m[3] * dx + m[4] * dy + m[5] * dz,
            m[6] * dx + m[7] * dy + m[8] * dz,
        )
    if step.lateral:
        x, y = x + theta[step.shift_at], y + theta[step.shift_at + 1]
    return (x, y, z + theta[step.shift_at + 2]), (dx, dy, dz)


def _on_measured(
    shape: type[Shape],
    error: SagMap,
    numbers: Sequence[Any],
    start: tuple[Any, Any],
    d: tuple[Any, Any, Any],
    xp: ArrayNamespace,
) -> Hit:
    """Intersection with a shape and its measured deviation; parameters as `Shape.intersect`.

    A ray meets the sag z(x, y) + e(x, y) where the same ray, shifted by -e along z, meets z(x, y); e is that of the
    last point. Every step leaves the slope of e times that of the ray, some 1e-4, of the change before it.
    """
    sag_error, change = 0.0 * start[0], 0.0 * start[0]
    for _ in range(MEASURED_STEPS):
        along = sag_error / d[2]
        hit = shape.intersect(numbers, start[0] + along * d[0], start[1] + along * d[1], d, xp)
        height, slope_x, slope_y, reached = error.at(hit.x, hit.y, xp)
        change, sag_error = height - sag_error, height
    nx, ny = hit.nx / hit.nz - slope_x, hit.ny / hit.nz - slope_y
    scale = 1.0 / xp.sqrt(nx * nx + ny * ny + 1.0)
    cos_i = (nx * d[0] + ny * d[1] + d[2]) * scale
    valid = reached & (change * change < MEASURED_RESIDUAL_MM**2) & (cos_i > 0.0)
    valid = valid if hit.valid is None else hit.valid & valid
    return Hit(along + hit.path, hit.x, hit.y, hit.z + sag_error, nx * scale, ny * scale, scale, cos_i, valid)


def _lost(outside: Any, number: int, status: Any, failed_at: Any, xp: ArrayNamespace) -> tuple[Any, Any]:
    """Status and surface of loss where rays meet something dark."""
    lost = (status == OK) & outside
    return xp.where(lost, VIGNETTED, status), xp.where(lost, number, failed_at)


def _cross(number: int, step: SurfaceStep, theta: Any, index: Sequence[Any], rays: Rays, xp: ArrayNamespace) -> Rays:
    """Rays at the next surface, in its vertex frame, after refraction or reflection."""
    (x, y, z), d = _into_frame(step, theta, (rays.x, rays.y, rays.z), (rays.dx, rays.dy, rays.dz))
    status, failed_at = rays.status, rays.failed_at
    to_plane = -z / d[2]
    x, y = x + to_plane * d[0], y + to_plane * d[1]
    numbers = theta[step.shape_at : step.shape_at + step.shape_size]
    if step.error is None:
        hit = step.shape.intersect(numbers, x, y, d, xp)
    else:
        hit = _on_measured(step.shape, step.error, numbers, (x, y), d, xp)
    n1 = index[step.before]
    opl = rays.opl_mm + n1 * (to_plane + hit.path)
    valid = d[2] > 0.0 if hit.valid is None else hit.valid & (d[2] > 0.0)
    missed = (status == OK) & ~valid
    status = xp.where(missed, MISSED, status)
    failed_at = xp.where(missed, number, failed_at)
    if step.aperture_at >= 0:
        r2 = hit.x * hit.x + hit.y * hit.y
        outside = r2 > theta[step.aperture_at]
        if step.annular:
            outside = outside | (r2 < theta[step.aperture_at + 1])
        status, failed_at = _lost(outside, number, status, failed_at, xp)
    for kind, at, size, obscures in step.outlines:
        inside = kind.inside(theta[at : at + size], hit.x, hit.y, xp)
        status, failed_at = _lost(inside if obscures else ~inside, number, status, failed_at, xp)
    if step.mirror:
        normal = -2.0 * hit.cos_i
        d = (d[0] + normal * hit.nx, d[1] + normal * hit.ny, d[2] + normal * hit.nz)
    elif step.shape.redirects:
        d, path = step.shape.redirect(numbers, hit, d, (n1, index[step.after], index[0]), xp)
        opl = opl + path
    elif step.before != step.after:  # Snell's law in vector form: d' = eta d + (cos i' - eta cos i) N
        eta = n1 / index[step.after]
        cos2 = 1.0 - eta * eta * (1.0 - hit.cos_i * hit.cos_i)
        reflected = (status == OK) & (cos2 < 0.0)
        status = xp.where(reflected, TOTAL_REFLECTION, status)
        failed_at = xp.where(reflected, number, failed_at)
        normal = xp.sqrt(xp.maximum(cos2, 0.0)) - eta * hit.cos_i
        d = (eta * d[0] + normal * hit.nx, eta * d[1] + normal * hit.ny, eta * d[2] + normal * hit.nz)
    return Rays(
        x=hit.x, y=hit.y, z=hit.z, dx=d[0], dy=d[1], dz=d[2],
        wavelength_nm=rays.wavelength_nm, opl_mm=opl, status=status, failed_at=failed_at,
    )  # fmt: skip


def trace_program(
    program: LensProgram,
    theta: Any,
    rays: Rays,
    xp: ArrayNamespace,
    visit: Visitor | None = None,
) -> Rays:
    """Trace rays through a compiled lens to its image plane.

    Parameters
    ----------
    program, theta : LensProgram, array
        From `optics.rays.program.compile_lens`; ``theta`` in the form of ``xp.parameters``.
    rays : Rays
        In the lens frame.
    xp : ArrayNamespace
        Array library of the rays.
    visit : callable, optional
        See `Visitor`.

    Returns
    -------
    Rays
        In the frame of the image plane.
    """
    index = [medium.index(theta, rays.wavelength_nm, xp) for medium in program.media]
    for number, step in enumerate(program.steps):
        rays = _cross(number, step, theta, index, rays, xp)
        if visit is not None:
            visit(number, rays)
    # the image plane is flat, so that z is the plain number 0; adding 0 x makes it an array of the library of the rays
    return replace(rays, z=rays.z + 0.0 * rays.x)


def trace(lens: LensSystem, rays: Rays, visit: Visitor | None = None) -> Rays:
    """Trace NumPy rays through a lens to its image plane.

    Parameters
    ----------
    lens : LensSystem
        The lens.
    rays : Rays
        In the lens frame (`Rays.create`).
    visit : callable, optional
        See `Visitor`.

    Returns
    -------
    Rays
        In the frame of the image plane.

    Raises
    ------
    DomainError
        If a wavelength is outside the range of one of the glasses.
    """
    lens.check_wavelength(rays.wavelength_nm)
    program, theta = compile_lens(lens)
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        return trace_program(program, NUMPY.parameters(theta), rays, NUMPY, visit)


def surface_normal(n1: Any, before: NDArray[Any], n2: Any, after: NDArray[Any]) -> NDArray[np.float64]:
    """Unit normals (3, n) of a surface from the directions (3, n) of traced rays before and behind it.

    Snell's law in vector form: n2 d2 - n1 d1 is a multiple of the normal; 0 where the ray goes on undeflected.
    """
    difference = n2 * after - n1 * before
    length = np.linalg.norm(difference, axis=0)
    return np.asarray(difference / np.where(length > 0.0, length, 1.0))


def trace_path(lens: LensSystem, rays: Rays) -> NDArray[np.float64]:
    """Points where NumPy rays meet every surface and the image plane, in the lens frame; for drawings."""
    points = [np.stack([rays.x, rays.y, rays.z], axis=-1)]

    def visit(number: int, rays: Rays) -> None:
        position, rotation = lens.poses[number]
        local = np.stack(np.broadcast_arrays(rays.x, rays.y, rays.z), axis=-1)
        points.append(np.where((rays.status == OK)[..., None], local @ rotation.T + position, np.nan))

    trace(lens, rays, visit)
    return np.stack(points)
