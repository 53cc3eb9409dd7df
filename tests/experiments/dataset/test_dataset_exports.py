"""Copies for learning programs, read back by what would read them; the contact sheet."""

from __future__ import annotations

import io
import json
import tarfile

import numpy as np
import pytest
from PIL import Image

from experiments.dataset.exports import export_coco, export_shards
from experiments.dataset.folder import StorageError
from experiments.dataset.job import Job, make_frame
from experiments.dataset.labels import CLASSES
from experiments.dataset.settings import ConePointing, DatasetConfig, VerifyConfig
from experiments.dataset.truth_files import read_table
from render.fits.files import read_frame
from render.sensor_file.tables import CatalogueConfig, InstrumentConfig

ABOUT = {"title": "", "version": "", "licence": "", "licence_url": "", "citation": ""}


@pytest.fixture(scope="module")
def dataset(engine, tmp_path_factory):
    """(folder, records) of two frames of the Pleiades."""
    folder = tmp_path_factory.mktemp("exports")
    for name in ("frames", "truth"):
        (folder / name).mkdir()
    config = DatasetConfig(
        instrument=InstrumentConfig(detector="cmv4000", exposure_s=0.2, width_px=192, height_px=128),
        nodes=3,
        catalogue=CatalogueConfig(faintest_mag=10.0),
        pointing=ConePointing(ra_deg=56.75, dec_deg=24.12, radius_deg=0.1),
        verify=VerifyConfig(frames=0),
    )
    job = Job(config=config.model_dump_json(), folder=str(folder), backend="llvm")
    return folder, [make_frame(job, frame) for frame in (0, 1)]


def test_coco(dataset):
    folder, records = dataset
    seen = []
    options = {"diffusion_px": 0.3, "bits": 16, "about": ABOUT}
    said = export_coco(folder, records, labels=lambda _: [], done=lambda: seen.append(1), **options)
    assert len(seen) == 2
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


def test_shards(dataset):
    pytest.importorskip("webdataset")
    folder, records = dataset
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


def test_a_full_disk_leaves_no_half_shard(dataset, monkeypatch):
    webdataset = pytest.importorskip("webdataset")
    folder, records = dataset

    def full(self, sample):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(webdataset.TarWriter, "write", full)
    with pytest.raises(StorageError, match="the disk is full"):
        export_shards(folder, records, done=lambda: None)
    assert not list(folder.rglob("*.partial"))
