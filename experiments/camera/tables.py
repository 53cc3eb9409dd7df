"""Tables of the camera report."""

from __future__ import annotations

import math
from typing import Any

from experiments.harness.pivot import Pivot
from experiments.harness.quantities import Outcome, shown_unit
from experiments.harness.summary import Measured
from experiments.harness.tables import Column, Table, cell_text

__all__ = ["tables"]

OPTICS = (
    "focal_length_mm", "f_number", "pupil_mm", "field_width_deg", "field_height_deg", "field_diagonal_deg",
    "plate_scale_arcsec_per_mm", "pixel_arcsec", "spot_axis_um", "spot_um", "best_focus_um", "depth_of_focus_um",
    "distortion_percent", "lateral_colour_px", "star_colour_px", "axial_colour_um", "vignetting_percent",
)  # fmt: skip
ACCURACY = (
    "electrons_e", "snr", "nea_arcsec", "pattern_arcsec", "phase_arcsec", "colour_arcsec", "single_star_arcsec",
)  # fmt: skip
SKY = (
    "saturation_mag", "complete_magnitude_mag", "limiting_magnitude_mag", "threshold_sigma", "false_alarms_per_frame",
    "stars_mean_per_frame", "stars_worst_per_frame", "attitude_cross_arcsec", "attitude_cross_worst_arcsec",
    "attitude_roll_arcsec", "attitude_roll_worst_arcsec", "attitude_cross_noise_arcsec", "attitude_roll_noise_arcsec",
)  # fmt: skip


def tables(outcome: Outcome) -> dict[str, Table | Pivot]:
    """Every table by name."""
    result = outcome.result
    made: dict[str, Table | Pivot] = {
        "requirements": _requirements(outcome),
        "optics": _scalars(outcome, OPTICS, "Lens and detector, as configured."),
        "accuracy": _scalars(outcome, ACCURACY, "One star, one axis, one standard deviation, mean over the detector."),
        "sky": _scalars(outcome, SKY, "Detection, and the real sky."),
        "fields": Pivot(
            rows="field",
            columns="field_spot_um field_focus_um field_distortion_percent field_vignetting_percent",
            caption="Over the field; spot and focus are those of all light of the pass band.",
        ),
    }
    if len(result.thermal.temperature_c):
        made["thermal"] = Pivot(
            rows="temperature",
            columns="thermal_focus_um thermal_scale_ppm thermal_spot_px thermal_colour_px thermal_nea_arcsec "
            "thermal_attitude_arcsec",
            caption="Over temperature, the detector where the focus was set.",
        )
    if result.swings:
        made["what_to_change"] = _swings(outcome)
    if result.rendered is not None:
        made["frames"] = _frames(outcome)
    return made


SATURABLE = frozenset({"snr", "nea_arcsec", "pattern_arcsec", "phase_arcsec", "single_star_arcsec"})


def _number(value: float, form: str) -> Any:
    return cell_text(value, form) if math.isfinite(value) else "–"


def _scalar(outcome: Outcome, name: str, value: float, form: str) -> Any:
    """A scalar as text; of a star that saturates there is no accuracy."""
    lost = name in SATURABLE and outcome.result.prediction.saturated
    return "saturated" if lost else _number(value, form)


def _requirements(outcome: Outcome) -> Table:
    rows = [
        (
            one.label,
            one.key,
            f"{'≥' if one.at_least else '≤'} {one.required:g}",
            _scalar(outcome, one.key, one.predicted, one.format),
            shown_unit(one.unit),
            one.margin_words,
            "met" if one.met else "MISSED",
        )
        for one in outcome.result.verdicts
    ]
    columns = (
        "Requirement",
        Column(name="Key", key="key"),
        Column(name="Required", key="required"),
        Column(name="Predicted", key="predicted"),
        Column(name="Unit", key="unit"),
        Column(name="Margin", key="margin"),
        Column(name="Verdict", key="verdict"),
    )
    return Table(columns=columns, rows=rows, caption="What is asked of the sensor, and what it will do.")


def _scalars(outcome: Outcome, names: tuple[str, ...], caption: str) -> Table:
    scalars = outcome.result.scalars
    rows = [
        (one.label, _scalar(outcome, name, one.value, one.format), shown_unit(one.unit), name)
        for name, one in ((name, scalars[name]) for name in names)
    ]
    return Table(columns=("Quantity", "Value", "Unit", "Name"), rows=rows, caption=caption)


def _swings(outcome: Outcome) -> Table:
    rows = []
    for swing in outcome.result.swings:
        ends = [end or {} for end in (swing.at_low, swing.at_high)]
        rows.append(
            (
                swing.label,
                swing.key,
                f"{swing.low:.3g} … {swing.high:.3g}".replace("-", "\N{MINUS SIGN}"),
                *(_pair(ends, name) for name in ("attitude_cross_arcsec", "single_star_arcsec")),
                _pair(ends, "limiting_magnitude_mag"),
                _pair(ends, "stars_worst_per_frame"),
            )
        )
    heads = (
        "What",
        "Key",
        "From … to",
        Column(name="Attitude across", unit="%", key="attitude_cross_percent"),
        Column(name="Single star", unit="%", key="single_star_percent"),
        Column(name="Magnitude", unit="mag", key="limiting_magnitude_mag"),
        Column(name="Stars, worst 1 %", unit="%", key="stars_worst_percent"),
    )
    return Table(
        columns=heads,
        rows=rows,
        caption="Change at the lower / upper value of each key, the others as they are.",
    )


def _pair(ends: list[dict[str, float]], name: str) -> str:
    scale, digits = (1.0, 2) if name.endswith("_mag") else (100.0, 1)
    known = [end and not math.isnan(end[name]) for end in ends]
    words = [f"{scale * end[name] + 0.0:+.{digits}f}" if one else "–" for one, end in zip(known, ends, strict=True)]
    return " / ".join(words).replace("-", "\N{MINUS SIGN}")


def _frames(outcome: Outcome) -> Table:
    rows = [
        (
            one.label,
            Measured(value=one.measured, uncertainty=one.error, n=one.n),
            one.predicted,
            shown_unit(one.unit),
            one.n,
            one.pull,
        )
        for one in outcome.result.compared
    ]
    columns = (
        "Quantity",
        Column(name="Measured in frames", key="measured"),
        Column(name="Predicted", key="predicted"),
        Column(name="Unit", key="unit"),
        Column(name="Samples", key="samples", format="d"),
        Column(name="Difference", unit="σ", key="difference_sigma", format=".1f"),
    )
    return Table(
        columns=columns,
        rows=rows,
        caption="Rendered frames beside the prediction for the same stars and attitudes.",
        note="The uncertainty is that of measured minus predicted, if the prediction is right.",
    )
