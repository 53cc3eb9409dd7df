"""Table 1's verdict and the choice of an element, from drawn shifts and given solutions."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from experiments.chromatic.experiment import independent
from experiments.chromatic.perturbation import choose
from experiments.chromatic.settings import Config
from optics.errors import ConvergenceError, DomainError


def test_a_line_of_sight_that_moves_all_points_leaves_fewer_independent_pulls():
    """Pulls of two bands with a common part: the scatter of their mean square over runs is sqrt(2 / independent)."""
    rng, points, own, common = np.random.default_rng(2), 25, 0.03, 0.02
    shape = (1, 4, points, 2)
    sigma = np.full(shape, np.sqrt(2.0 * (own**2 + common**2)))
    runs = []
    for _ in range(3000):
        noise = [own * rng.standard_normal(shape) + common * rng.standard_normal((1, 4, 1, 2)) for _ in range(2)]
        runs.append((((noise[0] - noise[1]) / sigma) ** 2).mean())
    count = independent(np.zeros(shape), SimpleNamespace(common_mean_px=common), sigma)
    assert np.std(runs) == pytest.approx(np.sqrt(2.0 / count), rel=4.0 / np.sqrt(6000))
    assert independent(np.zeros(shape), SimpleNamespace(common_mean_px=0.0), sigma) == 4 * points * 2


def solution(element, kind, amount, moves=5.0):
    return SimpleNamespace(
        element=element, kind=kind, amount=amount, unit="um", boresight_px=np.array([0.5 * moves, -moves])
    )


def chosen(*solutions, glasses=("N-BK7",), edge_px=150.0, **changes):
    config = Config.model_validate({"decentre": changes})
    bench = SimpleNamespace(target=SimpleNamespace(edge_px=edge_px), window_px=13)
    return choose(config, bench, SimpleNamespace(name="lens", glasses=glasses), solutions)


def test_the_element_that_moves_least_is_taken():
    every = (
        solution("L1", "decentre", -200.0),
        solution("L2", "decentre", 90.0),
        solution("L2", "tilt", 1.0),
        solution("L3", "decentre", np.nan),
        solution("L4", "decentre", -80.0),
    )
    assert chosen(*every) is every[4]
    assert chosen(*every, element="L1") is every[0]
    assert chosen(*every, kind="tilt") is every[2]
    with pytest.raises(ConvergenceError, match="no decentre of element L3"):
        chosen(*every, element="L3")
    with pytest.raises(ConvergenceError, match="no glass"):
        chosen(every[3], glasses=())


@pytest.mark.parametrize(
    ("moves", "edge_px", "fits"), [(80.0, 150.0, True), (81.0, 150.0, False), (14.0, 20.0, False), (13.0, 20.0, True)]
)
def test_the_image_must_stay_within_the_search(moves, edge_px, fits):
    """80 px of search, or what lies between the window of 13 px and the edge."""
    if fits:
        assert chosen(solution("L1", "decentre", 10.0, moves), edge_px=edge_px)
    else:
        with pytest.raises(DomainError, match=f"by {moves:g} px"):
            chosen(solution("L1", "decentre", 10.0, moves), edge_px=edge_px)
