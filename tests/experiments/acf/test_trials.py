"""Work on several processes: order, errors, a worker that vanishes."""

import math
import multiprocessing
import os

import pytest

from experiments.acf.trials import run_tasks
from optics.errors import BackendError


def test_nothing_to_do():
    assert run_tasks(math.sqrt, [], workers=2, done=lambda index: None) == []


def test_results_come_in_order():
    seen = []
    values = [float(k) for k in range(20)]
    assert run_tasks(math.sqrt, values, workers=2, done=seen.append) == [math.sqrt(v) for v in values]
    assert seen == list(range(20))
    assert multiprocessing.active_children() == []


@pytest.mark.slow
def test_an_error_in_a_worker_is_passed_on():
    with pytest.raises(ValueError, match="math domain error"):
        run_tasks(math.sqrt, [1.0, -1.0, 4.0], workers=2, done=lambda index: None)
    assert multiprocessing.active_children() == []


@pytest.mark.slow
def test_a_worker_that_vanishes_is_one_line():
    with pytest.raises(BackendError, match="a Monte Carlo process ended"):
        run_tasks(os._exit, [3, 3], workers=2, done=lambda index: None)


@pytest.mark.slow
def test_an_interrupt_ends_the_workers():
    def interrupt(index):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_tasks(math.sqrt, [float(k) for k in range(50)], workers=2, done=interrupt)
    assert multiprocessing.active_children() == []


def test_the_environment_is_as_before(monkeypatch):
    monkeypatch.setenv("OMP_NUM_THREADS", "7")
    monkeypatch.delenv("OPENBLAS_NUM_THREADS", raising=False)
    assert run_tasks(os.getenv, ["OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"], workers=1, done=lambda k: None) == [
        "1",
        "1",
    ]
    assert os.environ["OMP_NUM_THREADS"] == "7"
    assert "OPENBLAS_NUM_THREADS" not in os.environ
