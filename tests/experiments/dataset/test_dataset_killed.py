"""The command killed, starved and interrupted: what was made stays, the same command goes on to the same bytes."""

from __future__ import annotations

import contextlib
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from pleiades_frames import OPTIONS, digests, results

pytestmark = [pytest.mark.slow, pytest.mark.alone]

ROOT = Path(__file__).parents[3]
FRAMES = 60


def command(folder, *more, workers=1, frames=FRAMES):
    return [
        *(sys.executable, "-m", "experiments.dataset", *OPTIONS, "--backend", "llvm", "--out", str(folder)),
        *("--frames", str(frames), "--workers", str(workers), *more),
    ]


def start(*arguments, **settings):
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True, "cwd": ROOT}
    environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1"}
    return subprocess.Popen(command(*arguments, **settings), env=environment, start_new_session=True, **pipes)


def end_well(process):
    out, error = process.communicate(timeout=120)
    assert process.returncode == 0, out + error
    return error


def wait_for(folder, frames, process):
    """Until so many frames are made."""
    until = time.monotonic() + 60
    while len(list(folder.glob("truth/frame_*"))) < frames:
        assert process.poll() is None, process.communicate()
        assert time.monotonic() < until
        time.sleep(0.002)


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    """All frames by one process in one go."""
    folder = tmp_path_factory.mktemp("killed") / "one"
    end_well(start(folder))
    return folder


def test_killed_at_any_moment_and_taken_up_again(dataset, tmp_path):
    folder = tmp_path / "killed"
    for frames in (1, 30):
        process = start(folder)
        wait_for(folder, frames, process)
        process.kill()
        process.communicate()
        assert not (folder / "index.parquet").exists()
        made = {name: digest for name, digest in digests(folder).items() if not name.startswith(".")}
        assert made.items() <= digests(dataset).items()  # what bears a frame's name is that frame
    end_well(start(folder))
    assert digests(folder) == digests(dataset)
    assert 0 < results(folder)["frames_made"] <= FRAMES - 30
    assert (folder / "index.parquet").read_bytes() == (dataset / "index.parquet").read_bytes()


def test_a_worker_killed_in_the_middle(dataset, tmp_path):
    """Two worker processes; one dies by SIGKILL; the run goes on and every frame is as it would have been."""
    folder = tmp_path / "worker"
    process = start(folder, workers=2)
    wait_for(folder, 10, process)
    workers = workers_of(process.pid)
    assert len(workers) == 2
    os.kill(workers[0], signal.SIGKILL)
    assert end_well(process) == ""
    assert digests(folder) == digests(dataset)
    assert results(folder)["workers"] == 2
    assert results(folder)["frames_made"] == FRAMES


def workers_of(parent):
    """Worker processes below a process: those that Python's multiprocessing spawned with a pipe."""
    found = subprocess.run(
        ["ps", "-ww", "-o", "pid=,args=", "--ppid", str(parent)], capture_output=True, text=True, check=False
    )
    lines = [line.split(None, 1) for line in found.stdout.splitlines()]
    return [int(pid) for pid, arguments in lines if "spawn_main" in arguments]


def test_everything_killed_with_workers(dataset, tmp_path):
    folder = tmp_path / "all"
    process = start(folder, workers=2)
    wait_for(folder, 20, process)
    workers = workers_of(process.pid)
    process.kill()
    process.communicate()
    until = time.monotonic() + 10
    while any(Path(f"/proc/{pid}").exists() for pid in workers):  # they do not stay behind
        assert time.monotonic() < until
        time.sleep(0.05)
    end_well(start(folder))
    assert digests(folder) == digests(dataset)


@pytest.mark.parametrize(("workers", "frames"), [(1, 5), (2, 5), (2, 0)])
def test_interrupted(tmp_path, workers, frames):
    """Amid frames, and while the workers start: at once, everybody gone, nothing half-written."""
    folder = tmp_path / "interrupted"
    process = start(folder, workers=workers)
    wait_for(folder, frames, process)
    while len(others := workers_of(process.pid)) < (workers if workers > 1 else 0):
        assert process.poll() is None, process.communicate()
        time.sleep(0.01)
    begun = time.monotonic()
    os.killpg(process.pid, signal.SIGINT)  # as a terminal does
    out, error = process.communicate(timeout=30)
    assert time.monotonic() - begun < 3.0  # 0.7 s when nothing else runs; a wait for threads once made 4.6 s
    assert process.returncode == 130, out + error
    assert not any(Path(f"/proc/{pid}").exists() for pid in others)
    found = re.fullmatch(r"interrupted; (\d+) of 60 frames are kept, the same command continues", error.strip())
    assert found, error
    assert frames <= int(found[1]) == len(list(folder.glob("truth/frame_*"))) < FRAMES
    assert not [file for file in folder.rglob(".*") if file.is_file()]


def test_a_disk_that_is_really_full(tmp_path):
    """A file system of 3.8 MB, mounted for one process: frames would fit, with their truth they do not."""
    if shutil.which("unshare") is None or subprocess.run(["unshare", "-m", "true"], check=False).returncode:
        pytest.skip("needs the right to mount")
    disk, kept = tmp_path / "disk", tmp_path / "kept"
    disk.mkdir()
    steps = 'mount -t tmpfs -o size=3800k none "$0" && { shift 0; "$@"; echo status $?; cp -r "$0/full" "$KEPT"; }'
    line = ["unshare", "-m", "sh", "-c", steps, str(disk), *command(disk / "full")]
    environment = {**os.environ, "KEPT": str(kept), "OPENBLAS_NUM_THREADS": "1"}
    done = subprocess.run(line, capture_output=True, text=True, cwd=ROOT, env=environment, timeout=120, check=False)
    if "mount:" in done.stderr:
        pytest.skip("needs the right to mount")
    assert "status 2" in done.stdout, done.stderr
    assert "the disk is full" in done.stderr
    assert done.stderr.count("\n") == 1
    made = digests(kept)
    truths = [name for name in made if name.endswith(".parquet")]
    assert 5 < len(truths) < FRAMES
    assert f"{len(truths)} of 60 frames are complete and kept" in done.stderr
    end_well(start(kept))  # with room
    whole = digests(kept)
    assert len(whole) == 2 * FRAMES
    assert made.items() <= whole.items()  # nothing half-written bore a frame's name
    assert results(kept)["frames_made"] == FRAMES - len(truths)


@contextlib.contextmanager
def scheduler_of(tmp_path):
    """Dask's own commands: address of a scheduler, its process, and a function that gives it workers."""
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL, "cwd": ROOT}
    file, python = tmp_path / "scheduler.json", [sys.executable, "-m"]
    dask = [*python, "distributed.cli.dask_scheduler", "--port", "0", "--no-dashboard", "--host", "127.0.0.1"]
    processes = [subprocess.Popen([*dask, "--scheduler-file", str(file)], **quiet)]

    def add_workers(count):
        worker = [*python, "distributed.cli.dask_worker", address, "--nthreads", "1", "--no-nanny", "--no-dashboard"]
        worker += ["--local-directory", str(tmp_path)]
        processes.extend(subprocess.Popen(worker, **quiet) for _ in range(count))
        wait = f"from distributed import Client; Client({address!r}).wait_for_workers({count}, timeout=60)"
        subprocess.run([sys.executable, "-c", wait], check=True, timeout=90, **quiet)

    try:
        until = time.monotonic() + 30
        while not (file.exists() and file.read_text()):
            assert time.monotonic() < until
            time.sleep(0.1)
        address = json.loads(file.read_text())["address"]
        yield address, processes[0], add_workers
    finally:
        for process in processes[::-1]:
            process.kill()
            process.wait()


def test_a_scheduler_that_is_killed(tmp_path):
    """One line, exit status 2, how to go on."""
    with scheduler_of(tmp_path) as (address, scheduler, add_workers):
        add_workers(1)
        process = start(tmp_path / "lost", "--scheduler", address, frames=5000)
        wait_for(tmp_path / "lost", 3, process)
        scheduler.kill()
        _, error = process.communicate(timeout=60)
    assert process.returncode == 2, error
    assert "is gone; finished frames are kept; run the same command again to continue" in error
    assert error.count("\n") == 1, error


def test_a_scheduler_elsewhere(dataset, tmp_path):
    """None of its workers is there, then two; then an address where nobody listens."""
    with scheduler_of(tmp_path) as (address, _, add_workers):
        process = start(tmp_path / "none", "--scheduler", address)
        assert "has no workers" in process.communicate(timeout=60)[1]
        assert process.returncode == 2
        add_workers(2)
        folder = tmp_path / "remote"
        error = end_well(start(folder, "--scheduler", address))
        assert all("waiting for some" in line for line in error.splitlines())  # a busy machine lets workers be silent
        assert digests(folder) == digests(dataset)
        assert results(folder)["workers"] == 2
    begun = time.monotonic()
    process = start(tmp_path / "nobody", "--scheduler", address)
    _, error = process.communicate(timeout=60)
    assert process.returncode == 2
    assert "does not answer" in error
    assert error.count("\n") == 1
    assert time.monotonic() - begun < 15
