"""Sections of an experiment: records whose fields describe themselves; Dataset, tables, JSON and verdicts follow.

A section answers one question. Its record is a frozen dataclass whose fields are `col`: label, unit, format and
dimensions stand where the number is defined. ``run`` of the experiment returns a mapping: name of the section -> its
record, or a sequence of records along the dimension of the section, or None for a section that a run skips::

    @dataclass(frozen=True, slots=True, kw_only=True)
    class FieldPoint:
        field_deg: float = col("Field", "deg", "g")
        baseline_bias: Measured = col("Pixel method", "percent")
        closed_form: float = col("Closed form", "percent", ".4f")

    SECTIONS = {
        "fields": Section(
            record=FieldPoint,
            dim="field",
            along="field_deg",
            caption="Bias of sigma against the field angle.",
            figures={"field_bias": curves("field_deg", points="baseline_bias", lines="closed_form")},
            verdicts=[agree("baseline_bias", with_="closed_form")],
        )
    }

The module is light: figures are drawn, and matplotlib and xarray imported, when they are needed.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from scipy.special import ndtr, ndtri

from experiments.harness.pivot import Pivot
from experiments.harness.quantities import Outcome, Quantities, Quantity, names_of, shown_unit
from experiments.harness.summary import Criterion, farthest_from_one
from experiments.harness.tables import Column, Table, cell_text
from optics.errors import DomainError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FALSE_ALARM = 0.001
"""Chance that a verdict fails by noise alone, unless it says another one."""
PREDICTION_SIGMA = 3.0
"""Standard deviations for which the stated error of a prediction (``slack``) stands."""


Advice = str | Callable[[Outcome], str]
"""Likely cause where a verdict fails, or a function that gives it for an outcome."""


class Verdict(Protocol):
    """``verdict(outcome)`` gives criteria; ``names`` are the quantities that it needs."""

    names: tuple[str, ...]

    def __call__(self, outcome: Outcome) -> list[Criterion]: ...


def col(
    label: str,
    unit: str = "",
    format: str = "",
    dims: str = "",
    *,
    shown: bool = True,
    default: Any = ...,
) -> Any:
    """A field of a record that is a quantity.

    Parameters
    ----------
    label, unit, format : str
        What it is, its unit ("arcsec", "px", "um", "e-"), and the format of plain numbers (".3f"), for tables, axes and
        the text of the report.
    dims : str
        Dimensions of the value, without that of the section; those with names were described by ``axes``.
    shown : bool
        Whether the section's table shows it; the ECSV file has it anyway.
    default : object
        Value where a record does not give it; None leaves the quantity out.
    """
    metadata = {"col": {"label": label, "unit": unit, "format": format, "dims": dims}, "shown": shown}
    return field(metadata=metadata) if default is ... else field(metadata=metadata, default=default)


@dataclass(frozen=True, slots=True, kw_only=True)
class Section:
    """A question of an experiment, and how its answer is shown."""

    record: type  # Dataclass of `col` fields
    dim: str = ""  # Dimension of a sequence of records; "" for one record
    along: str = ""  # Field that gives the coordinates of ``dim``; 1, 2, 3 ... without it
    # ``axes(quantities, value)``: dimensions that only this section has, described from its records
    axes: Callable[[Quantities, Any], None] | None = None
    table: str = ""  # Name of its table and ECSV file, if not that of the section; none without a caption
    rows: str = ""  # Dimensions that run down; ``dim`` and those of the columns by default
    across: str = ""  # Dimensions spread over columns
    # Columns that are shown, in this order; by default every field with ``shown``. A name that is no field of the
    # record is a quantity of another section
    columns: str = ""
    hidden: str = ""  # Dimensions of the rows without a column of their own
    where: Mapping[str, Any] = field(default_factory=dict)  # As of `Pivot`
    vertical: bool = False  # One row per quantity: label, value (of every record), unit, name
    caption: str = ""  # Of the table
    note: str = ""  # Small print below the table
    figures: Mapping[str, Callable[..., Figure]] = field(default_factory=dict)  # Name -> figure of an outcome
    verdicts: Sequence[Verdict] = ()

    def table_name(self, name: str) -> str:
        """Name of the table of the section ``name``; "" where it has none."""
        return self.table or (name if self.caption else "")

    def columns_of(self) -> dict[str, Mapping[str, Any]]:
        """Fields of the record that are quantities -> their `col` descriptions."""
        return {member.name: member.metadata for member in fields(self.record) if "col" in member.metadata}

    def describe(self, q: Quantities, section: str, value: Any) -> None:
        """Add the record, or the records along ``dim``, to the quantities as ``section.FIELD``; None adds nothing."""
        if value is None:
            return
        if self.axes is not None:
            self.axes(q, value)
        records = list(value) if self.dim else [value]
        columns = self.columns_of()
        if self.dim and self.dim not in q.coordinates:
            head = columns[self.along]["col"] if self.along else {"label": self.dim.replace("_", " ").capitalize()}
            values = [getattr(record, self.along) for record in records] if self.along else np.arange(len(records)) + 1
            q.axis(self.dim, values, **{part: head.get(part) or "" for part in ("label", "unit", "format")})
        for name, metadata in columns.items():
            values = [getattr(record, name) for record in records]
            if not records or all(value is None for value in values):
                continue
            col = metadata["col"]
            q.add(
                f"{section}.{name}",
                values if self.dim else values[0],
                col["label"],
                unit=col["unit"],
                format=col["format"],
                dims=f"{self.dim} {col['dims']}".strip(),
            )

    def table_of(self, outcome: Outcome, *, every: bool = False) -> Pivot | Table:
        """Its table: the shown columns, or every column that has no further dimensions (for the ECSV file)."""
        columns = self.columns_of()
        shown = self.columns.split() or [name for name, metadata in columns.items() if metadata["shown"]]
        if self.vertical:
            return self._vertical(outcome, list(dict.fromkeys((*shown, *columns))) if every else shown, every=every)
        shown = [name for name in shown if name not in columns or f"{outcome.section}.{name}" in outcome]
        if not self.rows:
            shown = [name for name in shown if name != self.along]
        dims = [dim for name in shown if name in outcome for dim in outcome.dims(name)]
        rows = self.rows.split() or [dim for dim in (self.dim, *dims) if dim and dim not in self.across.split()]
        if every:
            runs = {*rows, *self.across.split(), *self.where}
            others = [name for name in columns if name != self.along and f"{outcome.section}.{name}" in outcome]
            shown += [name for name in others if name not in shown and {*outcome.dims(name)} <= runs]
        return Pivot(
            columns=" ".join(outcome.name(name) for name in shown if name in outcome),
            rows=" ".join(dict.fromkeys(rows)),
            across=self.across,
            hidden=self.hidden,
            where=self.where,
            section=outcome.section,
            coordinates={self.dim: self.along} if self.along else {},
            caption=self.caption,
            note=self.note,
        )

    def _vertical(self, outcome: Outcome, names: Sequence[str], *, every: bool) -> Table:
        """One row per quantity, one column per record."""
        heads = outcome.names(self.dim) if self.dim else ["Value"]
        columns = [Column(name=head, key=f"{self.dim}_{n}" if self.dim else "") for n, head in enumerate(heads, 1)]
        rows = []
        for quantity in (outcome.quantity(name) for name in names if name in outcome and name != self.dim):
            if quantity.dims != ((self.dim,) if self.dim else ()):
                continue
            members = [quantity.at(**{self.dim: n}) for n in range(len(heads))] if self.dim else [quantity]
            values = [member.scalar() for member in members]
            cells = values if every else [cell_text(value, quantity.format) for value in values]
            rows.append((quantity.label, *cells, shown_unit(quantity.unit), quantity.field))
        return Table(columns=("Quantity", *columns, "Unit", "Name"), rows=rows, caption=self.caption, note=self.note)


def described(sections: Mapping[str, Section], q: Quantities, result: Mapping[str, Any]) -> Quantities:
    """Quantities of all sections, in their order."""
    unknown = set(result) - set(sections)
    if unknown:
        raise DomainError(f"no section is declared for {', '.join(sorted(unknown))}")
    for name, section in sections.items():
        section.describe(q, name, result.get(name))
    return q


def numbers_of(*records: Any) -> dict[str, Quantity]:
    """Single numbers of records, by field."""
    numbers: dict[str, Quantity] = {}
    for record in records:
        for name, metadata in Section(record=type(record)).columns_of().items():
            col, value = metadata["col"], np.asarray(getattr(record, name))
            if not col["dims"]:
                numbers[name] = Quantity(name, col["label"] or name, col["unit"], col["format"], (), value, None, None)
    return {name: number for name, number in numbers.items() if number.values.dtype.kind in "if"}


def single_numbers(data: Any) -> dict[str, Quantity]:
    """Numbers without dimensions, by FIELD; by SECTION_FIELD where several sections have that field."""
    numbers = [Quantity.of(data, name) for name in names_of(data) if not data[name].dims]
    count = Counter(number.field for number in numbers)
    return {
        number.field if count[number.field] == 1 else number.name.replace(".", "_"): number
        for number in numbers
        if number.values.dtype.kind in "if"
    }


def tabulated(sections: Mapping[str, Section], outcome: Outcome, *, every: bool = False) -> dict[str, Pivot | Table]:
    """Tables of the sections that have one; with ``every`` all their columns."""
    return {
        table: section.table_of(replace(outcome, section=name), every=every)
        for name, section in sections.items()
        if outcome.result.get(name) is not None and (table := section.table_name(name))
    }


def judged(sections: Mapping[str, Section], outcome: Outcome) -> list[Criterion]:
    """Criteria of all sections whose question was put."""
    return [
        criterion
        for name, section in sections.items()
        if outcome.result.get(name) is not None
        for verdict in section.verdicts
        for criterion in verdict(replace(outcome, section=name))
    ]


def two_sided_limit(count: int, false_alarm: float = FALSE_ALARM) -> float:
    """Standard deviations that the largest of ``count`` normal deviates exceeds with probability ``false_alarm``."""
    return float(-ndtri(false_alarm / (2 * count)))


def chance_of(largest: float, count: int) -> float:
    """Probability that the largest of ``count`` normal deviates is at least so large."""
    return float(-np.expm1(count * np.log1p(-2.0 * ndtr(-largest)))) if count and largest > 0.0 else 1.0


def noticed(limit: float, part: Any, slack: float = 0.0) -> float:
    """Relative error, common to all, that takes one of several numbers beyond a limit in half of all runs.

    ``part`` is the standard deviation of each number over what an error is a part of, ``limit`` that of the largest
    deviation in these units, ``slack`` a relative error allowed in addition. Infinite where nothing can be noticed.
    """
    from scipy.optimize import brentq

    part = np.ravel(np.asarray(part, float))
    part = part[np.isfinite(part)]
    if not part.size:
        return float("inf")
    most = float(limit * part.min())  # the most exact number alone notices this
    if most == 0.0:
        return slack

    def held(error: float) -> float:
        shift = error / np.maximum(part, 1e-12 * most)
        return float(np.sum(np.log(ndtr(limit - shift) - ndtr(-limit - shift)))) - np.log(0.5)

    return slack + float(brentq(held, 0.0, 1.001 * most))


def agree(
    name: str,
    with_: str | float,
    *,
    title: str = "",
    each: str = "",
    at: Mapping[str, Any] | None = None,
    of: str | float | None = None,
    square: bool = False,
    error: float | None = None,
    false_alarm: float = FALSE_ALARM,
    slack: float | str = 0.0,
    advice: Advice = "",
) -> Verdict:
    """A quantity against another one, or a number: the largest deviation over the uncertainties of both.

    Cells whose prediction or uncertainty is NaN are left out; if none is left, the verdict fails. Where an error of
    25 % would not be noticed, the value is shown, not judged (`experiments.harness.summary.Criterion`).

    Parameters
    ----------
    name, with_ : str
        Measured and predicted quantity; ``with_`` may be a number.
    title : str
        What is judged, in words; by default the labels of both.
    each : str
        Dimension along which each coordinate is judged by itself.
    at : mapping
        Dimension -> coordinate or position that is judged; the verdict is left out where there is none such.
    of : str or float
        What an error is a part of, a quantity or a number in the unit of the measured one; by default the prediction.
        Needed where that is zero (a bias: the standard deviation it would spoil).
    square : bool
        The quantity is a mean square: an error is a part of its root.
    error : float
        Standard deviation of a measured quantity that states none.
    false_alarm : float
        Probability that the verdict fails by noise alone; the limit follows from it and the number of deviates.
    slack : float or str
        Part of the predicted value that the prediction may be off, counted as three standard deviations; a number or a
        quantity.
    advice : str or function
        What is likely wrong where it fails; a function of the outcome where that depends on what came out.
    """

    def judge(outcome: Outcome) -> list[Criterion]:
        out = []
        for measured, who, where in _parts(outcome, name, each, at):
            predicted = outcome.quantity(with_).at(**where) if isinstance(with_, str) else None
            expected = predicted.values if predicted is not None else float(str(with_))
            errors = [part.error for part in (measured, predicted) if part is not None and part.error is not None]
            errors += [np.asarray(error)] if error is not None else []
            off = float(outcome.value(slack)) if isinstance(slack, str) else slack
            variance = sum((np.square(sigma) for sigma in errors), np.square(off * expected / PREDICTION_SIGMA))
            finite = np.broadcast_to(~np.isnan(expected + np.sqrt(variance)), measured.values.shape)
            pulls = ((measured.values - expected) / np.sqrt(variance))[finite]
            part_of = outcome.quantity(of).at(**where).values if isinstance(of, str) else of
            limit = two_sided_limit(max(pulls.size, 1), false_alarm)
            worst = float(np.abs(pulls).max()) if pulls.size else float("nan")
            other = f"{expected:g}" if predicted is None else predicted.label.lower()
            what = title or f"{measured.label} against {other}"
            number = f", largest of {pulls.size} deviations" if pulls.size > 1 else ""
            out.append(
                Criterion(
                    name=f"{who}{what}{number}",
                    value=worst,
                    limit=limit,
                    unit="sigma",
                    advice=_words(advice, outcome),
                    false_alarm=false_alarm,
                    chance=chance_of(worst, pulls.size),
                    notices=_noticed(
                        limit, np.sqrt(variance), np.abs(expected if part_of is None else part_of), finite, square
                    ),
                )
            )
        return out

    return _named(judge, name, with_, of)


def _noticed(limit: float, sigma: Any, total: Any, finite: Any, square: bool) -> float | None:
    """Relative error that is noticed; None where there is nothing that an error is a part of."""
    sigma, total = (np.broadcast_to(values, finite.shape)[finite] for values in (sigma, total))
    positive = total > 0.0
    return _of_root(noticed(limit, sigma[positive] / total[positive]), square) if np.any(positive) else None


def _of_root(error: float, square: bool) -> float:
    """Relative error of the root of a mean square, from that of the mean square."""
    return float(np.sqrt(1.0 + error) - 1.0) if square else error


def ratio_near(
    name: str,
    about: float = 1.0,
    *,
    within: float,
    title: str = "",
    each: str = "",
    at: Mapping[str, Any] | None = None,
    mean: bool = False,
    square: bool = False,
    false_alarm: float = FALSE_ALARM,
    advice: Advice = "",
) -> Verdict:
    """A ratio: the farthest of several from ``about`` (or their mean) within a part of it, plus what noise may do.

    Parameters as of `agree`; ``within`` is the allowed error of the prediction in addition to the noise of the
    measurement.
    """

    def judge(outcome: Outcome) -> list[Criterion]:
        out = []
        for measured, who, _ in _parts(outcome, name, each, at):
            error = np.zeros(1) if measured.error is None else np.ravel(measured.error)
            value = float(measured.values.mean()) if mean else about * farthest_from_one(measured.values / about)
            spread = np.array([np.sqrt((error**2).sum()) / error.size]) if mean else error
            count, widest = (spread.size, float(spread.max()))
            sigmas = two_sided_limit(count, false_alarm)
            beyond = abs(value - about) - within
            of = f", mean of {measured.values.size}" if mean and measured.dims else ""
            out.append(
                Criterion(
                    name=f"{who}{title or measured.label}{of}",
                    value=value,
                    about=about,
                    limit=within + sigmas * widest,
                    advice=_words(advice, outcome),
                    false_alarm=false_alarm if widest else None,
                    chance=chance_of(beyond / widest, count) if widest else None,
                    # all are held against the limit of the least exact
                    notices=_of_root(noticed(sigmas, np.full(count, widest / about), within / about), square),
                )
            )
        return out

    return _named(judge, name)


def below(
    name: str,
    limit: str | float,
    *,
    title: str = "",
    each: str = "",
    at: Mapping[str, Any] | None = None,
    size: bool = False,
    least: bool = False,
    whole: str | float | None = None,
    false_alarm: float | None = None,
    advice: Advice = "",
) -> Verdict:
    """The largest of a quantity (with ``size`` of its absolute values) at or below a number or another quantity.

    With ``least`` the smallest, at or above it (`above`). ``whole`` is the limit without the allowance for noise that
    it holds, a number or a quantity: errors beyond ``limit / whole - 1`` are noticed. ``false_alarm`` as of `agree`.
    """

    def judge(outcome: Outcome) -> list[Criterion]:
        out = []
        for measured, who, where in _parts(outcome, name, each, at):
            bound = outcome.quantity(limit).at(**where).values if isinstance(limit, str) else limit
            values = np.abs(measured.values) if size else measured.values
            farthest = np.argmin if least else np.argmax
            plain = outcome.quantity(whole).at(**where).values if isinstance(whole, str) else whole
            with np.errstate(invalid="ignore", divide="ignore"):  # nothing allowed, nothing measured
                worst = int(farthest(np.ravel(values / bound))) if np.size(values) > 1 else 0
            out.append(
                Criterion(
                    name=f"{who}{title or measured.label}",
                    value=float(np.ravel(values)[worst]),
                    limit=float(np.ravel(np.broadcast_to(bound, np.shape(values)))[worst]),
                    unit=measured.unit,
                    relation=">=" if least else "<=",
                    advice=_words(advice, outcome),
                    false_alarm=false_alarm,
                    notices=None if plain is None else float(np.max(np.abs(bound / plain - 1.0))),
                )
            )
        return out

    return _named(judge, name, limit, whole)


def above(name: str, limit: str | float, **others: Any) -> Verdict:
    """The smallest of a quantity at or above a number or another quantity; parameters as of `below`."""
    return below(name, limit, least=True, **others)


def _words(advice: Advice, outcome: Outcome) -> str:
    return advice if isinstance(advice, str) else advice(outcome)


def _named(judge: Any, *names: str | float | None) -> Verdict:
    judge.names = tuple(name for name in names if isinstance(name, str))
    verdict: Verdict = judge
    return verdict


def _parts(
    outcome: Outcome, name: str, each: str, at: Mapping[str, Any] | None
) -> Iterator[tuple[Quantity, str, dict[str, int]]]:
    """Parts of a quantity that are judged by themselves, what readers call them, where they are; none if it is not."""
    if name not in outcome:
        return
    fixed: dict[str, int] = {}
    for dim, key in (at or {}).items():
        coordinates = outcome.data.coords[dim].values.tolist() if dim in outcome.data.coords else []
        if not isinstance(key, int) and key not in coordinates:
            return
        fixed[dim] = key if isinstance(key, int) else coordinates.index(key)
    for position in range(outcome.data.sizes[each]) if each else [None]:
        here = fixed | ({} if position is None else {each: position})
        called = ", ".join(outcome.names(dim)[n] for dim, n in here.items())
        yield outcome.quantity(name).at(**here), f"{called}: " if called else "", here
