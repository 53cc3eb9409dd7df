"""Search of a movement on hand-made functions."""

import numpy as np
import pytest

from optics.lens.movement import moved_element, refined_movement, smallest_movement
from optics.lens_file import load_lens


@pytest.mark.parametrize(
    ("function", "root"),
    [
        (lambda x: 2 * x - 1, 0.5),
        (lambda x: -2 * x - 1, -0.5),
        (lambda x: x, 0.0),
        (lambda x: x + 0.3 * x**3 - 1.3, 1.0),
        (lambda x: x - 2.99, 2.99),
        (lambda x: x - 3.01, np.nan),
        (lambda x: np.exp(x) - 4.5, np.log(4.5)),  # far from linear: the slope alone would look beyond the limit
        (lambda x: 1.0 + x * x, np.nan),
        (lambda x: np.nan, np.nan),
    ],
)
def test_root_nearest_to_zero(function, root):
    assert smallest_movement(function, 3.0) == pytest.approx(root, abs=1e-5, nan_ok=True)


def test_a_root_is_refined_from_that_of_an_approximation():
    """The approximation has 1 % another slope and root: five chords leave 1e-10 of the difference."""
    calls = []

    def exact(x):
        calls.append(x)
        return 1.01 * (x - 1.0) + 0.01 * (x - 1.0) ** 2

    root = refined_movement(exact, lambda x: x - 1.02, 1.02, 1e-9)
    assert root == pytest.approx(1.0, abs=1e-9)
    assert len(calls) <= 6


def test_kinds_of_movement():
    lens = load_lens("star_camera_206mm")
    before, after = (
        one.surfaces[one.indices_of("L2")[0]] for one in (lens, moved_element(lens, "L2", "decentre", 1, 0.2))
    )
    np.testing.assert_allclose(after.position_mm - before.position_mm, [0.0, 0.2, 0.0], atol=1e-12)
    turned = moved_element(lens, "L2", "tilt", 0, 0.5).surfaces[lens.indices_of("L2")[0]]
    assert np.degrees(np.arccos(turned.rotation[2, 2])) == pytest.approx(0.5)
    assert abs(turned.rotation[0, 2]) > 100.0 * abs(turned.rotation[1, 2])
