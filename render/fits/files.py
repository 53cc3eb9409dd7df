"""Frames and expected images as FITS files.

Pixels: FITS counts from 1, starbench from 0. Array element ``[row, column]`` is FITS pixel ``(column + 1, row + 1)``,
in the order in which astropy stores it; nothing is flipped. A position measured on the array becomes a FITS position by
adding 1 to both coordinates (``PIXOFF = 1`` in the header says so).

A frame is a 16-bit image (unsigned by ``BZERO = 32768``) with an 8-bit image ``MASK`` behind it, whose bits the cards
``SATURATE = 1`` and ``DEFECT = 2`` of its header name; tile-compressed on request, and with more cards, such as the
world coordinates of `render.fits.wcs`. A ``MASK`` without these cards is taken as astropy's ``CCDData`` writes it: any
value but 0 is a pixel not to be used. Files of others may hold many frames: planes of a cube, image extensions.
Cards: ``EXPTIME`` [s], ``GAIN`` [e-/DN] (the reciprocal of EMVA's K: what astronomers call gain), ``RDNOISE`` [e-],
``OFFSET`` [DN], ``FILTER``, ``FRAMENUM``. Files appear complete or not at all.
"""

from __future__ import annotations

import io
import os
import tempfile
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from astropy.io import fits
from numpy.typing import NDArray

from optics.errors import ConfigError, unknown_name
from optics.fits import located, open_fits
from render.fits.headers import BLOCK, SUMS, Card, block, checked_cards, summed
from render.records import Frame

_SATURATED, _DEFECT = 1, 2
_AUXILIARY = ("MASK", "DQ", "BPM", "ERR", "UNCERT", "WEIGHT")  # extensions that go with a frame and are none
_PIXEL_OFFSET: Card = ("PIXOFF", 1, "add to array indices for FITS pixels")
_COMMENT: Card = ("COMMENT", "FITS pixel = starbench pixel + 1 (column -> axis 1, row -> axis 2)", "")
_MASK_CARDS: tuple[Card, ...] = (
    ("EXTNAME", "MASK", "extension name"),
    ("SATURATE", _SATURATED, "bit of saturated pixels"),
    ("DEFECT", _DEFECT, "bit of defective pixels"),
)
_MARKS = {"COSMIC": (4, "bit of pixels that a cosmic ray struck"), "DISK": (8, "bit of pixels of Moon and planets")}
_RANGES = {
    "GAIN": (1e-9, 1e9, "e-/DN"),
    "OFFSET": (0.0, 65535.0, "DN"),
    "RDNOISE": (0.0, 1e9, "e-"),
    "EXPTIME": (0.0, 1e9, "s"),
}
"""Allowed range and unit of the keys of a raw frame of up to 16 bits."""
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
    marks: Mapping[str, NDArray[np.bool_]] | None = None,
) -> Path:
    """Write a frame as FITS; an existing file is replaced. The same input gives the same bytes.

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
    marks : mapping of str to (h, w) bool, optional
        More bits of ``MASK``, by their card: ``COSMIC``, pixels struck by a cosmic ray; ``DISK``, pixels of a body.
        They are truth: `read_frame` leaves them aside.

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
    frame_cards = [*_frame_cards(frame), _PIXEL_OFFSET]
    frame_cards += [*checked_cards(cards, [keyword for keyword, _, _ in frame_cards]), _COMMENT]
    flags, behind = _flags(frame, mask, dict(marks or {}))
    if compression is None:
        return _write(_plain_frame(frame.dn, frame_cards, flags, behind), Path(path))
    return _write(_compressed_frame(frame.dn, frame_cards, flags, behind, _CODECS[compression]), Path(path))


def _flags(
    frame: Frame, mask: str, marks: Mapping[str, NDArray[np.bool_]]
) -> tuple[NDArray[np.uint8] | None, list[Card]]:
    """Bits of the pixels, or None for no mask, and the cards that say what they mean."""
    unknown = [card for card in marks if card not in _MARKS]
    if unknown:
        raise unknown_name("mark", unknown[0], _MARKS)
    if mask == "never":
        return None, []
    flags = frame.saturated.view(np.uint8) * np.uint8(_SATURATED)
    if mask == "always":
        flags |= frame.defect.view(np.uint8) * np.uint8(_DEFECT)
    for card, where in marks.items():
        flags |= where.view(np.uint8) * np.uint8(_MARKS[card][0])
    if mask == "saturated" and not flags.any():
        return None, []
    return flags, [*_MASK_CARDS, *((card, *_MARKS[card]) for card in marks)]


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
    dn: NDArray[np.uint16], cards: list[Card], flags: NDArray[np.uint8] | None, about: list[Card]
) -> list[Any]:
    """Content of an image with its mask behind it; the bytes that astropy would write, in a fifth of its time."""

    def size(kind: Card, bits: int) -> list[Card]:
        rows, columns = dn.shape
        axes: list[Card] = [("NAXIS", 2, ""), ("NAXIS1", columns, "columns"), ("NAXIS2", rows, "rows")]
        return [kind, ("BITPIX", bits, "bits of a pixel"), *axes]

    image = [*size(("SIMPLE", True, "conforms to the FITS standard"), 16), ("EXTEND", True, "")]
    image += [("BZERO", 32768, "unsigned"), ("BSCALE", 1, ""), *cards, *SUMS]
    behind = [*size(("XTENSION", "IMAGE", ""), 8), ("PCOUNT", 0, ""), ("GCOUNT", 1, ""), *about, *SUMS]
    parts = [(block(image), np.bitwise_xor(dn, np.uint16(0x8000)).astype(">u2"))]
    if flags is not None:
        parts.append((block(behind), flags))
    content: list[Any] = []
    for header, data in parts:
        pixels = data.data.cast("B") if data.size else b""
        content += [summed(header, pixels), pixels, bytes(-data.nbytes % BLOCK)]
    return content


def _compressed_frame(
    dn: NDArray[np.uint16], cards: list[Card], flags: NDArray[np.uint8] | None, about: list[Card], codec: str
) -> list[Any]:
    image = _tiles(dn, [("EXTNAME", "FRAME", "extension name"), *cards], codec, primary=True)
    return [image] if flags is None else [image, _tiles(flags, about, codec, primary=False)]


def _tiles(data: NDArray[Any], cards: Iterable[Card], codec: str, *, primary: bool) -> bytes:
    """Compressed extension, with the empty primary header that must come first or without.

    The cards are put into what astropy has written: through its headers they would take as long as the compression.
    """
    tile = (min(_TILE_ROWS, data.shape[0]), data.shape[1])
    table = fits.CompImageHDU(data, compression_type=codec, tile_shape=tile)
    buffer = io.BytesIO()
    fits.HDUList([fits.PrimaryHDU(), table]).writeto(buffer)
    content = buffer.getvalue()
    end = next(at for at in range(BLOCK, len(content), 80) if content[at : at + 8] == b"END     ")
    structure = [content[at : at + 80] for at in range(BLOCK, end, 80)]
    header = b"".join(card for card in structure if not card.startswith(b"EXTNAME ")) + block([*cards, *SUMS]).rstrip()
    header = header.ljust(-(-len(header) // BLOCK) * BLOCK)
    stored = content[end + BLOCK - end % BLOCK :]
    return (content[:BLOCK] if primary else b"") + summed(header, stored) + stored


def read_frame(
    path: str | Path,
    *,
    gain_dn_per_e: float | None = None,
    offset_dn: float | None = None,
    read_noise_e: float | None = None,
    exposure_s: float | None = None,
    band: str | None = None,
) -> Frame:
    """Read a frame from a FITS file of starbench or another source.

    Parameters
    ----------
    path : str or pathlib.Path
        File, or a URL as fsspec reads it; the first image in it is read, a third axis of length 1 dropped;
        `read_frames` reads all.
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
    path = located(path)
    header, image, mask = next(_images(path))
    if image.ndim == 3 and len(image) > 1:
        raise ConfigError(f"{path}: image has 3 axes, {len(image)} planes; one frame is needed here")
    flags = _mask_planes(path, image.shape, mask)
    return _frame(
        path,
        header,
        image.reshape(image.shape[-2:]),
        None if flags is None else flags[0],
        numbers=[gain_dn_per_e, offset_dn, read_noise_e, exposure_s],
        band=band,
    )


def read_frames(path: str | Path, *, gain_dn_per_e: float, offset_dn: float, read_noise_e: float) -> Iterator[Frame]:
    """All frames of another program's file in sequence: its image extensions, and the planes of each cube.

    Extensions named MASK, DQ, BPM, ERR, UNCERT or WEIGHT are no frames. A ``MASK`` belongs to the frame with its
    ``EXTVER``; a single one to all frames.
    """
    path, index = located(path), 0
    for header, image, mask in _images(path):
        planes = image.reshape(-1, *image.shape[-2:])
        flags = _mask_planes(path, image.shape, mask)
        seconds = next((header[card] for card in ("EXPTIME", "EXPOSURE") if _is_number(header.get(card))), np.nan)
        for number, plane in enumerate(planes):
            yield replace(
                _frame(
                    path,
                    header,
                    plane,
                    None if flags is None else flags[number % len(flags)],
                    numbers=[gain_dn_per_e, offset_dn, read_noise_e, float(seconds)],
                    band=None,
                ),
                index=index,
            )
            index += 1


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _frame(
    path: Path | str,
    header: fits.Header,
    image: NDArray[Any],
    flags: tuple[NDArray[np.bool_], NDArray[np.bool_]] | None,
    *,
    numbers: list[float | None],
    band: str | None,
) -> Frame:
    """A frame from an image and its cards; ``numbers``: gain, offset, read noise, exposure where given."""
    _check_whole(path, image)
    saturated, defect = (np.zeros(image.shape, bool), np.zeros(image.shape, bool)) if flags is None else flags

    def number(card: str, given: float | None, argument: str) -> float:
        value = given if given is not None else header.get(card)
        if not _is_number(value):
            raise ConfigError(f"{path}: card {card} is missing or not a number ({value!r}); give {argument}")
        value = float(value)
        low, high, unit = _RANGES[card]
        if not low <= value <= high and not (card == "EXPTIME" and given is not None and np.isnan(value)):
            raise ConfigError(f"{path}: {card} = {value:g} {unit}; {low:g} to {high:g} is possible, or give {argument}")
        return value

    gain, offset_dn, read_noise_e, exposure_s = numbers
    if gain is None:
        gain = 1.0 / number("GAIN", None, "gain_dn_per_e")
    index = header.get("FRAMENUM", 0)
    return Frame(
        dn=image.astype(np.uint16),
        saturated=saturated,
        defect=defect,
        gain_dn_per_e=gain,
        offset_dn=number("OFFSET", offset_dn, "offset_dn"),
        read_noise_e=number("RDNOISE", read_noise_e, "read_noise_e"),
        exposure_s=number("EXPTIME", exposure_s, "exposure_s"),
        band=str(header.get("FILTER", "")) if band is None else band,
        index=index if isinstance(index, int) else 0,
    )


def _write(content: list[Any], path: Path) -> Path:
    try:
        handle, temporary = tempfile.mkstemp(prefix=f".{path.name}.", dir=path.parent)
    except OSError as error:
        raise ConfigError(f"{path}: cannot be written ({error.strerror})") from None
    try:
        with os.fdopen(handle, "wb") as stream:
            stream.writelines(content)
        os.chmod(temporary, 0o666 & ~_umask())
        os.replace(temporary, path)
    except OSError as error:
        raise ConfigError(f"{path}: cannot be written ({error.strerror})") from None
    finally:
        with suppress(FileNotFoundError):
            os.unlink(temporary)
    return path


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask


def _images(path: Path | str) -> Iterator[tuple[fits.Header, NDArray[Any], fits.ImageHDU | None]]:
    """Header, data of two or three axes, and MASK or None of every frame or cube in a file."""
    with open_fits(path) as content:
        pictures = [hdu for hdu in content if hdu.is_image and hdu.header.get("NAXIS", 0)]
        masks = {hdu.ver: hdu for hdu in pictures if hdu.name == "MASK"}
        images = [
            (hdu.header.copy(), np.array(hdu.data), masks.get(hdu.ver if len(masks) > 1 else min(masks, default=1)))
            for hdu in pictures
            if hdu.name not in _AUXILIARY
        ]
        for hdu in pictures:
            dict(hdu.header)  # read every value and the data here, where a fault names the file
        for mask in masks.values():
            mask.data  # noqa: B018
    if not images:
        raise ConfigError(f"{path}: holds no image")
    for header, image, mask_of_image in images:
        if image.ndim not in (2, 3) or not image.size:
            raise ConfigError(f"{path}: image has {image.ndim} axes; a frame has 2, a cube of frames 3")
        yield header, image, mask_of_image


def _mask_planes(
    path: Path | str, shape: tuple[int, ...], mask: fits.ImageHDU | None
) -> list[tuple[NDArray[np.bool_], NDArray[np.bool_]]] | None:
    """(saturated, defective) pixels of every plane, or of all planes together, by a MASK."""
    if mask is None:
        return None
    values, header = np.asarray(mask.data), mask.header
    if values.shape not in (shape, shape[-2:]) or values.dtype.kind not in "iub":
        raise ConfigError(
            f"{path}: MASK of shape {values.shape}, {values.dtype}, for an image of shape {shape}; whole numbers for "
            "the same pixels are needed"
        )
    planes = values.reshape(-1, *shape[-2:])
    bits = {card: value for card in ("SATURATE", "DEFECT", *_MARKS) if isinstance(value := header.get(card), int)}
    if not bits:
        return [(np.zeros(plane.shape, bool), plane != 0) for plane in planes]
    unknown = int(np.bitwise_or.reduce(planes, axis=None)) & ~sum(bits.values())
    if unknown:
        named = ", ".join(f"{card} = {bit}" for card, bit in bits.items())
        raise ConfigError(
            f"{path}: MASK has bits set that no card of its header names (value {unknown}; named are {named}); remove "
            "these cards to exclude every pixel with a value other than 0"
        )
    return [((plane & bits.get("SATURATE", 0)) != 0, (plane & bits.get("DEFECT", 0)) != 0) for plane in planes]


def _check_whole(path: Path | str, image: NDArray[Any]) -> None:
    """Refuse what is no raw frame of up to 16 bits, and say why."""
    if image.dtype.kind == "f" and not np.isfinite(image).all():
        fault = (
            f"{int((~np.isfinite(image)).sum())} pixels are NaN or infinite (mark them in a MASK or a bad-pixel map)"
        )
    elif float(image.min()) < 0:
        fault = (
            f"the lowest value is {float(image.min()):g} (signed numbers without BZERO, or a dark frame was subtracted)"
        )
    elif float(image.max()) > 65535:
        fault = (
            f"the highest value is {float(image.max()):g}, above the 16-bit range (a sum of frames, or another scale)"
        )
    elif not (np.issubdtype(image.dtype, np.integer) or np.array_equal(image, np.rint(image))):
        fault = "values are not whole numbers (a mean of frames, or a calibrated image)"
    else:
        return
    raise ConfigError(f"{path}: image is not made of whole numbers from 0 to 65535: {fault}; a raw frame is needed")
