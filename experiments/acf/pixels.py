"""The same calibration on rendered frames: what the experiment ``skycal`` found, as the report on ACF17 shows it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from experiments.acf.result import Result
from experiments.harness.report import Figure, Section, Text
from experiments.harness.summary import Criterion
from experiments.harness.tables import cell_text

if TYPE_CHECKING:
    from experiments.skycal.calibrate import CalibratedMap
    from experiments.skycal.result import CameraResult

__all__ = ["camera_text", "pixel_criteria", "pixel_results", "pixel_sections"]


def pixel_results(result: Result) -> dict[str, Any] | None:
    """Map errors of the rendered cameras [arcsec]; None where none was rendered."""
    if result.rendered is None:
        return None
    found = {}
    for name, camera in result.rendered.cameras.items():
        linked = camera.of("measured", method="linked")
        found[name] = {
            "lens": camera.scene.instrument.camera.lens.name,
            "field_deg": camera.scene.instrument.field_deg,
            "frames": camera.scene.frames,
            "stars_per_frame": camera.stars_per_frame,
            "map_error_arcsec": _map(camera.total),
            "map_error_with_gyro_arcsec": _map(linked),
            "parts_arcsec": camera.evaluation.part_rms_arcsec,
        }
    return found


def _map(judged: CalibratedMap) -> dict[str, float]:
    return {"rms": judged.rms_arcsec, "max": judged.max_arcsec, "predicted": judged.predicted_arcsec}


def pixel_criteria(result: Result) -> list[Criterion]:
    """The criteria of ``skycal`` on the rendered cameras."""
    if result.rendered is None:
        return []
    from experiments.skycal.experiment import experiment

    return experiment.judge(experiment.outcome(result.rendered.config, result.rendered))


def pixel_sections(result: Result) -> list[Section]:
    """One section with a map for each rendered camera."""
    if result.rendered is None:
        return []
    from experiments.skycal.experiment import experiment

    draw = experiment.draw(experiment.outcome(result.rendered.config, result.rendered))
    cameras = result.rendered.cameras.values()
    words = (
        "So far positions were numbers with Gaussian noise. Here frames are rendered through a traced lens, read out "
        "and reduced; the truth is the lens. "
        + " ".join(camera_text(camera) for camera in cameras)
        + " A part is what one more error in the positions changes of the map; parts add up as vectors, so that "
        "opposite ones make a whole smaller than their squares do. The predicted uncertainty contains a floor fitted "
        "to the residuals, hence some of the colour and of the camera model, not the noise alone. Which camera model "
        "is enough, and what wrong matches do, is in the report of *skycal*."
    )
    figures = [
        Figure(
            drawing=draw("error_and_uncertainty", camera.name),
            caption=f"The {camera.title}: error of the line of sight after the best rotation, and its predicted "
            "uncertainty, over the detector.",
        )
        for camera in cameras
    ]
    return [Section(title="On pixels", blocks=[Text(words), *figures])]


def camera_text(camera: CameraResult) -> str:
    """Size of the error of one camera, and the parts as ``skycal`` takes it apart."""
    from experiments.skycal.quantities import PART_NAMES

    sizes = sorted(camera.evaluation.part_rms_arcsec.items(), key=lambda item: -item[1])
    return (
        f"The {camera.title}: {camera.scene.frames} frames of the real sky, {camera.stars_per_frame:.0f} stars in a "
        f"frame detected, centroided and matched. The line of sight is off by {camera.total.rms_arcsec:.2f}″ RMS, "
        f"predicted {camera.total.predicted_arcsec:.2f}″. Its parts, RMS: "
        + ", ".join(f"{PART_NAMES[name]} {cell_text(size, '.2g')}″" for name, size in sizes)
        + "."
    )
