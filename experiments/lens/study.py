"""Everything the page of a lens tells, computed once; what a lens does not have is told by its reason."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from optics.arrays import FloatArray
from optics.errors import StarbenchError
from optics.lens_file import LensFile
from optics.rays.chief import chief_ray_points
from optics.rays.paraxial import ParaxialLens, axial_paraxial
from optics.rays.performance import LensPerformance, lens_performance, white_focus
from optics.rays.spots import Spots, trace_spots
from optics.waves.image_quality import transfer_function
from optics.waves.pupil_field import trace_pupil

__all__ = ["Study", "study"]

FIELD_SHARES = (0.0, 0.35, 0.5, 0.7, 0.85, 1.0)
SHOWN = (0, 3, 5)
"""Fields of spots and MTF among these."""
FREQUENCIES = 41
PUPIL_ORDER = (16, 48)
"""Rays whose phase a polynomial of the twelfth degree follows."""
BAND_SHARES = (0.85, 1.0, 1.2)
"""Wavelengths over the design wavelength, where the file states none or one."""


@dataclass(frozen=True, slots=True)
class Mtf:
    """Modulation over spatial frequency (f) [1/mm] for the shown fields: along the field (tangential), across it."""

    frequency: FloatArray
    geometric: FloatArray
    diffraction: FloatArray | None
    note: str


@dataclass(frozen=True, slots=True)
class Study:
    """A lens as its page shows it; ``missing`` holds, by section, why something is not shown.

    ``focus`` is the field curvature: the best focus of each wavelength along and across the field [mm], (f, 2).
    """

    shown: str
    file: LensFile
    wavelength_nm: FloatArray
    weight: FloatArray
    field_deg: FloatArray
    first_order: ParaxialLens | None
    spots: Spots | None
    performance: LensPerformance | None
    chief_mm: FloatArray | None
    focus: FloatArray | None
    mtf: Mtf | None
    missing: dict[str, str]


def _waves(file: LensFile) -> tuple[FloatArray, FloatArray]:
    """Wavelengths of the page: those of the file, or three about the design wavelength within the glasses' range."""
    lens, defaults = file.lens, file.defaults
    if defaults is not None and defaults.wavelength_nm.size > 1 and float(defaults.wavelength_weight.sum()) > 0.0:
        used = defaults.wavelength_weight > 0.0
        return defaults.wavelength_nm[used], defaults.wavelength_weight[used]
    low, high = lens.wavelength_range_nm
    waves = np.clip(np.array(BAND_SHARES) * lens.design_wavelength_nm, low, high)
    return waves, np.ones(waves.size)


def _along_and_across(spots: Spots, weight: FloatArray) -> FloatArray:
    """Shift of the image plane that makes the white spot smallest along and across the field, (f, 2) [mm]."""
    rays = spots.rays
    light = spots.area_mm2 * (weight / weight.sum())[:, None]
    total = light.sum(axis=(1, 2), keepdims=True)
    share = np.divide(light, total, out=np.zeros_like(light), where=total > 0)
    shifts = []
    for height, component in ((rays.x, rays.dx), (rays.y, rays.dy)):
        y = np.where(rays.ok, height, 0.0)
        slope = np.where(rays.ok, component / np.where(rays.ok, rays.dz, 1.0), 0.0)
        dy = y - (share * y).sum(axis=(1, 2), keepdims=True)
        ds = slope - (share * slope).sum(axis=(1, 2), keepdims=True)
        with np.errstate(invalid="ignore", divide="ignore"):
            shifts.append(-(share * dy * ds).sum(axis=(1, 2)) / (share * ds * ds).sum(axis=(1, 2)))
    return np.stack(shifts, axis=-1)


def _mtf(lens: Any, spots: Spots, weight: FloatArray, fields: FloatArray, limit: float) -> Mtf:
    frequency = np.linspace(0.0, limit, FREQUENCIES)
    light = spots.area_mm2 * (weight / weight.sum())[:, None]
    geometric = np.zeros((len(SHOWN), 2, FREQUENCIES))
    for row, at in enumerate(SHOWN):
        total = light[at].sum()
        for axis, height in enumerate((spots.rays.x[at], spots.rays.y[at])):
            y = np.where(spots.rays.ok[at], height, 0.0)
            turns = np.exp(-2j * np.pi * frequency[:, None, None] * (y - (light[at] * y).sum() / total))
            geometric[row, axis] = np.abs((turns * light[at]).sum(axis=(1, 2)) / total)
    diffraction, note = None, ""
    try:
        chosen = fields[list(SHOWN)], np.zeros(len(SHOWN)), [lens.design_wavelength_nm]
        pupil, zero = trace_pupil(lens, *chosen, order=PUPIL_ORDER), np.zeros_like(frequency)
        points = np.concatenate([np.stack([frequency, zero], -1), np.stack([zero, frequency], -1)])
        values = [transfer_function(pupil, points, at=(row, 0), size=128) for row in range(len(SHOWN))]
        diffraction = np.abs(np.array(values)).reshape(len(SHOWN), 2, FREQUENCIES)
    except StarbenchError as error:
        note = str(error)
    return Mtf(frequency, geometric, diffraction, note)


def study(file: LensFile, shown: str) -> Study:
    """Compute a page.

    Parameters
    ----------
    file : LensFile
        The lens.
    shown : str
        Its file, as the page names it.
    """
    lens = file.lens
    waves, weight = _waves(file)
    fields = np.array(FIELD_SHARES) * lens.max_field_deg
    missing: dict[str, str] = {}

    def tried(name: str, compute: Callable[[], Any]) -> Any:
        try:
            return compute()
        except StarbenchError as error:
            missing[name] = str(error).split("\n", maxsplit=1)[0]
            return None

    first = tried("first-order data", lambda: axial_paraxial(lens, lens.design_wavelength_nm))
    zero = np.zeros_like(fields)
    spots = tried("spots", lambda: trace_spots(lens, fields, zero, waves))
    performance = None
    if spots is not None:
        performance = tried("distortion", lambda: lens_performance(lens, fields, waves, weight, spots=spots))
    chief = tried("lateral colour", lambda: chief_ray_points(lens, fields[:, None], 0.0, waves[None, :])[0])
    focus = mtf = None
    if spots is not None:
        focus = _along_and_across(spots, weight)
        f_number = abs(first.f_number) if first is not None and np.isfinite(first.f_number) else 4.0
        limit = min(1e6 / (lens.design_wavelength_nm * f_number), 200.0)
        mtf = tried("MTF", lambda: _mtf(lens, spots, weight, fields, limit))
    return Study(shown, file, waves, weight, fields, first, spots, performance, chief, focus, mtf, missing)


def white_rms_mm(made: Study) -> FloatArray | None:
    """RMS radius of the spot of all wavelengths, (f,) [mm]."""
    if made.spots is None:
        return None
    return np.asarray(white_focus(made.spots, made.weight / made.weight.sum()).rms_mm())
