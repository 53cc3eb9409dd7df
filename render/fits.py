"""Frames and expected images as FITS files.

Pixels: FITS counts from 1, starbench from 0. Array element ``[row, column]`` is FITS pixel ``(column + 1, row + 1)``,
in the order in which astropy stores it; nothing is flipped. A position measured on the array becomes a FITS position by
adding 1 to both coordinates (``PIXOFF = 1`` in the header says so).

A frame is a 16-bit image (unsigned by ``BZERO = 32768``) with an 8-bit image ``MASK`` behind it: 1 saturated, 2 defect.
Cards: ``EXPTIME`` [s], ``GAIN`` [e-/DN] (the reciprocal of EMVA's K: what astronomers call gain), ``RDNOISE`` [e-],
``OFFSET`` [DN], ``FILTER``, ``FRAMENUM``. Files appear complete or not at all.
"""

from __future__ import annotations

import os
import tempfile
import warnings
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from astropy.io import fits
from astropy.utils.exceptions import AstropyUserWarning
from numpy.typing import NDArray

from optics.errors import ConfigError, DomainError
from render.records import ExpectedImage, Frame

__all__ = ["read_expected", "read_frame", "write_expected", "write_frame"]

_SATURATED, _DEFECT = 1, 2
_NOTE = "FITS pixel = starbench pixel + 1 (column -> axis 1, row -> axis 2)"


def write_frame(frame: Frame, path: str | Path) -> Path:
    """Write a frame; an existing file is replaced.

    Parameters
    ----------
    frame : Frame
        What to write.
    path : str or pathlib.Path
        Where to.

    Returns
    -------
    pathlib.Path
        The file.

    Raises
    ------
    ConfigError
        The folder is missing or cannot be written to.
    """
    image = fits.PrimaryHDU(frame.dn)
    cards = [
        ("BUNIT", "adu", "digital numbers"),
        ("EXPTIME", frame.exposure_s, "[s] exposure time"),
        ("GAIN", 1.0 / frame.gain_dn_per_e, "[e-/DN] reciprocal of the system gain K"),
        ("RDNOISE", frame.read_noise_e, "[e-] median read noise"),
        ("OFFSET", frame.offset_dn, "[DN] nominal offset"),
        ("FILTER", frame.band, "filter band"),
        ("FRAMENUM", frame.index, "frame number, key of the random streams"),
    ]
    _finish(image.header, cards)
    mask = fits.ImageHDU(frame.saturated * np.uint8(_SATURATED) | frame.defect * np.uint8(_DEFECT), name="MASK")
    mask.header["SATURATE"] = (_SATURATED, "bit of saturated pixels")
    mask.header["DEFECT"] = (_DEFECT, "bit of defective pixels")
    return _write(fits.HDUList([image, mask]), Path(path))


def read_frame(
    path: str | Path,
    *,
    gain_dn_per_e: float | None = None,
    offset_dn: float | None = None,
    read_noise_e: float | None = None,
    exposure_s: float | None = None,
    band: str | None = None,
) -> Frame:
    """Read a frame, from here or from elsewhere.

    Parameters
    ----------
    path : str or pathlib.Path
        File; the first image in it is read, a third axis of length 1 dropped.
    gain_dn_per_e, offset_dn, read_noise_e, exposure_s, band : optional
        Take the place of the cards ``GAIN`` (reciprocal), ``OFFSET``, ``RDNOISE``, ``EXPTIME``, ``FILTER``.

    Returns
    -------
    Frame
        Without a ``MASK`` no pixel is flagged; without ``FILTER`` the band is empty, without ``FRAMENUM`` the number 0.

    Raises
    ------
    ConfigError
        Missing, broken or truncated file, no image, an image that is not of whole numbers from 0 to 65535, a card that
        is missing and not given here.
    """
    path = Path(path)
    header, image, mask = _read(path)
    if image.ndim == 3 and image.shape[0] == 1:
        image = image[0]
    if image.ndim != 2:
        raise ConfigError(f"{path}: image has {image.ndim} axes; a frame has 2")
    if not _is_whole(image):
        raise ConfigError(f"{path}: image is not made of whole numbers from 0 to 65535; a raw frame is needed")
    if mask is None or mask.shape != image.shape:
        mask = np.zeros(image.shape, np.uint8)

    def number(card: str, given: float | None, argument: str) -> float:
        value = given if given is not None else header.get(card)
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise ConfigError(f"{path}: card {card} is missing or no number ({value!r}); give {argument}")
        return float(value)

    gain = gain_dn_per_e
    if gain is None:
        electrons_per_dn = number("GAIN", None, "gain_dn_per_e")
        if not electrons_per_dn > 0:
            raise ConfigError(f"{path}: GAIN = {electrons_per_dn:g} e-/DN; it must be positive, or give gain_dn_per_e")
        gain = 1.0 / electrons_per_dn
    index = header.get("FRAMENUM", 0)
    return Frame(
        dn=image.astype(np.uint16),
        saturated=(mask & _SATURATED) != 0,
        defect=(mask & _DEFECT) != 0,
        gain_dn_per_e=gain,
        offset_dn=number("OFFSET", offset_dn, "offset_dn"),
        read_noise_e=number("RDNOISE", read_noise_e, "read_noise_e"),
        exposure_s=number("EXPTIME", exposure_s, "exposure_s"),
        band=str(header.get("FILTER", "")) if band is None else band,
        index=index if isinstance(index, int) else 0,
    )


def write_expected(expected: ExpectedImage, path: str | Path) -> Path:
    """Write an expected image as a float32 cube (band, row, column); the truth table is not part of it.

    Parameters, returns and errors as in `write_frame`.
    """
    image = fits.PrimaryHDU(np.ascontiguousarray(np.moveaxis(expected.electrons, 2, 0)))
    cards: list[tuple[str, Any, str]] = [
        ("BUNIT", "electron", "expected photo-electrons per pixel"),
        ("EXPTIME", expected.exposure_s, "[s] exposure time"),
        ("DIFFUSED", expected.diffused, "charge diffusion applied"),
        ("NBAND", len(expected.band), "filter bands along axis 3"),
    ]
    cards += [(f"BAND{i + 1}", name, f"filter band of plane {i + 1}") for i, name in enumerate(expected.band)]
    _finish(image.header, cards)
    return _write(fits.HDUList([image]), Path(path))


def read_expected(path: str | Path) -> ExpectedImage:
    """Read what `write_expected` wrote.

    Returns
    -------
    ExpectedImage
        With ``truth = None``.

    Raises
    ------
    ConfigError
        Missing or broken file, or one of another kind.
    """
    path = Path(path)
    header, image, _ = _read(path)
    if image.ndim != 3 or any(card not in header for card in ("EXPTIME", "DIFFUSED", "NBAND")):
        raise ConfigError(f"{path}: not an expected image; a cube with EXPTIME, DIFFUSED and NBAND is needed")
    try:
        return ExpectedImage(
            electrons=np.moveaxis(image, 0, 2),
            band=tuple(str(header.get(f"BAND{i + 1}", "")) for i in range(int(header["NBAND"]))),
            exposure_s=float(header["EXPTIME"]),
            diffused=bool(header["DIFFUSED"]),
        )
    except (DomainError, TypeError, ValueError) as error:
        raise ConfigError(f"{path}: {error}") from None


def _finish(header: fits.Header, cards: list[tuple[str, Any, str]]) -> None:
    for card, value, comment in cards:
        header[card] = (value, comment)
    header["PIXOFF"] = (1, "add to array indices for FITS pixels")
    header["COMMENT"] = _NOTE


def _write(content: fits.HDUList, path: Path) -> Path:
    try:
        handle, beside = tempfile.mkstemp(prefix=f".{path.name}.", dir=path.parent)
    except OSError as error:
        raise ConfigError(f"{path}: cannot be written ({error.strerror})") from None
    try:
        with os.fdopen(handle, "wb") as stream:
            content.writeto(stream)
        os.chmod(beside, 0o666 & ~_umask())
        os.replace(beside, path)
    except OSError as error:
        raise ConfigError(f"{path}: cannot be written ({error.strerror})") from None
    finally:
        with suppress(FileNotFoundError):
            os.unlink(beside)
    return path


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask


def _read(path: Path) -> tuple[fits.Header, NDArray[Any], NDArray[np.uint8] | None]:
    """(header, first image, MASK or None)."""
    if not path.is_file():
        raise ConfigError(f"{path}: no such file")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", fits.verify.VerifyWarning)  # cards of others may be untidy
            warnings.filterwarnings("error", category=AstropyUserWarning, message=".*truncated.*")
            with path.open("rb") as stream, fits.open(stream, memmap=False) as content:
                images = [hdu for hdu in content if hdu.is_image and hdu.name != "MASK" and hdu.data is not None]
                if not images:
                    raise ConfigError(f"{path}: holds no image")
                mask = content["MASK"].data if "MASK" in content else None
                header, image = images[0].header.copy(), np.array(images[0].data)
    except ConfigError:
        raise
    except (OSError, ValueError, TypeError, AstropyUserWarning) as error:
        raise ConfigError(f"{path}: not a readable FITS file ({str(error).splitlines()[0]})") from None
    return header, image, None if mask is None else np.asarray(mask, np.uint8)


def _is_whole(image: NDArray[Any]) -> bool:
    if not image.size:
        return False
    low, high = float(image.min()), float(image.max())
    if not (low >= 0 and high <= 65535):
        return False
    return bool(np.issubdtype(image.dtype, np.integer) or np.array_equal(image, np.rint(image)))
