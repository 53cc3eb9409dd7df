"""Chromatic error of a camera (ACC18 eq. 13-16): a point target in the corners of the field, behind every filter."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from experiments.laboratory.bench.point_bench import Bench
from experiments.laboratory.bench.points import PointMeasurement, PointReadout
from experiments.laboratory.bench.target_light import target_light
from experiments.laboratory.devices.target import CORNERS, corner_directions
from optics.arrays import FloatArray
from render.engine.random import Streams
from render.records import ExpectedImage, WindowStack
from render.sensor_file.instrument import Instrument

CALIBRATIONS = {"as found": [], "principal point": [0, 1], "focal length": [2], "both": [0, 1, 2]}
"""Parameters that a camera model may have per band -> its columns in the design of `after_calibration`."""


def shifts(position_px: FloatArray, pairs: Sequence[tuple[str, int, int]]) -> dict[str, FloatArray]:
    """Shift (..., 2) of every point for each pair of bands, from positions (..., b, 2); ACC18 eq. 15."""
    return {name: position_px[..., high, :] - position_px[..., low, :] for name, high, low in pairs}


def table1(shift_px: FloatArray) -> FloatArray:
    """Signed mean over positions and points, halved (ACC18 eq. 16): (..., p, j, 2) -> (..., 2)."""
    return np.asarray(shift_px.mean((-3, -2)) / 2.0)


def rms(shift_px: FloatArray) -> FloatArray:
    """Root mean square per axis over positions and points, (p, j, 2) -> (2,)."""
    return np.asarray(np.sqrt((shift_px**2).mean((0, 1))))


def after_calibration(shift_px: FloatArray, from_centre_px: FloatArray) -> dict[str, FloatArray]:
    """Shifts that remain when a camera model has parameters of its own for the band."""
    shift, place = shift_px.reshape(-1, 2), from_centre_px.reshape(-1, 2)
    one = np.zeros((len(shift), 2, 3))
    one[:, 0, 0] = one[:, 1, 1] = 1.0
    one[:, :, 2] = place
    design, data = one.reshape(-1, 3), shift.ravel()
    left = {}
    for name, use in CALIBRATIONS.items():
        fit = design[:, use] @ np.linalg.lstsq(design[:, use], data, rcond=None)[0] if use else np.zeros_like(data)
        left[name] = (data - fit).reshape(shift_px.shape)
    return left


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


def shift_sigma(
    measured: ChromaticMeasurement, pairs: Sequence[tuple[str, int, int]], method: str
) -> dict[str, FloatArray]:
    """Standard deviation (p, j, 2) of every shift, by pair of bands.

    The scatter of the frames, pooled over the points of a position (one point's own estimate from 30 frames would have
    pulls of Student's law), and shared out among them as predicted: the centroid error of a small spot changes by a
    factor of three with its place on the pixels.
    """
    pattern = shifts(measured.pattern_px[method], pairs)
    share = measured.noise_px**2 + measured.common_px**2
    of_frame = share * (measured.sigma_px[method] ** 2 / share).mean(1, keepdims=True)
    of_mean = of_frame / measured.frames_used[..., None]
    return {
        name: np.sqrt(of_mean[..., high, :] + of_mean[..., low, :] + (pattern[name] ** 2).mean(0))
        for name, high, low in pairs
    }


def table1_sigma(
    measured: ChromaticMeasurement, pairs: Sequence[tuple[str, int, int]], method: str
) -> dict[str, FloatArray]:
    """Standard deviation (2,) of the mean of eq. 16, by pair of bands; any method with its effect of fixed patterns."""
    pattern = shifts(measured.pattern_px[method], pairs)
    of_mean = (measured.sigma_px[method] ** 2).mean(1, keepdims=True) / measured.frames_used[..., None]
    sigma = {}
    for name, high, low in pairs:
        temporal = of_mean[..., high, :] + of_mean[..., low, :]
        count = temporal.shape[0] * temporal.shape[1]
        # what the points of a position have in common does not average over them
        common = 2.0 * measured.common_mean_px**2 * (1.0 / temporal.shape[0] - 1.0 / count) / 4.0
        own = temporal.sum((0, 1)) / (2 * count) ** 2
        sigma[name] = np.sqrt(own + common + (table1(pattern[name]) ** 2).mean(0))
    return sigma
