"""From an image to its stars: background, detection, windows, centroids."""

from __future__ import annotations

from typing import Any

from numpy.typing import NDArray

from calib.measure.background import Background, estimate_background
from calib.measure.centroiding.registry import get_centroider
from calib.measure.detection.filtered_noise import FilteredNoise
from calib.measure.detection.matched_filter import detect
from calib.measure.images.sensor_image import as_image
from calib.measure.stamps import extract_stamps
from calib.records import SensorImage, Stamps, StarTable
from render.records import Frame


def find_stars(
    image: SensorImage | Frame | NDArray[Any],
    centroider: str = "windowed",
    *,
    background: Background | None = None,
    threshold_sigma: float = 5.0,
    fwhm_px: float = 2.0,
    size_px: int = 11,
    max_stars: int | None = None,
    noise: FilteredNoise | None = None,
    **options: Any,
) -> StarTable:
    """Detected and centroided stars of an image, brightest first.

    Every detection keeps its row; flags state its faults. ``stars.select(stars.fit)`` are the stars usable for an
    attitude. ``PIXEL_PHASE`` flags stars too narrow (or too wide) for the centroider: ``stars.width_px`` is their
    width, ``stars.phase_error_px`` the error that the covariance does not include.

    Parameters
    ----------
    image : SensorImage, Frame or (h, w) array
        The image. Of a plain array of digital numbers, offset and noise are estimated from the background
        (`calib.measure.images.sensor_image.sensor_image`, which also takes gain and read noise where they are known).
    centroider : str
        Name of a centroider (`calib.measure.centroiding.registry.list_centroiders`).
    background, threshold_sigma, fwhm_px, size_px, max_stars, noise : optional
        As in `find_stamps`.
    **options
        Attributes of the centroider, e.g. ``epsf=`` for "epsf" or ``fit_background=True`` for "gaussian".

    Returns
    -------
    StarTable
        Empty, with all its columns, if nothing was found.

    Raises
    ------
    ConfigError
        On an unknown centroider or option.
    DomainError
        On a value out of range, or an image without a usable pixel.

    Examples
    --------
    >>> import numpy as np
    >>> row, column = np.indices((64, 64))
    >>> image = np.random.default_rng(1).normal(100.0, 3.0, (64, 64))
    >>> image += 2000.0 * np.exp(-0.5 * ((column - 40.25) ** 2 + (row - 20.5) ** 2))
    >>> stars = find_stars(image)
    >>> bool(abs(stars.x_px[0] - 40.25) < 0.01), bool(abs(stars.y_px[0] - 20.5) < 0.01)
    (True, True)
    """
    estimator = get_centroider(centroider, **options)
    sensor = as_image(image)
    stamps = find_stamps(
        sensor,
        background=background,
        threshold_sigma=threshold_sigma,
        fwhm_px=fwhm_px,
        size_px=size_px,
        max_stars=max_stars,
        noise=noise,
    )
    return estimator.measure(stamps, sensor.noise)


def find_stamps(
    image: SensorImage | Frame | NDArray[Any],
    *,
    background: Background | None = None,
    threshold_sigma: float = 5.0,
    fwhm_px: float = 2.0,
    size_px: int = 11,
    max_stars: int | None = None,
    noise: FilteredNoise | None = None,
) -> Stamps:
    """Windows around the detected stars of an image (h, w), brightest first, for a centroider."""
    sensor = as_image(image)
    sky = estimate_background(sensor) if background is None else background
    stars = detect(sensor, sky, threshold_sigma=threshold_sigma, fwhm_px=fwhm_px, max_stars=max_stars, noise=noise)
    return extract_stamps(sensor, stars.x_px, stars.y_px, background=sky, size_px=size_px, flags=stars.flags)
