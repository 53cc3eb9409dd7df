"""A star at many positions on the detector: windows around it, read out, reduced, with predicted noise.

At every position the star is searched in a wide window, then a small window around it is read out many times, and as
often with the lamp off. The measurement is the mean centroid over the frames. Its covariance is predicted from the
linear response of the centroider to each pixel, by the noise of that pixel: photons, read noise, rounding and dark
current over the number of frames, the same of the dark frames, and the response pattern (PRNU), which averaging does
not reduce.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calib.measure.centroid_error.linear_response import centroid_covariance, centroid_variance, linear_response
from calib.measure.centroiding.registry import get_centroider
from calib.measure.reduced_windows import dark_subtracted, refuse_saturated
from calib.measure.statistics.frame_positions import frame_statistics, measured_positions
from experiments.laboratory.bench.point_bench import refuse_few_frames
from experiments.laboratory.bench.readout.search import find_star
from experiments.laboratory.bench.readout.windows import WindowReader, cut_windows, window_corners
from optics.arrays import FloatArray
from optics.records import freeze
from render.engine.random import Streams
from render.records import EffectivePsf, ExpectedImage
from render.sensor_file.instrument import Instrument


@dataclass(frozen=True, slots=True, kw_only=True)
class WindowPlan:
    """Side of the windows [px], frames with the star, frames with the lamp off."""

    size_px: int
    frames: int
    dark_frames: int


@dataclass(frozen=True, slots=True, kw_only=True)
class StarReadings:
    """Mean centroids of a star at n positions."""

    position_px: FloatArray  # (n, 2) Mean over the frames
    covariance_px2: FloatArray  # (n, 2, 2) Of the mean, predicted (see the module)
    temporal_px: FloatArray  # (n, 2) Standard deviation of a single frame's centroid, measured
    predicted_temporal_px: FloatArray  # (n, 2) Its prediction

    def __post_init__(self) -> None:
        sizes: dict[str, int] = {}
        for name in ("position_px", "temporal_px", "predicted_temporal_px"):
            freeze(self, name, shape=("n", 2), sizes=sizes)
        freeze(self, "covariance_px2", shape=("n", 2, 2), sizes=sizes)

    @property
    def sigma_px(self) -> FloatArray:
        """Standard deviations (n, 2) of the mean."""
        return np.sqrt(np.diagonal(self.covariance_px2, axis1=1, axis2=2))


def read_windows(
    expected: ExpectedImage,
    near_px: FloatArray,
    psfs: Sequence[EffectivePsf],
    instrument: Instrument,
    plan: WindowPlan,
    *,
    streams: Streams,
) -> StarReadings:
    """Detect the star at every position, read windows around it, and reduce them."""
    reader, light_px = WindowReader(instrument, streams), expected.electrons[:, :, 0]
    centre = find_star(reader, light_px, near_px)
    size = instrument.camera.width_px, instrument.camera.height_px
    corner = window_corners(centre, plan.size_px, size, where="the star", advice="keep farther from the edge")
    light = cut_windows(light_px, corner, plan.size_px)
    stack = reader.expose(light, corner, frames=plan.frames, label="star")
    stamps, noise = dark_subtracted(stack, reader.dark(corner, plan.size_px, frames=plan.dark_frames))
    brightest = float(light.sum((1, 2)).max())
    advice = f"lower the signal (up to {brightest:.0f} e- in a window)"
    refuse_saturated(stamps, len(centre), where="the star", advice=advice)
    centroider = get_centroider("epsf", epsf=list(psfs))
    position = measured_positions(centroider, stamps, noise, plan.frames)
    refuse_few_frames(position, "epsf", where="the star")
    mean, temporal, _ = frame_statistics(position)
    light_e, pixel = light.astype(np.float64), instrument.pixel_noise()
    gain = linear_response(centroider, stamps.select(slice(0, len(centre))), noise, light_e)
    mean_e2 = pixel.temporal_e2(light_e, frames=plan.frames, dark_frames=plan.dark_frames) + pixel.response_e2(light_e)
    return StarReadings(
        position_px=mean,
        covariance_px2=centroid_covariance(gain, mean_e2),
        temporal_px=temporal,
        predicted_temporal_px=np.sqrt(centroid_variance(gain, pixel.temporal_e2(light_e))),
    )
