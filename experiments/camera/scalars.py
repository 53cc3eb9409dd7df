"""The single numbers of a prediction, by name: the same names for every sensor."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from calib.measure.centroid_prediction import phase_windows
from calib.measure.crlb import matched_snr
from experiments.camera.optical_state import COLD_K, HOT_K
from experiments.camera.records import CameraPrediction, Scalar, colour_distance, detector_radii
from optics.arrays import FloatArray
from optics.units import RAD_ARCSEC

__all__ = ["scalars_of"]


WORST = 0.01
"""Share of the sky that counts as its worst part."""


def scalars_of(prediction: CameraPrediction, limits: Mapping[float, float]) -> dict[str, Scalar]:
    """Numbers by name."""
    return _lens_scalars(prediction) | _star_scalars(prediction, limits) | _sky_scalars(prediction)


def _lens_scalars(prediction: CameraPrediction) -> dict[str, Scalar]:
    state, lens = prediction.state, prediction.state.performance
    camera = state.instrument.camera
    half = np.array([camera.width_px, camera.height_px]) * camera.pixel_pitch_mm / 2.0 / lens.plate_scale_mm
    wide, high = 2.0 * np.degrees(np.arctan(half))
    diagonal = 2.0 * float(np.degrees(np.arctan(np.hypot(*half))))
    pitch, rms = camera.pixel_pitch_mm, lens.white.rms_mm()
    colour = np.ptp(lens.bundle_mm, axis=1).max() / pitch
    first, last = (int(np.abs(np.log(state.temperatures_k / t)).argmin()) for t in (COLD_K, HOT_K))
    stars = np.abs(state.colour_px[last] - state.colour_px[first]).max()
    axial = np.ptp(lens.axial_colour_mm) * 1e3
    return {
        "focal_length_mm": Scalar(value=lens.focal_length_mm, unit="mm", label="Focal length", format=".3f"),
        "f_number": Scalar(value=lens.f_number, unit="", label="F-number", format=".2f"),
        "pupil_mm": Scalar(
            value=abs(lens.focal_length_mm) / lens.f_number, unit="mm", label="Entrance pupil", format=".2f"
        ),
        "plate_scale_arcsec_per_mm": Scalar(
            value=RAD_ARCSEC / lens.plate_scale_mm, unit="arcsec/mm", label="Plate scale", format=".1f"
        ),
        "pixel_arcsec": Scalar(value=state.pixel_arcsec, unit="arcsec", label="Angle of a pixel", format=".3f"),
        "field_width_deg": Scalar(value=float(wide), unit="deg", label="Field, width", format=".2f"),
        "field_height_deg": Scalar(value=float(high), unit="deg", label="Field, height", format=".2f"),
        "field_deg": Scalar(value=float(min(wide, high)), unit="deg", label="Field, shorter side", format=".2f"),
        "field_diagonal_deg": Scalar(value=diagonal, unit="deg", label="Field, diagonal", format=".2f"),
        "spot_axis_um": Scalar(value=1e3 * float(rms[0]), unit="um", label="Spot radius (RMS) on axis", format=".2f"),
        "spot_um": Scalar(value=1e3 * float(rms.max()), unit="um", label="Spot radius (RMS), largest", format=".2f"),
        "spot_px": Scalar(value=float(rms.max()) / pitch, unit="px", label="Spot radius (RMS), largest", format=".3f"),
        "best_focus_um": Scalar(
            value=1e3 * lens.best_focus_mm, unit="um", label="Best focus, from the detector", format=".1f"
        ),
        "depth_of_focus_um": Scalar(
            value=1e3 * lens.depth_of_focus_mm(pitch), unit="um", label="Depth of focus, ±", format=".1f"
        ),
        "distortion_percent": Scalar(
            value=100.0 * float(np.abs(lens.distortion).max()),
            unit="percent",
            label="Distortion, largest",
            format=".3f",
        ),
        "lateral_colour_px": Scalar(
            value=float(colour), unit="px", label="Lateral colour over the pass band", format=".3f"
        ),
        "star_colour_px": Scalar(
            value=float(stars), unit="px", label="Shift of a 10 000 K against a 3500 K star", format=".3f"
        ),
        "axial_colour_um": Scalar(value=float(axial), unit="um", label="Axial colour over the pass band", format=".1f"),
        "vignetting_percent": Scalar(
            value=100.0 * float(1.0 - lens.vignetting.min()), unit="percent", label="Vignetting, largest", format=".2f"
        ),
    }


def _star_scalars(prediction: CameraPrediction, limits: Mapping[float, float]) -> dict[str, Scalar]:
    config, state, processing = prediction.config, prediction.state, prediction.processing
    star, stars, radius = config.star, prediction.stars, detector_radii(state)
    electrons = prediction.electrons(np.full(len(radius), star.magnitude_mag), star.temperature_k, radius)
    pixel = state.pixel_arcsec

    def over_detector(sigma_px: FloatArray) -> float:
        return pixel * float(np.sqrt((stars.sigma_at(sigma_px, electrons, radius) ** 2).mean()))

    noise, pattern = over_detector(stars.centroid.noise_px), over_detector(stars.centroid.pattern_px)
    phase = over_detector(stars.centroid.phase_px) if stars.centroid.phase_px.any() else 0.0
    view = prediction.view
    seen = view.magnitude <= limits[0.5]
    shift = state.colour_shift_px(view.temperature_k[seen], view.radius_px[seen])
    spot = over_detector(stars.colour_px) if stars.colour_px.any() else 0.0
    apart = colour_distance(view.temperature_k[seen], star.temperature_k)
    colour = float("nan")
    if seen.any():
        colour = float(np.hypot(pixel * np.sqrt(0.5 * (shift**2).mean()), spot * np.sqrt((apart**2).mean())))
    axis = float(prediction.electrons(np.array([star.magnitude_mag]), star.temperature_k)[0])
    full = float(stars.centroid.peak.max()) * axis / max(processing.top_e, 1e-9)
    windows = phase_windows(state.psfs[:1], config.window_px)
    quoted = 1.0 if full <= 1.0 else float("nan")  # centroids of clipped spots are not predicted
    noise, pattern, phase = quoted * noise, quoted * pattern, quoted * phase
    snr = quoted * float(
        matched_snr(windows.light, np.full(len(windows.light), axis), processing.background_e, processing.noise).mean()
    )
    what = f"of a star of {star.magnitude_mag:g} mag"
    return {
        "electrons_e": Scalar(value=axis, unit="e-", label=f"Electrons {what}", format=".0f"),
        "snr": Scalar(value=snr, unit="", label=f"Signal-to-noise ratio {what}", format=".1f"),
        "saturation_mag": Scalar(
            value=star.magnitude_mag + 2.5 * float(np.log10(max(full, 1e-9))),
            unit="mag",
            label="Brightest star that does not saturate",
            format=".2f",
        ),
        "limiting_magnitude_mag": Scalar(
            value=limits[0.5], unit="mag", label="Limiting magnitude, half are found", format=".2f"
        ),
        "complete_magnitude_mag": Scalar(
            value=limits[0.9], unit="mag", label="Limiting magnitude, 90 % are found", format=".2f"
        ),
        "threshold_sigma": Scalar(
            value=processing.threshold_sigma, unit="sigma", label="Detection limit", format=".2f"
        ),
        "false_alarms_per_frame": Scalar(
            value=processing.false_alarms, unit="", label="False alarms per frame", format=".3g"
        ),
        "nea_arcsec": Scalar(value=noise, unit="arcsec", label=f"NEA {what}", format=".3f"),
        "pattern_arcsec": Scalar(value=pattern, unit="arcsec", label="Pixel patterns", format=".3f"),
        "phase_arcsec": Scalar(value=phase, unit="arcsec", label="Pixel phase", format=".3f"),
        "colour_arcsec": Scalar(value=colour, unit="arcsec", label="Star colours", format=".3f"),
        "single_star_arcsec": Scalar(
            value=float(np.sqrt(noise**2 + pattern**2 + phase**2 + np.nan_to_num(colour) ** 2)),
            unit="arcsec",
            label=f"Single-star accuracy {what}",
            format=".3f",
        ),
    }


def _sky_scalars(prediction: CameraPrediction) -> dict[str, Scalar]:
    forecast = prediction.attitude
    exposure = prediction.config.instrument.exposure_s
    found = {
        "stars_mean_per_frame": Scalar(
            value=float(forecast.stars.mean()), unit="", label="Stars per frame, mean over the sky", format=".1f"
        ),
        "stars_worst_per_frame": Scalar(
            value=float(np.quantile(forecast.stars, WORST)),
            unit="",
            label="Stars per frame, worst 1 % of the sky",
            format=".1f",
        ),
        "update_rate_hz": Scalar(
            value=1.0 / exposure, unit="Hz", label="Frames per second that the exposure allows", format=".3g"
        ),
    }
    for kind, values in (("", forecast.total_arcsec), ("_noise", forecast.noise_arcsec)):
        cross = np.sqrt((values[:, :2] ** 2).mean(1))
        by = ", noise alone" if kind else ""
        for name, one, words in (("cross", cross, "across"), ("roll", values[:, 2], "roll")):
            for part, level, where in (("", 0.5, "median"), ("_worst", 1.0 - WORST, "worst 1 % of the sky")):
                found[f"attitude_{name}{part}{kind}_arcsec"] = Scalar(
                    value=float(np.quantile(one, level, method="inverted_cdf")),
                    unit="arcsec",
                    label=f"Attitude {words}, {where}{by}",
                    format=".3f",
                )
    return found
