"""Predictions of several sensors, and in what they differ."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from experiments.camera.prediction import predict_camera
from experiments.camera.records import CameraPrediction, Scalar
from experiments.camera.result import thermal_scalars
from experiments.camera.settings import Config
from experiments.camera.thermal import thermal_study
from experiments.camera.verdicts import Verdict, judge, verdict_words
from optics.errors import DomainError, StarbenchError

__all__ = ["Sensor", "SideBySide", "side_by_side"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Sensor:
    """One of the sensors."""

    name: str  # What to call it; no two have the same
    prediction: CameraPrediction  # As configured
    # Of the prediction; over temperature too where a requirement of any of the sensors needs that
    scalars: Mapping[str, Scalar]

    @property
    def verdicts(self) -> tuple[Verdict, ...]:
        """On its own requirements."""
        return judge(self.prediction.config.requirements, self.scalars)

    @property
    def answer(self) -> str:
        """What the verdicts come to."""
        return verdict_words(self.verdicts)


@dataclass(frozen=True, slots=True, kw_only=True)
class SideBySide:
    """Sensors in the order in which they were named."""

    sensors: tuple[Sensor, ...]

    @property
    def names(self) -> list[str]:
        """Of the sensors."""
        return [one.name for one in self.sensors]

    @property
    def differences(self) -> dict[str, tuple[Any, ...]]:
        """Dotted key -> its values, for keys in which the sensors differ."""
        flat = [_flat(one.prediction.config.model_dump()) for one in self.sensors]
        keys = dict.fromkeys(key for one in flat for key in one)
        rows = {key: tuple(one.get(key) for one in flat) for key in keys if key != "name"}
        return {key: values for key, values in rows.items() if any(value != values[0] for value in values)}

    def best(self, name: str, *, more: bool) -> Sensor:
        """The sensor that has most, or least, of a quantity."""
        return sorted(self.sensors, key=lambda one: one.scalars[name].value, reverse=more)[0]


def side_by_side(configs: Sequence[Config], *, advance: Callable[[], None] = lambda: None) -> SideBySide:
    """Predict all sensors, in the same attitudes of the sky (those of their seed)."""
    counts: Counter[str] = Counter()
    asked = {key for config in configs for key, value in config.requirements.model_dump().items() if value is not None}
    found = []
    for number, config in enumerate(configs, start=1):
        try:
            prediction = predict_camera(config)
        except StarbenchError as error:
            raise DomainError(f"sensor {number} ({config.name or 'without a name'}): {error}") from None
        instrument = prediction.state.instrument
        name = config.name or f"{instrument.camera.lens.name} on {instrument.detector.name}"
        counts[name] += 1
        if counts[name] > 1:
            name = f"{name} ({counts[name]})"
        scalars = dict(prediction.scalars)
        if not asked <= scalars.keys():
            scalars |= thermal_scalars(thermal_study(config))
        found.append(Sensor(name=name, prediction=prediction, scalars=scalars))
        advance()
    return SideBySide(sensors=tuple(found))


def _flat(table: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    rows: dict[str, Any] = {}
    for key, value in table.items():
        rows |= _flat(value, f"{prefix}{key}.") if isinstance(value, Mapping) else {prefix + key: value}
    return rows
