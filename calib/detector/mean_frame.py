"""Mean and temporal variance of frames of one scene, pixel by pixel: mean darks, flats and their noise."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from optics.arrays import FloatArray
from optics.errors import DomainError
from optics.records import freeze, freeze_all


@dataclass(frozen=True, slots=True, kw_only=True)
class MeanFrame:
    """Mean and temporal variance of the pixels of n frames."""

    mean_dn: FloatArray  # (h, w)
    variance_dn2: FloatArray  # (h, w) From frame to frame, n - 1 degrees of freedom; NaN of a single frame
    frames: int  # n
    level_dn: FloatArray  # (n,) Mean over the pixels of every frame

    def __post_init__(self) -> None:
        sizes: dict[str, int] = {}
        freeze_all(self, mean_dn=("h", "w"), level_dn=("n",), sizes=sizes)
        freeze(self, "variance_dn2", shape=("h", "w"), finite=self.frames > 1, sizes=sizes)

    @property
    def error_dn(self) -> FloatArray:
        """Standard error of the mean (h, w)."""
        return np.asarray(np.sqrt(self.variance_dn2 / self.frames))


def mean_frame(frames: Iterable[ArrayLike]) -> MeanFrame:
    """Mean and variance of frames, in a single pass that holds one frame at a time.

    Sums are of differences from the first frame: exact for whole numbers, without cancellation in the squares.

    Parameters
    ----------
    frames : iterable of (h, w)
        Frames of equal size [DN], or an array (n, h, w).

    Returns
    -------
    MeanFrame
        Mean and temporal variance of every pixel.

    Raises
    ------
    DomainError
        No frame, or frames of unlike size.
    """
    first = total = squares = None
    level: list[float] = []
    for frame in frames:
        dn = np.asarray(frame, float)
        if first is None:
            first, total, squares = dn, np.zeros(dn.shape), np.zeros(dn.shape)
        if dn.ndim != 2 or dn.shape != first.shape:
            raise DomainError(f"frame {len(level)} has the shape {dn.shape}, the first {first.shape}; (h, w) is needed")
        total += dn - first
        squares += np.square(dn - first)
        level.append(float(dn.mean()))
    if first is None or total is None or squares is None:
        raise DomainError("no frame; at least one is needed for a mean")
    count = len(level)
    variance = (squares - total**2 / count) / (count - 1) if count > 1 else np.full(first.shape, np.nan)
    return MeanFrame(mean_dn=first + total / count, variance_dn2=variance, frames=count, level_dn=np.array(level))
