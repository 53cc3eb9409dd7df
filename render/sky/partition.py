"""Partition of boresights among training, validation and test, so that no star of one part is seen in another.

Parts are separated by gaps as wide as the field's diagonal: two boresights of different parts are at least that far
apart. Frames in gaps belong to no part. Functions take the fractions of the parts and give ``part_of(boresight)``.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq
from scipy.spatial import cKDTree

from optics.arrays import FloatArray
from optics.errors import DomainError
from optics.units import DEG_RAD, RAD_DEG

PARTS = ("train", "validation", "test")
GAP = "gap"
WIDEST_GAP_RAD = 0.5 * math.pi
LEAST_USED = 0.5
CONE_POINTS = 20_000
PartOf = Callable[[FloatArray], str]


def parts_by_caps(fraction: Mapping[str, float], pole: FloatArray, gap_rad: float) -> PartOf:
    """All of the sky: a cap about a pole for the test, the opposite one for validation, the rest for training.

    The caps are as large as makes the fractions right among the frames that are in no gap, of less than 90 deg.
    """
    if gap_rad >= WIDEST_GAP_RAD:
        raise DomainError(f"gap_deg = {gap_rad * RAD_DEG:g} deg; less than 90 deg is needed")

    def edges(used: float) -> tuple[float, float, float, float]:
        """Radii of both caps, and of both with the gap about them, if this part of the sky counts."""
        radii = [math.acos(1.0 - 2.0 * fraction[name] * used) for name in ("test", "validation")]
        wide = [radius + gap_rad if radius > 0 else 0.0 for radius in radii]
        return radii[0], radii[1], wide[0], wide[1]

    def surplus(used: float) -> float:
        _, _, test, validation = edges(used)
        return 0.5 * (math.cos(test) + math.cos(validation)) - fraction["train"] * used

    used = 1.0 if surplus(1.0) >= -1e-12 else float(brentq(surplus, 0.0, 1.0))
    test, validation, beyond_test, beyond_validation = edges(used)

    def part_of(boresight: FloatArray) -> str:
        angle = math.acos(float(np.clip(boresight @ pole, -1.0, 1.0)))
        if angle < test:
            return "test"
        if math.pi - angle < validation:
            return "validation"
        return "train" if angle >= beyond_test and math.pi - angle >= beyond_validation else GAP

    return part_of


def cone_directions(axes: FloatArray, radius_rad: float, count: int = CONE_POINTS) -> FloatArray:
    """Directions (n, 3) that fill a cone about the third of the axes (3, 3) evenly: a spiral of the golden angle."""
    order = np.arange(count)
    z = 1.0 - (1.0 - math.cos(radius_rad)) * (order + 0.5) / count
    turn, out = order * math.pi * (3.0 - math.sqrt(5.0)), np.sqrt(np.maximum(1.0 - z**2, 0.0))
    return np.asarray(np.stack([out * np.cos(turn), out * np.sin(turn), z], axis=1) @ axes)


def parts_by_latitude(
    fraction: Mapping[str, float], boresights: FloatArray, gap_rad: float, symmetry_breaking: FloatArray
) -> PartOf:
    """The part of the sky that boresights (n, 3) fill: one side for the test, the other for validation.

    The sides are defined by the latitude above a great circle through the middle, across which the boresights spread
    farthest; two boresights are at least as far apart as their latitudes. ``symmetry_breaking`` (3,): standard normal
    numbers that choose the circle for a cone. `DomainError` where gaps leave less than half of the boresights.
    """
    middle = boresights.mean(0) / max(float(np.linalg.norm(boresights.mean(0))), 1e-9)
    aside = boresights - np.outer(boresights @ middle, middle) + 1e-3 * symmetry_breaking
    pole = np.linalg.svd(aside - aside.mean(0), full_matrices=False)[2][0]
    latitude = np.arcsin(np.clip(boresights @ pole, -1.0, 1.0))
    gaps = [gap_rad if fraction[name] > 0 else 0.0 for name in ("validation", "test")]
    for used in np.linspace(1.0, LEAST_USED, 51):
        low = float(np.quantile(latitude, fraction["validation"] * used)) if gaps[0] else -math.inf
        high = float(np.quantile(latitude, 1.0 - fraction["test"] * used)) if gaps[1] else math.inf
        inner = low + gaps[0], high - gaps[1]
        if np.mean((latitude >= inner[0]) & (latitude <= inner[1])) >= fraction["train"] * used - 1e-9:
            break
    else:
        raise DomainError(
            f"gap_deg = {gap_rad * RAD_DEG:g} deg: the boresights lie within {np.ptp(latitude) * RAD_DEG:.3g} deg, "
            "such gaps leave less than half of the frames; take a smaller one, or splits.by = frame"
        )

    def part_of(boresight: FloatArray) -> str:
        here = math.asin(float(np.clip(boresight @ pole, -1.0, 1.0)))
        if here > high:
            return "test"
        if here < low:
            return "validation"
        return "train" if inner[0] <= here <= inner[1] else GAP

    return part_of


def parts_by_arcs(fraction: Mapping[str, float], pole: FloatArray, start: FloatArray, gap_rad: float) -> PartOf:
    """Arcs of the circle of a boresight that begins at ``start`` and turns about ``pole``, each followed by a gap.

    The sequence repeats as often as leaves half of the circle to frames that count: short scans have all parts; the
    scan may go round many times. `DomainError` on a circle without room for the gaps.
    """
    radius = math.acos(float(np.clip(pole @ start, -1.0, 1.0)))
    chord = math.sin(0.5 * gap_rad) / math.sin(radius) if math.sin(radius) > 1e-9 else math.inf
    parts = {name: fraction[name] for name in PARTS if fraction[name] > 0}
    gap = 2.0 * math.asin(min(chord, 1.0)) if len(parts) > 1 else 0.0
    period = 2.0 * math.pi / max(1, int(math.pi / (len(parts) * gap))) if gap > 0 else 2.0 * math.pi
    used = period - len(parts) * gap
    if chord >= 1.0 or used <= 0:
        raise DomainError(
            f"gap_deg = {gap_rad * RAD_DEG:g} deg: a circle of {radius * RAD_DEG:g} deg radius has no room "
            f"for {len(parts)} such gaps; use a smaller one, or splits.by = frame"
        )
    across = np.cross(pole, start)

    def part_of(boresight: FloatArray) -> str:
        turn = math.atan2(float(boresight @ across), float(boresight @ (start - (start @ pole) * pole)))
        along = turn % (2.0 * math.pi) % period
        for name, part in parts.items():
            if along < part * used:
                return name
            along -= part * used + gap
            if along < 0:
                return GAP
        return GAP

    return part_of


@dataclass(frozen=True, slots=True, kw_only=True)
class Leak:
    """Overlap of the frames of a part with the training frames."""

    frames: int  # Frames of the part
    near: int  # Those within half a field's diagonal of a training frame
    shared: int  # Those within a whole one: they may show the same stars
    nearest_deg: float  # Smallest angle to a training frame; NaN without frames


def leakage(boresights: Mapping[str, Sequence[tuple[float, float]]], diagonal_deg: float) -> dict[str, Leak]:
    """Leakage of validation and test, from the boresights (ra, dec) [deg] of the frames of every part."""

    def directions(name: str) -> FloatArray:
        ra, dec = (np.array(boresights.get(name, ()), float).reshape(-1, 2) * DEG_RAD).T
        return np.stack([np.cos(dec) * np.cos(ra), np.cos(dec) * np.sin(ra), np.sin(dec)], axis=1)

    training, leaks = directions("train"), {}
    for name in PARTS[1:]:
        part_directions = directions(name)
        if not len(part_directions):
            continue
        chord = cKDTree(training).query(part_directions)[0] if len(training) else np.full(len(part_directions), np.nan)
        angle = np.degrees(2.0 * np.arcsin(np.clip(0.5 * chord, 0.0, 1.0)))
        leaks[name] = Leak(
            frames=len(part_directions),
            near=int((angle < 0.5 * diagonal_deg).sum()),
            shared=int((angle < diagonal_deg).sum()),
            nearest_deg=float(angle.min()),
        )
    return leaks
