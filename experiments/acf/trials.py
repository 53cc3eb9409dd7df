"""A few Monte-Carlo runs of one point: every method calibrates with the same noisy stars."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from calib.attitude.link import angles_of_rotation, link_attitudes
from calib.calibration.attitude_correlated import AttitudeCorrelated
from calib.calibration.calibrate import calibrate
from calib.calibration.free_attitudes import FreeAttitudes
from calib.calibration.gyro_linked import GyroLinked, GyroNoise
from calib.calibration.no_attitude import NoAttitude
from calib.calibration.observations import Observations
from calib.calibration.record import Calibration
from calib.cameras.brown_conrady import BrownConrady
from calib.cameras.line_of_sight import line_of_sight_map
from experiments.acf.linear_model import Design, GyroError, correlated, free, linked, sight_arcsec, sight_operator
from experiments.acf.points import Method, Point
from experiments.acf.settings import Config
from experiments.acf.simulate import (
    HOUR_S,
    Scene,
    Stars,
    build_camera,
    build_scene,
    choose_frames,
    draw_stars,
    gyro_rotations,
    observe,
    start_camera,
)
from optics.arrays import FloatArray
from optics.units import DEG_RAD
from render.engine.random import Streams

__all__ = ["Field", "Task", "field_of", "gyro_error", "sky_of", "work"]


LINKED = ("acc", "linked")
GRID = 15
"""Field points along each side of the line-of-sight map and of the residual distortion."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Task:
    """Runs ``first`` to ``last`` - 1 of a point."""

    config: Config
    point: Point
    first: int
    last: int


@dataclass(frozen=True, slots=True)
class _Link:
    """What a gyro said of the body's rotation in a run, and its noise as stated."""

    rotation: Rotation
    noise: tuple[float, float]


@dataclass(frozen=True, slots=True, kw_only=True)
class _Sky:
    """Stars of a sky, and what the design alone tells."""

    stars: Stars
    used: NDArray[np.bool_]
    kept: NDArray[np.int64]
    design: Design


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
                link = None if k is None else _Link(rotation=turned[k][index], noise=point.gyro[k])
                judged = _one(task, sky, observed, method, link)
                row |= {f"{method if k is None else f'{method}@{k}'}.{what}": v for what, v in judged.items()}
        if point.own_sky:
            row |= _bounds(point, scene, sky, grid.operator)
        rows.append(row)
    return {key: np.stack([np.asarray(row[key], float) for row in rows]) for key in rows[0]}


@lru_cache(maxsize=4)
def _shared_sky(config: Config, which: str, exactly: int | None, pixel_um: float | None) -> _Sky:
    return _drawn(config, which, exactly, pixel_um, 0)


def _drawn(config: Config, which: str, exactly: int | None, pixel_um: float | None, number: int) -> _Sky:
    scene = build_scene(config, pixel_um)
    streams = Streams(config.seed).child("acf")
    if exactly is None:
        stars = draw_stars(scene, streams, number, mean=config.sky.stars_per_frame)
    else:
        stars = draw_stars(scene, streams, number, exactly=exactly)
    used, kept = choose_frames(stars, scene, which)
    design = Design.at(scene.camera, scene.attitude, scene.installation, stars.direction, stars.frame)
    return _Sky(stars=stars, used=used, kept=kept, design=design)


def sky_of(config: Config, point: Point, run: int) -> _Sky:
    """Stars of a run, with the design at the truth."""
    if point.own_sky:
        return _drawn(config, point.frames, point.stars, point.pixel_um, run + 1)
    return _shared_sky(config, point.frames, point.stars, point.pixel_um)


def _calibrate(task: Task, sky: _Sky, observed: Observations, method: Method, link: _Link | None) -> Calibration:
    """One calibration. ACC starts as in Table 2: camera, phi and theta zero.

    The others, and ACC in the sweep, take the attitudes from the stars as the start camera sees them.
    """
    start = start_camera(task.config, build_camera(task.config, task.point.pixel_um).geometry)
    if link is None:
        if method == "free":
            return calibrate(observed, start, FreeAttitudes())
        return calibrate(observed, start, NoAttitude(weighting="none" if method == "iac" else "full"))
    turned = link.rotation[sky.kept]
    if method == "acc":
        known = task.config.start.phi_from_stars or task.point.own_sky
        family = AttitudeCorrelated(
            gyro_rotation=turned,
            first_attitude=None if known else Rotation.identity(),
            installation=Rotation.identity(),
        )
        return calibrate(observed, start, family)
    bias, walk = link.noise
    scene = build_scene(task.config, task.point.pixel_um)
    linked = GyroLinked(
        gyro_rotation=turned,
        time_s=scene.time_s[sky.kept],
        noise=GyroNoise.from_data_sheet(angle_random_walk_deg_per_sqrt_h=walk, bias_deg_per_h=bias),
        installation=Rotation.identity(),
    )
    return calibrate(observed, start, linked)


def _one(task: Task, sky: _Sky, observed: Observations, method: Method, link: _Link | None) -> dict[str, Any]:
    """One calibration and what it is judged by."""
    scene, grid = build_scene(task.config, task.point.pixel_um), field_of(task.config, task.point.pixel_um)
    found = _calibrate(task, sky, observed, method, link)
    camera = found.model
    assert isinstance(camera, BrownConrady)
    error = camera.parameters - scene.camera.parameters
    sigma = np.sqrt(np.diag(found.covariance))
    result: dict[str, Any] = {
        "converged": found.solution.converged,
        "iterations": found.solution.iterations,
        "distortion_px": residual_distortion(scene.camera, camera, grid),
        "sight_arcsec": sight_rms(camera, grid),
    }
    if link is not None:
        assert found.attitude is not None
        assert found.installation is not None
        pairs = ((found.attitude[0], scene.attitude[0]), (found.installation, scene.installation))
        error = np.concatenate([error, *(angles_of_rotation(one) - angles_of_rotation(true) for one, true in pairs)])
        sigma = found.solution.sigma[: len(error)]
        if task.point.frames == "odd":
            away = _reprojected(scene, sky, camera, found, link.rotation)
            result["reprojection_px2"] = (away**2).mean(0)
            if task.point.keep_reprojections:
                result["reprojected_px"] = away
    return result | {"error": error, "sigma": sigma}


def _reprojected(scene: Scene, sky: _Sky, camera: BrownConrady, found: Calibration, rotation: Rotation) -> FloatArray:
    """Noise-free stars of the frames that did not calibrate: predicted minus true position (n, 2)."""
    assert found.attitude is not None
    assert found.installation is not None
    other = ~sky.used
    attitude = link_attitudes(found.attitude[0], found.installation, rotation).as_matrix()
    seen = np.einsum("nij,nj->ni", attitude[sky.stars.frame[other]], sky.stars.direction[other])
    return np.asarray(camera.project(seen) - sky.stars.pixel_px[other])


@dataclass(frozen=True, slots=True)
class Field:
    """A grid over the detector, for maps: places, true directions, `sight_operator`."""

    pixel_px: FloatArray
    direction: FloatArray
    operator: FloatArray


@lru_cache(maxsize=8)
def field_of(config: Config, pixel_um: float | None) -> Field:
    """The grid of a configuration's camera."""
    camera = build_scene(config, pixel_um).camera
    pixel = camera.geometry.grid_px(GRID)
    return Field(pixel, camera.unproject(pixel), sight_operator(camera, GRID))


def residual_distortion(true: BrownConrady, camera: BrownConrady, grid: Field) -> float:
    """Largest residual distortion over the array [px]: found minus true (dx, dy) of eq. 4 at the same ideal places.

    Principal point and focal length are the true ones on both sides; the document says no more than "residual
    distortion over the whole 1024 x 1024 array".
    """
    frame = np.array([name in true.pinhole_names for name in true.parameter_names])
    same = true.with_parameters(np.where(frame, true.parameters, camera.parameters))
    return float(np.linalg.norm(same.project(grid.direction) - grid.pixel_px, axis=1).max())


def sight_rms(camera: BrownConrady, grid: Field) -> float:
    """RMS length of the line-of-sight error over the detector after the best rotation [arcsec]."""
    return float(line_of_sight_map(camera, grid.direction, grid.pixel_px).rms_arcsec)


def gyro_error(scene: Scene, pair: tuple[float, float]) -> GyroError:
    """Error of a gyro with that bias [deg/h] and angle random walk [deg/sqrt(h)]."""
    return GyroError.of(
        scene.time_s,
        scene.swept,
        bias_rad_per_s=pair[0] * DEG_RAD / HOUR_S,
        walk_rad_per_sqrt_s=pair[1] * DEG_RAD / np.sqrt(HOUR_S),
    )


def _bounds(point: Point, scene: Scene, sky: _Sky, operator: FloatArray) -> dict[str, FloatArray]:
    """Predicted sigma of the camera's parameters and, last, of the line of sight [arcsec]."""
    design = sky.design.select(sky.used)

    def figures(covariance: FloatArray) -> FloatArray:
        count = len(scene.camera.parameters)
        return np.append(np.sqrt(np.diag(covariance)[:count]), sight_arcsec(operator, covariance))

    result = {"bound.free": figures(free(design, point.noise_px))}
    for k, pair in enumerate(point.gyro):
        error = gyro_error(scene, pair)
        result[f"bound@{k}.acc"] = figures(correlated(design, point.noise_px, error))
        result[f"bound@{k}.linked"] = figures(linked(design, point.noise_px, error))
    return result
