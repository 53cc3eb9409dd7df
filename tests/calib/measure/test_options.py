from dataclasses import dataclass

import pytest

from calib.measure.options import check_options, option
from optics.errors import DomainError


@dataclass(frozen=True, kw_only=True)
class Options:
    """Every kind of bound, and a field without one."""

    width_px: float | None = option(None, at_least=0.5, at_most=20, unit="px")
    step: float = option(0.1, above=0)
    free: float = -1e300

    def __post_init__(self):
        check_options(self)


@pytest.mark.parametrize("good", [{}, {"width_px": 0.5}, {"width_px": 20}, {"step": 1e-9}, {"free": 0.0}])
def test_values_within_the_range_pass(good):
    assert Options(**good)


@pytest.mark.parametrize(
    ("bad", "said"),
    [
        ({"width_px": 0.4}, r"width_px = 0.4 px; it must be at least 0.5 and at most 20 px"),
        ({"width_px": 21}, r"width_px = 21 px"),
        ({"width_px": float("nan")}, r"width_px = nan px"),
        ({"step": 0}, r"step = 0; it must be above 0$"),
    ],
)
def test_values_outside_are_told_with_the_range(bad, said):
    with pytest.raises(DomainError, match=said):
        Options(**bad)
