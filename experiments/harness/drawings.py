"""Figures that draw what the Dataset holds: ``curves("x", points="measured", lines="predicted", by="method")``.

Points are measured and carry their uncertainty, lines are predicted, the grey floor is what cannot be reached, dashes
are published. Every function returns a function of an outcome, which is what the figures of a section are; ``names`` of
it are the quantities it draws. A figure that has to compute lacks a column.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from experiments.harness.quantities import Outcome

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
        Quantity or dimension of the axis across; without numbers its names stand as ticks.
    points, lines : str
        Quantities, measured (markers with their uncertainty, not joined) and predicted (joined). Several of one kind
        without ``by`` get a colour each; a line that does not depend on ``by`` is drawn once, in black.
    by : str
        Dimension, or quantity of text along ``x``: its values group the points.
    floor : str
        Quantity below which nothing can be.
    dashes : str
        Quantity without ``x``, drawn across the panel; left out where the Dataset lacks it.
    level, band : float
        A level across, and half of the grey height about it.
    log : str
        Axes that are logarithmic, e.g. "xy".
    y : str
        What the upright axis shows, where that is more than the label of the first quantity; the unit is added.
    at : dict
        Dimension -> coordinate that is drawn.
    **size
        As of `experiments.harness.plotting.new_figure`.
    """

    def draw(o: Outcome) -> Figure:
        from experiments.harness.plotting import INK, MARKERS, PALETTE, log_ticks, new_figure

        keys = _keys(o, panels)
        drawn = _keys(o, by)
        figure, grid = new_figure(1, len(keys), sharey=True, squeeze=False, **({"aspect_ratio": 0.5} | size))
        whole_x, ticks = _across(o, x)
        at_x, group = whole_x, o.values(by) if by and by in o and by not in o.data.dims else None
        apart = not by and len(points.split()) + len(lines.split()) > 1
        for panel, key in zip(grid[0], keys, strict=True):

            def part(name: str, key: Any = key, **more: Any) -> tuple[Any, Any]:
                where = {panels: key, **(at or {}), **more}
                where = {dim: one for dim, one in where.items() if dim and dim in o.dims(name)}
                some = ... if group is None or by not in more else group == more[by]
                return o.values(name, **where)[some], o.errors(name, **where)[some]

            if level is not None:
                panel.axhline(level, color=INK, linewidth=0.8)
                panel.axhspan(level - band, level + band, color=SHADE, linewidth=0, zorder=0)
            for k, member in enumerate(drawn):
                where = {by: member} if by else {}
                at_x = whole_x if group is None else whole_x[group == member]
                for n, name in enumerate(one for one in lines.split() if one in o):
                    shared = _shared(o, name, by)
                    if not shared or k == 0:
                        colour = INK if shared else PALETTE[n if apart else k]
                        panel.plot(at_x, part(name, **where)[0], color=colour, linewidth=1.1)
                for n, name in enumerate(one for one in points.split() if one in o):
                    value, error = part(name, **where)
                    style = n if apart else k
                    beside = _beside(at_x, k, len(drawn), log) if level is not None else at_x
                    panel.errorbar(
                        beside,
                        value,
                        error if np.isfinite(error).any() else None,
                        fmt=MARKERS[style],
                        color=PALETTE[style],
                        markerfacecolor="white",
                        linewidth=0.9,
                    )
            if floor and floor in o:
                bound = part(floor)[0]
                panel.plot(at_x, bound, color=INK, linewidth=1.0)
                panel.fill_between(at_x, 1e-9 if "y" in log else 0.0, bound, color=SHADE, linewidth=0, zorder=0)
                panel.set_ylim(0.75 * np.nanmin(o.values(floor)) if "y" in log else 0.0, None)
            if dashes and dashes in o:
                value, shown = float(part(dashes)[0]), o.quantity(dashes)
                panel.axhline(value, color=GREY, linewidth=0.9, dashes=(5, 3))
                words = f"{shown.label[:1].lower()}{shown.label[1:]} {value:{shown.format or 'g'}}"
                panel.text(at_x[-1], value, words, ha="right", va="bottom")
            panel.set(xlabel=o.heading(x), title=o.label(panels, key) if panels else "")
            for letter in log:
                panel.set(**{f"{letter}scale": "log"})
                log_ticks(panel, "x" if letter == "x" else "y")
            if ticks:
                panel.set_xticks(at_x, ticks)
        first = next(o.quantity(one) for one in (points or lines).split() if one in o)
        grid[0][0].set_ylabel(replace(first, label=y or first.label).heading)
        black = [name for name in (*lines.split(), floor) if name in o and (name == floor or _shared(o, name, by))]
        _legend(o, figure, by, drawn, (points, lines) if apart else ("", ""), black)
        return figure

    return _named(draw, points, lines, floor)


def bars(
    dim: str, *, bars: str, points: str = "", marks: str = "", by: str = "", panels: str = "", **size: Any
) -> Drawing:
    """Quantities along ``dim`` as bars, those of ``by`` next to each other.

    ``points`` (predictions) are circles, ``marks`` (published) grey diamonds; without ``bars`` the points are the bars.
    """

    def draw(o: Outcome) -> Figure:
        from experiments.harness.plotting import INK, PALETTE, new_figure

        long, circles = (bars, points) if bars in o else (points, "")
        keys, members = _keys(o, panels), _keys(o, by)
        figure, grid = new_figure(1, len(keys), sharey=True, squeeze=False, **({"aspect_ratio": 0.36} | size))
        place, thick = -np.arange(o.data.sizes[dim], dtype=float), 0.7 / len(members)
        for panel, key in zip(grid[0], keys, strict=True):
            for k, (member, colour) in enumerate(zip(members, PALETTE, strict=False)):
                at = {name: value for name, value in ((panels, key), (by, member)) if name}
                beside = place - thick * (k - (len(members) - 1) / 2)
                label = o.label(by, member) if by else o.quantity(long).label
                panel.barh(beside, o.values(long, **at), height=thick, color=colour, alpha=0.85, label=label)
                for name, shape, ink in ((circles, "o", INK), (marks, "D", GREY)):
                    if name and name in o:
                        style = {"color": ink, "markerfacecolor": "white", "markersize": 4, "linestyle": ""}
                        own = o.quantity(name).label if k == 0 else None
                        its = {dim: value for dim, value in at.items() if dim in o.dims(name)}
                        panel.plot(o.values(name, **its), beside, marker=shape, label=own, **style)
            panel.set_yticks(place, o.names(dim))
            if len(place) < 3:
                panel.set_ylim(place.mean() - 1.5, place.mean() + 1.5)
            panel.grid(visible=False, axis="y")
            low = min(0.0, float(np.nanmin(o.values(long))))
            compared = any(name and name in o for name in (circles, marks))
            heading = o.heading(long).removeprefix(o.quantity(long).label if compared else "")
            panel.set(title=o.label(panels, key) if panels else "", xlabel=heading.strip(), xlim=(low or 0, None))
        handles, labels = grid[0][0].get_legend_handles_labels()
        if len(handles) > 1:
            figure.legend(handles, labels, loc="outside lower center", ncols=4)
        return figure

    return _named(draw, bars, points, marks)


def maps(name: str, *, place: str = "", panels: str = "", zero: bool = False, **size: Any) -> Drawing:
    """A quantity over two dimensions (row, column) as colours; with ``place``, (n, 2), as coloured points at places.

    ``zero`` centres a two-coloured scale on zero.
    """

    def draw(o: Outcome) -> Figure:
        from matplotlib.colors import Normalize

        from experiments.harness.plotting import new_figure

        keys = _keys(o, panels)
        figure, grid = new_figure(1, len(keys), squeeze=False, **({"aspect_ratio": 0.5} | size))
        whole = o.values(name).astype(float)
        reach = float(np.nanmax(np.abs(whole)))
        low, high = (-reach, reach) if zero else (float(np.nanmin(whole)), float(np.nanmax(whole)))
        style = {"cmap": "RdBu_r" if zero else "viridis", "norm": Normalize(low, high)}
        for panel, key in zip(grid[0], keys, strict=True):
            one = o.quantity(name, **({panels: key} if panels else {}))
            if place:
                at = o.values(place, **({panels: key} if panels in o.quantity(place).dims else {}))
                drawn = panel.scatter(*at.reshape(-1, 2).T, c=np.ravel(one.values), s=14, **style)
                panel.set(xlabel="x [px]", ylabel="y [px]", aspect="equal")
                panel.invert_yaxis()
            else:
                down, across = one.dims
                (at_y, words_y), (at_x, words_x) = (_across(o, dim) for dim in (down, across))
                drawn = panel.pcolormesh(at_x, at_y, one.values.astype(float), shading="nearest", **style)
                panel.set(xlabel=o.heading(across), ylabel=o.heading(down))
                if words_x:
                    panel.set_xticks(at_x, words_x, rotation=90)
                    panel.set(yticks=at_y, yticklabels=words_y, aspect="equal")
                    panel.invert_yaxis()
            panel.grid(visible=False)
            panel.set_title(o.label(panels, key) if panels else "")
        figure.colorbar(drawn, ax=list(grid[0]), label=o.heading(name), shrink=0.85)
        return figure

    return _named(draw, name, place)


def cloud(name: str, *, ellipses: str = "", panels: str = "", at: dict[str, Any] | None = None) -> Drawing:
    """Places (..., axis) about zero; quantities as circles, or (axis) as half-axes of ellipses.

    ``at``: coordinates or positions of the ellipses.
    """

    def draw(o: Outcome) -> Figure:
        from experiments.harness.plotting import INK, PALETTE, new_figure

        keys, width = _keys(o, panels), {"aspect_ratio": 0.6} if panels else {"width": "half", "aspect_ratio": 1.0}
        figure, grid = new_figure(1, len(keys), sharex=True, sharey=True, squeeze=False, **width)
        turn, unit = np.linspace(0, 2 * np.pi, 181), o.heading(name).partition("[")[2]
        reach = float(np.nanmax(np.abs(o.values(name))))
        for panel, key in zip(grid[0], keys, strict=True):
            here = {panels: key} if panels else {}
            dots = o.values(name, **here).reshape(-1, 2)
            size, alpha = (1.6, 0.5) if len(dots) > 300 else (5.0, 0.9)
            panel.plot(*dots.T, ".", color=PALETTE[0], markersize=size, alpha=alpha)
            for one, colour in zip((e for e in ellipses.split() if e in o), (PALETTE[1], INK), strict=False):
                half = o.quantity(one)
                where = {dim: _position(o, dim, k) for dim, k in {**here, **(at or {})}.items() if dim in half.dims}
                x, y = np.broadcast_to(half.at(**where).values, 2)
                reach = max(reach, float(x), float(y))
                panel.plot(x * np.cos(turn), y * np.sin(turn), color=colour, label=half.label)
            panel.set(xlabel=f"x [{unit}", aspect="equal", title=o.label(panels, key) if panels else "")
        ends = (-1.1 * reach, 1.1 * reach)
        grid[0][0].set(ylabel=f"y [{unit}", xlim=ends, ylim=ends)
        if ellipses:
            figure.legend(*grid[0][0].get_legend_handles_labels(), loc="outside lower center", ncols=2)
        return figure

    return _named(draw, name)


def arrows(place: str, *vectors: str, panels: str = "", frame: str = "", longest: float = 0.08, **size: Any) -> Drawing:
    """Vectors (..., axis) at places (..., axis) on the detector, one panel per quantity or coordinate of ``panels``.

    ``frame`` is a quantity (width, height) whose edge is drawn; the longest arrow is ``longest`` of the reach.
    """

    def draw(o: Outcome) -> Figure:
        from experiments.harness.plotting import PALETTE, new_figure
        from experiments.harness.quantities import shown_unit

        shown = [(one, key) for one in vectors for key in _keys(o, panels)]
        shape = {"aspect_ratio": 0.7 if len(shown) == 1 else 0.5} | size
        figure, grid = new_figure(1, len(shown), sharey=True, squeeze=False, **shape)
        for panel, (name, key) in zip(grid[0], shown, strict=True):
            at = {panels: key} if panels else {}
            error = o.quantity(name, **at)
            where = o.values(place, **(at if panels in o.quantity(place).dims else {})).reshape(-1, 2)
            corner = o.values(frame) if frame else where.max(0)
            vector = error.values.reshape(-1, 2)
            top = float(np.nanmax(np.linalg.norm(vector, axis=1)))
            scale = (top or 1.0) / (longest * float(corner[0] if frame else np.ptp(where[:, 0])))
            style = {"angles": "xy", "scale_units": "xy", "scale": scale, "width": 0.004, "color": PALETTE[0]}
            panel.quiver(*where.T, *vector.T, **style)
            if frame:
                x, y = ((-0.5, float(end) - 0.5) for end in corner)
                panel.plot([x[0], x[1], x[1], x[0], x[0]], [y[0], y[0], y[1], y[1], y[0]], color=GREY, linewidth=0.8)
            label = o.label(panels, key) if panels else error.label
            panel.set(
                xlabel="column [px]", aspect="equal", title=f"{label}: longest {top:.2g} {shown_unit(error.unit)}"
            )
            panel.grid(visible=False)
        grid[0][0].set_ylabel("row [px]")
        grid[0][0].invert_yaxis()
        return figure

    return _named(draw, place, *vectors)


def _named(draw: Any, *names: str) -> Drawing:
    draw.names = tuple(one for text in names for one in text.split())
    drawing: Drawing = draw
    return drawing


def _keys(o: Outcome, dim: str) -> list[Any]:
    """Coordinates along a dimension, positions where it has none; a single None without a dimension; or texts."""
    if not dim:
        return [None]
    if dim in o and dim not in o.data.dims:
        return list(dict.fromkeys(o.values(dim).tolist()))
    return o.data[dim].values.tolist() if dim in o.data.coords else list(range(o.data.sizes[dim]))


def _position(o: Outcome, dim: str, key: Any) -> int:
    return key if isinstance(key, int) else o.data.coords[dim].values.tolist().index(key)


def _across(o: Outcome, x: str) -> tuple[Any, list[str]]:
    """Numbers for an axis, and the names to write there if they are none."""
    if x not in o:
        return np.arange(o.data.sizes[x], dtype=float) + 1.0, []
    values = o.values(x)
    if values.dtype.kind in "OU":
        return np.arange(len(values), dtype=float), o.names(x)
    return values.astype(float), []


def _shared(o: Outcome, name: str, by: str) -> bool:
    """Whether a line is the same for all coordinates of ``by``."""
    return by in o.data.dims and by not in o.dims(name)


def _beside(at_x: Any, k: int, count: int, log: str) -> Any:
    """Places moved a little, so that points of several colours do not hide each other."""
    step = k - (count - 1) / 2
    return at_x * np.exp(0.02 * step) if "x" in log else at_x + 0.01 * step * float(np.ptp(at_x) or 1.0)


def _legend(o: Outcome, figure: Figure, by: str, drawn: list[Any], kinds: tuple[str, str], black: list[str]) -> None:
    from matplotlib.lines import Line2D

    from experiments.harness.plotting import INK, MARKERS, PALETTE

    points, lines = ([one for one in kind.split() if one in o] for kind in kinds)
    handles = []
    if by:
        named = o.labels(by) if by in o.data.coords else {n: f"{by} {n + 1}" for n in range(o.data.sizes.get(by, 0))}
        for one, colour, marker in zip(drawn, PALETTE, MARKERS, strict=False):
            label = named.get(one, one)
            handles.append(Line2D([], [], color=colour, marker=marker, markerfacecolor="white", label=label))
    for one, colour, marker in zip(points, PALETTE, MARKERS, strict=False):
        style: dict[str, Any] = {"marker": marker, "markerfacecolor": "white", "linestyle": ""}
        handles.append(Line2D([], [], color=colour, label=o.quantity(one).label, **style))
    for one, colour in zip(lines, PALETTE, strict=False):
        handles.append(Line2D([], [], color=colour, linewidth=1.1, label=o.quantity(one).label))
    handles += [Line2D([], [], color=INK, linewidth=1.0, label=o.quantity(name).label) for name in black]
    if handles:
        long = max(len(str(one.get_label())) for one in handles) > 14
        most = 2 if long and figure.get_figwidth() < 5.0 else 4  # half a page holds two long names
        figure.legend(handles=handles, loc="outside lower center", ncols=min(most, len(handles)))
