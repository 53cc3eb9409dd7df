"""What to change first: every key of the sensor moved down and up, the others as they are, by prediction."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from experiments.camera.prediction import predict_camera
from experiments.camera.records import CameraPrediction
from experiments.camera.settings import Config
from experiments.harness.range import value_at, with_value
from optics.errors import StarbenchError

__all__ = ["JUDGED", "Swing", "predict_tornado", "tornado_size"]


JUDGED = ("attitude_cross_arcsec", "single_star_arcsec", "limiting_magnitude_mag", "stars_worst_per_frame")
"""Scalars whose change is looked at; swings are sorted by the first."""
ATTITUDES = 150
"""Differences of the same attitudes are known from fewer of them."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Swing:
    """What one key does."""

    key: str  # Of the key
    label: str  # Of the key
    unit: str  # Of the key
    low: float  # Its values
    value: float  # Its values
    high: float  # Its values
    # Of `JUDGED`, relative to the sensor as it is (limiting magnitudes: the difference); empty where refused
    at_low: dict[str, float]
    # Of `JUDGED`, relative to the sensor as it is (limiting magnitudes: the difference); empty where refused
    at_high: dict[str, float]

    def size(self, name: str) -> float:
        """Largest change that is known."""
        known = (abs(end[name]) for end in (self.at_low, self.at_high) if end and math.isfinite(end[name]))
        return max(known, default=0.0)


def _parameters(config: Config, base: CameraPrediction) -> Sequence[tuple[str, str, str, float, float, float]]:
    """Key, label, unit, low, value, high."""
    change, chip = config.tornado, base.processing.detector
    share, depth_mm = change.change_fraction, base.value("depth_of_focus_um") * 1e-3
    relative = (
        ("instrument.exposure_s", "exposure", "s", None),
        ("instrument.f_number", "F-number", "", base.value("f_number")),
        ("detector.read_noise_e", "read noise", "e⁻", chip.read_noise_e),
        ("detector.dark_current_e_per_s", "dark current", "e⁻/s", chip.dark_current_e_per_s),
        ("detector.prnu", "PRNU", "", chip.prnu),
        ("throughput_fraction", "throughput (QE, coatings)", "", None),
        ("background_e_per_s", "straylight", "e⁻/s", None),
        ("threshold_sigma", "detection limit", "σ", base.value("threshold_sigma")),
    )
    rows = []
    for key, label, unit, own in relative:
        value = float(value_at(config, key) if own is None else own)
        low, high = value * (1.0 - share), value * (1.0 + share)
        if key == "instrument.f_number":
            low = value  # a stop can be closed, not opened beyond what the lens has
        if key == "throughput_fraction":
            high = min(high, 1.0)
        rows.append((key, label, unit, low, value, high))
    defocus, chip_c = config.instrument.defocus_mm, config.instrument.chip_temperature_c
    rows.append(("instrument.defocus_mm", "defocus", "mm", defocus - depth_mm, defocus, defocus + depth_mm))
    rows.append(
        (
            "instrument.chip_temperature_c",
            "chip temperature",
            "°C",
            chip_c - change.chip_k,
            chip_c,
            chip_c + change.chip_k,
        )
    )
    return [row for row in rows if row[3] < row[5] and row[0] in change.parameters]


def tornado_size(config: Config, base: CameraPrediction) -> int:
    """How many settings `predict_tornado` predicts."""
    return 1 + sum((low != value) + (high != value) for *_, low, value, high in _parameters(config, base))


def predict_tornado(
    config: Config, base: CameraPrediction, *, advance: Callable[[], None] = lambda: None
) -> tuple[Swing, ...]:
    """Swings, the largest first."""
    fewer = config.model_copy(
        update={"sky": config.sky.model_copy(update={"attitudes": min(ATTITUDES, config.sky.attitudes)})}
    )
    middle = predict_camera(fewer)
    advance()
    swings = []
    for key, label, unit, low, value, high in _parameters(config, base):
        ends: list[dict[str, float]] = []
        for at in (low, high):
            if at == value:
                ends.append(dict.fromkeys(JUDGED, 0.0))
                continue
            try:
                found = predict_camera(with_value(fewer, key, at))
                ends.append({name: _change(name, found.value(name), middle.value(name)) for name in JUDGED})
            except (StarbenchError, ValueError):
                ends.append({})
            advance()
        swings.append(
            Swing(key=key, label=label, unit=unit, low=low, value=value, high=high, at_low=ends[0], at_high=ends[1])
        )
    return tuple(sorted(swings, key=lambda swing: -swing.size(JUDGED[0])))


def _change(name: str, value: float, base: float) -> float:
    """NaN where there is nothing to change: no star in the worst part of the sky, attitudes that nobody knows."""
    if name.endswith("_mag"):
        return value - base
    return value / base - 1.0 if math.isfinite(base) and base else math.nan
