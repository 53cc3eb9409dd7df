"""Copies for learning programs, read back by what would read them; the contact sheet."""

from __future__ import annotations

import io
import json
import shutil
import tarfile

import numpy as np
import pytest
from PIL import Image

from experiments.dataset.exports import export_coco, export_shards
from experiments.dataset.folder import StorageError
from experiments.dataset.labels import CLASSES
from experiments.dataset.truth_files import read_record, read_table
from render.fits.files import read_frame

ABOUT = {"title": "", "version": "", "licence": "", "licence_url": "", "citation": ""}


@pytest.fixture
def records(dataset):
    return [read_record(file) for file in sorted((dataset / "truth").iterdir())]


def test_coco(dataset, records, tmp_path):
    folder = shutil.copytree(dataset, tmp_path / "copy")
    seen = []
    options = {"diffusion_px": 0.3, "bits": 16, "about": ABOUT}
    said = export_coco(folder, records, labels=lambda _: [], done=lambda: seen.append(1), **options)
    assert len(seen) == 3
    parts = {split: _coco(folder, split) for split in ("train", "validation", "test")}
    images = [image for part in parts.values() for image in part["images"]]
    stars = [star for part in parts.values() for star in part["annotations"]]
    assert [one["id"] for one in parts[records[0].split]["images"]].count(0) == 1
    assert f"{len(stars)} of class star" in said
    assert len({star["id"] for star in stars}) == len(stars)
    for image in images:
        one = records[image["id"]]
        pixels = np.array(Image.open(folder / "coco" / "images" / image["file_name"]))
        np.testing.assert_array_equal(pixels, read_frame(folder / one.file).dn)
        truth = read_table(folder / one.truth)
        mine = {star["star_id"]: star for star in stars if star["image_id"] == image["id"]}
        for row in truth[np.asarray(truth["electrons"]) > 5000]:
            x, y, seen_flag = mine[row["star_id"]]["keypoints"]
            assert (x, y, seen_flag) == (row["photon_x_px"] + 0.5, row["photon_y_px"] + 0.5, 2)  # COCO: from the corner


def _coco(folder, split):
    content = json.loads((folder / "coco" / "annotations" / f"instances_{split}.json").read_text())
    assert [one["name"] for one in content["categories"]] == list(CLASSES)
    return content


def test_shards(dataset, records, tmp_path):
    pytest.importorskip("webdataset")
    folder = shutil.copytree(dataset, tmp_path / "copy")
    export_shards(folder, records, done=lambda: None)
    shards = sorted((folder / "webdataset").iterdir())
    assert {shard.name for shard in shards} == {f"{one.split}-000000.tar" for one in records}
    first = {shard.name: shard.read_bytes() for shard in shards}
    members = {}
    for content in first.values():
        with tarfile.open(fileobj=io.BytesIO(content)) as tar:
            members.update({member.name: tar.extractfile(member).read() for member in tar})
    for one in records:
        assert members[f"frame_{one.frame:06d}.fts"] == (folder / one.file).read_bytes()
        assert members[f"frame_{one.frame:06d}.parquet"] == (folder / one.truth).read_bytes()
        assert json.loads(members[f"frame_{one.frame:06d}.json"])["quat_xyzw"] == list(one.quat_xyzw)
    export_shards(folder, records, done=lambda: None)
    assert {shard.name: shard.read_bytes() for shard in shards} == first  # no time, no user in it


def test_a_full_disk_leaves_no_half_shard(dataset, records, tmp_path, monkeypatch):
    webdataset = pytest.importorskip("webdataset")
    folder = shutil.copytree(dataset, tmp_path / "copy")

    def full(self, sample):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(webdataset.TarWriter, "write", full)
    with pytest.raises(StorageError, match="the disk is full"):
        export_shards(folder, records, done=lambda: None)
    assert not list(folder.rglob("*.partial"))
