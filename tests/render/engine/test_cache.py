"""Where Dr.Jit, which aborts without a home folder, keeps its kernels."""

import os

import pytest

from render.engine import cache


@pytest.mark.skipif(os.name != "posix", reason="Dr.Jit asks for HOME on POSIX systems alone")
def test_a_process_without_home_gets_one_meanwhile(monkeypatch, tmp_path):
    """Services and jobs have none; that root could write to / is no home to Dr.Jit."""
    monkeypatch.setattr(cache, "_holds_cache", lambda home: True)
    monkeypatch.setattr(cache, "_temporary", lambda: tmp_path)
    monkeypatch.delenv("HOME")
    with cache.home_with_cache():
        assert os.environ["HOME"] == str(tmp_path)
    assert "HOME" not in os.environ
    monkeypatch.setenv("HOME", "/mine")
    with cache.home_with_cache():
        assert os.environ["HOME"] == "/mine"
