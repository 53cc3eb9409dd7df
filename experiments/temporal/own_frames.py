"""Temporal error of a laboratory's own frames (ACC18 eq. 1-2): every series is a signal level."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from calib.accuracy.temporal import scatter_interval, small_sample_factor, temporal_error
from experiments.harness.drawings import curves
from experiments.harness.sections import Section, col
from experiments.harness.summary import Measured
from experiments.harness.summary import measured as with_error
from experiments.reduce.folder import FrameFolder
from experiments.reduce.frames_toml import FolderLayout
from experiments.reduce.pipeline import POINTS, POINTS_CAPTION, FramesTest, Reduced, tabulate_points
from experiments.reduce.series import SeriesFrames, reduce_series
from optics.arrays import FloatArray


@dataclass(frozen=True, slots=True, kw_only=True)
class SeriesScatter:
    """Temporal error of a series (3 sigma), and its prediction from the stated camera noise."""

    measured_arcsec: Sequence[Sequence[Measured]] = col("Measured", "arcsec", dims="method axis")
    low_arcsec: FloatArray = col("95 % from", "arcsec", dims="method axis")
    high_arcsec: FloatArray = col("to", "arcsec", dims="method axis")
    noise_model_arcsec: FloatArray = col("Noise model", "arcsec", ".4f", "method axis")
    ratio: FloatArray = col("Ratio", "", ".3f", "method axis")


def reduce_level(series: SeriesFrames, methods: Sequence[str], pixel_arcsec: float) -> SeriesScatter:
    """Temporal error of a series; the ratio is corrected for the small-sample factor of the measured values."""
    terms = [temporal_error(series.points.sigma_px(method), pixel_arcsec, series.frames) for method in methods]
    model = np.array([3.0 * pixel_arcsec * series.predicted_px(method).mean(0) for method in methods])
    value = np.array([term.arcsec for term in terms])
    error = np.array([series.widening(m) * term.uncertainty_arcsec for m, term in zip(methods, terms, strict=True)])
    unbiased = value / small_sample_factor(series.frames)
    low, high = scatter_interval(unbiased, error / value)
    return SeriesScatter(
        measured_arcsec=with_error(value, error, n=terms[0].n, unit="arcsec"),
        low_arcsec=low,
        high_arcsec=high,
        noise_model_arcsec=model,
        ratio=unbiased / model,
    )


def reduce(folder: FrameFolder, methods: Sequence[str], config: Any = None) -> Reduced:
    """Temporal error of every series of a folder.

    Raises
    ------
    StarbenchError
        As `reduce_series`.
    """
    reduced = [reduce_series(folder, series, methods, every_model=True) for series in folder.series]
    levels = [reduce_level(series, methods, folder.settings.pixel_arcsec) for series in reduced]
    return reduced, {"levels": levels, **tabulate_points(folder, reduced[-1], methods[0])}


own_frames = FramesTest(
    title="Temporal error",
    layout=FolderLayout(),
    reduce=reduce,
    sections={
        "levels": Section(
            record=SeriesScatter,
            dim="series",
            table="temporal_error",
            rows="series method axis",
            columns="frames signal_e measured_arcsec low_arcsec high_arcsec noise_model_arcsec ratio",
            caption="Temporal error (ACC18 eq. 1-2, 3 σ) of every series, and its prediction from the stated "
            "camera noise.",
            note="Measured values include the small-sample bias of a standard deviation; *Ratio* and "
            "interval are corrected for it (chi-square interval, widened for common motion of the "
            "points and correlation of the frames).",
            figures={
                "levels": curves(
                    "signal_e",
                    points="measured_arcsec",
                    lines="noise_model_arcsec",
                    by="method",
                    panels="axis",
                    y="Temporal error, 3 σ",
                )
            },
        ),
        **POINTS,
    },
    head={"Temporal error (3 σ)": ("measured_arcsec", {"series": -1, "method": 0})},
    captions={"levels": "Points: measured; lines: the noise model.", **POINTS_CAPTION},
)
