"""Figures that draw what the Dataset holds: ``curves("x", points="measured", lines="predicted", by="method")``.

Points are measured and carry their uncertainty, lines are predicted, the grey floor is a lower bound, dashes are
published values. Every function returns a function of an outcome, which is what the figures of a section are; its
attribute ``names`` holds the quantities that it draws. A figure that has to compute lacks a column.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from experiments.harness.quantities import Outcome, Quantity

Drawing = Callable[["Outcome"], "Figure"]
GREY, SHADE = "#8a9099", "#eef0f2"


def curves(
    x: str,
    *,
    points: str = "",
    lines: str = "",
    by: str = "",
    panels: str = "",
    floor: str = "",
    dashes: str = "",
    level: float | None = None,
    band: float = 0.0,
    log: str = "",
    y: str = "",
    at: dict[str, Any] | None = None,
    **size: Any,
) -> Drawing:
    """Quantities against ``x``: one colour per coordinate of ``by`` (or per quantity), one panel per ``panels``.

    Parameters
    ----------
    x : str
        Quantity or dimension of the horizontal axis; texts become its ticks.
    points, lines : str
        Quantities, measured (markers with their uncertainty, not joined) and predicted (joined). Several of one kind
        without ``by`` get a colour each; a line that does not depend on ``by`` is drawn once, in black.
    by : str
        Dimension, or quantity of text along ``x``: its values group the points.
    floor : str
        Quantity that is a lower bound.
    dashes : str
        Quantity without ``x``, a horizontal line; omitted if the Dataset lacks it.
    level, band : float
        A horizontal line, and half of the height of the grey band about it.
    log : str
        Axes that are logarithmic, e.g. "xy".
    y : str
        Label of the vertical axis in place of the first quantity's; the unit is added.
    at : dict
        Dimension -> coordinate that is drawn.
    **size
        As of `experiments.harness.plotting.new_figure`.
    """

    def draw(o: Outcome) -> Figure:
        from experiments.harness.plotting import INK, MARKERS, PALETTE, log_ticks

        members = _keys(o, by)
        figure, grid = _panels(o, panels, {"sharey": True, "aspect_ratio": 0.5} | size)
        all_x, ticks = _axis(o, x)
        groups = o.values(by) if by and by in o and by not in o.data.dims else None
        coloured = not by and len(points.split()) + len(lines.split()) > 1
        for panel, coordinates in grid:
            if level is not None:
                panel.axhline(level, color=INK, linewidth=0.8)
                panel.axhspan(level - band, level + band, color=SHADE, linewidth=0, zorder=0)
            for number, member in enumerate(members):
                chosen = ... if groups is None or not by else groups == member
                where = {**coordinates, **(at or {}), **({by: member} if by else {})}
                member_x = all_x[chosen]
                for k, name in enumerate(name for name in lines.split() if name in o):
                    shared = _shared(o, name, by)
                    if not shared or number == 0:
                        colour = INK if shared else PALETTE[k if coloured else number]
                        panel.plot(member_x, _part(o, name, where).values[chosen], color=colour, linewidth=1.1)
                for k, name in enumerate(name for name in points.split() if name in o):
                    measured, style = _part(o, name, where), k if coloured else number
                    error = None if measured.error is None else measured.error[chosen]
                    panel.errorbar(
                        _offset(member_x, number, len(members), log) if level is not None else member_x,
                        measured.values[chosen],
                        error if error is not None and np.isfinite(error).any() else None,
                        fmt=MARKERS[style],
                        color=PALETTE[style],
                        markerfacecolor="white",
                        linewidth=0.9,
                    )
            where = {**coordinates, **(at or {})}
            if floor and floor in o:
                bound = _part(o, floor, where).values
                panel.plot(member_x, bound, color=INK, linewidth=1.0)
                panel.fill_between(member_x, 1e-9 if "y" in log else 0.0, bound, color=SHADE, linewidth=0, zorder=0)
                panel.set_ylim(0.75 * np.nanmin(o.values(floor)) if "y" in log else 0.0, None)
            if dashes and dashes in o:
                published = _part(o, dashes, where)
                value = float(published.values)
                panel.axhline(value, color=GREY, linewidth=0.9, dashes=(5, 3))
                words = f"{published.label[:1].lower()}{published.label[1:]} {value:{published.format or 'g'}}"
                panel.text(member_x[-1], value, words, ha="right", va="bottom")
            panel.set(xlabel=o.heading(x))
            for letter in log:
                panel.set(**{f"{letter}scale": "log"})
                log_ticks(panel, "x" if letter == "x" else "y")
            if ticks:
                panel.set_xticks(member_x, ticks)
        first = next(o.quantity(name) for name in (points or lines).split() if name in o)
        grid[0][0].set_ylabel(replace(first, label=y or first.label).heading)
        black = [name for name in (*lines.split(), floor) if name in o and (name == floor or _shared(o, name, by))]
        _legend(o, figure, by, members, (points, lines) if coloured else ("", ""), black)
        return figure

    return _named(draw, points, lines, floor)


def bars(
    dim: str, *, bars: str, points: str = "", marks: str = "", by: str = "", panels: str = "", **size: Any
) -> Drawing:
    """Quantities along ``dim`` as bars, for each coordinate of ``by``.

    ``points`` (predictions) are circles, ``marks`` (published) grey diamonds; without ``bars`` the points are the bars.
    """

    def draw(o: Outcome) -> Figure:
        from experiments.harness.plotting import INK, PALETTE

        length, circles = (bars, points) if bars in o else (points, "")
        markers = [(name, *style) for name, *style in ((circles, "o", INK), (marks, "D", GREY)) if name and name in o]
        members = _keys(o, by)
        figure, grid = _panels(o, panels, {"sharey": True, "aspect_ratio": 0.36} | size)
        row, height = -np.arange(o.data.sizes[dim], dtype=float), 0.7 / len(members)
        for panel, coordinates in grid:
            for number, (member, colour) in enumerate(zip(members, PALETTE, strict=False)):
                where = {**coordinates, **({by: member} if by else {})}
                member_row = row - height * (number - (len(members) - 1) / 2)
                label = o.label(by, member) if by else o.quantity(length).label
                panel.barh(member_row, o.values(length, **where), height=height, color=colour, alpha=0.85, label=label)
                for name, shape, ink in markers:
                    style = {"color": ink, "markerfacecolor": "white", "markersize": 4, "linestyle": ""}
                    named = o.quantity(name).label if number == 0 else None
                    panel.plot(_part(o, name, where).values, member_row, marker=shape, label=named, **style)
            panel.set_yticks(row, o.names(dim))
            if len(row) < 3:
                panel.set_ylim(row.mean() - 1.5, row.mean() + 1.5)
            panel.grid(visible=False, axis="y")
            low = min(0.0, float(np.nanmin(o.values(length))))
            heading = o.heading(length).removeprefix(o.quantity(length).label if markers else "")
            panel.set(xlabel=heading.strip(), xlim=(low or 0, None))
        handles, labels = grid[0][0].get_legend_handles_labels()
        if len(handles) > 1:
            figure.legend(handles, labels, loc="outside lower center", ncols=4)
        return figure

    return _named(draw, bars, points, marks)


def maps(name: str, *, place: str = "", panels: str = "", zero: bool = False, **size: Any) -> Drawing:
    """A quantity over two dimensions (row, column) as colours; with positions ``place``, (n, 2), as coloured points.

    ``zero`` centres a two-coloured scale on zero.
    """

    def draw(o: Outcome) -> Figure:
        from matplotlib.colors import Normalize

        figure, grid = _panels(o, panels, {"aspect_ratio": 0.5} | size)
        values = o.values(name).astype(float)
        largest = float(np.nanmax(np.abs(values)))
        low, high = (-largest, largest) if zero else (float(np.nanmin(values)), float(np.nanmax(values)))
        style = {"cmap": "RdBu_r" if zero else "viridis", "norm": Normalize(low, high)}
        for panel, where in grid:
            quantity = o.quantity(name, **where)
            if place:
                position = _part(o, place, where).values.reshape(-1, 2)
                colours = panel.scatter(*position.T, c=np.ravel(quantity.values), s=14, **style)
                panel.set(xlabel="x [px]", ylabel="y [px]", aspect="equal")
                panel.invert_yaxis()
            else:
                (y, rows), (x, columns) = (_axis(o, dim) for dim in quantity.dims)
                colours = panel.pcolormesh(x, y, quantity.values.astype(float), shading="nearest", **style)
                panel.set(xlabel=o.heading(quantity.dims[1]), ylabel=o.heading(quantity.dims[0]))
                if columns:
                    panel.set_xticks(x, columns, rotation=90)
                    panel.set(yticks=y, yticklabels=rows, aspect="equal")
                    panel.invert_yaxis()
            panel.grid(visible=False)
        figure.colorbar(colours, ax=[panel for panel, _ in grid], label=o.heading(name), shrink=0.85)
        return figure

    return _named(draw, name, place)


def cloud(name: str, *, ellipses: str = "", panels: str = "", at: dict[str, Any] | None = None) -> Drawing:
    """Vectors (..., axis) as points about zero; quantities as circles, or (axis) as semi-axes of ellipses.

    ``at``: coordinates or positions of the ellipses.
    """

    def draw(o: Outcome) -> Figure:
        from experiments.harness.plotting import INK, PALETTE

        width = {"aspect_ratio": 0.6} if panels else {"width": "half", "aspect_ratio": 1.0}
        figure, grid = _panels(o, panels, {"sharex": True, "sharey": True} | width)
        angle, unit = np.linspace(0, 2 * np.pi, 181), o.heading(name).partition("[")[2]
        largest = float(np.nanmax(np.abs(o.values(name))))
        for panel, coordinates in grid:
            vectors = o.values(name, **coordinates).reshape(-1, 2)
            size, alpha = (1.6, 0.5) if len(vectors) > 300 else (5.0, 0.9)
            panel.plot(*vectors.T, ".", color=PALETTE[0], markersize=size, alpha=alpha)
            for ellipse, colour in zip((e for e in ellipses.split() if e in o), (PALETTE[1], INK), strict=False):
                semi_axis = o.quantity(ellipse)
                where = {**coordinates, **(at or {})}
                where = {dim: _position(o, dim, where[dim]) for dim in where if dim in semi_axis.dims}
                x, y = np.broadcast_to(semi_axis.at(**where).values, 2)
                largest = max(largest, float(x), float(y))
                panel.plot(x * np.cos(angle), y * np.sin(angle), color=colour, label=semi_axis.label)
            panel.set(xlabel=f"x [{unit}", aspect="equal")
        limits = (-1.1 * largest, 1.1 * largest)
        grid[0][0].set(ylabel=f"y [{unit}", xlim=limits, ylim=limits)
        if ellipses:
            figure.legend(*grid[0][0].get_legend_handles_labels(), loc="outside lower center", ncols=2)
        return figure

    return _named(draw, name)


def arrows(place: str, *vectors: str, panels: str = "", frame: str = "", longest: float = 0.08, **size: Any) -> Drawing:
    """Vectors (..., axis) at positions (..., axis) on the detector, one panel per quantity or coordinate of ``panels``.

    ``frame`` is a quantity (width, height) whose edge is drawn; the longest arrow is ``longest`` of the width.
    """

    def draw(o: Outcome) -> Figure:
        from experiments.harness.plotting import PALETTE, new_figure
        from experiments.harness.quantities import shown_unit

        drawn = [(name, where) for name in vectors for where in _coordinates(o, panels)]
        shape = {"aspect_ratio": 0.7 if len(drawn) == 1 else 0.5} | size
        figure, grid = new_figure(1, len(drawn), sharey=True, squeeze=False, **shape)
        for panel, (name, where) in zip(grid[0], drawn, strict=True):
            quantity = o.quantity(name, **where)
            position = _part(o, place, where).values.reshape(-1, 2)
            vector = quantity.values.reshape(-1, 2)
            largest = float(np.nanmax(np.linalg.norm(vector, axis=1)))
            width = float(o.values(frame)[0] if frame else np.ptp(position[:, 0]))
            scale = (largest or 1.0) / (longest * width)
            style = {"angles": "xy", "scale_units": "xy", "scale": scale, "width": 0.004, "color": PALETTE[0]}
            panel.quiver(*position.T, *vector.T, **style)
            if frame:
                x, y = ((-0.5, float(pixels) - 0.5) for pixels in o.values(frame))
                panel.plot([x[0], x[1], x[1], x[0], x[0]], [y[0], y[0], y[1], y[1], y[0]], color=GREY, linewidth=0.8)
            label = o.label(panels, where[panels]) if panels else quantity.label
            title = f"{label}: longest {largest:.2g} {shown_unit(quantity.unit)}"
            panel.set(xlabel="column [px]", aspect="equal", title=title)
            panel.grid(visible=False)
        grid[0][0].set_ylabel("row [px]")
        grid[0][0].invert_yaxis()
        return figure

    return _named(draw, place, *vectors)


def _named(draw: Any, *names: str) -> Drawing:
    draw.names = tuple(name for text in names for name in text.split())
    drawing: Drawing = draw
    return drawing


def _panels(o: Outcome, dim: str, options: dict[str, Any]) -> tuple[Figure, list[tuple[Any, dict[str, Any]]]]:
    """Figure with a titled panel per coordinate of a dimension; its panels, each with its coordinate."""
    from experiments.harness.plotting import new_figure

    where = _coordinates(o, dim)
    figure, grid = new_figure(1, len(where), squeeze=False, **options)
    for panel, coordinates in zip(grid[0], where, strict=True):
        panel.set_title(o.label(dim, coordinates[dim]) if dim else "")
    return figure, list(zip(grid[0], where, strict=True))


def _coordinates(o: Outcome, dim: str) -> list[dict[str, Any]]:
    return [{dim: key} for key in _keys(o, dim)] if dim else [{}]


def _keys(o: Outcome, dim: str) -> list[Any]:
    """Coordinates along a dimension, positions if it has none; a single None without a dimension; or texts."""
    if not dim:
        return [None]
    if dim in o and dim not in o.data.dims:
        return list(dict.fromkeys(o.values(dim).tolist()))
    return o.data[dim].values.tolist() if dim in o.data.coords else list(range(o.data.sizes[dim]))


def _part(o: Outcome, name: str, where: dict[str, Any]) -> Quantity:
    """A quantity at those of the coordinates whose dimensions it has."""
    dims = o.dims(name)
    return o.quantity(name, **{dim: coordinate for dim, coordinate in where.items() if dim in dims})


def _position(o: Outcome, dim: str, key: Any) -> int:
    return key if isinstance(key, int) else o.data.coords[dim].values.tolist().index(key)


def _axis(o: Outcome, x: str) -> tuple[Any, list[str]]:
    """Numbers for an axis, and the texts of its ticks if they are none."""
    if x not in o:
        return np.arange(o.data.sizes[x], dtype=float) + 1.0, []
    values = o.values(x)
    if values.dtype.kind in "OU":
        return np.arange(len(values), dtype=float), o.names(x)
    return values.astype(float), []


def _shared(o: Outcome, name: str, by: str) -> bool:
    """Whether a line is the same for all coordinates of ``by``."""
    return by in o.data.dims and by not in o.dims(name)


def _offset(x: Any, number: int, count: int, log: str) -> Any:
    """Horizontal positions moved a little, so that points of several colours do not hide each other."""
    step = number - (count - 1) / 2
    return x * np.exp(0.02 * step) if "x" in log else x + 0.01 * step * float(np.ptp(x) or 1.0)


def _legend(o: Outcome, figure: Figure, by: str, members: list[Any], kinds: tuple[str, str], black: list[str]) -> None:
    from matplotlib.lines import Line2D

    from experiments.harness.plotting import INK, MARKERS, PALETTE

    points, lines = ([o.quantity(name).label for name in kind.split() if name in o] for kind in kinds)
    styles = list(zip(PALETTE, MARKERS, strict=True))
    handles = []
    if by:
        labels = o.labels(by) if by in o.data.coords else {n: f"{by} {n + 1}" for n in range(o.data.sizes.get(by, 0))}
        for member, (colour, marker) in zip(members, styles, strict=False):
            label = labels.get(member, member)
            handles.append(Line2D([], [], color=colour, marker=marker, markerfacecolor="white", label=label))
    for label, (colour, marker) in zip(points, styles, strict=False):
        style: dict[str, Any] = {"marker": marker, "markerfacecolor": "white", "linestyle": ""}
        handles.append(Line2D([], [], color=colour, label=label, **style))
    for label, (colour, _) in zip(lines, styles, strict=False):
        handles.append(Line2D([], [], color=colour, linewidth=1.1, label=label))
    handles += [Line2D([], [], color=INK, linewidth=1.0, label=o.quantity(name).label) for name in black]
    if handles:
        wide = max(len(str(handle.get_label())) for handle in handles) > 14
        columns = 2 if wide and figure.get_figwidth() < 5.0 else 4  # half a page has room for two long names
        figure.legend(handles=handles, loc="outside lower center", ncols=min(columns, len(handles)))
