"""Calibration of a star sensor with attitude-correlated frames (ACF17): simulated night, runs, convergence.

Fig. 3 and 4 are in `experiments.acf.reprojection`, Table 2 and the implied pixel size in `experiments.acf.table2`, Fig.
5 in `experiments.acf.methods`, the sweep of stars per frame in `experiments.acf.gain`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from calib.calibration.linked_design import correlated_covariance
from calib.cameras.brown_conrady import BrownConrady
from experiments.acf.gain import GAIN, gains, sweep_points
from experiments.acf.methods import ERRORS, METHODS, RATIOS, fig5_points, methods
from experiments.acf.reprojection import (
    REPROJECTION,
    counts,
    counts_points,
    fig3,
    fig3_points,
    fig4,
    inferred_point,
    matching_stars,
    overall,
    table2_point,
)
from experiments.acf.settings import Config
from experiments.acf.simulate import build_camera
from experiments.acf.table2 import NAMES, TABLE2, UNKNOWNS, covariances, implied, sums, table2
from experiments.acf.trials import COMPARED, Point, Trials, perform, sky_of
from experiments.harness.progress import Progress
from experiments.harness.quantities import Quantities
from experiments.harness.sections import Section, below, col
from optics.errors import DomainError

METHOD_NAMES = {
    "acc": "ACC",
    "linked": "ACC, gyro weighted",
    "free": "free attitudes",
    "iac": "IAC",
    "iac_full": "IAC, full weights",
}
SWEPT = ("acc", "linked", "free")
"""Methods of the sweep of stars per frame."""
LEAST_PART = 1e-12
"""Of the largest eigenvalue of the scaled normal matrix; below, an unknown is not determined."""
MOST_DISTORTION = 0.3
"""Of the field at a corner; from a start without distortion, more is another camera."""
WORST_DEG = 1.0
"""Largest standard deviation of an installation angle at which the adjustment is still linear."""


def check_design(config: Config) -> None:
    """Refuse a camera of mostly distortion, and a night that cannot determine all 14 unknowns."""
    _check_distortion(config)
    if config.gyro.motion == "fixed_axis":
        raise DomainError(
            "gyro.motion = 'fixed_axis': the rotation of the installation about this axis is not observable, 13 of "
            "the 14 unknowns are determined; use 'turning_axis'"
        )
    for point, key in ((table2_point(config), "sky.stars_per_frame"), (counts_points(config)[0], "counts")):
        _check_point(config, point, key)


def _check_distortion(config: Config) -> None:
    camera = build_camera(config)
    plain = BrownConrady.create(
        camera.geometry,
        focal_length_mm=config.camera.focal_length_mm,
        x0_px=config.camera.x0_px,
        y0_px=config.camera.y0_px,
    )
    corner = camera.geometry.grid_px(2)
    moved = np.hypot(*(plain.project(camera.unproject(corner)) - corner).T)
    part = float((moved / np.hypot(*(corner - camera.geometry.centre_px - camera.parameters[:2]).T)).max())
    if not part <= MOST_DISTORTION:
        raise DomainError(
            f"camera: this distortion moves the image by {100 * part:.0f} % of its distance from the principal point "
            f"at a corner of the detector; at most {100 * MOST_DISTORTION:.0f} % is possible: use smaller q1_per_mm2 "
            "... p2_per_mm"
        )


def _check_point(config: Config, point: Point, key: str) -> None:
    sky = sky_of(config, point, 0)
    behind = int((sky.stars.direction[sky.used, 2] <= 0.0).sum())
    if behind and not config.start.phi_from_stars:
        raise DomainError(
            f"sky.phi_deg = {list(config.sky.phi_deg)} deg: from ACF17's start, phi = 0, {behind} of "
            f"{int(sky.used.sum())} stars are behind the camera; set start.phi_from_stars=true"
        )
    design = sky.calibrating
    swept_deg = float(np.degrees(Rotation.from_matrix(design.link[:, :, :3]).magnitude().max()))
    if design.least_information() > LEAST_PART:
        covariance = correlated_covariance(design, max(config.noise_px))
        worst_deg = float(np.degrees(np.sqrt(np.diag(covariance)[-3:].max())))
        if worst_deg <= WORST_DEG:
            return
        raise DomainError(
            f"the installation would be determined to {worst_deg:.1f} deg only (the body turns by "
            f"{swept_deg:.2g} deg, {len(design.frame)} stars calibrate); at most {WORST_DEG:g} deg can be calibrated: "
            f"a faster gyro.angular_speed_deg_per_s, more frames or more stars ({key}) are needed"
        )
    raise DomainError(
        f"{key}: {len(design.frame)} stars in the frames that calibrate do not determine the 14 unknowns; more "
        "stars or frames are needed"
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class Night:
    """The sky of Fig. 3 to 5 and Table 2, as the turning sensor sees it."""

    stars_per_frame: float = col("Stars", "per frame", ".0f")


@dataclass(frozen=True, slots=True, kw_only=True)
class Levels:
    """Settings along which the numbers of the figures run."""

    noise_px: Sequence[float] = col("Star noise", "px", dims="noise")
    bias: Sequence[float] = col("Bias", "°/h", dims="bias")
    walk: Sequence[float] = col("Angle random walk", "°/√h", dims="walk")
    stars: Sequence[int] = col("Stars", "per frame", dims="stars")
    factor: Sequence[float] = col("Gyro noise", dims="factor")
    skies: int = col("Skies")


def axes(config: Config) -> Quantities:
    """Dimensions that several sections share."""
    q = Quantities()
    biases = (0.0, *config.bias_deg_per_h)
    walks = (0.0, *config.angle_random_walk_deg_per_sqrt_h)
    factors = config.sweep.gyro_factor
    perfect = "perfect gyro"
    q.axis("axis", ["x", "y"], "Axis")
    q.axis("noise", config.noise_px, "Star noise", unit="px", format=".2f")
    q.axis("bias", biases, "Bias", names=[f"{v:g} °/h" if v else perfect for v in biases])
    q.axis("walk", walks, "Angle random walk", names=[f"{v:g} °/√h" if v else perfect for v in walks])
    q.axis("case", ["assumed", "inferred"], "Fig. 4", names=["assumed", "inferred"])
    q.axis("count_gyro", ["perfect", "table1"], "Gyro", names=[perfect, "ACF17's gyro"])
    q.axis("unknown", UNKNOWNS, "Unknown", names=NAMES)
    q.axis("coefficients", ["q1_q2", "q1_q3", "q2_q3"], "Coefficients")
    q.axis("method", COMPARED, "Method", names=METHOD_NAMES)
    q.axis("ratio", list(RATIOS), "Methods")
    q.axis("error", ERRORS, "Error")
    q.axis("factor", factors, "Gyro noise", names=[f"{v:g} × ACF17 Table 1" if v else perfect for v in factors])
    q.axis("swept", SWEPT, "Method", names=METHOD_NAMES)
    return q


@dataclass(frozen=True, slots=True, kw_only=True)
class Failed:
    """Calibrations of a method that did not converge, and the number of all."""

    failed: int = col("Failed")
    n: int = col("Calibrations")


@dataclass(frozen=True, slots=True, kw_only=True)
class Failures:
    """Judged number of failures; in the sweep some are expected: two stars per frame, a gyro of large noise."""

    failures_n: int = col("Calibrations that did not converge")


def failed(trials: Sequence[Trials], method: str) -> Failed:
    """Calibrations of a method at some points."""
    status = [
        values
        for one in trials
        for key, values in one.values.items()
        if key.endswith(".converged") and key.split(".")[0].split("@")[0] == method
    ]
    return Failed(failed=int(sum((one < 0.5).sum() for one in status)), n=sum(len(one) for one in status))


def run(config: Config, *, progress: Progress) -> dict[str, Any]:
    """Simulate, calibrate, compare."""
    check_design(config)
    with progress.stage("implied pixel"):
        guess = implied()
    pixel_um, stars = round(guess.pixel_um.value, 2), max(round(guess.stars), 2)
    first, inferred, sweep = table2_point(config), inferred_point(config, pixel_um, stars), sweep_points(config)
    figures = [first, inferred, *counts_points(config), *fig3_points(config), *fig5_points(config)]
    with progress.stage("Monte Carlo", total=sum(point.runs for point in (*figures, *sweep))) as stage:
        trials = perform(config, [*figures, *sweep], advance=stage.advance)
    with progress.stage("predictions"):
        return _sections(config, trials, figures) | {
            "implied": guess,
            "fig4": fig4(config, trials, inferred),
            "matching": [matching_stars(config, um) for um in (config.camera.pixel_pitch_um, pixel_um)],
        }


def _sections(config: Config, trials: Mapping[str, Trials], figures: Sequence[Point]) -> dict[str, Any]:
    sky = sky_of(config, figures[0], 0)
    by_bias, by_walk = fig3(config, trials)
    expected = covariances(config, figures[0])
    of_figures = [trials[point.name] for point in figures]
    of_sweep = [trials[point.name] for point in sweep_points(config)]
    not_converged = [failed(of_figures, method) for method in COMPARED]
    return {
        "night": Night(
            stars_per_frame=len(sky.stars) / config.frames,
        ),
        "levels": Levels(
            noise_px=config.noise_px,
            bias=(0.0, *config.bias_deg_per_h),
            walk=(0.0, *config.angle_random_walk_deg_per_sqrt_h),
            stars=config.sweep.stars,
            factor=config.sweep.gyro_factor,
            skies=config.sweep.skies,
        ),
        "fig3a": by_bias,
        "fig3b": by_walk,
        "counts": counts(config, trials),
        "reprojection": overall(config, trials),
        "table2": table2(config, trials, expected),
        "sums": sums(config, trials, expected),
        **methods(config, trials),
        "gain": gains(config, trials),
        "failed": not_converged,
        "failed_sweep": [failed(of_sweep, method) for method in SWEPT],
        "failures": Failures(failures_n=sum(one.failed for one in not_converged)),
    }


SECTIONS = {
    "night": Section(record=Night),
    **REPROJECTION,
    **TABLE2,
    **METHODS,
    **GAIN,
    "levels": Section(record=Levels),
    "failed": Section(record=Failed, dim="method"),
    "failed_sweep": Section(record=Failed, dim="swept"),
    "failures": Section(
        record=Failures,
        verdicts=[
            below(
                "failures_n",
                0.0,
                title="Fig. 3 to 5 and Table 2: calibrations that did not converge, all methods",
                advice="use a better start value (start.focal_length_mm), or set start.phi_from_stars=true",
            )
        ],
    ),
}
