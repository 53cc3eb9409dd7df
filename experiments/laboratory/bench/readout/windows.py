"""Windows of a detector: positions, light, readout."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from optics.arrays import FloatArray
from optics.errors import DomainError
from render.detector.readout import expose, expose_windows
from render.engine.random import Streams
from render.records import ExpectedImage, Frame, WindowStack
from render.sensor_file.instrument import Instrument


@dataclass(frozen=True, slots=True)
class WindowReader:
    """Reads windows out under the conditions of an instrument."""

    instrument: Instrument  # Detector, exposure time, chip temperature
    streams: Streams  # Root of the noise

    def expose(self, light_e: ArrayLike, corner_px: NDArray[np.int64], *, frames: int, label: str) -> WindowStack:
        """Frames of windows (n, h, w) with their first pixels at ``corner_px``; ``label`` names the random streams.

        Light of the shape (f, n, h, w) differs from frame to frame.
        """
        light = np.asarray(light_e)
        if light.ndim == 3:
            return self._expose(light, corner_px, frames, 0, label)
        stacks = [self._expose(frame_e, corner_px, 1, number, label) for number, frame_e in enumerate(light)]
        dn, saturated = (np.concatenate([getattr(stack, name) for stack in stacks]) for name in ("dn", "saturated"))
        return replace(stacks[0], dn=dn, saturated=saturated)

    def _expose(
        self, light_e: FloatArray, corner_px: NDArray[np.int64], frames: int, first: int, label: str
    ) -> WindowStack:
        config = self.instrument.config
        return expose_windows(
            light_e,
            corner_px,
            self.instrument.detector,
            streams=self.streams,
            frames=frames,
            first_frame=first,
            exposure_s=config.exposure_s,
            temperature_c=config.chip_temperature_c,
            band=label,
        )

    def frame(self, image: ExpectedImage, band: str) -> Frame:
        """A frame of the whole detector."""
        celsius = self.instrument.config.chip_temperature_c
        return expose(image, self.instrument.detector, streams=self.streams, temperature_c=celsius, band=band)

    def dark(self, corner_px: NDArray[np.int64], size_px: int, *, frames: int, label: str = "dark") -> FloatArray:
        """Mean (n, h, w) [e-] of frames without light, offset included."""
        stack = self.expose(np.zeros((len(corner_px), size_px, size_px)), corner_px, frames=frames, label=label)
        return np.asarray(stack.dn.mean(0) / stack.gain_dn_per_e)


def window_corners(
    centre_px: FloatArray, size_px: int, detector_px: tuple[int, int], *, where: str, advice: str
) -> NDArray[np.int64]:
    """First pixels (n, 2) of windows around positions; refuses windows that leave the detector."""
    corner = np.rint(centre_px).astype(np.int64) - size_px // 2
    off = np.any((corner < 0) | (corner + size_px > np.array(detector_px)), axis=1)
    if off.any():
        x, y = centre_px[int(np.argmax(off))]
        raise DomainError(
            f"{where}: {int(off.sum())} of {len(off)} windows of {size_px} px leave the detector of {detector_px[0]} x "
            f"{detector_px[1]} px, e.g. the one at column {x:.0f}, row {y:.0f}; {advice}"
        )
    return corner


def cut_windows(image: NDArray[Any], corner_px: NDArray[np.int64], size_px: int) -> NDArray[Any]:
    """Windows (n, size, size, ...) of an image (h, w, ...)."""
    index = np.arange(size_px)
    return np.asarray(image[corner_px[:, 1, None, None] + index[:, None], corner_px[:, 0, None, None] + index])
