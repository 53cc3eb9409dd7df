"""Required performance of a sensor: the table ``[requirements]`` of a sensor file."""

from __future__ import annotations

from pydantic import Field

from optics.settings import StrictModel


def _asked(description: str, low: float = 0.0) -> float | None:
    field: float | None = Field(default=None, gt=low, le=1e9, description=description)
    return field


class RequirementsConfig(StrictModel):
    """Required performance of the sensor; every key is optional. Accuracies are one standard deviation."""

    field_deg: float | None = _asked("field of view along the shorter side, at least")
    field_diagonal_deg: float | None = _asked("field of view over the diagonal, at least")
    limiting_magnitude_mag: float | None = _asked(
        "magnitude (system of the catalogue) at which half of the stars are detected, at least", -10.0
    )
    saturation_mag: float | None = _asked("magnitude of the brightest star that does not saturate, at most", -10.0)
    false_alarms_per_frame: float | None = _asked("false detections per frame, at most")
    nea_arcsec: float | None = _asked("noise-equivalent angle of the star of [star], one axis, at most")
    single_star_arcsec: float | None = _asked(
        "error of the star of [star] by noise and fixed patterns, one axis, at most"
    )
    stars_mean_per_frame: float | None = _asked("stars detected per frame, mean over the sky, at least")
    stars_worst_per_frame: float | None = _asked("stars detected per frame in the worst 1 % of the sky, at least")
    sky_coverage_percent: float | None = _asked("share of the sky with 4 guide stars or more, at least")
    lost_success_percent: float | None = _asked("share of the sky identified lost in space, at least")
    attitude_cross_arcsec: float | None = _asked("attitude error across the boresight, median over the sky, at most")
    attitude_cross_worst_arcsec: float | None = _asked(
        "attitude error across the boresight, worst 1 % of the sky, at most"
    )
    attitude_roll_arcsec: float | None = _asked("attitude error about the boresight, median over the sky, at most")
    attitude_roll_worst_arcsec: float | None = _asked(
        "attitude error about the boresight, worst 1 % of the sky, at most"
    )
    update_rate_hz: float | None = _asked("update rate that exposure and [timing] allow, at least")
    latency_s: float | None = _asked("age of an attitude at its output, at most")
    slew_rate_deg_per_s: float | None = _asked(
        "slew rate up to which there is an attitude and all other requirements are met, at least"
    )
    spot_px: float | None = _asked("RMS radius of the white spot, largest over the field, at most")
    distortion_percent: float | None = _asked("largest distortion over the field, at most")
    lsfe_before_arcsec: float | None = _asked(
        "RMS difference in distortion between a lens drawn by [manufacture] and the design, at most"
    )
    lsfe_after_arcsec: float | None = _asked(
        "RMS distortion of a lens drawn by [manufacture] that remains after calibration, at most"
    )
    lateral_colour_px: float | None = _asked("largest separation of two wavelengths' images in the pass band, at most")
    vignetting_percent: float | None = _asked("largest loss of light over the field against the axis, at most")
    focus_shift_um: float | None = _asked("largest change of the best focus over the range of [thermal], at most")
    spot_thermal_px: float | None = _asked("largest RMS radius of the white spot over the range of [thermal], at most")
    sun_exclusion_deg: float | None = _asked("exclusion angle of the Sun (experiment straylight), at most")
    scale_change_ppm: float | None = _asked("largest change of the plate scale over the range of [thermal], at most")


AT_LEAST = frozenset(
    name for name, field in RequirementsConfig.model_fields.items() if str(field.description).endswith("at least")
)
"""Requirements that the sensor has to reach; it must not exceed the others."""
