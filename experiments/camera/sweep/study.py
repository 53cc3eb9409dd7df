"""The sensor predicted at every value of one key, or of two."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from experiments.camera.confirmation import Comparison, compare
from experiments.camera.criteria import frame_criteria
from experiments.camera.prediction import predict_camera
from experiments.camera.records import Scalar
from experiments.camera.settings import Config
from experiments.camera.verdicts import Verdict, judge
from experiments.harness.quantities import shown_unit
from experiments.harness.range import logarithmic, quantity_of, with_value
from experiments.harness.summary import Criterion
from optics.arrays import FloatArray
from optics.errors import DomainError, StarbenchError

__all__ = ["MAIN", "Axis", "Crossing", "SweepPoint", "SweepStudy", "sweep_study"]


MAIN = (
    "limiting_magnitude_mag",
    "nea_arcsec",
    "single_star_arcsec",
    "attitude_cross_arcsec",
    "attitude_roll_arcsec",
    "stars_mean_per_frame",
    "stars_worst_per_frame",
    "spot_px",
)
"""What figures show besides what is required."""
MEASURED = {
    "electrons_e": "electrons",
    "limiting_magnitude_mag": "limiting_magnitude",
    "nea_arcsec": "nea",
    "attitude_cross_arcsec": "attitude_cross",
    "attitude_roll_arcsec": "attitude_roll",
    "stars_mean_per_frame": "stars",
}
"""Scalar -> the comparison with rendered frames that confirms it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Axis:
    """One swept key."""

    key: str  # Dotted key, what it is, its unit
    label: str  # Dotted key, what it is, its unit
    unit: str  # Dotted key, what it is, its unit
    values: tuple[float, ...]  # In order


@dataclass(frozen=True, slots=True, kw_only=True)
class SweepPoint:
    """The sensor at one point of the sweep."""

    at: tuple[float, ...]  # Values of the swept keys
    scalars: Mapping[str, Scalar]  # Of the prediction; empty where the setting is refused
    verdicts: tuple[Verdict, ...] = ()  # On the requirements that a prediction at one temperature knows of
    compared: tuple[Comparison, ...] = ()  # Frames beside the prediction; empty without frames
    criteria: tuple[Criterion, ...] = ()  # On these frames
    catalogue_ends: bool = False  # Whether the sensor finds stars that the catalogue does not hold
    refusal: str = ""  # Why there is no prediction, or no frames; "" where there is what was asked for

    @property
    def met(self) -> bool:
        """Whether every requirement is met."""
        return bool(self.scalars) and all(one.met for one in self.verdicts)

    def measured(self, name: str) -> tuple[float, float]:
        """A scalar as the frames have it, and its standard deviation; NaN where they say nothing of it.

        Frames show it for some stars and attitudes; by as much as they are off there, the scalar is taken to be off.
        """
        found = {one.name: one for one in self.compared}.get(MEASURED.get(name, ""))
        if found is None:
            return float("nan"), float("nan")
        value = self.scalars[name].value
        if self.scalars[name].unit == "mag":
            return value + found.measured - found.predicted, found.error
        return value * found.measured / found.predicted, value * found.error / found.predicted


@dataclass(frozen=True, slots=True, kw_only=True)
class Crossing:
    """Where a requirement begins or ceases to be met, between two values of a swept key."""

    name: str  # Of the requirement
    at: float  # Value of the key, by interpolation of the margin
    above: bool  # Whether it is met above that value; below it otherwise


@dataclass(frozen=True, slots=True, kw_only=True)
class SweepStudy:
    """A sweep of one or two keys."""

    config: Config  # The sensor without the sweep
    axes: tuple[Axis, ...]  # One or two
    points: tuple[SweepPoint, ...]  # All combinations, the last axis fastest

    @property
    def shape(self) -> tuple[int, ...]:
        """Values along the axes."""
        return tuple(len(axis.values) for axis in self.axes)

    @property
    def described(self) -> Mapping[str, Scalar]:
        """The scalars of the first point that has any, for their labels and units."""
        return next(point.scalars for point in self.points if point.scalars)

    def series(self, name: str) -> FloatArray:
        """A scalar at all points; NaN where refused."""
        return np.array([point.scalars[name].value if point.scalars else np.nan for point in self.points])

    def grid(self, name: str) -> FloatArray:
        """The same with one dimension per axis."""
        return self.series(name).reshape(self.shape)

    @property
    def met(self) -> NDArray[np.bool_]:
        """Whether all requirements are met, at all points."""
        return np.array([point.met for point in self.points])

    @property
    def required(self) -> Mapping[str, float]:
        """Requirement -> what is asked, in the order of the table."""
        given = next(point.verdicts for point in self.points if point.scalars)
        return {one.key: one.required for one in given}

    @property
    def left_out(self) -> tuple[str, ...]:
        """Requirements that need the study over temperature."""
        asked = self.config.requirements.model_dump()
        return tuple(key for key, value in asked.items() if value is not None and key not in self.required)

    @property
    def saturated(self) -> int:
        """At how many points the star that accuracies are quoted for saturates, and has none."""
        names = [axis.key for axis in self.axes]
        swept = names.index(STAR) if STAR in names else None
        return sum(
            bool(point.scalars)
            and point.scalars["saturation_mag"].value
            > (self.config.star.magnitude_mag if swept is None else point.at[swept])
            for point in self.points
        )

    @property
    def shown(self) -> tuple[str, ...]:
        """The main quantities, and what is required besides."""
        return tuple(dict.fromkeys((*MAIN, *self.required)))

    @property
    def best(self) -> SweepPoint | None:
        """The point of the best attitude across among those that meet all requirements (all points where none does)."""
        known = [p for p in self.points if p.scalars and np.isfinite(p.scalars[BEST_OF].value)]
        among = [p for p in known if p.met] or known
        return min(among, key=lambda p: p.scalars[BEST_OF].value, default=None)

    @property
    def crossings(self) -> tuple[Crossing, ...]:
        """Of one swept key."""
        if len(self.axes) > 1:
            return ()
        at = self.axes[0].values
        found = []
        for name in self.required:
            margin = [next((v.margin for v in point.verdicts if v.key == name), float("nan")) for point in self.points]
            for (x, a), (y, b) in itertools.pairwise(zip(at, margin, strict=True)):
                if np.isfinite([a, b]).all() and (a >= 0.0) != (b >= 0.0):
                    part = a / (a - b)
                    where = x * (y / x) ** part if logarithmic(at) else x + (y - x) * part
                    found.append(Crossing(name=name, at=float(where), above=bool((b >= 0.0) == (y > x))))
        return tuple(found)

    @property
    def name(self) -> str:
        """What to call the sensor."""
        setting = self.config.instrument
        return self.config.name or f"{Path(setting.lens).stem} on {Path(setting.detector).stem}"

    @property
    def asked(self) -> str:
        """What was varied, in words."""
        words = [
            f"{axis.label} from {axis.values[0]:g} to {axis.values[-1]:g} {shown_unit(axis.unit)}".rstrip()
            + f" in {len(axis.values)} values"
            for axis in self.axes
        ]
        return " and ".join(words)

    @property
    def answer(self) -> str:
        """Where requirements are met, and the best point."""
        count = int(self.met.sum())
        if not self.required:
            words = "Nothing was asked of the sensor: its file has no table [requirements]."
        elif not count:
            words = f"No point meets all {len(self.required)} requirements."
        else:
            words = f"{count} of {len(self.points)} points meet all requirements."
        best = self.best
        if best is None:
            return words
        at = ", ".join(
            f"{axis.label} {value:g} {shown_unit(axis.unit)}".rstrip()
            for axis, value in zip(self.axes, best.at, strict=True)
        )
        one = best.scalars[BEST_OF]
        among = " among them" if self.required and count else ""
        return f"{words} Best attitude across{among}: {one.value:{one.format}}{shown_unit(one.unit)} at {at}."


BEST_OF = "attitude_cross_arcsec"
STAR = "star.magnitude_mag"


def sweep_study(config: Config, *, advance: Callable[[], None] = lambda: None) -> SweepStudy:
    """Predict a sensor over the range of one key, or over that of two."""
    plain = config.model_copy(update={"sweep": (), "sweep_measured": False})
    ranges = config.sweep_ranges
    frames = len(ranges[0].values) if config.sweep_measured else 0
    points = []
    for at in itertools.product(*(one.values for one in ranges)):
        points.append(_point(plain, tuple(one.key for one in ranges), at, frames))
        advance()
    if not any(point.scalars for point in points):
        raise DomainError(f"no value of the sweep can be predicted: {points[0].refusal}")
    axes = []
    for one in ranges:
        label, unit = quantity_of(one.key)
        axes.append(Axis(key=one.key, label=label, unit=unit, values=tuple(float(v) for v in one.values)))
    return SweepStudy(config=plain, axes=tuple(axes), points=tuple(points))


def _point(config: Config, keys: tuple[str, ...], at: tuple[float, ...], frames: int) -> SweepPoint:
    """One point; ``frames`` is the number of points that are confirmed by frames, 0 for none."""
    try:
        changed = config
        for key, value in zip(keys, at, strict=True):
            changed = with_value(changed, key, value)
        prediction = predict_camera(changed)
    except (StarbenchError, ValueError) as error:
        return SweepPoint(at=at, scalars={}, refusal=_first_line(error))
    asked = changed.requirements
    unknown = {key: None for key in asked.model_dump() if key not in prediction.scalars}
    point = SweepPoint(
        at=at,
        scalars=prediction.scalars,
        verdicts=judge(asked.model_copy(update=unknown), prediction.scalars),
        catalogue_ends=prediction.catalogue_ends,
    )
    if not frames:
        return point
    from experiments.camera.rendered import render_frames

    try:
        rendered = render_frames(prediction)
    except StarbenchError as error:
        return replace(point, refusal=_first_line(error))
    return replace(
        point,
        compared=compare(prediction, rendered),
        criteria=tuple(frame_criteria(prediction, rendered, looks=frames)),
    )


def _first_line(error: Exception) -> str:
    return str(error).splitlines()[0]
