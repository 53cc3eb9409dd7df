"""A measured lens from the distortion, PSF and photometry of a camera in frames of stars."""

from __future__ import annotations

import numpy as np

from calib.cameras.base import CameraModel
from calib.cameras.fit import as_brown_conrady
from calib.photometry.spectral_response import WAVELENGTHS_NM, aperture_and_transmission, fit_response
from calib.photometry.zero_point import PhotometricSolution
from calib.psf.chromatic_psf import PSF_WAVES_NM, mixture_table
from calib.psf.gaussian_mixture import MixturePsf
from optics.arrays import FloatArray
from optics.lens.measured import MeasuredLens
from optics.response import Response

VIGNETTING_NODES = 9
REFERENCE_NM = 600.0
FIELD_MARGIN = 1.05
"""Radius of the measured field over half of the diagonal."""
POWERS = {"q1_per_mm2": 2, "q2_per_mm4": 4, "q3_per_mm6": 6, "p1_per_mm": 1, "p2_per_mm": 1}


def lens_from_stars(
    camera: CameraModel,
    psf: MixturePsf,
    light: PhotometricSolution,
    *,
    pitch_mm: float,
    exposure_s: float,
    efficiency: FloatArray,
    aperture_mm: float | None = None,
    name: str,
    source: str,
    date: str,
) -> tuple[MeasuredLens, FloatArray]:
    """Lens of a camera, and the colour terms (k,) [mag] of its response at the knots.

    Frames of stars determine angles per pixel and electrons per exposure only: pixel pitch, exposure time and
    ``efficiency`` (w,) at `calib.photometry.spectral_response.WAVELENGTHS_NM` are stated. The default aperture is the
    smallest for a transmission below 1.
    """
    response = fit_response(light.colour_mag, light.colour_error_mag, efficiency)
    aperture, transmission = aperture_and_transmission(
        light.above_mag, response, efficiency, exposure_s=exposure_s, aperture_mm=aperture_mm
    )
    model = as_brown_conrady(camera)
    scale = pitch_mm / model.geometry.pixel_pitch_mm
    focal_mm = model.value("focal_length_mm") * scale
    half_mm = 0.5 * pitch_mm * float(np.hypot(*psf.size_px))
    radius = np.linspace(0.0, 1.0, VIGNETTING_NODES)
    curve = Response(
        name=f"transmission of {name}",
        source=source,
        wavelength_nm=WAVELENGTHS_NM,
        value=np.clip(transmission, 0.0, 1.0),
    )
    lens = MeasuredLens(
        name=name,
        source=source,
        date=date,
        focal_length_mm=focal_mm,
        principal_point_mm=np.array([model.value("x0_px"), model.value("y0_px")]) * pitch_mm,
        distortion=np.array([model.value(key) / scale**power for key, power in POWERS.items()]),
        colour_nm=np.array(PSF_WAVES_NM),
        colour_scale=np.ones(len(PSF_WAVES_NM)),
        colour_shift_mm=np.zeros((len(PSF_WAVES_NM), 2)),
        psf=mixture_table(psf, pitch_mm, response.relative),
        includes_charge_diffusion=True,
        vignetting_mm=radius * half_mm,
        relative_light=10.0 ** (-0.4 * light.vignetting_at(radius**2)),
        aperture_mm=aperture,
        transmission=curve,
        reference_wavelength_nm=REFERENCE_NM,
        max_field_deg=float(np.degrees(np.arctan(FIELD_MARGIN * half_mm / focal_mm))),
    )
    return lens, response.colour_mag
