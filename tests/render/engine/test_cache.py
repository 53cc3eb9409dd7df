"""The folder of kernels, without which Dr.Jit aborts."""

import os

import pytest

from optics.errors import BackendError
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


@pytest.mark.skipif(os.name != "posix", reason="POSIX permissions")
def test_folders_of_kernels(monkeypatch, tmp_path):
    """A home without a folder cannot hold one; below the temporary folder, one that only this user can write to."""
    assert cache._holds_cache(tmp_path)
    assert not cache._holds_cache(tmp_path / "missing" / "home")
    monkeypatch.setattr(cache.tempfile, "gettempdir", lambda: str(tmp_path))
    monkeypatch.setattr(cache.tempfile, "tempdir", str(tmp_path))
    folder = cache._temporary()
    assert cache._temporary() == folder
    folder.chmod(0o777)
    assert cache._temporary() not in (folder, tmp_path)
    monkeypatch.setattr(cache.tempfile, "gettempdir", lambda: str(tmp_path / "missing"))
    with pytest.raises(BackendError, match="no folder for compiled kernels"):
        cache._temporary()
