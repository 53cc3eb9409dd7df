"""The search for the movement of an element: an independent trace, symmetries."""

from dataclasses import replace

import numpy as np
import pytest

from calib.accuracy.chromatic import table1
from experiments.chromatic.perturbation import solve_perturbation
from experiments.laboratory.bench.ray_prediction import bundle_prediction
from experiments.laboratory.devices.target import corner_directions
from optics.lens.movement import moved_element


def test_mirrored_decentre_gives_the_mirrored_image(star_camera, bench_of):
    bench = bench_of()
    direction = corner_directions(bench.target, star_camera)

    def image(kind, axis, amount, points):
        lens = moved_element(star_camera.camera.lens, "L2", kind, axis, amount)
        moved = replace(star_camera, camera=replace(star_camera.camera, lens=lens))
        return bundle_prediction(bench, moved, points) - [2047.5, 1023.5]

    for kind, amount in (("decentre", 0.117), ("tilt", 0.5)):
        for axis in range(2):
            flip = np.where(np.arange(2) == axis, -1.0, 1.0)
            there = image(kind, axis, amount, direction)
            back = image(kind, axis, -amount, direction * [*flip, 1.0])
            assert np.abs(there - back * flip).max() < 1e-9
            assert np.abs(there - image(kind, axis, 0.0, direction)).max() > 1.0


@pytest.fixture(scope="module")
def solution_of(engine, star_camera, bench_of):
    bench = bench_of(rows=1, columns=1)
    direction = corner_directions(bench.target, star_camera)
    known = {}

    def solve(element="L2", kind="decentre", axis=0, wanted_px=0.12, weighted=True):
        key = element, kind, axis, wanted_px, weighted
        if key not in known:
            known[key] = solve_perturbation(
                bench,
                star_camera,
                direction,
                element=element,
                kind=kind,
                pair="800-600",
                axis=axis,
                wanted_px=wanted_px,
                weighted=weighted,
            )
        return known[key]

    return solve


@pytest.mark.slow
@pytest.mark.parametrize(("element", "kind", "axis"), [("L1", "tilt", 0), ("L2", "decentre", 1)])
def test_solution_by_the_trace_on_numpy(solution_of, star_camera, bench_of, element, kind, axis):
    """The movement gives the wanted mean by a trace that knows neither kernel nor frames; rays weighted by their own
    transmission need another by less than 1 %."""
    bench, found = bench_of(rows=1, columns=1), solution_of(element, kind, axis, weighted=False)
    amount = found.amount / {"decentre": 1e3, "tilt": 60.0}[kind]
    lens = moved_element(star_camera.camera.lens, element, kind, axis, amount)
    moved = replace(star_camera, camera=replace(star_camera.camera, lens=lens))
    direction = corner_directions(bench.target, star_camera)
    there, rest = (bundle_prediction(bench, one, direction) for one in (moved, star_camera))
    expected = np.zeros(2)
    expected[axis] = 0.12
    assert table1(there[:, :, 2] - there[:, :, 1]) == pytest.approx(expected, abs=1e-4)
    assert found.boresight_px == pytest.approx((there - rest)[:, :, 1].mean((0, 1)), rel=1e-3, abs=1e-3)
    weighted = solution_of(element, kind, axis)
    assert weighted.table1_px[1][axis] == pytest.approx(0.12, abs=1e-6)
    assert 1e-5 < abs(weighted.amount / found.amount - 1.0) < 0.01


def test_no_shift_needs_no_movement(solution_of):
    found = solution_of(wanted_px=0.0)
    assert abs(found.amount) < 0.01  # um
    assert np.abs(found.boresight_px).max() < 0.01


def test_unreachable_shift_is_nan(solution_of):
    assert np.isnan(solution_of(wanted_px=50.0).amount)
