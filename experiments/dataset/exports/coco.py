"""COCO export: frames as PNG, what they show as objects with box, mask and one keypoint, one JSON file per split.

Masks are uncompressed run lengths over the columns, which ``pycocotools`` reads as they are: of a star the ellipse that
its footprint fills, of a body its disk, of detector faults their pixels.

COCO counts from the outer corner of the first pixel, whose centre therefore is (0.5, 0.5)
(https://cocodataset.org/#format-data; the same as Mitsuba's film): half a pixel more than ``photon_x_px`` and
``photon_y_px`` of the truth.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from experiments.dataset.exports.contact_sheet import stretched
from experiments.dataset.frames.sky_light import LAST_PLANET_ID
from experiments.dataset.frames.splits import GAP, SPLITS
from experiments.dataset.production.folder import storage_error, write_whole
from experiments.dataset.truth.files import read_table
from experiments.dataset.truth.frame_record import FrameRecord
from experiments.dataset.truth.labels import CLASSES, Label, pixels_of_ellipse
from experiments.dataset.truth.star_truth import FLAGS, footprint_px
from optics.frames import pixel_to_mitsuba

__all__ = ["export_coco"]

FOLDER = "coco"
_SKY = ("star", "planet", "moon")
_CATEGORIES = [
    {
        "id": number,
        "name": name,
        "supercategory": "sky" if name in _SKY else "detector",
        "keypoints": ["centre"],
        "skeleton": [],
    }
    for number, name in enumerate(CLASSES, start=1)
]
_ID = {name: number for number, name in enumerate(CLASSES, start=1)}


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
    root = folder / FOLDER
    try:
        for part in ("images", "annotations"):
            (root / part).mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise storage_error(root, error) from None
    content: dict[str, dict[str, list[Any]]] = {split: {"images": [], "annotations": []} for split in (*SPLITS, GAP)}
    count, found = 0, Counter[int]()
    for one in records:
        held = content[one.split]
        image = _image(folder, root, one, bits)
        stars = _stars(read_table(folder / one.truth), one, image, diffusion_px, first=count + 1)
        others = [_other(one, label, image, count + len(stars) + k) for k, label in enumerate(labels(one.frame), 1)]
        held["images"].append(image)
        held["annotations"].extend([*stars, *others])
        found = found + Counter(annotation["category_id"] for annotation in (*stars, *others))
        count += len(stars) + len(others)
        done()
    for split, held in content.items():
        if split == GAP and not held["images"]:
            continue
        info = {
            "description": f"{about['title']}, {split}",
            "version": about["version"],
            "contributor": about["citation"],
            "url": "",
        }
        licences = [{"id": 1, "name": about["licence"], "url": about["licence_url"]}]
        text = json.dumps({"info": info, "licenses": licences, "categories": _CATEGORIES, **held})
        write_whole(root / "annotations" / f"instances_{split}.json", text.encode())
    said = ", ".join(f"{found[number]} of class {name}" for name, number in _ID.items() if found[number])
    return f"{len(records)} PNG files of {bits} bit in {FOLDER}/; objects: {said or 'none'}"


def _image(folder: Path, root: Path, one: FrameRecord, bits: int) -> dict[str, Any]:
    """The image's entry; the picture is written unless it is there."""
    import io

    from PIL import Image

    from render.fits.files import read_frame

    name = f"frame_{one.frame:06d}.png"
    path = root / "images" / name
    dn = read_frame(folder / one.file).dn
    pixels = dn if bits == 16 else np.rint(255.0 * stretched(dn.astype(np.float32))).astype(np.uint8)
    buffer = io.BytesIO()
    Image.fromarray(pixels).save(buffer, format="PNG", compress_level=1)
    write_whole(path, buffer.getvalue())
    return {
        "id": one.frame,
        "file_name": name,
        "width": dn.shape[1],
        "height": dn.shape[0],
        "license": 1,
        "ra_deg": one.ra_deg,
        "dec_deg": one.dec_deg,
        "roll_deg": one.roll_deg,
        "quat_xyzw": list(one.quat_xyzw),
        "exposure_s": one.exposure_s,
    }


def _stars(truth: Any, one: FrameRecord, image: dict[str, Any], diffusion_px: float, *, first: int) -> list[Any]:
    """Annotations of the stars of which light reaches the detector and whose centroid lies on it."""
    x, y = (np.asarray(truth[f"photon_{axis}_px"]) for axis in "xy")
    half_x, half_y = footprint_px(truth["variance_x_px2"], truth["variance_y_px2"], diffusion_px)
    corner_x, corner_y = pixel_to_mitsuba(x, y)
    width, height = image["width"], image["height"]
    lit = (np.asarray(truth["flags"]) & FLAGS["no_light"][0]) == 0
    lit &= (corner_x >= 0) & (corner_y >= 0) & (corner_x <= width) & (corner_y <= height)
    found: list[Any] = []
    for i in np.flatnonzero(lit):
        pixels = pixels_of_ellipse(float(x[i]), float(y[i]), float(half_x[i]), float(half_y[i]), (height, width))
        left, right = np.clip([corner_x[i] - half_x[i], corner_x[i] + half_x[i]], 0, width)
        top, bottom = np.clip([corner_y[i] - half_y[i], corner_y[i] + half_y[i]], 0, height)
        found.append(
            {
                "id": first + len(found),
                "image_id": one.frame,
                "category_id": _ID["star" if truth["star_id"][i] > LAST_PLANET_ID else "planet"],
                "bbox": [round(float(v), 4) for v in (left, top, right - left, bottom - top)],
                "area": pixels.shape[1],
                "segmentation": _run_lengths(pixels, height, width),
                "iscrowd": 0,
                "keypoints": [float(corner_x[i]), float(corner_y[i]), 2],
                "num_keypoints": 1,
                "star_id": int(truth["star_id"][i]),
                "magnitude": float(truth["magnitude"][i]),
                "electrons": float(truth["electrons"][i]),
                "snr": float(truth["snr"][i]),
                "flags": int(truth["flags"][i]),
            }
        )
    return found


def _other(one: FrameRecord, label: Label, image: dict[str, Any], number: int) -> dict[str, Any]:
    """Annotation of what is no star."""
    x, y = pixel_to_mitsuba(np.array([label.x_px]), np.array([label.y_px]))
    entry: dict[str, Any] = {
        "id": number,
        "image_id": one.frame,
        "category_id": _ID[label.kind],
        "bbox": [round(v, 4) for v in label.box_px],
        "area": label.pixels.shape[1],
        "segmentation": _run_lengths(label.pixels, image["height"], image["width"]),
        "iscrowd": 0,
        "keypoints": [float(x[0]), float(y[0]), 2],
        "num_keypoints": 1,
    }
    if label.name:
        entry["name"] = label.name
    if np.isfinite(label.electrons):
        entry["electrons"] = label.electrons
    return entry


def _run_lengths(pixels: NDArray[np.int64], height: int, width: int) -> dict[str, Any]:
    """Mask of rows and columns (2, n) as COCO's run lengths: outside, inside, outside ..., column after column."""
    place = np.sort(pixels[1] * height + pixels[0])
    first = np.flatnonzero(np.diff(place, prepend=-2) > 1)
    ends = np.append(first[1:], len(place)) - 1 if len(place) else first
    edges = np.stack([place[first], place[ends] + 1], axis=1).ravel()
    counts = np.diff(edges, prepend=0, append=height * width)
    return {"size": [height, width], "counts": counts.tolist()}
