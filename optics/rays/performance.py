"""Lens performance from one trace: scale, distortion, spots through focus, colour, vignetting over field and band.

Fields lie along +X of cam, so that positions are x in the image plane; for lenses of revolution this is the whole
field.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from optics.arrays import FloatArray
from optics.errors import DomainError
from optics.lens.system import LensSystem
from optics.rays.best_focus import FocusCurve, focus_by_axis, white_focus
from optics.rays.chief_ray import chief_ray_points
from optics.rays.distortion import plate_scale_mm
from optics.rays.paraxial import axial_paraxial
from optics.rays.spots import Spots, trace_spots, weighted_mean
from optics.records import freeze_all
from optics.units import DEG_RAD


@dataclass(frozen=True, slots=True, kw_only=True)
class LensPerformance:
    """Image quality of a lens over f fields and w wavelengths."""

    field_deg: FloatArray  # (f,) Field angles, the first 0
    wavelength_nm: FloatArray  # (w,)
    spectrum: FloatArray  # (w,) Fraction of the light at each wavelength
    focal_length_mm: float  # Paraxial, at the design wavelength
    f_number: float
    plate_scale_mm: float  # Focal length by chief rays about the axis (`optics.rays.distortion`), design wavelength
    chief_mm: FloatArray  # (f,) Chief-ray height from that of field 0, design wavelength
    bundle_mm: FloatArray  # (f, w) Mean of the ray bundle
    # (f, w) Cross-section of the beam that arrives: the flux of a star is that times its irradiance
    area_mm2: FloatArray
    white: FocusCurve  # (f,): all wavelengths about their common mean
    single: FocusCurve  # (f, w): each wavelength about its own mean

    def __post_init__(self) -> None:
        sizes: dict[str, int] = {}
        freeze_all(self, field_deg=("f",), wavelength_nm=("w",), spectrum=("w",), chief_mm=("f",), sizes=sizes)
        freeze_all(self, bundle_mm=("f", "w"), area_mm2=("f", "w"), finite=False, sizes=sizes)

    @property
    def distortion(self) -> FloatArray:
        """Radial distortion of the chief ray, relative to f tan(field), (f,); 0 on the axis."""
        ideal = self.plate_scale_mm * np.tan(self.field_deg * DEG_RAD)
        return np.divide(self.chief_mm - ideal, ideal, out=np.zeros_like(ideal), where=ideal > 0)

    @property
    def white_mm(self) -> FloatArray:
        """Mean of all light, (f,) [mm]."""
        return weighted_mean(self.bundle_mm, self.spectrum * np.nan_to_num(self.area_mm2))

    @property
    def lateral_colour_mm(self) -> FloatArray:
        """Bundle mean of each wavelength minus that of all light, (f, w) [mm]."""
        return self.bundle_mm - self.white_mm[:, None]

    @property
    def axial_colour_mm(self) -> FloatArray:
        """Best focus of each wavelength on the axis, from the image plane, (w,) [mm]."""
        return np.asarray(self.single.best_mm[0])

    @property
    def vignetting(self) -> FloatArray:
        """Light of a star relative to the axis, (f,): loss at apertures, and the foreshortened pupil."""
        light = (self.spectrum * np.nan_to_num(self.area_mm2)).sum(1)
        return np.asarray(light / light[0])

    @property
    def best_focus_mm(self) -> float:
        """Image-plane shift of the smallest mean square of the white spots, all fields with equal weights [mm]."""
        return float(self.white.mean.best_mm)

    def depth_of_focus_mm(self, blur_mm: float) -> float:
        """Half the depth of focus: the defocus whose geometric blur circle has the diameter ``blur_mm``, N times it."""
        return self.f_number * blur_mm


def lens_performance(
    lens: LensSystem,
    field_deg: ArrayLike,
    wavelength_nm: ArrayLike,
    spectrum: ArrayLike | None = None,
    *,
    spots: Spots | None = None,
) -> LensPerformance:
    """Trace a lens at fields (f,), the first 0, and wavelengths (w,).

    ``spectrum`` (w,): detected photons at each wavelength, in any unit; equal if left out. ``spots``: rays of these
    fields and wavelengths, if they are traced already.
    """
    field, wave = np.atleast_1d(np.asarray(field_deg, float)), np.atleast_1d(np.asarray(wavelength_nm, float))
    if field[0] != 0.0:
        raise DomainError(
            f"first field {field[0]:g} deg; distortion and vignetting are relative to field 0, which must come first"
        )
    light = np.ones(len(wave)) if spectrum is None else np.asarray(spectrum, float)
    light = light / light.sum()
    traced = trace_spots(lens, field, np.zeros_like(field), wave) if spots is None else spots
    first_order = axial_paraxial(lens, lens.design_wavelength_nm)
    chief, _ = chief_ray_points(lens, field, np.zeros_like(field), blocked="follow")
    (mean_x, _), (focus_x, focus_y) = focus_by_axis(traced, traced.area_mm2, (-1,))
    return LensPerformance(
        field_deg=field,
        wavelength_nm=wave,
        spectrum=light,
        focal_length_mm=first_order.efl_mm,
        f_number=first_order.f_number,
        plate_scale_mm=plate_scale_mm(lens),
        chief_mm=chief - chief[0],
        bundle_mm=mean_x,
        area_mm2=traced.area_mm2.sum(-1) * np.cos(field * DEG_RAD)[:, None],
        white=white_focus(traced, light),
        single=focus_x + focus_y,
    )
