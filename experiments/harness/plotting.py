"""House style of the figures, and colours of light; matplotlib's object interface only, no pyplot, no global state.

Use it as ``with house_style(): figure, axes = new_figure(); axes.plot(...)``; reports are written inside `house_style`.
"""

from __future__ import annotations

import io
import logging
import math
import re
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from functools import lru_cache
from pathlib import Path
from typing import Any, Literal

import numpy as np

logging.getLogger("matplotlib").setLevel(logging.ERROR)  # it warns of a home folder that cannot hold its cache

from matplotlib import rc_context, style  # noqa: E402
from matplotlib.backends.backend_agg import FigureCanvasAgg  # noqa: E402
from matplotlib.backends.backend_svg import FigureCanvasSVG  # noqa: E402
from matplotlib.figure import Figure  # noqa: E402
from matplotlib.ticker import ScalarFormatter  # noqa: E402

from experiments.harness.range import logarithmic  # noqa: E402
from optics.errors import DomainError  # noqa: E402

# Okabe & Ito (2008), "Color Universal Design": distinguishable with every common colour-vision deficiency
PALETTE = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#000000")
MARKERS = ("o", "s", "^", "D", "v", "P", "X")
INK = "#22262b"

WIDTH_IN = {"full": 7.6, "half": 3.7}
_NARROW_IN = 4.4


@contextmanager
def house_style() -> Iterator[None]:
    """The house style; matplotlib's settings are restored afterwards."""
    with style.context(Path(__file__).with_name("house.mplstyle")):
        yield


def new_figure(
    rows: int = 1,
    columns: int = 1,
    *,
    width: Literal["full", "half"] = "full",
    aspect_ratio: float = 0.45,
    **subplots: Any,
) -> tuple[Figure, Any]:
    """Empty figure of a width that fits the report; call inside `house_style`."""
    inches = WIDTH_IN[width]
    figure = Figure(figsize=(inches, inches * aspect_ratio), layout="constrained")
    axes = figure.subplots(rows, columns, **subplots)
    if columns == 2:  # on narrow screens the right one stands below the left one
        for axis in np.reshape(axes, (rows, columns))[:, 1]:
            axis.tick_params(labelleft=True)
    for panel in figure.axes:
        for axis in (panel.xaxis, panel.yaxis):
            if isinstance(axis.get_major_formatter(), ScalarFormatter):
                axis.set_major_formatter(_PlainFormatter())
    return figure, axes


class _PlainFormatter(ScalarFormatter):
    """Numbers as plain text, set ten times as fast as mathematics; only the power of ten of an axis is mathematics."""

    def __init__(self) -> None:
        super().__init__(useMathText=False)

    def get_offset(self) -> str:
        return re.sub(r"1e(\N{MINUS SIGN}?\d+)", r"$\\times\\mathdefault{10^{\1}}$", super().get_offset())


def spaced_axis(axes: Any, which: Literal["x", "y"], values: Sequence[float]) -> None:
    """Make an axis logarithmic if its ``values`` are spaced so; call after the limits are set."""
    if not logarithmic(values):
        return
    (axes.set_xscale if which == "x" else axes.set_yscale)("log")
    low, high = min(values), max(values)
    ends = range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)
    log_ticks(axes, which, (10.0**end for end in ends) if high > 100.0 * low else None)


def log_ticks(axes: Any, which: Literal["x", "y"], ticks: Iterable[float] | None = None) -> None:
    """Ticks of a logarithmic axis as plain numbers, none between them; call after the limits are set."""
    axis = axes.xaxis if which == "x" else axes.yaxis
    low, high = sorted(axes.get_xlim() if which == "x" else axes.get_ylim())
    if not low > 0:  # nothing was drawn
        low, high = 1.0, 100.0
        (axes.set_xlim if which == "x" else axes.set_ylim)(low, high)
    if ticks is None:
        decades = range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)
        digits = (1, 2, 5) if high / low < 1e4 else (1,)
        ticks = (float(f"{digit}e{decade}") for decade in decades for digit in digits)
    ticks = [tick for tick in ticks if low <= tick <= high]
    axis.set_ticks(ticks, [f"{tick:g}" for tick in ticks])
    axis.set_ticks([], minor=True)


def figure_svg(figure: Figure, *, prefix: str = "f") -> str:
    """The figure as one ``<svg>`` element to stand inside an HTML page; the same figure gives the same bytes."""
    buffer = io.StringIO()
    with rc_context({"svg.hashsalt": "starbench", "svg.fonttype": "path"}):
        FigureCanvasSVG(figure).print_svg(buffer, metadata={"Date": None, "Creator": None})
    text = buffer.getvalue()
    text = text[text.index("<svg") :].strip()
    text = re.sub(r"<metadata>.*?</metadata>", "", text, flags=re.DOTALL)
    text = re.sub(r'\bid="', f'id="{prefix}-', text)
    return re.sub(r"(href=\"|url\()#", rf"\g<1>#{prefix}-", text)


def side_by_side(figure: Figure) -> list[tuple[float, float]]:
    """Left and right ends (fractions of the width) of the parts of a figure that need not stand in a row.

    Empty unless there are two to four, each with its own scale.
    """
    if len(figure.axes) < 2:
        return []
    renderer = FigureCanvasAgg(figure).get_renderer()
    to_figure = figure.transFigure.inverted()
    parts: list[list[Any]] = []  # left end, right end, axes
    for axis in sorted(figure.axes, key=lambda axes: axes.get_position().x0):
        box = axis.get_tightbbox(renderer)
        if box is None:
            continue
        left, right = box.transformed(to_figure).intervalx
        if parts and (left < parts[-1][1] or axis.get_label() == "<colorbar>"):
            parts[-1] = [parts[-1][0], max(right, parts[-1][1]), [*parts[-1][2], axis]]
        else:
            parts.append([left, right, [axis]])
    if not 2 <= len(parts) <= 4 or figure.legends or figure.texts:
        return []
    panels = [axis for part in parts[1:] for axis in part[2] if axis.get_label() != "<colorbar>"]
    scaled = [axis for axis in panels if axis.axison and len(axis.get_yticks())]
    if any(not axis.yaxis.get_tick_params().get("labelleft", True) for axis in scaled):
        return []
    return [(max(left - 0.005, 0.0), min(right + 0.005, 1.0)) for left, right, _ in parts]


def narrow(figure: Figure) -> bool:
    """Make a figure of one plot as wide as a telephone shows it in a legible size, after its wide version is drawn."""
    plots = [axis for axis in figure.axes if axis.get_label() != "<colorbar>"]
    width, height = figure.get_size_inches()
    if len(plots) != 1 or not plots[0].axison or plots[0].get_aspect() != "auto" or width <= _NARROW_IN:
        return False
    figure.set_size_inches(_NARROW_IN, max(0.85 * height, 0.6 * _NARROW_IN))
    legend, spare_px = plots[0].get_legend(), 0.85 * figure.bbox.width  # the axes stand right of the middle
    renderer = FigureCanvasAgg(figure).get_renderer()
    columns = 0 if legend is None else len(legend.get_texts())
    while legend is not None and legend.get_window_extent(renderer).width > spare_px and columns > 1:
        columns = (columns + 1) // 2
        words = [text.get_text() for text in legend.get_texts()]
        handles = [handle for handle in legend.legend_handles if handle is not None]
        below = {"loc": "upper center", "bbox_to_anchor": (0.5, -0.22), "ncols": columns}
        legend = plots[0].legend(handles, words, title=legend.get_title().get_text(), **below)
        figure.set_figheight(max(0.85 * height, 0.6 * _NARROW_IN) + 0.17 * math.ceil(len(words) / columns))
    _thin_out(figure, plots[0])
    return True


def _thin_out(figure: Figure, axes: Any) -> None:
    """Hide labels of the x axis that overlap the one before."""
    FigureCanvasAgg(figure).draw()
    end = -math.inf
    for label in sorted(axes.get_xticklabels(), key=lambda label: label.get_window_extent().x0):
        box = label.get_window_extent()
        if label.get_text() and box.x0 < end:
            label.set_visible(False)
        elif label.get_text():
            end = box.x1 + 3.0


def figure_png(figure: Figure, *, dpi: float = 200.0) -> bytes:
    """The figure as a PNG file [bytes], for drawings with very many marks."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=dpi, metadata={"Software": None})
    return buffer.getvalue()


def equation_svg(latex: str, *, prefix: str = "e") -> str:
    """An equation in matplotlib's subset of LaTeX (without the dollar signs) as an ``<svg>`` element."""
    from matplotlib.font_manager import FontProperties
    from matplotlib.mathtext import MathTextParser

    with rc_context({"mathtext.fontset": "stix", "text.color": INK}):
        font = FontProperties(size=13.5)
        try:
            parsed = MathTextParser("path").parse(f"${latex}$", dpi=72, prop=font)
        except ValueError as error:
            raise DomainError(f"equation {latex!r} cannot be set: {str(error).splitlines()[-1]}") from None
        figure = Figure(figsize=((parsed.width + 4) / 72, (parsed.height + parsed.depth + 6) / 72))
        figure.patch.set_alpha(0)
        figure.text(2 / 72 / figure.get_figwidth(), 0.5, f"${latex}$", fontproperties=font, va="center", color=INK)
        return figure_svg(figure, prefix=prefix)


@lru_cache(maxsize=1)
def _cie() -> tuple[np.ndarray, np.ndarray]:
    """CIE 1931 2 degree colour-matching functions: wavelength (n,) [nm], xyz (n, 3); from colour-science."""
    import colour

    functions = colour.MSDS_CMFS["CIE 1931 2 Degree Standard Observer"]
    return np.asarray(functions.wavelengths, dtype=float), np.asarray(functions.values, dtype=float)


def wavelength_colour(wavelength_nm: float, *, lightness: float = 55.0) -> str:
    """Colour of light on a screen: its hue, with a legible lightness."""
    if not (np.isfinite(wavelength_nm) and wavelength_nm > 0):
        raise DomainError(f"wavelength_nm = {wavelength_nm} nm; it must be positive")
    import colour

    wavelengths, xyz = _cie()
    band = np.abs(wavelengths - float(np.clip(wavelength_nm, 420.0, 690.0))) <= 10.0
    tristimulus = xyz[band].mean(axis=0)
    white = colour.CCS_ILLUMINANTS["CIE 1931 2 Degree Standard Observer"]["D65"]
    _, a, b = colour.XYZ_to_Lab(tristimulus / tristimulus[1] * 0.3, white)
    lab = np.array([lightness, a, b]) * np.linspace([1.0, 1.0, 1.0], [1.0, 0.0, 0.0], 201)
    rgb = colour.XYZ_to_sRGB(colour.Lab_to_XYZ(lab, white), white)
    in_gamut = ((rgb >= -1e-6) & (rgb <= 1.0 + 1e-6)).all(axis=1)
    rgb = np.clip(rgb[in_gamut.argmax() if in_gamut.any() else -1], 0.0, 1.0)  # the most saturated colour in gamut
    return "#" + "".join(f"{round(255 * float(channel)):02x}" for channel in rgb)


def band_colours(centres_nm: Sequence[float]) -> tuple[str, ...]:
    """One colour per band, its own hue, darker towards the red: distinguishable in grey and with colour blindness."""
    order = np.argsort(np.argsort(centres_nm))
    steps = max(len(centres_nm) - 1, 1)
    return tuple(
        wavelength_colour(centre, lightness=66.0 - 30.0 * rank / steps)
        for centre, rank in zip(centres_nm, order, strict=True)
    )
