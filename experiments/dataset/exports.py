"""Exports for machine learning: COCO (PNG images, objects with box, mask and one keypoint) and WebDataset (tar files).

COCO counts from the outer corner of the first pixel, whose centre therefore is (0.5, 0.5)
(https://cocodataset.org/#format-data; the same as Mitsuba's film): half a pixel more than ``photon_x_px`` and
``photon_y_px`` of the truth. Masks are uncompressed run lengths over the columns, readable by ``pycocotools``: the
ellipse of a star's footprint, the disk of a body, the pixels of detector faults.

WebDataset: samples of image, truth, record and FITS file, one series of shards per split, for streaming. The image is a
NumPy array (key ``npy``), which webdataset, datasets and torch read as 16 bits, first row first. Through PIL they would
flip FITS, ignore BZERO, and reduce 16-bit PNG to 8 bits; the FITS file therefore has the key ``fts``, another suffix of
the standard, which they pass on as bytes.
"""

from __future__ import annotations

import io
import json
import os
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calib.measure.detection.footprints import footprint_px
from experiments.dataset.folder import storage_error, write_whole
from experiments.dataset.labels import CLASSES, Label, pixels_of_ellipse
from experiments.dataset.scene import LAST_PLANET_ID
from experiments.dataset.truth import FLAGS, FrameRecord
from experiments.dataset.truth_files import read_table
from optics.errors import ConfigError
from optics.frames import pixel_to_mitsuba
from render.fits.files import read_frame
from render.fits.preview import stretched
from render.sky.partition import GAP, PARTS

COCO, WEBDATASET = "coco", "webdataset"
FRAMES_PER_SHARD = 1000
"""Frame numbers per shard number, over all splits: an extended dataset leaves complete shards unchanged."""
_IDS = {name: number for number, name in enumerate(CLASSES, start=1)}
_CATEGORIES = [
    {
        "id": number,
        "name": name,
        "supercategory": "sky" if name in ("star", "planet", "moon") else "detector",
        "keypoints": ["centre"],
        "skeleton": [],
    }
    for name, number in _IDS.items()
]


def export_coco(
    folder: Path,
    records: Sequence[FrameRecord],
    *,
    diffusion_px: float,
    bits: int,
    labels: Callable[[int], Sequence[Label]],
    about: Mapping[str, str],
    done: Callable[[], None],
) -> str:
    """Write ``coco/images/frame_000123.png`` and ``coco/annotations/instances_SPLIT.json``."""
    root = folder / COCO
    try:
        for part in ("images", "annotations"):
            (root / part).mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise storage_error(root, error) from None
    content: dict[str, dict[str, list[Any]]] = {split: {"images": [], "annotations": []} for split in (*PARTS, GAP)}
    objects, number = Counter[int](), 0
    for record in records:
        image = _image(folder, root, record, bits)
        content[record.split]["images"].append(image)
        stars = _stars(read_table(folder / record.truth), image, diffusion_px)
        for annotation in (*stars, *(_label(label, image) for label in labels(record.frame))):
            number += 1
            content[record.split]["annotations"].append({"id": number, **annotation})
            objects[annotation["category_id"]] += 1
        done()
    licences = [{"id": 1, "name": about["licence"], "url": about["licence_url"]}]
    for split, entries in content.items():
        if split == GAP and not entries["images"]:
            continue
        info = {"description": f"{about['title']}, {split}", "version": about["version"]}
        info |= {"contributor": about["citation"], "url": ""}
        text = json.dumps({"info": info, "licenses": licences, "categories": _CATEGORIES, **entries})
        write_whole(root / "annotations" / f"instances_{split}.json", text.encode())
    counts = ", ".join(f"{objects[k]} of class {name}" for name, k in _IDS.items() if objects[k])
    return f"{len(records)} PNG files of {bits} bit in {COCO}/; objects: {counts or 'none'}"


def _image(folder: Path, root: Path, record: FrameRecord, bits: int) -> dict[str, Any]:
    """Write the PNG file; its entry among the images."""
    from PIL import Image

    name = f"frame_{record.frame:06d}.png"
    dn = read_frame(folder / record.file).dn
    pixels = dn if bits == 16 else np.rint(255.0 * stretched(dn.astype(np.float32))).astype(np.uint8)
    buffer = io.BytesIO()
    Image.fromarray(pixels).save(buffer, format="PNG", compress_level=1)
    write_whole(root / "images" / name, buffer.getvalue())
    return {
        "id": record.frame,
        "file_name": name,
        "width": dn.shape[1],
        "height": dn.shape[0],
        "license": 1,
        "ra_deg": record.ra_deg,
        "dec_deg": record.dec_deg,
        "roll_deg": record.roll_deg,
        "quat_xyzw": list(record.quat_xyzw),
        "exposure_s": record.exposure_s,
    }


def _stars(truth: Any, image: dict[str, Any], diffusion_px: float) -> Iterator[dict[str, Any]]:
    """Annotations of the stars of which light reaches the detector and whose centroid lies on it."""
    x, y = (np.asarray(truth[f"photon_{axis}_px"]) for axis in "xy")
    half_x, half_y = footprint_px(truth["variance_x_px2"], truth["variance_y_px2"], diffusion_px)
    corner_x, corner_y = pixel_to_mitsuba(x, y)
    width, height = image["width"], image["height"]
    lit = (np.asarray(truth["flags"]) & FLAGS["no_light"][0]) == 0
    lit &= (corner_x >= 0) & (corner_y >= 0) & (corner_x <= width) & (corner_y <= height)
    for i in np.flatnonzero(lit):
        left, right = np.clip([corner_x[i] - half_x[i], corner_x[i] + half_x[i]], 0, width)
        top, bottom = np.clip([corner_y[i] - half_y[i], corner_y[i] + half_y[i]], 0, height)
        pixels = pixels_of_ellipse(float(x[i]), float(y[i]), float(half_x[i]), float(half_y[i]), (height, width))
        kind = "star" if truth["star_id"][i] > LAST_PLANET_ID else "planet"
        yield _annotation(image, kind, (left, top, right - left, bottom - top), pixels, corner_x[i], corner_y[i]) | {
            "star_id": int(truth["star_id"][i]),
            "magnitude": float(truth["magnitude"][i]),
            "electrons": float(truth["electrons"][i]),
            "snr": float(truth["snr"][i]),
            "flags": int(truth["flags"][i]),
        }


def _label(label: Label, image: dict[str, Any]) -> dict[str, Any]:
    """Annotation of an object other than a star."""
    x, y = pixel_to_mitsuba(np.array([label.x_px]), np.array([label.y_px]))
    attributes: dict[str, Any] = {"name": label.name} if label.name else {}
    if np.isfinite(label.electrons):
        attributes["electrons"] = label.electrons
    return _annotation(image, label.kind, label.box_px, label.pixels, x[0], y[0]) | attributes


def _annotation(
    image: dict[str, Any], kind: str, box: Sequence[float], pixels: NDArray[np.int64], x: float, y: float
) -> dict[str, Any]:
    return {
        "image_id": image["id"],
        "category_id": _IDS[kind],
        "bbox": [round(float(v), 4) for v in box],
        "area": pixels.shape[1],
        "segmentation": _run_lengths(pixels, image["height"], image["width"]),
        "iscrowd": 0,
        "keypoints": [float(x), float(y), 2],
        "num_keypoints": 1,
    }


def _run_lengths(pixels: NDArray[np.int64], height: int, width: int) -> dict[str, Any]:
    """Mask of rows and columns (2, n) as COCO's run lengths: outside, inside, outside ..., column after column."""
    index = np.sort(pixels[1] * height + pixels[0])
    starts = index[np.diff(index, prepend=-2) > 1]
    ends = index[np.diff(index, append=height * width + 1) > 1] + 1
    edges = np.stack([starts, ends], axis=1).ravel()
    return {"size": [height, width], "counts": np.diff(edges, prepend=0, append=height * width).tolist()}


def check_webdataset() -> Any:
    """The library webdataset; ConfigError without it."""
    try:
        import webdataset
    except ImportError:
        raise ConfigError(
            "exports = webdataset needs the package webdataset; pip install 'starbench[export]', or leave it out"
        ) from None
    return webdataset


def export_shards(folder: Path, records: Sequence[FrameRecord], *, done: Callable[[], None]) -> str:
    """Write ``webdataset/SPLIT-000000.tar``: per sample ``npy`` (uint16), ``json`` (record), the truth, and ``fts``."""
    webdataset = check_webdataset()
    root = folder / WEBDATASET
    shards: dict[str, list[FrameRecord]] = {}
    for record in records:
        shards.setdefault(f"{record.split}-{record.frame // FRAMES_PER_SHARD:06d}.tar", []).append(record)
    try:
        root.mkdir(exist_ok=True)
        for partial in root.glob(".*.tar.*.partial"):  # of a killed run
            partial.unlink()
        for name, members in shards.items():
            _shard(webdataset, folder, root / name, members, done)
    except OSError as error:
        raise storage_error(root, error) from None
    return f"{len(shards)} shards in {WEBDATASET}/"


def _shard(webdataset: Any, folder: Path, path: Path, members: Sequence[FrameRecord], done: Callable[[], None]) -> None:
    temporary = path.with_name(f".{path.name}.{os.getpid()}.partial")
    try:
        with temporary.open("wb") as stream:
            writer = webdataset.TarWriter(stream, user="", group="", mtime=0.0, encoder=False)
            for record in members:
                array = io.BytesIO()
                np.save(array, read_frame(folder / record.file).dn, allow_pickle=False)
                sample = {
                    "__key__": f"frame_{record.frame:06d}",
                    "npy": array.getvalue(),
                    "json": record.to_text().encode(),
                    Path(record.truth).suffix[1:]: (folder / record.truth).read_bytes(),
                    "fts": (folder / record.file).read_bytes(),
                }
                writer.write(sample)
                done()
            writer.close()
        os.replace(temporary, path)
    finally:
        with suppress(OSError):
            temporary.unlink()
