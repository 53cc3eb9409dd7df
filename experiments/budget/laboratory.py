"""Instrument, benches and tests of the budget from its configuration; checks before long work."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from calib.accuracy.error_budget import ErrorTerm
from experiments.budget.settings import BudgetConfig, MovedConfig
from experiments.laboratory.bench.centroid_methods import has_matched_epsf
from experiments.laboratory.bench.checks import check_light
from experiments.laboratory.bench.point_bench import Bench
from experiments.laboratory.bench.points import point_scene
from experiments.laboratory.bench.ray_prediction import expected_spots
from experiments.laboratory.bench.signal import Signal, signal_of
from experiments.laboratory.devices.collimator import build_collimator
from experiments.laboratory.devices.target import corner_directions
from optics.arrays import FloatArray
from optics.errors import DomainError
from optics.lens.perturb import decentre, despace, tilt
from optics.lens.system import LensSystem
from optics.light.spectrum import Blackbody
from optics.units import UM_MM
from render.engine.random import Streams
from render.records import EffectivePsf
from render.sensor_file.detector import overridden
from render.sensor_file.filters import Filter, interference_filters, open_band
from render.sensor_file.instrument import Instrument, build_instrument, configured_detector, configured_lens

PIXEL_APERTURE_PX2 = 1.0 / 12.0
"""Variance per axis of the pixel aperture, a uniform distribution over one pixel."""
EDGE_MARGIN_PX = 100.0
"""Distance of the outer target points of the step test from the edge of the detector."""
GOLDEN_RATIO = 0.618
"""Inverse golden ratio: multiples modulo 1 fill an interval evenly for any number of them."""
ROW_STEP_PX = 0.37
"""Row from one field position of the step test to the next: each samples another pixel phase of the S-curve."""


@dataclass(frozen=True, slots=True, kw_only=True)
class BudgetLaboratory:
    """The instrument and the targets in front of it."""

    config: BudgetConfig
    instrument: Instrument  # Camera with the perturbed lens and the overridden detector
    bench: Bench  # Point target in the full pass band: temporal, pixel and distortion terms
    filtered: Bench  # Point target behind the filters: chromatic term
    signal: Signal  # Electrons of a point per frame, and the star that gives as many

    def with_epsf(self, epsf: EffectivePsf, sessions: Sequence[EffectivePsf] = ()) -> BudgetLaboratory:
        """The laboratory with a PSF built from frames, and Monte-Carlo realisations of that PSF."""
        return replace(
            self,
            bench=replace(self.bench, epsf=epsf, sessions=sessions),
            filtered=replace(self.filtered, epsf=epsf, sessions=sessions),
        )


def perturbed_lens(lens: LensSystem, moved: MovedConfig) -> LensSystem:
    """The lens with the configured misalignment of an element; the same object without misalignment."""
    if moved == MovedConfig():  # its default element is one of the built-in lens
        return lens
    lens.indices_of(moved.element)
    if moved.tilt_x_arcmin or moved.tilt_y_arcmin:
        lens = tilt(lens, moved.element, moved.tilt_x_arcmin / 60.0, moved.tilt_y_arcmin / 60.0)
    if moved.decentre_x_um or moved.decentre_y_um:
        # rows increase against the y axis of the lens
        lens = decentre(lens, moved.element, moved.decentre_x_um * UM_MM, -moved.decentre_y_um * UM_MM)
    return despace(lens, moved.element, moved.despace_um * UM_MM) if moved.despace_um else lens


def build_laboratory(config: BudgetConfig, lens: LensSystem | None = None) -> BudgetLaboratory:
    """Instrument and benches of a configuration."""
    detector = overridden(configured_detector(config.instrument), config.detector)
    prescription = perturbed_lens(configured_lens(config.instrument), config.moved) if lens is None else lens
    prescription.check_surfaces()  # misalignment and temperature need a prescription
    instrument = build_instrument(config.instrument, prescription, detector)
    filters = interference_filters(config.filters)
    passband = open_band(config.passband, instrument, "open")
    for band in filters:
        instrument.check_band("filters.centres_nm", band)
    collimator = build_collimator(config.collimator, filters)
    signal = signal_of(config.source, passband, instrument, config.source.star_k)

    def bench(bands: Sequence[Filter], reference: int) -> Bench:
        return Bench(
            target=config.target,
            lamp=Blackbody(temperature_k=config.source.lamp_k),
            filters=bands,
            reference=reference,
            signal_e=signal.signal_e,
            frames=config.frames,
            dark_frames=config.dark_frames,
            window_px=config.window_px,
            methods=config.methods,
            collimator=collimator,
        )

    return BudgetLaboratory(
        config=config,
        instrument=instrument,
        bench=bench([passband], 0),
        signal=signal,
        filtered=bench(filters, config.filters.centres_nm.index(config.filters.reference_nm)),
    )


def half_field(instrument: Instrument) -> FloatArray:
    """Half width and half height (2,) of the detector as tangents of the field angle."""
    camera = instrument.camera
    return np.array([camera.width_px, camera.height_px]) / 2.0 * camera.pixel_pitch_mm / instrument.focal_length_mm


def check_laboratory(lab: BudgetLaboratory) -> None:
    """Refuse spots wider than the window, and points that saturate.

    The brightest pixel of a Gaussian spot is taken to hold 1 / (2 pi s^2 + 1) of its electrons, with s^2 = variance of
    the spot per axis plus 1/12 px^2, the variance of the pixel aperture. A spot centred on a pixel exceeds this by up
    to a half: settings are refused that saturate for the majority of pixel phases.
    """
    saturation_e = lab.instrument.detector.saturation_e
    signal_e = lab.signal.signal_e
    corners = corner_directions(lab.config.target, lab.instrument)
    check_light(lab.filtered, lab.instrument, corners)
    _, radius_px, _ = expected_spots(lab.filtered, lab.instrument, corners)
    variance_px2 = float(np.nanmin(radius_px)) ** 2 / 2.0 + lab.instrument.camera.blur_px**2 + PIXEL_APERTURE_PX2
    if signal_e / (2.0 * np.pi * variance_px2 + 1.0) > saturation_e:
        raise DomainError(
            f"source: a point of {signal_e:g} e- saturates its brightest pixel (it holds {saturation_e:.0f} e-); "
            "lower source.signal_e (raise source.magnitude_mag) or defocus"
        )


def grid_streams(lab: BudgetLaboratory) -> Streams:
    """Random streams of the grid target: prediction and measurement have the same points."""
    return Streams(lab.config.seed).child("budget", "grid")


def target_survey_term(lab: BudgetLaboratory) -> ErrorTerm:
    """LSFE-C2, three times the error of the target coordinates (ACC18: marking error): an input."""
    return ErrorTerm(arcsec=np.full(2, 3.0 * lab.config.grid.marking_error_arcsec))


def field_positions_px(lab: BudgetLaboratory) -> FloatArray:
    """Centres (q, 2) [px] of the target in the step test: along the detector, the first at the centre of chip one."""
    detector = lab.instrument.detector
    target = lab.config.target
    centre_x = (detector.chip_width_px - 1) / 2
    centre_y = (detector.chip_height_px - 1) / 2
    low = (target.columns - 1) * target.pitch_px / 2 + EDGE_MARGIN_PX
    high = lab.instrument.camera.width_px - 1 - low
    number = np.arange(1, lab.config.steps.places)
    columns = low + (high - low) * np.modf(number * GOLDEN_RATIO)[0]
    rows = centre_y + ROW_STEP_PX * number
    return np.column_stack([[centre_x, *columns], [centre_y, *rows]])


_CACHE: OrderedDict[tuple[Any, ...], Any] = OrderedDict()
_CACHE_SIZE = 32
_PSF_INDEPENDENT_SETTINGS: dict[str, Any] = {
    "frames": True,
    "dark_frames": True,
    "centroid": True,
    "compare": True,
    "hexapod": True,
    "attitude": True,
    "thermal": True,
    "published_within_fraction": True,
    "predict_only": True,
    "source": {"signal_e", "magnitude_mag"},
    "grid": {"marking_error_arcsec", "surveys", "order", "reference"},
    "detector": {"read_noise_e", "prnu", "dark_current_e_per_s", "sensor_seed"},
}
"""Settings on which no PSF depends, as pydantic's ``exclude``: True excludes a table or key, a set keys of a table."""


def cached_psfs(lab: BudgetLaboratory, bench: Bench, target: str, direction: FloatArray) -> tuple[EffectivePsf, ...]:
    """PSFs of target points (j, 3), rendered once per named target (`cached_light`)."""
    return cached_light(lab, bench, target, lambda: point_scene(bench, lab.instrument).psfs(direction))


def cached_light(lab: BudgetLaboratory, bench: Bench, target: str, render: Callable[[], Any]) -> Any:
    """Result of ``render``, which depends on the lens and the target only: a sweep over the read noise renders once."""
    all_matched = all(has_matched_epsf(method) for method in bench.methods)  # the chromatic target then needs no PSF
    camera = repr((lab.instrument.camera, lab.instrument.camera.lens.surfaces))  # a lens file may change, its name not
    key = (target, all_matched, camera, lab.config.model_dump_json(exclude=_PSF_INDEPENDENT_SETTINGS))
    if key not in _CACHE:
        _CACHE[key] = render()
        if len(_CACHE) > _CACHE_SIZE:
            _CACHE.popitem(last=False)
    _CACHE.move_to_end(key)
    return _CACHE[key]
