"""Criteria that several tests with point targets share: paths to the same number that have no reduction in common."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from scipy.stats import norm, t

from experiments.harness.summary import Criterion
from experiments.laboratory.instrument import Instrument
from optics.arrays import FloatArray
from optics.errors import DomainError
from optics.lens.system import LensSystem
from optics.rays.paraxial import axial_paraxial, chief_ray
from optics.rays.pupil import gauss_disk
from optics.rays.spots import spot_moments

__all__ = ["MOTION_RATIO", "as_the_paper", "centroids_on_the_light", "pixel_angle", "two_sided_limit"]

FALSE_ALARM = 1e-3
"""Chance that a criterion of this module fails by noise alone; that of 3.29 standard deviations of one number."""
WINDOW_PX = {"cog": 0.05, "epsf": 0.001}
"""Centroiders whose mean is that of all the light, with what may part them from it besides noise: a window that cuts
the wings of a spot shifts its centre of gravity. The others follow the core of a spot with a tail."""
MOTION_RATIO = 0.01
"""What a known motion may be off besides noise: it is that of some sixty rays of each bundle."""


def two_sided_limit(count: int, false_alarm: float = FALSE_ALARM) -> float:
    """Standard deviations that the largest of ``count`` normal deviates exceeds with probability ``false_alarm``."""
    return float(norm.isf(false_alarm / (2 * count)))


def as_the_paper(name: str, reported: Any, printed: Any, unit: str) -> Criterion:
    """Numbers of the report against the document's equation, evaluated by `experiments.laboratory.as_printed`."""
    apart = np.abs(np.asarray(reported, float) - np.asarray(printed, float))
    return Criterion(
        name=f"{name}: reported against the printed equation, summed from the centroids by other code",
        value=float(apart.max()),
        limit=1e-9,
        unit=unit,
    )


def pixel_angle(instrument: Instrument) -> Criterion:
    """The angle of a pixel that turns px into arcsec, over that between two traced bundles at both sides of the axis.

    A detector away from the paraxial focus sees another scale, unless the lens is telecentric: that of the paraxial
    chief ray, where the lens is centred. The limit leaves room for what aberrations do to the mean of a bundle.
    """
    camera, apart_deg = instrument.camera, 0.02
    lens = camera.focused_lens
    ends = np.array([-0.5, 0.5]) * apart_deg
    at, samples = lens.design_wavelength_nm, gauss_disk(5, 12)
    along_x = spot_moments(lens, ends, 0.0 * ends, at, samples=samples).x_mm
    along_y = spot_moments(lens, 0.0 * ends, ends, at, samples=samples).y_mm
    distance_px = 0.5 * float(np.ptp(along_x) + np.ptp(along_y)) / camera.pixel_pitch_mm
    return Criterion(
        name="angle of a pixel over that of two traced bundles beside the axis",
        value=instrument.pixel_arcsec * distance_px / (3600.0 * apart_deg),
        limit=0.005,
        about=_chief_ray_scale_mm(lens) / instrument.focal_length_mm,
    )


def _chief_ray_scale_mm(lens: LensSystem) -> float:
    """Height of the paraxial chief ray on the detector per tangent of the field angle, next to the axis [mm].

    That is the focal length in the paraxial focus, and taken as that where a lens is tilted or decentred, which leaves
    no paraxial chief ray, and where the entrance pupil is at infinity.
    """
    field_deg = 0.01
    try:
        scale = abs(chief_ray(lens, field_deg)[0][-1]) / math.tan(math.radians(field_deg))
    except DomainError:
        scale = math.inf
    return scale if math.isfinite(scale) else abs(axial_paraxial(lens, lens.design_wavelength_nm).efl_mm)


def centroids_on_the_light(
    label: str, position_px: Mapping[str, FloatArray], light_px: FloatArray, common_px: float = 0.0
) -> list[Criterion]:
    """Mean of centroid minus noiseless light over all points, by every centroider that follows all the light."""
    found = []
    for method in (one for one in WINDOW_PX if one in position_px):
        apart = (position_px[method] - light_px).reshape(-1, 2)
        count = len(apart)
        # of the mean, from the scatter over the points: noise, fixed pattern and S-curve of each are in it
        error = np.hypot(apart.std(axis=0, ddof=1) / np.sqrt(count), common_px)
        found.append(
            Criterion(
                name=f"{label}{method}: centroid minus noiseless light, mean of {count}, larger of x and y",
                value=float(np.abs(apart.mean(0)).max()),
                limit=WINDOW_PX[method] + float(t.isf(FALSE_ALARM / 4, count - 1) * error.max()),
                unit="px",
            )
        )
    return found
