"""What the experiment refuses before its long work: designs in which an unknown does not show."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from calib.cameras.brown_conrady import BrownConrady
from experiments.acf.linear_model import correlated
from experiments.acf.points import Point, make_plan
from experiments.acf.settings import Config
from experiments.acf.simulate import build_camera
from experiments.acf.trials import sky_of
from optics.errors import DomainError

__all__ = ["check_design"]

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
            "gyro.motion = 'fixed_axis': the installation's turn about that axis does not show in any star, 13 of the "
            "14 unknowns can be found; use 'turning_axis'"
        )
    plan = make_plan(config, inferred_um=config.camera.pixel_um, inferred_stars=config.counts[0])
    for point, key in ((plan.table2, "sky.stars_per_frame"), (plan.counts[0], "counts")):
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
    moved = np.linalg.norm(plain.project(camera.unproject(corner)) - corner, axis=1)
    part = float((moved / np.linalg.norm(corner - camera.geometry.centre_px - camera.parameters[:2], axis=1)).max())
    if not part <= MOST_DISTORTION:
        raise DomainError(
            f"camera: this distortion moves the image by {100 * part:.0f} % of its distance from the principal point "
            f"at a corner of the detector; at most {100 * MOST_DISTORTION:.0f} % are possible: use smaller q1_per_mm2 "
            "... p2_per_mm"
        )


def _check_point(config: Config, point: Point, key: str) -> None:
    sky = sky_of(config, point, 0)
    behind = int((sky.stars.direction[sky.used, 2] <= 0.0).sum())
    if behind and not config.start.phi_from_stars:
        raise DomainError(
            f"sky.phi_deg = {list(config.sky.phi_deg)} deg: from the document's start, phi = 0, {behind} of "
            f"{int(sky.used.sum())} stars are behind the camera; set start.phi_from_stars=true"
        )
    design = sky.design.select(sky.used)
    swept_deg = float(np.degrees(Rotation.from_matrix(design.link[:, :, :3]).magnitude().max()))
    columns = design.by_unknown()
    if len(columns) >= columns.shape[1]:
        scaled = columns / np.maximum(np.sqrt((columns**2).sum(0)), 1e-300)
        size = np.linalg.svd(scaled, compute_uv=False) ** 2
        if size[-1] > LEAST_PART * size[0]:
            covariance = correlated(design, max(config.noise_px))
            worst_deg = float(np.degrees(np.sqrt(np.diag(covariance)[-3:].max())))
            if worst_deg <= WORST_DEG:
                return
            raise DomainError(
                f"the installation would be known to {worst_deg:.1f} deg only (the body turns by {swept_deg:.2g} deg, "
                f"{len(design.frame)} stars calibrate); at most {WORST_DEG:g} deg can be adjusted: a faster "
                f"gyro.angular_speed_deg_per_s, more frames or more stars ({key}) are needed"
            )
    raise DomainError(
        f"{key}: {len(design.frame)} stars in the frames that calibrate do not determine the 14 unknowns; more "
        "stars or frames are needed"
    )
