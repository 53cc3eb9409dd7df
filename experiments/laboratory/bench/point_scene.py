"""Laboratory of a test with point targets, and their light: rendered without noise, detected, cut into windows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from experiments.harness.progress import Progress
from experiments.laboratory.bench.checks import check_light
from experiments.laboratory.bench.point_bench import Bench
from experiments.laboratory.bench.points import PointReadout, nominal_px
from experiments.laboratory.bench.readout.windows import cut_windows
from experiments.laboratory.bench.signal import Signal, signal_of
from experiments.laboratory.bench.target_light import TargetLight, target_light
from experiments.laboratory.devices.collimator import build_collimator
from experiments.laboratory.settings.points import PointConfig
from experiments.laboratory.settings.tables import TargetConfig
from optics.arrays import FloatArray
from optics.errors import DomainError
from optics.light.spectrum import Blackbody
from optics.records import freeze
from render.engine.random import Streams
from render.records import EffectivePsf
from render.sensor_file.filters import open_band
from render.sensor_file.instrument import Instrument, build_instrument


@dataclass(frozen=True, slots=True, kw_only=True)
class PointLight:
    """A target at one place: j windows of noiseless light through one filter."""

    direction: FloatArray  # (j, 3) Unit vectors in cam
    nominal_px: FloatArray  # (j, 2) Where an ideal lens would image the points
    bundle_px: FloatArray  # (j, 2) Truth: mean of the traced rays, mean of all light
    photon_px: FloatArray  # (j, 2)
    found_px: FloatArray  # (j, 2) Where the points were detected
    corner_px: NDArray[np.int64]  # (j, 2) First pixel of each window
    light_e: FloatArray  # (j, h, w) Expected electrons at the signal of the bench
    psf: tuple[EffectivePsf, ...]  # PSF of each point, of the lens as it is

    def __post_init__(self) -> None:
        sizes: dict[str, int] = {"j": len(self.psf)}
        freeze(self, "direction", shape=("j", 3), sizes=sizes)
        for name in ("nominal_px", "bundle_px", "photon_px", "found_px"):
            freeze(self, name, shape=("j", 2), sizes=sizes)
        freeze(self, "corner_px", shape=("j", 2), dtype=np.int64, sizes=sizes)
        freeze(self, "light_e", shape=("j", "h", "w"), sizes=sizes)

    def __len__(self) -> int:
        return len(self.psf)


@dataclass(frozen=True, slots=True)
class PointScene:
    """Renders point targets through one camera; holds what is prepared once (`point_scene`)."""

    bench: Bench  # The laboratory; the bench has one filter
    instrument: Instrument
    target: TargetLight  # Renders images and PSFs

    def psfs(self, direction: FloatArray) -> tuple[EffectivePsf, ...]:
        """PSF of each of the points (j, 3)."""
        return tuple(row[0] for row in self.target.psfs(direction, self.bench.window_px // 2 + 2))

    def light(
        self, direction: FloatArray, streams: Streams, place: str, *, psf: Sequence[EffectivePsf] | None = None
    ) -> PointLight:
        """Render a target, find its points in one readout, cut windows around them."""
        expected = self.target.image(direction)
        truth = expected.truth
        assert truth is not None
        found, corner = PointReadout(self.bench, self.instrument, streams, place).corners(expected, direction)
        return PointLight(
            direction=direction,
            nominal_px=nominal_px(self.instrument, direction),
            bundle_px=np.column_stack([truth.bundle_x_px[:, 0], truth.bundle_y_px[:, 0]]),
            photon_px=np.column_stack([truth.photon_x_px[:, 0], truth.photon_y_px[:, 0]]),
            found_px=found,
            corner_px=corner,
            light_e=cut_windows(expected.electrons[:, :, 0], corner, self.bench.window_px).astype(np.float64),
            psf=tuple(psf) if psf is not None else self.psfs(direction),
        )


def one_filter(bench: Bench) -> Bench:
    """The bench with its reference filter alone."""
    return replace(bench, filters=[bench.filters[bench.reference]], reference=0)


def scene_of(scene: PointScene | None, bench: Bench, instrument: Instrument) -> PointScene:
    """A new scene, or the given one with this bench: frames, methods and signal may be others than it was made for."""
    if scene is None:
        return point_scene(bench, instrument)
    one = one_filter(bench)
    return replace(scene, bench=one, target=replace(scene.target, bench=one))


def point_scene(bench: Bench, instrument: Instrument) -> PointScene:
    """Scene of a bench; its reference filter is the one that is used."""
    one = one_filter(bench)
    return PointScene(one, instrument, target_light(one, instrument))


def point_signal(config: PointConfig, instrument: Instrument) -> Signal:
    """Brightness of a target point, and the star that it means."""
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
        at = nominal[int(np.argmax(off))]
        raise DomainError(
            f"{int(off.sum())} of {len(nominal)} target points lie off the detector or within {half} px of its edge, "
            f"e.g. at column {at[0]:.0f}, row {at[1]:.0f} of {camera.width_px} x {camera.height_px} px; shift the "
            "target or reduce its size"
        )
    check_light(bench, instrument, direction)
    with progress.stage("prepare"):
        return point_scene(bench, instrument)
