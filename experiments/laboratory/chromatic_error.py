"""Chromatic error of a camera (ACC18 eq. 13-16): a point target in the corners of the field, behind every filter."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from calib.accuracy.chromatic import Pair, shift_sigma, table1_sigma
from calib.measure.centroid_error.expected_windows import pattern_shifts_px
from calib.measure.centroid_error.linear_response import centroid_variance, linear_response, tight
from calib.measure.stamps import centre_of_gravity
from experiments.laboratory.bench.point_bench import Bench
from experiments.laboratory.bench.points import PointFrames, PointLight, filter_scene, read_points
from experiments.laboratory.devices.target import CORNERS, corner_directions
from optics.arrays import FloatArray
from render.engine.random import Streams
from render.records import ExpectedImage
from render.sensor_file.instrument import Instrument

PATTERNS = 48
"""Monte-Carlo fixed patterns of the pixels from which their effect on the centroids is predicted."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ChromaticMeasurement:
    """Centroids and truth of a lens; p positions, j points, b filters, by method where a mapping."""

    direction: FloatArray  # (p, j, 3) Unit vectors in the camera frame
    nominal_px: FloatArray  # (p, j, 2) Images by an ideal lens
    photon_px: FloatArray  # (p, j, b, 2) Truth: centroid of the noiseless image, within and outside the window
    pixels_px: FloatArray  # (p, j, b, 2) First moment of the noiseless pixels of the window
    mean_px: Mapping[str, FloatArray]  # (p, j, b, 2) Mean centroid over the frames
    sigma_px: Mapping[str, FloatArray]  # (p, j, b, 2) Standard deviation of a single frame's centroid
    noise_px: FloatArray  # (p, j, b, 2) Predicted ``sigma_px`` of the main method, without motion of the line of sight
    pattern_px: Mapping[str, FloatArray]  # (q, p, j, b, 2) Predicted effect of q fixed patterns, common to the filters
    frames_used: NDArray[np.int64]  # (p, j, b) Frames that converged, main method
    rms_spot_um: FloatArray  # (b,) RMS spot radius of the traced bundles
    example: ExpectedImage  # Noiseless image of the first position
    common_px: float = 0.0  # Standard deviation per axis of the line of sight from frame to frame

    @property
    def common_mean_px(self) -> float:
        """Standard deviation of the mean line of sight over the frames of a position."""
        return float(self.common_px / np.sqrt(self.frames_used.mean()))

    def shift_sigma(self, pairs: Sequence[Pair], method: str) -> dict[str, FloatArray]:
        """Standard deviation (p, j, 2) of every shift, by pair of bands."""
        variance_px2 = self.noise_px**2 + self.common_px**2
        errors = self.sigma_px[method], self.frames_used, self.pattern_px[method]
        return shift_sigma(*errors, pairs, variance_fraction=variance_px2)

    def table1_sigma(self, pairs: Sequence[Pair], method: str) -> dict[str, FloatArray]:
        """Standard deviation (2,) of an entry of Table 1, by pair of bands."""
        errors = self.sigma_px[method], self.frames_used, self.pattern_px[method]
        return table1_sigma(*errors, pairs, common_px=self.common_mean_px)


class _FilterReadout(NamedTuple):
    """Frames of the target at one position behind one filter."""

    light: PointLight
    frames: PointFrames
    noise_px: FloatArray  # (j, 2) Predicted standard deviation of a frame, main method
    pattern_px: dict[str, FloatArray]  # (q, j, 2) Predicted effect of fixed patterns


def _read_filter(
    light: PointLight, bench: Bench, instrument: Instrument, streams: Streams, position: str, methods: Sequence[str]
) -> _FilterReadout:
    frames = read_points(
        light,
        bench,
        instrument,
        streams=streams,
        motion_streams=streams.child(light.band),
        label=light.band,
        where=f"{position} position, filter {light.band}",
    )
    centroiders = light.centroiders(bench)
    pixel = instrument.pixel_noise()
    gain = linear_response(tight(centroiders[bench.methods[0]]), frames.stamps, frames.noise, light.light_e)
    pattern_px = {
        method: pattern_shifts_px(
            centroiders[method],
            frames.stamps,
            frames.noise,
            light.light_e,
            prnu=pixel.prnu,
            offset_e=float(np.sqrt(pixel.floor_e2 / bench.dark_frames)),
            draws=PATTERNS,
            rng=streams.generator("predicted pattern"),  # the same patterns for every filter
        )
        for method in methods
    }
    noise_px = np.sqrt(centroid_variance(gain, pixel.temporal_e2(light.light_e)))
    return _FilterReadout(light, frames, noise_px, pattern_px)


def measure_chromatic(
    bench: Bench,
    instrument: Instrument,
    streams: Streams,
    *,
    directions: FloatArray | None = None,
    patterns: Sequence[str] = (),
    advance: Callable[[], None] = lambda: None,
) -> ChromaticMeasurement:
    """Run the test on a lens; ``patterns``: methods with predicted effects of fixed patterns, by default the main."""
    scene = filter_scene(bench, instrument, by_grid=False)
    main = bench.methods[0]
    patterns = patterns or (main,)
    target = corner_directions(bench.target, instrument) if directions is None else directions
    readouts, images = [], []
    for position, direction in zip(CORNERS, target, strict=True):
        position_streams = streams.child(position)
        lights, image = scene.lights(direction, position_streams, position)
        readouts.append(
            [_read_filter(light, bench, instrument, position_streams, position, patterns) for light in lights]
        )
        images.append(image)
        advance()

    def stacked(part: Callable[[_FilterReadout], Any]) -> NDArray[Any]:
        """Arrays (..., j, 2) of every readout as (..., p, j, b, 2)."""
        return np.stack([np.stack([part(readout) for readout in row], axis=-2) for row in readouts], axis=-4)

    mean_px = stacked(lambda readout: [readout.frames.mean_px(method) for method in bench.methods])
    sigma_px = stacked(lambda readout: [readout.frames.sigma_px(method) for method in bench.methods])
    pattern_px = stacked(lambda readout: [readout.pattern_px[method] for method in patterns])
    return ChromaticMeasurement(
        direction=target,
        nominal_px=np.stack([row[0].light.nominal_px for row in readouts]),
        photon_px=stacked(lambda readout: readout.light.photon_px),
        pixels_px=stacked(lambda readout: readout.light.corner_px + centre_of_gravity(readout.light.light_e)),
        mean_px=dict(zip(bench.methods, mean_px, strict=True)),
        sigma_px=dict(zip(bench.methods, sigma_px, strict=True)),
        noise_px=stacked(lambda readout: readout.noise_px),
        pattern_px=dict(zip(patterns, pattern_px, strict=True)),
        frames_used=stacked(lambda readout: readout.frames.used(main)[:, None])[..., 0],
        rms_spot_um=np.mean([[readout.light.spot_um for readout in row] for row in readouts], axis=(0, 2)),
        example=images[0],
        common_px=bench.power_px2(instrument)[0] ** 0.5,
    )
