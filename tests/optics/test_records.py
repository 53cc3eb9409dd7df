"""Records: arrays of several joined into one, and their files."""

import sys
from dataclasses import dataclass

import numpy as np
import pytest
from refusals import refuses
from scipy.interpolate import CubicSpline

from optics import record_files
from optics.errors import ConfigError, DomainError
from optics.records import concatenated, freeze


@dataclass(frozen=True)
class Points:
    place: np.ndarray
    name: np.ndarray
    frames: int

    def __post_init__(self):
        sizes = {}
        freeze(self, "place", shape=("n", 2), sizes=sizes)
        freeze(self, "name", shape=("n",), dtype=np.int64, sizes=sizes)


def test_arrays_follow_each_other_and_the_joined_record_is_checked():
    parts = [Points(np.full((k, 2), float(k)), np.arange(k), frames=k) for k in (2, 0, 1)]
    whole = concatenated(parts, frames=3)
    assert whole.place.tolist() == [[2.0, 2.0], [2.0, 2.0], [1.0, 1.0]]
    assert whole.name.tolist() == [0, 1, 0]
    assert whole.frames == 3
    assert not whole.place.flags.writeable
    odd = [Points(np.zeros((1, 2)), np.zeros(1), frames=1), Points(np.zeros((2, 2)), np.zeros(2), frames=1)]
    object.__setattr__(odd[1], "name", np.zeros(3))
    refuses(DomainError, r"Points\.name", concatenated, odd, frames=2)


@dataclass(frozen=True)
class Mixed:
    value: object


def test_records_come_back_from_their_file_bit_by_bit(tmp_path, monkeypatch):
    monkeypatch.setattr(record_files, "PACKAGES", (f"{Mixed.__module__.split('.')[0]}",))
    monkeypatch.setitem(sys.modules, Mixed.__module__, sys.modules[__name__])
    spline = CubicSpline([0.0, 1.0, 3.0], [1.0, 4.0, 2.0])
    values = (0.1, np.nan, -np.inf, 3, True, None, "a", np.float32(0.1), (1, (2.5, "b")), {"k": 1.5, 2: None})
    record_files.write_record(tmp_path / "a.json", Mixed(values))
    read = record_files.read_record(tmp_path / "a.json", Mixed)
    assert repr(read.value) == repr((*values[:7], float(np.float32(0.1)), *values[8:]))
    for array in (np.arange(6.0).reshape(2, 3), np.array([[np.nan, 1.0]]), np.array([1, 2], np.int16)):
        record_files.write_record(tmp_path / "a.json", Mixed(array))
        read = record_files.read_record(tmp_path / "a.json", Mixed).value
        assert (read.dtype, read.shape) == (array.dtype, array.shape)
        np.testing.assert_array_equal(read, array)
    record_files.write_record(tmp_path / "a.json", Mixed(spline))
    x = np.linspace(-1.0, 4.0, 11)
    np.testing.assert_array_equal(record_files.read_record(tmp_path / "a.json", Mixed).value(x), spline(x))
    with pytest.raises(ConfigError, match="a Mixed; a Points is needed"):
        record_files.read_record(tmp_path / "a.json", Points)
