"""Marginal rays: beam radii on every surface, and a check that light on the axis passes a lens."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from optics.arrays import NUMPY, FloatArray
from optics.errors import DomainError
from optics.frames import star_direction
from optics.lens.system import LensSystem
from optics.rays.paraxial import paraxial
from optics.rays.program import compile_lens
from optics.rays.ray_aiming import without_apertures
from optics.rays.trace import OK, STATUS_NAMES, Rays, Visitor, trace_program
from optics.rays.vignetted_pupil import pupil_outlines
from optics.units import DEG_RAD

ARMS = 50
"""Marginal rays of a beam, two of them along y; a round rim passes the polygon of them by 1 - cos(pi / 50), 0.2 %."""
HEIGHTS, FAN = 64, 0.95
"""Rays on the axis, and the fraction of the pupil radius from which they have to reach the image plane."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SemiDiameters:
    """Radii of beams on the surfaces of a lens."""

    # (surfaces,) Greatest distance of a marginal ray from the vertex, in the vertex plane; NaN where none arrives
    semi_diameter_mm: FloatArray
    dark: tuple[int, ...]  # Fields from which no light passes the stop
    lost: int  # Marginal rays that miss a surface or are totally reflected
    rays: int  # All marginal rays


def _trace_without_apertures(lens: LensSystem, rays: Rays, visit: Visitor | None = None) -> Rays:
    program, theta = compile_lens(lens)
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        return trace_program(without_apertures(program), NUMPY.parameters(theta), rays, NUMPY, visit)


def beam_semi_diameters(
    lens: LensSystem, field_deg: ArrayLike, wavelength_nm: ArrayLike, vignetting: ArrayLike | None = None
) -> SemiDiameters:
    """Distances from the vertices to which the light of fields (f, 2) at wavelengths (w,) reaches.

    ``vignetting`` (f, 5): factors of a lens file that decentre (x, y), compress (x, y) and rotate [deg] the pupil.
    """
    slope = np.tan(np.asarray(field_deg, float) * DEG_RAD)
    direction = np.concatenate([slope, np.ones((len(slope), 1))], axis=1)
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    wave = np.asarray(wavelength_nm, float)
    outline = pupil_outlines(lens, star_direction(direction), wave, arms=ARMS)
    centre = outline.centre_mm[..., None]
    rim = np.stack([outline.x_mm, outline.y_mm], axis=2) - centre
    if vignetting is not None:
        factors = np.asarray(vignetting, float)[:, None, :, None]
        half = np.abs(rim).max(axis=-1, keepdims=True)
        rim = factors[:, :, 0:2] * half + (1.0 - factors[:, :, 2:4]) * rim
        c, s = np.cos(factors[:, :, 4] * DEG_RAD), np.sin(factors[:, :, 4] * DEG_RAD)
        rim = np.stack([c * rim[:, :, 0] - s * rim[:, :, 1], s * rim[:, :, 0] + c * rim[:, :, 1]], axis=2)
    lit = np.nonzero(outline.lit)
    x, y = np.moveaxis((centre + rim)[lit], 1, 0)
    semi_diameter = np.full(len(lens.surfaces) + 1, np.nan)  # the last one is the image plane

    def visit(number: int, rays: Rays) -> None:
        height = np.hypot(rays.x, rays.y)[rays.status == OK]
        semi_diameter[number] = height.max() if height.size else np.nan

    rays = Rays.create(
        x_mm=x, y_mm=y, z_mm=outline.z_mm, direction=direction[lit[0], None], wavelength_nm=wave[lit[1], None]
    )
    out = _trace_without_apertures(lens, rays, visit)
    return SemiDiameters(
        semi_diameter_mm=semi_diameter[:-1],
        dark=tuple(int(i) for i in np.flatnonzero(~outline.lit.any(axis=1))),
        lost=int((out.status != OK).sum()),
        rays=out.status.size,
    )


def check_axial_rays(lens: LensSystem) -> None:
    """Refuse a centred lens that loses axial rays other than at apertures: a surface beyond its valid radius."""
    try:
        first_order = paraxial(lens)
    except DomainError:  # tilted or afocal
        return
    pupil_z_mm, radius_mm = first_order.entrance_pupil_z_mm, first_order.entrance_pupil_radius_mm
    if not (math.isfinite(pupil_z_mm) and math.isfinite(radius_mm)):
        return
    height = np.linspace(0.0, FAN, HEIGHTS) * radius_mm
    rays = Rays.create(
        x_mm=height, y_mm=0.0, z_mm=pupil_z_mm, direction=[0.0, 0.0, 1.0], wavelength_nm=lens.design_wavelength_nm
    )
    out = _trace_without_apertures(lens, rays)
    failed = out.status != OK
    if failed.any():
        at = int(np.argmax(failed))
        raise DomainError(
            f"lens {lens.name!r}: rays on the axis from {height[at]:.4g} mm of the pupil's {radius_mm:.4g} mm on are "
            f"lost at {lens.label(int(out.failed_at[at]))} ({STATUS_NAMES[int(out.status[at])]}); check its shape, or "
            "close the stop"
        )
