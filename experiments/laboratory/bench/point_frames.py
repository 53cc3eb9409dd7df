"""Frames of point targets and their reduction: centroids of every point in every frame, by several methods."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from calib.measure.frame_positions import frame_statistics, measured_positions
from experiments.laboratory.bench.point_bench import Bench, centroiders, refuse_few_frames
from experiments.laboratory.bench.point_scene import PointLight
from experiments.laboratory.bench.readout.stamps import dark_subtracted, refuse_saturated, ring_subtracted
from experiments.laboratory.bench.readout.windows import WindowReader
from experiments.laboratory.bench.target_light import frame_light
from optics.arrays import FloatArray
from optics.errors import DomainError
from render.detector.spec import Detector
from render.engine.random import Streams
from render.records import WindowStack
from render.sensor_file.instrument import Instrument

Subtraction = Literal["dark", "raw"]
"""``dark``: minus the mean of frames with the lamp off. ``raw``: minus the nominal offset and one background value per
window, from the outermost ring of its mean frame; fixed patterns stay."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PointFrames:
    """Centroids of j points in f frames."""

    position_px: Mapping[str, FloatArray]  # (f, j, 2) By method; NaN where a frame gave none
    windows: WindowStack  # The readout

    def __post_init__(self) -> None:
        for value in self.position_px.values():
            if value.ndim != 3 or value.shape[2] != 2:
                raise DomainError(f"PointFrames.position_px: shape {value.shape} where (frames, points, 2) is needed")

    def mean_px(self, method: str) -> FloatArray:
        """Mean over the frames (j, 2)."""
        return frame_statistics(self.position_px[method])[0]

    def sigma_px(self, method: str) -> FloatArray:
        """Standard deviation of a single frame (j, 2)."""
        return frame_statistics(self.position_px[method])[1]


def read_points(
    light: PointLight,
    bench: Bench,
    instrument: Instrument,
    *,
    streams: Streams,
    dark_streams: Streams | None = None,
    signal_ratio: float = 1.0,
    detector: Detector | None = None,
    subtraction: Subtraction = "dark",
    mask_defects: bool = True,
) -> PointFrames:
    """Read out frames of a target and centroid its points."""
    reader = WindowReader(instrument if detector is None else replace(instrument, detector=detector), streams)
    light_e = frame_light(light.light_e, light.corner_px, light.bundle_px, light.psf, bench, instrument, streams)
    lit = reader.expose(light_e * signal_ratio, light.corner_px, frames=bench.frames, label="lamp")
    stack = lit if mask_defects else replace(lit, defect=np.zeros_like(lit.defect))
    if subtraction == "dark":
        night = reader if dark_streams is None else replace(reader, streams=dark_streams)
        stamps, noise = dark_subtracted(stack, night.dark(light.corner_px, bench.window_px, frames=bench.dark_frames))
    else:
        stamps, noise = ring_subtracted(stack, light.found_px)
    where = f"target points at {bench.signal_e * signal_ratio:g} e- per frame"
    refuse_saturated(stamps, len(light), where=where, advice="lower signal_e or the highest level")
    position = {
        name: measured_positions(centroider, stamps, noise, bench.frames)
        for name, centroider in centroiders(bench, light.psf).items()
    }
    refuse_few_frames(position[bench.methods[0]], bench.methods[0], where=where)
    return PointFrames(position_px=position, windows=stack)
