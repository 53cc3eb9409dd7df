"""Sections of the report: records, tables, curves, verdicts, pictures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from calib.measure.statistics.separability import FEATURES
from experiments.harness.drawings import bars, curves
from experiments.harness.quantities import Outcome, Quantities
from experiments.harness.sections import Section, Verdict, agree, below
from experiments.twin.camera_results import (
    CameraNumbers,
    ColourPoint,
    OrderNumbers,
    ResidualTerm,
    TransferPoint,
    TrueNumber,
    camera_numbers,
    colour_points,
    order_numbers,
    residual_terms,
    transfer_points,
    true_numbers,
)
from experiments.twin.compare import THRESHOLDS_SIGMA, half_detected_mag
from experiments.twin.comparison_results import (
    FALSE_ALARM,
    FALSE_LIMIT_SIGMA,
    ComparedStatistic,
    DetectionNumbers,
    Feature,
    FrameNumbers,
    TwinCompleteness,
    compare_statistics,
    completeness_bins,
    detection_numbers,
    frame_numbers,
    judge_completeness,
    judge_frames,
    judge_statistics,
    star_separability,
)
from experiments.twin.hold_out import HeldOut
from experiments.twin.pipeline import MeasuredNight
from experiments.twin.prescription import LensPose
from experiments.twin.synthetic import RenderedNight
from experiments.twin.twin import Twin
from optics.arrays import FloatArray

STRETCH_PERCENT = (20.0, 99.7)
"""Percentiles of the real frame that are black and white."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TwinProducts:
    """Contents of the written files and the pictures."""

    name: str
    twin: Twin
    limit_mag: float
    real: tuple[FloatArray, ...]  # (h, w) Frames as read
    rendered: tuple[FloatArray, ...]
    notes: tuple[str, ...]
    prescription: str = ""


def records(
    night: MeasuredNight,
    compared: HeldOut,
    twin: Twin,
    *,
    truth: RenderedNight | None,
    name: str,
    pose: LensPose | None = None,
    prescription: str = "",
) -> dict[str, Any]:
    """Section -> record or records."""
    limit_mag = half_detected_mag(compared.real, THRESHOLDS_SIGMA[0])
    numbers = camera_numbers(night, compared, limit_mag)
    roc = star_separability(night, compared)
    features = None if roc is None else zip(FEATURES, roc.effect, strict=True)
    return {
        "products": TwinProducts(
            name=name,
            twin=twin,
            limit_mag=limit_mag,
            real=tuple(frame.image.dn for frame in night.prepared.night.frames),
            rendered=tuple(image.dn for image in compared.images),
            notes=night.notes,
            prescription=prescription,
        ),
        "camera": numbers,
        "frames": frame_numbers(night, compared),
        "orders": order_numbers(night) or None,
        "photon_transfer": transfer_points(night.fit.noise),
        "colour_term": colour_points(night.fit.photometry, twin.response_mag),
        "residuals": residual_terms(night.fit, compared, limit_mag),
        "comparison": compare_statistics(compared, limit_mag),
        "completeness": completeness_bins(compared, limit_mag),
        "detections": detection_numbers(compared, roc),
        "features": features and [Feature(name=name, effect_sigma=float(effect)) for name, effect in features],
        "detector_pose": pose,
        "truth": truth and true_numbers(truth, numbers, night.fit),
    }


def axes(config: Any) -> Quantities:
    """None: all dimensions follow from the frames."""
    del config
    return Quantities()


def _named(dim: str, label: str, key: str = "name", names: str = "name", units: str = "") -> Any:
    """Axis with the field ``key`` of the records as coordinates, numbered where it is not unique.

    ``names``: field that readers see; ``units``: `Measured` field that gives the unit of the row.
    """

    def describe(q: Quantities, rows: Sequence[Any]) -> None:
        keys = [getattr(row, key) for row in rows]
        if len(set(keys)) < len(keys):
            keys = [f"{n + 1} {row}" for n, row in enumerate(keys)]
        row_units = [getattr(row, units).unit for row in rows] if units else ()
        q.axis(dim, keys, label, names=[getattr(row, names) for row in rows], units=row_units)

    return describe


def _verdict(judge: Any, *names: str) -> Verdict:
    judge.names = names
    verdict: Verdict = judge
    return verdict


def pictures(outcome: Outcome, number: int, half_px: int | None = None) -> Figure:
    """A real and a rendered frame, same grey scale; with ``half_px`` the middle, enlarged."""
    from experiments.harness.plotting import new_figure

    products: TwinProducts = outcome.result["products"]
    real, rendered = products.real[number], products.rendered[number]
    if half_px is not None:
        middle = tuple(slice(max(n // 2 - half_px, 0), n // 2 + half_px) for n in real.shape)
        real, rendered = real[middle], rendered[middle]
    height, width = real.shape
    figure, grid = new_figure(1, 2, width="full", aspect_ratio=0.52 * height / width + 0.06)
    low, high = np.percentile(real, STRETCH_PERCENT)
    for panel, image, title in zip(np.ravel(grid), (real, rendered), ("real", "twin"), strict=True):
        panel.imshow(image, cmap="gray", vmin=low, vmax=high, interpolation="auto" if half_px is None else "nearest")
        panel.set(title=title)
        panel.set_axis_off()
    return figure


SECTIONS: dict[str, Section] = {
    "products": Section(
        record=TwinProducts,
        figures={
            "first": partial(pictures, number=0),
            "last": partial(pictures, number=-1),
            "close": partial(pictures, number=0, half_px=96),
        },
    ),
    "camera": Section(record=CameraNumbers, vertical=True, caption="Measured properties of the camera."),
    "frames": Section(
        record=FrameNumbers,
        dim="frame",
        axes=_named("frame", "Frame"),
        caption="Frames, and frames rendered by twins measured without them.",
        verdicts=[_verdict(judge_frames, "stars_difference_percent", "noise_difference_percent")],
    ),
    "orders": Section(
        record=OrderNumbers,
        dim="order",
        axes=_named("order", "Model"),
        caption="Camera models, cross-validated: each frame predicted from the others.",
        note="Chosen: the simplest within one standard error of the best, paired by frames.",
    ),
    "photon_transfer": Section(
        record=TransferPoint,
        dim="level",
        along="level_dn",
        figures={
            "photon_transfer": curves("level", points="variance_dn2", lines="fitted_variance_dn2", aspect_ratio=0.4)
        },
    ),
    "colour_term": Section(
        record=ColourPoint,
        dim="knot",
        along="colour",
        caption="Colour term, zero at 5040 K.",
        figures={"colour_term": curves("knot", points="measured_mag", lines="twin_mag", aspect_ratio=0.4)},
    ),
    "residuals": Section(
        record=ResidualTerm,
        dim="cause",
        axes=_named("cause", "Cause"),
        caption="Residuals of bright stars after the calibration; contributions add in quadrature.",
    ),
    "comparison": Section(
        record=ComparedStatistic,
        dim="statistic",
        axes=_named("statistic", "Statistic", "key", "label", "real"),
        columns="unit real twin difference allowed within_limit",
        caption="Real and rendered frames; each frame is rendered by a twin measured without it.",
        note="Difference: (twin − real) / real (for magnitudes, correlations and fractions: twin − real); ±: "
        "noise of a single set, from the scatter of the rendered sets.",
        verdicts=[_verdict(judge_statistics, "difference", "allowed")],
    ),
    "completeness": Section(
        record=TwinCompleteness,
        dim="bin",
        along="magnitude_mag",
        caption="Fraction of the catalogue stars detected, per half magnitude.",
        figures={
            "completeness_plot": curves(
                "bin",
                points="real_5_sigma real_6_sigma",
                lines="twin_5_sigma twin_6_sigma",
                y="Fraction detected",
                aspect_ratio=0.42,
            )
        },
        verdicts=[_verdict(judge_completeness, "real_5_sigma", "twin_5_sigma", "real_6_sigma", "twin_6_sigma")],
    ),
    "detections": Section(
        record=DetectionNumbers,
        vertical=True,
        caption="False detections in all frames, and separability of real and rendered stars.",
        verdicts=[
            below(
                "false_difference_sigma",
                FALSE_LIMIT_SIGMA,
                title="false detections at 5 sigma: twin against real",
                size=True,
                false_alarm=FALSE_ALARM,
            )
        ],
    ),
    "features": Section(
        record=Feature,
        dim="feature",
        axes=_named("feature", "Feature"),
        caption="Differences between real and rendered star windows.",
        figures={"feature_bars": bars("feature", bars="effect_sigma")},
    ),
    "detector_pose": Section(
        record=LensPose,
        vertical=True,
        caption="Detector position behind the known lens, from the frames.",
    ),
    "truth": Section(
        record=TrueNumber,
        dim="parameter",
        axes=_named("parameter", "Number", units="measured"),
        caption="Measured values and true values of the rendering camera.",
        verdicts=[agree("measured", with_="true", each="parameter", false_alarm=2e-3, title="measured against truth")],
    ),
}
