"""What a cluster that fails looks like: told in time, in one line, with how to go on."""

from __future__ import annotations

import json
from types import SimpleNamespace

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


def test_a_cluster_that_starts_no_worker_though_there_is_work():
    future = SimpleNamespace(result=lambda timeout: (_ for _ in ()).throw(TimeoutError))
    client = SimpleNamespace(submit=lambda work, pure: future)
    with pytest.raises(ConfigError, match=r"^scheduler tcp://head:8786 has no workers, and started none within 10 s"):
        workers._check_cluster(client, None, "tcp://head:8786")


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
