"""Training, validation and test splits by the sky, so that no star of a test frame occurs in training.

Random attitudes over the sky: a cap about a random pole is for the test, the opposite cap for validation, the rest for
training; gaps as wide as the field's diagonal separate them, so that no star is in two splits. A scan runs along a
circle, once or many times: it is cut into arcs with the same gaps. A cone, or the attitudes of a list, are cut across:
one side is for the test, the other for validation, the middle for training. Frames in gaps belong to no split
(``gap``). If gaps would leave less than half of the frames, and in all other cases, frames are assigned at random, and
the leakage is reported (`leakage`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Literal

import numpy as np
from scipy.optimize import brentq
from scipy.spatial import cKDTree

from experiments.dataset.settings import ConePointing, Config, ScanPointing, SkyPointing, SplitsConfig
from optics.arrays import FloatArray
from optics.attitude import attitude_from_angles
from optics.errors import DomainError
from optics.units import DEG_RAD, RAD_DEG
from render.engine.random import Streams

SPLITS = ("train", "validation", "test")
GAP = "gap"
BLOCK = 100
WIDEST_GAP_RAD = 0.5 * math.pi
CONE_POINTS = 20_000
LEAST_USED = 0.5


@dataclass(frozen=True, slots=True, kw_only=True)
class Splits:
    """Split of the frames of a dataset."""

    by: Literal["sky", "arc", "frame"]  # "sky", "arc" or "frame"
    gap_deg: float  # Least angle between boresights of two splits; 0 by frame
    of: Callable[[int, FloatArray], str]  # ``of(frame, boresight)``: name of the split, `GAP` for none


def build_splits(config: Config, streams: Streams, diagonal_deg: float, listed: FloatArray | None = None) -> Splits:
    """The splits of a dataset; which one a frame is in follows from configuration, number and boresight."""
    splits = config.splits
    gap_rad = (diagonal_deg if splits.gap_deg is None else splits.gap_deg) * DEG_RAD
    circle, looks = _circle(config), listed if listed is not None else _cone(config)
    if splits.by == "auto":
        with suppress(DomainError):  # a field too wide, a scan about the boresight
            if circle is not None:
                return _by_arc(splits, *circle, gap_rad)
            if looks is not None or isinstance(config.pointing, SkyPointing):
                return _by_sky(splits, streams, gap_rad, looks)
    if splits.by == "sky":
        return _by_sky(splits, streams, gap_rad, looks)
    if splits.by == "arc":
        if circle is None:
            raise DomainError("splits.by = arc needs a scan at a constant rate across the sky; take sky or frame")
        return _by_arc(splits, *circle, gap_rad)
    return Splits(by="frame", gap_deg=0.0, of=lambda frame, _: _of_block(splits, streams, frame))


def _by_sky(splits: SplitsConfig, streams: Streams, gap_rad: float, looks: FloatArray | None) -> Splits:
    """Regions of all the sky, or of the part that boresights ``looks`` (n, 3) fill."""
    return _by_caps(splits, streams, gap_rad) if looks is None else _by_side(splits, streams, looks, gap_rad)


def _by_caps(splits: SplitsConfig, streams: Streams, gap_rad: float) -> Splits:
    """Caps about a random pole and its opposite, as large as makes the shares right among the frames that count."""
    if gap_rad >= WIDEST_GAP_RAD:
        raise DomainError(f"splits.gap_deg = {gap_rad * RAD_DEG:g} deg; less than 90 deg is needed")
    pole = streams.generator("split pole", 0).standard_normal(3)
    pole /= np.linalg.norm(pole)

    def edges(used: float) -> tuple[float, float, float, float]:
        """Radii of both caps, and of both with the gap about them, if this share of the sky counts."""
        radii = [math.acos(1.0 - 2.0 * part * used) for part in (splits.test_fraction, splits.validation_fraction)]
        wide = [radius + gap_rad if radius > 0 else 0.0 for radius in radii]
        return radii[0], radii[1], wide[0], wide[1]

    def too_much(used: float) -> float:
        _, _, test, validation = edges(used)
        rest = 0.5 * (math.cos(test) + math.cos(validation))
        return rest - splits.train_fraction * used

    used = 1.0 if too_much(1.0) >= -1e-12 else float(brentq(too_much, 0.0, 1.0))
    test, validation, beyond_test, beyond_validation = edges(used)

    def of(_: int, boresight: FloatArray) -> str:
        angle = math.acos(float(np.clip(boresight @ pole, -1.0, 1.0)))
        if angle < test:
            return "test"
        if math.pi - angle < validation:
            return "validation"
        return "train" if angle >= beyond_test and math.pi - angle >= beyond_validation else GAP

    return Splits(by="sky", gap_deg=gap_rad * RAD_DEG, of=of)


def _cone(config: Config) -> FloatArray | None:
    """Boresights (n, 3) that fill the cone of a configuration evenly; None without one."""
    pointing = config.pointing
    if not isinstance(pointing, ConePointing):
        return None
    order = np.arange(CONE_POINTS)
    z = 1.0 - (1.0 - math.cos(pointing.radius_deg * DEG_RAD)) * (order + 0.5) / CONE_POINTS
    turn, out = order * math.pi * (3.0 - math.sqrt(5.0)), np.sqrt(np.maximum(1.0 - z**2, 0.0))
    axes = attitude_from_angles(pointing.ra_deg, pointing.dec_deg, 0.0).as_matrix()
    return np.asarray(np.stack([out * np.cos(turn), out * np.sin(turn), z], axis=1) @ axes)


def _by_side(splits: SplitsConfig, streams: Streams, looks: FloatArray, gap_rad: float) -> Splits:
    """One side of where frames look for the test, the other for validation, the middle for training.

    The sides are defined by the latitude above a great circle through the middle, across which the boresights spread
    farthest (for a cone: a random one); two boresights are at least as far apart as their latitudes.
    """
    middle = looks.mean(0) / max(float(np.linalg.norm(looks.mean(0))), 1e-9)
    aside = looks - np.outer(looks @ middle, middle) + 1e-3 * streams.generator("split pole", 0).standard_normal(3)
    pole = np.linalg.svd(aside - aside.mean(0), full_matrices=False)[2][0]
    latitude = np.arcsin(np.clip(looks @ pole, -1.0, 1.0))
    gaps = [gap_rad if share > 0 else 0.0 for share in (splits.validation_fraction, splits.test_fraction)]
    for used in np.linspace(1.0, LEAST_USED, 51):
        low = float(np.quantile(latitude, splits.validation_fraction * used)) if gaps[0] else -math.inf
        high = float(np.quantile(latitude, 1.0 - splits.test_fraction * used)) if gaps[1] else math.inf
        inner = low + gaps[0], high - gaps[1]
        if np.mean((latitude >= inner[0]) & (latitude <= inner[1])) >= splits.train_fraction * used - 1e-9:
            break
    else:
        raise DomainError(
            f"splits.gap_deg = {gap_rad * RAD_DEG:g} deg: the boresights lie within "
            f"{np.ptp(latitude) * RAD_DEG:.3g} deg, such gaps leave less than half of the frames; take a smaller one, "
            "or splits.by = frame"
        )

    def of(_: int, boresight: FloatArray) -> str:
        here = math.asin(float(np.clip(boresight @ pole, -1.0, 1.0)))
        if here > high:
            return "test"
        if here < low:
            return "validation"
        return "train" if inner[0] <= here <= inner[1] else GAP

    return Splits(by="sky", gap_deg=gap_rad * RAD_DEG, of=of)


def _circle(config: Config) -> tuple[FloatArray, float, FloatArray] | None:
    """Pole and radius [rad] of the circle of a scan at a constant rate, and the boresight at its start."""
    pointing = config.pointing
    if not isinstance(pointing, ScanPointing) or pointing.file or not any(pointing.rate_deg_per_s):
        return None
    start = attitude_from_angles(pointing.ra_deg, pointing.dec_deg, pointing.roll_deg)
    rate = np.array(pointing.rate_deg_per_s)
    pole = start.inv().apply(rate / np.linalg.norm(rate))
    boresight = start.as_matrix()[2]
    return pole, math.acos(float(np.clip(pole @ boresight, -1.0, 1.0))), boresight


def _by_arc(splits: SplitsConfig, pole: FloatArray, radius: float, start: FloatArray, gap_rad: float) -> Splits:
    """Arcs of the circle, for one split after the other, each followed by a gap; the scan may go round many times.

    The sequence repeats as often as leaves half of the circle to frames that count: short scans have all splits.
    """
    chord = math.sin(0.5 * gap_rad) / math.sin(radius) if math.sin(radius) > 1e-9 else math.inf
    shares = dict(zip(SPLITS, (splits.train_fraction, splits.validation_fraction, splits.test_fraction), strict=True))
    parts = {name: share for name, share in shares.items() if share > 0}
    gap = 2.0 * math.asin(min(chord, 1.0)) if len(parts) > 1 else 0.0
    period = 2.0 * math.pi / max(1, int(math.pi / (len(parts) * gap))) if gap > 0 else 2.0 * math.pi
    used = period - len(parts) * gap
    if chord >= 1.0 or used <= 0:
        raise DomainError(
            f"splits.gap_deg = {gap_rad * RAD_DEG:g} deg: a circle of {radius * RAD_DEG:g} deg radius has no room "
            f"for {len(parts)} such gaps; use a smaller one, or splits.by = frame"
        )
    across = np.cross(pole, start)

    def of(_: int, boresight: FloatArray) -> str:
        turn = math.atan2(float(boresight @ across), float(boresight @ (start - (start @ pole) * pole)))
        place = turn % (2.0 * math.pi) % period
        for name, share in parts.items():
            if place < share * used:
                return name
            place -= share * used + gap
            if place < 0:
                return GAP
        return GAP

    return Splits(by="arc", gap_deg=gap_rad * RAD_DEG, of=of)


def _of_block(splits: SplitsConfig, streams: Streams, frame: int) -> str:
    """Every block of 100 frames is shared out as exactly as whole frames allow."""
    block, place = divmod(frame, BLOCK)
    position = (_order(streams, block)[place] + 0.5) / BLOCK
    if position < splits.train_fraction:
        return SPLITS[0]
    return SPLITS[1] if position < splits.train_fraction + splits.validation_fraction else SPLITS[2]


@lru_cache(maxsize=64)
def _order(streams: Streams, block: int) -> Any:
    return streams.generator("split", block).permutation(BLOCK)


@dataclass(frozen=True, slots=True, kw_only=True)
class Leak:
    """Overlap of the frames of a split with the training frames."""

    frames: int  # Frames of the split
    near: int  # Those within half a field's diagonal of a training frame
    shared: int  # Those within a whole one: they may show the same stars
    nearest_deg: float  # Smallest angle to a training frame; NaN without frames


def leakage(boresights: Mapping[str, Sequence[tuple[float, float]]], diagonal_deg: float) -> dict[str, Leak]:
    """Leakage of validation and test, from the boresights (ra, dec) [deg] of the frames of every split."""

    def directions(name: str) -> FloatArray:
        ra, dec = np.radians(np.array(boresights.get(name, ()), float).reshape(-1, 2).T)
        return np.stack([np.cos(dec) * np.cos(ra), np.cos(dec) * np.sin(ra), np.sin(dec)], axis=1)

    training, leaks = directions("train"), {}
    for name in SPLITS[1:]:
        mine = directions(name)
        if not len(mine):
            continue
        chord = cKDTree(training).query(mine)[0] if len(training) else np.full(len(mine), np.nan)
        angle = np.degrees(2.0 * np.arcsin(np.clip(0.5 * chord, 0.0, 1.0)))
        leaks[name] = Leak(
            frames=len(mine),
            near=int((angle < 0.5 * diagonal_deg).sum()),
            shared=int((angle < diagonal_deg).sum()),
            nearest_deg=float(angle.min()),
        )
    return leaks
