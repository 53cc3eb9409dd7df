"""Dask clusters within this process: frames and records; failures end a run in a line that says how to continue."""

from __future__ import annotations

import json
import threading
from types import SimpleNamespace

import distributed
import pytest

from experiments.dataset import job as making
from experiments.dataset import workers
from experiments.dataset.job import Job
from optics.errors import BackendError, ConfigError, DomainError


@pytest.fixture
def cluster(monkeypatch):
    """A cluster that is as the test says, and a clock."""
    held = SimpleNamespace(now=100.0, workers={"a": {"nthreads": 1}}, status="running")
    held.scheduler_info = lambda n_workers: {"workers": held.workers}
    monkeypatch.setattr(workers.time, "monotonic", lambda: held.now)
    return held


def test_workers_that_are_gone(cluster, capsys):
    monitor = workers._Monitor(cluster, "scheduler tcp://head:8786")
    cluster.workers = {}
    told = {}
    for second in range(1, 300):
        cluster.now = 100.0 + second
        monitor.update()
        if line := capsys.readouterr().err:
            told[second] = line
    assert list(told.values()) == ["scheduler tcp://head:8786: no workers for 10 s; waiting for some\n"]
    assert 10 <= min(told) <= 12
    cluster.now = 402.0
    with pytest.raises(
        BackendError, match="no workers for 300 s; finished frames are kept; run the same command again"
    ):
        monitor.update()


def test_workers_that_come_and_go(cluster, capsys):
    """Adaptive scaling: more frames are handed out ahead to more workers."""
    monitor = workers._Monitor(cluster, "scheduler")
    assert monitor.slots == 1
    for second, count in ((110, 0), (115, 3), (130, 2), (140, 0), (145, 1)):
        cluster.now = float(second)
        cluster.workers = {f"w{k}": {"nthreads": 2} for k in range(count)}
        monitor.update()
        assert monitor.slots == (2 * count or monitor.slots)
    assert monitor.most_workers == 3
    assert capsys.readouterr().err == ""


def test_a_scheduler_that_is_gone(cluster):
    monitor = workers._Monitor(cluster, "scheduler tcp://head:8786")
    cluster.status, cluster.now = "closed", 200.0
    with pytest.raises(BackendError, match=r"^scheduler tcp://head:8786 is gone; finished frames are kept"):
        monitor.update()


def job(folder, **software):
    return Job(config="{}", folder=str(folder), backend="llvm", token="token", software=json.dumps(software))


def test_a_worker_that_sees_another_folder_or_has_other_software(tmp_path, monkeypatch):
    """Every worker checks itself before its first frame, also one that comes late."""
    monkeypatch.setattr("distributed.get_worker", lambda: SimpleNamespace(address="tcp://node7:1234"))
    with pytest.raises(ConfigError, match=r"^worker tcp://node7:1234 does not see the folder of the dataset; it must"):
        making.make_frame(job(tmp_path), 0)
    (tmp_path / "token").touch()
    with pytest.raises(ConfigError, match=r"node7:1234 has mitsuba 3.*, here it is 2.0; frames would differ"):
        making.make_frame(job(tmp_path, mitsuba="2.0"), 0)


def test_a_setting_refused_in_a_worker_is_an_error_of_the_caller(monkeypatch):
    """Dask replaces an exception whose traceback is large: its class, and with it the exit status, is lost."""

    def refused(job, frame, threads):
        raise DomainError("defocus 5 mm puts the light beyond the patch")

    monkeypatch.setattr(workers, "make_frame", refused)
    answer = workers.make_batch(None, [0], None)
    assert type(answer) is DomainError
    assert str(answer) == "defocus 5 mm puts the light beyond the patch"


@pytest.fixture
def rendered(monkeypatch):
    """Frames that workers of this process rendered, by thread; frame 99 is refused."""
    threads = {}

    def make_frame(job, frame, threads_of_renderer=None):
        if frame == 99:
            raise DomainError("frame 99 is refused")
        making.check_worker(job) if job.token else None
        threads[frame] = threading.current_thread()
        return SimpleNamespace(frame=frame)

    monkeypatch.setattr(workers, "make_frame", make_frame)
    return threads


@pytest.fixture
def threads_for_processes(monkeypatch):
    """Clusters of `local_cluster` whose workers are threads."""
    local = distributed.LocalCluster

    def cluster(**options):
        return local(**options | {"processes": False})

    monkeypatch.setattr(distributed, "LocalCluster", cluster)


@pytest.mark.parametrize("frames", [40, 1])
def test_every_frame_is_rendered_once_by_the_workers_of_a_scheduler(frames, rendered, tmp_path):
    """The token by which workers recognise the folder is gone afterwards."""
    done = []
    options = {"threads_per_worker": 1, "processes": False, "protocol": "tcp", "dashboard_address": "127.0.0.1:0"}
    with distributed.LocalCluster(n_workers=2, **options) as cluster:
        most = workers.make_frames(
            Job(config="{}", folder=str(tmp_path), backend="llvm"),
            range(frames),
            workers=0,
            scheduler=cluster.scheduler_address,
            done=lambda batch: done.extend(record.frame for record in batch),
        )
    assert most == 2
    assert sorted(done) == sorted(rendered) == list(range(frames))
    assert list(tmp_path.iterdir()) == []


def local_run(frames, done):
    job = Job(config="{}", folder="", backend="llvm")
    return workers.make_frames(job, frames, workers=2, scheduler="", done=done)


def test_workers_of_this_machine(rendered, threads_for_processes):
    done = []
    assert local_run(range(12), lambda batch: done.extend(record.frame for record in batch)) == 2
    assert sorted(done) == list(range(12))
    assert threading.main_thread() not in rendered.values()
    assert local_run([], done.append) == 0
    assert local_run([5], lambda batch: done.append(batch[0].frame)) == 1
    assert rendered[5] is threading.main_thread()


@pytest.mark.parametrize("interrupt", [KeyboardInterrupt, None])
def test_a_cluster_ends_with_the_error_of_its_run(interrupt, rendered, threads_for_processes):
    """Interrupted, or with a frame that is refused; no worker goes on."""

    def done(batch):
        if interrupt is not None:
            raise interrupt

    with pytest.raises(interrupt or DomainError, match=None if interrupt else "frame 99 is refused"):
        local_run([1, 99] if interrupt is None else [1, 2], done)
    assert not [one for one in threading.enumerate() if one.name.startswith("Dask-Worker")]


def test_a_token_at_a_url(monkeypatch):
    """A worker that does not reach the URL is refused; the token is removed with the run."""
    monkeypatch.setattr("distributed.get_worker", lambda: SimpleNamespace(address="tcp://node7:1234"))
    plain = Job(config="{}", folder="", backend="llvm", url="memory://token/sky")
    with workers._with_token(plain) as job:
        making.check_worker(job)
    with pytest.raises(ConfigError, match="node7:1234 does not see memory://token/sky; the worker must reach this URL"):
        making.check_worker(job)


def test_the_cause_of_an_error_is_part_of_its_text():
    error = RuntimeError("Nanny failed to start.")
    error.__cause__ = OSError("no pipes")
    assert workers._reason(error) == "Nanny failed to start: no pipes"
    assert workers._reason(TimeoutError()) == "TimeoutError"
