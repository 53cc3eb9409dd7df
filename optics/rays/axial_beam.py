"""Check that light on the axis passes a lens."""

from __future__ import annotations

import math

import numpy as np

from optics.arrays import NUMPY
from optics.errors import DomainError
from optics.lens.system import LensSystem
from optics.rays.aim import without_apertures
from optics.rays.paraxial import paraxial
from optics.rays.program import compile_lens
from optics.rays.trace import OK, STATUS_NAMES, Rays, trace_program

HEIGHTS = 64
FAN = 0.95
"""Part of the pupil's radius from which every ray on the axis has to reach the image plane."""


def check_axial_beam(lens: LensSystem) -> None:
    """Refuse a centred lens that loses axial rays other than at apertures: a surface beyond its valid radius."""
    try:
        first = paraxial(lens)
    except DomainError:  # tilted or afocal
        return
    pupil_z_mm, radius_mm = first.entrance_pupil_z_mm, first.entrance_pupil_radius_mm
    if not (math.isfinite(pupil_z_mm) and math.isfinite(radius_mm)):
        return
    program, theta = compile_lens(lens)
    height = np.linspace(0.0, FAN, HEIGHTS) * radius_mm
    rays = Rays.create(
        x_mm=height, y_mm=0.0, z_mm=pupil_z_mm, direction=[0.0, 0.0, 1.0], wavelength_nm=lens.design_wavelength_nm
    )
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        out = trace_program(without_apertures(program), NUMPY.parameters(theta), rays, NUMPY)
    bad = out.status != OK
    if bad.any():
        at = int(np.argmax(bad))
        what = lens.label(int(out.failed_at[at]))
        raise DomainError(
            f"lens {lens.name!r}: rays on the axis from {height[at]:.4g} mm of the pupil's {radius_mm:.4g} mm on are "
            f"lost at {what} ({STATUS_NAMES[int(out.status[at])]}); check its shape, or close the stop"
        )
