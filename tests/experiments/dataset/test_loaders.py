"""Exports as the usual loaders read them, pixel by pixel and label by label; the recipes of the data card are run.

Oracle: the FITS files by astropy and the truth by pyarrow, which have nothing to do with the exports.
"""

from __future__ import annotations

import io
import json

import numpy as np
import pyarrow.parquet as pq
import pytest
from astropy.io import fits

from experiments.dataset.settings import main

pytestmark = [
    pytest.mark.reference,
    pytest.mark.slow,
    pytest.mark.filterwarnings("default"),  # the loaders' own: what they use is deprecated, or has no GPU
]

FRAMES = 8
SETTINGS = [
    "instrument.lens=star_tracker_26mm",
    "instrument.width_px=512",
    "instrument.height_px=256",
    "nodes=3",
    "catalogue.faintest_mag=10",
    "verify.frames=0",
    "pointing.kind=cone",
    "pointing.ra_deg=56.75",
    "pointing.dec_deg=24.12",
    "pointing.radius_deg=0.1",
    "radiation.displacement_dose_tev_per_g=500",
    "instrument.chip_temperature_c=30",
    'exports=["coco", "webdataset"]',
    'card.title=Seven | "<sisters>"',
    "splits.train_fraction=0.5",
    "splits.validation_fraction=0.25",
    "splits.test_fraction=0.25",
]


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    """Eight frames of the Pleiades by a warm, damaged detector, with both exports."""
    folder = tmp_path_factory.mktemp("loaders") / "one"
    options = [part for one in SETTINGS for part in ("--set", one)]
    assert main([*options, "--frames", str(FRAMES), "--workers", "1", "--out", str(folder)]) == 0
    return folder


@pytest.fixture(scope="module")
def shots(dataset):
    """Pixels and stars of every frame, by split and key."""
    index = pq.read_table(dataset / "index.parquet").to_pylist()
    found = {}
    for one in index:
        pixels = fits.getdata(dataset / one["file"])
        found.setdefault(one["split"], {})[f"frame_{one['frame']:06d}"] = pixels, pq.read_table(dataset / one["truth"])
    assert sum(map(len, found.values())) == FRAMES
    assert len(found) == 3
    return found


def recipe(folder, word, **names):
    """Run the block of the data card that holds a word."""
    blocks = [part.partition("```")[0] for part in (folder / "README.md").read_text().split("```python\n")[1:]]
    (block,) = [one for one in blocks if word in one]
    exec(block, names)
    return names


def check(pixels, stars, shot):
    """The same image, and labels that lie on its light."""
    expected, truth = shot
    np.testing.assert_array_equal(np.asarray(pixels), expected)
    assert np.asarray(pixels).max() > 3000  # not one grey all over
    assert stars.equals(truth)
    table = {name: truth[name].to_numpy() for name in ("photon_x_px", "photon_y_px", "electrons")}
    bright = np.argmax(table["electrons"])
    x, y = round(table["photon_x_px"][bright]), round(table["photon_y_px"][bright])
    assert np.asarray(pixels)[y, x] > 0.9 * np.asarray(pixels)[max(y - 3, 0) : y + 4, max(x - 3, 0) : x + 4].max()


@pytest.mark.parametrize("how", ["", "pil", "rgb8", "torchrgb"])
def test_webdataset(dataset, shots, how):
    """However images are to be decoded: `pil` made a uniform picture of FITS, turned over."""
    webdataset = pytest.importorskip("webdataset")
    if how.startswith("torch"):
        pytest.importorskip("torch")
    for split, expected in shots.items():
        shard = str(dataset / "webdataset" / f"{split}-000000.tar")
        samples = list(webdataset.WebDataset(shard, shardshuffle=False).decode(*([how] if how else [])))
        assert {one["__key__"] for one in samples} == set(expected)
        for one in samples:
            check(one["npy"], pq.read_table(io.BytesIO(one["parquet"])), expected[one["__key__"]])
            assert one["npy"].dtype == np.uint16
            assert one["json"]["split"] == split
            np.testing.assert_array_equal(fits.getdata(io.BytesIO(one["fts"])), expected[one["__key__"]][0])


def test_hugging_face(dataset, shots, tmp_path):
    datasets = pytest.importorskip("datasets")
    datasets.disable_progress_bars()
    loaded = datasets.load_dataset(str(dataset), cache_dir=str(tmp_path))
    assert set(loaded) == set(shots)
    for split, expected in shots.items():
        assert [one["__key__"] for one in loaded[split]] == sorted(expected)
        for one in loaded[split].with_format("numpy"):
            check(one["npy"], pq.read_table(io.BytesIO(one["parquet"])), expected[str(one["__key__"])])


def test_torch(dataset, shots, monkeypatch):
    torch = pytest.importorskip("torch")
    pytest.importorskip("webdataset")
    monkeypatch.chdir(dataset)
    loader = recipe(dataset, "DataLoader")["loader"]
    seen = list(loader)
    assert len(seen) == len(shots["train"])
    for (image, stars), (pixels, truth) in zip(seen, shots["train"].values(), strict=True):
        assert isinstance(loader, torch.utils.data.DataLoader)
        np.testing.assert_array_equal(image.numpy(), pixels.astype(np.float32))
        expected = np.stack([truth[name].to_numpy() for name in ("photon_x_px", "photon_y_px", "electrons")], axis=1)
        np.testing.assert_array_equal(stars.numpy(), expected)


@pytest.mark.parametrize("kind", ["bbox", "segm"])
def test_a_perfect_detector_scores_one(dataset, monkeypatch, kind):
    """... and one that misses every second star half of it; with more objects than COCO's usual hundred."""
    coco = pytest.importorskip("pycocotools.coco")
    monkeypatch.chdir(dataset)
    split = "test"
    content = json.loads((dataset / "coco" / "annotations" / f"instances_{split}.json").read_text())
    per_image = [one["image_id"] for one in content["annotations"]]
    assert max(map(per_image.count, set(per_image))) > 100
    field = "segmentation" if kind == "segm" else "bbox"
    truth = coco.COCO(f"coco/annotations/instances_{split}.json")

    def answer(one):
        place = truth.annToRLE(one) if kind == "segm" else one["bbox"]
        return {"image_id": one["image_id"], "category_id": one["category_id"], field: place, "score": 0.9}

    every = [answer(one) for one in content["annotations"]]
    assert scored(dataset, every, kind) == 1.0
    some = [answer(one) for k, one in enumerate(content["annotations"]) if k % 2]
    assert 0.3 < scored(dataset, some, kind) < 0.7


def scored(folder, detections, kind):
    blocks = (folder / "README.md").read_text().split("```python\n")[1:]
    (block,) = [part.partition("```")[0] for part in blocks if "COCOeval" in part]
    names = {"detections": detections}
    exec(block.replace('"bbox")', f'"{kind}")'), names)
    return names["ap"]


def test_coco_masks_and_what_is_said(dataset, shots):
    coco = pytest.importorskip("pycocotools.coco")
    for split in shots:
        held = coco.COCO(str(dataset / "coco" / "annotations" / f"instances_{split}.json"))
        assert held.dataset["info"]["description"] == f'Seven | "<sisters>", {split}'
        assert held.dataset["licenses"][0]["name"] == "CC-BY-SA-3.0-IGO"
        assert {one["license"] for one in held.imgs.values()} == {1}
        kinds = {one["id"]: one["name"] for one in held.dataset["categories"]}
        for one in held.anns.values():
            mask = held.annToMask(one)
            assert mask.sum() == one["area"] > 0
            left, top, width, height = one["bbox"]
            rows, columns = np.nonzero(mask)
            assert left <= columns.min() + 0.5  # COCO's corner: pixel centres lie in the box
            assert columns.max() + 0.5 <= left + width
            assert top <= rows.min() + 0.5
            assert rows.max() + 0.5 <= top + height
            if kinds[one["category_id"]] == "hot_pixel":
                assert mask.sum() == 1
            else:
                x, y, _ = one["keypoints"]
                assert mask[min(int(y), mask.shape[0] - 1), min(int(x), mask.shape[1] - 1)]


def test_croissant(dataset):
    croissant = pytest.importorskip("mlcroissant")
    held = croissant.Dataset(jsonld=str(dataset / "croissant.json"))
    assert not held.metadata.issues.errors
    index = pq.read_table(dataset / "index.parquet").to_pylist()
    records = list(held.records("index"))
    assert [one["index/frame"] for one in records] == list(range(FRAMES))
    for mine, theirs in zip(records, index, strict=True):
        assert mine["index/sha256"].decode() == theirs["sha256"]
        assert mine["index/quat_w"] == theirs["quat_w"]
    assert sum(1 for _ in held.records("stars")) == sum(
        pq.read_metadata(dataset / one["truth"]).num_rows for one in index
    )
