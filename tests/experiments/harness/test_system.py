"""Locks, signals and threads of this process."""

import io
import os
import signal
import sys
import threading
import time

import click
import numpy as np
import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from experiments.harness import system
from experiments.harness.interrupts import EXIT_INTERRUPTED, NOTHING_WRITTEN, interrupts, invoke
from experiments.harness.system import THREADS, forked, one_thread, prompt_pool, shared


def test_one_process_at_a_time_holds_a_folder(tmp_path):
    (tmp_path / "a").mkdir()
    (tmp_path / "b").mkdir()
    held = system.lock_folder(tmp_path / "a")
    with pytest.raises(BlockingIOError):
        system.lock_folder(tmp_path / "b" / ".." / "a")
    os.close(system.lock_folder(tmp_path / "b"))
    os.close(held)
    os.close(system.lock_folder(tmp_path / "a"))
    assert not any((tmp_path / "a").iterdir())  # nothing lies in a user's folder


def test_a_signal_that_is_held_comes_afterwards(monkeypatch):
    done = []

    def work():
        with system.signals_held(signal.SIGINT):
            signal.raise_signal(signal.SIGINT)
            done.append("the work")

    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        with pytest.raises(KeyboardInterrupt):
            work()
    finally:
        signal.signal(signal.SIGINT, before)
    assert done == ["the work"]


def test_signs_that_an_encoding_lacks(monkeypatch):
    written = io.BytesIO()
    monkeypatch.setattr(sys, "stdout", io.TextIOWrapper(written, encoding="cp1252"))
    show = click.Command("show", callback=lambda: print("0.3\N{DOUBLE PRIME} \N{PLUS-MINUS SIGN} 1"))
    assert invoke(show, [], prog="show", own_process=True) == 0
    sys.stdout.flush()
    assert written.getvalue().decode("cp1252").split() == ["0.3?", "±", "1"]


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize(("at_once", "own_process"), [(True, True), (False, True), (False, False)])
def test_a_signal_ends_a_command_with_its_message(number, at_once, own_process, monkeypatch, capfd):
    """During imports the handler ends the process; later an error that an interrupted import raises counts as one."""

    def leave():
        raise SystemExit(EXIT_INTERRUPTED)

    def work():
        interrupts.at_once = at_once
        try:
            signal.raise_signal(number)
        except KeyboardInterrupt:
            raise ImportError("half an extension module") from None

    monkeypatch.setattr("experiments.harness.interrupts._leave", leave)
    command = click.Command("work", callback=work)
    if own_process:
        with pytest.raises(SystemExit, match="130"):
            invoke(command, [], prog="work", own_process=True)
    else:
        assert invoke(command, [], prog="work", own_process=False) == EXIT_INTERRUPTED
    assert capfd.readouterr().err == f"{NOTHING_WRITTEN}\n"
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


@pytest.fixture
def two_threads(monkeypatch):
    for name in THREADS:
        monkeypatch.delenv(name, raising=False)
    with threadpool_limits(2, user_api="blas"):
        yield


def threads_in_use():
    np.linalg.inv(np.eye(3))
    return {library["num_threads"] for library in threadpool_info() if library["user_api"] == "blas"}


def test_one_thread_meanwhile_and_everything_as_before_afterwards(two_threads):
    assert threads_in_use() == {2}
    with one_thread():
        assert threads_in_use() == {1}
        assert os.environ["OPENBLAS_NUM_THREADS"] == "1"  # what is loaded or started now
    assert threads_in_use() == {2}
    assert not set(THREADS) & set(os.environ)


def test_what_the_environment_says_holds(two_threads, monkeypatch):
    monkeypatch.setenv("OMP_NUM_THREADS", "2")
    with one_thread(unless_set=True):
        assert threads_in_use() == {2}
        assert os.environ["OMP_NUM_THREADS"] == "2"
    with one_thread():
        assert threads_in_use() == {1}
    assert os.environ["OMP_NUM_THREADS"] == "2"


def test_an_interrupt_waits_for_no_thread():
    started, going = threading.Event(), threading.Event()
    begun = time.monotonic()
    with pytest.raises(KeyboardInterrupt), prompt_pool(1) as pool:  # noqa: PT012
        first, second = pool.submit(lambda: started.set() or going.wait(20.0)), pool.submit(int)
        started.wait(20.0)
        raise KeyboardInterrupt
    assert time.monotonic() - begun < 5.0
    going.set()
    assert first.result(20.0)
    assert second.cancelled()


def test_tasks_are_shared_with_a_copy_of_the_process(monkeypatch):
    monkeypatch.setattr("experiments.harness.system.processors", lambda: 2)
    steps = []

    def work(number):
        time.sleep(0.05)
        return number**2, os.getpid()

    squares, processes = zip(*shared(work, range(6), steps.append), strict=True)
    assert squares == (0, 1, 4, 9, 16, 25)
    assert len({*processes}) == 2
    assert steps == list(range(6))


@pytest.mark.parametrize("ends", [lambda: os._exit(1), lambda: 1 // 0, lambda: lambda: None])
def test_what_a_copy_does_not_tell_is_done_here(ends, monkeypatch):
    monkeypatch.setattr("experiments.harness.system.processors", lambda: 2)
    here = os.getpid()
    with forked(lambda: "here" if os.getpid() == here else ends()) as result:
        assert result() == "here"
    with pytest.raises(ZeroDivisionError):
        shared(lambda number: 1 // number, [1, 0, 2])
