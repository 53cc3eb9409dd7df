"""Noise of a real image after the detection filter, and the resulting false detections.

Pixels of real cameras are neither independent nor normal: demosaicing and compression correlate neighbours, a black
level above the darkest noise clips it at zero, some amplifiers have tails. The noise of a pixel does not determine that
of the filtered image in which stars are detected. It is measured in the filtered image, from quantiles of its
signal-to-noise ratio s (in units of white noise) against normal quantiles z. From -1.5 to 1.5, where few stars are,

    s(z) = offset + scale z.

If pixels are clipped at their lowest number, or these quantiles bend, the noise is skewed:

    s(z) = offset + scale z + curvature z^2,

fitted from 0.3 to 2.6 without values beyond 5 sigma, and continued by its tangent beyond 3.5: noise clipped below has a
normal tail above. For white normal noise s = z. A threshold of 5 sigma means z = 5: as rare as 5 sigma of normal noise
for any distribution of the pixels. The number of local maxima above it follows as in
`calib.measure.detection.false_alarms`, with the measured correlation of the filtered noise in place of the kernel's.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import ndtr

from calib.measure.background import grown
from calib.measure.detection.false_alarms import kernel_correlation, maxima_per_pixel, solve_threshold
from optics.arrays import FloatArray

CENTRE_Z, LOW_Z, FIRST_Z, HIGH_Z, LINEAR_FROM_Z = 1.5, 0.3, 2.0, 2.6, 3.5
"""Normal quantiles: of the fit of normal noise, of skewed noise before and after stars are left out, of its tangent."""
STAR_Z, STAR_PX = 5.0, 4
"""Limit [sigma] above which pixels, with a margin [px], are left out of the fit of skewed noise."""
SKEWED, CUT_OFF = 0.03, 0.005
"""Curvature over scale, and fraction of pixels with the lowest number, above which noise is skewed."""
FEWEST_PIXELS = 4000
TILE_PX = 128
"""Side of the tiles in which the noise is measured [px]."""
FEWEST_QUIET, LEAST_QUIET = 400, 0.03
"""Pixels of a tile, and fraction of it, without stars that a measurement needs."""
NOISE_STEPS, NOISE_STEP, NOISE_CHANGE = 20, 1.3, 0.02
"""Steps from white noise upwards; factor where too few pixels are without stars; relative change of the limit of a star
that ends them."""
CALM, CALM_FRACTION = 1.15, 0.25
"""Tiles whose limit is so many times that of this quantile of all tiles, or less, tell the noise of the camera."""
SPREAD = np.array([1.6, 1.0, 0.75])
"""RMS deviation of offset, scale and curvature from their values in white noise, times the root of the number of
pixels, per px of FWHM (40 images each of 256 and 512 px, FWHM 1.2 to 4 px: at most 1.60, 0.98, 0.75)."""
SURE = 4.0
"""Significance of a deviation from white noise [standard deviations]."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FilteredNoise:
    """Noise of a filtered image in units of white noise of the same pixel noise."""

    offset: float = 0.0
    scale: float = 1.0
    curvature: float = 0.0
    correlation_x: tuple[float, float]  # Of filtered pixels at distances of 1 and 2 columns
    correlation_y: tuple[float, float]  # Of 1 and 2 rows
    pixel_correlation: tuple[float, float] = (0.0, 0.0)  # Of neighbours along x and y, before the filter
    pixels: int  # Of the image

    @property
    def white(self) -> bool:
        """Whether the noise is compatible with independent normal noise."""
        return (self.offset, self.scale, self.curvature) == (0.0, 1.0, 0.0)

    def limit(self, sigma: ArrayLike) -> FloatArray:
        """Signal-to-noise ratio in units of white noise that is as rare as ``sigma`` of a normal distribution."""
        return _limit((self.curvature, self.scale, self.offset), sigma)

    def false_alarms(self, threshold_sigma: ArrayLike) -> FloatArray:
        """Expected number of detections by noise alone per image."""
        return np.asarray(self.pixels * maxima_per_pixel(threshold_sigma, self.correlation_x, self.correlation_y))

    def threshold(self, count: float) -> float:
        """Threshold [sigma] with an expected number of false detections per image."""
        return solve_threshold(lambda threshold: float(self.false_alarms(threshold)), count, self.pixels)

    def __str__(self) -> str:
        x, y = self.pixel_correlation
        kind = "white" if self.white else f"{self.scale:.2f} times white, curvature {self.curvature:.2f}"
        expected = float(self.false_alarms(5.0))
        return (
            f"noise after the filter {kind}; neighbours correlated by {x:.2f} and {y:.2f}; "
            f"{expected:.2g} false detections per image at 5 sigma"
        )


def measure_noise(
    signal_to_noise: FloatArray,
    valid: NDArray[np.bool_],
    *,
    fwhm_px: float,
    pixel: FloatArray | None = None,
    cut_off: bool = False,
) -> FilteredNoise:
    """Noise of a filtered image; white for too few pixels, or where the deviation is not significant.

    Shapes: ``signal_to_noise`` (h, w), filtered image over its noise for independent pixels; ``valid`` (h, w);
    ``pixel`` (h, w), image without background before the filter, for ``pixel_correlation``. ``cut_off``: many pixels
    have the lowest number of the converter, so that the noise is skewed.
    """
    pixels = int(np.count_nonzero(valid))
    white = kernel_correlation(fwhm_px)
    border = int(np.ceil(2.0 * fwhm_px))
    inner = (slice(border, -border), slice(border, -border))
    ratio, usable = signal_to_noise[inner], valid[inner]
    if np.count_nonzero(usable) < FEWEST_PIXELS:
        return FilteredNoise(correlation_x=white, correlation_y=white, pixels=pixels)
    step = max(1, round(0.8 * fwhm_px))
    spread = SURE * SPREAD * fwhm_px / np.sqrt(pixels)
    tiles = _tiles(ratio.shape)
    local = [_least_noise(ratio[tile], usable[tile], step, cut_off) for tile in tiles]
    limits = np.array([float(_limit(shape, STAR_Z)) for shape, _ in local])
    if np.isnan(limits).all():  # structure everywhere
        return FilteredNoise(correlation_x=white, correlation_y=white, pixels=pixels)
    calm = limits <= CALM * np.nanquantile(limits, CALM_FRACTION)
    quiet = np.zeros_like(usable)
    for tile, (_, mask), is_calm in zip(tiles, local, calm, strict=True):
        if is_calm:
            quiet[tile] = mask
    thin = (slice(None, None, step), slice(None, None, step))
    remaining = ratio[thin][quiet[thin]]
    if remaining.size < FEWEST_PIXELS // step**2:
        return FilteredNoise(correlation_x=white, correlation_y=white, pixels=pixels)
    curvature, scale, offset = _parabola(remaining, -CENTRE_Z, CENTRE_Z)
    bent = np.median([shape[0] / shape[1] for (shape, _), is_calm in zip(local, calm, strict=True) if is_calm])
    skewed = cut_off or (bent > SKEWED and curvature > max(SKEWED * scale, spread[2]))
    curvature, scale, offset = _parabola(remaining, LOW_Z, HIGH_Z) if skewed else (0.0, scale, offset)
    if not skewed and scale < 1.0 + spread[1]:  # below white, as of pixels of unequal noise, counts as white
        scale, offset = 1.0, 0.0
    filtered = [
        white if scale == 1.0 else (_correlation(ratio, quiet, axis, 1), _correlation(ratio, quiet, axis, 2))
        for axis in (1, 0)
    ]
    faint = quiet & (ratio < _limit((curvature, scale, offset), 3.0))
    pair = [0.0 if pixel is None else _correlation(pixel[inner], faint, axis, 1) for axis in (1, 0)]
    return FilteredNoise(
        offset=offset,
        scale=scale,
        curvature=curvature,
        correlation_x=filtered[0],
        correlation_y=filtered[1],
        pixel_correlation=(pair[0], pair[1]),
        pixels=pixels,
    )


def _tiles(shape: tuple[int, ...]) -> list[tuple[slice, slice]]:
    """Tiles of some `TILE_PX` that cover an image."""
    edges = [np.linspace(0, size, max(1, round(size / TILE_PX)) + 1).astype(int) for size in shape]
    rows, columns = ([slice(*pair) for pair in pairwise(axis.tolist())] for axis in edges)
    return [(row, column) for row in rows for column in columns]


def _least_noise(
    ratio: FloatArray, usable: NDArray[np.bool_], step: int, cut_off: bool
) -> tuple[tuple[float, float, float], NDArray[np.bool_]]:
    """The least noise of a tile that explains all pixels but those near to values too high for it, and these pixels.

    From white noise upwards: stars, at any density, raise quantiles of all pixels, but not those of the pixels between
    them.
    """
    shape = (0.0, 1.0, 0.0)
    thin = (slice(None, None, step), slice(None, None, step))
    needed = max(FEWEST_QUIET, LEAST_QUIET * np.count_nonzero(usable))
    for _ in range(NOISE_STEPS):
        quiet = usable & ~grown(ratio > _limit(shape, STAR_Z), STAR_PX)
        if np.count_nonzero(quiet) < needed:
            shape = (NOISE_STEP * shape[0], NOISE_STEP * shape[1], shape[2])
            continue
        limits = (LOW_Z, HIGH_Z) if cut_off else (-CENTRE_Z, CENTRE_Z)
        before, shape = shape, _parabola(ratio[thin][quiet[thin]], *limits)
        if _limit(shape, STAR_Z) < (1.0 + NOISE_CHANGE) * _limit(before, STAR_Z):
            return shape, quiet
    return (np.nan, np.nan, np.nan), np.zeros_like(usable)


def _parabola(ratio: FloatArray, low: float, high: float) -> tuple[float, float, float]:
    """Curvature, scale and offset of quantiles; a straight line for quantiles that bend down."""
    z = np.linspace(low, high, 24)
    quantile = np.quantile(ratio, ndtr(z))
    curvature, scale, offset = np.polyfit(z, quantile, 2)
    if curvature < 0.0 or scale <= 0.0:
        (scale, offset), curvature = np.polyfit(z, quantile, 1), 0.0
    return float(curvature), float(max(scale, 1e-3)), float(offset)


def _limit(shape: tuple[float, float, float], z: ArrayLike) -> FloatArray:
    curvature, scale, offset = shape
    z = np.asarray(z, np.float64)
    bent = np.minimum(z, LINEAR_FROM_Z)
    return np.asarray(offset + scale * bent + curvature * bent**2 + (scale + 2.0 * curvature * bent) * (z - bent))


def _correlation(image: FloatArray, usable: NDArray[np.bool_], axis: int, distance: int) -> float:
    """Correlation of usable pixels at a distance along an axis, from some 250 lines."""
    every = max(1, image.shape[1 - axis] // 250)
    values, mask = np.moveaxis(image, axis, -1)[::every], np.moveaxis(usable, axis, -1)[::every]
    both = mask[:, :-distance] & mask[:, distance:]
    if np.count_nonzero(both) < FEWEST_PIXELS // 4:
        return 0.0
    return float(np.clip(np.corrcoef(values[:, :-distance][both], values[:, distance:][both])[0, 1], -0.95, 0.98))
