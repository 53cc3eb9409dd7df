"""What no lens can be: an image plane inside it, rims that cross, a stop that stops nothing.

Such a lens can be traced, often without a sign that anything is wrong. What is said here is said of lenses whose
surfaces stand on one axis; what tilts and decentres do is the designer's affair.
"""

from __future__ import annotations

import itertools
import math

import numpy as np

from optics.arrays import FloatArray
from optics.lens.system import LensSystem, Surface

__all__ = ["axial_ray", "geometry_faults"]


HEIGHTS = 64
"""Heights at which surfaces are compared."""
TOUCHING_MM = 1e-6
USED_STOP = 0.75
"""Least part of the radius of a stop that the rest of the lens leaves open on the axis."""


def geometry_faults(lens: LensSystem) -> tuple[str, ...]:
    """What is impossible about a lens, one line each; nothing for a lens that may be."""
    return (*_image_plane(lens), *_crossing(lens), *_idle_stop(lens))


def _image_plane(lens: LensSystem) -> list[str]:
    """The image plane has to lie behind the last surface."""
    last = lens.surfaces[-1]
    behind = float((lens.image_position_mm - last.position_mm) @ lens.axis[-1])
    if behind > 0.0:
        return []
    what = "the stop" if last.is_stop else f"surface {len(lens.surfaces) - 1}, the last,"
    return [
        f"the image plane lies {-behind:g} mm in front of {what}; it must lie behind it: check stop.z_mm and the "
        "thicknesses"
    ]


def _on_one_axis(one: Surface, other: Surface) -> float | None:
    """Distance from one vertex to the other along the axis of both, None where they do not share one."""
    shift = one.rotation.T @ (other.position_mm - one.position_mm)
    same = np.array_equal(one.rotation, other.rotation) and not shift[:2].any()
    return float(shift[2]) if same and one.shape.rotational and other.shape.rotational else None


def _crossing(lens: LensSystem) -> list[str]:
    """Surfaces that follow each other must not meet inside both their rims."""
    real = [(i, s) for i, s in enumerate(lens.surfaces) if not s.is_stop or s.shape.curvature != 0.0]
    faults = []
    for (i, one), (j, other) in itertools.pairwise(real):
        distance = _on_one_axis(one, other)
        radius = min(one.semi_diameter_mm, other.semi_diameter_mm)
        if distance is None or not math.isfinite(radius):
            continue
        height = np.linspace(0.0, radius, HEIGHTS)
        gap = distance + other.shape.sag(height, 0.0 * height) - one.shape.sag(height, 0.0 * height)
        if not np.isfinite(gap).all():
            faults.append(f"surface {i} or {j} does not reach its rim at {radius:g} mm")
        elif gap.min() < -TOUCHING_MM:
            what = f"{one.medium} between them would be" if one.medium != "air" else "they would overlap by"
            at = height[int(np.argmin(gap))]
            amount = f"{gap.min():.4g}" if one.medium != "air" else f"{-gap.min():.4g}"
            faults.append(
                f"surfaces {i} and {j} cross: at {at:.4g} mm from the axis {what} {amount} mm; "
                "at least 0 mm is needed: check radii, thickness_mm and semi_diameter_mm"
            )
    return faults


def _idle_stop(lens: LensSystem) -> list[str]:
    """The stop has to limit the light on the axis, not another rim long before it."""
    stop = lens.surfaces[lens.stop_index]
    if not math.isfinite(stop.semi_diameter_mm):
        return []
    height = axial_ray(lens)[0]
    if height[lens.stop_index] == 0.0:
        return []
    heights = height * (stop.semi_diameter_mm / height[lens.stop_index])
    with np.errstate(divide="ignore"):
        room = np.array([s.semi_diameter_mm for s in lens.surfaces]) / np.abs(heights)
    room[lens.stop_index] = np.inf
    worst = int(np.argmin(room))
    if room[worst] >= USED_STOP:
        return []
    return [
        f"the stop, surface {lens.stop_index}, has semi_diameter_mm = {stop.semi_diameter_mm:g} mm, but on the axis "
        f"the rim of surface {worst} leaves only {room[worst] * stop.semi_diameter_mm:.4g} mm of it; a stop must limit "
        "the light: close it, or open that surface"
    ]


def axial_ray(lens: LensSystem) -> tuple[FloatArray, float]:
    """Paraxial heights (surfaces,) of a ray that is parallel to the axis at height 1, and the focal length [mm]."""
    index = lens.indices(lens.design_wavelength_nm)
    y, nu, at, found = 1.0, 0.0, lens.surfaces[0].position_mm, []
    for i, surface in enumerate(lens.surfaces):
        y += float((surface.position_mm - at) @ lens.axis[i]) * nu / float(index[i])
        nu -= y * surface.shape.power(
            *(float(n) for n in (index[i], -index[i] if surface.mirror else index[i + 1], index[0]))
        )
        at = surface.position_mm
        found.append(y)
    return np.array(found), -float(index[-1]) / nu if nu else math.inf
