"""The search for the movement of an element: an independent trace, symmetries, hand-made functions."""

from dataclasses import replace

import numpy as np
import pytest

from experiments.chromatic.perturbation import solve_perturbation
from experiments.laboratory.bench.ray_prediction import bundle_prediction
from experiments.laboratory.devices.target import corner_directions
from optics.lens.movement import moved_element
from optics.rays.ghosts import trace_ghost
from optics.rays.trace import Rays


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


def through_spheres(lens, position, direction, wavelength_nm):
    """Places (n, 2) of rays through a lens of spheres and planes in global coordinates, and which pass: Snell."""
    n = lens.indices(wavelength_nm)
    inside = np.ones(len(position), bool)
    for i, surface in enumerate(lens.surfaces):
        vertex, normal = surface.position_mm, surface.rotation[:, 2]
        curvature = surface.shape.curvature
        if curvature == 0:
            way = ((vertex - position) @ normal) / (direction @ normal)
            position = position + way[:, None] * direction
            facing = np.broadcast_to(normal, position.shape)
        else:
            centre = vertex + normal / curvature
            to_centre = position - centre
            b = (to_centre * direction).sum(1)
            root = np.sqrt(b**2 - (to_centre**2).sum(1) + curvature**-2)
            way = -b - np.sign(curvature) * root
            position = position + way[:, None] * direction
            facing = (centre - position) * curvature
        from_axis = (position - vertex) - ((position - vertex) @ normal)[:, None] * normal
        inside &= np.linalg.norm(from_axis, axis=1) <= surface.semi_diameter_mm
        cosine, ratio = (direction * facing).sum(1), n[i] / n[i + 1]
        bend = np.sqrt(1 - ratio**2 * (1 - cosine**2)) - ratio * cosine
        direction = ratio * direction + bend[:, None] * facing
    way = (lens.image_position_mm[2] - position[:, 2]) / direction[:, 2]
    return (position + way[:, None] * direction)[:, :2], inside


def mean_spot(camera, aimed, light, wavelength_nm):
    """Mean of the rays, each with the transmission of its own path."""
    lens, losses = camera.focused_lens, camera.losses
    spots, inside = through_spheres(lens, aimed, np.broadcast_to(light, aimed.shape), wavelength_nm)
    x, y, z = aimed.T
    rays = Rays.create(x_mm=x, y_mm=y, z_mm=z, direction=light, wavelength_nm=wavelength_nm)
    paths = trace_ghost(lens, None, rays, np.ones(len(aimed)), coating=losses.coating, absorption=losses.absorption)
    return (inside * paths.weight) @ spots / (inside @ paths.weight)


def brute_force_table1(instrument, bench, direction, pair, rings=40, arms=24):
    """Eq. 16 of one pair from dense bundles through the stop, which lies in front of this lens."""
    lens = instrument.camera.focused_lens
    radius = lens.surfaces[0].semi_diameter_mm * np.sqrt((np.arange(rings)[:, None] + 0.5) / rings)
    phi = 2 * np.pi * (np.arange(arms) + (np.arange(rings)[:, None] * 0.618) % 1) / arms
    start = np.stack([radius * np.cos(phi), radius * np.sin(phi), np.zeros(phi.shape)], axis=-1).reshape(-1, 3)
    mean = {}
    for band in pair:
        w, weight = np.polynomial.legendre.leggauss(6)
        w = bench.filters[band].centre_nm + 50 * w  # a box without edges: 3e-5 px in the result
        weight = weight * instrument.camera.response_at(w) / w**4 / np.expm1(1.4387769e7 / (w * 3000.0))
        mean[band] = np.zeros(2)
        for v in direction.reshape(-1, 3):
            light = np.array([v[0], -v[1], v[2]])
            aimed = start - 5.0 * light / light[2]  # evenly over the stop's plane
            spots = [mean_spot(instrument.camera, aimed, light, wavelength_nm) for wavelength_nm in w]
            mean[band] += weight @ np.array(spots) / weight.sum()
    total = (mean[pair[0]] - mean[pair[1]]) / direction.reshape(-1, 3).shape[0] / 2 / 5.5e-3
    return total * [1, -1]  # rows run against y_lens


@pytest.fixture(scope="module")
def solution_of(engine, star_camera, bench_of):
    bench = bench_of(rows=1, columns=1)
    direction = corner_directions(bench.target, star_camera)
    known = {}

    def solve(element="L2", kind="decentre", axis=0, wanted_px=0.12):
        key = element, kind, axis, wanted_px
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
            )
        return known[key]

    return solve


@pytest.mark.parametrize(
    ("element", "kind", "axis"),
    [
        ("L1", "tilt", 0),
        pytest.param("L2", "decentre", 1, marks=pytest.mark.slow),
    ],
)
def test_solution_by_an_independent_trace(solution_of, star_camera, bench_of, element, kind, axis):
    """The movement found must give the wanted mean in a brute-force trace that knows neither frames nor pupils."""
    bench, found = bench_of(rows=1, columns=1), solution_of(element, kind, axis)
    assert found.table1_px[1][axis] == pytest.approx(0.12, abs=1e-6)
    amount = found.amount / {"decentre": 1e3, "tilt": 60.0}[kind]
    lens = moved_element(star_camera.camera.lens, element, kind, axis, amount)
    moved = replace(star_camera, camera=replace(star_camera.camera, lens=lens))
    direction = corner_directions(bench.target, star_camera)
    expected = np.zeros(2)
    expected[axis] = 0.12
    assert brute_force_table1(moved, bench, direction, (2, 1)) == pytest.approx(expected, abs=5e-5)
    there, rest = (bundle_prediction(bench, one, direction)[:, :, bench.reference] for one in (moved, star_camera))
    assert found.boresight_px == pytest.approx((there - rest).mean((0, 1)), rel=1e-3, abs=1e-3)


def test_no_shift_needs_no_movement(solution_of):
    found = solution_of(wanted_px=0.0)
    assert abs(found.amount) < 0.01  # um
    assert np.abs(found.boresight_px).max() < 0.01


def test_unreachable_shift_is_nan(solution_of):
    assert np.isnan(solution_of(wanted_px=50.0).amount)
