"""Monte-Carlo runs: every method calibrates the same noisy stars.

The result does not depend on the number of processes: random streams are named by point and run, workers use one thread
for linear algebra, and results have the order of the tasks.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from calib.attitude.euler_angles import angles_of_rotation
from calib.attitude.gyro_attitude import link_attitudes
from calib.calibration.attitude_correlated import AttitudeCorrelated
from calib.calibration.attitude_family import AttitudeFamily
from calib.calibration.calibrate import calibrate
from calib.calibration.drawn_stars import DrawnStars, draw_stars
from calib.calibration.free_attitudes import FreeAttitudes
from calib.calibration.gyro_linked import GyroLinked, GyroNoise
from calib.calibration.interstar_angles import NoAttitude
from calib.calibration.linked_design import GyroDrift, LinkedDesign, correlated_covariance, free_bound, linked_bound
from calib.calibration.observations import Observations
from calib.cameras.brown_conrady import BrownConrady
from calib.cameras.line_of_sight import drawn_rms, expected_rms, line_of_sight_map, mean_square_matrix
from experiments.acf.settings import AcfConfig
from experiments.acf.simulate import HOUR_S, AcfScene, build_scene, choose_frames, gyro_rotations, observe, start_camera
from experiments.harness.system import one_thread, shared
from optics.arrays import FloatArray
from optics.units import DEG_RAD
from render.engine.random import Streams

Method = Literal["acc", "linked", "free", "iac", "iac_full"]
COMPARED: tuple[Method, ...] = ("acc", "linked", "free", "iac", "iac_full")
"""ACC of the paper (error-free gyro); gyro weighted by its noise; independent attitudes; IAC as published; IAC with
full covariance."""
LINKED = ("acc", "linked")
"""Methods that use the gyro."""
GRID = 15
"""Points along each side of the line-of-sight map and of the residual distortion."""
SAMPLES = 400
"""Line-of-sight errors sampled from the predicted covariance of every sky, for the distribution of a gain."""
CHUNK = 25
"""Largest number of runs of a task: a few seconds of work at most."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TrialPoint:
    """Settings of a series of Monte-Carlo runs."""

    name: str  # Name of its random streams
    runs: int
    noise_px: float  # Noise of a star's position, per axis
    # Gyros tried on the same stars: bias [deg/h] and angle random walk [deg/sqrt(h)]
    gyro: tuple[tuple[float, float], ...]
    methods: tuple[Method, ...]  # "acc" and "linked" run for every gyro, the others once
    frames: Literal["odd", "all"] = "odd"  # Frames that calibrate. After "odd", noise-free even frames are reprojected
    stars: int | None = None  # Stars in every frame; None: the density of the configuration
    new_sky_each_run: bool = False  # Otherwise all runs see sky 0
    pixel_um: float | None = None  # Pixel pitch; None: the configured one
    keep_reprojection_errors: bool = False  # Whether the trials hold the reprojection error of every star


def table1_gyro(config: AcfConfig) -> tuple[float, float]:
    """Bias [deg/h] and angle random walk [deg/sqrt(h)] of the configured gyro, by default Table 1's."""
    return config.gyro.bias_deg_per_h, config.gyro.angle_random_walk_deg_per_sqrt_h


@dataclass(frozen=True, slots=True, kw_only=True)
class Trials:
    """Results of a point's runs, which are the first axis of every array; `of` names them."""

    point: TrialPoint
    values: Mapping[str, FloatArray]

    def of(self, method: str, quantity: str, gyro: int | None = 0) -> FloatArray:
        """A quantity of a method: keys of `_calibration_errors`, `_predicted_errors`; ``gyro`` for `LINKED` only."""
        label = f"{method}@{gyro}" if method in LINKED else method
        return self.values[f"{label}.{quantity}"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Task:
    """Runs ``first`` to ``last`` - 1 of a point."""

    config: AcfConfig
    point: TrialPoint
    first: int
    last: int


@dataclass(frozen=True, slots=True, kw_only=True)
class NightSky:
    """Stars of a sky, and the design at the truth."""

    scene: AcfScene
    stars: DrawnStars
    used: NDArray[np.bool_]  # (n,) Stars that calibrate
    frames: NDArray[np.int64]  # Frames that calibrate
    design: LinkedDesign  # Of all stars

    @property
    def calibrating(self) -> LinkedDesign:
        """Design of the stars that calibrate."""
        return self.design.select(self.used)

    @property
    def reprojected(self) -> LinkedDesign:
        """Design of the stars that do not calibrate."""
        return self.design.select(~self.used)


def run_task(task: Task) -> dict[str, FloatArray]:
    """Calibrate the runs of a task with every method and gyro, as "method.quantity" or "method@gyro.quantity"."""
    point, scene = task.point, build_scene(task.config, task.point.pixel_um)
    grid = map_grid(task.config, task.point.pixel_um)
    streams = Streams(task.config.seed).child("acf", point.name)
    runs = range(task.first, task.last)
    rotations = [
        gyro_rotations(scene, task.config, streams.child("gyro", k), runs, noise) for k, noise in enumerate(point.gyro)
    ]
    results: list[dict[str, Any]] = []
    for index, run in enumerate(runs):
        sky = sky_of(task.config, point, run)
        observed = observe(sky.stars, sky.used, sky.frames, point.noise_px, streams.generator("noise", run))
        result: dict[str, Any] = {}
        for method in point.methods:
            for k in range(len(point.gyro)) if method in LINKED else (None,):
                rotation = None if k is None else rotations[k][index]
                errors = _calibration_errors(task, sky, observed, method, k or 0, rotation)
                label = method if k is None else f"{method}@{k}"
                result |= {f"{label}.{quantity}": value for quantity, value in errors.items()}
        if point.new_sky_each_run:
            result |= _predicted_errors(point, sky, grid.mean_square, streams.generator("expected gain", run))
        results.append(result)
    return {key: np.stack([np.asarray(result[key], float) for result in results]) for key in results[0]}


@lru_cache(maxsize=4)
def _sky(config: AcfConfig, frame_selection: str, exactly: int | None, pixel_um: float | None, number: int) -> NightSky:
    scene = build_scene(config, pixel_um)
    rng = Streams(config.seed).child("acf").generator("sky", number)
    mean = config.sky.stars_per_frame if exactly is None else None
    stars = draw_stars(scene.camera, scene.attitude, rng, mean=mean, exactly=exactly or 0)
    used, frames = choose_frames(stars, scene, frame_selection)
    design = LinkedDesign.at(scene.camera, scene.attitude, scene.installation, stars.direction, stars.frame)
    return NightSky(scene=scene, stars=stars, used=used, frames=frames, design=design)


def sky_of(config: AcfConfig, point: TrialPoint, run: int) -> NightSky:
    """Stars of a run, with the design at the truth."""
    number = run + 1 if point.new_sky_each_run else 0
    return _sky(config, point.frames, point.stars, point.pixel_um, number)


def _family(task: Task, sky: NightSky, method: Method, gyro: int, rotation: Rotation | None) -> AttitudeFamily:
    """How a method treats attitudes. ACC starts with phi and theta zero, as in Table 2; in the sweep, and with the
    other methods, start attitudes come from the stars and the start camera."""
    if method == "free":
        return FreeAttitudes()
    if rotation is None:
        return NoAttitude(weighting="none" if method == "iac" else "full")
    start = {"gyro_rotation": rotation[sky.frames], "installation": Rotation.identity()}
    if method == "acc":
        from_stars = task.config.start.phi_from_stars or task.point.new_sky_each_run
        return AttitudeCorrelated(**start, first_attitude=None if from_stars else Rotation.identity())
    bias, walk = task.point.gyro[gyro]
    noise = GyroNoise.from_data_sheet(angle_random_walk_deg_per_sqrt_h=walk, bias_deg_per_h=bias)
    return GyroLinked(**start, time_s=sky.scene.time_s[sky.frames], noise=noise)


def _calibration_errors(
    task: Task, sky: NightSky, observed: Observations, method: Method, gyro: int, rotation: Rotation | None
) -> dict[str, Any]:
    """Errors of a calibration that starts from a camera without distortion."""
    scene, grid = sky.scene, map_grid(task.config, task.point.pixel_um)
    family = _family(task, sky, method, gyro, rotation)
    fitted = calibrate(observed, start_camera(task.config, scene.camera.geometry), family)
    camera = fitted.model
    assert isinstance(camera, BrownConrady)
    error = camera.parameters - scene.camera.parameters
    sigma = np.sqrt(np.diag(fitted.covariance))
    result: dict[str, Any] = {
        "converged": fitted.solution.converged,
        "residual_distortion_px": residual_distortion(scene.camera, camera, grid),
        "line_of_sight_arcsec": line_of_sight_map(camera, grid.direction, grid.pixel_px).rms_arcsec,
    }
    if rotation is not None:
        assert fitted.attitude is not None
        assert fitted.installation is not None
        for estimate, truth in ((fitted.attitude[0], scene.attitude[0]), (fitted.installation, scene.installation)):
            error = np.append(error, angles_of_rotation(estimate) - angles_of_rotation(truth))
        sigma = fitted.solution.sigma[: len(error)]
        if task.point.frames == "odd":
            attitude = link_attitudes(fitted.attitude[0], fitted.installation, rotation)
            error_px = _reprojection_error_px(sky, camera, attitude)
            result["reprojection_px2"] = (error_px**2).mean(0)
            if task.point.keep_reprojection_errors:
                result["reprojection_error_px"] = error_px
    return result | {"error": error, "sigma": sigma}


def _reprojection_error_px(sky: NightSky, camera: BrownConrady, attitude: Rotation) -> FloatArray:
    """Predicted minus true position (n, 2) of the stars in the frames that did not calibrate."""
    frame, direction = sky.stars.frame[~sky.used], sky.stars.direction[~sky.used]
    return np.asarray(camera.project(attitude[frame].apply(direction)) - sky.stars.pixel_px[~sky.used])


@dataclass(frozen=True, slots=True)
class MapGrid:
    """A grid over the detector, for maps."""

    pixel_px: FloatArray  # (n, 2)
    direction: FloatArray  # (n, 3) True directions in cam
    mean_square: FloatArray  # `mean_square_matrix`


@lru_cache(maxsize=8)
def map_grid(config: AcfConfig, pixel_um: float | None) -> MapGrid:
    """The grid of a configuration's camera."""
    camera = build_scene(config, pixel_um).camera
    pixel = camera.geometry.grid_px(GRID)
    return MapGrid(pixel, camera.unproject(pixel), mean_square_matrix(camera, pixel))


def residual_distortion(true: BrownConrady, camera: BrownConrady, grid: MapGrid) -> float:
    """Largest residual distortion over the array [px]: fitted minus true (dx, dy) of eq. 4 at the same ideal positions.

    Principal point and focal length are the true ones on both sides; ACF17 says no more than "residual distortion over
    the whole 1024 x 1024 array".
    """
    pinhole = np.array([name in true.pinhole_names for name in true.parameter_names])
    fitted_distortion = true.with_parameters(np.where(pinhole, true.parameters, camera.parameters))
    return float(np.hypot(*(fitted_distortion.project(grid.direction) - grid.pixel_px).T).max())


def gyro_drift(scene: AcfScene, noise: tuple[float, float]) -> GyroDrift:
    """Error of a gyro with a bias [deg/h] and an angle random walk [deg/sqrt(h)]."""
    return GyroDrift.of(
        scene.time_s,
        scene.integrated_rotation,
        bias_rad_per_s=noise[0] * DEG_RAD / HOUR_S,
        walk_rad_per_sqrt_s=noise[1] * DEG_RAD / np.sqrt(HOUR_S),
    )


def _predicted_errors(
    point: TrialPoint, sky: NightSky, matrix: FloatArray, rng: np.random.Generator
) -> dict[str, FloatArray | float]:
    """Line-of-sight errors [arcsec] by the covariances of `calib.calibration.linked_design`: RMS, and random samples.

    Samples of a gyro-weighted fit and of independent attitudes are correlated, as of fits to the same stars.
    """
    design = sky.calibrating
    size = len(matrix)
    free = free_bound(design, point.noise_px)
    result: dict[str, FloatArray | float] = {"free.predicted_arcsec": expected_rms(matrix, free)}
    for k, noise in enumerate(point.gyro):
        drift = gyro_drift(sky.scene, noise)
        acc = correlated_covariance(design, point.noise_px, drift)
        linked = linked_bound(design, point.noise_px, drift)
        result[f"acc@{k}.predicted_arcsec"] = expected_rms(matrix, acc)
        result[f"linked@{k}.predicted_arcsec"] = expected_rms(matrix, linked)
        samples = drawn_rms(matrix, linked[:size, :size], free, SAMPLES, rng)
        result[f"linked@{k}.sampled_arcsec"], result[f"linked@{k}.sampled_free_arcsec"] = samples
    return result


def run_trials(config: AcfConfig, points: Sequence[TrialPoint], *, advance: Callable[[int], None]) -> dict[str, Trials]:
    """Trials of all points, by the name of the point."""
    tasks = [
        Task(config=config, point=point, first=first, last=min(first + CHUNK, point.runs))
        for point in points
        for first in range(0, point.runs, CHUNK)
    ]
    with one_thread():  # sums in the same order on every machine
        values = shared(run_task, tasks, lambda task: advance(task.last - task.first), workers=config.workers)
    trials = {}
    for point in points:
        chunks = [chunk for task, chunk in zip(tasks, values, strict=True) if task.point.name == point.name]
        joined = {key: np.concatenate([chunk[key] for chunk in chunks]) for key in chunks[0]}
        trials[point.name] = Trials(point=point, values=joined)
    return trials
