"""Devices of a test with point targets, and their light."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from calib.accuracy.chromatic import band_pairs
from calib.measure.centroiding.registry import Centroider
from calib.measure.statistics.frame_positions import FEWEST_FRAMES
from experiments.laboratory.bench.centroid_methods import method_centroiders, needs_measured_epsf
from experiments.laboratory.devices.collimator import Collimator
from experiments.laboratory.settings.tables import TargetConfig
from optics.arrays import FloatArray
from optics.errors import DomainError
from optics.light.band import band_nodes
from optics.light.collimation import Collimation
from optics.light.spectrum import Sed
from optics.rays.vignetting import collecting_area_mm2
from render.records import EffectivePsf, StarField
from render.sensor_file.filters import Filter
from render.sensor_file.instrument import Instrument

NODES = 16
"""Wavelength nodes per filter."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Bench:
    """Devices of the laboratory."""

    target: TargetConfig  # Point target
    lamp: Sed  # Spectrum of the source
    filters: Sequence[Filter]  # b filters
    reference: int  # Index of the filter with which the others are compared (ACC18: 600 nm)
    signal_e: float  # Electrons per point and frame, the same behind every filter (lamp current adjusted)
    frames: int  # Exposures per position and filter; exposures with the lamp off, once per position
    dark_frames: int
    window_px: int  # Window read out around each point
    methods: Sequence[str]  # Centroiders, the main one first
    epsf: EffectivePsf | None = None  # Built from frames before the test, for methods ``NAME_measured``
    sessions: Sequence[EffectivePsf] = ()  # For predictions: that PSF from each of several drawn sets of frames
    collimator: Collimator | None = None  # With errors; None: perfect

    @property
    def pairs(self) -> list[tuple[str, int, int]]:
        """Differences between the filters; see `band_pairs`."""
        return band_pairs([band.centre_nm for band in self.filters], self.reference)

    @property
    def pair_names(self) -> list[str]:
        """Names of the differences."""
        return [name for name, _, _ in self.pairs]

    def power_px2(self, instrument: Instrument) -> tuple[float, float]:
        """Variance of the line of sight per axis: from exposure to exposure, and within an exposure."""
        if self.collimator is None:
            return 0.0, 0.0
        between, within = self.collimator.power_arcsec2(instrument.config.exposure_s)
        return between / instrument.pixel_arcsec**2, within / instrument.pixel_arcsec**2

    def collimation(self, wavelength_nm: FloatArray, instrument: Instrument) -> Collimation | None:
        """Collimation error behind the filters at wavelengths (b, k)."""
        if self.collimator is None:
            return None
        return self.collimator.light(self.filters, wavelength_nm, instrument.camera.lens.environment)


def one_filter(bench: Bench) -> Bench:
    """The bench with its reference filter alone."""
    return replace(bench, filters=[bench.filters[bench.reference]], reference=0)


def point_field(bench: Bench, instrument: Instrument, direction: FloatArray) -> StarField:
    """Star field of a target at one position, scaled to the signal of the bench behind every filter."""
    nodes = band_nodes(bench.filters, NODES)
    shape = nodes.weight_nm * nodes.transmission * bench.lamp.photon_density(nodes.wavelength_nm)
    camera = instrument.camera
    area = collecting_area_mm2(camera.lens) * instrument.config.exposure_s
    collected = (shape * camera.response_at(nodes.wavelength_nm)).sum(1) * area
    rate = (bench.signal_e / collected)[None, :, None] * shape[None] / direction[:, 2][:, None, None]
    return StarField(
        direction=direction,
        wavelength_nm=nodes.wavelength_nm,
        photon_rate=rate,
        band=nodes.name,
        collimation=bench.collimation(nodes.wavelength_nm, instrument),
    )


def centroiders(bench: Bench, psf: Sequence[EffectivePsf]) -> dict[str, Centroider]:
    """Centroiders of the bench by method; the PSF for all points is that of the middle one."""
    reference = [psf[len(psf) // 2]] * len(psf)
    return method_centroiders(bench.methods, matched=psf, reference=reference, measured=bench.epsf)


def session_centroiders(bench: Bench, psf: Sequence[EffectivePsf], method: str) -> list[Centroider]:
    """A method with the PSF of each of the bench's drawn sessions; none if it uses no measured PSF."""
    if not needs_measured_epsf(method):
        return []
    return [centroiders(replace(bench, methods=(method,), epsf=epsf), psf)[method] for epsf in bench.sessions]


def motion_method(methods: Sequence[str]) -> str:
    """The method for motion of the image: a fit of the true PSF, which has no S-curve, or else the main one."""
    return "epsf" if "epsf" in methods else methods[0]


def refuse_few_frames(position_px: FloatArray, method: str, *, where: str) -> None:
    """Refuse positions (f, n, 2) of which a window has fewer than two."""
    count = np.isfinite(position_px[..., 0]).sum(0)
    if count.min() < FEWEST_FRAMES:
        raise DomainError(
            f"{where}: centroider {method!r} gives {count.min()} usable frames of {len(position_px)} at place "
            f"{count.argmin()}; at least {FEWEST_FRAMES} are needed: raise the signal or the number of frames, or take "
            "another centroider"
        )
