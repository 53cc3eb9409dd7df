"""Study of a lens file: first order, spots, distortion, MTF, wavefronts and diffraction images over the field."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from optics.arrays import FloatArray
from optics.errors import DomainError, StarbenchError
from optics.lens.system import LensSystem
from optics.lens_file import LensFile
from optics.rays.best_focus import focus_by_axis, white_focus
from optics.rays.chief_ray import chief_ray_points
from optics.rays.paraxial import ParaxialLens, axial_paraxial
from optics.rays.performance import LensPerformance, lens_performance
from optics.rays.spots import Spots, trace_spots
from optics.waves.image_quality import perfect_peak, strehl, transfer_function
from optics.waves.pupil_field import PupilField, needed_order, trace_pupil
from optics.waves.wavefront import Wavefront, wavefront

FIELD_FRACTIONS = (0.0, 0.35, 0.5, 0.7, 0.85, 1.0)
SHOWN = (0, 3, 5)
"""Fields of spots and MTF among these."""
FREQUENCIES = 41
PUPIL_ORDER = (16, 48)
"""Rays whose phase a polynomial of the twelfth degree follows."""
ZERNIKES = 15
"""Noll coefficients, up to the fourth order."""
MOST_RAYS = 6000
"""Rays of a pupil that a page waits for."""
FOCUS_STEPS, DEPTHS = 11, 3.0
"""Image planes on both sides, in units of the depth of focus 2 wavelength F^2 (a quarter wave at the rim)."""
SIDE, CIRCLES = 121, 33
COARSE, FINE = (5.0, 0.25), (0.25, 0.05)
"""Half side and step of grids that look for the brightest point, in wavelengths over the numerical aperture."""
AIRY_RADII, SPOT_RADII = 3.0, 2.5
"""Half widths of images, in Airy radii and in RMS radii of the largest spot."""
BAND_FRACTIONS = (0.85, 1.0, 1.2)
"""Wavelengths over the design wavelength, where the file states none or one."""


@dataclass(frozen=True, slots=True)
class Mtf:
    """Modulation over spatial frequency (f) [1/mm] for the shown fields: along the field (tangential), across it.

    ``limit`` is that of the same pupils, as wide and as vignetted, without wavefront error.
    """

    frequency: FloatArray
    geometric: FloatArray
    diffraction: FloatArray | None
    limit: FloatArray | None
    note: str


@dataclass(frozen=True, slots=True)
class Images:
    """Diffraction images at the design wavelength for the shown fields."""

    strehl: tuple[float, ...]  # Strehl ratios in the plane of the file
    strehl_through_focus: FloatArray  # (fields, z) The same at `Waves.focus_mm`
    # (fields, side, side) Images over the brightest point of the same pupil without wavefront error
    intensity: FloatArray
    encircled: FloatArray  # (fields, r) Fraction of the light within circles of `Waves.radius_mm`


@dataclass(frozen=True, slots=True)
class Waves:
    """Wavefronts at the design wavelength for the shown fields."""

    wavefront: tuple[Wavefront, ...]  # Wavefront errors about the reference point of the smallest
    zernike_waves: FloatArray  # (fields, ZERNIKES) Their Noll coefficients, in wavelengths
    focus_mm: FloatArray  # (z,) Shifts of the image plane
    half_mm: float  # Half the side of images, about the mean of the light
    radius_mm: FloatArray  # (r,) Circles about it
    images: Images | None  # None where images need too many rays, as ``note`` says
    note: str


@dataclass(frozen=True, slots=True)
class Study:
    """Results of a lens for its page; ``missing`` states by section why something is not shown.

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
    waves: Waves | None
    missing: dict[str, str]


def _waves(file: LensFile) -> tuple[FloatArray, FloatArray]:
    """Wavelengths of the page: from the file, or three about the design wavelength within the glasses' range."""
    lens, defaults = file.lens, file.defaults
    if defaults is not None and defaults.wavelength_nm.size > 1 and float(defaults.wavelength_weight.sum()) > 0.0:
        used = defaults.wavelength_weight > 0.0
        return defaults.wavelength_nm[used], defaults.wavelength_weight[used]
    low, high = lens.wavelength_range_nm
    waves = np.clip(np.array(BAND_FRACTIONS) * lens.design_wavelength_nm, low, high)
    return waves, np.ones(waves.size)


def _along_and_across(spots: Spots, weight: FloatArray) -> FloatArray:
    """Shift of the image plane that makes the white spot smallest along and across the field, (f, 2) [mm]."""
    _, axes = focus_by_axis(spots, spots.area_mm2 * (weight / weight.sum())[:, None])
    return np.stack([axis.best_mm for axis in axes], axis=-1)


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
    diffraction: FloatArray | None = None
    perfect: FloatArray | None = None
    note = ""
    try:
        chosen = fields[list(SHOWN)], np.zeros(len(SHOWN)), [lens.design_wavelength_nm]
        pupil, zero = trace_pupil(lens, *chosen, order=PUPIL_ORDER), np.zeros_like(frequency)
        points = np.concatenate([np.stack([frequency, zero], -1), np.stack([zero, frequency], -1)])

        def modulation(of: PupilField) -> FloatArray:
            values = [transfer_function(of, points, at=(row, 0)) for row in range(len(SHOWN))]
            return np.asarray(np.abs(np.array(values)).reshape(len(SHOWN), 2, FREQUENCIES))

        diffraction, perfect = modulation(pupil), modulation(pupil.with_path(-pupil.path_to(*pupil.mean_mm)))
    except StarbenchError as error:
        note = str(error)
    return Mtf(frequency, geometric, diffraction, perfect, note)


def _diffraction(lens: LensSystem, fields: FloatArray, rms_mm: FloatArray, f_number: float) -> Waves:
    """Everything by waves, at the design wavelength."""
    chosen = fields[list(SHOWN)], np.zeros(len(SHOWN)), [lens.design_wavelength_nm]
    pupil, all_fields = trace_pupil(lens, *chosen, order=PUPIL_ORDER), range(len(SHOWN))
    errors = tuple(wavefront(pupil, at=(row, 0)) for row in all_fields)
    wave_mm = 1e-6 * lens.design_wavelength_nm
    focus_mm = DEPTHS * 2.0 * wave_mm * f_number**2 * np.linspace(-1.0, 1.0, FOCUS_STEPS)
    half_mm = AIRY_RADII * 1.22 * wave_mm * f_number + SPOT_RADII * float(np.nanmax(rms_mm[list(SHOWN)]))
    radius_mm, images, note = half_mm * np.linspace(0.0, 1.0, CIRCLES), None, ""
    try:
        images = _images(lens, chosen, pupil, focus_mm, radius_mm)
    except StarbenchError as error:
        note = str(error)
    return Waves(
        wavefront=errors,
        zernike_waves=np.array([error.zernike_nm(ZERNIKES) / error.wavelength_nm for error in errors]),
        focus_mm=focus_mm,
        half_mm=half_mm,
        radius_mm=radius_mm,
        images=images,
        note=note,
    )


def _images(
    lens: LensSystem,
    chosen: tuple[FloatArray, FloatArray, list[float]],
    pupil: PupilField,
    focus_mm: FloatArray,
    radius_mm: FloatArray,
) -> Images:
    """Images of the shown fields; ``pupil`` is a coarse one that gives the number of rays that they need."""
    half_mm = float(radius_mm[-1])
    peaks_mm = (COARSE[0] + 2.0 * FINE[0]) * _airy_unit_mm(pupil)
    needs = [needed_order(pupil.shifted(float(z)), peaks_mm) for z in focus_mm[[0, -1]]]
    order = np.max([needed_order(pupil, half_mm), *needs], axis=0)
    if order.prod() > MOST_RAYS:
        raise DomainError(
            f"they need {order[0]} x {order[1]} rays, at most {MOST_RAYS} are traced; geometric spots suffice for "
            "this lens"
        )
    fine, all_fields = trace_pupil(lens, *chosen, order=(int(order[0]), int(order[1]))), range(len(SHOWN))
    grid = half_mm * np.linspace(-1.0, 1.0, SIDE)
    means = [[float(v[row, 0]) for v in fine.mean_mm] for row in all_fields]
    light = np.array([fine.intensity(x + grid, y + grid, at=(row, 0)) for row, (x, y) in enumerate(means)])
    perfect = np.array([perfect_peak(fine, at=(row, 0)) for row in all_fields])
    through = np.array([[_highest(fine.shifted(float(z)), row) for z in focus_mm] for row in all_fields])
    return Images(
        strehl=tuple(strehl(fine, at=(row, 0)) for row in all_fields),
        strehl_through_focus=through / perfect[:, None],
        intensity=light / perfect[:, None, None],
        encircled=_within(light, grid, radius_mm),
    )


def _airy_unit_mm(pupil: PupilField) -> float:
    """Wavelength over the sine of the steepest ray [mm], of the field where it is largest."""
    steepest = np.hypot(pupil.l, pupil.m).max(axis=(1, 2, 3))
    return 1e-6 * float(pupil.wavelength_nm[0]) / float(steepest.min())


def _highest(pupil: PupilField, row: int) -> float:
    """Intensity of the brightest point, to a percent: the best of a fine grid about the best of a coarse one."""
    unit_mm = _airy_unit_mm(pupil)
    x, y = (float(v[row, 0]) for v in pupil.mean_mm)
    image = np.zeros((1, 1))
    for reach, step in (COARSE, FINE):
        grid = unit_mm * np.arange(-reach, reach + 0.5 * step, step)
        image = pupil.intensity(x + grid, y + grid, at=(row, 0))
        at_y, at_x = np.unravel_index(int(image.argmax()), image.shape)
        x, y = x + float(grid[at_x]), y + float(grid[at_y])
    return float(image.max())


def _within(light: FloatArray, grid: FloatArray, radius_mm: FloatArray) -> FloatArray:
    """Light within circles (fields, r) about the middle of images, whose cells at the rim count in part."""
    step = float(grid[1] - grid[0])
    part = np.clip((radius_mm[:, None, None] - np.hypot(grid, grid[:, None])) / step + 0.5, 0.0, 1.0)
    part[0] = 0.0
    return np.asarray(np.einsum("fyx,ryx->fr", light, part)) * step**2


def study(file: LensFile, shown: str) -> Study:
    """Study a lens with the defaults of its file; ``shown`` is its name on the page."""
    lens = file.lens
    waves, weight = _waves(file)
    fields = np.array(FIELD_FRACTIONS) * lens.max_field_deg
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
    focus = mtf = by_waves = None
    if spots is not None:
        focus = _along_and_across(spots, weight)
        f_number = abs(first.f_number) if first is not None and np.isfinite(first.f_number) else 4.0
        limit = min(1e6 / (lens.design_wavelength_nm * f_number), 200.0)
        mtf = tried("MTF", lambda: _mtf(lens, spots, weight, fields, limit))
        rms = np.asarray(white_focus(spots, weight / weight.sum()).rms_mm())
        by_waves = tried("images by diffraction", lambda: _diffraction(lens, fields, rms, f_number))
    return Study(shown, file, waves, weight, fields, first, spots, performance, chief, focus, mtf, by_waves, missing)


def airy_radius_mm(result: Study) -> float:
    """First dark ring, 1.22 wavelength F, of a perfect lens of this F-number; not finite for a lens without one."""
    f_number = np.nan if result.first_order is None else abs(result.first_order.f_number)
    return 1.22e-6 * result.file.lens.design_wavelength_nm * f_number


def white_rms_mm(result: Study) -> FloatArray | None:
    """RMS radius of the spot of all wavelengths, (f,) [mm]."""
    if result.spots is None:
        return None
    return np.asarray(white_focus(result.spots, result.weight / result.weight.sum()).rms_mm())
