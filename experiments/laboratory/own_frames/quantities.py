"""The numbers of frames from outside, each described once."""

from __future__ import annotations

import numpy as np

from experiments.harness.quantities import Quantities
from experiments.laboratory.distortion_statistics import LABELS
from experiments.laboratory.own_frames.experiment import FramesResult
from experiments.laboratory.own_frames.reduction import GridFrames, StepFrames, TemporalFrames
from experiments.laboratory.point_quantities import point_quantities
from experiments.laboratory.temporal_error import small_sample_factor

__all__ = ["describe"]


def describe(result: FramesResult) -> Quantities:
    """Quantities of a folder: those of the test, its series, and the points of the last series."""
    q, reduced, folder = point_quantities(result.methods), result.reduced, result.folder
    series, head = reduced.series, "Position" if isinstance(reduced, StepFrames) else "Series"
    q.axis("series", np.arange(len(series)) + 1, head, names=[one.name for one in series])
    q.add("source", "frames", "Source")
    if isinstance(reduced, TemporalFrames):
        _temporal(q, reduced, result.methods)
    elif isinstance(reduced, StepFrames):
        _steps(q, reduced, result.methods)
    else:
        _grid(q, reduced, result.methods)
    every, signal = {"dims": "series"}, [one.signal_e for one in series]
    q.add("series_name", [one.name for one in series], "Name", **every, json="series[series].name")
    q.add("frames", [one.frames for one in series], "Frames", **every, json="series[series].frames")
    q.add("signal_e", signal, "Signal", unit="e-", **every, format=".0f", json="series[series].signal_e")
    usable = [one.usable_fraction for one in series]
    q.add("usable_fraction", usable, "Usable", **every, format=".3f", json="series[series].usable_fraction")
    last = series[-1].points
    q.axis("point", np.arange(len(folder.series[0].found_px)) + 1, "Point")
    for name, label, values in (
        ("mean", "Mean", last.mean_px(result.methods[0])),
        ("sigma", "σ", last.sigma_px(result.methods[0])),
    ):
        key = f"{name}_{{axis}}_px"
        q.add(f"{name}_px", values, label, unit="px", dims="point axis", format=".4f", key=key, json="")
    q.add("points", len(folder.series[0].found_px), "Points")
    q.add("dark_frames", folder.dark_frames, "Frames with the lamp off")
    q.add("frame_size_px", [folder.width_px, folder.height_px], "Size of a frame", unit="px", dims="side")
    q.add("pixel_arcsec", reduced.pixel_arcsec, "Angle of a pixel", unit="arcsec")
    return q


def _temporal(q: Quantities, reduced: TemporalFrames, methods: tuple[str, ...]) -> None:
    """Temporal error (ACC18 eq. 1-2) of every series, beside what the stated noise gives."""
    levels = range(len(reduced.series))
    found = [[reduced.te_arcsec(m, n) for m in methods] for n in levels]
    model = np.array([[reduced.predicted_te_arcsec(m, n) for m in methods] for n in levels])
    c4 = np.array([small_sample_factor(one.frames) for one in reduced.series])[:, None, None]
    value = np.array([[[one.value for one in pair] for pair in row] for row in found])
    angle = {"unit": "arcsec", "dims": "series method axis"}
    q.add("measured_arcsec", found, "Measured", **angle, json="temporal_error_arcsec_3sigma")
    q.add("noise_model_arcsec", model, "Noise model", **angle, format=".4f", json="noise_model_arcsec_3sigma")
    q.add("ratio", value / (c4 * model), "Ratio", dims="series method axis", format=".3f", json="")


def _steps(q: Quantities, reduced: StepFrames, methods: tuple[str, ...]) -> None:
    """High spatial frequency error (ACC18 eq. 3-12), and the shift of the image at every position."""
    angle = {"unit": "arcsec", "dims": "method axis"}
    found = [reduced.document_arcsec(m) for m in methods]
    q.add("hsfe_arcsec", found, "As printed", **angle, json="hsfe_arcsec_3sigma")
    halved, place = [reduced.halved_arcsec(m) for m in methods], "single_position_arcsec_3sigma"
    q.add("single_arcsec", halved, "One position", **angle, format=".4f", json=place)
    shift = {"unit": "px", "dims": "series axis", "format": ".4f"}
    q.add("seen_px", reduced.common_px(methods[0]), "Seen", **shift, key="seen_{axis}_px", json="common_shift_px")
    q.add("commanded_px", reduced.shift_px, "Commanded", **shift, key="commanded_{axis}_px", json="")


def _grid(q: Quantities, reduced: GridFrames, methods: tuple[str, ...]) -> None:
    """Distortion error (ACC18 eq. 17-30)."""
    scale = 3.0 * reduced.pixel_arcsec
    q.axis("reference", list(reduced.references), "Reference")
    every = [[reduced.statistics(m, r) for r in reduced.references] for m in methods]
    for name, json, label, field in (
        ("sigma_d_arcsec", "sigma_d", LABELS[0], "sigma_d_px"),
        ("sigma_left_arcsec", "sigma_Dd", LABELS[1], "sigma_left_px"),
        ("sigma_c1_arcsec", "sigma_C1", LABELS[2], "sigma_c1_px"),
    ):
        values = scale * np.array([[getattr(one, field) for one in row] for row in every])
        place = f"distortion_arcsec_3sigma[method][reference].{json}"
        q.add(name, values, label, unit="arcsec", dims="method reference axis", format=".3f", json=place)
    q.add("order", reduced.order, "Order of the polynomial")
