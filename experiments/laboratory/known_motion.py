"""Motions of known size put into the scene: what a reduction has to give back, whatever its equations are.

The size of a motion on the detector is that between the places of both ends by the NumPy trace (no renderer, image or
centroid takes part). All motions are whole pixels: what a centroider makes of the place within a pixel is the same at
both ends. Two motions, one for each kind of error of ACC18:

* a target that stands at two places for half of the frames each: the scatter over the frames is known (eq. 1-2);
* points that walk about the platform's path, each for itself: the RMS of their steps is known (eq. 3-12).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from experiments.harness.summary import Measured
from experiments.laboratory.bench import Bench
from experiments.laboratory.hexapod import Hexapod
from experiments.laboratory.high_frequency import HighFrequencyMeasurement, StepPlan, measure_high_frequency
from experiments.laboratory.instrument import Instrument
from experiments.laboratory.point_frames import Subtraction, read_points
from experiments.laboratory.point_scene import PointScene, one_filter
from experiments.laboratory.ray_prediction import expected_spots
from experiments.laboratory.readout.centroids import frame_statistics
from experiments.laboratory.target import nudged
from experiments.laboratory.temporal_error import temporal_error_arcsec
from optics.arrays import FloatArray
from render.engine.random import Streams
from render.records import EffectivePsf

__all__ = [
    "ShakenTarget",
    "WalkingPoints",
    "measure_shaken",
    "measure_walking",
    "traced_motion_px",
]

SHAKE_PX = (2.0, 1.0)
"""Distance between the two places of the target."""
WALK_PX = (1.0, 2.0)
"""Motion of a point from one position to the next, besides that of the platform."""
WALK_POSITIONS = 4


def traced_motion_px(bench: Bench, instrument: Instrument, before: FloatArray, after: FloatArray) -> FloatArray:
    """Motion (m, j, 2) [px] of the images of points whose directions (m, j, 3) change, behind the reference filter."""
    places = [expected_spots(one_filter(bench), instrument, one)[0][:, :, 0] for one in (before, after)]
    return places[1] - places[0]


@dataclass(frozen=True, slots=True, kw_only=True)
class ShakenTarget:
    """Frames of a target that stood at two places, j stars."""

    # (f, j, 2) Centroids by method: first the frames at one place, then those at the other
    position_px: Mapping[str, FloatArray]
    frames: tuple[int, int]  # (int, int) At each place
    motion_px: FloatArray  # (j, 2) From the first place to the second, by the NumPy trace
    pixel_arcsec: float  # Angle of a pixel

    def te_arcsec(self, method: str) -> tuple[Measured, Measured]:
        """Temporal error of these frames, x and y, as that of frames at rest (`temporal_error_arcsec`)."""
        sigma_px = frame_statistics(self.position_px[method])[1]
        return temporal_error_arcsec(sigma_px, self.pixel_arcsec, sum(self.frames))

    @property
    def motion_arcsec(self) -> FloatArray:
        """Three standard deviations (2,) of the motion, mean of the stars: those of two values that come so often."""
        first, second = self.frames
        count = first + second
        deviation = np.abs(self.motion_px) * np.sqrt(first * second / (count * (count - 1.0)))
        return np.asarray(3.0 * self.pixel_arcsec * deviation.mean(0))


def measure_shaken(
    scene: PointScene, direction: FloatArray, psf: Sequence[EffectivePsf], streams: Streams
) -> ShakenTarget:
    """Half of the frames with the target to one side of its place, half with it to the other."""
    bench, instrument = scene.bench, scene.instrument
    count = (bench.frames // 2, bench.frames - bench.frames // 2)
    ends = [nudged(instrument, direction, side * np.array(SHAKE_PX)) for side in (-0.5, 0.5)]
    parts = []
    for number, (end, frames) in enumerate(zip(ends, count, strict=True)):
        here = streams.child("place", number)
        light = scene.light(end, here, f"place {number + 1}", psf=psf)
        # two frames are the fewest that a readout reduces
        found = read_points(light, replace(bench, frames=max(frames, 2)), instrument, streams=here)
        parts.append({method: position[:frames] for method, position in found.position_px.items()})
    return ShakenTarget(
        position_px={m: np.concatenate([one[m] for one in parts]) for m in bench.methods},
        frames=count,
        motion_px=traced_motion_px(bench, instrument, ends[0][None], ends[1][None])[0],
        pixel_arcsec=instrument.pixel_arcsec,
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class WalkingPoints:
    """A step test of few positions in which every point moves for itself too."""

    measured: HighFrequencyMeasurement  # The test, no cause switched off
    # (2,) RMS over points and steps of the points' own steps without their mean: closed form, the scale by the trace
    walk_rms_px: FloatArray

    @property
    def walk_arcsec(self) -> FloatArray:
        """Three times it as an angle (2,): the document's figure of a camera without error."""
        return 3.0 * self.measured.pixel_arcsec * self.walk_rms_px


def walk_px(positions: int, stars: int) -> FloatArray:
    """Own motion (m, j, 2) of the points: forth and back, every other point the other way."""
    side = np.where((np.arange(positions)[:, None] + np.arange(stars)) % 2, 0.5, -0.5)
    return np.asarray(side[..., None] * np.array(WALK_PX))


def measure_walking(
    scene: PointScene,
    hexapod: Hexapod,
    plan: StepPlan,
    rest: FloatArray,
    streams: Streams,
    *,
    place_px: Sequence[float] | None = None,
    subtraction: Subtraction = "dark",
) -> WalkingPoints:
    """Step a target whose points walk."""
    instrument = scene.instrument
    walk = walk_px(WALK_POSITIONS, len(rest))
    measured = measure_high_frequency(
        scene.bench,
        instrument,
        hexapod,
        replace(plan, positions=WALK_POSITIONS),
        place_px=place_px,
        subtraction=subtraction,
        split=False,
        walk_px=walk,
        streams=streams,
        scene=scene,
    )
    still = np.broadcast_to(rest, (len(walk), *rest.shape))
    seen = traced_motion_px(scene.bench, instrument, still, nudged(instrument, still, walk))
    scale = np.sqrt((seen**2).mean((0, 1)) / (walk**2).mean((0, 1)))
    # of an odd number of points one is left over: the mean over the points is a step of 1 / W, which is removed
    left = np.sqrt(1.0 - (len(rest) % 2) / len(rest) ** 2)
    return WalkingPoints(measured=measured, walk_rms_px=left * scale * np.array(WALK_PX))
