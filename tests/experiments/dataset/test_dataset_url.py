"""Datasets at URLs, by fsspec's memory and local file systems: the same bytes as in a folder, resumed and checked."""

from __future__ import annotations

import hashlib
import json
import uuid
from typing import ClassVar

import fsspec
import numpy as np
import pyarrow.parquet as pq
import pytest
from astropy.io import fits
from fsspec.implementations.memory import MemoryFileSystem

from experiments.dataset.job import make_frame
from experiments.dataset.remote import RemoteDataset, Store, check_at, working_copy
from experiments.dataset.settings import main
from optics.errors import ConfigError
from render.fits.files import read_frame

SETTINGS = {
    "verify.frames": 0,
    "calibration_frames": 3,
    "instrument.width_px": 96,
    "instrument.height_px": 64,
    "pupil_tolerance": 1e-3,
}
RUN = ["--quick", "--frames", "3", *(part for key, value in SETTINGS.items() for part in ("--set", f"{key}={value}"))]
OF_THE_RUN = {"provenance.json", "summary.json", "results.nc", "report.html", "SHA256SUMS"}
"""Files that hold times of the run, or digests of those."""


@pytest.fixture(params=["memory", "file"])
def url(request, tmp_path):
    return f"memory://{uuid.uuid4().hex}/sky" if request.param == "memory" else f"file://{tmp_path}/far/sky"


def test_a_store_keeps_what_is_written(url):
    store = Store(url)
    assert store.names() == set()
    store.write("a/b.fits", b"one")
    store.write("c.json", b"two")
    store.write("c.json", b"three")
    assert store.names() == {"a/b.fits", "c.json"}
    assert store.read("c.json") == b"three"
    store.remove("c.json")
    assert Store(url).names() == {"a/b.fits"}
    with working_copy(url) as folder:
        assert (folder / "a" / "b.fits").read_bytes() == b"one"
    store.write("../outside", b"four")
    assert store.names() == {"a/b.fits"}, "no copy of it may leave the folder"
    with pytest.raises(ConfigError) as error:
        store.read("nothing")
    assert "nothing" in str(error.value)
    assert "\n" not in str(error.value)


class Bucket(MemoryFileSystem):
    """As s3fs: what was listed is all there is until the listing is dropped; a folder that is made is a bucket."""

    protocol = "gs"
    listed: ClassVar[list[str]] = []

    def find(self, path, **kwargs):
        Bucket.listed = super().find(path, **kwargs)
        return Bucket.listed

    def invalidate_cache(self, path=None):
        Bucket.listed = []

    def cat_file(self, path, **kwargs):
        if Bucket.listed and path not in Bucket.listed:
            raise FileNotFoundError(path)
        return super().cat_file(path, **kwargs)

    def makedirs(self, path, exist_ok=False):
        pytest.fail(f"a bucket is made for {path}")


def test_a_store_of_buckets_that_remembers_what_it_listed():
    fsspec.register_implementation("gs", Bucket, clobber=True)
    store = Store("gs://bucket/sky")
    store.write("truth/one", b"1")
    assert store.names() == {"truth/one"}
    store.write("truth/two", b"2")  # as a worker does
    assert store.read("truth/two") == b"2"


def test_only_datasets_go_to_urls(capsys):
    from experiments.temporal.settings import main as temporal

    assert temporal(["--quick", "--out", "memory://x/y"], own_process=False) == 2
    assert "only datasets are written to URLs" in capsys.readouterr().err


def objects(url):
    store = Store(url)
    return {name: store.read(name) for name in store.names()}


def test_frames_and_closing_files_at_a_url(url, dataset, job, tmp_path):
    """Oracle: the dataset in a folder. A damaged frame is rendered again, and its outdated copy replaced."""
    content = json.loads((dataset / "dataset.json").read_text())
    names = ["frames/frame_000001.fits", "truth/frame_000001.parquet"]
    settings = {"config": content["config"], "frames": 3, "truth": "parquet"}
    remote = RemoteDataset(url, **settings)
    assert (remote.numbers(), remote.only_here) == ([], url.startswith("memory"))
    remote.open(content["software"])
    remote.close()  # without a frame nothing is left
    assert objects(url) == {}
    make_frame(job("", url), 1)
    assert objects(url) == {name: (dataset / name).read_bytes() for name in names}
    Store(url).write(names[0], b"damaged")
    remote = RemoteDataset(url, **settings)
    assert (remote.count(), remote.checked(1)) == (1, None)
    make_frame(job("", url), 1)
    remote.open(content["software"])
    remote.fetch(names)
    assert remote.checked(1).sha256 == hashlib.sha256((remote.path / names[0]).read_bytes()).hexdigest()
    with remote.writing() as folder:
        (folder / "README.md").write_text("card")
    assert set(objects(url)) == {*names, "dataset.json", "README.md", "SHA256SUMS"}
    assert check_at(url).damaged == check_at(url).missing == ()


@pytest.mark.slow
@pytest.mark.parametrize("url", ["file"], indirect=True)
def test_at_a_url_as_in_a_folder(url, engine, tmp_path, capsys):
    """Oracle: the dataset in a folder. Then two files are damaged, and the same command mends them."""
    folder, workers = tmp_path / "here", ["--workers", "2"]
    assert main([*RUN, "--workers", "1", "--out", str(folder)], own_process=False) == 0
    assert main([*RUN, *workers, "--out", url], own_process=False) == 0
    here = {file.relative_to(folder).as_posix(): file.read_bytes() for file in folder.rglob("*") if file.is_file()}
    there = objects(url)
    assert set(there) == set(here)
    same = set(here) - OF_THE_RUN
    assert {name for name in same if there[name] != here[name]} == set()
    assert main(["check", url]) == 0

    store = Store(url)
    store.remove("frames/frame_000001.fits")
    store.write("truth/frame_000002.parquet", there["truth/frame_000002.parquet"][:-3])
    capsys.readouterr()
    assert main(["check", url]) == 1
    assert "the same command restores: frames 1, 2" in capsys.readouterr().out
    assert main([*RUN, "--workers", "1", "--out", url], own_process=False) == 0
    again = objects(url)
    assert {name for name in same if again.get(name) != here[name]} == set()
    assert main(["check", url]) == 0
    assert main([*RUN, "--seed", "9", "--out", url], own_process=False) == 2
    assert "seed = 1" in capsys.readouterr().err
    assert objects(url) == again

    with fsspec.open(f"{url}/index.parquet") as stream:
        first = pq.read_table(stream).to_pylist()[0]
    frame = read_frame(f"{url}/{first['file']}")
    np.testing.assert_array_equal(frame.dn, fits.getdata(folder / first["file"]))
