"""Three frames of the Pleiades on disk, and the same dataset as a worker sees it."""

import json

import pytest
from pleiades_frames import run

from experiments.dataset.job import Job
from experiments.dataset.settings import DatasetConfig


@pytest.fixture(scope="session")
def dataset(engine, tmp_path_factory):
    """Three frames, made in one go; the first is evaluated."""
    folder = tmp_path_factory.mktemp("dataset") / "one"
    assert run(folder, "--set", "verify.frames=1", "--set", "verify.dark_frames=4") == 0
    return folder


@pytest.fixture(scope="session")
def job(dataset):
    """``job(folder, key=value)``: that dataset in a folder, with changed settings; ``url`` is no setting."""

    def make(folder, url="", **changes):
        config = json.loads((dataset / "dataset.json").read_text())["config"]
        text = DatasetConfig.model_validate(config | changes).model_dump_json()
        return Job(config=text, folder=str(folder), backend="llvm", url=url)

    return make
