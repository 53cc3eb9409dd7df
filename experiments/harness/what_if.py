"""Predictions over one or two swept settings, and of several sensors in comparison.

For every experiment that declares ``predict`` and ``swept``; its ``limits`` (requirements) are judged at every point.
"""

from __future__ import annotations

import itertools
import math
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, make_dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from experiments.harness.experiment import Experiment
from experiments.harness.progress import Progress
from experiments.harness.quantities import Outcome, Quantities, Quantity, shown_unit
from experiments.harness.range import logarithmic, quantity_of, value_at, with_value
from experiments.harness.sections import Section, col, single_numbers
from optics.arrays import FloatArray
from optics.errors import DomainError, StarbenchError
from optics.settings import flat

if TYPE_CHECKING:
    from matplotlib.figure import Figure

IN_TABLE = 5
"""Number of swept quantities in the table of the terminal, two fewer where there are requirements; the ECSV file has
all of them."""
FINE = 120
"""Points along each side of a map that its lines are drawn with."""
MISSED, NOW = "#d55e00", "#8a9099"


@dataclass(frozen=True, slots=True, kw_only=True)
class Requirement:
    """A number against its requirement."""

    label: str = col("Requirement")
    key: str = col("Key")
    required: float = col("Required", format="g")
    predicted: float = col("Predicted", format=".4g")  # NaN where nothing could be predicted
    unit: str = col("Unit")
    margin: str = col("Margin")
    met: bool = col("Met")
    at_least: bool
    excess: float  # How much better than required: relative, for magnitudes the difference; negative where missed


def judge(limits: Mapping[str, tuple[float, bool]], numbers: Mapping[str, Quantity]) -> list[Requirement]:
    """Every limit, (value, whether at least), against the number of that name; limits without a number are left out."""
    rows = []
    for key, (required, at_least) in limits.items():
        if key not in numbers:
            continue
        one = numbers[key]
        value = float(one.values)
        excess = value - required if at_least else required - value
        if one.unit != "mag" and required:
            excess /= abs(required)
        rows.append(
            Requirement(
                label=one.label,
                key=key,
                required=float(required),
                predicted=value,
                unit=shown_unit(one.unit),
                margin=_margin(excess, one.unit),
                met=bool(value >= required if at_least else value <= required),
                at_least=at_least,
                excess=excess,
            )
        )
    return rows


def _margin(excess: float, unit: str) -> str:
    if not math.isfinite(excess):
        return "–"
    sign = "+" if excess >= 0 else "\N{MINUS SIGN}"
    return f"{sign}{abs(excess):.2f} mag" if unit == "mag" else f"{sign}{100.0 * abs(excess):.0f} %"


NEAR = 0.02
"""Accuracy of a crossing, as a fraction of its distance from the value that meets the requirements, or of itself."""


def crossing(met: Callable[[float], bool], held: float, lost: float) -> float:
    """Where between a value at which ``met`` and one at which not it ceases to be, by halving."""
    start = held
    while abs(lost - held) > NEAR * max(abs(lost - start), 1e-3 * abs(lost)):
        middle = 0.5 * (held + lost)
        held, lost = (middle, lost) if met(middle) else (held, middle)
    return 0.5 * (held + lost)


def missed_words(requirements: Sequence[Requirement]) -> str:
    """Summary of the verdicts on all requirements, in a sentence."""
    if not requirements:
        return "The sensor file states no [requirements]."
    missed = [one for one in requirements if not one.met]
    if not missed:
        return f"The sensor meets {f'all {len(requirements)} requirements' if requirements[1:] else 'its requirement'}."
    labels = (one.label if one.label[1:2].isupper() else f"{one.label[0].lower()}{one.label[1:]}" for one in missed)
    return f"The sensor misses {len(missed)} of {len(requirements)} requirements: {', '.join(labels)}."


def _requirement_axis(q: Quantities, requirements: Sequence[Requirement]) -> None:
    q.axis("requirement", np.array([one.key for one in requirements], dtype=object), "Requirement")


REQUIREMENTS = Section(
    record=Requirement,
    dim="requirement",
    axes=_requirement_axis,
    table="requirements",
    rows="requirement",
    hidden="requirement",
    caption="Requirements and predictions.",
)
"""Section of requirements; its record is what `judge` gives."""


@dataclass(frozen=True, slots=True, kw_only=True)
class _Key:
    """One swept key."""

    key: str
    label: str
    unit: str
    values: tuple[float, ...]
    now: float | None  # Value of the sensor as it is; None where its file leaves that open

    @property
    def field(self) -> str:
        """Field of the points that holds the value of the key."""
        return self.key.replace(".", "_")


@dataclass(frozen=True, slots=True, kw_only=True)
class _Point:
    """The prediction at one point; no numbers where the setting is refused."""

    at: tuple[float, ...]
    numbers: Mapping[str, Quantity]
    requirements: Sequence[Requirement] = ()
    refusal: str = ""

    @property
    def met(self) -> bool:
        return bool(self.numbers) and all(one.met for one in self.requirements)


@dataclass(frozen=True, slots=True, kw_only=True)
class Swept:
    """The sweep, and its answer."""

    answer: str = col("Answer")
    sensor: str = col("Sensor")
    words: str = col("Range")
    first: str = col("Key")
    second: str | None = col("Second key", default=None)
    left_out: str = col("Requirements without a prediction")
    keys: tuple[_Key, ...]
    points: tuple[_Point, ...]
    shown: tuple[str, ...]  # Quantities of the figures

    @property
    def required(self) -> dict[str, tuple[float, bool]]:
        """Requirement -> (value, whether at least)."""
        rows = next((one.requirements for one in self.points if one.numbers), ())
        return {one.key: (one.required, one.at_least) for one in rows}

    @property
    def met(self) -> Any:
        """Whether all requirements are met, at all points."""
        return np.array([one.met for one in self.points])


@dataclass(frozen=True, slots=True, kw_only=True)
class Crossing:
    """Where a requirement begins or ceases to be met, to `NEAR` of the step between two values of the swept key."""

    label: str = col("Requirement")
    requirement: str = col("Key")
    at: float = col("Crossed at", format=".4g")
    met: str = col("Met")


def run_sweep(declared: Experiment, config: Any, *, progress: Progress) -> dict[str, Any]:
    """Predict at every value of one key, or at all pairs of values of two."""
    plain = config.model_copy(update={"sweep": ()})
    ranges = config.sweep_ranges
    combinations = list(itertools.product(*(one.values for one in ranges)))
    points = []
    with progress.stage("predict", total=len(combinations)) as stage:
        for at in combinations:
            points.append(_point(declared, plain, [one.key for one in ranges], at))
            stage.advance()
    known = next((one for one in points if one.numbers), None)
    if known is None:
        raise DomainError(f"no value of the sweep can be predicted: {points[0].refusal}")
    keys = []
    for one in ranges:
        label, unit = quantity_of(one.key)
        now = value_at(plain, one.key)
        values = tuple(float(v) for v in one.values)
        keys.append(_Key(key=one.key, label=label, unit=unit, values=values, now=None if now is None else float(now)))
    required = [one.key for one in known.requirements]
    left_out = [key for key in _limits(declared, plain) if key not in required]
    swept = Swept(
        answer=_answer(declared, keys, points),
        sensor=_name(plain),
        words=" and ".join(f"{one.label} from {_with_unit(one, one.values[0])} to {_with_unit(one, one.values[-1])} in "
                           f"{len(one.values)} values" for one in keys),
        first=keys[0].key,
        second=keys[1].key if keys[1:] else None,
        left_out=", ".join(left_out),
        keys=tuple(keys),
        points=tuple(points),
        shown=tuple(dict.fromkeys((*(name for name in declared.swept if name in known.numbers), *required))),
    )  # fmt: skip
    if keys[1:]:
        return {"swept": swept, "points": _rows(declared, swept, known.numbers), "crossings": None}
    with progress.stage("crossings"):
        crossings = _crossings(swept, partial(_point, declared, plain, [ranges[0].key]))
    return {"swept": swept, "points": _rows(declared, swept, known.numbers), "crossings": crossings or None}


def _point(declared: Experiment, config: Any, keys: Sequence[str], at: tuple[float, ...]) -> _Point:
    try:
        for key, value in zip(keys, at, strict=True):
            config = with_value(config, key, value)
        outcome = _predicted(declared, config)
    except (StarbenchError, ValueError) as error:
        return _Point(at=at, numbers={}, refusal=str(error).splitlines()[0])
    numbers = single_numbers(outcome.data)
    return _Point(at=at, numbers=numbers, requirements=judge(_limits(declared, config), numbers))


def _predicted(declared: Experiment, config: Any) -> Outcome:
    if declared.predict is None:
        raise DomainError(f"{declared.name} has no prediction without frames")
    return declared.outcome(config, declared.part(declared.predict)(config, progress=Progress()))


def _limits(declared: Experiment, config: Any) -> Mapping[str, tuple[float, bool]]:
    limits: Mapping[str, tuple[float, bool]] = {} if declared.limits is None else declared.part(declared.limits)(config)
    return limits


def _name(config: Any) -> str:
    setting = getattr(config, "instrument", None)
    named: str = getattr(config, "name", "")
    return named or ("the sensor" if setting is None else f"{setting.lens_label} on {Path(setting.detector).stem}")


def _with_unit(key: _Key, value: float) -> str:
    return f"{value:g} {shown_unit(key.unit)}".rstrip()


def _answer(declared: Experiment, keys: Sequence[_Key], points: Sequence[_Point]) -> str:
    """Number of points that meet the requirements, and the best of them."""
    chief = declared.swept[0]
    known = [one for one in points if one.numbers and np.isfinite(one.numbers[chief].values)]
    required = next(one.requirements for one in points if one.numbers)
    met = [one for one in known if one.met]
    words = "The sensor file states no [requirements]."
    if required:
        count = f"{len(met)} of {len(points)} points meet" if met else "No point meets"
        words = f"{count} {f'all {len(required)} requirements' if required[1:] else 'the requirement'}."
    if not known:
        return words
    at_most = dict.fromkeys((one.key for one in required if one.at_least), -1.0).get(chief, 1.0)
    best = min(met or known, key=lambda one: at_most * float(one.numbers[chief].values))
    one = best.numbers[chief]
    at = ", ".join(f"{key.label} {_with_unit(key, value)}" for key, value in zip(keys, best.at, strict=True))
    among = " among these" if required and met else ""
    label = f"{one.label[0].lower()}{one.label[1:]}"
    return f"{words} Best {label}{among}: {float(one.values):{one.format or '.4g'}}{shown_unit(one.unit)} at {at}."


def _rows(declared: Experiment, swept: Swept, numbers: Mapping[str, Quantity]) -> list[Any]:
    """Points as records whose fields are the swept keys and every number of the prediction."""
    swept_fields = [key.field for key in swept.keys]
    numbers = {name: number for name, number in numbers.items() if name not in swept_fields}
    in_table = [name for name in declared.swept if name in numbers][: IN_TABLE - 2 * bool(swept.required)]
    fields: list[Any] = [
        (key.field, float, col(f"{key.label[0].upper()}{key.label[1:]}", key.unit, ".5g")) for key in swept.keys
    ]
    for name in dict.fromkeys((*in_table, *numbers)):
        number = numbers[name]
        fields.append((name, float, col(number.label, number.unit, number.format, shown=name in in_table)))
    fields.append(("meets", bool, col("Meets", shown=False)))
    fields.append(("misses", str, col("Misses", shown=bool(swept.required))))
    fields.append(("refusal", str, col("Refused", shown=False)))
    record = make_dataclass("SweepPoint", fields, frozen=True, kw_only=True)
    nothing = dict.fromkeys(numbers, math.nan)
    rows = []
    for point in swept.points:
        values = nothing | {name: float(one.values) for name, one in point.numbers.items() if name in numbers}
        missed = ", ".join(one.key for one in point.requirements if not one.met)
        at = dict(zip(swept_fields, point.at, strict=True))
        rows.append(record(**at, **values, meets=point.met, misses=missed, refusal=point.refusal))
    return rows


def _crossings(swept: Swept, predict: Callable[[tuple[float]], _Point]) -> list[Crossing]:
    """Crossings of one swept key between its values, each found by further predictions."""
    at, rows = swept.keys[0].values, []
    whole = all(isinstance(value, int) for value in at)
    for name in swept.required:
        labels = [next((one for one in point.requirements if one.key == name), None) for point in swept.points]
        label = next(one.label for one in labels if one is not None)

        def met(value: float, name: str = name) -> bool:
            return next((one.met for one in predict((value,)).requirements if one.key == name), False)

        for (x, one), (y, other) in itertools.pairwise(zip(at, labels, strict=True)):
            if one is None or other is None or one.met == other.met:
                continue
            held, lost = (x, y) if one.met else (y, x)
            where = 0.5 * (x + y) if whole else crossing(met, held, lost)
            rows.append(
                Crossing(label=label, requirement=name, at=float(where), met="above" if held > lost else "below")
            )
    return rows


def _draw_sweep(outcome: Outcome) -> Figure:
    from experiments.harness.plotting import new_figure, spaced_axis

    swept: Swept = outcome.result["swept"]
    rows = -(-len(swept.shown) // 2)
    two = len(swept.keys) == 2
    figure, axes = new_figure(rows, 2, aspect_ratio=(0.33 if two else 0.22) * rows + 0.05, squeeze=False)
    panels = list(axes.ravel())
    for panel in panels[len(swept.shown) :]:
        panel.set_visible(False)
    for panel, name in zip(panels, swept.shown, strict=False):
        (_map if two else _curve)(figure, panel, outcome, swept, name)
        panel.set_title(outcome.quantity(name).heading)
        for which, key in zip("xy", swept.keys, strict=False):
            panel.set(**{f"{which}label": outcome.heading(key.field)})
            spaced_axis(panel, which, key.values)  # type: ignore[arg-type]
    return figure


def _curve(figure: Figure, panel: Any, outcome: Outcome, swept: Swept, name: str) -> None:
    from experiments.harness.plotting import PALETTE

    key, values = swept.keys[0], outcome.values(name)
    panel.plot(key.values, values, color=PALETTE[0], marker="o", markersize=3)
    if name in swept.required:
        _required(panel, *swept.required[name], values)
    for one in outcome.result["crossings"] or ():
        if one.requirement == name:
            panel.axvline(one.at, color=MISSED, linewidth=0.9)
    if key.now is not None and min(key.values) <= key.now <= max(key.values):
        panel.axvline(key.now, color=NOW, linewidth=1.0, dashes=(1, 2))
    if np.isfinite(values).any() and np.nanmin(values) > 0 and name.endswith(("_arcsec", "_px")):
        panel.set_ylim(0, None)


def _map(figure: Figure, panel: Any, outcome: Outcome, swept: Swept, name: str) -> None:
    from experiments.harness.plotting import INK

    first, second = (np.array(one.values) for one in swept.keys)
    values = outcome.values(name).reshape(len(first), len(second)).T
    drawn = panel.pcolormesh(first, second, np.ma.masked_invalid(values), shading="nearest", cmap="cividis")
    figure.colorbar(drawn, ax=panel, pad=0.02)
    required = swept.required.get(name, (math.nan, True))[0]
    if np.nanmin(values) < required < np.nanmax(values) and min(values.shape) > 1:
        panel.contour(*_finer(first, second, values), levels=[required], colors=MISSED, linewidths=1.4)
    missed = np.array([one.at for one in swept.points])[~swept.met] if swept.required else np.empty((0, 2))
    for colour, thickness in ((INK, 2.2), ("white", 0.9)):  # visible on every ground
        panel.plot(*missed.T, "x", color=colour, markersize=3.5, markeredgewidth=thickness)
    panel.grid(visible=False)


def _finer(first: FloatArray, second: FloatArray, values: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """A map (second, first) on a fine grid, by cubic splines of logarithms; unchanged where some points are refused."""
    from scipy.interpolate import RectBivariateSpline

    if not (np.isfinite(values).all() and (values > 0.0).all()):
        return first, second, values
    spread = [logarithmic(one.tolist()) for one in (first, second)]
    axes = [np.log(one) if log else one for one, log in zip((first, second), spread, strict=True)]
    fine = [np.linspace(one[0], one[-1], FINE) for one in axes]
    x, y = (np.exp(one) if log else one for one, log in zip(fine, spread, strict=True))
    degree = {"kx": min(3, len(second) - 1), "ky": min(3, len(first) - 1)}
    return x, y, np.exp(RectBivariateSpline(axes[1], axes[0], np.log(values), **degree)(fine[1], fine[0]))


def _required(panel: Any, required: float, at_least: bool, values: FloatArray) -> None:
    """The limit as a line, the side that misses it shaded."""
    panel.axhline(required, color=MISSED, linewidth=0.9, dashes=(4, 3))
    low, high = panel.get_ylim()
    span = max(high - low, 1e-12) if np.isfinite(values).any() else 1.0
    low, high = min(low, required - 0.06 * span), max(high, required + 0.06 * span)
    edge = low - span if at_least else high + span
    panel.axhspan(*sorted((required, edge)), color=MISSED, alpha=0.07, linewidth=0, zorder=0)
    panel.set_ylim(low, high)


def sweep_sections(result: Mapping[str, Any]) -> dict[str, Section]:
    """Sections of a sweep; the columns of its points are the numbers of the prediction."""
    return {
        "swept": Section(record=Swept),
        "points": Section(
            record=type(result["points"][0]),
            dim="point",
            table="sweep",
            rows="point",
            hidden="point",
            caption="Predictions at all points.",
            figures={"sweep": _draw_sweep},
        ),
        "crossings": Section(
            record=Crossing,
            dim="crossing",
            rows="crossing",
            hidden="crossing",
            caption="Values at which a requirement changes between met and missed.",
        ),
    }


@dataclass(frozen=True, slots=True, kw_only=True)
class Difference:
    """A key of the configuration in which the sensors differ."""

    key: str = col("Key")
    value: Sequence[str] = col("Value", dims="sensor")


@dataclass(frozen=True, slots=True, kw_only=True)
class Compared:
    """Performance of each sensor against a requirement of its own file."""

    label: str = col("Requirement")
    verdict: Sequence[str] = col("Verdict", dims="sensor")


@dataclass(frozen=True, slots=True, kw_only=True)
class _Curves:
    """Quantities of all sensors that are drawn on each other."""

    outcomes: tuple[Outcome, ...]
    names: tuple[str, ...]
    sensors: tuple[str, ...]


def run_comparison(declared: Experiment, configs: Sequence[Any], *, progress: Progress) -> dict[str, Any]:
    """Predict all sensors."""
    outcomes, counts = [], Counter[str]()
    names: list[str] = []
    with progress.stage("sensors", total=len(configs)) as stage:
        for number, config in enumerate(configs, start=1):
            try:
                outcomes.append(_predicted(declared, config))
            except StarbenchError as error:
                raise DomainError(f"sensor {number} ({_name(config)}): {error}") from None
            name = _name(config)
            counts[name] += 1
            names.append(name if counts[name] == 1 else f"{name} ({counts[name]})")
            stage.advance()
    numbers = [single_numbers(one.data) for one in outcomes]
    requirements = [judge(_limits(declared, c), n) for c, n in zip(configs, numbers, strict=True)]
    common = {name: one for name, one in numbers[0].items() if all(name in other for other in numbers)}
    shown = [name for name in declared.swept if name in common]
    fields: list[Any] = [("sensor", str, col("Sensor"))]
    common.pop("requirements_missed", None)
    for name in dict.fromkeys((*shown, *common)):
        one = common[name]
        fields.append((name, float, col(one.label, one.unit, one.format, shown=name in shown)))
    fields.append(("requirements", int, col("Requirements", shown=False)))
    fields.append(("requirements_missed", int, col("Requirements missed", shown=False)))
    record = make_dataclass("Sensor", fields, frozen=True, kw_only=True)
    rows = [
        record(
            sensor=name,
            requirements=len(asked),
            requirements_missed=sum(not one.met for one in asked),
            **{key: float(own[key].values) for key in common},
        )
        for name, own, asked in zip(names, numbers, requirements, strict=True)
    ]
    return {
        "sensors": rows,
        "requirements": list(_compared(requirements)) or None,
        "differences": _differences(configs) or None,
        "curves": _Curves(outcomes=tuple(outcomes), names=tuple(declared.compared), sensors=tuple(names)),
    }


def _compared(requirements: Sequence[Sequence[Requirement]]) -> Iterator[Compared]:
    labels = {one.key: one.label for own in requirements for one in own}
    for key, label in labels.items():
        rows = [next((one for one in own if one.key == key), None) for own in requirements]
        words = ["not required" if r is None else f"{'met' if r.met else 'MISSED'}, {r.margin}" for r in rows]
        yield Compared(label=label, verdict=words)


def _differences(configs: Sequence[Any]) -> list[Difference]:
    settings = [flat(one.model_dump()) for one in configs]
    keys = dict.fromkeys(key for one in settings for key in one if key != "name")
    rows = [Difference(key=key, value=[_plain(one.get(key)) for one in settings]) for key in keys]
    return [one for one in rows if len(set(one.value)) > 1]


def _plain(value: Any) -> str:
    if value is None:
        return "–"
    if isinstance(value, (tuple, list)):
        return ", ".join(_plain(one) for one in value)
    return f"{value:g}" if isinstance(value, float) else str(value)


def _draw_curves(outcome: Outcome) -> Figure:
    from experiments.harness.plotting import PALETTE, log_ticks, new_figure

    drawn: _Curves = outcome.result["curves"]
    names = [name for name in drawn.names if all(name in one for one in drawn.outcomes)]
    figure, axes = new_figure(1, len(names), aspect_ratio=0.42, squeeze=False)
    for panel, name in zip(axes[0], names, strict=True):
        for one, sensor, colour in zip(drawn.outcomes, drawn.sensors, PALETTE, strict=False):
            (dim,) = one.quantity(name).dims
            panel.plot(one.data[dim].values, one.values(name), color=colour, label=sensor)
        panel.set(xlabel=drawn.outcomes[0].heading(dim), ylabel=drawn.outcomes[0].heading(name))
        if name.endswith("_arcsec"):
            panel.set_yscale("log")
            log_ticks(panel, "y")
    axes[0][-1].legend()
    return figure


def comparison_sections(result: Mapping[str, Any]) -> dict[str, Section]:
    """Sections of a comparison; its rows are the numbers that all sensors have."""
    key = Section(
        record=Difference,
        dim="key",
        along="key",
        table="differences",
        across="sensor",
        columns="value",
        caption="Differences of the configurations.",
    )
    return {
        "sensors": Section(
            record=type(result["sensors"][0]),
            dim="sensor",
            along="sensor",
            vertical=True,
            caption="Predictions for all sensors.",
        ),
        "requirements": Section(
            record=Compared,
            dim="requirement",
            rows="requirement",
            hidden="requirement",
            across="sensor",
            caption="Each sensor against the requirements of its own file, with its margin.",
        ),
        "differences": key,
        "curves": Section(record=_Curves, figures={"curves": _draw_curves}),
    }
