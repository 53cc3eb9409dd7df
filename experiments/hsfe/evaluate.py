"""Criteria and numbers of the step test."""

from __future__ import annotations

from typing import Any

import numpy as np

from experiments.harness.summary import Criterion, Measured
from experiments.hsfe.result import PUBLISHED_ARCSEC, Result
from experiments.laboratory.high_frequency import CAUSES
from optics.arrays import FloatArray

__all__ = ["criteria", "ratio", "results", "three_sigma"]


SIGMA_LIMIT = 4.0
"""Of two axes, two predictions and several methods the largest deviation counts."""
MODEL_RATIO = 0.03
"""What the linear model may be off: a threshold smooths the S-curve under noise by about this much."""


def three_sigma(result: Result, value_px: FloatArray) -> FloatArray:
    """Pixels, 1 sigma, as arcsec, 3 sigma."""
    return np.asarray(3.0 * result.instrument.pixel_arcsec * np.asarray(value_px))


def ratio(result: Result, method: str) -> tuple[Measured, Measured]:
    """Measured over predicted (after the test), x and y; the uncertainty is the scatter from chip to chip."""
    found, model = result.measured.document_px(method), result.after.method[method]
    values = found / model.document_px
    error = model.scatter_px / model.document_px
    x, y = (Measured(value=float(values[a]), uncertainty=float(error[a])) for a in range(2))
    return x, y


def criteria(result: Result) -> list[Criterion]:
    """What has to hold for the run to count as passed."""
    found = []
    measured = result.measured
    for method in result.config.methods:
        after, before = result.after.method[method], result.before.method[method]
        number = measured.document_px(method)
        for label, model in (("the motion seen", after), ("drawn paths", before)):
            spread = np.hypot(SIGMA_LIMIT * model.scatter_px, MODEL_RATIO * model.document_px)
            found.append(
                Criterion(
                    name=f"{method}: document's figure against prediction for {label}, in units of what is allowed "
                    "(4 σ and 3 %)",
                    value=float(np.abs((number - model.document_px) / spread).max()),
                    limit=1.0,
                )
            )
        found.append(
            Criterion(
                name=f"{method}: causes and noise in quadrature over everything together, off 1 by",
                value=float(np.abs(measured.quadrature_px(method) / number - 1.0).max()),
                # cross terms of causes and noise have no mean but scatter as the figure itself does
                limit=MODEL_RATIO + SIGMA_LIMIT * float((after.scatter_px / after.document_px).max()),
            )
        )
        if method != "epsf":
            curve = measured.cause_px(method, "s_curve")
            found.append(
                Criterion(
                    name=f"{method}: S-curve of the rendered light over that of the sampled PSF, off 1 by",
                    value=float(np.abs(curve / after.cause_px["s_curve"] - 1.0).max()),
                    limit=0.05,
                )
            )
    found.append(
        Criterion(
            name="true motion of the light after the mean over the stars is removed",
            value=float(measured.motion_px.max()),
            limit=3.0 * max(float(one.document_px.max()) for one in result.geometry if one.label == "this one"),
            unit="px",
        )
    )
    return found


def _xy(values: Any) -> dict[str, float]:
    return {"x": float(values[0]), "y": float(values[1])}


def results(result: Result) -> dict[str, Any]:
    """The ``results`` of ``summary.json``."""
    measured, out = result.measured, {}
    for method in result.config.methods:
        after, before = result.after.method[method], result.before.method[method]
        x, y = measured.document_arcsec(method)
        ratios = ratio(result, method)

        def arcsec(value_px: FloatArray) -> dict[str, float]:
            return _xy(three_sigma(result, value_px))

        out[method] = {
            "document": {"x": x, "y": y},
            "document_predicted": arcsec(after.document_px),
            "document_predicted_scatter": arcsec(after.scatter_px),
            "document_predicted_before": arcsec(before.document_px),
            "document_predicted_before_scatter": arcsec(before.scatter_px),
            "ratio": {"x": ratios[0], "y": ratios[1]},
            "one_position_if_independent": arcsec(measured.halved_px(method)),
            "one_position": arcsec(measured.single_px(method)),
            "one_position_predicted": arcsec(after.single_px),
            "temporal_in_document": arcsec(measured.temporal_px(method)),
            "dark_frames_in_document": arcsec(after.dark_px),
            "roll_in_document": arcsec(after.roll_px),
            "quadrature": arcsec(measured.quadrature_px(method)),
            "causes": {
                cause: {
                    "alone": arcsec(measured.cause_px(method, cause)),
                    "switched_off": arcsec(measured.cause_px(method, cause, alone=False)),
                    "predicted": arcsec(after.cause_px[cause]),
                    "one_position_alone": arcsec(measured.cause_single_px(method, cause)),
                    "one_position_predicted": arcsec(after.cause_single_px[cause]),
                }
                for cause in CAUSES
            },
        }
    first = result.config.methods[0]
    return {
        "hsfe_arcsec_3sigma": out[first]["document"],
        "published_arcsec_3sigma": _xy(PUBLISHED_ARCSEC),
        "methods_arcsec_3sigma": out,
        "subtraction": result.config.subtraction,
        "motion_left_px": _xy(measured.motion_px),
        "hexapods": [
            {
                "label": one.label,
                "step_error_arcsec": one.step_arcsec,
                "roll_error_arcsec": one.roll_arcsec,
                "common_motion_px": one.motion_px,
                "left_px": _xy(one.document_px),
            }
            for one in result.geometry
        ],
        "positions": result.config.steps.positions,
        "frames": measured.frames,
        "stars": int(measured.photon_px.shape[1]),
        "pixel_arcsec": measured.pixel_arcsec,
        "runtime_s": result.runtime_s,
        "peak_memory_mb": result.peak_memory_mb,
    }
