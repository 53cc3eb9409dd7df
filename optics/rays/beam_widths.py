"""Beam radii of given fields on every surface, by real marginal rays."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from optics.arrays import NUMPY, FloatArray
from optics.frames import star_direction
from optics.lens.system import LensSystem
from optics.rays.aim import without_apertures
from optics.rays.beam import beam_outlines
from optics.rays.program import compile_lens
from optics.rays.trace import OK, Rays, trace_program
from optics.units import DEG_RAD

ARMS = 50
"""Marginal rays of a beam, two of them along y; a round rim passes the polygon of them by 1 - cos(pi / 50), 0.2 %."""


@dataclass(frozen=True, slots=True, kw_only=True)
class BeamWidths:
    """Widths of beams."""

    # (surfaces,) Greatest distance of a marginal ray from the vertex, in the vertex plane; NaN where none arrives
    semi_diameter_mm: FloatArray
    dark: tuple[int, ...]  # Fields from which no light passes the stop
    lost: int  # Marginal rays that miss a surface or are totally reflected, and all of them
    rays: int


def beam_widths(
    lens: LensSystem, field_deg: ArrayLike, wavelength_nm: ArrayLike, vignetting: ArrayLike | None = None
) -> BeamWidths:
    """Distances from the vertices to which the light of some fields reaches.

    Shapes: ``field_deg`` (f, 2), ``wavelength_nm`` (w,), ``vignetting`` (f, 5).
    """
    slope = np.tan(np.asarray(field_deg, float) * DEG_RAD)
    direction = np.concatenate([slope, np.ones((len(slope), 1))], axis=1)
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    wave = np.asarray(wavelength_nm, float)
    outline = beam_outlines(lens, star_direction(direction), wave, arms=ARMS)
    middle = outline.centre_mm[..., None]
    edge = np.stack([outline.x_mm, outline.y_mm], axis=2) - middle
    if vignetting is not None:
        factors = np.asarray(vignetting, float)[:, None, :, None]
        half = np.abs(edge).max(axis=-1, keepdims=True)
        edge = factors[:, :, 0:2] * half + (1.0 - factors[:, :, 2:4]) * edge
        c, s = np.cos(factors[:, :, 4] * DEG_RAD), np.sin(factors[:, :, 4] * DEG_RAD)
        edge = np.stack([c * edge[:, :, 0] - s * edge[:, :, 1], s * edge[:, :, 0] + c * edge[:, :, 1]], axis=2)
    at = np.nonzero(outline.lit)
    x, y = np.moveaxis((middle + edge)[at], 1, 0)
    widest = np.full(len(lens.surfaces) + 1, np.nan)  # the last one is the image plane

    def visit(number: int, rays: Rays) -> None:
        height = np.hypot(rays.x, rays.y)[rays.status == OK]
        widest[number] = height.max() if height.size else np.nan

    program, theta = compile_lens(lens)
    rays = Rays.create(
        x_mm=x, y_mm=y, z_mm=outline.z_mm, direction=direction[at[0], None], wavelength_nm=wave[at[1], None]
    )
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        out = trace_program(without_apertures(program), NUMPY.parameters(theta), rays, NUMPY, visit)
    return BeamWidths(
        semi_diameter_mm=widest[:-1],
        dark=tuple(int(i) for i in np.flatnonzero(~outline.lit.any(axis=1))),
        lost=int((out.status != OK).sum()),
        rays=out.status.size,
    )
