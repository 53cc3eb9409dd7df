"""Expected results of every point, from its design: Cramer-Rao bounds, gyro errors carried through, reprojections."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calib.attitude.link import angles_of_rotation, increment_per_angle
from experiments.acf.linear_model import Design, Reprojection, correlated, free, linked, reprojection, reprojections
from experiments.acf.points import Plan, Point
from experiments.acf.published import FIG4_RMS_PX
from experiments.acf.settings import Config
from experiments.acf.simulate import Scene, build_scene
from experiments.acf.trials import gyro_error, sky_of
from optics.arrays import FloatArray
from optics.records import freeze

__all__ = ["Covariances", "ExpectedResults", "StarCount", "expected_results", "stars_for_published"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Covariances:
    """Predicted at one noise; angles phi and theta in rad."""

    perfect: FloatArray  # (14, 14) ACC as it sees itself, and with the gyro's error that it does not know of
    acc: FloatArray  # (14, 14) ACC as it sees itself, and with the gyro's error that it does not know of
    linked: FloatArray  # (14, 14) Cramer-Rao bound with that gyro
    free: FloatArray  # (8, 8) Cramer-Rao bound with an attitude of its own in every frame

    def __post_init__(self) -> None:
        for name in ("perfect", "acc", "linked"):
            freeze(self, name, shape=(14, 14))
        freeze(self, "free", shape=(8, 8))


@dataclass(frozen=True, slots=True, kw_only=True)
class StarCount:
    """Stars per frame for which the expected reprojection error is the published one."""

    pixel_um: float  # Pixel
    closed_form: float  # From sigma sqrt(14 / n), a perfect gyro
    with_gyro: float  # With the gyro of Table 1; infinite where the gyro alone gives more than is published
    gyro_px: float  # What that gyro alone gives
    stars: FloatArray  # (m,) Numbers of stars tried
    mean_px: FloatArray  # (m,) Expected RMS length of a run with the gyro of Table 1, and its standard deviation
    scatter_px: FloatArray  # (m,) Expected RMS length of a run with the gyro of Table 1, and its standard deviation
    low: float  # Between these the published value lies within one standard deviation of a run; NaN if nowhere
    high: float  # Between these the published value lies within one standard deviation of a run; NaN if nowhere


@dataclass(frozen=True, slots=True, kw_only=True)
class ExpectedResults:
    """Expected results."""

    fig3: Sequence[Sequence[Reprojection]]  # By noise, by gyro
    table2: Covariances  # For the frames that calibrate
    fig4: Reprojection  # With the gyro of Table 1
    inferred: Reprojection  # With the gyro of Table 1
    counts: Sequence[Sequence[Reprojection]]  # By number of stars, by gyro
    fig5: Sequence[Covariances]  # By noise
    matching: Sequence[StarCount]  # For the assumed and the inferred pixel


def expected_results(config: Config, plan: Plan, inferred_um: float) -> ExpectedResults:
    """Expected results of a plan."""
    return ExpectedResults(
        fig3=_fig3(config, plan.fig3),
        table2=_covariances(config, plan.table2),
        fig4=_judged(config, plan.table2, 0),
        inferred=_judged(config, plan.inferred, 0),
        counts=[[_judged(config, point, k) for k in range(len(point.gyro))] for point in plan.counts],
        fig5=[_covariances(config, point) for point in plan.fig5],
        matching=[stars_for_published(config, um) for um in (config.camera.pixel_um, inferred_um)],
    )


def stars_for_published(config: Config, pixel_um: float, stars: int = 40) -> StarCount:
    """Solve for the number of stars: their part of the mean square goes with 1 / n, that of the gyro does not."""
    table1 = (config.gyro.bias_deg_per_h, config.gyro.angle_random_walk_deg_per_sqrt_h)
    sigma_px = config.table_noise_px
    point = Point(name="", noise_px=sigma_px, gyro=(table1,), methods=(), stars=stars, pixel_um=pixel_um)
    scene, used, judged = _designs(config, point)
    error = gyro_error(scene, table1)
    tried = np.geomspace(5.0, 125.0, 25)
    expected = reprojections(used, judged, [sigma_px * float(np.sqrt(stars / n)) for n in tried], error)
    perfect = reprojection(used, judged, sigma_px).total_px ** 2
    gyro = expected[0].total_px ** 2 - perfect * stars / tried[0]
    wanted = float(FIG4_RMS_PX @ FIG4_RMS_PX)
    mean, scatter = (np.array([getattr(one, name) for one in expected]) for name in ("mean_px", "scatter_px"))
    within = tried[np.abs(np.sqrt(wanted) - mean) < scatter]
    return StarCount(
        pixel_um=pixel_um,
        closed_form=14.0 * sigma_px**2 / wanted / ((config.frames + 1) // 2),
        with_gyro=stars * perfect / (wanted - gyro) if wanted > gyro else float("inf"),
        gyro_px=float(np.sqrt(max(gyro, 0.0))),
        stars=tried,
        mean_px=mean,
        scatter_px=scatter,
        low=float(within[0]) if len(within) else float("nan"),
        high=float(within[-1]) if len(within) else float("nan"),
    )


def _fig3(config: Config, points: Sequence[Point]) -> list[list[Reprojection]]:
    """All noises see the same stars, so each gyro needs one look at the design."""
    scene, used, judged = _designs(config, points[0])
    noises = [point.noise_px for point in points]
    by_gyro = [
        reprojections(used, judged, noises, gyro_error(scene, noise) if any(noise) else None)
        for noise in points[0].gyro
    ]
    return [list(row) for row in zip(*by_gyro, strict=True)]


def _designs(config: Config, point: Point) -> tuple[Scene, Design, Design]:
    """Scene, stars that calibrate, stars that judge."""
    sky = sky_of(config, point, 0)
    return build_scene(config, point.pixel_um), sky.design.select(sky.used), sky.design.select(~sky.used)


def _judged(config: Config, point: Point, gyro: int) -> Reprojection:
    scene, used, judged = _designs(config, point)
    noise = point.gyro[gyro]
    return reprojection(used, judged, point.noise_px, gyro_error(scene, noise) if any(noise) else None)


def _covariances(config: Config, point: Point) -> Covariances:
    scene, used, _ = _designs(config, point)
    error = gyro_error(scene, point.gyro[0])
    to_angles = np.eye(14)
    for start, rotation in ((8, scene.attitude[0]), (11, scene.installation)):
        rows = slice(start, start + 3)
        to_angles[rows, rows] = np.linalg.inv(increment_per_angle(angles_of_rotation(rotation)))

    def angles(covariance: FloatArray) -> FloatArray:
        return np.asarray(to_angles @ covariance @ to_angles.T)

    return Covariances(
        perfect=angles(correlated(used, point.noise_px)),
        acc=angles(correlated(used, point.noise_px, error)),
        linked=angles(linked(used, point.noise_px, error)),
        free=free(used, point.noise_px),
    )
