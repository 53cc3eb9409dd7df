"""The laboratory part of the chromatic test: the point target in the four corners of the field, behind every filter."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from experiments.laboratory.bench import Bench, point_field
from experiments.laboratory.instrument import Instrument
from experiments.laboratory.points import PointMeasurement, PointReadout
from experiments.laboratory.target import CORNERS, corner_directions
from optics.arrays import FloatArray
from render.engine.random import Streams
from render.forward import StarRenderer
from render.records import ExpectedImage, WindowStack
from render.tracing.psf import epsf_tracer

__all__ = ["Measurement", "measure"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Measurement:
    """Result for one lens; p positions, j points, b filters.

    Attributes
    ----------
    direction : (p, j, 3)
        Unit vectors in cam.
    nominal_px : (p, j, 2)
        Where an ideal lens would image the points.
    chief_px, bundle_px, photon_px : (p, j, b, 2)
        Truth.
    mean_px : dict of str to (p, j, b, 2)
        Mean centroid over the frames, by method.
    sigma_px : dict of str to (p, j, b, 2)
        Standard deviation of a single frame's centroid.
    pattern_px : (q, p, j, b, 2)
        Predicted effect of q fixed patterns on the first method's centroids, common to the filters.
    frames_used : (p, j, b)
        Frames that converged, first method.
    rms_spot_um : (b,)
        RMS spot radius of the traced bundles.
    example : ExpectedImage
        Noiseless image of the first position.
    windows : tuple of WindowStack
        Readout of the first position, per filter.
    """

    direction: FloatArray
    nominal_px: FloatArray
    chief_px: FloatArray
    bundle_px: FloatArray
    photon_px: FloatArray
    mean_px: Mapping[str, FloatArray]
    sigma_px: Mapping[str, FloatArray]
    pattern_px: FloatArray
    frames_used: NDArray[np.int64]
    rms_spot_um: FloatArray
    example: ExpectedImage
    windows: tuple[WindowStack, ...]


def measure(bench: Bench, instrument: Instrument, streams: Streams, *, advance: Callable[[], None]) -> Measurement:
    """Run the test on one lens.

    Parameters
    ----------
    bench, instrument
        The laboratory.
    streams : Streams
        Root of the noise of this run.
    advance : callable
        Called after each position.

    Raises
    ------
    DomainError
        If points are not detected, or saturated.
    """
    camera = instrument.camera
    renderer, tracer = StarRenderer(camera, exposure_s=instrument.config.exposure_s), epsf_tracer(camera)
    first: ExpectedImage | None = None
    parts: list[PointMeasurement] = []
    for place, direction in zip(CORNERS, corner_directions(bench.target, instrument), strict=True):
        stars = point_field(bench, instrument, direction)
        expected = renderer.render(stars)
        first = first or expected
        parts.append(PointReadout(tracer, bench, instrument, streams.child(place), place).measure(stars, expected))
        advance()
    assert first is not None
    return Measurement(
        direction=np.stack([part.direction for part in parts]),
        nominal_px=np.stack([part.nominal_px for part in parts]),
        chief_px=np.stack([part.chief_px for part in parts]),
        bundle_px=np.stack([part.bundle_px for part in parts]),
        photon_px=np.stack([part.photon_px for part in parts]),
        mean_px={m: np.stack([part.mean_px[m] for part in parts]) for m in bench.methods},
        sigma_px={m: np.stack([part.sigma_px[m] for part in parts]) for m in bench.methods},
        pattern_px=np.stack([part.pattern_px for part in parts], axis=1),
        frames_used=np.stack([part.frames_used for part in parts]),
        rms_spot_um=np.stack([part.spot_um for part in parts]).mean((0, 1)),
        example=first,
        windows=parts[0].windows,
    )
