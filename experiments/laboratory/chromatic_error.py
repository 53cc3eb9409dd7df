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
"""Independent fixed patterns from which their effect on the centroids is predicted."""


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


class _FilterReadout(NamedTuple):
    """The target at a position behind one filter."""

    light: PointLight
    frames: PointFrames
    noise_px: FloatArray  # (j, 2) Predicted standard deviation of a frame, first method
    pattern_px: dict[str, FloatArray]  # (q, j, 2) Predicted effect of fixed patterns


def _read(
    light: PointLight, bench: Bench, instrument: Instrument, streams: Streams, place: str, methods: Sequence[str]
) -> _FilterReadout:
    frames = read_points(
        light,
        bench,
        instrument,
        streams=streams,
        motion_streams=streams.child(light.band),
        label=light.band,
        where=f"{place} position, filter {light.band}",
    )
    centroiders, pixel = light.centroiders(bench), instrument.pixel_noise()
    gain = linear_response(tight(centroiders[bench.methods[0]]), frames.stamps, frames.noise, light.light_e)
    shifts = {
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
    return _FilterReadout(light, frames, np.sqrt(centroid_variance(gain, pixel.temporal_e2(light.light_e))), shifts)


def measure_chromatic(
    bench: Bench,
    instrument: Instrument,
    streams: Streams,
    *,
    directions: FloatArray | None = None,
    patterns: Sequence[str] = (),
    advance: Callable[[], None] = lambda: None,
) -> ChromaticMeasurement:
    """Run the test on one lens; effects of fixed patterns are predicted for some methods, or for the first."""
    scene, first = filter_scene(bench, instrument, by_grid=False), bench.methods[0]
    points = corner_directions(bench.target, instrument) if directions is None else directions
    cells, images = [], []
    for place, direction in zip(CORNERS, points, strict=True):
        here = streams.child(place)
        lights, image = scene.lights(direction, here, place)
        cells.append([_read(light, bench, instrument, here, place, patterns or (first,)) for light in lights])
        images.append(image)
        advance()

    def stacked(part: Callable[[_FilterReadout], NDArray[Any]], band: int = 1, place: int = 0) -> NDArray[Any]:
        return np.stack([np.stack([part(cell) for cell in row], axis=band) for row in cells], axis=place)

    def by_method(
        methods: Sequence[str], part: Callable[[_FilterReadout, str], FloatArray], *axes: int
    ) -> dict[str, FloatArray]:
        found = {}
        for method in methods:

            def of_method(cell: _FilterReadout, method: str = method) -> FloatArray:
                return part(cell, method)

            found[method] = stacked(of_method, *axes)
        return found

    return ChromaticMeasurement(
        direction=np.stack([row[0].light.direction for row in cells]),
        nominal_px=np.stack([row[0].light.nominal_px for row in cells]),
        photon_px=stacked(lambda cell: cell.light.photon_px),
        pixels_px=stacked(lambda cell: cell.light.corner_px + centre_of_gravity(cell.light.light_e)),
        mean_px=by_method(bench.methods, lambda cell, method: cell.frames.mean_px(method)),
        sigma_px=by_method(bench.methods, lambda cell, method: cell.frames.sigma_px(method)),
        noise_px=stacked(lambda cell: cell.noise_px),
        pattern_px=by_method(patterns or (first,), lambda cell, method: cell.pattern_px[method], 2, 1),
        frames_used=stacked(lambda cell: cell.frames.used(first)),
        rms_spot_um=stacked(lambda cell: cell.light.spot_um).mean((0, 1)),
        example=images[0],
        common_px=bench.power_px2(instrument)[0] ** 0.5,
    )
