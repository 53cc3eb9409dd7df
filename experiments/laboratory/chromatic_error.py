"""Chromatic error of a camera (ACC18 eq. 13-16): a point target in the corners of the field, behind every filter."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calib.accuracy.chromatic import Pair, shift_sigma, table1_sigma
from experiments.laboratory.bench.point_bench import Bench
from experiments.laboratory.bench.points import PointMeasurement, PointReadout
from experiments.laboratory.bench.target_light import target_light
from experiments.laboratory.devices.target import CORNERS, corner_directions
from optics.arrays import FloatArray
from render.engine.random import Streams
from render.records import ExpectedImage, WindowStack
from render.sensor_file.instrument import Instrument


@dataclass(frozen=True, slots=True, kw_only=True)
class ChromaticMeasurement:
    """Centroids and truth of one lens; p positions, j points, b filters."""

    direction: FloatArray  # (p, j, 3) Unit vectors in cam
    nominal_px: FloatArray  # (p, j, 2) Where an ideal lens would image the points
    photon_px: FloatArray  # (p, j, b, 2) Truth: mean of all light, in the window or beyond
    pixels_px: FloatArray  # (p, j, b, 2) First moment of the noiseless pixels of the window, as rendered
    mean_px: Mapping[str, FloatArray]  # (p, j, b, 2) Mean centroid over the frames, by method
    sigma_px: Mapping[str, FloatArray]  # (p, j, b, 2) Standard deviation of a single frame's centroid
    # (p, j, b, 2) The same as predicted, first method; without what moves all points of a position
    noise_px: FloatArray
    # (q, p, j, b, 2) Predicted effect of q fixed patterns on the centroids, common to the filters, by method
    pattern_px: Mapping[str, FloatArray]
    frames_used: NDArray[np.int64]  # (p, j, b) Frames that converged, first method
    rms_spot_um: FloatArray  # (b,) RMS spot radius of the traced bundles
    example: ExpectedImage  # Noiseless image of the first position
    windows: tuple[WindowStack, ...]  # Readout of the first position, per filter
    # Standard deviation per axis of the line of sight from frame to frame, the same for all points of a position
    common_px: float = 0.0

    @property
    def common_mean_px(self) -> float:
        """The same of the mean over the frames of a position."""
        return float(self.common_px / np.sqrt(self.frames_used.mean()))

    def shift_sigma(self, pairs: Sequence[Pair], method: str) -> dict[str, FloatArray]:
        """Standard deviation (p, j, 2) of every shift, by pair of bands."""
        sampled = self.sigma_px[method], self.frames_used, self.pattern_px[method]
        return shift_sigma(*sampled, pairs, variance_fraction=self.noise_px**2 + self.common_px**2)

    def table1_sigma(self, pairs: Sequence[Pair], method: str) -> dict[str, FloatArray]:
        """Standard deviation (2,) of an entry of Table 1, by pair; any method with its effect of fixed patterns."""
        sampled = self.sigma_px[method], self.frames_used, self.pattern_px[method]
        return table1_sigma(*sampled, pairs, common_px=self.common_mean_px)


def measure_chromatic(
    bench: Bench,
    instrument: Instrument,
    streams: Streams,
    *,
    directions: FloatArray | None = None,
    patterns: Sequence[str] = (),
    advance: Callable[[], None] = lambda: None,
) -> ChromaticMeasurement:
    """Run the test on one lens."""
    target = target_light(bench, instrument, by_grid=False)
    first: ExpectedImage | None = None
    parts: list[PointMeasurement] = []
    points = corner_directions(bench.target, instrument) if directions is None else directions
    for place, direction in zip(CORNERS, points, strict=True):
        readout = PointReadout(bench, instrument, streams.child(place), place, patterns)
        part, expected = readout.measure(target, direction)
        first = first or expected
        parts.append(part)
        advance()
    assert first is not None
    return ChromaticMeasurement(
        direction=np.stack([part.direction for part in parts]),
        nominal_px=np.stack([part.nominal_px for part in parts]),
        photon_px=np.stack([part.photon_px for part in parts]),
        pixels_px=np.stack([part.pixels_px for part in parts]),
        mean_px={m: np.stack([part.mean_px[m] for part in parts]) for m in bench.methods},
        sigma_px={m: np.stack([part.sigma_px[m] for part in parts]) for m in bench.methods},
        noise_px=np.stack([part.noise_px for part in parts]),
        pattern_px={m: np.stack([part.pattern_px[m] for part in parts], axis=1) for m in parts[0].pattern_px},
        frames_used=np.stack([part.frames_used for part in parts]),
        rms_spot_um=np.stack([part.spot_um for part in parts]).mean((0, 1)),
        example=first,
        windows=parts[0].windows,
        common_px=bench.power_px2(instrument)[0] ** 0.5,
    )
