"""High spatial frequency error (ACC18 eq. 3-12) measured: small steps of a hexapod, causes switched off one by one.

Every cause is measured twice on the same random streams: *alone* (a detector with only this cause, against a detector
without any) and *switched off* (all causes, against all but this). Both are differences of mean centroids from frames
with the same noise, which therefore largely cancels; the residual noise (different rounding and Poisson variates) is
estimated from the scatter of the difference over the frames and subtracted.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from calib.accuracy.error_budget import ErrorTerm
from calib.accuracy.high_frequency import (
    averaged_noise_px,
    high_frequency_error,
    position_rms_px,
    sigma_without_common_motion_px,
    step_rms_px,
)
from calib.accuracy.step_prediction import CAUSES
from calib.measure.stamps import noiseless_stamps
from calib.measure.statistics.frame_positions import common_motion_px2, frame_statistics
from experiments.laboratory.bench.point_bench import Bench, centroiders, motion_method
from experiments.laboratory.bench.points import PointLight, PointScene, Subtraction, read_points, scene_of
from experiments.laboratory.bench.readout.frames import nominal_noise
from experiments.laboratory.devices.hexapod import step_path, turned
from experiments.laboratory.settings.tables import HexapodConfig, StepConfig
from experiments.laboratory.temporal_error import star_target_directions
from optics.arrays import FloatArray
from optics.errors import DomainError
from render.detector.spec import Detector
from render.engine.random import Streams
from render.sensor_file.instrument import Instrument

SWITCHES: Mapping[str, Mapping[str, float]] = {
    "prnu": {"prnu": 0.0},
    "pattern": {"dsnu_e": 0.0, "column_pattern_e": 0.0, "dark_spread_e_per_s": 0.0},
    "defects": {"hot_fraction": 0.0, "dead_fraction": 0.0},
}
"""Values of the detector with a cause switched off."""


def check_steps(steps: StepConfig, bench: Bench) -> None:
    """Refuse steps that leave the window."""
    if steps.step_px >= bench.window_px / 2:
        raise DomainError(
            f"a step of {steps.step_px:g} px is not smaller than half the window (window_px = {bench.window_px}); "
            "ACC18 uses 0.2 px"
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class HighFrequencyMeasurement:
    """Centroids of j stars at m positions in f frames, with all causes and with some switched off."""

    pixel_arcsec: float  # Angle of a pixel
    photon_px: FloatArray  # (m, j, 2) Truth: centroid of the noiseless image, within and outside the window
    noiseless_px: Mapping[str, FloatArray]  # (m, j, 2) Centroids of the noiseless windows by method
    # (f, m, j, 2) Centroids by run and method: "all", "none", "only CAUSE", "without CAUSE"
    position_px: Mapping[str, Mapping[str, FloatArray]]
    corner_px: NDArray[np.int64]  # (m, j, 2) First pixels of the windows
    moving: bool  # Whether the line of sight moves from frame to frame
    motion_px2: FloatArray  # (m, 2, 2) Motion common to the stars in the frames (`common_motion_px2`)

    @property
    def frames(self) -> int:
        """Number of frames per position."""
        return len(next(iter(self.position_px["all"].values())))

    def mean_px(self, method: str, run: str = "all") -> FloatArray:
        """Mean centroids (m, j, 2)."""
        return frame_statistics(self.position_px[run][method])[0]

    def sigma_px(self, method: str) -> FloatArray:
        """Standard deviation (m, j, 2) of a frame's centroid, without motion common to all stars."""
        position = self.position_px["all"][method]
        return sigma_without_common_motion_px(position) if self.moving else frame_statistics(position)[1]

    def high_frequency_error(self, method: str) -> ErrorTerm:
        """HSFE as printed (eq. 11-12), 3 sigma."""
        return high_frequency_error(self.mean_px(method), self.pixel_arcsec)

    def single_px(self, method: str) -> FloatArray:
        """Error of one position (2,) against the truth, common motion and temporal noise subtracted."""
        return position_rms_px(self.mean_px(method) - self.photon_px, self.sigma_px(method), self.frames)

    def temporal_px(self, method: str) -> FloatArray:
        """Averaged temporal noise in the steps' RMS (2,)."""
        return averaged_noise_px(self.sigma_px(method), self.frames)

    def effect_px(self, method: str, cause: str, *, alone: bool = True) -> tuple[FloatArray, FloatArray]:
        """Effect of a cause on the mean centroids, and standard deviation of the difference over the frames.

        Shapes (m, j, 2); ``alone``: the cause against none, otherwise all causes against all but this.
        """
        if cause == "s_curve":
            return np.asarray(self.noiseless_px[method] - self.photon_px), np.zeros_like(self.photon_px)
        with_cause, without = (f"only {cause}", "none") if alone else ("all", f"without {cause}")
        difference = self.position_px[with_cause][method] - self.position_px[without][method]
        effect = self.mean_px(method, with_cause) - self.mean_px(method, without)
        return np.asarray(effect), np.asarray(np.nanstd(difference, axis=0, ddof=1))

    def cause_px(self, method: str, cause: str, *, alone: bool = True) -> FloatArray:
        """Contribution of a cause (2,) to the steps' RMS."""
        return step_rms_px(*self.effect_px(method, cause, alone=alone), self.frames)

    def cause_single_px(self, method: str, cause: str, *, alone: bool = True) -> FloatArray:
        """Contribution of a cause (2,) to the error of a position."""
        return position_rms_px(*self.effect_px(method, cause, alone=alone), self.frames)

    def quadrature_px(self, method: str) -> FloatArray:
        """Causes (alone), roll and temporal noise, added in quadrature (2,): to be compared with the steps' RMS."""
        parts = [self.cause_px(method, cause) for cause in CAUSES]
        return np.asarray(np.sqrt(np.square([*parts, self.motion_px, self.temporal_px(method)]).sum(0)))

    @property
    def motion_px(self) -> FloatArray:
        """RMS (2,) of the true motion of the light in the steps, mean over the stars removed: roll and distortion."""
        return step_rms_px(self.photon_px)


def switched(detector: Detector, active: Collection[str]) -> Detector:
    """The chip with every cause of `SWITCHES` off except ``active``, whose patterns do not change."""
    changes = {
        name: value for cause, values in SWITCHES.items() if cause not in active for name, value in values.items()
    }
    return replace(detector, **changes)  # type: ignore[arg-type]


def runs_of(*, split: bool) -> dict[str, tuple[str, ...]]:
    """Names of the runs and the causes that act in each."""
    causes = tuple(SWITCHES)
    runs: dict[str, tuple[str, ...]] = {"all": causes}
    if split:
        runs["none"] = ()
        for cause in causes:
            runs[f"only {cause}"] = (cause,)
            runs[f"without {cause}"] = tuple(other for other in causes if other != cause)
    return runs


def measure_high_frequency(
    bench: Bench,
    instrument: Instrument,
    hexapod: HexapodConfig,
    steps: StepConfig,
    *,
    place_px: Sequence[float] | None = None,
    subtraction: Subtraction = "dark",
    split: bool = True,
    streams: Streams,
    scene: PointScene | None = None,
    advance: Callable[[], None] = lambda: None,
) -> HighFrequencyMeasurement:
    """Step the camera, take frames at every position, centroid (ACC18 section 1.3).

    Dark frames are taken once, before the steps, and subtracted at all positions.
    """
    check_steps(steps, bench)
    scene = scene_of(scene, bench, instrument)
    bench = scene.bench
    rest = star_target_directions(bench, instrument, place_px)
    path = step_path(hexapod, steps, instrument.pixel_arcsec, streams.generator("hexapod"))
    psf = scene.psfs(rest)
    chips = {run: switched(instrument.detector, active) for run, active in runs_of(split=split).items()}
    lights: list[PointLight] = []
    position: dict[str, dict[str, list[FloatArray]]] = {run: {m: [] for m in bench.methods} for run in chips}
    for number, direction in enumerate(turned(rest, path.true_rad)):
        position_streams = streams.child("position", number)
        lights.append(scene.light(direction, position_streams, f"step {number + 1}", psf=psf))
        for run, chip in chips.items():
            frames = read_points(
                lights[-1],
                bench,
                instrument,
                streams=position_streams,
                dark_streams=streams.child("before"),
                detector=chip,
                subtraction=subtraction,
            )
            for method, centroids in frames.position_px.items():
                position[run][method].append(centroids)
        advance()
    noise_model, reference = nominal_noise(instrument), position["all"][motion_method(bench.methods)]
    noiseless = [noiseless_stamps(light.light_e, corner_px=light.corner_px) for light in lights]
    return HighFrequencyMeasurement(
        pixel_arcsec=instrument.pixel_arcsec,
        photon_px=np.stack([light.photon_px for light in lights]),
        noiseless_px={
            name: np.stack([centroider.measure(stamps, noise_model).pixel_px for stamps in noiseless])
            for name, centroider in centroiders(bench, lights[0].psf).items()
        },
        position_px={
            run: {method: np.stack(centroids, axis=1) for method, centroids in by_method.items()}
            for run, by_method in position.items()
        },
        corner_px=np.stack([light.corner_px for light in lights]),
        moving=bench.power_px2(instrument)[0] > 0.0,
        motion_px2=np.stack([common_motion_px2(centroids) for centroids in reference]),
    )
