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
from optics.records import freeze
from optics.textfile import write_text

SHAPES = ("circle", "square", "cross", "arrow")
FLAG_COLOURS = ("#ff4d6d", "#c77dff", "#4895ef")
STEPS_PER_SIGMA = 64
PREVIEW_PX = 700
SHOWN_PX = 900
"""About as wide as a page shows a whole frame."""
WHITE_SIGMA = 40.0
"""Above the background, in its noise: where white begins, if so few pixels of the frame are brighter."""
LARGEST_PX = 1 << 27


@dataclass(frozen=True, slots=True, kw_only=True)
class Marks:
    """A layer of marks over a frame.

    Attributes
    ----------
    name : str
        As the page names it.
    x_px, y_px : (n,)
        Where; (column, row), integers are pixel centres. Marks that are not finite are left out.
    shape : {"circle", "square", "cross", "arrow"}
        Arrows start at their place and have the length `dx_px`, `dy_px`, drawn enlarged.
    colour : str
        ``#rrggbb``.
    label : sequence of str, optional
        Text next to each.
    columns : mapping of str to sequence
        More about each: ``"flux [e-]"`` -> n numbers or texts.
    dx_px, dy_px : (n,), optional
        Of arrows.
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
        sizes: dict[str, int] = {}
        names = ("x_px", "y_px", *(("dx_px", "dy_px") if self.shape == "arrow" else ()))
        for name in names:
            freeze(self, name, shape=("n",), finite=False, sizes=sizes)
        counts = {name: len(values) for name, values in self.columns.items()}
        for name, count in (counts | ({"label": len(self.label)} if len(self.label) else {})).items():
            if count != len(self.x_px):
                raise DomainError(f"Marks {self.name!r}: {name} has {count} values for {len(self.x_px)} marks")

    def _content(self) -> dict[str, Any]:
        x, y = self.x_px, self.y_px
        known = np.isfinite(x) & np.isfinite(y)
        if self.shape == "arrow":
            known &= np.isfinite(self.dx_px) & np.isfinite(self.dy_px)
        rows = np.flatnonzero(known)
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
            "x": _rounded(x[rows]),
            "y": _rounded(y[rows]),
            "label": [str(self.label[int(row)]) for row in rows] if len(self.label) else [],
            "columns": columns,
            **arrows,
        }


def differences(measured: Sequence[Marks], reference: Marks, *, within_px: float = 2.0) -> Marks:
    """Arrows from positions of a reference to the nearest measured position within a radius."""
    from scipy.spatial import cKDTree

    x, y = (np.concatenate([getattr(one, name) for one in measured] or [np.empty(0)]) for name in ("x_px", "y_px"))
    places = [np.column_stack([x, y]), np.column_stack([reference.x_px, reference.y_px])]
    known = [np.flatnonzero(np.isfinite(place).all(axis=1)) for place in places]
    here, there = (place[rows] for place, rows in zip(places, known, strict=True))
    far, partner = cKDTree(there).query(here, distance_upper_bound=within_px) if len(there) else (np.empty(0), [])
    found = np.flatnonzero(np.isfinite(far))
    start = there[np.asarray(partner, np.int64)[found]].reshape(-1, 2)
    offset = here[found].reshape(-1, 2) - start
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
    known = np.isfinite(image)
    flagged = {name: np.asarray(mask, bool) for name, mask in (flags or {}).items()}
    if not known.all():
        flagged["no value"] = ~known
        image = np.where(known, image, np.median(image[known]))
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
    told = {"size": f"{image.shape[1]} × {image.shape[0]} px", **(facts or {})}
    if about["step"] != 1:
        told["rounded to"] = f"{about['step']:g} {unit}"
    counts = [f"{len(layer.x_px)} {layer.name}" for layer in layers if layer.shape != "arrow"]
    alt = f"{title}: {', '.join([f'image of {image.shape[1]} by {image.shape[0]} pixels', *counts])}"
    return _filled(
        title=html.escape(title),
        alt=html.escape(alt),
        wide=str(image.shape[1]),
        high=str(image.shape[0]),
        facts=html.escape(" · ".join(f"{name} {text}" for name, text in told.items())),
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
    lengths = np.concatenate([np.hypot(one.dx_px, one.dy_px) for one in layers] or [np.empty(0)])
    lengths = lengths[np.isfinite(lengths) & (lengths > 0)]
    return float(np.clip(0.01 * width_px / np.median(lengths), 1.0, 1e4)) if len(lengths) else 100.0


def _packed(image: NDArray[Any], noise: float | None) -> tuple[str, dict[str, Any]]:
    """Pixels as base64 text, and how numbers become values again.

    Numbers count from a multiple of 256 below a point half a byte under the median: so the noise of the background
    seldom carries into the second byte, whose plane then takes no room.
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
    whole = step == 1.0
    return _deflated(data), {"zero": zero if whole else zero * step, "step": 1 if whole else step, "planes": planes}


def _shades(image: NDArray[Any]) -> dict[str, float]:
    """Shares of the pixels that begin as black and are not yet white: noise is dark, and faint stars stand out of it.

    Where the whole frame is shown, each place shows the brightest of some pixels; that of noise alone lies higher.
    """
    middle = float(np.median(image))
    sigma = 1.4826 * float(np.median(np.abs(image - middle)))
    together = max(1, max(image.shape) // SHOWN_PX) ** 2
    noise = 0.5 + NormalDist().inv_cdf(together / (together + 1.0))
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
    held = io.BytesIO()
    imsave(held, shown, cmap="gray", format="png")
    return "data:image/png;base64," + base64.b64encode(held.getvalue()).decode("ascii")


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
    """The template with its parts in their places; each part is put in once, so that none can name another."""
    folder = files("optics").joinpath("data", "frame_page")
    texts |= {name: folder.joinpath(file).read_text(encoding="utf-8").rstrip() for name, file in _PARTS.items()}
    pieces = folder.joinpath("page.html").read_text(encoding="utf-8").split("@")
    return "".join(texts.get(piece, piece) if at % 2 else piece for at, piece in enumerate(pieces))


_PARTS = {"style": "page.css", "script": "page.js"}
