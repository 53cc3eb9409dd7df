"""From the budget's configuration to the instrument and its benches, and what is refused before long work."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from experiments.budget.settings import Config, MovedConfig
from experiments.laboratory.bench import Bench
from experiments.laboratory.collimator import build_collimator
from experiments.laboratory.detector_changes import overridden
from experiments.laboratory.filter_wheel import Filter, interference_filters, open_band
from experiments.laboratory.instrument import Instrument, build_instrument, configured_detector, configured_lens
from experiments.laboratory.signal import Signal, signal_of
from optics.lens.perturb import decentre, despace, tilt
from optics.lens.system import LensSystem
from optics.light.spectrum import Blackbody
from optics.units import UM_MM
from render.records import EffectivePsf

__all__ = ["Laboratory", "build_laboratory", "moved_lens"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Laboratory:
    """The instrument, and what stands in front of it."""

    config: Config  # What it was built from
    instrument: Instrument  # The camera, its element moved, its detector as overridden
    bench: Bench  # Point target in the whole pass band: temporal, pixel and distortion terms
    filtered: Bench  # The same behind the filters: chromatic term
    signal: Signal  # Of a point, and the star that it means

    def with_epsf(self, epsf: EffectivePsf, sessions: Sequence[EffectivePsf] = ()) -> Laboratory:
        """The same, with a PSF that was built from frames, and what it might have been."""
        bench, filtered = (replace(one, epsf=epsf, sessions=sessions) for one in (self.bench, self.filtered))
        return replace(self, bench=bench, filtered=filtered)


def moved_lens(lens: LensSystem, moved: MovedConfig) -> LensSystem:
    """The lens with the element where the configuration has it; the lens itself if that is where it belongs."""
    if moved == MovedConfig():  # an element of the built-in lens, where it belongs
        return lens
    lens.indices_of(moved.element)
    if moved.tilt_x_arcmin or moved.tilt_y_arcmin:
        lens = tilt(lens, moved.element, moved.tilt_x_arcmin / 60.0, moved.tilt_y_arcmin / 60.0)
    if moved.decentre_x_um or moved.decentre_y_um:
        # rows increase against the y axis of the lens
        lens = decentre(lens, moved.element, moved.decentre_x_um * UM_MM, -moved.decentre_y_um * UM_MM)
    return despace(lens, moved.element, moved.despace_um * UM_MM) if moved.despace_um else lens


def build_laboratory(config: Config, lens: LensSystem | None = None) -> Laboratory:
    """Instrument and benches of a configuration."""
    detector = overridden(configured_detector(config.instrument), config.detector)
    prescription = moved_lens(configured_lens(config.instrument), config.moved) if lens is None else lens
    instrument = build_instrument(config.instrument, prescription, detector)
    filters = config.filters
    narrow = interference_filters(filters)
    wide = (open_band(config.passband, instrument, "open"),)
    for band in narrow:
        instrument.check_band("filters.centres_nm", band)

    collimator = build_collimator(config.collimator, narrow)
    light = signal_of(config.source, wide[0], instrument, config.source.star_k)

    def bench(bands: Sequence[Filter], reference: int) -> Bench:
        return Bench(
            target=config.target,
            lamp=Blackbody(temperature_k=config.source.lamp_k),
            filters=bands,
            reference=reference,
            signal_e=light.signal_e,
            frames=config.frames,
            dark_frames=config.dark_frames,
            window_px=config.window_px,
            methods=config.methods,
            collimator=collimator,
        )

    return Laboratory(
        config=config,
        instrument=instrument,
        bench=bench(wide, 0),
        signal=light,
        filtered=bench(narrow, filters.centres_nm.index(filters.reference_nm)),
    )
