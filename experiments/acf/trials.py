"""Monte-Carlo runs: every method calibrates the same noisy stars; the result does not depend on the number of
processes.

Random streams are named by point and run; workers use one thread for linear algebra, and results keep the order of the
tasks.
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
from experiments.acf.settings import Config
from experiments.acf.simulate import HOUR_S, Scene, build_scene, choose_frames, gyro_rotations, observe, start_camera
from experiments.harness.system import one_thread, shared
from optics.arrays import FloatArray
from optics.units import DEG_RAD
from render.engine.random import Streams

Method = Literal["acc", "linked", "free", "iac", "iac_full"]
COMPARED: tuple[Method, ...] = ("acc", "linked", "free", "iac", "iac_full")
"""The document's method (ACC), a gyro of stated noise, free attitudes, interstar angles (IAC) as published, and IAC
fully weighted."""
LINKED = ("acc", "linked")
GRID = 15
"""Field points along each side of the line-of-sight map and of the residual distortion."""
DRAWN = 400
"""Errors that are drawn of every sky for the scatter of a gain."""
CHUNK = 25
"""Runs of a task at most; a part of a second to a few seconds of work."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Point:
    """A setting that runs are made of."""

    name: str  # Name of its random streams
    runs: int
    noise_px: float  # Noise of a star's position, per axis
    # Gyros tried on the same stars: bias [deg/h] and angle random walk [deg/sqrt(h)]
    gyro: tuple[tuple[float, float], ...]
    methods: tuple[Method, ...]  # "acc" and "linked" run for every gyro, the others once
    frames: Literal["odd", "all"] = "odd"  # Frames that calibrate. After "odd", noise-free even frames are reprojected
    stars: int | None = None  # Stars in every frame; None: the density of the configuration
    own_sky: bool = False  # Whether each run has a sky of its own; otherwise all runs see sky 0
    pixel_um: float | None = None  # Pixel in place of the configured one
    keep_reprojections: bool = False  # Whether each star's reprojection error is kept


def table1_gyro(config: Config) -> tuple[float, float]:
    """Bias [deg/h] and angle random walk [deg/sqrt(h)] of the configured gyro, by default Table 1's."""
    return config.gyro.bias_deg_per_h, config.gyro.angle_random_walk_deg_per_sqrt_h


@dataclass(frozen=True, slots=True, kw_only=True)
class Trials:
    """The runs of a point: arrays with the runs along the first axis, named as `work` does."""

    point: Point
    values: Mapping[str, FloatArray]

    def of(self, method: str, what: str, gyro: int | None = 0) -> FloatArray:
        """One figure of one method; ``gyro`` counts for ACC and the linked adjustment only."""
        label = f"{method}@{gyro}" if method in LINKED else method
        return self.values[f"{label}.{what}"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Task:
    """Runs ``first`` to ``last`` - 1 of a point."""

    config: Config
    point: Point
    first: int
    last: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Sky:
    """Stars of a sky, and the design at the truth."""

    scene: Scene
    stars: DrawnStars
    used: NDArray[np.bool_]  # (n,) Stars that calibrate
    kept: NDArray[np.int64]  # Frames that calibrate
    design: LinkedDesign

    @property
    def calibrating(self) -> LinkedDesign:
        """Design of the stars that calibrate."""
        return self.design.select(self.used)

    @property
    def judging(self) -> LinkedDesign:
        """Design of the stars that are reprojected."""
        return self.design.select(~self.used)


def work(task: Task) -> dict[str, FloatArray]:
    """Runs of a task."""
    point, scene = task.point, build_scene(task.config, task.point.pixel_um)
    grid = field_of(task.config, task.point.pixel_um)
    streams = Streams(task.config.seed).child("acf", point.name)
    runs = range(task.first, task.last)
    turned = [
        gyro_rotations(scene, task.config, streams.child("gyro", k), runs, pair) for k, pair in enumerate(point.gyro)
    ]
    rows: list[dict[str, Any]] = []
    for index, run in enumerate(runs):
        sky = sky_of(task.config, point, run)
        observed = observe(sky.stars, sky.used, sky.kept, point.noise_px, streams.generator("noise", run))
        row: dict[str, Any] = {}
        for method in point.methods:
            for k in range(len(point.gyro)) if method in LINKED else (None,):
                rotation = None if k is None else turned[k][index]
                judged = _judged(task, sky, observed, method, k or 0, rotation)
                row |= {f"{method if k is None else f'{method}@{k}'}.{what}": v for what, v in judged.items()}
        if point.own_sky:
            row |= _bounds(point, sky, grid.mean_square, streams.generator("expected gain", run))
        rows.append(row)
    return {key: np.stack([np.asarray(row[key], float) for row in rows]) for key in rows[0]}


@lru_cache(maxsize=4)
def _shared_sky(config: Config, which: str, exactly: int | None, pixel_um: float | None) -> Sky:
    return _drawn(config, which, exactly, pixel_um, 0)


def _drawn(config: Config, which: str, exactly: int | None, pixel_um: float | None, number: int) -> Sky:
    scene = build_scene(config, pixel_um)
    rng = Streams(config.seed).child("acf").generator("sky", number)
    mean = config.sky.stars_per_frame if exactly is None else None
    stars = draw_stars(scene.camera, scene.attitude, rng, mean=mean, exactly=exactly or 0)
    used, kept = choose_frames(stars, scene, which)
    design = LinkedDesign.at(scene.camera, scene.attitude, scene.installation, stars.direction, stars.frame)
    return Sky(scene=scene, stars=stars, used=used, kept=kept, design=design)


def sky_of(config: Config, point: Point, run: int) -> Sky:
    """Stars of a run, with the design at the truth."""
    if point.own_sky:
        return _drawn(config, point.frames, point.stars, point.pixel_um, run + 1)
    return _shared_sky(config, point.frames, point.stars, point.pixel_um)


def _family(task: Task, sky: Sky, method: Method, gyro: int, rotation: Rotation | None) -> AttitudeFamily:
    """How a method treats attitudes: ACC starts with phi and theta zero, as in Table 2; the others, and ACC in the
    sweep, take them from the stars as the start camera sees them."""
    if method == "free":
        return FreeAttitudes()
    if rotation is None:
        return NoAttitude(weighting="none" if method == "iac" else "full")
    start = {"gyro_rotation": rotation[sky.kept], "installation": Rotation.identity()}
    if method == "acc":
        known = task.config.start.phi_from_stars or task.point.own_sky
        return AttitudeCorrelated(**start, first_attitude=None if known else Rotation.identity())
    bias, walk = task.point.gyro[gyro]
    noise = GyroNoise.from_data_sheet(angle_random_walk_deg_per_sqrt_h=walk, bias_deg_per_h=bias)
    return GyroLinked(**start, time_s=sky.scene.time_s[sky.kept], noise=noise)


def _judged(
    task: Task, sky: Sky, observed: Observations, method: Method, gyro: int, rotation: Rotation | None
) -> dict[str, Any]:
    """One calibration, from a camera without distortion, and what it is judged by."""
    scene, grid = sky.scene, field_of(task.config, task.point.pixel_um)
    family = _family(task, sky, method, gyro, rotation)
    fitted = calibrate(observed, start_camera(task.config, scene.camera.geometry), family)
    camera = fitted.model
    assert isinstance(camera, BrownConrady)
    error = camera.parameters - scene.camera.parameters
    sigma = np.sqrt(np.diag(fitted.covariance))
    result: dict[str, Any] = {
        "converged": fitted.solution.converged,
        "distortion_px": residual_distortion(scene.camera, camera, grid),
        "sight_arcsec": line_of_sight_map(camera, grid.direction, grid.pixel_px).rms_arcsec,
    }
    if rotation is not None:
        assert fitted.attitude is not None
        assert fitted.installation is not None
        pairs = ((fitted.attitude[0], scene.attitude[0]), (fitted.installation, scene.installation))
        error = np.concatenate([error, *(angles_of_rotation(one) - angles_of_rotation(true) for one, true in pairs)])
        sigma = fitted.solution.sigma[: len(error)]
        if task.point.frames == "odd":
            away = _reprojected(sky, camera, link_attitudes(fitted.attitude[0], fitted.installation, rotation))
            result["reprojection_px2"] = (away**2).mean(0)
            if task.point.keep_reprojections:
                result["reprojected_px"] = away
    return result | {"error": error, "sigma": sigma}


def _reprojected(sky: Sky, camera: BrownConrady, attitude: Rotation) -> FloatArray:
    """Noise-free stars of the frames that did not calibrate: predicted minus true position (n, 2)."""
    frame, direction = (part[~sky.used] for part in (sky.stars.frame, sky.stars.direction))
    return np.asarray(camera.project(attitude[frame].apply(direction)) - sky.stars.pixel_px[~sky.used])


@dataclass(frozen=True, slots=True)
class Field:
    """A grid over the detector, for maps: places, true directions, `mean_square_matrix`."""

    pixel_px: FloatArray
    direction: FloatArray
    mean_square: FloatArray


@lru_cache(maxsize=8)
def field_of(config: Config, pixel_um: float | None) -> Field:
    """The grid of a configuration's camera."""
    camera = build_scene(config, pixel_um).camera
    pixel = camera.geometry.grid_px(GRID)
    return Field(pixel, camera.unproject(pixel), mean_square_matrix(camera, pixel))


def residual_distortion(true: BrownConrady, camera: BrownConrady, grid: Field) -> float:
    """Largest residual distortion over the array [px]: fitted minus true (dx, dy) of eq. 4 at the same ideal places.

    Principal point and focal length are the true ones on both sides; the document says no more than "residual
    distortion over the whole 1024 x 1024 array".
    """
    frame = np.array([name in true.pinhole_names for name in true.parameter_names])
    same = true.with_parameters(np.where(frame, true.parameters, camera.parameters))
    return float(np.hypot(*(same.project(grid.direction) - grid.pixel_px).T).max())


def gyro_drift(scene: Scene, pair: tuple[float, float]) -> GyroDrift:
    """Error of a gyro with that bias [deg/h] and angle random walk [deg/sqrt(h)]."""
    return GyroDrift.of(
        scene.time_s,
        scene.swept,
        bias_rad_per_s=pair[0] * DEG_RAD / HOUR_S,
        walk_rad_per_sqrt_s=pair[1] * DEG_RAD / np.sqrt(HOUR_S),
    )


def _bounds(point: Point, sky: Sky, matrix: FloatArray, rng: np.random.Generator) -> dict[str, FloatArray]:
    """Predicted sigma of the camera's parameters and, last, of the line of sight [arcsec]; drawn errors of the latter,
    for free attitudes and for a gyro of stated noise on the same stars."""
    design = sky.calibrating

    def figures(covariance: FloatArray) -> FloatArray:
        count = len(sky.scene.camera.parameters)
        return np.append(np.sqrt(np.diag(covariance)[:count]), expected_rms(matrix, covariance))

    alone = free_bound(design, point.noise_px)
    result = {"bound.free": figures(alone)}
    for k, pair in enumerate(point.gyro):
        error = gyro_drift(sky.scene, pair)
        result[f"bound@{k}.acc"] = figures(correlated_covariance(design, point.noise_px, error))
        weighted = linked_bound(design, point.noise_px, error)
        result[f"bound@{k}.linked"] = figures(weighted)
        size = len(matrix)
        drawn = drawn_rms(matrix, weighted[:size, :size], alone, DRAWN, rng)
        result |= {f"drawn@{k}.{name}": one for name, one in zip(("linked", "free"), drawn, strict=True)}
    return result


def perform(config: Config, points: Sequence[Point], *, advance: Callable[[int], None]) -> dict[str, Trials]:
    """Make all runs; trials by the name of the point."""
    tasks = [
        Task(config=config, point=point, first=first, last=min(first + CHUNK, point.runs))
        for point in points
        for first in range(0, point.runs, CHUNK)
    ]
    with one_thread():  # the same sums everywhere
        values = shared(work, tasks, lambda task: advance(task.last - task.first), workers=config.workers)
    trials = {}
    for point in points:
        parts = [part for task, part in zip(tasks, values, strict=True) if task.point.name == point.name]
        whole = {key: np.concatenate([part[key] for part in parts]) for key in parts[0]}
        trials[point.name] = Trials(point=point, values=whole)
    return trials
