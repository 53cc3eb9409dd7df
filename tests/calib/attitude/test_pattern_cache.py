"""Patterns of stars kept on disk: made once, shared by processes, made again where damaged."""

import threading

import pytest

from calib.attitude import pattern_cache as patterns
from calib.attitude.pattern_cache import cache_folder, kept_database

pytestmark = pytest.mark.reference

FIELD = {"min_fov_deg": 55.0, "max_fov_deg": 60.0}
"""Patterns of a wide field take a tenth of a second."""


@pytest.fixture
def builds(tmp_path, monkeypatch):
    """How often patterns were made, with an empty cache."""
    pytest.importorskip("tetra3rs")
    monkeypatch.setenv("STARBENCH_CACHE", str(tmp_path / "cache"))
    made = []

    def counted(**field):
        made.append(field)
        return patterns_of_tetra3rs(**field)

    patterns_of_tetra3rs = patterns.build_database
    monkeypatch.setattr(patterns, "build_database", counted)
    return made


def test_made_once_and_the_same_from_disk(builds):
    first, second = kept_database(**FIELD), kept_database(**FIELD)
    assert len(builds) == 1
    assert (first.num_patterns, first.num_stars) == (second.num_patterns, second.num_stars)
    assert first.parameters == second.parameters
    kept_database(min_fov_deg=54.0, max_fov_deg=60.0)
    assert len(builds) == 2, "another field is another file"


@pytest.mark.parametrize(
    "damage", [lambda content: content[:-1], lambda content: content[:999] + b"?" + content[1000:]]
)
def test_damaged_files_are_made_again(builds, damage):
    kept_database(**FIELD)
    (file,) = cache_folder().glob("patterns-*.bin")
    file.write_bytes(damage(file.read_bytes()))
    assert kept_database(**FIELD).num_stars > 0
    assert len(builds) == 2
    kept_database(**FIELD)
    assert len(builds) == 2


def test_several_at_once_leave_one_whole_file(builds):
    found = []
    threads = [threading.Thread(target=lambda: found.append(kept_database(**FIELD).num_patterns)) for _ in range(3)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert found == found[:1] * 3
    assert not list(cache_folder().glob(".*"))
    before = len(builds)
    kept_database(**FIELD)
    assert len(builds) == before


def test_no_cache_stops_nothing(builds, tmp_path, monkeypatch):
    (tmp_path / "file").write_text("no folder")
    monkeypatch.setenv("STARBENCH_CACHE", str(tmp_path / "file"))
    assert kept_database(**FIELD).num_stars > 0
