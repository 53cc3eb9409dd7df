"""Opening of FITS files: claims of the headers are checked against the file before memory is allocated.

A header of a few bytes can claim any amount of memory or time: 2^31 axes or columns, an image of petabytes, a gzip
stream that unpacks to a thousand times its size. The headers are read first (FITS standard 4.0, sec. 4.4), and every
exception of astropy for damaged files becomes a one-line error.
"""

from __future__ import annotations

import bz2
import gzip
import io
import lzma
import os
import re
import warnings
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

from optics.errors import ConfigError, StarbenchError

if TYPE_CHECKING:
    from astropy.io import fits

_BLOCK, _CARD = 2880, 80
_PACKED: dict[bytes, Callable[..., Any]] = {b"\x1f\x8b": gzip.open, b"BZh": bz2.open, b"\xfd7zXZ": lzma.open}
_UNREADABLE = {b"PK\x03\x04": "zip", b"\x1f\x9d": "compress"}
MOST_UNPACKED_BYTES = 1 << 28
"""A packed file may become this large; unpacked by its owner it may be of any size."""
MOST_RATIO = 2000
"""Largest ratio of a tile-compressed image to its stored size, that of an image of a single value."""
_SURELY_BYTES = 1 << 26
_MOST_EXTENSIONS = 4096
_MOST_HEADER_BLOCKS = 1000
_DEEPEST_BITS = (8, 16, 32, 64, -32, -64)
_WIDTH = {"L": 1, "B": 1, "A": 1, "I": 2, "J": 4, "E": 4, "K": 8, "D": 8, "C": 8, "M": 16, "P": 8, "Q": 16}
_FORMAT = re.compile(r"(\d*)([LXBAIJEKDCMPQ])")
_GZIP_OR_ZLIB = 47


@contextmanager
def open_fits(path: str | Path, *, sums: bool = True) -> Iterator[fits.HDUList]:
    """A FITS file, plain or packed by gzip, bzip2 or xz; with ``sums`` held against CHECKSUM and DATASUM, if any."""
    from astropy.io import fits  # slow to import
    from astropy.utils.exceptions import AstropyUserWarning, AstropyWarning

    path = located(path)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", AstropyWarning)
            warnings.filterwarnings("ignore", category=RuntimeWarning)
            warnings.filterwarnings("error", category=AstropyUserWarning, message=".*(truncated|verification failed).*")
            with _stream(path) as stream:
                _walk(stream)
                stream.seek(0)
                with fits.open(stream, memmap=False, checksum=sums) as content:
                    yield content
    except StarbenchError as error:
        if str(path) in str(error):
            raise
        raise ConfigError(f"{path}: not a readable FITS file ({error})") from None
    except Exception as error:  # astropy raises a dozen kinds on damaged files
        raise ConfigError(f"{path}: not a readable FITS file ({_reason(error)})") from None


def image_header(path: str | Path, hdu: int | str | None = None) -> fits.Header:
    """Header of an image: of an extension, or of the first image in the file, compressed or not."""
    with open_fits(path, sums=False) as content:
        images = [unit for unit in content if unit.is_image and unit.header.get("NAXIS", 0) >= 2]
        try:
            header: fits.Header = (images[0] if hdu is None else content[hdu]).header.copy()
        except (IndexError, KeyError):
            raise ConfigError(f"{path}: holds no image {'' if hdu is None else f'in extension {hdu}'}") from None
        return header


def located(path: str | Path) -> Path | str:
    """A path, or the text of a URL, which a path would alter."""
    return str(path) if "://" in str(path) else Path(path)


def unpacked(path: Path) -> bytes | None:
    """Content of a file that is packed by gzip, bzip2 or xz; None of one that is not."""
    try:
        with path.open("rb") as stream:
            start = stream.read(6)
        for magic, name in _UNREADABLE.items():
            if start.startswith(magic):
                raise ConfigError(f"{path}: is packed by {name}; unpack it first")
        opener = next((opener for magic, opener in _PACKED.items() if start.startswith(magic)), None)
        if opener is None:
            return None
        content = bytearray()
        with opener(path, "rb") as packed:
            while part := packed.read(1 << 22):
                content += part
                if len(content) > MOST_UNPACKED_BYTES:
                    raise ConfigError(
                        f"{path}: unpacks to more than {MOST_UNPACKED_BYTES / 1e6:.0f} MB; unpack it first if this "
                        "size is intended"
                    )
        return bytes(content)
    except (OSError, EOFError, zlib.error, lzma.LZMAError) as error:
        raise ConfigError(f"{path}: cannot be read ({_reason(error)})") from None


@contextmanager
def _stream(path: Path | str) -> Iterator[BinaryIO]:
    if isinstance(path, str):
        import fsspec

        with fsspec.open(path, "rb") as stream:
            yield stream
        return
    if not os.path.isfile(path):
        raise ConfigError(f"{path}: no such file")
    content = unpacked(path)
    with path.open("rb") if content is None else io.BytesIO(content) as stream:
        yield stream


def _walk(stream: BinaryIO) -> None:
    """Hold every header against the length of the file."""
    length, start = stream.seek(0, io.SEEK_END), 0
    if not length:
        raise ConfigError("file is empty")
    for number in range(_MOST_EXTENSIONS):
        stream.seek(start)
        header = _header(stream, number)
        if header is None:
            return
        start = stream.tell()
        size = _data_bytes(header, number)
        if start + size > length:
            raise ConfigError(
                f"header {number} announces {size} bytes of data, {length - start} follow: it is cut off or damaged"
            )
        if header.get("ZIMAGE") == "T":
            _check_tiles(header, number, size)
            _check_streams(stream, header, number, start)
        start += -(-size // _BLOCK) * _BLOCK
        if start >= length:
            return
    raise ConfigError(f"more than {_MOST_EXTENSIONS} extensions")


def _header(stream: BinaryIO, number: int) -> dict[str, str] | None:
    """Keyword -> text of its value; None where something follows that is no extension, which FITS allows."""
    cards: dict[str, str] = {}
    for _ in range(_MOST_HEADER_BLOCKS):
        block = stream.read(_BLOCK)
        if not cards and not block.startswith((b"SIMPLE", b"XTENSION")[min(number, 1)]):
            if number:
                return None
            raise ConfigError("it does not begin with SIMPLE, as a FITS file must")
        for at in range(0, len(block), _CARD):
            card = block[at : at + _CARD].decode("ascii", "replace")
            keyword = card[:8].rstrip()
            if keyword == "END":
                return cards
            if card[8:10] == "= ":
                cards.setdefault(keyword, card[10:].partition("/")[0].strip())
        if len(block) < _BLOCK:
            raise ConfigError(f"header {number} does not end")
    raise ConfigError(f"header {number} is longer than {_MOST_HEADER_BLOCKS} blocks")


def _integer(
    header: dict[str, str], keyword: str, number: int, low: int, high: int = 1 << 62, default: str = ""
) -> int:
    text = header.get(keyword, default)
    try:
        value = int(text) if len(text) < 20 else high + 1
    except ValueError:
        raise ConfigError(f"header {number}: {keyword} = {text!r}; a whole number is needed") from None
    if not low <= value <= high:
        raise ConfigError(f"header {number}: {keyword} = {text[:40]}; {low} to {high} is allowed")
    return value


def _data_bytes(header: dict[str, str], number: int) -> int:
    """Bytes of the data of a header: FITS standard 4.0, eq. 1 and 2."""
    bits = _integer(header, "BITPIX", number, -64, 64)
    if bits not in _DEEPEST_BITS:
        raise ConfigError(f"header {number}: BITPIX = {bits}; one of {', '.join(map(str, _DEEPEST_BITS))} is needed")
    axes = [_integer(header, f"NAXIS{k + 1}", number, 0) for k in range(_integer(header, "NAXIS", number, 0, 999))]
    if "TFIELDS" in header:
        _integer(header, "TFIELDS", number, 0, 999)
    if header.get("GROUPS") == "T":
        raise ConfigError(f"header {number}: GROUPS = T; random groups are not read")
    elements = 1 if axes else 0
    for axis in axes:
        elements *= axis
    groups = _integer(header, "GCOUNT", number, 0, default="1")
    return abs(bits) // 8 * groups * (_integer(header, "PCOUNT", number, 0, default="0") + elements)


def _check_tiles(header: dict[str, str], number: int, stored: int) -> None:
    """Refuse a compressed image, or tiles of it, far larger than the stored bytes."""
    for name in ("ZNAXIS", "ZTILE"):
        size = 8
        for axis in range(_integer(header, "ZNAXIS", number, 1, 99)):
            size *= _integer(header, f"{name}{axis + 1}", number, 1, default="1")
        if size > max(_SURELY_BYTES, MOST_RATIO * stored):
            raise ConfigError(f"header {number} announces {name} of {size} bytes from {stored} that are stored")


def _check_streams(stream: BinaryIO, header: dict[str, str], number: int, start: int) -> None:
    """Refuse tiles that unpack to more than a tile: gzip to a thousand times its size, HCOMPRESS to other sides;
    those of other algorithms cannot (FITS standard 4.0, sec. 10)."""
    pixels = 1
    for axis in range(int(header["ZNAXIS"])):
        pixels *= int(header.get(f"ZTILE{axis + 1}", header[f"ZNAXIS{axis + 1}"] if axis == 0 else "1"))
    algorithm = _text(header.get("ZCMPTYPE", ""))
    for column, offset, wide in _columns(header, number):
        is_gzip = column == "GZIP_COMPRESSED_DATA" or (column == "COMPRESSED_DATA" and algorithm.startswith("GZIP"))
        if not (is_gzip or (column == "COMPRESSED_DATA" and algorithm == "HCOMPRESS_1")):
            continue
        for tile in _tiles(stream, header, number, start, offset, wide):
            if is_gzip:
                fits = _unpacks_within(tile, 8 * pixels)
            else:
                sides = int.from_bytes(tile[2:6], "big"), int.from_bytes(tile[6:10], "big")
                fits = sides[0] * sides[1] <= pixels
            if not fits:
                raise ConfigError(f"header {number}: a compressed tile unpacks to more than its {pixels} pixels")


def _text(value: str) -> str:
    return value.strip("' ")


def _columns(header: dict[str, str], number: int) -> Iterator[tuple[str, int, bool]]:
    """Name, offset in the row and width of the descriptor of every column of variable length."""
    offset = 0
    for field in range(1, int(header.get("TFIELDS", "0")) + 1):
        match = _FORMAT.match(_text(header.get(f"TFORM{field}", "")))
        if match is None:
            raise ConfigError(f"header {number}: TFORM{field} = {header.get(f'TFORM{field}')!r} is not a valid format")
        repeat, kind = int(match[1] or "1"), match[2]
        if kind in "PQ" and repeat:
            yield _text(header.get(f"TTYPE{field}", "")).upper(), offset, kind == "Q"
        offset += -(-repeat // 8) if kind == "X" else repeat * _WIDTH[kind]


def _tiles(
    stream: BinaryIO, header: dict[str, str], number: int, start: int, offset: int, wide: bool
) -> Iterator[bytes]:
    """Stored bytes of the tiles of a column."""
    row, rows, heap = int(header["NAXIS1"]), int(header["NAXIS2"]), int(header.get("PCOUNT", "0"))
    size = 8 if wide else 4
    stream.seek(start)
    table = stream.read(row * rows)
    before = int(header.get("THEAP", str(row * rows))) - row * rows
    for at in range(offset, len(table), max(row, 1)):
        count = int.from_bytes(table[at : at + size], "big")
        position = int.from_bytes(table[at + size : at + 2 * size], "big")
        if before < 0 or before + position + count > heap:
            raise ConfigError(f"header {number}: a compressed tile lies outside its table")
        stream.seek(start + row * rows + before + position)
        yield stream.read(count)


def _unpacks_within(content: bytes, most: int) -> bool:
    """Whether all members of a gzip stream together unpack within a number of bytes; damage is left to the reader."""
    while content:
        unpack = zlib.decompressobj(_GZIP_OR_ZLIB)
        try:
            most -= len(unpack.decompress(content, most + 1))
        except zlib.error:
            return True
        if most < 0:
            return False
        content = unpack.unused_data
    return True


def _reason(error: BaseException) -> str:
    if "verification failed" in str(error):
        return (
            f"{str(error).strip()} It was damaged or edited since it was written: copy it again or remove the "
            "checksum cards"
        )
    return " ".join(str(error).split())[:160] or type(error).__name__
