"""Other systems, simulated: what Windows and macOS lack or name otherwise."""

from __future__ import annotations

import errno
import fcntl
import io
import os
import signal
import sys
from types import SimpleNamespace

import pytest

from experiments.harness import outputs, system
from experiments.harness.outputs import RECORD, OutputFolder
from optics.errors import ConfigError
from optics.textfile import write_text


def windows_locks():
    """``msvcrt`` as its documentation has it: a region that is locked gives OSError."""

    def locking(handle, mode, count):
        assert (mode, count) == (2, 1)
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise OSError(errno.EACCES, "Permission denied") from None

    return SimpleNamespace(locking=locking, LK_NBLCK=2)


@pytest.mark.parametrize("windows", [False, True])
def test_one_process_at_a_time_holds_a_folder(tmp_path, monkeypatch, windows):
    if windows:
        monkeypatch.setitem(sys.modules, "msvcrt", windows_locks())
        monkeypatch.setitem(sys.modules, "fcntl", None)
        monkeypatch.setattr(system.tempfile, "gettempdir", lambda: str(tmp_path))
    (tmp_path / "a").mkdir()
    (tmp_path / "b").mkdir()
    held = system.lock_folder(tmp_path / "a")
    with pytest.raises(BlockingIOError):
        system.lock_folder(tmp_path / "b" / ".." / "a")
    os.close(system.lock_folder(tmp_path / "b"))
    os.close(held)
    os.close(system.lock_folder(tmp_path / "a"))
    assert not any((tmp_path / "a").iterdir())  # nothing lies in a user's folder


def test_peak_memory_without_the_module_resource(monkeypatch):
    assert 10.0 < system.own_peak_memory_mb() < 1e5
    monkeypatch.setitem(sys.modules, "resource", None)
    memory = SimpleNamespace(memory_info=lambda: SimpleNamespace(peak_wset=250_000_000))
    monkeypatch.setitem(sys.modules, "psutil", SimpleNamespace(Process=lambda: memory))
    assert system.own_peak_memory_mb() == 250.0


def test_processors_without_affinity(monkeypatch):
    monkeypatch.delattr(os, "sched_getaffinity", raising=False)
    monkeypatch.setattr(os, "cpu_count", lambda: 6)
    assert system.processors() == 6


def test_signals_are_left_alone_where_they_cannot_be_held(monkeypatch):
    def work(done):
        with system.signals_held(signal.SIGINT):
            signal.raise_signal(signal.SIGINT)
            done.append("the work")

    def work_done():
        done = []
        with pytest.raises(KeyboardInterrupt):
            work(done)
        return done

    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        assert work_done() == ["the work"]
        monkeypatch.delattr(signal, "pthread_sigmask")
        assert work_done() == []
    finally:
        signal.signal(signal.SIGINT, before)


@pytest.fixture
def windows(monkeypatch):
    """Folders that cannot be opened, renames that replace nothing, no exchange of folders."""
    open_any, rename_any = os.open, os.rename

    def opened(path, flags, *rest, **more):
        if os.path.isdir(path):
            raise PermissionError(errno.EACCES, "Permission denied", str(path))
        return open_any(path, flags, *rest, **more)

    def renamed(old, new):
        if os.path.exists(new):
            raise FileExistsError(errno.EEXIST, "Cannot create a file when that file already exists", str(new))
        rename_any(old, new)

    def fsync(handle):
        if fcntl.fcntl(handle, fcntl.F_GETFL) & os.O_ACCMODE == os.O_RDONLY:
            raise OSError(errno.EBADF, "Bad file descriptor")

    monkeypatch.setattr(sys, "platform", "win32")
    for name, fake in (("open", opened), ("rename", renamed), ("fsync", fsync)):
        monkeypatch.setattr(os, name, fake)
    monkeypatch.setattr(outputs.shutil, "_use_fd_functions", False)
    monkeypatch.setattr(outputs, "_exchange", lambda first, second: False)


@pytest.mark.parametrize("before", ["absent", "empty", "earlier output"])
def test_output_folders_on_windows(tmp_path, windows, before):
    folder = tmp_path / "out"
    if before != "absent":
        folder.mkdir()
    if before == "earlier output":
        (folder / RECORD).write_text('{"program": "starbench", "files": {"old.txt": ""}}')
        (folder / "old.txt").write_text("old")
    with OutputFolder(folder).writing() as staging:
        (staging / "new.txt").write_text("new")
        (staging / "below").mkdir()
    assert sorted(path.name for path in folder.iterdir()) == ["below", "new.txt"]
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


def test_signs_that_a_code_page_lacks(monkeypatch):
    written = io.BytesIO()
    terminal = io.TextIOWrapper(written, encoding="cp1252")
    monkeypatch.setattr(sys, "stdout", terminal)
    system.print_anything()
    print("0.3\N{DOUBLE PRIME} \N{PLUS-MINUS SIGN} 1")
    terminal.flush()
    assert written.getvalue().decode("cp1252").split() == ["0.3?", "±", "1"]


def test_texts_have_the_same_bytes_everywhere_and_leave_nothing_behind(tmp_path, monkeypatch):
    monkeypatch.setattr(os, "linesep", "\r\n")
    assert write_text(tmp_path / "a.txt", "one\ntwo µ\n").read_bytes() == "one\ntwo µ\n".encode()
    (tmp_path / "b").mkdir()
    with pytest.raises(ConfigError, match="cannot be written"):
        write_text(tmp_path / "b", "no file")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.txt", "b"]
