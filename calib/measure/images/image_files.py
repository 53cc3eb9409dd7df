"""Pixel values of image files, with their digital steps: TIFF, PNG, JPEG, PGM and PPM, NumPy, FITS.

The first bytes determine the format, not the name. Values are not scaled, stretched or rounded: 16 bits stay 16 bits.
Gamma curve, white balance or compression applied by the camera cannot be undone, and are reported.
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calib.measure.images.exposure_time import exif_time, header_time
from calib.records import Conversion, ExposureTime
from optics.errors import ConfigError, StarbenchError
from optics.fits import located, open_fits, unpacked

MOST_PIXELS = 1 << 28
"""Largest number of pixels, 2 GB as float64; a header can announce any number."""
FEWEST_CODES = 8
"""Fewest different numbers for which a common step is significant."""
PILED_UP, PILED_OVER = 8, 10.0
"""Pixels at the highest number, and their ratio to those within 5 % below it, that show a level of saturation."""
_EXPOSURE_KEYS = ("EXPTIME", "EXPOSURE", "XPOSURE")  # s
_EXIF_TABLE, _GPS_TABLE = 0x8769, 0x8825
_WHITE_IS_ZERO, _PALETTE, _SEPARATE = 0, 3, 2  # photometric interpretation, planar configuration (TIFF 6.0)
_NETPBM = re.compile(rb"P([2356])" + 3 * rb"(?:\s|#[^\n]*\n)+(\d{1,9})" + rb"\s")
"""Format, columns, rows and full scale; comments anywhere (netpbm.sourceforge.net/doc/pgm.html)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class StoredPixels:
    """Contents of a file, unchanged."""

    values: NDArray[Any]  # (h, w), or (h, w, colours), in the stored type
    opaque: NDArray[np.bool_] | None = None  # (h, w) Where an alpha channel is not 0
    kind: str  # Name of the format
    header: Any = field(default_factory=dict)  # Of a FITS file
    full: float | None = None  # Full scale, if the file states one other than its type's
    exposure_s: float | None = None
    taken: ExposureTime | None = None


def load_pixels(path: str | Path, *, hdu: int | str | None = None, plane: int | None = None) -> StoredPixels:
    """Pixels of a file; every failure is a message of one line with the name of the file."""
    path = located(path)
    if isinstance(path, str):  # a URL, which `open_fits` reads
        return _fits(path, hdu, plane)
    if not path.is_file():
        fault = "no such file" if not path.exists() else "a folder" if path.is_dir() else "no regular file"
        raise ConfigError(f"{path}: {fault}")
    with path.open("rb") as stream:
        start = stream.read(16)
    if not start:
        raise ConfigError(f"{path}: the file is empty")
    reader, kind = _reader(start)
    if reader is None:
        return _fits(path, hdu, plane)
    if hdu is not None:
        raise ConfigError(f"{path}: hdu = {hdu!r}, but {kind} files have no extensions")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of pixels per inch, odd tags, sizes
            return reader(path, plane)
    except StarbenchError:
        raise
    except Exception as error:  # readers raise a dozen kinds on damaged files
        reason = " ".join(str(error).split())[:160] or type(error).__name__
        raise ConfigError(f"{path}: not a readable {kind} file ({reason})") from None


def _reader(start: bytes) -> tuple[Callable[[Path, int | None], StoredPixels] | None, str]:
    if start.startswith((b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")):
        return _tiff, "TIFF"
    if re.match(rb"P[2356][\s#]", start):
        return _netpbm, "PGM or PPM"
    if start.startswith((b"\x89PNG\r\n\x1a\n", b"\xff\xd8\xff", b"BM", b"GIF8")):
        return _picture, {0x89: "PNG", 0xFF: "JPEG"}.get(start[0], "picture")
    if start.startswith((b"\x93NUMPY", b"PK\x03\x04")):
        return _numpy, "NumPy"
    return None, "FITS"


def _tiff(path: Path, plane: int | None) -> StoredPixels:
    import tifffile

    with tifffile.TiffFile(path) as file:
        pages = [page for page in file.pages if not getattr(page, "is_reduced", False)] or list(file.pages)
        page = pages[_plane(path, len(pages), plane)]
        if "DNGVersion" in getattr(page, "tags", ()):
            raise ConfigError(f"{path}: a raw file (DNG); develop it to a linear 16-bit TIFF first")
        _check_size(path, page.imagewidth, page.imagelength)
        for start, size in zip(page.dataoffsets, page.databytecounts, strict=False):
            if start + size > path.stat().st_size:
                raise ConfigError(f"{path}: the file ends within the pixel data: it is truncated")
        try:
            values = page.asarray()
        except ValueError:  # a compression for which tifffile needs imagecodecs; Pillow reads the common ones
            if page.dtype != np.uint8 and page.samplesperpixel > 1:
                raise ConfigError(
                    f"{path}: colours of {page.dtype} compressed ({page.compression!r}); save it uncompressed"
                ) from None
            return _picture(path, plane)
        if page.photometric == _PALETTE:
            return _picture(path, plane)
        if page.planarconfig == _SEPARATE and values.ndim == 3:
            values = np.moveaxis(values, 0, -1)
        if page.photometric == _WHITE_IS_ZERO:
            values = np.iinfo(values.dtype).max - values
        tags: dict[str, Any] = {
            page.tags[code].name: page.tags[code].value for code in (306, 33434) if code in page.tags
        }
        for table in (_EXIF_TABLE, _GPS_TABLE):
            tags |= dict(page.tags[table].value) if table in page.tags else {}
    values, opaque = _colours(path, values)
    return StoredPixels(values=values, opaque=opaque, kind="TIFF", **_times(tags))


def _times(tags: Mapping[str, Any]) -> dict[str, Any]:
    """Exposure time and time of EXIF or TIFF tags, name -> value."""
    exposure = tags.get("ExposureTime")
    if isinstance(exposure, tuple):
        exposure = exposure[0] / exposure[1] if exposure[1] else None
    seconds = _positive(exposure)
    return {"exposure_s": seconds, "taken": exif_time(tags, seconds)}


def _netpbm(path: Path, plane: int | None) -> StoredPixels:
    """PGM and PPM in their steps, which Pillow stretches to 8 or 16 bits."""
    content = path.read_bytes()
    match = _NETPBM.match(content)
    if match is None:
        raise ConfigError(f"{path}: not a readable PGM or PPM file (its header is damaged)")
    _plane(path, 1, plane)
    kind, (columns, rows, full) = int(match[1]), (int(number) for number in match.groups()[1:])
    _check_size(path, columns, rows)
    if not 0 < full < 65536:
        raise ConfigError(f"{path}: full scale {full}; 1 to 65535 is allowed")
    shape = (rows, columns, 3) if kind in (3, 6) else (rows, columns)
    count, width = int(np.prod(shape)), 1 if full < 256 else 2
    if kind in (2, 3):
        words = re.sub(rb"#[^\n]*", b"", content[match.end() :]).split(maxsplit=count)
        values = np.array(words[:count], np.int64)
    else:
        values = np.frombuffer(content[match.end() : match.end() + count * width], f">u{width}")
    if values.size < count:
        raise ConfigError(f"{path}: the file ends within the pixel data: it is truncated")
    if not 0 <= values.min() <= values.max() <= full:
        raise ConfigError(f"{path}: values from {values.min()} to {values.max()}; full scale is {full}")
    values = values.astype(f"u{width}").reshape(shape)
    stated = None if full in (255, 65535) else float(full)  # else the type's, whatever the depth
    return StoredPixels(values=values, kind="PGM" if values.ndim == 2 else "PPM", full=stated)


def _picture(path: Path, plane: int | None) -> StoredPixels:
    from PIL import ExifTags, Image

    with Image.open(path) as file:
        kind = "JPEG" if file.format == "MPO" else str(file.format)
        _check_size(path, *file.size)
        number = _plane(path, 1 if file.format == "MPO" else getattr(file, "n_frames", 1), plane)
        if number:
            file.seek(number)
        exif = file.getexif()
        shot = {**exif, **exif.get_ifd(_EXIF_TABLE)}
        tags = {ExifTags.TAGS.get(code, ""): value for code, value in shot.items()}
        tags |= {ExifTags.GPSTAGS.get(code, ""): value for code, value in exif.get_ifd(_GPS_TABLE).items()}
        if kind == "PNG" and _png_bits(path) == (16, True):
            values = _deep_png(path)
        else:
            plain = {"1": "L", "P": "RGBA" if "transparency" in file.info else "RGB", "PA": "RGBA"}
            numeric = file.mode in ("L", "LA", "RGB", "RGBA", "I", "F") or file.mode.startswith("I;16")
            values = np.asarray(file if numeric else file.convert(plain.get(file.mode, "RGB")))
    if kind == "PNG" and values.dtype == np.int32:  # 16 bits of older versions of Pillow
        values = values.astype(np.uint16)
    values, opaque = _colours(path, values)
    return StoredPixels(values=values, opaque=opaque, kind=kind, **_times(tags))


def _png_bits(path: Path) -> tuple[int, bool]:
    """Bits per sample, and whether a pixel has several samples (PNG specification, IHDR)."""
    with path.open("rb") as stream:
        header = stream.read(26)
    return header[24], header[25] != 0


def _deep_png(path: Path) -> NDArray[Any]:
    """Colours of 16 bits, which Pillow would cut to 8."""
    try:
        import cv2
    except ImportError:
        raise ConfigError(
            f"{path}: a 16 bit colour PNG, of which Pillow reads 8 bits; save it as TIFF, or pip install "
            "opencv-python-headless"
        ) from None
    values = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    if values is None:
        raise ConfigError(f"{path}: not a readable PNG file (damaged or cut off)")
    return values if values.ndim == 2 else values[:, :, [2, 1, 0, 3][: values.shape[2]]]


def _numpy(path: Path, plane: int | None) -> StoredPixels:
    loaded = np.load(path, allow_pickle=False, mmap_mode="r")
    if not isinstance(loaded, np.ndarray):
        with loaded:
            names = loaded.files
            if len(names) != 1:
                raise ConfigError(f"{path}: holds {len(names)} arrays ({', '.join(names[:5])}); one is needed")
            loaded = loaded[names[0]]
    if loaded.dtype.kind not in "uif":
        raise ConfigError(f"{path}: holds an array of {loaded.dtype}; numbers are needed")
    if loaded.ndim > 2 and loaded.shape[-1] > 4:
        cube = loaded.reshape(-1, *loaded.shape[-2:])
        loaded = cube[_plane(path, len(cube), plane)]
    _check_size(path, *loaded.shape[:2])
    values, opaque = _colours(path, np.array(loaded))
    return StoredPixels(values=values, opaque=opaque, kind="NumPy")


def _fits(path: Path | str, hdu: int | str | None, plane: int | None) -> StoredPixels:
    if isinstance(path, Path) and (content := _head(path)) is not None and b"SIMPLE" not in content:
        raise ConfigError(f"{path}: no image: neither TIFF, PNG, JPEG, PGM, PPM, NumPy nor a readable FITS file")
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
        cards = {**_readable_cards(file[0].header), **dict(header)}  # parses every value: faults are reported here
    if data is None or not isinstance(data, np.ndarray) or data.dtype.kind not in "iuf":
        raise ConfigError(f"{path}: extension {hdu if hdu is not None else 0} holds no image")
    if data.ndim > 2:
        data = data.reshape(-1, *data.shape[-2:])
        data = data[_plane(path, len(data), plane)]
    if data.ndim != 2 or data.size == 0:
        raise ConfigError(f"{path}: image has shape {data.shape}; two dimensions and at least one pixel are needed")
    exposure_s = next((seconds for key in _EXPOSURE_KEYS if (seconds := _positive(cards.get(key)))), None)
    taken = header_time(cards, exposure_s)
    return StoredPixels(values=data, kind="FITS", header=header, exposure_s=exposure_s, taken=taken)


def _readable_cards(header: Any) -> dict[str, Any]:
    """Values of the primary header, which hold for its extensions too."""
    cards = {}
    for card in header.cards:
        with suppress(Exception):  # of damaged cards
            cards[card.keyword] = card.value
    return cards


def _head(path: Path) -> bytes | None:
    """First bytes of the unpacked content of a file."""
    content = unpacked(path)
    if content is not None:
        return content[:80]
    with path.open("rb") as stream:
        return stream.read(80)


def _plane(path: Path | str, count: int, plane: int | None) -> int:
    if plane is None and count > 1:
        raise ConfigError(f"{path}: holds a cube of {count} images; choose a plane, 0 to {count - 1} (--plane 0)")
    if plane is not None and not 0 <= plane < count:
        raise ConfigError(f"{path}: plane {plane} of {count}; choose 0 to {count - 1}")
    return plane or 0


def _check_size(path: Path, width: int, height: int) -> None:
    if not 0 < width * height <= MOST_PIXELS:
        raise ConfigError(f"{path}: {width} x {height} px; 1 to {MOST_PIXELS} pixels are read")


def _colours(path: Path, values: NDArray[Any]) -> tuple[NDArray[Any], NDArray[np.bool_] | None]:
    """Colours, and where the alpha channel is opaque."""
    if values.dtype.kind not in "uif" or values.ndim not in (2, 3) or (values.ndim == 3 and values.shape[2] > 4):
        raise ConfigError(
            f"{path}: {values.dtype} of shape {values.shape}; rows, columns and at most 4 colours are read"
        )
    if values.ndim == 2:
        return values, None
    opaque = values[:, :, -1] > 0 if values.shape[2] in (2, 4) else None
    colours = values[:, :, : 3 if values.shape[2] > 2 else 1]
    return (colours[:, :, 0] if colours.shape[2] == 1 else colours), opaque


def _positive(value: Any) -> float | None:
    try:
        number = float(value)
    except (TypeError, ValueError, ZeroDivisionError):
        return None
    return number if np.isfinite(number) and number > 0 else None


def converter_steps(values: NDArray[Any], kind: str = "array") -> Conversion:
    """Step and saturation level of whole numbers (h, w) or (h, w, colours) of a format.

    Converters of 10 to 14 bits are stored in the upper bits of 16, with zeros below (steps of 4 to 64) or with the
    upper bits repeated there (65535 is full); a digital gain multiplies all numbers. The step is the greatest common
    divisor of all differences except that of the full code, which some cameras set to 65535 for any step.
    """
    bits = 8 * values.dtype.itemsize
    if values.dtype.kind not in "ui" or bits > 16:
        return Conversion(kind=kind, stored=str(values.dtype))
    lowest, end = int(np.iinfo(values.dtype).min), int(np.iinfo(values.dtype).max)
    counts = np.bincount((values.ravel().astype(np.int64) - lowest) if lowest else values.ravel(), minlength=1)
    codes = np.flatnonzero(counts) + lowest
    counts = counts[codes - lowest]
    below = codes[codes < end]
    step, repeated = 1, False
    if len(below) >= FEWEST_CODES:
        step = int(np.gcd.reduce(below - below[0]))
        deep = [n for n in range(8, bits) if np.array_equal(codes, _repeated(codes >> (bits - n), n, bits))]
        if lowest == 0 and deep and (step == 1 or np.any(below % step)):
            step, repeated = 1 << (bits - deep[0]), True
    full: float | None = float(end - end % step) if lowest == 0 else None
    top = int(codes[-1])
    beyond = int(counts[codes > 0.95 * top].sum() - counts[-1])
    usual = top // step + 1 in {1 << n for n in (10, 12, 14)} and counts[-1] > 1
    piled = counts[-1] >= PILED_UP and counts[-1] > PILED_OVER * beyond and counts[-1] < 0.05 * values.size
    if len(codes) > 1 and (full is None or top < full) and (usual or (piled and top > 4.0 * np.median(values))):
        full = float(top)
    return Conversion(kind=kind, stored=str(values.dtype), step=float(step), repeated=repeated, full=full)


def _repeated(codes: NDArray[np.int64], depth: int, bits: int) -> NDArray[np.int64]:
    """Codes of ``depth`` bits in the upper ones of ``bits``, and again in those below."""
    upper = codes << (bits - depth)
    return np.asarray(upper | (upper >> depth))
