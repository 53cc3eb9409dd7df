"""Images from elsewhere: our own frames, and FITS files that nobody here made."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from astropy.io import fits
from numpy.typing import ArrayLike, NDArray

from calib.measure.background import estimate_background
from calib.records import NoiseModel, SensorImage
from optics.errors import ConfigError, DomainError
from optics.fits import open_fits
from render.records import Frame

__all__ = ["as_image", "image_from_frame", "read_image", "sensor_image", "subtract_dark"]

_GAIN_KEYS = ("EGAIN", "CCDGAIN", "GAIN")  # electrons per DN
_READ_NOISE_KEYS = ("RDNOISE", "READNOIS", "ENOISE", "RON")  # electrons
_SATURATION_KEYS = ("SATURATE", "SATLEVEL", "DATAMAX")  # DN
_OFFSET_KEY = "OFFSET"  # DN, if the comment says so; elsewhere it is a camera setting
_EXPOSURE_KEYS = ("EXPTIME", "EXPOSURE")  # s


def as_image(image: SensorImage | Frame | NDArray[Any]) -> SensorImage:
    """An image in any of the forms that a user may have as a `SensorImage`.

    Shapes: ``image`` (h, w).
    """
    if isinstance(image, SensorImage):
        return image
    return image_from_frame(image) if isinstance(image, Frame) else sensor_image(image)


def image_from_frame(frame: Frame) -> SensorImage:
    """A rendered frame as the inverse model sees it: pixels, masks and the nominal noise model."""
    return SensorImage(
        dn=frame.dn.astype(np.float64),
        valid=~frame.defect,
        saturated=frame.saturated,
        noise=NoiseModel(
            read_noise_e=frame.read_noise_e,
            gain_dn_per_e=frame.gain_dn_per_e,
            offset_dn=frame.offset_dn,
            quantised=True,
        ),
        exposure_s=frame.exposure_s,
        source=f"frame {frame.index}, band {frame.band}",
    )


def subtract_dark(frame: Frame, dark_dn: ArrayLike) -> SensorImage:
    """A rendered frame without its fixed pattern: what is left above the nominal offset is light.

    Parameters
    ----------
    frame : Frame
        Raw readout.
    dark_dn : (h, w)
        Mean of frames without light, of the same exposure time and temperature [DN].

    Returns
    -------
    SensorImage
        With the noise model of the frame.

    Raises
    ------
    DomainError
        Sizes that differ.
    """
    image, dark = image_from_frame(frame), np.asarray(dark_dn)
    if dark.shape != image.dn.shape:
        raise DomainError(f"dark of shape {dark.shape} for a frame of shape {image.dn.shape}; they must agree")
    return replace(image, dn=image.dn - dark + frame.offset_dn)


def sensor_image(
    dn: NDArray[Any],
    *,
    gain_dn_per_e: float | None = None,
    offset_dn: float | None = None,
    read_noise_e: float | None = None,
    saturation_dn: float | None = None,
    defect: NDArray[np.bool_] | None = None,
    quantised: bool | None = None,
    exposure_s: float | None = None,
    source: str = "array",
) -> SensorImage:
    """An array of digital numbers as a `SensorImage`, with what is not known taken from the image itself.

    Unknown gain: 1 DN/e-. Unknown read noise: the noise of the background, less the shot noise of the background if
    the offset is known. Unknown offset: placed so that background and read noise together give the noise that the
    background shows. Names of such values are listed in ``assumed``.

    Parameters
    ----------
    dn : (h, w)
        Digital numbers; NaN and infinity mark unusable pixels, and so does the mask of a masked array.
    gain_dn_per_e, offset_dn, read_noise_e : float, optional
        Noise model, where known.
    saturation_dn : float, optional
        DN from which a pixel counts as saturated; for unsigned integers the largest number there is, if not given.
    defect : (h, w) bool, optional
        Known defective pixels.
    quantised : bool, optional
        Whether rounding noise counts; if not given, whether all numbers are whole.
    exposure_s : float, optional
        Exposure time.
    source : str
        Name for messages.

    Returns
    -------
    SensorImage
        What `find_stars` works on.

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
        raise DomainError(f"image {source!r} holds no finite number; nothing can be measured on it")
    values = np.where(finite, values, 0.0)
    saturated = np.zeros(values.shape, bool) if saturation_dn is None else finite & (values >= saturation_dn)
    valid = finite.copy()
    valid &= ~np.ma.getmaskarray(dn)
    if not valid.any():
        raise DomainError(f"image {source!r} is masked all over; nothing can be measured on it")
    if defect is not None:
        if np.shape(defect) != values.shape:
            raise DomainError(f"defect has shape {np.shape(defect)}, the image {values.shape}; they must agree")
        valid &= ~np.asarray(defect, dtype=bool)
    if quantised is None:
        quantised = bool(np.all(values == np.rint(values)))
    stated = {"gain_dn_per_e": gain_dn_per_e, "offset_dn": offset_dn, "read_noise_e": read_noise_e}
    assumed = tuple(name for name, value in stated.items() if value is None)
    gain = 1.0 if gain_dn_per_e is None else float(gain_dn_per_e)
    offset, read_noise = offset_dn, read_noise_e
    if offset is None or read_noise is None:
        plain = NoiseModel(read_noise_e=0.0, gain_dn_per_e=gain, offset_dn=offset or 0.0)
        sky = estimate_background(SensorImage(dn=values, valid=valid, saturated=saturated, noise=plain, source=source))
        level, sigma = float(np.median(sky.level_e)), float(np.median(sky.sigma_e))
        if read_noise is None:
            shot = max(level, 0.0) if offset is not None else 0.0
            read_noise = float(np.sqrt(max(sigma**2 - shot, 0.0)))
        if offset is None:
            offset = gain * (level - max(sigma**2 - read_noise**2, 0.0))
    noise = NoiseModel(read_noise_e=read_noise, gain_dn_per_e=gain, offset_dn=offset, quantised=quantised)
    return SensorImage(
        dn=values,
        valid=valid,
        saturated=saturated,
        noise=noise,
        assumed=assumed,
        exposure_s=exposure_s,
        source=source,
    )


def read_image(
    path: str | Path,
    *,
    hdu: int | str | None = None,
    plane: int | None = None,
    gain_dn_per_e: float | None = None,
    offset_dn: float | None = None,
    read_noise_e: float | None = None,
    saturation_dn: float | None = None,
    defect: NDArray[np.bool_] | None = None,
) -> SensorImage:
    """A FITS image of any origin; header keywords are used where they exist and needed nowhere.

    Used keywords: EGAIN or CCDGAIN, or GAIN if its comment speaks of electrons (elsewhere it is a camera setting)
    [e-/DN]; OFFSET if its comment gives the unit [DN]; RDNOISE, READNOIS, ENOISE or RON [e-]; SATURATE, SATLEVEL or
    DATAMAX [DN]; EXPTIME or EXPOSURE [s]. BSCALE, BZERO, BLANK and tile compression are undone by astropy. Arguments go
    before keywords; what neither states is estimated as `sensor_image` says.

    Parameters
    ----------
    path : str or Path
        The file.
    hdu : int or str, optional
        Extension; the first one that holds an image if not given.
    plane : int, optional
        Which image of a cube.
    gain_dn_per_e, offset_dn, read_noise_e, saturation_dn, defect : optional
        As in `sensor_image`.

    Returns
    -------
    SensorImage
        Row 0 is the first row of the file; (x, y) = FITS pixel - 1.

    Raises
    ------
    ConfigError
        If the file is missing, broken, or holds no image.
    DomainError
        If the image holds no finite number.
    """
    path = Path(path)
    data, header = _load(path, hdu)
    if data.ndim > 2:
        data = data.reshape(-1, *data.shape[-2:])
        if plane is None and len(data) > 1:
            last = len(data) - 1
            raise ConfigError(f"{path}: holds a cube of {len(data)} images; choose a plane, 0 to {last} (--plane 0)")
        if plane is not None and not 0 <= plane < len(data):
            raise ConfigError(f"{path}: plane {plane} of {len(data)}; choose 0 to {len(data) - 1}")
        data = data[plane or 0]
    if data.ndim != 2 or data.size == 0:
        raise ConfigError(f"{path}: image has shape {data.shape}; two dimensions and at least one pixel are needed")
    if gain_dn_per_e is None:
        electrons_per_dn = _gain_keyword(header)
        gain_dn_per_e = None if electrons_per_dn is None else 1.0 / electrons_per_dn
    if offset_dn is None and _OFFSET_KEY in header and "[dn]" in str(header.comments[_OFFSET_KEY]).lower():
        offset_dn = _number(header, (_OFFSET_KEY,))
    if read_noise_e is None:
        read_noise_e = _number(header, _READ_NOISE_KEYS)
    if saturation_dn is None:
        saturation_dn = _number(header, _SATURATION_KEYS, positive=True)
    return sensor_image(
        data,
        gain_dn_per_e=gain_dn_per_e,
        offset_dn=offset_dn,
        read_noise_e=read_noise_e,
        saturation_dn=saturation_dn,
        defect=defect,
        exposure_s=_number(header, _EXPOSURE_KEYS, positive=True),
        source=path.name,
    )


def _load(path: Path, hdu: int | str | None) -> tuple[NDArray[Any], Any]:
    """Data and header of an image extension; every failure is one ConfigError line."""
    with open_fits(path) as file:
        if hdu is None:
            images = [item for item in file if item.is_image and item.header.get("NAXIS", 0) >= 2]
            if not images:
                raise ConfigError(f"{path}: holds no image; {len(file)} extension(s) without image data")
        try:
            chosen = images[0] if hdu is None else file[hdu]
        except (IndexError, KeyError):
            raise ConfigError(f"{path}: has no extension {hdu!r}; it has {len(file)}, counted from 0") from None
        data = chosen.data
        header = chosen.header.copy()
        dict(header)  # every value is looked at while what is wrong with it can be told
    if data is None or not isinstance(data, np.ndarray) or data.dtype.kind not in "iuf":
        raise ConfigError(f"{path}: extension {hdu if hdu is not None else 0} holds no image")
    return data, header


def _number(header: Any, keys: tuple[str, ...], positive: bool = False) -> float | None:
    """First usable number among ``keys``; text and nonsense count as absent."""
    for key in keys:
        try:
            value = float(header.get(key))
        except (TypeError, ValueError, fits.VerifyError):
            continue
        if np.isfinite(value) and (value > 0 or (value == 0 and not positive)):
            return value
    return None


def _gain_keyword(header: Any) -> float | None:
    for key in _GAIN_KEYS:
        value = _number(header, (key,), positive=True)
        if value is None:
            continue
        comment = str(header.comments[key]).lower()
        if key != "GAIN" or "electron" in comment or "e-" in comment or "e/" in comment:
            return value
    return None
