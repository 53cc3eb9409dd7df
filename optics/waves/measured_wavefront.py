"""A measured wavefront error, applied to a lens as the figure error of a surface next to its stop.

Interferometers measure the error of a lens over its pupil. On the surface next to the stop it acts on all fields
and wavelengths nearly alike, bends rays and delays waves consistently (the centroid of the light stays the mean of the
rays), and moves with its element. The height for a path difference follows from the path change of every ray per small
constant height, which by Fermat's principle is independent of the bending of rays behind the surface.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from optics.arrays import FloatArray
from optics.errors import DomainError
from optics.field_map import polynomial_basis
from optics.lens.sag_map import SagMap
from optics.lens.system import LensSystem
from optics.rays.trace import Rays, trace_path
from optics.waves.pupil_field import PupilField, trace_pupil
from optics.waves.wavefront import PathMap

ORDER = (12, 32)
DEGREE = 7
"""Of the polynomials from the surface to the pupil."""
PROBE_MM = 1e-5
POINTS = 129
MARGIN = 1.3
"""Width of the map in footprints of the light on the axis, at least; the rims of the surface, if they are wider."""
REACH = 1.04
"""Radius of the pupil up to which a map is read; the beams of other fields that lie further out get its edge."""


def with_wavefront(lens: LensSystem, error: PathMap) -> LensSystem:
    """Lens with an additional wavefront error, exact on the axis at the design wavelength.

    Parameters
    ----------
    lens : LensSystem
        The lens.
    error : PathMap
        Optical path [nm] over the pupil, positive where the light is late, axes as in the lens frame; read up to 1.04
        of the pupil's radius, or to where it ends.

    Returns
    -------
    LensSystem
        The changed lens.

    Raises
    ------
    DomainError
        No refracting or reflecting surface without a measured error.
    """
    lens.check_surfaces()
    at = _surface(lens)
    wave = lens.design_wavelength_nm
    pupil = trace_pupil(lens, [0.0], [0.0], [wave], order=ORDER)
    raised = trace_pupil(_with_error(lens, at, np.full((5, 5), PROBE_MM), 1e5), [0.0], [0.0], [wave], order=ORDER)
    lit = (pupil.area_mm2[0, 0] > 0.0) & (raised.area_mm2[0, 0] > 0.0)
    path_per_height = (raised.path_to([[0.0]], [[0.0]]) - pupil.path_to([[0.0]], [[0.0]]))[0, 0][lit] / PROBE_MM
    u, v = (p[lit] for p in pupil.unit_pupil((0, 0)))
    footprint = _footprint(lens, at, pupil)[lit]
    radius = float(np.linalg.norm(footprint, axis=1).max())
    rim = lens.surfaces[at].semi_diameter_mm
    width = 2.0 * max(MARGIN * radius, 1.01 * rim if np.isfinite(rim) else 0.0)
    side = np.linspace(-0.5 * width, 0.5 * width, POINTS)
    point = np.stack(np.meshgrid(side, side), axis=-1)
    # polynomials hold on the footprint: points beyond are read on its edge, and their pupil coordinates scaled
    within = np.minimum(1.0, radius / np.maximum(np.linalg.norm(point, axis=-1), 1e-300))
    values = np.stack([u, v, path_per_height], axis=-1)
    coefficients = np.linalg.lstsq(polynomial_basis(footprint / radius, DEGREE), values, rcond=None)[0]
    px, py, gain = np.moveaxis(polynomial_basis(point * within[..., None] / radius, DEGREE) @ coefficients, -1, 0)
    px, py = px / within, py / within
    end = min(REACH, *(abs(float(edge)) for grid in (error.x, error.y) for edge in (grid[0], grid[-1])))
    inside = np.minimum(1.0, end / np.maximum(np.hypot(px, py), 1e-300))
    return _with_error(lens, at, 1e-6 * error(px * inside, py * inside) / gain, width)


def _surface(lens: LensSystem) -> int:
    """The refracting or reflecting surface without measured error nearest to the stop; of two as near, the later."""
    index = lens.indices(np.array([lens.design_wavelength_nm]))[:, 0]
    candidates = [
        i
        for i, surface in enumerate(lens.surfaces)
        if surface.error is None and (surface.mirror or abs(index[i + 1] - index[i]) > 1e-3)
    ]
    if not candidates:
        raise DomainError(
            f"lens {lens.name!r}: no surface can carry the measured wavefront error: it needs a change of index or "
            "a mirror, and no surface map yet"
        )
    return min(candidates, key=lambda i: (abs(i - lens.stop_index), -i))


def _with_error(lens: LensSystem, at: int, height_mm: FloatArray, width_mm: float) -> LensSystem:
    surfaces = list(lens.surfaces)
    surfaces[at] = replace(surfaces[at], error=SagMap(values_mm=height_mm, width_mm=(width_mm, width_mm)))
    return replace(lens, surfaces=tuple(surfaces))


def _footprint(lens: LensSystem, at: int, pupil: PupilField) -> FloatArray:
    """Intersections (rings, arms, 2) of the rays of a pupil on the axis with a surface, in its vertex frame."""
    surface = lens.surfaces[at]
    start = Rays.create(
        x_mm=pupil.pupil_x[0, 0],
        y_mm=pupil.pupil_y[0, 0],
        z_mm=float(lens.surfaces[0].position_mm[2]) - 1.0,
        direction=np.array([0.0, 0.0, 1.0]),
        wavelength_nm=lens.design_wavelength_nm,
    )
    point = trace_path(lens, start)[at + 1]
    return np.asarray((point - surface.position_mm) @ surface.rotation)[..., :2]
