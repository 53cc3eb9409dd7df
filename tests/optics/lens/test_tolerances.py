"""Perturbations within tolerances: names, amounts, distributions."""

import numpy as np
import pytest

from optics import decentre, load_lens
from optics.lens.tolerances import Tolerances, draw_amounts, perturbations, perturbed

LENS = load_lens("star_tracker_26mm")


def test_moves_are_those_of_their_names_and_every_tolerance_has_one():
    moves = perturbations(LENS, Tolerances(decentre_mm=0.003, index=1e-4))
    assert not any(name.startswith(("tilt", "wedge", "radius", "thickness")) for name in moves)
    first = LENS.elements[0]
    amounts = np.array([2.0 * (name == f"decentre x of {first}") for name in moves])
    made, by_hand = perturbed(LENS, moves, amounts), decentre(LENS, first, 0.006, 0.0)
    for a, b in zip(made.surfaces, by_hand.surfaces, strict=True):
        np.testing.assert_allclose(a.position_mm, b.position_mm, atol=1e-15)
    every = Tolerances(
        decentre_mm=0.01, tilt_deg=0.01, wedge_deg=0.01, thickness_mm=0.01, radius_fraction=1e-3, index=1e-4
    )
    kinds = {name.split()[0] for name in perturbations(LENS, every)}
    assert kinds == {"decentre", "tilt", "wedge", "thickness", "radius", "index"}
    assert perturbations(LENS, Tolerances()) == {}


@pytest.mark.parametrize("uniform", [False, True])
def test_amounts_have_unit_standard_deviation(uniform):
    drawn = draw_amounts(np.random.default_rng(1), 4000, 5, uniform=uniform)
    assert drawn.std() == pytest.approx(1.0, abs=5.0 / np.sqrt(2.0 * drawn.size))
    assert (np.abs(drawn).max() <= np.sqrt(3.0)) == uniform
