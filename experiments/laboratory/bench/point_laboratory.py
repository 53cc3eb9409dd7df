"""Bench, instrument, checks and dimensions of the tests with point targets, from their configuration."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from experiments.harness.progress import Progress
from experiments.harness.quantities import Quantities
from experiments.laboratory.bench.centroid_methods import MethodLabels
from experiments.laboratory.bench.checks import check_light
from experiments.laboratory.bench.point_bench import Bench
from experiments.laboratory.bench.points import PointScene, nominal_px, point_scene
from experiments.laboratory.bench.signal import Signal, signal_of
from experiments.laboratory.devices.collimator import build_collimator
from experiments.laboratory.settings.points import PointConfig
from experiments.laboratory.settings.tables import TargetConfig
from optics.arrays import FloatArray
from optics.errors import DomainError
from optics.light.spectrum import Blackbody
from render.sensor_file.filters import open_band
from render.sensor_file.instrument import Instrument, build_instrument


def point_signal(config: PointConfig, instrument: Instrument) -> Signal:
    """Brightness of a target point, and the star of that brightness."""
    band = open_band(config.passband, instrument, "open")
    return signal_of(config.source, band, instrument, config.source.star_k)


def point_laboratory(config: PointConfig, target: TargetConfig | None = None) -> tuple[Bench, Instrument]:
    """Bench and instrument of a configuration; a test without the multi-star target leaves it out."""
    source, instrument = config.source, build_instrument(config.instrument)
    bench = Bench(
        target=target or TargetConfig(),
        lamp=Blackbody(temperature_k=source.lamp_k),
        filters=[open_band(config.passband, instrument, "open")],
        reference=0,
        signal_e=point_signal(config, instrument).signal_e,
        frames=config.frames,
        dark_frames=config.dark_frames,
        window_px=config.window_px,
        methods=config.methods,
        collimator=build_collimator(config.collimator),
    )
    return bench, instrument


def prepared_scene(bench: Bench, instrument: Instrument, direction: FloatArray, progress: Progress) -> PointScene:
    """Scene of a test, after checks."""
    nominal = nominal_px(instrument, direction.reshape(-1, 3))
    camera, half = instrument.camera, bench.window_px // 2 + 1
    off = np.any((nominal < half) | (nominal > np.array([camera.width_px, camera.height_px]) - 1 - half), axis=1)
    if off.any():
        column, row = nominal[int(np.argmax(off))]
        raise DomainError(
            f"{int(off.sum())} of {len(nominal)} target points lie off the detector or within {half} px of its edge, "
            f"e.g. at column {column:.0f}, row {row:.0f} of {camera.width_px} x {camera.height_px} px; shift the "
            "target or reduce its size"
        )
    check_light(bench, instrument, direction)
    with progress.stage("prepare"):
        return point_scene(bench, instrument)


def point_quantities(methods: Sequence[Any]) -> Quantities:
    """Quantities with the dimensions ``method`` (centroiders) and ``axis`` (x along a row, y along a column)."""
    q = Quantities()
    q.axis("method", list(methods), "Centroider", names=MethodLabels())
    q.axis("axis", ["x", "y"], "Axis")
    return q
