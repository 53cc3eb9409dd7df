"""The same calibration on rendered frames: what the experiment ``skycal`` found, as the report on ACF17 shows it."""

from __future__ import annotations

from typing import Any

from experiments.acf_result import Result
from experiments.report import Figure, Section, Text
from experiments.summary import Criterion

__all__ = ["pixel_criteria", "pixel_results", "pixel_sections"]


def pixel_results(result: Result) -> dict[str, Any] | None:
    """Map errors of the rendered cameras [arcsec]; None where none was rendered."""
    if result.rendered is None:
        return None
    found = {}
    for name, camera in result.rendered.cameras.items():
        linked = camera.of("measured", method="linked")
        found[name] = {
            "lens": camera.scene.instrument.camera.lens.name,
            "field_deg": camera.scene.field_deg,
            "frames": camera.scene.frames,
            "stars_per_frame": camera.stars_per_frame,
            "map_error_arcsec": {"rms": camera.total.rms_arcsec, "max": camera.total.max_arcsec},
            "predicted_arcsec": camera.total.predicted_arcsec,
            "map_error_with_gyro_arcsec": {"rms": linked.rms_arcsec, "max": linked.max_arcsec},
            "predicted_with_gyro_arcsec": linked.predicted_arcsec,
        }
    return found


def pixel_criteria(result: Result) -> list[Criterion]:
    """The criteria of ``skycal`` on the rendered cameras."""
    if result.rendered is None:
        return []
    from experiments.skycal_checks import criteria

    return criteria(result.rendered)


def pixel_sections(result: Result) -> list[Section]:
    """One section with a map for each rendered camera."""
    if result.rendered is None:
        return []
    from experiments.skycal_figures import error_and_uncertainty

    cameras = result.rendered.cameras.values()
    parts = [
        f"The {camera.title}: {camera.scene.frames} frames of the real sky, {camera.stars_per_frame:.0f} stars in a "
        f"frame detected, centroided and matched. The line of sight is off by {camera.total.rms_arcsec:.2f}″ RMS; the "
        f"noise of the calibration makes {camera.total.predicted_arcsec:.2f}″ of it, the colour of the stars and the "
        "camera model the rest."
        for camera in cameras
    ]
    words = (
        "So far positions were numbers with Gaussian noise. Here frames are rendered through a traced lens, read out "
        "and reduced; the truth is the lens. "
        + " ".join(parts)
        + " What the error is made of, which camera model is enough, and what wrong matches do is in the report of "
        "*skycal*."
    )
    figures = [
        Figure(
            drawing=error_and_uncertainty(camera),
            caption=f"The {camera.title}: error of the line of sight after the best rotation, and its predicted "
            "uncertainty, over the detector.",
        )
        for camera in cameras
    ]
    return [Section(title="On pixels", blocks=[Text(words), *figures])]
