"""Contact sheet: small pictures of frames, side by side, for a first look."""

from __future__ import annotations

import io
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from experiments.dataset.truth.frame_record import FrameRecord

if TYPE_CHECKING:
    from render.records import Frame

__all__ = ["chosen", "contact_sheet", "preview", "stretched"]

ROWS, COLUMNS = 4, 6
TILE_PX = 300
"""Longer side of a picture."""
PREVIEW_DARKEST_SIGMA = 3.0
SOFT_SIGMA, BRIGHTEST_SIGMA = 3.0, 150.0
TITLE_IN = 0.15
GLOW_PX = 0.9
"""Stars of a single pixel are hard to see: small pictures are blurred by this much, and scaled to keep the peaks."""


def stretched(image: NDArray[np.float32], darkest_sigma: float = -2.0) -> NDArray[np.float32]:
    """Brightness 0 ... 1 of an image of digital numbers: inverse hyperbolic sine above the sky, in units of its noise.

    Black is ``darkest_sigma`` above the sky. Linear for what is as faint as the noise, logarithmic for what is bright
    (R. Lupton et al., PASP 116, 133 (2004)).
    """
    low, sky, high = np.percentile(image, (15.9, 50.0, 84.1))
    sigma = max(0.5 * (high - low), 0.5)
    above = ((image - sky) / sigma - darkest_sigma) / SOFT_SIGMA
    return np.asarray(np.clip(np.arcsinh(above) / np.arcsinh(BRIGHTEST_SIGMA / SOFT_SIGMA), 0.0, 1.0), np.float32)


def preview(frame: Frame, size_px: int = TILE_PX) -> NDArray[np.uint8]:
    """Small grey picture of a frame; of every block of pixels the brightest is kept, so that no star goes under."""
    image = stretched(frame.dn.astype(np.float32), PREVIEW_DARKEST_SIGMA)
    step = max(1, -(-max(image.shape) // size_px))
    height, width = (side - side % step for side in image.shape)
    blocks = image[:height, :width].reshape(height // step, step, width // step, step)
    brightest = blocks.max((1, 3))
    glow = gaussian_filter(brightest - np.median(brightest), GLOW_PX) * (2.0 * np.pi * GLOW_PX**2)
    return np.asarray(np.rint(255.0 * np.clip(glow, 0.0, 1.0)), np.uint8)


def chosen(records: Sequence[FrameRecord]) -> list[FrameRecord]:
    """Frames for the sheet, spread evenly over the dataset."""
    count = min(ROWS * COLUMNS, len(records))
    return [records[i] for i in np.unique(np.linspace(0, len(records) - 1, count).round().astype(int))]


def contact_sheet(folder: Path, records: Sequence[FrameRecord]) -> bytes:
    """PNG of up to 24 frames of a dataset; the same frames give the same bytes."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    from render.fits.files import read_frame

    shown = chosen(records)
    columns = min(COLUMNS, len(shown))
    rows = -(-len(shown) // columns)
    pictures = [preview(read_frame(folder / one.file)) for one in shown]
    height, width = pictures[0].shape
    tall = 2.0 * height / width
    inches = (2.0 * columns, (tall + TITLE_IN) * rows)
    figure = Figure(figsize=inches, dpi=150, facecolor="#111418")
    axes = figure.subplots(rows, columns, squeeze=False).ravel()
    figure.subplots_adjust(left=0.004, right=0.996, bottom=0.004, top=1.0 - TITLE_IN / inches[1])
    figure.subplots_adjust(wspace=0.02, hspace=TITLE_IN / tall)
    for place in axes:
        place.set_axis_off()
    for place, one, picture in zip(axes, shown, pictures, strict=False):
        place.imshow(picture, cmap="gray", vmin=0, vmax=255, interpolation="nearest")
        title = f"{one.frame}   {one.ra_deg:.1f}° {one.dec_deg:+.1f}°   {one.stars} stars"
        place.set_title(title, color="#d7dbe0", fontsize=6.5, pad=2.0)
    buffer = io.BytesIO()
    FigureCanvasAgg(figure).print_png(buffer, metadata={"Software": None})
    return buffer.getvalue()
