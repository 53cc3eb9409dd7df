"""Checks for impossible lenses: an image plane inside the lens, crossing surfaces, a stop that does not limit the beam.

Such lenses can often be traced without an error. The checks apply to surfaces on one common axis; effects of tilts and
decentres are not checked.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np

from optics.arrays import FloatArray
from optics.lens.system import STOP_ALONE, LensSystem, Surface

HEIGHTS = 64
"""Heights at which surfaces are compared."""
TOUCHING_MM = 1e-6
USED_STOP = 0.75
"""Least part of the radius of a stop that the rest of the lens leaves open on the axis."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SurfaceCrossing:
    """Two crossing surfaces of a lens: their numbers, the smallest height of crossing [mm], a message."""

    surfaces: tuple[int, int]
    from_mm: float
    message: str


def geometry_faults(lens: LensSystem) -> tuple[str, ...]:
    """Faults of a lens geometry, one line each; empty for a possible lens."""
    return (*_image_plane(lens), *(crossing.message for crossing in crossings(lens)), *idle_stop(lens))


def acts(lens: LensSystem, number: int) -> bool:
    """Whether a surface refracts, reflects or scatters light, not only stops it."""
    surface = lens.surfaces[number]
    return surface.mirror or surface.shape.redirects or lens.media[number] != lens.media[number + 1]


def _image_plane(lens: LensSystem) -> list[str]:
    """The image plane has to lie behind the last surface."""
    at = max(i for i, s in enumerate(lens.surfaces) if s.is_stop or acts(lens, i))
    last = lens.surfaces[at]
    behind = float((lens.image_position_mm - last.position_mm) @ lens.axis[-1])
    if behind > 0.0:
        return _past_the_image(lens, at, behind, lens.label(at))
    what = "the stop" if last.is_stop else f"{lens.label(at)}, the last that acts on light"
    return [
        f"the image plane lies {-behind:g} mm in front of {what}; it must lie behind it (no detector stands in a "
        "virtual image): check stop.z_mm and the thicknesses"
    ]


def _past_the_image(lens: LensSystem, number: int, behind_mm: float, name: str) -> list[str]:
    """The last surface has to end before the image plane where the light of the axis meets it."""
    last, stop, height = lens.surfaces[number], lens.surfaces[lens.stop_index], axial_ray(lens)[0]
    upright = last.shape.rotational and np.array_equal(last.rotation, lens.image_rotation)
    if not upright or height[lens.stop_index] == 0.0 or not math.isfinite(stop.semi_diameter_mm):
        return []
    light_mm = abs(stop.semi_diameter_mm * height[number] / height[lens.stop_index])
    x = np.linspace(0.0, min(light_mm, last.semi_diameter_mm), HEIGHTS)
    with np.errstate(all="ignore"):
        sag = last.shape.sag(x, 0.0 * x) * float(lens.axis[-1] @ last.rotation[:, 2])
    past = ~(sag < behind_mm)
    if not past.any():
        return []
    return [
        f"{name}, the last, reaches the image plane, {behind_mm:g} mm behind its vertex, {x[past][0]:.4g} mm from the "
        "axis already, within the light: check its radius and the coefficients of its asphere"
    ]


def _axial_distance(front: Surface, back: Surface) -> float | None:
    """Distance from one vertex to the other along the axis of both, None where they do not share one."""
    shift = front.rotation.T @ (back.position_mm - front.position_mm)
    coaxial = np.array_equal(front.rotation, back.rotation) and not shift[:2].any()
    return float(shift[2]) if coaxial and front.shape.rotational and back.shape.rotational else None


def crossings(lens: LensSystem) -> list[SurfaceCrossing]:
    """Surfaces that follow each other and meet inside both their rims."""
    real = [(i, s) for i, s in enumerate(lens.surfaces) if s.shape.curvature != 0.0 or acts(lens, i)]
    faults = []
    for (i, front), (j, back) in itertools.pairwise(real):
        distance = _axial_distance(front, back)
        radius = min(front.semi_diameter_mm, back.semi_diameter_mm)
        if distance is None or not math.isfinite(radius):
            continue
        height = np.linspace(0.0, radius, HEIGHTS)
        with np.errstate(all="ignore"):  # powers of an absurd asphere
            gap = distance + back.shape.sag(height, 0.0 * height) - front.shape.sag(height, 0.0 * height)
        if not np.isfinite(gap).all():
            message = f"{lens.label(i)} or {lens.label(j)} does not reach its rim at {radius:g} mm"
        elif gap.min() < -TOUCHING_MM:
            what = f"{front.medium} between them would be" if front.medium != "air" else "they would overlap by"
            at = height[int(np.argmin(gap))]
            amount = f"{gap.min():.4g}" if front.medium != "air" else f"{-gap.min():.4g}"
            message = (
                f"{lens.label(i)} and {lens.label(j)} cross: at {at:.4g} mm from the axis {what} {amount} mm; at least "
                "0 mm is needed: check radii, thickness_mm and semi_diameter_mm"
            )
        elif distance < TOUCHING_MM and front.medium not in ("air", "vacuum") and not front.mirror and not back.mirror:
            message = (
                f"{front.medium} between {lens.label(i)} and {lens.label(j)} has no thickness on the axis; it must be "
            )
            message += "more than 0 mm: check thickness_mm"
            gap[0] = -math.inf  # from the axis on
        else:
            continue
        first = float(height[int(np.argmax(~(gap >= -TOUCHING_MM)))])
        faults.append(SurfaceCrossing(surfaces=(i, j), from_mm=first, message=message))
    return faults


def idle_stop(lens: LensSystem) -> list[str]:
    """Fault of a stop that does not limit the light on the axis, because another rim does."""
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
    what = lens.label(lens.stop_index)
    return [
        f"{what if what == STOP_ALONE else f'the stop, {what},'} has semi_diameter_mm = {stop.semi_diameter_mm:g} mm, "
        f"but on the axis the rim of {lens.label(worst)} leaves only {room[worst] * stop.semi_diameter_mm:.4g} mm of "
        "it; a stop must limit the light: close it, or open that surface"
    ]


def axial_ray(lens: LensSystem) -> tuple[FloatArray, float]:
    """Paraxial heights (surfaces,) of a ray that is parallel to the axis at height 1, and the focal length [mm]."""
    index = lens.indices(lens.design_wavelength_nm)
    y, nu, at, heights = 1.0, 0.0, lens.surfaces[0].position_mm, []
    for i, surface in enumerate(lens.surfaces):
        y += float((surface.position_mm - at) @ lens.axis[i]) * nu / float(index[i])
        nu -= y * surface.shape.power(
            *(float(n) for n in (index[i], -index[i] if surface.mirror else index[i + 1], index[0]))
        )
        at = surface.position_mm
        heights.append(y)
    return np.array(heights), -float(index[-1]) / nu if nu else math.inf
