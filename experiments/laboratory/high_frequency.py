"""High spatial frequency error (ACC18 eq. 3-12) measured: small steps of a hexapod, causes switched off one by one.

Every cause is measured twice on the same random streams: *alone* (a detector with only this cause, against one without
any) and *switched off* (all causes, against all but this). Both are differences of mean centroids from frames with the
same noise, which therefore largely cancels; its remainder (another rounding, another Poisson variate) is estimated from
the scatter of the difference over the frames and subtracted.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from calib.accuracy.error_budget import ErrorTerm
from calib.accuracy.high_frequency import (
    high_frequency_error,
    position_rms_px,
    step_rms_px,
)
from calib.accuracy.step_prediction import CAUSES
from calib.measure.frame_positions import common_motion_px2
from calib.measure.stamps import noiseless_stamps
from experiments.laboratory.bench.point_bench import Bench, centroiders, motion_method
from experiments.laboratory.bench.points import PointFrames, PointLight, PointScene, Subtraction, read_points, scene_of
from experiments.laboratory.bench.readout.noise_model import nominal_noise
from experiments.laboratory.devices.hexapod import Hexapod, HexapodPath, step_path, turned
from experiments.laboratory.temporal_error import target_place
from optics.arrays import FloatArray
from optics.errors import DomainError
from optics.units import ARCSEC_RAD
from render.detector.spec import Detector
from render.engine.random import Streams
from render.sensor_file.instrument import Instrument

SWITCHES: Mapping[str, Mapping[str, float]] = {
    "prnu": {"prnu": 0.0},
    "pattern": {"dsnu_e": 0.0, "column_pattern_e": 0.0, "dark_spread_e_per_s": 0.0},
    "defects": {"hot_fraction": 0.0, "dead_fraction": 0.0},
}
"""What to set in a detector to switch a cause off."""


@dataclass(frozen=True, slots=True, kw_only=True)
class StepPlan:
    """The test: positions along a line."""

    positions: int = 12  # M. The document counts 0, 0.2 ... 2.0 px as 12 positions, which is 11
    step_px: float = 0.2  # Length of a step of the image
    direction_deg: float = 45.0  # Of the motion, from increasing column towards increasing row

    def __post_init__(self) -> None:
        if self.positions < 2:
            raise DomainError(f"StepPlan.positions = {self.positions}; at least 2 are needed")
        if not (np.isfinite(self.step_px) and self.step_px > 0):
            raise DomainError(f"StepPlan.step_px = {self.step_px} px; it must be positive")

    def path(self, instrument: Instrument, hexapod: Hexapod, rng: np.random.Generator) -> HexapodPath:
        """Poses of the hexapod."""
        return step_path(
            hexapod,
            rng,
            positions=self.positions,
            step_rad=self.step_px * instrument.pixel_arcsec * ARCSEC_RAD,
            direction_deg=self.direction_deg,
        )

    def check(self, bench: Bench) -> None:
        """Refuse steps that leave the window."""
        if self.step_px >= bench.window_px / 2:
            raise DomainError(
                f"a step of {self.step_px:g} px is not smaller than half the window (window_px = {bench.window_px}); "
                "ACC18 uses 0.2 px"
            )


@dataclass(frozen=True, slots=True, kw_only=True)
class HighFrequencyMeasurement:
    """Mean centroids of m positions and j stars, with every effect, and with some switched off."""

    plan: StepPlan  # The test
    frames: int  # N per position
    pixel_arcsec: float  # Angle of a pixel
    path: HexapodPath  # What the hexapod did
    direction: FloatArray  # (j, 3) Target points at rest
    photon_px: FloatArray  # (m, j, 2) Truth: mean of all light, in the window or beyond
    noiseless_px: Mapping[str, FloatArray]  # (m, j, 2) What each method makes of the noiseless windows
    # (m, j, 2) Mean centroids by run and method: "all", "none", "only CAUSE", "without CAUSE"
    mean_px: Mapping[str, Mapping[str, FloatArray]]
    # (m, j, 2) Standard deviation of a single frame's centroid, run "all", without a motion that all stars have in
    # common
    sigma_px: Mapping[str, FloatArray]
    # (m, j, 2) Standard deviation over the frames of the difference of two runs, by cause ("only CAUSE", "without
    # CAUSE")
    paired_px: Mapping[str, Mapping[str, FloatArray]]
    lights: tuple[PointLight, ...]  # The target at every position
    # (m, 2, 2) What the stars have in common in the frames
    # (`calib.measure.frame_positions.common_motion_px2`)
    motion_px2: FloatArray

    def high_frequency_error(self, method: str) -> ErrorTerm:
        """HSFE as printed (eq. 11-12), 3 sigma."""
        return high_frequency_error(self.mean_px["all"][method], self.pixel_arcsec)

    def single_px(self, method: str) -> FloatArray:
        """Error of one position (2,) against the truth, common motion and temporal noise subtracted."""
        error = self.mean_px["all"][method] - self.photon_px
        return position_rms_px(error, self.sigma_px[method], self.frames)

    def temporal_px(self, method: str) -> FloatArray:
        """Averaged temporal noise in the document's number (2,)."""
        return np.sqrt(self._averaged2(self.sigma_px[method]))

    def _averaged2(self, sigma_px: FloatArray) -> FloatArray:
        """Square of what noise of the frames leaves in the document's number (2,)."""
        of_mean = sigma_px**2 / self.frames
        return np.asarray((of_mean[1:] + of_mean[:-1]).mean((0, 1)) * (1.0 - 1.0 / sigma_px.shape[1]))

    def effect_px(self, method: str, cause: str, *, alone: bool) -> FloatArray:
        """Effect of a cause on the mean centroids (m, j, 2): acting alone, or missing when switched off."""
        if cause == "s_curve":
            return np.asarray(self.noiseless_px[method] - self.photon_px)
        runs = (f"only {cause}", "none") if alone else ("all", f"without {cause}")
        return np.asarray(self.mean_px[runs[0]][method] - self.mean_px[runs[1]][method])

    def _left(self, method: str, cause: str, *, alone: bool) -> FloatArray:
        """Noise (m, j, 2) of a frame that does not cancel between the two runs of `effect_px`."""
        if cause == "s_curve":
            return np.zeros_like(self.photon_px)
        return self.paired_px[f"{'only' if alone else 'without'} {cause}"][method]

    def cause_px(self, method: str, cause: str, *, alone: bool = True) -> FloatArray:
        """A cause's part (2,) in the document's number."""
        found = step_rms_px(self.effect_px(method, cause, alone=alone)) ** 2
        return np.sqrt(np.maximum(found - self._averaged2(self._left(method, cause, alone=alone)), 0.0))

    def cause_single_px(self, method: str, cause: str, *, alone: bool = True) -> FloatArray:
        """A cause's part (2,) in the error of a position."""
        noise = self._left(method, cause, alone=alone)
        return position_rms_px(self.effect_px(method, cause, alone=alone), noise, self.frames)

    def quadrature_px(self, method: str) -> FloatArray:
        """Causes (alone), roll and temporal noise, added in quadrature (2,): to be compared with `document_px`."""
        parts = [*(self.cause_px(method, cause) for cause in CAUSES), self.motion_px]
        return np.asarray(np.sqrt(sum((part**2 for part in parts), self.temporal_px(method) ** 2)))

    def common_shift_px(self, method: str, place_px: FloatArray) -> FloatArray:
        """Measured shift of the whole image from predicted places (m, j, 2) at every position (m, 2)."""
        return np.asarray((self.mean_px["all"][method] - place_px).mean(1))

    @property
    def motion_px(self) -> FloatArray:
        """The document's number (2,) for the true motion of the light: what hexapod and distortion leave in it."""
        return step_rms_px(self.photon_px)

    @property
    def step_px(self) -> FloatArray:
        """Mean step over the stars (m - 1, 2), by the truth."""
        return np.asarray(np.diff(self.photon_px, axis=0).mean(1))


def switched(detector: Detector, keep: Collection[str]) -> Detector:
    """The same chip with every cause of `SWITCHES` off but those to ``keep``; patterns that stay are the same."""
    off = {name: value for cause, values in SWITCHES.items() if cause not in keep for name, value in values.items()}
    return replace(detector, **off)  # type: ignore[arg-type]


def runs_of(*, split: bool) -> dict[str, tuple[str, ...]]:
    """Names of the runs and the causes that act in each."""
    every = tuple(SWITCHES)
    runs: dict[str, tuple[str, ...]] = {"all": every}
    if split:
        runs["none"] = ()
        for cause in every:
            runs[f"only {cause}"] = (cause,)
            runs[f"without {cause}"] = tuple(c for c in every if c != cause)
    return runs


def measure_high_frequency(
    bench: Bench,
    instrument: Instrument,
    hexapod: Hexapod,
    plan: StepPlan,
    *,
    place_px: Sequence[float] | None = None,
    subtraction: Subtraction = "dark",
    split: bool = True,
    streams: Streams,
    scene: PointScene | None = None,
    advance: Callable[[], None] = lambda: None,
) -> HighFrequencyMeasurement:
    """Step the camera, take frames at every position, centroid (ACC18 section 1.3).

    Dark frames are taken once, before the steps: all positions share them pixel by pixel.
    """
    plan.check(bench)
    scene = scene_of(scene, bench, instrument)
    bench = scene.bench
    rest = target_place(bench, instrument, place_px)
    path = plan.path(instrument, hexapod, streams.generator("hexapod"))
    psf = scene.psfs(rest)
    chips = {run: switched(instrument.detector, keep) for run, keep in runs_of(split=split).items()}
    mean: dict[str, dict[str, list[FloatArray]]] = {run: {m: [] for m in bench.methods} for run in chips}
    sigma: dict[str, list[FloatArray]] = {m: [] for m in bench.methods}
    paired: dict[str, dict[str, list[FloatArray]]] = {
        run: {m: [] for m in bench.methods} for run in chips if run not in ("all", "none")
    }
    lights, motion = [], []
    moving = bench.power_px2(instrument)[0] > 0.0
    for number, direction in enumerate(turned(rest, path.true_rad)):
        here = streams.child("position", number)
        light = scene.light(direction, here, f"step {number + 1}", psf=psf)
        lights.append(light)
        frames = {
            run: read_points(
                light,
                bench,
                instrument,
                streams=here,
                dark_streams=streams.child("before"),
                detector=chip,
                subtraction=subtraction,
            )
            for run, chip in chips.items()
        }
        motion.append(common_motion_px2(frames["all"].position_px[motion_method(bench.methods)]))
        for method in bench.methods:
            for run, one in frames.items():
                mean[run][method].append(one.mean_px(method))
            sigma[method].append(_own_sigma_px(frames["all"], method, moving))
            for run, of in paired.items():
                against = frames["none" if run.startswith("only") else "all"]
                difference = frames[run].position_px[method] - against.position_px[method]
                of[method].append(np.nanstd(difference, axis=0, ddof=1))
        advance()
    return HighFrequencyMeasurement(
        plan=plan,
        frames=bench.frames,
        pixel_arcsec=instrument.pixel_arcsec,
        path=path,
        direction=rest,
        photon_px=np.stack([light.photon_px for light in lights]),
        noiseless_px=_noiseless(lights, bench, instrument),
        mean_px={run: {m: np.stack(v) for m, v in of.items()} for run, of in mean.items()},
        sigma_px={m: np.stack(v) for m, v in sigma.items()},
        paired_px={run: {m: np.stack(v) for m, v in of.items()} for run, of in paired.items()},
        lights=tuple(lights),
        motion_px2=np.stack(motion),
    )


def _own_sigma_px(frames: PointFrames, method: str, moving: bool) -> FloatArray:
    """Standard deviation of a frame (j, 2); of a moving line of sight what the stars do not have in common."""
    if not moving:
        return frames.sigma_px(method)
    position = frames.position_px[method]
    stars = position.shape[1]
    own = position - np.nanmean(position, axis=1, keepdims=True)
    return np.asarray(np.nanstd(own, axis=0, ddof=1) * np.sqrt(stars / (stars - 1.0)))


def _noiseless(lights: Sequence[PointLight], bench: Bench, instrument: Instrument) -> dict[str, FloatArray]:
    """Results of each method on the rendered light."""
    noise, out = nominal_noise(instrument), {}
    for name, centroider in centroiders(bench, lights[0].psf).items():
        stamps = [noiseless_stamps(one.light_e, corner_px=one.corner_px) for one in lights]
        out[name] = np.stack([centroider.measure(one, noise).pixel_px for one in stamps])
    return out
