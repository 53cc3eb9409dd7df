"""Frames and expected images as FITS files.

Pixels: FITS counts from 1, starbench from 0. Array element ``[row, column]`` is FITS pixel ``(column + 1, row + 1)``,
in the order in which astropy stores it; nothing is flipped. A position measured on the array becomes a FITS position by
adding 1 to both coordinates (``PIXOFF = 1`` in the header says so).

A frame is a 16-bit image (unsigned by ``BZERO = 32768``) with an 8-bit image ``MASK`` behind it: 1 saturated, 2 defect;
tile-compressed on request, and with more cards, such as the world coordinates of `render.fits.wcs`.
Cards: ``EXPTIME`` [s], ``GAIN`` [e-/DN] (the reciprocal of EMVA's K: what astronomers call gain), ``RDNOISE`` [e-],
``OFFSET`` [DN], ``FILTER``, ``FRAMENUM``. Files appear complete or not at all.
"""

from __future__ import annotations

import io
import os
import tempfile
import warnings
from collections.abc import Callable, Iterable
from contextlib import suppress
from pathlib import Path
from typing import Any, BinaryIO, Literal

import numpy as np
from astropy.io import fits
from astropy.utils.exceptions import AstropyUserWarning
from numpy.typing import NDArray

from optics.errors import ConfigError, DomainError, unknown_name
from render.fits.headers import BLOCK, Card, block, checked_cards
from render.records import ExpectedImage, Frame

__all__ = ["read_expected", "read_frame", "write_expected", "write_frame"]

_SATURATED, _DEFECT = 1, 2
_PIXEL_OFFSET: Card = ("PIXOFF", 1, "add to array indices for FITS pixels")
_COMMENT: Card = ("COMMENT", "FITS pixel = starbench pixel + 1 (column -> axis 1, row -> axis 2)", "")
_MASK_CARDS: tuple[Card, ...] = (
    ("EXTNAME", "MASK", "extension name"),
    ("SATURATE", _SATURATED, "bit of saturated pixels"),
    ("DEFECT", _DEFECT, "bit of defective pixels"),
)
_MASKS = ("always", "saturated", "never")
_CODECS = {"rice": "RICE_1", "gzip": "GZIP_2"}
_TILE_ROWS = 32  # 1 row, the default of astropy, takes three times as long; more rows gain nothing


def write_frame(
    frame: Frame,
    path: str | Path,
    *,
    compression: Literal["rice", "gzip"] | None = None,
    cards: Iterable[Card] | fits.Header = (),
    mask: Literal["always", "saturated", "never"] = "always",
) -> Path:
    """Write a frame; an existing file is replaced. The same input makes the same bytes.

    Parameters
    ----------
    frame : Frame
        What to write.
    path : str or pathlib.Path
        Where to.
    compression : {"rice", "gzip"}, optional
        Lossless tile compression (FITS standard 4.0, sec. 10): RICE_1, or GZIP_2, which is a few per cent smaller and
        takes three times as long. The image then is the first extension, as with `fpack`.
    cards : iterable of (keyword, value, comment), or astropy.io.fits.Header
        More cards for the header of the image, e.g. of `render.fits.wcs.LensWcs.header`.
    mask : {"always", "saturated", "never"}
        ``MASK`` in every file; of saturated pixels only, in files that have one (defects are the same in every frame
        of a detector); or in none.

    Returns
    -------
    pathlib.Path
        The file.

    Raises
    ------
    ConfigError
        The folder is missing or cannot be written to; an unknown option; a card that cannot be written, describes the
        file itself, or stands there already.
    """
    if compression is not None and compression not in _CODECS:
        raise unknown_name("compression", str(compression), _CODECS)
    if mask not in _MASKS:
        raise unknown_name("mask", str(mask), _MASKS)
    own = [*_frame_cards(frame), _PIXEL_OFFSET]
    own += [*checked_cards(cards, [keyword for keyword, _, _ in own]), _COMMENT]
    flags = None
    if mask == "always":
        flags = frame.saturated.view(np.uint8) * np.uint8(_SATURATED) | frame.defect.view(np.uint8) * np.uint8(_DEFECT)
    elif mask == "saturated" and frame.saturated.any():
        flags = frame.saturated.view(np.uint8) * np.uint8(_SATURATED)
    if compression is None:
        return _write(_plain_frame(frame.dn, own, flags), Path(path))
    return _write(_compressed_frame(frame.dn, own, flags, _CODECS[compression]), Path(path))


def _frame_cards(frame: Frame) -> list[Card]:
    return [
        ("BUNIT", "adu", "digital numbers"),
        ("EXPTIME", frame.exposure_s, "[s] exposure time"),
        ("GAIN", 1.0 / frame.gain_dn_per_e, "[e-/DN] reciprocal of the system gain K"),
        ("RDNOISE", frame.read_noise_e, "[e-] median read noise"),
        ("OFFSET", frame.offset_dn, "[DN] nominal offset"),
        ("FILTER", frame.band, "filter band"),
        ("FRAMENUM", frame.index, "frame number, key of the random streams"),
    ]


def _plain_frame(
    dn: NDArray[np.uint16], cards: list[Card], flags: NDArray[np.uint8] | None
) -> Callable[[BinaryIO], None]:
    """Writer of an image with its mask behind it; the bytes that astropy would write, in a fifth of its time."""

    def size(kind: Card, bits: int) -> list[Card]:
        rows, columns = dn.shape
        return [
            kind,
            ("BITPIX", bits, "bits of a pixel"),
            ("NAXIS", 2, ""),
            ("NAXIS1", columns, "columns"),
            ("NAXIS2", rows, "rows"),
        ]

    image = [*size(("SIMPLE", True, "conforms to the FITS standard"), 16), ("EXTEND", True, "")]
    image += [("BZERO", 32768, "unsigned"), ("BSCALE", 1, ""), *cards]
    behind = [*size(("XTENSION", "IMAGE", ""), 8), ("PCOUNT", 0, ""), ("GCOUNT", 1, ""), *_MASK_CARDS]
    parts = [(block(image), np.bitwise_xor(dn, np.uint16(0x8000)).astype(">u2"))]
    if flags is not None:
        parts.append((block(behind), flags))

    def write(stream: BinaryIO) -> None:
        for header, data in parts:
            stream.write(header)
            stream.write(data.data.cast("B") if data.size else b"")
            stream.write(bytes(-data.nbytes % BLOCK))

    return write


def _compressed_frame(
    dn: NDArray[np.uint16], cards: list[Card], flags: NDArray[np.uint8] | None, codec: str
) -> Callable[[BinaryIO], None]:
    parts = [_tiles(dn, [("EXTNAME", "FRAME", "extension name"), *cards], codec, primary=True)]
    if flags is not None:
        parts.append(_tiles(flags, _MASK_CARDS, codec, primary=False))

    def write(stream: BinaryIO) -> None:
        for part in parts:
            stream.write(part)

    return write


def _tiles(data: NDArray[Any], cards: Iterable[Card], codec: str, *, primary: bool) -> bytes:
    """Compressed extension, with the empty primary header that must come first or without.

    The cards are put into what astropy has written: through its headers they would take as long as the compression.
    """
    tile = (min(_TILE_ROWS, data.shape[0]), data.shape[1])
    table = fits.CompImageHDU(data, compression_type=codec, tile_shape=tile)
    held = io.BytesIO()
    fits.HDUList([fits.PrimaryHDU(), table]).writeto(held)
    content = held.getvalue()
    end = next(at for at in range(BLOCK, len(content), 80) if content[at : at + 8] == b"END     ")
    structure = [content[at : at + 80] for at in range(BLOCK, end, 80)]
    header = b"".join(card for card in structure if not card.startswith(b"EXTNAME ")) + block(cards).rstrip()
    header = header.ljust(-(-len(header) // BLOCK) * BLOCK)
    return (content[:BLOCK] if primary else b"") + header + content[end + BLOCK - end % BLOCK :]


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
    for card, value, comment in [*cards, _PIXEL_OFFSET, _COMMENT]:
        image.header[card] = (value, comment) if comment else value
    return _write(fits.HDUList([image]).writeto, Path(path))


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


def _write(content: Callable[[BinaryIO], None], path: Path) -> Path:
    try:
        handle, beside = tempfile.mkstemp(prefix=f".{path.name}.", dir=path.parent)
    except OSError as error:
        raise ConfigError(f"{path}: cannot be written ({error.strerror})") from None
    try:
        with os.fdopen(handle, "wb") as stream:
            content(stream)
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
