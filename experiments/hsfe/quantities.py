"""The numbers of the step test, each described once."""

from __future__ import annotations

from typing import Any

import numpy as np

from experiments.harness.quantities import Quantities
from experiments.hsfe.result import Result
from experiments.laboratory.collimator_effects import add_line_of_sight
from experiments.laboratory.high_frequency import CAUSES
from experiments.laboratory.point_quantities import point_quantities
from experiments.laboratory.point_scene import point_signal
from experiments.laboratory.published import ACC18_ARCSEC, is_published_sensor
from experiments.laboratory.signal import add_signal
from experiments.laboratory.step_statistics import step_residual_px

__all__ = ["describe"]

CAUSE_NAMES = {
    "s_curve": "S-curve",
    "prnu": "response (PRNU)",
    "pattern": "offset pattern (DSNU)",
    "defects": "masked defects",
}


def describe(result: Result) -> Quantities:
    """Quantities of a run: by centroider, by cause, of hexapods, step by step."""
    measured, config = result.measured, result.config
    q = point_quantities(config.methods)
    add_signal(q, point_signal(config, result.instrument))
    q.axis("cause", CAUSES, "Cause", names=CAUSE_NAMES)
    _methods(q, result)
    _causes(q, result)
    if is_published_sensor(config):
        published, place = ACC18_ARCSEC["HSFE"], "published_arcsec_3sigma"
        q.add("published_arcsec", published, "Published", unit="arcsec", dims="axis", format=".2f", json=place)
    q.add("subtraction", config.subtraction, "Subtraction")
    q.add("motion_px", measured.motion_px, "Motion left", unit="px", dims="axis", json="motion_left_px")
    _hexapods(q, result)
    _steps(q, result)
    q.add("positions", config.steps.positions, "Positions")
    if result.sight is not None:
        add_line_of_sight(q, result.sight)
    q.add("frames", measured.frames, "Frames")
    q.add("stars", int(measured.photon_px.shape[1]), "Stars")
    q.add("pixel_arcsec", measured.pixel_arcsec, "Angle of a pixel", unit="arcsec")
    return q


def _methods(q: Quantities, result: Result) -> None:
    """The document's figure and the error of one position, by centroider."""
    methods, measured, scale = result.config.methods, result.measured, 3.0 * result.instrument.pixel_arcsec
    whole: dict[str, Any] = {"unit": "arcsec", "dims": "method axis", "format": ".3f"}
    place = "methods_arcsec_3sigma[method]."
    document, places = [measured.document_arcsec(m) for m in methods], {"*": f"{place}document"}
    q.add("document_arcsec", document, "Document", **whole, json=places | {methods[0]: "hsfe_arcsec_3sigma"})
    before, after = ([model.method[m] for m in methods] for model in (result.before, result.after))
    for name, models, json in (
        ("predicted_arcsec", after, f"{place}document_predicted"),
        ("predicted_before_arcsec", before, f"{place}document_predicted_before"),
    ):
        values, scatter = (scale * np.array([getattr(m, of) for m in models]) for of in ("document_px", "scatter_px"))
        q.add(name, values, "Predicted", **whole, error=scatter, json=json, json_error=f"{json}_scatter")
    found, expected = np.array([measured.document_px(m) for m in methods]), np.array([m.document_px for m in after])
    spread = np.array([m.scatter_px for m in after]) / expected  # the prediction after the test, from chip to chip
    ratio, json = found / expected, f"{place}ratio"
    q.add("ratio", ratio, "Ratio", dims="method axis", error=spread, format=".3f", json=json)
    for name, label, json, px in (
        ("halved_arcsec", "Over √2", "one_position_if_independent", [measured.halved_px(m) for m in methods]),
        ("one_position_arcsec", "One position", "one_position", [measured.single_px(m) for m in methods]),
        ("one_position_predicted_arcsec", "Predicted", "one_position_predicted", [m.single_px for m in after]),
        ("temporal_arcsec", "Temporal noise / √N", "temporal_in_document", [measured.temporal_px(m) for m in methods]),
        ("dark_arcsec", "Noise of the dark frames", "dark_frames_in_document", [m.dark_px for m in after]),
        ("roll_arcsec", "Roll of the hexapod", "roll_in_document", [m.roll_px for m in after]),
        ("quadrature_arcsec", "In quadrature", "quadrature", [measured.quadrature_px(m) for m in methods]),
    ):
        q.add(name, scale * np.array(px), label, **whole, json=place + json)
    temporal = scale * np.array([m.temporal_px for m in after])
    q.add("temporal_predicted_arcsec", temporal, "Temporal noise / √N, predicted", **whole, json="")


def _causes(q: Quantities, result: Result) -> None:
    """What each cause contributes, by centroider."""
    measured, after, scale = result.measured, result.after.method, 3.0 * result.instrument.pixel_arcsec
    for name, label, json, px in (
        ("alone_arcsec", "Alone", "alone", measured.cause_px),
        ("off_arcsec", "Switched off", "switched_off", lambda m, c: measured.cause_px(m, c, alone=False)),
        ("cause_predicted_arcsec", "Predicted", "predicted", lambda m, c: after[m].cause_px[c]),
        ("alone_position_arcsec", "Alone, one position", "one_position_alone", measured.cause_single_px),
        ("position_predicted_arcsec", "Predicted", "one_position_predicted", lambda m, c: after[m].cause_single_px[c]),
    ):
        values = [[scale * px(m, c) for c in CAUSES] for m in result.config.methods]
        place = f"methods_arcsec_3sigma[method].causes[cause].{json}"
        q.add(name, values, label, unit="arcsec", dims="method cause axis", format=".4f", json=place)


def _hexapods(q: Quantities, result: Result) -> None:
    """Hexapods of different quality, by ray trace."""
    hexapods = result.geometry
    for name, values, label, unit, format in (
        ("step_error_arcsec", [one.step_arcsec for one in hexapods], "Step error", "arcsec", ".1f"),
        ("roll_error_arcsec", [one.roll_arcsec for one in hexapods], "Roll error", "arcsec", ".1f"),
        ("common_motion_px", [one.motion_px for one in hexapods], "Common motion", "px", ".4f"),
    ):
        q.add(name, values, label, unit=unit, dims="hexapod", format=format, json=f"hexapods[hexapod].{name}")
    labels, left = [one.label for one in hexapods], [one.document_px for one in hexapods]
    q.add("hexapod_label", labels, "Hexapod", dims="hexapod", key="hexapod", json="hexapods[hexapod].label")
    described = {"unit": "px", "dims": "hexapod axis", "format": ".5f", "key": "left_{axis}_px"}
    q.add("left_px", left, "Left,", **described, json="hexapods[hexapod].left_px")


def _steps(q: Quantities, result: Result) -> None:
    """Residuals of eq. 7-8 of the centroider that counts, and of the light itself."""
    measured = result.measured
    left = step_residual_px(measured.mean_px["all"][result.config.methods[0]])
    q.axis("step", np.arange(left.shape[0]) + 1, "Step")
    q.axis("star", np.arange(left.shape[1]) + 1, "Star")
    for name, label, values in (("residual", "Residual", left), ("true", "True", step_residual_px(measured.photon_px))):
        q.add(f"{name}_px", values, label, unit="px", dims="step star axis", key=f"{name}_{{axis}}_px", json="")
