"""Effect of noise and fixed patterns on centroids, predicted without frames from PSFs, positions and the data sheet.

A pixel's electrons, as seen by the reduction, are

    light (1 + PRNU) + offset pattern + temporal noise,

temporal noise being photons, dark current, read noise and rounding. To first order a centroid moves by the sum over the
pixels of g x disturbance; g is the influence of a pixel, computed by raising one pixel after the other in a noiseless
window (`calib.measure.linear_response`). Where a linear response is not valid (a threshold), noise is drawn on the
noiseless windows and centroided. Positions come from the NumPy trace, PSFs from traced bundles; no image is rendered,
and the detector chain takes no part.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from calib.measure.centroid import Centroider
from calib.measure.crlb import fisher_information
from calib.measure.epsf import EpsfModel, epsf_bank
from calib.measure.linear_response import centroid_variance, linear_response, tight
from calib.records import NoiseModel, Stamps
from experiments.laboratory.bench.point_bench import Bench
from experiments.laboratory.bench.ray_prediction import bundle_prediction
from experiments.laboratory.bench.readout.centroids import measured_positions, noiseless_positions
from experiments.laboratory.bench.readout.noise_model import nominal_noise
from experiments.laboratory.bench.readout.windows import cut_windows
from optics.arrays import FloatArray
from optics.records import freeze
from render.detector.noise import PixelNoise
from render.detector.spec import Detector
from render.records import EffectivePsf
from render.sensor_file.instrument import Instrument


@dataclass(frozen=True, slots=True, kw_only=True)
class ExpectedWindows:
    """n noiseless windows drawn from PSFs."""

    place_px: FloatArray  # (n, 2) Mean of the rays, by the NumPy trace
    corner_px: NDArray[np.int64]  # (n, 2) First pixels
    light_e: FloatArray  # (n, h, w) Expected electrons
    valid: NDArray[np.bool_]  # (n, h, w) Pixels that the reduction uses
    psf: tuple[EffectivePsf, ...]  # PSFs; ``psf_index`` says which belongs to which window
    psf_index: NDArray[np.int64]  # (n,) Index into ``psf``

    def modelled(self, shift_px: FloatArray | float = 0.0) -> tuple[FloatArray, FloatArray]:
        """Images (n, h w) of the PSFs moved by (2,), with derivatives (n, h w, 3) by column, row and electrons.

        The electrons are those of the whole image, of which a window cuts the wings.
        """
        count, height, width = self.light_e.shape
        model = EpsfModel(epsf_bank(self.psf, (height, width)), self.psf_index)

        def images(shift_px: FloatArray | float, electrons: FloatArray) -> tuple[FloatArray, FloatArray]:
            place = self.place_px + shift_px - self.corner_px
            return model.evaluate(np.column_stack([place, electrons]), np.arange(count))

        inside = images(0.0, np.ones(count))[0].sum(1)
        return images(shift_px, self.light_e.sum((1, 2)) / inside)

    def moved(self, shift_px: FloatArray) -> ExpectedWindows:
        """The same windows with the image moved by (2,) in them."""
        light = np.maximum(self.modelled(shift_px)[0], 0.0).reshape(self.light_e.shape)
        return replace(self, place_px=self.place_px + shift_px, light_e=light)

    def __post_init__(self) -> None:
        sizes: dict[str, int] = {}
        freeze(self, "place_px", shape=("n", 2), sizes=sizes)
        freeze(self, "corner_px", shape=("n", 2), dtype=np.int64, sizes=sizes)
        freeze(self, "light_e", shape=("n", "h", "w"), sizes=sizes)
        freeze(self, "valid", shape=("n", "h", "w"), dtype=np.bool_, sizes=sizes)
        freeze(self, "psf_index", shape=("n",), dtype=np.int64, sizes=sizes)


def expected_windows(
    bench: Bench,
    instrument: Instrument,
    direction: FloatArray,
    psf: Sequence[EffectivePsf],
    place_px: FloatArray | None = None,
    *,
    corner_px: NDArray[np.int64] | None = None,
    defect: NDArray[np.bool_] | None = None,
) -> ExpectedWindows:
    """Windows around target points at m places (first pixels: ``corner_px``), as the reference filter shows them."""
    if place_px is None:
        place_px = bundle_prediction(bench, instrument, direction)[:, :, bench.reference]
    place = np.asarray(place_px, float).reshape(-1, 2)
    size = bench.window_px
    corner = np.rint(place).astype(np.int64) - size // 2 if corner_px is None else corner_px.reshape(-1, 2)
    index = np.tile(np.arange(len(psf)), len(direction))
    model = EpsfModel(epsf_bank(tuple(psf), (size, size)), index)
    theta = np.column_stack([place - corner, np.full(len(place), bench.signal_e)])
    light, _ = model.evaluate(theta, np.arange(len(place)))
    light = np.maximum(light, 0.0)  # the spline between the samples of a sharp PSF swings below zero by some 1e-6
    light = _bent(light, instrument.detector).reshape(-1, size, size)
    return ExpectedWindows(
        place_px=place,
        corner_px=corner,
        light_e=light,
        valid=np.ones(light.shape, bool) if defect is None else ~cut_windows(defect, corner, size),
        psf=tuple(psf),
        psf_index=index,
    )


def _bent(light_e: FloatArray, detector: Detector) -> FloatArray:
    """Electrons as a reduction with a constant gain sees them: the converter's non-linearity."""
    fraction = light_e / detector.full_well_e
    return np.asarray(light_e * (1.0 + sum(c * fraction ** (i + 1) for i, c in enumerate(detector.nonlinearity))))


@dataclass(frozen=True, slots=True, kw_only=True)
class Influence:
    """Response of a centroider to the pixels of n windows."""

    position_px: FloatArray  # (n, 2) Its position of the noiseless window
    gain_px_per_e: FloatArray  # (n, 2, h, w) Shift per electron in a pixel

    def sigma_px(self, variance_e2: FloatArray) -> FloatArray:
        """Standard deviation (n, 2) by independent noise of this variance in the pixels (n, h, w)."""
        return np.sqrt(centroid_variance(self.gain_px_per_e, variance_e2))

    def device_sigma_px(self, light_e: FloatArray, noise: PixelNoise) -> FloatArray:
        """Standard deviation of temporal noise from chip to chip (n, 2): read noise and dark charge differ by pixel."""
        of_variance = np.sqrt((self.gain_px_per_e**4).sum((2, 3)) * noise.floor_e4)
        return np.asarray(0.5 * of_variance / np.maximum(self.sigma_px(noise.temporal_e2(light_e)), 1e-300))


def window_positions(
    centroider: Centroider, instrument: Instrument, windows: ExpectedWindows
) -> tuple[FloatArray, Stamps]:
    """Positions (n, 2) by a centroider on noiseless windows, and its stamps."""
    return noiseless_positions(
        centroider,
        nominal_noise(instrument),
        light_e=windows.light_e,
        corner_px=windows.corner_px,
        valid=windows.valid,
        psf_index=windows.psf_index,
    )


def influence(centroider: Centroider, instrument: Instrument, windows: ExpectedWindows) -> Influence:
    """Position and influence function of a centroider on noiseless windows."""
    noise = nominal_noise(instrument)
    position, stamps = window_positions(centroider, instrument, windows)
    return Influence(
        position_px=position, gain_px_per_e=linear_response(tight(centroider), stamps, noise, windows.light_e)
    )


def bound_px(windows: ExpectedWindows, noise: PixelNoise) -> FloatArray:
    """Cramer-Rao bound (n, 2) of the standard deviation of x and y: flux unknown, background known."""
    signal, jacobian = windows.modelled()
    pixel = NoiseModel(read_noise_e=float(np.sqrt(noise.floor_e2)))
    information = fisher_information(jacobian, np.maximum(signal, 0.0), pixel)
    covariance = np.linalg.inv(information)
    return np.sqrt(np.stack([covariance[:, 0, 0], covariance[:, 1, 1]], axis=1))


def sampled_px(
    centroider: Centroider,
    instrument: Instrument,
    windows: ExpectedWindows,
    noise: PixelNoise,
    *,
    draws: int,
    rng: np.random.Generator,
) -> FloatArray:
    """Standard deviation (n, 2) of `drawn_positions`; parameters as there."""
    position = drawn_positions(centroider, instrument, windows, noise, draws=draws, rng=rng)
    return np.asarray(np.nanstd(position, axis=0, ddof=1))


def drawn_positions(
    centroider: Centroider,
    instrument: Instrument,
    windows: ExpectedWindows,
    noise: PixelNoise,
    *,
    draws: int,
    rng: np.random.Generator,
    mirrored: bool = False,
) -> FloatArray:
    """Positions (draws, n, 2) with noise drawn on the windows with NumPy: Poisson, normal, rounded.

    Their mean is where frames put the centroid of a method that is not linear (a threshold): the centroid of the
    noiseless window may lie elsewhere.
    """
    stated = nominal_noise(instrument)
    _, stamps = window_positions(centroider, instrument, windows)
    shape = (draws, *windows.light_e.shape)
    drawn = (draws // 2, *shape[1:]) if mirrored else shape
    electrons = rng.poisson(windows.light_e + noise.dark_e, drawn) - noise.dark_e
    electrons = electrons + np.sqrt(noise.read_e2) * rng.standard_normal(drawn)
    if mirrored:
        electrons = np.stack([electrons, 2.0 * windows.light_e - electrons], axis=1).reshape(shape)
    electrons = windows.valid * np.rint(electrons * stated.gain_dn_per_e) / stated.gain_dn_per_e
    many = stamps.select(np.tile(np.arange(len(stamps)), draws))
    noisy: Stamps = replace(many, electrons=electrons.reshape(-1, *shape[2:]))
    return measured_positions(centroider, noisy, stated, draws)
