"""ACC18's statistic, the predictions, the search for the decentre: hand-made fields, closed forms, another trace."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from experiments.chromatic.model import (
    _root,
    after_calibration,
    band_pairs,
    bundle_prediction,
    expected_spots,
    paraxial_prediction,
    perturbed,
    rms,
    shifts,
    solve_perturbation,
    table1,
)
from experiments.laboratory.target import corner_directions
from optics.glass.catalogue import Glass
from optics.lens.shapes.plane import Plane
from optics.lens.shapes.sphere import Sphere
from optics.lens.system import LensSystem, Surface
from render.camera import Camera


@pytest.fixture
def field():
    """Places (4, 25, 2) of the target's points from the centre, and a generator."""
    grid = np.stack(np.meshgrid(np.arange(-2, 3) * 150.0, np.arange(-2, 3) * 150.0), axis=-1).reshape(25, 2)
    centres = np.array([[-1600, -570], [1600, -570], [-1600, 570], [1600, 570.0]])
    return centres[:, None] + grid


def test_pairs_put_the_longer_wavelength_first():
    assert band_pairs((500.0, 600.0, 800.0), 1) == [("600-500", 1, 0), ("800-600", 2, 1)]
    assert band_pairs((800.0, 600.0, 500.0), 1) == [("800-600", 0, 1), ("600-500", 1, 2)]
    assert band_pairs((500.0, 600.0, 800.0), 0) == [("600-500", 1, 0), ("800-500", 2, 0)]
    assert band_pairs((656.3, 486.1), 0) == [("656.3-486.1", 0, 1)]


def test_shift_is_longer_minus_shorter_wavelength():
    position = np.zeros((4, 25, 3, 2))
    position[..., 0, :], position[..., 2, :] = [1.0, 2.0], [10.0, 20.0]
    found = shifts(position, band_pairs((500.0, 600.0, 800.0), 1))
    assert np.all(found["600-500"] == [-1.0, -2.0])
    assert np.all(found["800-600"] == [10.0, 20.0])


def test_eq_16_of_an_odd_field_vanishes_and_of_a_constant_is_half(field):
    odd = field * 1e-4 + field * (field**2).sum(-1, keepdims=True) * 1e-11
    assert np.abs(odd).max() > 0.2
    assert table1(odd) == pytest.approx([0, 0], abs=1e-15)
    assert table1(odd + np.array([0.24, -0.1])) == pytest.approx([0.12, -0.05], abs=1e-15)


def test_eq_16_counts_every_point_alike():
    one = np.zeros((4, 25, 2))
    one[2, 7] = [200.0, -400.0]
    assert table1(one) == pytest.approx([1.0, -2.0])  # 200 / (2 * 4 * 25)
    assert table1(np.stack([one, 2 * one])) == pytest.approx(np.array([[1.0, -2.0], [2.0, -4.0]]))


def test_rms_is_per_axis():
    shift = np.zeros((4, 25, 2))
    shift[:, :, 0] = 0.3 * np.where(np.arange(25) % 2, 1, -1)
    shift[:2, :, 1] = 0.4
    assert rms(shift) == pytest.approx([0.3, 0.4 / np.sqrt(2)])


def test_calibration_of_a_pure_offset(field):
    left = after_calibration(np.broadcast_to([0.2, -0.1], field.shape), field)
    assert np.abs(left["as found"] - [0.2, -0.1]).max() == 0
    assert np.abs(left["principal point"]).max() < 1e-14
    # the four positions lie symmetrically: no scale looks like an offset
    assert np.abs(left["focal length"] - [0.2, -0.1]).max() < 1e-14
    assert np.abs(left["both"]).max() < 1e-14


def test_calibration_of_a_pure_scale(field):
    left = after_calibration(1e-4 * field, field)
    assert np.abs(left["principal point"] - 1e-4 * field).max() < 1e-14
    assert np.abs(left["focal length"]).max() < 1e-14
    assert np.abs(left["both"]).max() < 1e-14


def test_calibration_of_both_on_one_side_of_the_field(field):
    """Away from symmetry the two parameters mix; fitted together they still find each its own."""
    place = field[:1] + np.array([5000.0, 3000.0])
    left = after_calibration(1e-4 * place + [0.2, -0.1], place)
    assert np.abs(left["both"]).max() < 1e-12
    assert np.abs(left["focal length"]).max() > 1e-3
    assert np.abs(left["principal point"]).max() > 1e-3


def test_calibration_leaves_the_cubic(field):
    """What is left is orthogonal to what was fitted, and is the cubic minus its own best scale."""
    squared = (field**2).sum(-1, keepdims=True)
    cubic = 1e-11 * squared * field
    left = after_calibration(cubic + 3e-5 * field + [0.05, 0.02], field)["both"]
    scale = (squared**2).sum() / squared.sum()  # sum(r^3 r) / sum(r r)
    assert np.abs(left - 1e-11 * (squared - scale) * field).max() < 1e-13
    assert (left * field).sum() == pytest.approx(0, abs=1e-9)
    assert left.sum((0, 1)) == pytest.approx([0, 0], abs=1e-11)


def test_calibration_leaves_its_inputs_alone(field):
    shift, place = 1e-4 * field, field.copy()
    before = shift.copy()
    after_calibration(shift, place)["as found"][:] = 7.0
    assert np.array_equal(place, field)
    assert np.array_equal(shift, before)


N_LAMBDA = Glass(name="flint", source="made up", B=(1.25,), C=(0.02,), range_nm=(300.0, 1100.0))
RADIUS_MM, GAP_MM, IMAGE_MM = 60.0, 20.0, 112.0


def dispersion(wavelength_nm):
    square = (np.asarray(wavelength_nm) * 1e-3) ** 2
    return np.sqrt(1 + 1.25 * square / (square - 0.02))


@pytest.fixture(scope="module")
def singlet():
    """A thin plano-convex lens behind a stop: an instrument whose lateral colour is a closed form."""

    def surface(z, medium, shape, **more):
        return Surface(shape=shape, position_mm=np.array([0.0, 0.0, z]), medium=medium, **more)

    thin = 1e-9
    lens = LensSystem(
        name="singlet",
        source="test",
        surfaces=(
            surface(0.0, "air", Plane(), semi_diameter_mm=0.01, is_stop=True),
            surface(GAP_MM, "flint", Sphere(radius_mm=RADIUS_MM), semi_diameter_mm=30.0),
            surface(GAP_MM + thin, "air", Plane(), semi_diameter_mm=30.0),
        ),
        glasses={"flint": N_LAMBDA},
        image_position_mm=np.array([0.0, 0.0, GAP_MM + thin + IMAGE_MM]),
        design_wavelength_nm=600.0,
        max_field_deg=8.0,
    )
    camera = Camera(lens=lens, width_px=4096, height_px=2048, pixel_pitch_mm=5.5e-3)
    return SimpleNamespace(camera=camera, focal_length_mm=112.0, config=SimpleNamespace(exposure_s=0.1, defocus_mm=0.0))


def chief_height_mm(tangent, wavelength_nm):
    """Stop, gap, thin lens of power (n - 1) / R, image plane; the glass's index counts relative to air."""
    height = GAP_MM * tangent
    return height + IMAGE_MM * (tangent - height * (dispersion(wavelength_nm) - 1) / RADIUS_MM)


def band_mean(bench, function):
    """Mean over the light of each filter: a dense trapezoid with the lamp's Planck spectrum in photons."""
    means = []
    for band in bench.filters:
        w = np.linspace(band.centre_nm - 60, band.centre_nm + 60, 24001)
        edge = np.clip((50 - np.abs(w - band.centre_nm)) / 10 + 0.5, 0, 1)  # 100 nm wide, 10 nm edges
        light = edge / w**4 / np.expm1(1.4387769e7 / (w * 3000.0))
        means.append((light * function(w)).sum() / light.sum())
    return np.array(means)


def test_paraxial_prediction_of_a_singlet_is_the_closed_form(singlet, bench_of):
    bench = bench_of()
    direction = corner_directions(bench.target, singlet)
    found = paraxial_prediction(bench, singlet, direction)
    per_tangent = band_mean(bench, lambda w: chief_height_mm(1.0, w)) / 5.5e-3
    tangent = direction[..., :2] / direction[..., 2:]
    expected = tangent[:, :, None, :] * (per_tangent - per_tangent[1])[:, None]
    assert np.abs(expected).max() > 1.0
    # the filter's edges are linear here; the nodes of the prediction may round them by some 1e-5
    assert np.abs(found - expected).max() < 2e-4 * np.abs(expected).max()
    assert np.all(found[:, :, 1] == 0)


def test_real_rays_of_a_singlet_approach_the_paraxial_shift_near_the_axis(singlet, bench_of):
    bench = bench_of()
    angle = np.radians(0.01)
    direction = np.array([[[np.sin(angle), 0, np.cos(angle)], [0, -np.sin(angle), np.cos(angle)]]])
    real = bundle_prediction(bench, singlet, direction)
    paraxial = paraxial_prediction(bench, singlet, direction)
    for name, shift in shifts(real, band_pairs((500.0, 600.0, 800.0), 1)).items():
        expected = shifts(paraxial, band_pairs((500.0, 600.0, 800.0), 1))[name]
        assert np.abs(shift - expected).max() < 1e-5 * np.abs(expected).max()


def test_spot_radius_of_a_defocused_lens(star_camera, bench_of):
    """Far out of focus the spot is a cut through the cone of an F/2.95 beam, filled evenly in sin^2 of its angle."""
    bench = bench_of(rows=1, columns=1)
    axis = np.array([[[0.0, 0.0, 1.0]]])
    radius = [
        expected_spots(bench, replace(star_camera, camera=replace(star_camera.camera, defocus_mm=d)), axis)[1]
        for d in (-1.0, 1.0)
    ]
    steepest = (0.5 / 2.95) ** 2
    rms_tangent = np.sqrt(-np.log1p(-steepest) / steepest - 1)  # mean of s / (1 - s) over s = 0 ... steepest
    # the mean of both sides takes out where the focus of each filter is
    assert np.mean(radius, axis=0) == pytest.approx(rms_tangent / 5.5e-3, rel=3e-3)


def test_mirrored_decentre_gives_the_mirrored_image(star_camera, bench_of):
    bench = bench_of()
    direction = corner_directions(bench.target, star_camera)

    def image(kind, axis, amount, points):
        lens = perturbed(star_camera.camera.lens, "L2", kind, axis, amount)
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
    """Rays (n, 3) through a lens of spheres and planes in global coordinates, without frames: vector Snell's law."""
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
    return (position + way[:, None] * direction)[inside, :2]


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
            spots = [through_spheres(lens, aimed, np.broadcast_to(light, aimed.shape), one).mean(0) for one in w]
            mean[band] += weight @ np.array(spots) / weight.sum()
    total = (mean[pair[0]] - mean[pair[1]]) / direction.reshape(-1, 3).shape[0] / 2 / 5.5e-3
    return total * [1, -1]  # rows run against y_lens


@pytest.fixture(scope="module")
def solution_of(engine, star_camera, bench_of):
    bench = bench_of()
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


@pytest.mark.parametrize(("element", "kind", "axis"), [("L2", "decentre", 0), ("L1", "tilt", 0), ("L2", "decentre", 1)])
def test_solution_by_an_independent_trace(solution_of, star_camera, bench_of, element, kind, axis):
    """The movement found must give the wanted mean in a brute-force trace that knows neither frames nor pupils."""
    bench, found = bench_of(), solution_of(element, kind, axis)
    assert found.table1_px["800-600"][axis] == pytest.approx(0.12, abs=1e-6)
    amount = found.amount / {"decentre": 1e3, "tilt": 60.0}[kind]
    lens = perturbed(star_camera.camera.lens, element, kind, axis, amount)
    moved = replace(star_camera, camera=replace(star_camera.camera, lens=lens))
    direction = corner_directions(bench.target, star_camera)
    expected = np.zeros(2)
    expected[axis] = 0.12
    assert brute_force_table1(moved, bench, direction, (2, 1)) == pytest.approx(expected, abs=5e-5)


def test_solution_of_the_opposite_shift_is_the_opposite_movement(solution_of):
    one, other = solution_of(wanted_px=0.12), solution_of(wanted_px=-0.12)
    assert other.amount == pytest.approx(-one.amount, rel=1e-5)
    assert other.table1_px["600-500"] == pytest.approx(-one.table1_px["600-500"], abs=1e-6)
    assert other.boresight_px == pytest.approx(-one.boresight_px, abs=1e-3)


def test_no_shift_needs_no_movement(solution_of):
    found = solution_of(wanted_px=0.0)
    assert abs(found.amount) < 0.01  # um
    assert np.abs(found.boresight_px).max() < 0.01


def test_unreachable_shift_is_nan(solution_of):
    assert np.isnan(solution_of(wanted_px=50.0).amount)


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
    assert _root(function, 3.0) == pytest.approx(root, abs=1e-5, nan_ok=True)
