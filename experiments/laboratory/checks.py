"""What is refused before long work: target points that the camera cannot see."""

from __future__ import annotations

import math

import numpy as np

from experiments.laboratory.bench import Bench
from experiments.laboratory.instrument import Instrument
from experiments.laboratory.ray_prediction import expected_spots
from optics.arrays import FloatArray
from optics.errors import DomainError
from optics.frames import field_angles_deg
from optics.rays.spots import best_focus_shift_mm

__all__ = ["check_light"]


RADII = 4.0
"""Least width of a window in RMS radii of the spot."""


def check_light(bench: Bench, instrument: Instrument, direction: FloatArray) -> None:
    """Refuse a target whose light does not reach the detector, or not the window around its image.

    Parameters
    ----------
    bench, instrument
        The laboratory.
    direction : (p, j, 3)
        Target points.

    Raises
    ------
    DomainError
        Rays lost, or a spot wider than the window.
    ConvergenceError
        If no ray of any point gets through the lens.
    """
    position, radius_px, _ = expected_spots(bench, instrument, direction)
    dark = ~np.isfinite(position).all(axis=(2, 3))
    if dark.any():
        raise DomainError(
            f"no light of {int(dark.sum())} of {dark.size} target points gets through lens "
            f"{instrument.camera.lens.name!r}; look at its clear apertures or raise target.edge_px"
        )
    widest = float(radius_px.max())
    if RADII * widest > bench.window_px:
        window = 2 * math.ceil((RADII * widest - 1.0) / 2.0) + 1
        field_x, field_y = field_angles_deg(direction.reshape(-1, 3))
        waves = [band.centre_nm for band in bench.filters]
        best = best_focus_shift_mm(instrument.camera.lens, field_x, field_y, waves)
        raise DomainError(
            f"the image of a target point has an RMS radius of {widest:.1f} px, for which window_px = "
            f"{bench.window_px} is too small (at least four RMS radii); best focus for these filters is at "
            f"instrument.defocus_mm = {best:.3f} mm (it is {instrument.config.defocus_mm:g} mm), or set "
            f"window_px = {window}"
        )
