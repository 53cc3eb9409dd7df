"""Detection of stars: matched filter, threshold, connected regions and their peaks."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter
from skimage.measure import label

from calib.flags import StarFlag
from calib.measure.background import Background, estimate_background
from calib.measure.centroiding.moments import FWHM_PER_SIGMA
from calib.measure.detection.false_alarms import filter_kernel
from calib.measure.detection.filtered_noise import CUT_OFF, FilteredNoise, measure_noise
from calib.measure.detection.trails import trail_members
from calib.measure.images.sensor_image import as_image
from calib.measure.stamps import subpixel_peaks
from calib.records import FLUX, SensorImage, StarTable, X, Y
from optics.arrays import FloatArray
from optics.errors import DomainError
from render.records import Frame


def detect(
    image: SensorImage | Frame | NDArray[Any],
    background: Background | None = None,
    *,
    threshold_sigma: float = 5.0,
    fwhm_px: float = 2.0,
    spike_fraction: float = 0.9,
    max_stars: int | None = None,
    noise: FilteredNoise | None = None,
) -> StarTable:
    """Stars of an image, brightest first.

    The image without background is filtered with a Gaussian of the expected width; a star is a local maximum of the
    filtered signal-to-noise ratio above ``threshold_sigma``, which is as rare in the noise of the filtered image
    (`detection_noise`: correlated, cut off at zero) as in normal noise. Maxima of a connected region are stars flagged
    ``BLEND``, except in a saturated region, of which only the highest is kept. Positions (vertex of a parabola through
    the filtered maximum) and fluxes (amplitude of the matched Gaussian) are starting values for a centroider, accurate
    to about 0.1 px and 10 %.

    Parameters
    ----------
    image : SensorImage, Frame or (h, w) array
        The image; of a plain array of digital numbers, offset and noise are estimated from its background.
    background : Background, optional
        Estimated from the image if not given.
    threshold_sigma : float
        Detection limit in units of the noise of the filtered image, positive.
    fwhm_px : float
        Full width at half maximum of the filter, 0.5 to 20 px.
    spike_fraction : float
        Fraction of the light of a 3 x 3 box in its brightest pixel above which the object is too sharp for a star and
        flagged ``SPIKE`` (a star of sigma 0.5 px reaches 0.52).
    max_stars : int, optional
        Keep only the brightest.
    noise : FilteredNoise, optional
        Noise of the filtered image; measured in it if not given.

    Returns
    -------
    StarTable
        Empty, with all its columns, if nothing was found. The covariance is that of the matched filter.

    Raises
    ------
    DomainError
        On parameters out of range, or an image without a usable pixel.
    """
    if not threshold_sigma > 0:
        raise DomainError(f"threshold_sigma = {threshold_sigma}; it must be positive")
    if not 0.5 <= fwhm_px <= 20:
        raise DomainError(f"fwhm_px = {fwhm_px} px; the filter must be 0.5 to 20 px wide")
    if max_stars is not None and max_stars < 0:
        raise DomainError(f"max_stars = {max_stars}; it must not be negative")
    image = as_image(image)
    if background is None:
        background = estimate_background(image)
    elif background.shape != image.dn.shape:
        raise DomainError(f"background has shape {background.shape} px, the image {image.dn.shape}; they must agree")
    search = _Search(image, background, fwhm_px)
    signal_to_noise = search.signal_to_noise
    if noise is None:
        noise = search.noise()
    bright = signal_to_noise > noise.limit(threshold_sigma)
    y, x = _local_maxima(signal_to_noise, bright)
    if not len(x):
        return StarTable.empty()
    keep, flags = _flag_maxima(
        image,
        light=search.light,
        regions=label(bright, connectivity=2),
        filtered=search.filtered,
        x=x,
        y=y,
        spike_fraction=spike_fraction,
    )
    x, y, flags = x[keep], y[keep], flags[keep]
    order = np.argsort(-search.filtered[y, x], kind="stable")[:max_stars]
    x, y, flags = x[order], y[order], flags[order]
    flags[trail_members(signal_to_noise / noise.scale, x, y)] |= int(StarFlag.TRAIL)
    return search.table(x, y, flags)


def detection_noise(
    image: SensorImage | Frame | NDArray[Any], background: Background | None = None, *, fwhm_px: float = 2.0
) -> FilteredNoise:
    """Noise of the filtered image in which `detect` searches, and the expected number of false detections.

    Parameters
    ----------
    image : SensorImage, Frame or (h, w) array
        The image.
    background : Background, optional
        Estimated from the image if not given.
    fwhm_px : float
        Full width at half maximum of the filter.

    Returns
    -------
    FilteredNoise
        ``.false_alarms(5.0)`` is the number of false detections per image that are to be expected, ``.threshold(0.1)``
        the limit for 0.1 of them; ``str()`` states both in a line.
    """
    image = as_image(image)
    return _Search(image, estimate_background(image) if background is None else background, fwhm_px).noise()


class _Search:
    """An image without background, filtered, and over the noise that white pixel noise would have."""

    def __init__(self, image: SensorImage, background: Background, fwhm_px: float) -> None:
        self.fwhm_px, self.valid = fwhm_px, image.valid & ~image.saturated
        self.level, sigma = background.level_image(), background.sigma_image()
        self.sigma = np.maximum(sigma, 1e-9 * np.abs(self.level).max() + np.finfo(float).tiny)  # none in flat images
        numbers = image.dn[self.valid]
        self.cut_off = bool(numbers.size and np.mean(numbers == numbers.min()) > CUT_OFF)
        self.light = np.where(image.valid, image.noise.to_electrons(image.dn) - self.level, 0.0)
        self.filtered = gaussian_filter(self.light, fwhm_px / FWHM_PER_SIGMA, mode="constant")
        self.power = float(np.sum(filter_kernel(fwhm_px) ** 2))
        self.signal_to_noise = self.filtered / (self.sigma * np.sqrt(self.power))

    def noise(self) -> FilteredNoise:
        """Noise measured in the filtered image."""
        return measure_noise(
            self.signal_to_noise, self.valid, fwhm_px=self.fwhm_px, pixel=self.light, cut_off=self.cut_off
        )

    def table(self, x: NDArray[np.int64], y: NDArray[np.int64], flags: NDArray[np.uint32]) -> StarTable:
        """Stars at maxima of the filtered image."""
        flux = self.filtered[y, x] / self.power
        variance_flux = self.sigma[y, x] ** 2 / self.power + flux
        width = self.fwhm_px / FWHM_PER_SIGMA
        covariance = np.zeros((len(x), 3, 3))
        # matched Gaussian in white noise: sigma_x = sqrt(2) width sigma_flux / flux (Fisher information of its shift)
        covariance[:, X, X] = covariance[:, Y, Y] = 2.0 * width**2 * variance_flux / flux**2
        covariance[:, FLUX, FLUX] = variance_flux
        x_px, y_px = subpixel_peaks(self.filtered[None], 0, x, y)
        return StarTable(
            x_px=x_px, y_px=y_px, flux_e=flux, background_e=self.level[y, x], covariance=covariance, flags=flags
        )


def _local_maxima(values: FloatArray, candidates: NDArray[np.bool_]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Rows and columns of candidates that no neighbour exceeds; of equal neighbours the first in the raster is kept."""
    padded = np.pad(values, 1, constant_values=-np.inf)
    y, x = np.nonzero(candidates)
    peak, keep = values[y, x], np.ones(len(y), bool)
    for step in ((0, 0), (0, 1), (0, 2), (1, 0), (1, 2), (2, 0), (2, 1), (2, 2)):
        neighbour = padded[y + step[0], x + step[1]]
        keep &= (peak > neighbour) if step < (1, 1) else (peak >= neighbour)
    return y[keep], x[keep]


def _flag_maxima(
    image: SensorImage,
    *,
    light: FloatArray,
    regions: NDArray[np.int64],
    filtered: FloatArray,
    x: NDArray[np.int64],
    y: NDArray[np.int64],
    spike_fraction: float,
) -> tuple[NDArray[np.bool_], NDArray[np.uint32]]:
    """Maxima to keep, and their flags."""
    height, width = light.shape
    flags = np.zeros(len(x), np.uint32)
    region = regions[y, x]
    maxima_per_region = np.bincount(region, minlength=regions.max() + 1)
    region_saturated = np.bincount(regions[image.saturated], minlength=len(maxima_per_region)) > 0
    region_saturated[0] = False
    flags[(maxima_per_region[region] > 1) & ~region_saturated[region]] |= int(StarFlag.BLEND)
    flags[region_saturated[region]] |= int(StarFlag.SATURATED)
    highest = np.full(len(maxima_per_region), -1)
    rising = np.argsort(filtered[y, x], kind="stable")
    highest[region[rising]] = rising  # the highest maximum of each region is written last
    keep = ~region_saturated[region] | (highest[region] == np.arange(len(x)))
    near_y = np.clip(y[:, None] + np.arange(-1, 2), 0, height - 1)[:, :, None]
    near_x = np.clip(x[:, None] + np.arange(-1, 2), 0, width - 1)[:, None, :]
    box = light[near_y, near_x]
    flags[(~image.valid[near_y, near_x]).any(axis=(1, 2))] |= int(StarFlag.DEFECT)
    total = box.sum(axis=(1, 2))
    flags[(total > 0) & (box.max(axis=(1, 2)) > spike_fraction * total)] |= int(StarFlag.SPIKE)
    border = (x == 0) | (y == 0) | (x == width - 1) | (y == height - 1)
    flags[border] |= int(StarFlag.EDGE)
    return keep, flags
