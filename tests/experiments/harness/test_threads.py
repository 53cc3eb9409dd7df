"""Linear algebra keeps to one thread meanwhile, and to what the user said otherwise; interrupts wait for no thread."""

import os
import threading
import time

import numpy as np
import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from experiments.harness.threads import THREADS, one_thread, prompt_pool


def threads_in_use():
    np.linalg.inv(np.eye(3))
    return {one["num_threads"] for one in threadpool_info() if one["user_api"] == "blas"}


@pytest.fixture
def unset(monkeypatch):
    for name in THREADS:
        monkeypatch.delenv(name, raising=False)
    with threadpool_limits(2, user_api="blas"):
        yield


def test_one_thread_meanwhile_and_everything_as_before_afterwards(unset):
    assert threads_in_use() == {2}
    with one_thread():
        assert threads_in_use() == {1}
        assert os.environ["OPENBLAS_NUM_THREADS"] == "1"  # what is loaded or started now
    assert threads_in_use() == {2}
    assert not set(THREADS) & set(os.environ)


def test_what_the_environment_says_holds(unset, monkeypatch):
    monkeypatch.setenv("OMP_NUM_THREADS", "2")
    with one_thread(unless_told=True):
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
