"""Lenses without glass: an ideal lens of given focal length and aperture, and a measured lens."""

from __future__ import annotations

import math

import numpy as np

from optics.errors import DomainError
from optics.lens.measured import MeasuredLens
from optics.lens.shapes.plane import Plane
from optics.lens.shapes.thin_lens import ThinLens
from optics.lens.system import LensSystem, Surface
from optics.response import Response

FASTEST = 0.5
"""F-number below which no lens in air can be: the sine of a marginal ray."""


def ideal_lens(
    *,
    focal_length_mm: float,
    f_number: float,
    spot_um: float = 0.0,
    psf_fwhm_px: float = 0.0,
    transmission: float | Response = 1.0,
    wavelength_range_nm: tuple[float, float] = (200.0, 2500.0),
    design_wavelength_nm: float = 550.0,
    max_field_deg: float = 30.0,
    name: str = "",
) -> LensSystem:
    """A thin lens without aberrations: x = f tan(field), in focus for all fields and colours; its stop is its rim.

    Parameters
    ----------
    focal_length_mm : float
        In the surroundings of the lens, air or vacuum.
    f_number : float
        Focal length over the diameter of the stop.
    spot_um : float
        RMS radius of a Gaussian spot in place of aberrations; it blurs the diffraction image.
    psf_fwhm_px : float
        The same by its full width at half maximum, in pixels of the detector; only one of the two.
    transmission : float or Response
        On the axis.
    wavelength_range_nm : (float, float)
        Where a transmission that is a number holds.
    design_wavelength_nm, max_field_deg : float
        Wavelength of chief rays; half field.
    name : str
        What to call it; focal length and F-number if left out.

    Returns
    -------
    LensSystem
        A stop and a `ThinLens`; light falls with the cosine of the field angle, as the stop is seen obliquely.

    Raises
    ------
    DomainError
        A value out of range, by name.
    """
    for key, value, low in (
        ("focal_length_mm", focal_length_mm, 0.0),
        ("f_number", f_number, FASTEST),
        ("design_wavelength_nm", design_wavelength_nm, 0.0),
    ):
        if not (value > low and math.isfinite(value)):
            raise DomainError(f"ideal lens: {key} = {value}; it must be above {low:g} and finite")
    for key, value in (("spot_um", spot_um), ("psf_fwhm_px", psf_fwhm_px)):
        if not (value >= 0.0 and math.isfinite(value)):
            raise DomainError(f"ideal lens: {key} = {value}; it must not be negative")
    if spot_um > 0.0 and psf_fwhm_px > 0.0:
        raise DomainError(f"ideal lens: spot_um = {spot_um:g} and psf_fwhm_px = {psf_fwhm_px:g}; give one of them")
    title = name or f"ideal lens {focal_length_mm:g} mm F/{f_number:g}"
    if not isinstance(transmission, Response):
        low, high = wavelength_range_nm
        transmission = Response(
            name=f"transmission of {title}",
            source="stated",
            wavelength_nm=np.array([low, high]),
            value=np.full(2, float(transmission)),
        )
    return _thin(
        title,
        "ideal thin lens",
        focal_length_mm,
        0.5 * focal_length_mm / f_number,
        transmission,
        design_wavelength_nm,
        max_field_deg,
        blur_um=spot_um / math.sqrt(2.0),
        blur_px=psf_fwhm_px / math.sqrt(8.0 * math.log(2.0)),
    )


def measured_lens(measured: MeasuredLens) -> LensSystem:
    """Lens known by measurement only (`LensSystem.measured`)."""
    return _thin(
        measured.name,
        f"{measured.source}, {measured.date}",
        measured.focal_length_mm,
        0.5 * measured.aperture_mm,
        measured.transmission,
        measured.reference_wavelength_nm,
        measured.max_field_deg,
        measured=measured,
    )


def _thin(
    name: str,
    source: str,
    focal_length_mm: float,
    radius_mm: float,
    throughput: Response,
    wavelength_nm: float,
    max_field_deg: float,
    *,
    blur_um: float = 0.0,
    blur_px: float = 0.0,
    measured: MeasuredLens | None = None,
) -> LensSystem:
    """A stop with a thin lens in it."""
    here = np.zeros(3)
    return LensSystem(
        name=name,
        source=source,
        surfaces=(
            Surface(shape=Plane(), position_mm=here, semi_diameter_mm=radius_mm, element="lens", is_stop=True),
            Surface(shape=ThinLens(focal_length_mm=focal_length_mm), position_mm=here, element="lens"),
        ),
        glasses={},
        image_position_mm=np.array([0.0, 0.0, focal_length_mm]),
        design_wavelength_nm=wavelength_nm,
        max_field_deg=max_field_deg,
        throughput=throughput,
        blur_um=blur_um,
        blur_px=blur_px,
        measured=measured,
    )
