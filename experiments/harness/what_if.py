"""Predictions over one or two swept settings, and of several sensors in comparison.

For every experiment that declares ``predict`` and ``swept``; its ``limits`` (requirements) are judged at every point.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
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
"""Number of predicted quantities in the table of the terminal, two fewer with requirements; the ECSV file has all."""
FINE = 120
"""Points along each side of the grid on which contour lines of a map are drawn."""
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
    """Every limit, (value, whether at least), against the number of that name; limits without a number are omitted."""
    requirements = []
    for key, (required, at_least) in limits.items():
        if key not in numbers:
            continue
        number = numbers[key]
        value = float(number.values)
        excess = value - required if at_least else required - value
        if number.unit != "mag" and required:
            excess /= abs(required)
        requirements.append(
            Requirement(
                label=number.label,
                key=key,
                required=float(required),
                predicted=value,
                unit=shown_unit(number.unit),
                margin=_margin(excess, number.unit),
                met=bool(value >= required if at_least else value <= required),
                at_least=at_least,
                excess=excess,
            )
        )
    return requirements


def _margin(excess: float, unit: str) -> str:
    if not math.isfinite(excess):
        return "–"
    sign = "+" if excess >= 0 else "\N{MINUS SIGN}"
    return f"{sign}{abs(excess):.2f} mag" if unit == "mag" else f"{sign}{100.0 * abs(excess):.0f} %"


NEAR = 0.02
"""Accuracy of a crossing, as a fraction of its distance from the value that meets the requirements, or of itself."""


def crossing(met: Callable[[float], bool], inside: float, outside: float) -> float:
    """Value at which ``met`` changes between one that meets (inside) and one that does not (outside), by bisection."""
    start = inside
    while abs(outside - inside) > NEAR * max(abs(outside - start), 1e-3 * abs(outside)):
        middle = 0.5 * (inside + outside)
        inside, outside = (middle, outside) if met(middle) else (inside, middle)
    return 0.5 * (inside + outside)


def missed_words(requirements: Sequence[Requirement]) -> str:
    """Summary of the verdicts on all requirements, in a sentence."""
    if not requirements:
        return "The sensor file states no [requirements]."
    missed = [requirement.label for requirement in requirements if not requirement.met]
    if not missed:
        return f"The sensor meets {f'all {len(requirements)} requirements' if requirements[1:] else 'its requirement'}."
    labels = (label if label[1:2].isupper() else _lower(label) for label in missed)
    return f"The sensor misses {len(missed)} of {len(requirements)} requirements: {', '.join(labels)}."


def _lower(label: str) -> str:
    """A label amid a sentence."""
    return f"{label[:1].lower()}{label[1:]}"


def _requirement_axis(q: Quantities, requirements: Sequence[Requirement]) -> None:
    q.axis("requirement", np.array([requirement.key for requirement in requirements], dtype=object), "Requirement")


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
class SweptKey:
    """A swept key and its values."""

    key: str
    label: str
    unit: str
    values: tuple[float, ...]
    now: float | None  # Value of the sensor as it is; None where its file states none

    @property
    def field(self) -> str:
        """Field of the points that holds the value of the key."""
        return self.key.replace(".", "_")


@dataclass(frozen=True, slots=True, kw_only=True)
class SweptPoint:
    """The prediction at a point of a sweep; no numbers where the setting is refused."""

    at: tuple[float, ...]
    numbers: Mapping[str, Quantity]
    requirements: Sequence[Requirement] = ()
    refusal: str = ""

    @property
    def met(self) -> bool:
        return bool(self.numbers) and all(requirement.met for requirement in self.requirements)


@dataclass(frozen=True, slots=True, kw_only=True)
class Swept:
    """The sweep, and its answer."""

    answer: str = col("Answer")
    sensor: str = col("Sensor")
    words: str = col("Range")
    first: str = col("Key")
    second: str | None = col("Second key", default=None)
    left_out: str = col("Requirements without a prediction")
    keys: tuple[SweptKey, ...]
    points: tuple[SweptPoint, ...]
    shown: tuple[str, ...]  # Quantities of the figures

    @property
    def required(self) -> dict[str, tuple[float, bool]]:
        """Requirement -> (value, whether at least)."""
        rows = next((point.requirements for point in self.points if point.numbers), ())
        return {row.key: (row.required, row.at_least) for row in rows}


@dataclass(frozen=True, slots=True, kw_only=True)
class Crossing:
    """Where a requirement begins or ceases to be met, to `NEAR` of the step between two values of the swept key."""

    label: str = col("Requirement")
    requirement: str = col("Key")
    at: float = col("Crossed at", format=".4g")
    met: str = col("Met")


def run_sweep(declared: Experiment, config: Any, *, progress: Progress) -> dict[str, Any]:
    """Predict at every value of a key, or at all pairs of values of two."""
    sensor = config.model_copy(update={"sweep": ()})
    ranges = config.sweep_ranges
    predict = partial(_point, declared, sensor, [axis.key for axis in ranges])
    combinations = list(itertools.product(*(axis.values for axis in ranges)))
    points = [predict(values) for values in progress.track(combinations, "predict")]
    example = next((point for point in points if point.numbers), None)
    if example is None:
        raise DomainError(f"no value of the sweep can be predicted: {points[0].refusal}")
    keys = []
    for axis in ranges:
        label, unit = quantity_of(axis.key)
        now = value_at(sensor, axis.key)
        values = tuple(map(float, axis.values))
        keys.append(
            SweptKey(key=axis.key, label=label, unit=unit, values=values, now=None if now is None else float(now))
        )
    required = [requirement.key for requirement in example.requirements]
    swept = Swept(
        answer=_answer(declared, keys, points),
        sensor=_name(sensor),
        words=" and ".join(f"{key.label} from {_with_unit(key, key.values[0])} to {_with_unit(key, key.values[-1])} in "
                           f"{len(key.values)} values" for key in keys),
        first=keys[0].key,
        second=keys[1].key if keys[1:] else None,
        left_out=", ".join(key for key in _limits(declared, sensor) if key not in required),
        keys=tuple(keys),
        points=tuple(points),
        shown=tuple(dict.fromkeys((*(name for name in declared.swept if name in example.numbers), *required))),
    )  # fmt: skip
    crossings: list[Crossing] = []
    if len(keys) == 1:
        with progress.stage("crossings"):
            crossings = _crossings(swept, predict)
    return {"swept": swept, "points": _rows(declared, swept, example.numbers), "crossings": crossings or None}


def _point(declared: Experiment, config: Any, keys: Sequence[str], at: tuple[float, ...]) -> SweptPoint:
    try:
        for key, value in zip(keys, at, strict=True):
            config = with_value(config, key, value)
        outcome = _predicted(declared, config)
    except (StarbenchError, ValueError) as error:
        return SweptPoint(at=at, numbers={}, refusal=str(error).splitlines()[0])
    numbers = single_numbers(outcome.data)
    return SweptPoint(at=at, numbers=numbers, requirements=judge(_limits(declared, config), numbers))


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


def _with_unit(key: SweptKey, value: float) -> str:
    return f"{value:g} {shown_unit(key.unit)}".rstrip()


def _answer(declared: Experiment, keys: Sequence[SweptKey], points: Sequence[SweptPoint]) -> str:
    """Number of points that meet the requirements, and the best of them."""
    chief = declared.swept[0]
    predicted = [point for point in points if point.numbers and np.isfinite(point.numbers[chief].values)]
    required = next(point.requirements for point in points if point.numbers)
    met = [point for point in predicted if point.met]
    words = "The sensor file states no [requirements]."
    if required:
        count = f"{len(met)} of {len(points)} points meet" if met else "No point meets"
        words = f"{count} {f'all {len(required)} requirements' if required[1:] else 'the requirement'}."
    if not predicted:
        return words
    sign = -1.0 if any(requirement.key == chief and requirement.at_least for requirement in required) else 1.0
    best = min(met or predicted, key=lambda point: sign * float(point.numbers[chief].values))
    number = best.numbers[chief]
    at = ", ".join(f"{key.label} {_with_unit(key, value)}" for key, value in zip(keys, best.at, strict=True))
    among = " among these" if required and met else ""
    value = f"{float(number.values):{number.format or '.4g'}}{shown_unit(number.unit)}"
    return f"{words} Best {_lower(number.label)}{among}: {value} at {at}."


def _rows(declared: Experiment, swept: Swept, numbers: Mapping[str, Quantity]) -> list[Any]:
    """Points as records whose fields are the swept keys and every number of the prediction."""
    swept_fields = [key.field for key in swept.keys]
    numbers = {name: number for name, number in numbers.items() if name not in swept_fields}
    in_table = [name for name in declared.swept if name in numbers][: IN_TABLE - 2 * bool(swept.required)]
    fields: list[Any] = [
        (key.field, float, col(f"{key.label[0].upper()}{key.label[1:]}", key.unit, ".5g")) for key in swept.keys
    ]
    fields += _columns(numbers, in_table)
    fields.append(("meets", bool, col("Meets", shown=False)))
    fields.append(("misses", str, col("Misses", shown=bool(swept.required))))
    fields.append(("refusal", str, col("Refused", shown=False)))
    record = make_dataclass("SweepPoint", fields, frozen=True, kw_only=True)
    rows = []
    for point in swept.points:
        values = {name: float(point.numbers[name].values) if name in point.numbers else math.nan for name in numbers}
        missed = ", ".join(requirement.key for requirement in point.requirements if not requirement.met)
        at = dict(zip(swept_fields, point.at, strict=True))
        rows.append(record(**at, **values, meets=point.met, misses=missed, refusal=point.refusal))
    return rows


def _columns(numbers: Mapping[str, Quantity], shown: Sequence[str]) -> list[Any]:
    """Fields of a record that holds predicted numbers; the shown ones come first."""
    ordered = {name: numbers[name] for name in dict.fromkeys((*shown, *numbers))}
    return [(name, float, col(n.label, n.unit, n.format, shown=name in shown)) for name, n in ordered.items()]


def _crossings(swept: Swept, predict: Callable[[tuple[float]], SweptPoint]) -> list[Crossing]:
    """Values of the only swept key at which a requirement changes, by further predictions between two points."""
    crossings = []
    for name in swept.required:

        def requirement(point: SweptPoint, name: str = name) -> Requirement | None:
            return next((row for row in point.requirements if row.key == name), None)

        def met(value: float) -> bool:
            row = requirement(predict((value,)))  # called within this turn of the loop
            return row is not None and row.met

        for lower, upper in itertools.pairwise(swept.points):
            first, second = requirement(lower), requirement(upper)
            if first is None or second is None or first.met == second.met:
                continue
            inside, outside = (*lower.at, *upper.at) if first.met else (*upper.at, *lower.at)
            whole = isinstance(inside, int)  # between two whole numbers nothing can be predicted
            at = 0.5 * (inside + outside) if whole else crossing(met, inside, outside)
            side = "above" if inside > outside else "below"
            crossings.append(Crossing(label=first.label, requirement=name, at=float(at), met=side))
    return crossings


def _draw_sweep(outcome: Outcome) -> Figure:
    from experiments.harness.plotting import new_figure, spaced_axis

    swept: Swept = outcome.result["swept"]
    rows = -(-len(swept.shown) // 2)
    is_map = len(swept.keys) == 2
    figure, axes = new_figure(rows, 2, aspect_ratio=(0.33 if is_map else 0.22) * rows + 0.05, squeeze=False)
    for panel, name in itertools.zip_longest(axes.ravel(), swept.shown):
        if name is None:
            panel.set_visible(False)
            continue
        (_map if is_map else _curve)(figure, panel, outcome, swept, name)
        panel.set_title(outcome.quantity(name).heading)
        for letter, key in zip("xy", swept.keys, strict=False):
            panel.set(**{f"{letter}label": outcome.heading(key.field)})
            spaced_axis(panel, letter, key.values)  # type: ignore[arg-type]
    return figure


def _curve(figure: Figure, panel: Any, outcome: Outcome, swept: Swept, name: str) -> None:
    from experiments.harness.plotting import PALETTE

    key, values = swept.keys[0], outcome.values(name)
    panel.plot(key.values, values, color=PALETTE[0], marker="o", markersize=3)
    if name in swept.required:
        _required(panel, *swept.required[name], values)
    for change in outcome.result["crossings"] or ():
        if change.requirement == name:
            panel.axvline(change.at, color=MISSED, linewidth=0.9)
    if key.now is not None and min(key.values) <= key.now <= max(key.values):
        panel.axvline(key.now, color=NOW, linewidth=1.0, dashes=(1, 2))
    if np.isfinite(values).any() and np.nanmin(values) > 0 and name.endswith(("_arcsec", "_px")):
        panel.set_ylim(0, None)


def _map(figure: Figure, panel: Any, outcome: Outcome, swept: Swept, name: str) -> None:
    from experiments.harness.plotting import INK

    first, second = (np.array(key.values) for key in swept.keys)
    values = outcome.values(name).reshape(len(first), len(second)).T
    mesh = panel.pcolormesh(first, second, np.ma.masked_invalid(values), shading="nearest", cmap="cividis")
    figure.colorbar(mesh, ax=panel, pad=0.02)
    required = swept.required.get(name, (math.nan, True))[0]
    if np.nanmin(values) < required < np.nanmax(values) and min(values.shape) > 1:
        panel.contour(*_finer(first, second, values), levels=[required], colors=MISSED, linewidths=1.4)
    missed = np.array([point.at for point in swept.points if swept.required and not point.met]).reshape(-1, 2)
    for colour, thickness in ((INK, 2.2), ("white", 0.9)):  # visible on light and dark colours
        panel.plot(*missed.T, "x", color=colour, markersize=3.5, markeredgewidth=thickness)
    panel.grid(visible=False)


def _finer(first: FloatArray, second: FloatArray, values: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """A map (second, first) on a fine grid, by cubic splines of logarithms; unchanged if any point is refused."""
    from scipy.interpolate import RectBivariateSpline

    if not (np.isfinite(values).all() and (values > 0.0).all()):
        return first, second, values
    logs = [logarithmic(axis.tolist()) for axis in (first, second)]
    axes = [np.log(axis) if log else axis for axis, log in zip((first, second), logs, strict=True)]
    fine = [np.linspace(axis[0], axis[-1], FINE) for axis in axes]
    x, y = (np.exp(axis) if log else axis for axis, log in zip(fine, logs, strict=True))
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
class RequirementVerdicts:
    """Performance of each sensor against a requirement of its file."""

    label: str = col("Requirement")
    verdict: Sequence[str] = col("Verdict", dims="sensor")


@dataclass(frozen=True, slots=True, kw_only=True)
class _Curves:
    """Quantities that a figure compares between sensors."""

    outcomes: tuple[Outcome, ...]
    names: tuple[str, ...]
    sensors: tuple[str, ...]


def run_comparison(declared: Experiment, configs: Sequence[Any], *, progress: Progress) -> dict[str, Any]:
    """Predict all sensors."""
    outcomes, names = [], list[str]()
    for number, config in enumerate(progress.track(configs, "sensors"), start=1):
        name = _name(config)
        try:
            outcomes.append(_predicted(declared, config))
        except StarbenchError as error:
            raise DomainError(f"sensor {number} ({name}): {error}") from None
        repeated = sum(name == other for other in map(_name, configs[:number]))
        names.append(name if repeated == 1 else f"{name} ({repeated})")
    numbers = [single_numbers(outcome.data) for outcome in outcomes]
    requirements = [judge(_limits(declared, c), n) for c, n in zip(configs, numbers, strict=True)]
    common = {name: number for name, number in numbers[0].items() if all(name in other for other in numbers)}
    common.pop("requirements_missed", None)
    fields = [
        ("sensor", str, col("Sensor")),
        *_columns(common, [name for name in declared.swept if name in common]),
        ("requirements", int, col("Requirements", shown=False)),
        ("requirements_missed", int, col("Requirements missed", shown=False)),
    ]
    record = make_dataclass("Sensor", fields, frozen=True, kw_only=True)
    rows = [
        record(
            sensor=name,
            requirements=len(verdicts),
            requirements_missed=sum(not verdict.met for verdict in verdicts),
            **{key: float(predicted[key].values) for key in common},
        )
        for name, predicted, verdicts in zip(names, numbers, requirements, strict=True)
    ]
    return {
        "sensors": rows,
        "requirements": _verdicts(requirements) or None,
        "differences": _differences(configs) or None,
        "curves": _Curves(outcomes=tuple(outcomes), names=tuple(declared.compared), sensors=tuple(names)),
    }


def _verdicts(requirements: Sequence[Sequence[Requirement]]) -> list[RequirementVerdicts]:
    sensors = [{requirement.key: requirement for requirement in verdicts} for verdicts in requirements]
    labels = {key: requirement.label for sensor in sensors for key, requirement in sensor.items()}
    rows = []
    for key, label in labels.items():
        verdicts = (sensor.get(key) for sensor in sensors)
        words = ["not required" if v is None else f"{'met' if v.met else 'MISSED'}, {v.margin}" for v in verdicts]
        rows.append(RequirementVerdicts(label=label, verdict=words))
    return rows


def _differences(configs: Sequence[Any]) -> list[Difference]:
    settings = [flat(config.model_dump()) for config in configs]
    keys = dict.fromkeys(key for values in settings for key, value in values.items() if key != "name" and value != {})
    rows = [Difference(key=key, value=[_plain(values.get(key)) for values in settings]) for key in keys]
    return [row for row in rows if len(set(row.value)) > 1]


def _plain(value: Any) -> str:
    if value is None:
        return "–"
    if isinstance(value, (tuple, list)):
        return ", ".join(map(_plain, value))
    return f"{value:g}" if isinstance(value, float) else str(value)


def _draw_curves(outcome: Outcome) -> Figure:
    from experiments.harness.plotting import PALETTE, log_ticks, new_figure

    curves: _Curves = outcome.result["curves"]
    names = [name for name in curves.names if all(name in sensor for sensor in curves.outcomes)]
    figure, axes = new_figure(1, len(names), aspect_ratio=0.42, squeeze=False)
    for panel, name in zip(axes[0], names, strict=True):
        for predicted, sensor, colour in zip(curves.outcomes, curves.sensors, PALETTE, strict=False):
            (dim,) = predicted.quantity(name).dims
            panel.plot(predicted.data[dim].values, predicted.values(name), color=colour, label=sensor)
        panel.set(xlabel=curves.outcomes[0].heading(dim), ylabel=curves.outcomes[0].heading(name))
        if name.endswith("_arcsec"):
            panel.set_yscale("log")
            log_ticks(panel, "y")
    axes[0][-1].legend()
    return figure


def comparison_sections(result: Mapping[str, Any]) -> dict[str, Section]:
    """Sections of a comparison; its rows are the numbers that all sensors have."""
    return {
        "sensors": Section(
            record=type(result["sensors"][0]),
            dim="sensor",
            along="sensor",
            vertical=True,
            caption="Predictions for all sensors.",
        ),
        "requirements": Section(
            record=RequirementVerdicts,
            dim="requirement",
            rows="requirement",
            hidden="requirement",
            across="sensor",
            caption="Each sensor against the requirements of its own file, with its margin.",
        ),
        "differences": Section(
            record=Difference,
            dim="key",
            along="key",
            table="differences",
            across="sensor",
            columns="value",
            caption="Differences of the configurations.",
        ),
        "curves": Section(record=_Curves, figures={"curves": _draw_curves}),
    }
