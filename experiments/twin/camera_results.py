"""Measured properties of the camera: parameters, model order, photon transfer, colour term, residuals, truth."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from calib.calibration.frame_attitudes import camera_residuals
from calib.cameras.line_of_sight import line_of_sight_map
from calib.detector.sky_photon_transfer import SkyNoise
from calib.photometry.zero_point import COLOUR_KNOTS, PhotometricSolution
from experiments.harness.quantities import shown_unit
from experiments.harness.sections import col
from experiments.harness.summary import Measured, measured
from experiments.twin.compare import BRIGHT_MAG, CLIP_PX
from experiments.twin.hold_out import HeldOut
from experiments.twin.measure import CameraFit, Centroids
from experiments.twin.pipeline import MeasuredNight
from experiments.twin.synthetic import RenderedNight
from optics.arrays import FloatArray
from optics.units import RAD_ARCSEC

MIN_BRIGHT_STARS = 8
"""Bright stars below which the terms of their residual are NaN."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraNumbers:
    """Measured properties of the camera."""

    frames_solved: int = col("Frames solved")
    frames_given: int = col("Frames given")
    order: str = col("Camera model")
    focal_length_px: Measured = col("Focal length", "px")
    focal_length_mm: Measured = col("Focal length", "mm")
    field_width_deg: float = col("Field, width", "deg", ".3f")
    principal_offset_x_px: Measured = col("Principal point from the centre, columns", "px")
    principal_offset_y_px: Measured = col("Principal point from the centre, rows", "px")
    corner_distortion_px: float = col("Distortion at the corner", "px", ".3f")
    error_floor_px: float = col("Error per axis beyond the noise of centroids", "px", ".3f")
    psf_width_px: Measured = col("Width of the PSF's core, reference colour", "px")
    gain_e_per_dn: Measured = col("Gain", "e-/DN")
    read_noise_low_e: float = col("Read noise, black level lowest", "e-", ".2f")
    read_noise_high_e: float = col("Read noise, black level highest", "e-", ".2f")
    black_level_low_dn: float = col("Black level, lowest", "DN", ".1f")
    black_level_high_dn: float = col("Black level, highest", "DN", ".1f")
    dsnu_dn: Measured = col("DSNU", "DN")
    prnu_percent: Measured = col("PRNU", "percent")
    hot_pixels: int = col("Hot pixels")
    saturation_dn: float = col("Saturation", "DN", "g")
    zero_point_mag: Measured = col("Zero point: G of 1 e- per exposure", "mag")
    extinction_mag: Measured | None = col("Extinction per airmass", "mag", default=None)
    vignetting_mag: Measured = col("Vignetting at the corner", "mag")
    limiting_magnitude_mag: float = col("Half of the stars detected at 5 sigma, G", "mag", ".2f")
    latitude_deg: Measured | None = col("Latitude", "deg", default=None)
    longitude_deg: Measured | None = col("Longitude", "deg", default=None)
    refraction_arcsec: Measured | None = col("Refraction / tan z from the frames", "arcsec", default=None)


def camera_numbers(night: MeasuredNight, compared: HeldOut, limit_mag: float) -> CameraNumbers:
    """Properties of the camera measured from all frames."""
    fit = night.fit
    model, noise, photometry = fit.calibration.model, fit.noise, fit.photometry
    sigma = np.sqrt(np.diag(fit.calibration.covariance))

    def parameter(name: str, scale: float = 1.0) -> Measured:
        if name not in model.parameter_names:
            return Measured(value=float("nan"))
        index = model.parameter_names.index(name)
        return measured(model.parameters[index] * scale, sigma[index] * scale)

    geometry, focal = model.geometry, parameter("focal_length_mm", 1.0 / night.pitch_mm)
    edges = model.unproject(geometry.centre_px + np.array([[-0.5, 0.0], [0.5, 0.0]]) * geometry.width_px)
    corner_rays = model.unproject(geometry.corners_px)
    principal = geometry.centre_px + np.nan_to_num([parameter("x0_px").value, parameter("y0_px").value])
    distortion = geometry.corners_px - (principal + focal.value * corner_rays[:, :2] / corner_rays[:, 2:])
    width, width_error = compared.bias.corrected(fit).psf.central_width_px
    site, refraction = night.zenith, night.refraction_arcsec
    return CameraNumbers(
        frames_solved=len(night.rows),
        frames_given=len(night.solutions),
        order=fit.order,
        focal_length_px=focal,
        focal_length_mm=parameter("focal_length_mm"),
        field_width_deg=float(np.degrees(np.arccos(np.clip(edges[0] @ edges[1], -1, 1)))),
        principal_offset_x_px=parameter("x0_px"),
        principal_offset_y_px=parameter("y0_px"),
        corner_distortion_px=float(np.hypot(*distortion.T).mean()),
        error_floor_px=fit.floor_px,
        psf_width_px=measured(width, width_error),
        gain_e_per_dn=measured(noise.gain_e_per_dn, noise.gain_error_e_per_dn, noise.blocks),
        read_noise_low_e=noise.read_noise_e[0],
        read_noise_high_e=noise.read_noise_e[1],
        black_level_low_dn=noise.black_level_dn[0],
        black_level_high_dn=noise.black_level_dn[1],
        dsnu_dn=measured(noise.dsnu_dn, noise.dsnu_error_dn),
        prnu_percent=measured(100.0 * noise.prnu, 100.0 * noise.prnu_error),
        hot_pixels=int(night.prepared.hot.sum()),
        saturation_dn=night.saturation_dn,
        # before forward folding, which corrects the twin's flux for its PSF
        zero_point_mag=measured(photometry.above_mag, photometry.above_error_mag, photometry.frames, "mag"),
        extinction_mag=None
        if np.isnan(photometry.extinction_mag)
        else measured(photometry.extinction_mag, photometry.extinction_error_mag, photometry.frames),
        vignetting_mag=measured(photometry.vignetting_at(1.0), photometry.vignetting_error_at(1.0)),
        limiting_magnitude_mag=limit_mag,
        latitude_deg=None if site is None else measured(site.latitude_deg, site.error_deg),
        longitude_deg=None if site is None else measured(site.longitude_deg, site.error_deg),
        refraction_arcsec=None if refraction is None else measured(*refraction),
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class OrderNumbers:
    """A camera model, each frame predicted from the others."""

    name: str = col("Model", shown=False)
    parameters: int = col("Parameters")
    reduced_chi2: float = col("χ² per degree of freedom", "", ".4f")
    residual_px: float = col("Residual of predicted frames", "px", ".4f")


def order_numbers(night: MeasuredNight) -> list[OrderNumbers]:
    """Cross-validation of the camera models; empty for one frame."""
    return [
        OrderNumbers(
            name=order.order, parameters=order.parameters, reduced_chi2=order.mean_chi2, residual_px=order.residual_px
        )
        for order in night.orders
    ]


@dataclass(frozen=True, slots=True, kw_only=True)
class TransferPoint:
    """Photon transfer: blocks of similar background."""

    level_dn: float = col("Background", "DN", ".1f")
    variance_dn2: float = col("Variance of a pixel", "DN2", ".2f")
    fitted_variance_dn2: float = col("Photon transfer and pattern", "DN2", ".2f")


def transfer_points(noise: SkyNoise) -> list[TransferPoint]:
    """Measured variances and the fitted photon transfer."""
    return [
        TransferPoint(level_dn=float(m), variance_dn2=float(v), fitted_variance_dn2=float(noise.variance_dn2(m)))
        for m, v in zip(noise.levels_dn, noise.variances_dn2, strict=True)
    ]


@dataclass(frozen=True, slots=True, kw_only=True)
class ColourPoint:
    """Colour term at a knot."""

    colour: float = col("5040 K / T", "", ".2f")
    measured_mag: Measured = col("Excess brightness over G", "mag")
    twin_mag: float = col("The twin's response", "mag", ".3f")


def colour_points(photometry: PhotometricSolution, response_mag: FloatArray) -> list[ColourPoint]:
    """Measured colour term and ``response_mag``, that of the twin's spectral response."""
    return [
        ColourPoint(
            colour=float(COLOUR_KNOTS[k]),
            measured_mag=measured(photometry.colour_mag[k], photometry.colour_error_mag[k]),
            twin_mag=float(response_mag[k]),
        )
        for k in np.flatnonzero(np.isfinite(photometry.colour_mag))
    ]


@dataclass(frozen=True, slots=True, kw_only=True)
class ResidualTerm:
    """Contribution to the residual of bright stars."""

    name: str = col("Cause", shown=False)
    rms_px: float = col("RMS per axis", "px", ".4f")


def residual_terms(fit: CameraFit, compared: HeldOut, limit_mag: float) -> list[ResidualTerm]:
    """Contributions to the residuals of bright stars."""

    def rms(stars: Centroids) -> tuple[float, float]:
        residual = camera_residuals(stars.observations, fit.camera, fit.attitudes)
        bright = (stars.magnitude < limit_mag - BRIGHT_MAG) & (np.hypot(*residual.T) < CLIP_PX)
        if bright.sum() < MIN_BRIGHT_STARS:
            return float("nan"), float("nan")
        return float(np.sqrt((residual[bright] ** 2).mean())), float(np.sqrt((stars.noise_px[bright] ** 2).mean()))

    def difference_px(total: float, *terms: float) -> float:
        return float(np.sqrt(max(total**2 - sum(term**2 for term in terms), 0.0)))

    (gaussian, gaussian_noise), (fitted, fitted_noise) = rms(fit.gaussian), rms(fit.fitted)
    method = compared.bias.floor_px
    terms_px = {
        "Gaussian fits, total residual": gaussian,
        "Gaussian fits, noise of the centroids": gaussian_noise,
        "Gaussian fits, S-curve (no error of PSF fits)": difference_px(gaussian, fitted),
        "PSF fits, total residual": fitted,
        "PSF fits, noise of the centroids": fitted_noise,
        "PSF fits, error of the method (from rendered frames)": method,
        "PSF fits, remainder (seeing, catalogue, PSF)": difference_px(fitted, fitted_noise, method),
    }
    return [ResidualTerm(name=name, rms_px=rms_px) for name, rms_px in terms_px.items()]


@dataclass(frozen=True, slots=True, kw_only=True)
class TrueNumber:
    """A measured number and the truth of the rendering camera."""

    name: str = col("Number", shown=False)
    unit: str = col("Unit")
    measured: Measured = col("Measured", "{parameter}")
    true: float = col("Truth", "{parameter}", ".5g")
    pull: float = col("Difference", "sigma", ".2f")


def true_numbers(truth: RenderedNight, numbers: CameraNumbers, fit: CameraFit) -> list[TrueNumber]:
    """Measured camera against the camera that rendered the frames."""
    detector = truth.detector
    focal_mm = truth.camera.value("focal_length_mm")
    grid = truth.camera.geometry.grid_px(13)
    line_of_sight = line_of_sight_map(
        fit.camera, truth.camera.unproject(grid), grid, covariance=fit.calibration.covariance
    )
    error_px, predicted_px = (
        float(np.sqrt(np.nanmean(np.square(part)))) * focal_mm / detector.pixel_pitch_mm / RAD_ARCSEC
        for part in (line_of_sight.error_arcsec, line_of_sight.predicted_sigma_arcsec)
    )
    rows = [
        ("map of the camera, RMS error", "px", measured(error_px, predicted_px), 0.0),
        ("gain", "e-/DN", numbers.gain_e_per_dn, 1.0 / detector.gain_dn_per_e),
        ("PRNU", "percent", numbers.prnu_percent, 100.0 * detector.prnu),
        ("zero point", "mag", numbers.zero_point_mag, truth.zero_point_mag),
        ("vignetting at the corner", "mag", numbers.vignetting_mag, truth.corner_vignetting_mag),
        ("focal length", "px", numbers.focal_length_px, focal_mm / detector.pixel_pitch_mm),
    ]
    return [
        TrueNumber(
            name=name,
            unit=shown_unit(unit),
            measured=replace(number, unit=unit),
            true=true,
            pull=float((number.value - true) / (number.uncertainty or np.nan)),
        )
        for name, unit, number, true in rows
    ]
