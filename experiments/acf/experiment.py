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
from experiments.acf.gain import GAIN, SWEPT, gain_by_stars, sweep_points
from experiments.acf.methods import ERRORS, METHODS, RATIOS, compare_methods, fig5_points
from experiments.acf.reprojection import (
    REPROJECTION,
    counts_points,
    fig3,
    fig3_points,
    fig4,
    infer_star_count,
    inferred_point,
    pool_ratios,
    sweep_star_counts,
    table2_point,
)
from experiments.acf.settings import AcfConfig
from experiments.acf.simulate import build_camera
from experiments.acf.table2 import NAMES, TABLE2, UNKNOWNS, covariances, degeneracy, implied, table2
from experiments.acf.trials import COMPARED, TrialPoint, Trials, run_trials, sky_of
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
MIN_EIGENVALUE_RATIO = 1e-12
"""Smallest over largest eigenvalue of the scaled normal matrix below which an unknown is not determined."""
MAX_DISTORTION = 0.3
"""Displacement at a corner over its distance from the principal point; the adjustments start without distortion."""
MAX_INSTALLATION_SIGMA_DEG = 1.0
"""Largest standard deviation of an installation angle at which the adjustment is still linear."""


def check_design(config: AcfConfig) -> None:
    """Refuse a camera of mostly distortion, and a night that cannot determine all 14 unknowns."""
    _check_distortion(config)
    if config.gyro.motion == "fixed_axis":
        raise DomainError(
            "gyro.motion = 'fixed_axis': the rotation of the installation about this axis is not observable, 13 of "
            "the 14 unknowns are determined; use 'turning_axis'"
        )
    for point, key in ((table2_point(config), "sky.stars_per_frame"), (counts_points(config)[0], "counts")):
        _check_point(config, point, key)


def _check_distortion(config: AcfConfig) -> None:
    """Refuse a distortion that moves a corner by more than `MAX_DISTORTION` of its radius."""
    camera = build_camera(config)
    pinhole = BrownConrady.create(
        camera.geometry,
        focal_length_mm=config.camera.focal_length_mm,
        x0_px=config.camera.x0_px,
        y0_px=config.camera.y0_px,
    )
    corner = camera.geometry.grid_px(2)
    displacement_px = np.hypot(*(pinhole.project(camera.unproject(corner)) - corner).T)
    radius_px = np.hypot(*(corner - camera.geometry.centre_px - camera.parameters[:2]).T)
    distortion = float((displacement_px / radius_px).max())
    if not distortion <= MAX_DISTORTION:
        raise DomainError(
            f"camera: this distortion moves the image by {100 * distortion:.0f} % of its distance from the principal "
            f"point at a corner of the detector; at most {100 * MAX_DISTORTION:.0f} % is possible: use smaller "
            "q1_per_mm2 ... p2_per_mm"
        )


def _check_point(config: AcfConfig, point: TrialPoint, key: str) -> None:
    """Refuse stars behind the start camera, a singular normal matrix, and an installation determined too poorly."""
    sky = sky_of(config, point, 0)
    behind = int((sky.stars.direction[sky.used, 2] <= 0.0).sum())
    if behind and not config.start.phi_from_stars:
        raise DomainError(
            f"sky.phi_deg = {list(config.sky.phi_deg)} deg: from ACF17's start, phi = 0, {behind} of "
            f"{int(sky.used.sum())} stars are behind the camera; set start.phi_from_stars=true"
        )
    design = sky.calibrating
    if not design.least_information() > MIN_EIGENVALUE_RATIO:
        raise DomainError(
            f"{key}: {len(design.frame)} stars in the frames that calibrate do not determine the 14 unknowns; more "
            "stars or frames are needed"
        )
    covariance = correlated_covariance(design, max(config.noise_px))
    sigma_deg = float(np.degrees(np.sqrt(np.diag(covariance)[-3:].max())))
    if not sigma_deg <= MAX_INSTALLATION_SIGMA_DEG:
        rotation_deg = float(np.degrees(Rotation.from_matrix(design.link[:, :, :3]).magnitude().max()))
        raise DomainError(
            f"the installation would be determined to {sigma_deg:.1f} deg only (the body turns by "
            f"{rotation_deg:.2g} deg, {len(design.frame)} stars calibrate); at most {MAX_INSTALLATION_SIGMA_DEG:g} "
            "deg can be calibrated: a faster gyro.angular_speed_deg_per_s, more frames or more stars "
            f"({key}) are needed"
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class Night:
    """The sky of Fig. 3 to 5 and Table 2."""

    stars_per_frame: float = col("Stars", "per frame", ".0f")


@dataclass(frozen=True, slots=True, kw_only=True)
class Levels:
    """Values of the settings that are varied."""

    noise_px: Sequence[float] = col("Star noise", "px", dims="noise")
    bias_deg_per_h: Sequence[float] = col("Bias", "°/h", dims="bias")
    angle_random_walk_deg_per_sqrt_h: Sequence[float] = col("Angle random walk", "°/√h", dims="walk")
    stars_per_frame: Sequence[int] = col("Stars", "per frame", dims="stars")
    gyro_factor: Sequence[float] = col("Gyro noise", dims="factor")
    skies: int = col("Skies")


def axes(config: AcfConfig) -> Quantities:
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
class Convergence:
    """Number of calibrations of a method that did not converge."""

    failed: int = col("Failed")
    n: int = col("Calibrations")


@dataclass(frozen=True, slots=True, kw_only=True)
class AllConvergence:
    """Failures outside the sweep of stars per frame, whose two stars or whose noisy gyro may not converge."""

    failed: int = col("Calibrations that did not converge")


def convergence(trials: Sequence[Trials], method: str) -> Convergence:
    """Calibrations of a method at some points."""
    converged = np.concatenate(
        [
            values
            for point in trials
            for key, values in point.values.items()
            if key.endswith(".converged") and key.split(".")[0].split("@")[0] == method
        ]
    )
    return Convergence(failed=int((converged < 0.5).sum()), n=len(converged))


def run(config: AcfConfig, *, progress: Progress) -> dict[str, Any]:
    """Simulate, calibrate, compare."""
    check_design(config)
    with progress.stage("implied pixel"):
        from_table2 = implied()
    pixel_um = round(from_table2.pixel_um.value, 2)
    stars = max(round(from_table2.stars_per_frame), 2)
    inferred = inferred_point(config, pixel_um, stars)
    sweep = sweep_points(config)
    figures = [table2_point(config), inferred, *counts_points(config), *fig3_points(config), *fig5_points(config)]
    with progress.stage("Monte Carlo", total=sum(point.runs for point in (*figures, *sweep))) as stage:
        trials = run_trials(config, [*figures, *sweep], advance=stage.advance)
    with progress.stage("predictions"):
        return _sections(config, trials, figures) | {
            "implied": from_table2,
            "fig4": fig4(config, trials, inferred),
            "matching": [infer_star_count(config, um) for um in (config.camera.pixel_pitch_um, pixel_um)],
        }


def _sections(config: AcfConfig, trials: Mapping[str, Trials], figures: Sequence[TrialPoint]) -> dict[str, Any]:
    sky = sky_of(config, figures[0], 0)
    by_bias, by_walk = fig3(config, trials)
    expected = covariances(config, figures[0])
    of_figures = [trials[point.name] for point in figures]
    of_sweep = [trials[point.name] for point in sweep_points(config)]
    by_method = [convergence(of_figures, method) for method in COMPARED]
    return {
        "night": Night(stars_per_frame=len(sky.stars) / config.frames),
        "levels": Levels(
            noise_px=config.noise_px,
            bias_deg_per_h=(0.0, *config.bias_deg_per_h),
            angle_random_walk_deg_per_sqrt_h=(0.0, *config.angle_random_walk_deg_per_sqrt_h),
            stars_per_frame=config.sweep.stars,
            gyro_factor=config.sweep.gyro_factor,
            skies=config.sweep.skies,
        ),
        "fig3a": by_bias,
        "fig3b": by_walk,
        "counts": sweep_star_counts(config, trials),
        "reprojection": pool_ratios(config, trials),
        "table2": table2(config, trials, expected),
        "degeneracy": degeneracy(config, trials, expected),
        **compare_methods(config, trials),
        "gain": gain_by_stars(config, trials),
        "convergence": by_method,
        "convergence_sweep": [convergence(of_sweep, method) for method in SWEPT],
        "convergence_all": AllConvergence(failed=sum(method.failed for method in by_method)),
    }


SECTIONS = {
    "night": Section(record=Night),
    **REPROJECTION,
    **TABLE2,
    **METHODS,
    **GAIN,
    "levels": Section(record=Levels),
    "convergence": Section(record=Convergence, dim="method"),
    "convergence_sweep": Section(record=Convergence, dim="swept"),
    "convergence_all": Section(
        record=AllConvergence,
        verdicts=[
            below(
                "failed",
                0.0,
                title="Fig. 3 to 5 and Table 2: calibrations that did not converge, all methods",
                advice="use a better start value (start.focal_length_mm), or set start.phi_from_stars=true",
            )
        ],
    ),
}
