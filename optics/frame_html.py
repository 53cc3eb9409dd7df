"""A frame as one self-contained HTML page: zoomable pixels with marks for stars, identifications and residuals.

The page contains the pixel values, not a picture of them: integers of one to four bytes in deflated byte planes, which
a browser restores exactly (a canvas would return 8 bits of a 16-bit PNG). Integers are stored unchanged; other values
are rounded to a 64th of the background noise, which the page states.
"""

from __future__ import annotations

import base64
import html
import io
import json
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from importlib.resources import files
from pathlib import Path
from statistics import NormalDist
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from optics.arrays import FloatArray
from optics.errors import ConfigError, DomainError
from optics.records import freeze_alike
from optics.textfile import write_text

SHAPES = ("circle", "square", "cross", "arrow")
FLAG_COLOURS = ("#ff4d6d", "#c77dff", "#4895ef")
STEPS_PER_SIGMA = 64
PREVIEW_PX = 700
SHOWN_PX = 900
"""About as wide as a page shows a whole frame."""
WHITE_SIGMA = 40.0
"""White above the median, in units of the noise, unless more than 0.03 % of the pixels are brighter."""
LARGEST_PX = 1 << 27


@dataclass(frozen=True, slots=True, kw_only=True)
class Marks:
    """A layer of marks over a frame.

    Attributes
    ----------
    name : str
        Name on the page.
    x_px, y_px : (n,)
        Column and row, integers are pixel centres; marks that are not finite are left out.
    shape : {"circle", "square", "cross", "arrow"}
        Arrows start at (x, y) and have the components `dx_px`, `dy_px`, drawn enlarged.
    colour : str
        ``#rrggbb``.
    label : sequence of str, optional
        Text next to each mark.
    columns : mapping of str to sequence
        Further values of each mark: ``"flux [e-]"`` -> n numbers or texts.
    dx_px, dy_px : (n,), optional
        Components of arrows.
    shown : bool
        Whether the page starts with it.
    """

    name: str
    x_px: FloatArray
    y_px: FloatArray
    shape: str = "circle"
    colour: str = "#f4d35e"
    label: Sequence[str] = ()
    columns: Mapping[str, Any] = field(default_factory=dict)
    dx_px: FloatArray = field(default_factory=lambda: np.empty(0))
    dy_px: FloatArray = field(default_factory=lambda: np.empty(0))
    shown: bool = True

    def __post_init__(self) -> None:
        if self.shape not in SHAPES:
            raise ConfigError(f"Marks.shape = {self.shape!r}; choose one of {', '.join(SHAPES)}")
        names = ("x_px", "y_px", *(("dx_px", "dy_px") if self.shape == "arrow" else ()))
        freeze_alike(self, *names, shape=("n",), finite=False)
        texts = {"label": self.label} if len(self.label) else {}
        for name, values in {**self.columns, **texts}.items():
            if len(values) != len(self.x_px):
                raise DomainError(f"Marks {self.name!r}: {name} has {len(values)} values for {len(self.x_px)} marks")

    def _content(self) -> dict[str, Any]:
        positions = [self.x_px, self.y_px, *((self.dx_px, self.dy_px) if self.shape == "arrow" else ())]
        rows = np.flatnonzero(np.isfinite(positions).all(axis=0))
        columns = [
            {
                "name": name.partition(" [")[0],
                "unit": name.partition(" [")[2].rstrip("]"),
                "values": [_plain(values[row]) for row in rows],
            }
            for name, values in self.columns.items()
        ]
        arrows = {"dx": _rounded(self.dx_px[rows]), "dy": _rounded(self.dy_px[rows])} if len(self.dx_px) else {}
        return {
            "name": self.name,
            "shape": self.shape,
            "colour": self.colour,
            "shown": self.shown,
            "x": _rounded(self.x_px[rows]),
            "y": _rounded(self.y_px[rows]),
            "label": [str(self.label[int(row)]) for row in rows] if len(self.label) else [],
            "columns": columns,
            **arrows,
        }


def _positions_px(*layers: Marks) -> FloatArray:
    """Finite positions (n, 2) of all marks."""
    positions = [np.column_stack([layer.x_px, layer.y_px]) for layer in layers]
    joined = np.concatenate([np.empty((0, 2)), *positions])
    return joined[np.isfinite(joined).all(axis=1)]


def differences(measured: Sequence[Marks], reference: Marks, *, within_px: float = 2.0) -> Marks:
    """Arrows from positions of a reference to the nearest measured position within a radius."""
    from scipy.spatial import cKDTree

    measured_px = _positions_px(*measured)
    reference_px = _positions_px(reference)
    distance_px, nearest = np.empty(0), np.empty(0, np.int64)
    if len(reference_px):
        distance_px, nearest = cKDTree(reference_px).query(measured_px, distance_upper_bound=within_px)
    matched = np.flatnonzero(np.isfinite(distance_px))
    start = reference_px[nearest[matched]]
    offset = measured_px[matched] - start
    return Marks(
        name=f"errors against {reference.name}",
        shape="arrow",
        colour="#ff9e00",
        x_px=start[:, 0],
        y_px=start[:, 1],
        dx_px=offset[:, 0],
        dy_px=offset[:, 1],
    )


def frame_page(
    values: ArrayLike,
    layers: Sequence[Marks] = (),
    *,
    title: str = "Frame",
    facts: Mapping[str, str] | None = None,
    flags: Mapping[str, ArrayLike] | None = None,
    sky: ArrayLike | None = None,
    unit: str = "DN",
    noise: float | None = None,
) -> str:
    """A frame as self-contained, zoomable HTML page.

    Parameters
    ----------
    values : (h, w)
        Pixels; NaN where there is no value.
    layers : sequence of Marks
        Drawn in this order; the page lists the marks of each but arrows, in the order given.
    title : str
        Heading of the page.
    facts : mapping of str to str, optional
        Facts listed below the heading.
    flags : mapping of str to (h, w) bool, optional
        Pixels to tint, e.g. ``{"saturated": ...}``; at most three kinds.
    sky : (rows, columns, 3), optional
        Unit vectors along icrs at even steps from the first to the last edge of the frame; the page interpolates the
        direction under the cursor.
    unit : str
        Of the values.
    noise : float, optional
        Standard deviation of the background, which sets the rounding of values that are not integers; measured if
        left out.

    Returns
    -------
    str
        The page.

    Raises
    ------
    DomainError
        Not a two-dimensional image with a finite number in it, more than 2^27 pixels, or flags or sky of wrong shape.
    """
    image = np.asarray(values)
    if image.ndim != 2 or not 0 < image.size <= LARGEST_PX or not np.isfinite(image).any():
        raise DomainError(f"frame of shape {image.shape}; two dimensions, 1 to {LARGEST_PX} pixels, finite are needed")
    finite = np.isfinite(image)
    flagged = {name: np.asarray(mask, bool) for name, mask in (flags or {}).items()}
    if not finite.all():
        flagged["no value"] = ~finite
        image = np.where(finite, image, np.median(image[finite]))
    if len(flagged) > len(FLAG_COLOURS) or any(mask.shape != image.shape for mask in flagged.values()):
        raise DomainError(f"flags: at most {len(FLAG_COLOURS)} kinds, each of the shape {image.shape} of the frame")
    pixels, about = _packed(image, noise)
    shown = [(name, mask) for name, mask in flagged.items() if mask.any()]
    bits = sum((mask.astype(np.uint8) << at for at, (_, mask) in enumerate(shown)), np.zeros(image.shape, np.uint8))
    content = {
        **about,
        "height": image.shape[0],
        "width": image.shape[1],
        "unit": unit,
        **_shades(image),
        "times": _enlargement(layers, image.shape[1]),
        "sky": None if sky is None else _grid(sky),
        "layers": [layer._content() for layer in layers],
        "flags": [
            {"name": name, "bit": 1 << at, "count": int(mask.sum()), "colour": FLAG_COLOURS[at]}
            for at, (name, mask) in enumerate(shown)
        ],
    }
    shown_facts = {"size": f"{image.shape[1]} × {image.shape[0]} px", **(facts or {})}
    if about["step"] != 1:
        shown_facts["rounded to"] = f"{about['step']:g} {unit}"
    counts = [f"{len(layer.x_px)} {layer.name}" for layer in layers if layer.shape != "arrow"]
    alt = f"{title}: {', '.join([f'image of {image.shape[1]} by {image.shape[0]} pixels', *counts])}"
    return _filled(
        title=html.escape(title),
        alt=html.escape(alt),
        wide=str(image.shape[1]),
        high=str(image.shape[0]),
        facts=html.escape(" · ".join(f"{name} {text}" for name, text in shown_facts.items())),
        preview=_preview(image),
        pixels=pixels,
        flags=_deflated(bits.tobytes()) if shown else "",
        meta=json.dumps(content, allow_nan=False, separators=(",", ":")).replace("<", "\\u003c"),
    )


def save_frame_page(path: str | Path, values: ArrayLike, layers: Sequence[Marks] = (), **settings: Any) -> Path:
    """Write the page of `frame_page`; the file appears complete or not at all.

    Parameters
    ----------
    path : path
        File to write.
    values : (h, w)
        Pixels.
    layers : sequence of Marks
        Drawn in this order.
    **settings
        As in `frame_page`.

    Returns
    -------
    pathlib.Path
        The file.

    Raises
    ------
    ConfigError
        It cannot be written.
    DomainError
        As `frame_page`.
    """
    return write_text(path, frame_page(values, layers, **settings))


def _enlargement(layers: Sequence[Marks], width_px: int) -> float:
    """Enlargement of arrows: a typical arrow is as long as a hundredth of the frame."""
    lengths = np.concatenate([np.hypot(layer.dx_px, layer.dy_px) for layer in layers] or [np.empty(0)])
    lengths = lengths[np.isfinite(lengths) & (lengths > 0)]
    return float(np.clip(0.01 * width_px / np.median(lengths), 1.0, 1e4)) if len(lengths) else 100.0


def _packed(image: NDArray[Any], noise: float | None) -> tuple[str, dict[str, Any]]:
    """Pixels as base64 text, and zero, step and number of byte planes by which they become values.

    Zero is a multiple of 256 below the point 128 under the median: the noise of the background then seldom carries
    into the second byte, whose plane compresses to almost nothing.
    """
    step = 1.0
    if image.dtype.kind == "f" and not np.array_equal(image, np.rint(image)):
        sigma = noise or 1.4826 * float(np.median(np.abs(image - np.median(image))))
        span = float(image.max()) - float(image.min())
        step = 2.0 ** np.floor(np.log2(max(sigma / STEPS_PER_SIGMA, span / 2**31)))
    number = np.rint(image / step).astype(np.int64)
    low, middle = int(number.min()), int(np.median(number)) - 128
    zero = middle - 256 * -((low - middle) // 256)
    number -= zero
    planes = max(1, (int(number.max()).bit_length() + 7) // 8)
    data = b"".join((number >> 8 * plane).astype(np.uint8).tobytes() for plane in range(planes))
    if step == 1.0:
        return _deflated(data), {"zero": zero, "step": 1, "planes": planes}
    return _deflated(data), {"zero": zero * step, "step": step, "planes": planes}


def _shades(image: NDArray[Any]) -> dict[str, float]:
    """Quantiles of the pixels at which black ends and white begins: noise is dark, and faint stars stand out of it.

    A frame scaled down shows the brightest of several pixels, which for noise alone lies above the median.
    """
    middle = float(np.median(image))
    sigma = 1.4826 * float(np.median(np.abs(image - middle)))
    pooled = max(1, max(image.shape) // SHOWN_PX) ** 2
    noise = 0.5 + NormalDist().inv_cdf(pooled / (pooled + 1.0))
    black = float((image < middle + noise * sigma).mean())
    white = float((image < middle + WHITE_SIGMA * sigma).mean())
    return {"black": min(max(black, 0.5), 0.995), "white": min(max(white, 0.9997), 1.0 - 1e-6)}


def _deflated(data: bytes) -> str:
    return base64.b64encode(zlib.compress(data, 6)).decode("ascii")


def _preview(image: NDArray[Any]) -> str:
    """A small picture for browsers without JavaScript, and until the pixels are there."""
    from matplotlib.image import imsave

    block = max(1, -(-max(image.shape) // PREVIEW_PX))
    height, width = (side // block * block for side in image.shape)
    coarse = image[:height, :width].astype(np.float64).reshape(height // block, block, width // block, block)
    coarse = coarse.max((1, 3)) if coarse.size else image.astype(np.float64)
    shades = _shades(coarse)
    low, high = np.quantile(coarse, (shades["black"], shades["white"]))
    shown = np.arcsinh(20.0 * np.clip((coarse - low) / max(high - low, 1e-12), 0.0, 1.0))
    png = io.BytesIO()
    imsave(png, shown, cmap="gray", format="png")
    return "data:image/png;base64," + base64.b64encode(png.getvalue()).decode("ascii")


def _grid(sky: ArrayLike) -> dict[str, Any]:
    vectors = np.asarray(sky, np.float64)
    if vectors.ndim != 3 or vectors.shape[2] != 3 or min(vectors.shape[:2]) < 2 or not np.isfinite(vectors).all():
        raise DomainError(f"sky of shape {vectors.shape}; (rows, columns, 3) of at least two each, finite, are needed")
    rows, columns, _ = vectors.shape
    return {"rows": rows, "columns": columns, "vectors": _rounded(vectors.ravel(), 9)}


def _rounded(values: FloatArray, digits: int = 4) -> list[float]:
    return [round(float(value), digits) for value in values]


def _plain(value: Any) -> Any:
    """A JSON value: numbers that are not finite become null."""
    value = value.item() if isinstance(value, np.generic) else value
    if isinstance(value, float):
        return float(f"{value:.8g}") if np.isfinite(value) else None
    return value if isinstance(value, (int, bool)) and abs(value) < 2**53 else str(value)


def _filled(**texts: str) -> str:
    """The template with its parts filled in; each part is inserted once, so that none can name another."""
    folder = files("optics").joinpath("data", "frame_page")
    texts |= {name: folder.joinpath(file).read_text(encoding="utf-8").rstrip() for name, file in _PARTS.items()}
    pieces = folder.joinpath("page.html").read_text(encoding="utf-8").split("@")
    return "".join(texts.get(piece, piece) if at % 2 else piece for at, piece in enumerate(pieces))


_PARTS = {"style": "page.css", "script": "page.js"}
