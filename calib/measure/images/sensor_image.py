"""Images as input: rendered frames, arrays, and files of other programs."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from calib.measure.background import estimate_background
from calib.measure.images.image_files import converter_steps, load_pixels
from calib.records import NoiseModel, SensorImage
from optics.errors import ConfigError, DomainError, unknown_name
from render.records import Frame

_GAIN_KEYS = ("EGAIN", "CCDGAIN", "GAIN")  # electrons per DN
_READ_NOISE_KEYS = ("RDNOISE", "READNOIS", "ENOISE", "RON")  # electrons
_SATURATION_KEYS = ("SATURATE", "SATLEVEL", "DATAMAX")  # DN
_OFFSET_KEY = "OFFSET"  # DN, if the comment says so; elsewhere it is a camera setting
_PER_NATIVE_STEP = re.compile(r"\bZWO\b|\bASI ?\d{3}", re.IGNORECASE)
"""Cameras whose driver pads to 16 bits and states EGAIN per step of the converter (panoptes/POCS issue 899)."""
_CHANNELS = ("mean", "red", "green", "blue")


def as_image(image: SensorImage | Frame | NDArray[Any]) -> SensorImage:
    """A frame or an array (h, w) as a `SensorImage`."""
    if isinstance(image, SensorImage):
        return image
    return image_from_frame(image) if isinstance(image, Frame) else sensor_image(image)


def image_from_frame(frame: Frame) -> SensorImage:
    """Pixels, masks and nominal noise model of a rendered frame."""
    return SensorImage(
        dn=frame.dn.astype(np.float64),
        valid=~frame.defect,
        saturated=frame.saturated,
        noise=NoiseModel.of(frame),
        exposure_s=frame.exposure_s,
        source=f"frame {frame.index}, band {frame.band}",
    )


def subtract_dark(frame: Frame, dark_dn: ArrayLike, *, noise: NoiseModel | None = None) -> SensorImage:
    """Subtract the fixed pattern of a rendered frame, so that only light remains above the nominal offset.

    Parameters
    ----------
    frame : Frame
        Raw readout.
    dark_dn : (h, w)
        Mean of frames without light, of the same exposure time and temperature [DN].
    noise : NoiseModel, optional
        Noise of the difference; that of the frame if not given.

    Returns
    -------
    SensorImage
        Light above the offset, with its noise.

    Raises
    ------
    DomainError
        Sizes that differ.
    """
    image, dark = image_from_frame(frame), np.asarray(dark_dn)
    if dark.shape != image.dn.shape:
        raise DomainError(f"dark of shape {dark.shape} for a frame of shape {image.dn.shape}; they must agree")
    return replace(image, dn=image.dn - dark + frame.offset_dn, noise=noise or image.noise)


LEAST_NOISE_DN = 0.1
"""Noise of the background below which numbers that are not whole are no counts of a converter [DN]."""


def sensor_image(
    dn: NDArray[Any],
    *,
    gain_dn_per_e: float | None = None,
    offset_dn: float | None = None,
    read_noise_e: float | None = None,
    saturation_dn: float | None = None,
    saturated: NDArray[np.bool_] | None = None,
    defect: NDArray[np.bool_] | None = None,
    quantised: bool | None = None,
    exposure_s: float | None = None,
    source: str = "array",
) -> SensorImage:
    """Digital numbers as a `SensorImage`; missing properties are estimated from the image.

    Unknown gain: 1 DN/e-; of numbers that are no counts (a noise below `LEAST_NOISE_DN`, as in images scaled to 0 .. 1)
    such that the noise of the background is 1 e-. Unknown read noise: the noise of the background, less its shot noise
    if the offset is known. Unknown offset: such that background and read noise together give the measured noise of the
    background. Names of such values are listed in ``assumed``.

    Parameters
    ----------
    dn : (h, w)
        Digital numbers; NaN and infinity mark unusable pixels, and so does the mask of a masked array.
    gain_dn_per_e, offset_dn, read_noise_e : float, optional
        Noise model, where known.
    saturation_dn : float, optional
        DN from which a pixel is saturated; for unsigned integers the largest number of the type, if not given.
    saturated : (h, w) bool, optional
        Saturated pixels, in place of a level.
    defect : (h, w) bool, optional
        Defective pixels.
    quantised : bool, optional
        Whether the noise includes rounding; if not given, whether all numbers are whole.
    exposure_s : float, optional
        Exposure time.
    source : str
        Name for messages.

    Returns
    -------
    SensorImage
        Input of `find_stars`.

    Raises
    ------
    DomainError
        If the array is not two-dimensional, is empty, holds no finite number or a value is out of range.
    """
    array = np.asarray(dn)
    if array.ndim != 2 or array.size == 0:
        raise DomainError(f"image {source!r} has shape {array.shape}; two dimensions and at least one pixel are needed")
    if saturation_dn is None and array.dtype.kind == "u":
        saturation_dn = float(np.iinfo(array.dtype).max)
    values = array.astype(np.float64)
    finite = np.isfinite(values)
    if not finite.any():
        raise DomainError(f"image {source!r} holds no finite number; it cannot be measured")
    values = np.where(finite, values, 0.0)
    if saturated is None:
        saturated = np.zeros(values.shape, bool) if saturation_dn is None else values >= saturation_dn
    saturated = finite & saturated
    valid = finite & ~np.ma.getmaskarray(dn)
    if not valid.any():
        raise DomainError(f"image {source!r} has no unmasked pixel; it cannot be measured")
    if defect is not None:
        if np.shape(defect) != values.shape:
            raise DomainError(f"defect has shape {np.shape(defect)}, the image {values.shape}; they must agree")
        valid &= ~np.asarray(defect, dtype=bool)
    if quantised is None:
        quantised = bool(np.all(values == np.rint(values)))
    stated = {"gain_dn_per_e": gain_dn_per_e, "offset_dn": offset_dn, "read_noise_e": read_noise_e}
    assumed = tuple(name for name, value in stated.items() if value is None)
    gain = 1.0 if gain_dn_per_e is None else float(gain_dn_per_e)
    offset = 0.0 if offset_dn is None else offset_dn
    read_noise = 0.0 if read_noise_e is None else read_noise_e
    if assumed:
        plain = NoiseModel(read_noise_e=0.0, gain_dn_per_e=gain, offset_dn=offset)
        frame = SensorImage(dn=values, valid=valid, saturated=saturated, noise=plain, source=source)
        step = 4 if min(values.shape) >= 512 else 1  # level and noise of a large frame to 0.3 %
        sky = estimate_background(frame, step_px=step)
        level, sigma = float(np.median(sky.level_e)), float(np.median(sky.sigma_e))
        if gain_dn_per_e is None and not quantised and 0.0 < sigma < LEAST_NOISE_DN:
            gain, level, sigma = sigma, level / sigma, 1.0
        if read_noise_e is None:
            shot = max(level, 0.0) if offset_dn is not None else 0.0
            read_noise = float(np.sqrt(max(sigma**2 - shot, 0.0)))
        if offset_dn is None:
            offset = gain * (level - max(sigma**2 - read_noise**2, 0.0))
    return SensorImage(
        dn=values,
        valid=valid,
        saturated=saturated,
        noise=NoiseModel(read_noise_e=read_noise, gain_dn_per_e=gain, offset_dn=offset, quantised=quantised),
        assumed=assumed,
        exposure_s=exposure_s,
        source=source,
    )


def read_image(
    path: str | Path,
    *,
    hdu: int | str | None = None,
    plane: int | None = None,
    channel: str = "mean",
    step: float | None = None,
    gain_dn_per_e: float | None = None,
    offset_dn: float | None = None,
    read_noise_e: float | None = None,
    saturation_dn: float | None = None,
    defect: NDArray[np.bool_] | None = None,
) -> SensorImage:
    """Read an image file: FITS, TIFF, PNG, JPEG, PGM, PPM, NumPy; 8 to 16 bits or floats; grey or colour.

    A DN of the result is a step of the converter: 12 bits in the upper bits of 16 are divided by 16, and the level of
    saturation with them. ``str(image.conversion)`` states the result. Of colours the mean is taken; a pixel is
    saturated where any of them is. Pixels that are transparent in an alpha channel are not valid.

    Used keywords of FITS, in units of the stored numbers: EGAIN or CCDGAIN, or GAIN if its comment speaks of electrons
    (elsewhere it is a camera setting) [e-/DN]; OFFSET if its comment gives the unit [DN]; RDNOISE, READNOIS, ENOISE or
    RON [e-]; SATURATE, SATLEVEL or DATAMAX [DN]; EXPTIME, EXPOSURE or XPOSURE [s]. The gain of ZWO's cameras (INSTRUME)
    is in units of the converter's steps instead; ``conversion.gain`` states the reading of padded numbers. BSCALE,
    BZERO, BLANK and tile compression are undone by astropy; CHECKSUM and DATASUM are verified. ``conversion.taken`` is
    the middle of the exposure, by FITS, EXIF or TIFF. Arguments override keywords; missing values are estimated as by
    `sensor_image`.

    Parameters
    ----------
    path : str or Path
        The file.
    hdu : int or str, optional
        Extension of a FITS file; the first with an image if not given.
    plane : int, optional
        Image of a cube, or page of a TIFF file.
    channel : str
        "mean", "red", "green" or "blue" of a colour image.
    step : float, optional
        Stored numbers per DN, if the frame does not determine it; by `converter_steps` if not given.
    gain_dn_per_e, offset_dn, read_noise_e, saturation_dn, defect : optional
        As in `sensor_image`.

    Returns
    -------
    SensorImage
        Row 0 is the first row of the file; (x, y) = FITS pixel - 1.

    Raises
    ------
    ConfigError
        If the file is missing, empty, cut off, broken, or holds no image.
    DomainError
        If the image holds no finite number.
    """
    if channel not in _CHANNELS:
        raise unknown_name("channel", channel, _CHANNELS)
    if step is not None and not 0 < step < np.inf:
        raise DomainError(f"step = {step}; it must be positive")
    stored = load_pixels(path, hdu=hdu, plane=plane)
    values, header = stored.values, stored.header
    conversion = converter_steps(values, stored.kind)
    native_step = conversion.step if step is None or step == 1 else float(step)
    if step is not None:
        conversion = replace(conversion, step=float(step))
    full = _number(header, _SATURATION_KEYS) if saturation_dn is None else saturation_dn * conversion.step
    if full is None and stored.full is not None:
        full = min(stored.full - stored.full % conversion.step, conversion.full or np.inf)
    conversion = replace(conversion, full=conversion.full if full is None else full, taken=stored.taken)
    saturated: Any = None if conversion.full is None else values >= conversion.full
    if values.ndim == 3:
        conversion = replace(conversion, channel=channel if channel != "mean" else "mean of red, green and blue")
        saturated = None if saturated is None else saturated.any(axis=2)
        values = values.mean(axis=2) if channel == "mean" else values[:, :, _CHANNELS.index(channel) - 1]
    if conversion.step != 1:
        values = values // int(conversion.step) if conversion.repeated else values / conversion.step
    if gain_dn_per_e is None:
        card, electrons_per_dn = _gain_keyword(header)
        native = _PER_NATIVE_STEP.search(f"{header.get('INSTRUME', '')} {header.get('CAMERA', '')}") is not None
        if electrons_per_dn is not None:
            gain_dn_per_e = (native_step if native else 1.0) / (electrons_per_dn * conversion.step)
            if native_step != 1:
                unit = "step of the converter, the habit of ZWO's driver" if native else "stored number"
                conversion = replace(conversion, gain=f"{card} = {electrons_per_dn:g} e- read per {unit}")
    if offset_dn is None and _OFFSET_KEY in header and "[dn]" in str(header.comments[_OFFSET_KEY]).lower():
        offset_dn = _number(header, (_OFFSET_KEY,), zero=True)
        offset_dn = None if offset_dn is None else offset_dn / conversion.step
    if read_noise_e is None:
        read_noise_e = _number(header, _READ_NOISE_KEYS, zero=True)
    transparent = None if stored.opaque is None else ~stored.opaque
    if transparent is not None and defect is not None and np.shape(defect) == transparent.shape:
        defect = transparent | np.asarray(defect, dtype=bool)
    image = sensor_image(
        values,
        gain_dn_per_e=gain_dn_per_e,
        offset_dn=offset_dn,
        read_noise_e=read_noise_e,
        saturated=saturated,
        defect=transparent if defect is None else defect,
        quantised=conversion.full is not None or None,
        exposure_s=stored.exposure_s,
        source=Path(path).name,
    )
    return replace(image, conversion=conversion)


def read_images(paths: Iterable[str | Path], **options: Any) -> Iterator[SensorImage]:
    """Read frames of one camera, file by file; all must have the size and steps of the first.

    Parameters
    ----------
    paths : iterable of str or Path
        The files.
    **options
        As in `read_image`.

    Yields
    ------
    SensorImage
        The frames, in the order of the paths; each is read on request.

    Raises
    ------
    ConfigError
        As `read_image`, or if a frame is of another size, type or step than the first one.
    """
    first: SensorImage | None = None
    for path in paths:
        image = read_image(path, **options)
        if first is None:
            first = image
        rows, columns = first.dn.shape
        if image.dn.shape != (rows, columns):
            height, width = image.dn.shape
            raise ConfigError(f"{path}: {width} x {height} px, {first.source} has {columns} x {rows}")
        assert first.conversion is not None
        assert image.conversion is not None
        stored, step = first.conversion.stored, first.conversion.step
        if image.conversion.stored != stored:
            raise ConfigError(f"{path}: stored as {image.conversion.stored}, {first.source} as {stored}")
        if image.conversion.step != step:
            if image.conversion.step % step:
                raise ConfigError(
                    f"{path}: counted in steps of {image.conversion.step:g}, {first.source} in steps of {step:g}; "
                    "state the step (step=1: values unchanged)"
                )
            image = read_image(path, **{**options, "step": step})  # few codes have a common step by chance
        yield image


def _number(header: Any, keys: tuple[str, ...], *, zero: bool = False) -> float | None:
    """First positive number (or ``zero``) among ``keys``; text counts as absent."""
    from astropy.io import fits  # slow to import

    for key in keys:
        try:
            value = float(header.get(key))
        except (TypeError, ValueError, fits.VerifyError):
            continue
        if np.isfinite(value) and (value > 0 or (value == 0 and zero)):
            return value
    return None


def _gain_keyword(header: Any) -> tuple[str, float | None]:
    """Card and its value [e-/DN]."""
    for key in _GAIN_KEYS:
        value = _number(header, (key,))
        comment = "" if value is None else str(header.comments[key]).lower()
        if value is not None and (key != "GAIN" or any(unit in comment for unit in ("electron", "e-", "e/"))):
            return key, value
    return "", None
