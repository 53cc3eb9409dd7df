"""A turntable of two or three axes as a device: setting and readings with their errors.

Its axes and the convention of its angles are those of `calib.calibration.table_axes`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from calib.calibration.table_axes import TableAxes, axis_directions
from optics.arrays import FloatArray
from optics.errors import DomainError
from optics.records import freeze
from optics.units import ARCSEC_RAD, DEG_RAD
from render.engine.random import Streams


@dataclass(frozen=True, slots=True, kw_only=True)
class Turntable(TableAxes):
    """A table of k = 2 or 3 axes, outermost first; `build_turntable` makes one. Each reading has its own noise."""

    # (k,) Standard deviation of the true angle about the commanded one, each setting anew; it is no error of the
    # reading
    setting_noise_arcsec: FloatArray
    step_arcsec: FloatArray  # (k,) The table goes to whole multiples of this; 0: anywhere
    encoder_amplitude_arcsec: FloatArray  # (k,) Amplitude of a sinusoidal error of the reading over the angle
    encoder_cycles: FloatArray  # (k,) Its cycles per turn
    encoder_phase_deg: FloatArray  # (k,) Its phase at angle 0

    def __post_init__(self) -> None:
        TableAxes.__post_init__(self)
        for name in (
            "setting_noise_arcsec",
            "step_arcsec",
            "encoder_amplitude_arcsec",
            "encoder_cycles",
            "encoder_phase_deg",
        ):
            freeze(self, name, shape=(len(self.axis),))
        for name in ("setting_noise_arcsec", "step_arcsec"):
            value = getattr(self, name)
            if value.min() < 0:
                raise DomainError(f"Turntable.{name} = {value.tolist()} arcsec; it must not be negative")

    def set(self, commanded_rad: ArrayLike, streams: Streams, *, call: int = 0) -> FloatArray:
        """Go to angles."""
        angle = self._angles(commanded_rad)
        step = self.step_arcsec * ARCSEC_RAD
        reached = np.where(step > 0, np.rint(angle / np.where(step > 0, step, 1.0)) * step, angle)
        return np.asarray(reached + self._noise(len(angle), self.setting_noise_arcsec, streams, "setting", call))

    def read(self, true_rad: ArrayLike, streams: Streams, *, call: int = 0) -> FloatArray:
        """Read the encoders."""
        angle = self._angles(true_rad)
        wave = np.sin(self.encoder_cycles * angle + self.encoder_phase_deg * DEG_RAD)
        systematic = self.encoder_amplitude_arcsec * ARCSEC_RAD * wave
        return np.asarray(
            angle + systematic + self._noise(len(angle), self.reading_noise_arcsec, streams, "reading", call)
        )

    def _noise(self, count: int, sigma_arcsec: FloatArray, streams: Streams, name: str, call: int) -> FloatArray:
        columns = [
            sigma * ARCSEC_RAD * streams.child("turntable", name).generator(axis, call).standard_normal(count)
            for axis, sigma in zip(self.axis_names, sigma_arcsec, strict=True)
        ]
        return np.column_stack(columns)


def build_turntable(
    axes: str | ArrayLike,
    *,
    non_orthogonality_arcsec: float | Sequence[float] = 0.0,
    reading_noise_arcsec: float | Sequence[float] = 0.0,
    setting_noise_arcsec: float | Sequence[float] = 0.0,
    step_arcsec: float | Sequence[float] = 0.0,
    encoder_amplitude_arcsec: float | Sequence[float] = 0.0,
    encoder_cycles: float | Sequence[float] = 1.0,
    encoder_phase_deg: float | Sequence[float] = 0.0,
) -> Turntable:
    """A table from letters; one value stands for all axes.

    Examples
    --------
    >>> table = build_turntable("xy", reading_noise_arcsec=(0.3, 0.4))
    >>> table.rotation([[0.5, 0.0]]).apply([0.0, 1.0, 0.0]).round(6).tolist()
    [[0.0, 0.877583, 0.479426]]
    """
    axis = axis_directions(axes) if isinstance(axes, str) else np.asarray(axes, dtype=np.float64)
    count = len(axis)

    def spread(values: float | Sequence[float], size: int = count) -> FloatArray:
        array = np.asarray(values, dtype=np.float64)
        return np.full(size, float(array)) if array.ndim == 0 else array

    return Turntable(
        axis=axis,
        non_orthogonality_arcsec=spread(non_orthogonality_arcsec, max(count - 1, 1)),
        reading_noise_arcsec=spread(reading_noise_arcsec),
        setting_noise_arcsec=spread(setting_noise_arcsec),
        step_arcsec=spread(step_arcsec),
        encoder_amplitude_arcsec=spread(encoder_amplitude_arcsec),
        encoder_cycles=spread(encoder_cycles),
        encoder_phase_deg=spread(encoder_phase_deg),
    )
