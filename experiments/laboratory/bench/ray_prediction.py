"""Image positions of target points and windows around them, predicted without a rendered image."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from calib.measure.centroid_error.expected_windows import ExpectedWindows, expected_windows
from experiments.laboratory.bench.point_bench import Bench
from optics.arrays import FloatArray
from optics.frames import field_angles_deg
from optics.light.band import band_nodes
from optics.rays.photocentre import photocentres_of
from optics.rays.spots import SpotMoments, spot_moments
from render.records import EffectivePsf
from render.sensor_file.instrument import Instrument

ORDER = (5, 12)
"""Rings and azimuths of the rays in the pupil."""
PREDICTION_NODES = 11
"""Wavelength nodes of the predictions; not the renderer's number, as the two quadratures test each other."""


def node_weights(bench: Bench, instrument: Instrument) -> tuple[FloatArray, FloatArray]:
    """Wavelength nodes (b, k) of the predictions, and the fraction of the detected photons at each."""
    nodes = band_nodes(bench.filters, PREDICTION_NODES)
    light = nodes.weight_nm * nodes.transmission * bench.lamp.photon_density(nodes.wavelength_nm)
    light = light * instrument.camera.response_at(nodes.wavelength_nm)
    return nodes.wavelength_nm, light / light.sum(1, keepdims=True)


def expected_spots(
    bench: Bench, instrument: Instrument, direction: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Mean (p, j, b, 2), RMS radius (p, j, b) [px] and transmitted area (p, j, b) [mm^2] of the ray bundles.

    Photon-weighted, by the NumPy trace alone: no renderer, image or noise takes part. NaN where no ray arrives.
    """
    wavelength, weight = node_weights(bench, instrument)
    field_x, field_y = field_angles_deg(direction.reshape(-1, 3))
    collimation = bench.collimation(wavelength, instrument)
    spot = spot_moments(
        instrument.camera.focused_lens,
        field_x,
        field_y,
        wavelength.ravel(),
        order=ORDER,
        collimation=None if collimation is None else collimation.at(wavelength).reshape(-1, 3),
    )
    return spots_of(spot, weight, instrument, direction.shape[:2])


def spots_of(
    spot: SpotMoments, weight: FloatArray, instrument: Instrument, shape: tuple[int, ...]
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """As `expected_spots`, from the moments of p j fields at all nodes of all bands, and the nodes' weights (b, k)."""
    camera, bands = instrument.camera, len(weight)
    spectrum = np.zeros((bands, *weight.shape))  # of band i: the weights of its own nodes, zero at those of the others
    spectrum[np.arange(bands), np.arange(bands)] = weight
    light = photocentres_of(spot, spectrum.reshape(bands, -1))
    mean_px = np.stack(camera.to_pixel(light.x_mm, light.y_mm), axis=-1).reshape(*shape, bands, 2)
    radius_px = light.rms_radius_mm / camera.pixel_pitch_mm
    return mean_px, radius_px.reshape(*shape, bands), light.area_mm2.reshape(*shape, bands)


def bundle_prediction(bench: Bench, instrument: Instrument, direction: FloatArray) -> FloatArray:
    """Photon-weighted bundle means (p, j, b, 2) [px] by the NumPy trace, without renderer, image or noise."""
    return expected_spots(bench, instrument, direction)[0]


def target_windows(
    bench: Bench,
    instrument: Instrument,
    direction: FloatArray,
    psf: Sequence[EffectivePsf],
    position_px: FloatArray | None = None,
    *,
    corner_px: NDArray[np.int64] | None = None,
    defect: NDArray[np.bool_] | None = None,
) -> ExpectedWindows:
    """Windows around points (p, j, 3) behind the reference filter, by default at their traced images."""
    if position_px is None:
        position_px = bundle_prediction(bench, instrument, direction)[:, :, bench.reference]
    chip = instrument.detector
    return expected_windows(
        psf,
        position_px,
        bench.signal_e,
        window_px=bench.window_px,
        corner_px=corner_px,
        defect=defect,
        full_well_e=chip.full_well_e,
        nonlinearity=chip.nonlinearity,
    )
