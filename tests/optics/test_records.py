"""Records: arrays of several joined into one."""

from dataclasses import dataclass

import numpy as np
from refusals import refuses

from optics.errors import DomainError
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


def test_arrays_follow_each_other_and_other_fields_are_given():
    parts = [Points(np.full((k, 2), float(k)), np.arange(k), frames=k) for k in (2, 0, 1)]
    whole = concatenated(parts, frames=3)
    assert whole.place.tolist() == [[2.0, 2.0], [2.0, 2.0], [1.0, 1.0]]
    assert whole.name.tolist() == [0, 1, 0]
    assert whole.frames == 3
    assert not whole.place.flags.writeable


def test_the_joined_record_is_checked_as_every_other():
    odd = [Points(np.zeros((1, 2)), np.zeros(1), frames=1), Points(np.zeros((2, 2)), np.zeros(2), frames=1)]
    object.__setattr__(odd[1], "name", np.zeros(3))
    refuses(DomainError, r"Points\.name", concatenated, odd, frames=2)
