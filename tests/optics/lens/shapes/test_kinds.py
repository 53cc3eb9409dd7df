"""What every kind of surface promises, one example each: nothing here knows how a kind is computed."""

import math
from dataclasses import fields, replace

import numpy as np
import pytest
from lens_texts import table_lens
from refusals import refuses

from optics import Conic, EvenAsphere, Plane, Rays, Sphere, paraxial, trace
from optics.arrays import NUMPY
from optics.errors import DomainError
from optics.lens.perturb import change_shape, change_temperature, decentre, tilt
from optics.lens.shapes import biconic, forbes_asphere, odd_asphere, registry, thin_lens, toroid, xy_polynomial, zernike
from optics.lens.shapes.cylinder import Cylinder
from optics.rays.reverse import retraced, reverse

COEFFICIENTS = (0.01, -0.02, 0.015, 0.03, -0.01, 0.02, 0.005, -0.004, 0.003, 0.006, -0.002, 0.001)
EXAMPLES = (
    Plane(),
    Sphere(radius_mm=-40.0),
    Conic(radius_mm=35.0, conic=-1.7),
    EvenAsphere(radius_mm=45.0, conic=0.4, asphere=(2e-6, -3e-9, 1e-12)),
    odd_asphere.OddAsphere(radius_mm=45.0, conic=0.4, terms=(0.0, 1e-3, 2e-5, -1e-6)),
    forbes_asphere.Qcon(radius_mm=40.0, conic=-0.5, norm_radius_mm=9.0, q_mm=(0.05, -0.02, 0.01, 0.003)),
    forbes_asphere.Qbfs(radius_mm=-35.0, norm_radius_mm=9.0, q_mm=(0.05, -0.02, 0.01, 0.003)),
    forbes_asphere.Qbfs(radius_mm=30.0, conic=-1.4, norm_radius_mm=9.0, q_mm=(0.05, -0.02, 0.01, 0.003)),
    thin_lens.ThinLens(focal_length_mm=80.0),
    Cylinder(radius_mm=30.0, conic=0.2),
    toroid.Toroid(radius_mm=40.0, conic=-0.5, terms=(1e-3, 2e-6), rotation_radius_mm=-25.0),
    biconic.Biconic(radius_x_mm=25.0, radius_y_mm=-60.0, conic_x=0.3, conic_y=-1.2),
    zernike.Zernike(radius_mm=50.0, conic=-1.0, norm_radius_mm=9.0, ordering="noll", coefficients_mm=COEFFICIENTS),
    xy_polynomial.XYPolynomial(radius_mm=50.0, conic=0.5, norm_radius_mm=9.0, coefficients_mm=COEFFICIENTS[:9]),
)
REACH_MM = 8.0
"""Half width of the region that is looked at; every example reaches that far."""

every_kind = pytest.mark.parametrize("shape", EXAMPLES, ids=lambda shape: shape.kind)


def points(count=200):
    return np.random.default_rng(1).uniform(-REACH_MM / math.sqrt(2), REACH_MM / math.sqrt(2), (2, count))


def directions(count=200):
    slopes = np.random.default_rng(2).uniform(-0.3, 0.3, (2, count))
    return np.array([*slopes, np.ones(count)]) / np.sqrt(1.0 + (slopes**2).sum(0))


def keys(shape):
    """The shape as a table of a lens file."""
    return {"kind": shape.kind, **{field.name: getattr(shape, field.name) for field in fields(shape)}}


def lens_with(shape):
    """A plano lens whose first surface has the shape; its stop is in front."""
    common = {"semi_diameter_mm": REACH_MM, "element": "L1"}
    front = {**keys(shape), "thickness_mm": 6.0, "medium": "N-BK7", **common}
    back = {"radius_mm": -300.0, "thickness_mm": 90.0, "medium": "air", **common}
    return table_lens(front, back, stop={"z_mm": -5.0, "semi_diameter_mm": 5.0})


def test_every_listed_kind_has_an_example_and_a_name_of_its_own():
    assert {type(shape) for shape in EXAMPLES} == set(registry.SHAPES)
    assert len({shape.kind for shape in registry.SHAPES}) == len(registry.SHAPES)


@every_kind
def test_rays_meet_the_surface_where_its_sag_says(shape):
    (x, y), d = points(), directions()
    hit = shape.intersect(shape.parameters(), x, y, d, NUMPY)
    for start, along, reached in zip((x, y, 0.0), d, (hit.x, hit.y, hit.z), strict=True):
        np.testing.assert_allclose(reached, start + hit.path * along, atol=1e-14)
    np.testing.assert_allclose(hit.z, shape.sag(hit.x, hit.y), atol=3e-14)
    assert hit.valid is None or np.all(hit.valid)


@every_kind
def test_normals_are_those_of_the_sag(shape):
    (x, y), d, step = points(), directions(), 1e-3
    hit = shape.intersect(shape.parameters(), x, y, d, NUMPY)

    def slope(dx, dy):  # fourth order in the step
        near = shape.sag(hit.x + dx, hit.y + dy) - shape.sag(hit.x - dx, hit.y - dy)
        far = shape.sag(hit.x + 2 * dx, hit.y + 2 * dy) - shape.sag(hit.x - 2 * dx, hit.y - 2 * dy)
        return (8.0 * near - far) / (12.0 * step)

    zx, zy = slope(step, 0.0), slope(0.0, step)
    length = np.sqrt(1.0 + zx**2 + zy**2)
    normal = np.array([-zx, -zy, np.ones_like(zx)]) / length
    for got, wanted in zip((hit.nx, hit.ny, hit.nz), normal, strict=True):
        np.testing.assert_allclose(np.broadcast_to(got, wanted.shape), wanted, atol=1e-11)
    np.testing.assert_allclose(hit.cos_i, (normal * d).sum(0), atol=1e-11)


@every_kind
def test_curvature_is_that_of_the_sag_at_the_vertex(shape):
    step = 1e-2
    along_x, along_y = shape.sag(np.array([step, -step]), 0.0), shape.sag(0.0, np.array([step, -step]))
    second = (along_x.sum() + along_y.sum() - 4.0 * shape.sag(0.0, 0.0)) / (2.0 * step**2)
    assert second == pytest.approx(shape.curvature, abs=1e-6)


@every_kind
def test_a_surface_of_revolution_is_one_and_another_is_not(shape):
    x, y = points()
    turned = [
        np.abs(shape.sag(x * math.cos(a) - y * math.sin(a), x * math.sin(a) + y * math.cos(a)) - shape.sag(x, y)).max()
        for a in (0.5, 1.0)
    ]
    assert (max(turned) < 1e-13) == shape.rotational


@every_kind
def test_flipped_and_scaled(shape):
    x, y = points()
    np.testing.assert_allclose(shape.flipped().sag(x, y), -shape.sag(-x, y), atol=1e-15)
    assert shape.flipped().flipped() == shape
    np.testing.assert_allclose(shape.scaled(1.25).sag(x, y), 1.25 * shape.sag(x / 1.25, y / 1.25), atol=1e-14)


@every_kind
def test_sag_ends_at_the_rim(shape):
    outside = min(1.001 * shape.rim_mm, 1e3)
    near = np.array([0.999 * outside, outside])
    ends = np.isnan([shape.sag(near, 0.0), shape.sag(0.0, near)]).any(0)
    assert ends.tolist() == ([False, True] if math.isfinite(shape.rim_mm) else [False, False])


@every_kind
def test_a_lens_file_names_it_and_gives_it_back(shape):
    assert lens_with(shape).surfaces[1].shape == shape


@every_kind
def test_numpy_and_drjit_agree(shape):
    llvm = pytest.importorskip("drjit.llvm")
    arrays = pytest.importorskip("render.engine.arrays").DrJitArrays(llvm.Float64)
    (x, y), d = points(), directions()
    expected = shape.intersect(shape.parameters(), x, y, d, NUMPY)
    on_llvm = [llvm.Float64(v) for v in (x, y, *d)]
    got = shape.intersect(arrays.parameters(shape.parameters()), *on_llvm[:2], on_llvm[2:], arrays)
    for name in ("path", "x", "y", "z", "nx", "ny", "nz", "cos_i"):
        np.testing.assert_allclose(np.array(getattr(got, name)), getattr(expected, name), rtol=0, atol=1e-13)


@every_kind
def test_light_goes_back_the_way_it_came_through_a_lens_out_of_line(shape):
    lens = tilt(decentre(lens_with(shape), 1, 0.2, -0.1), "L1", 0.4, 0.3)
    x, y = points() / 2.0
    rays = Rays.create(x_mm=x, y_mm=y, z_mm=-10.0, direction=[0.02, 0.03, 1.0], wavelength_nm=600.0)
    out = trace(lens, rays)
    keep = out.ok
    assert keep.sum() > 100
    arrived, start = (Rays(**{k: getattr(r, k)[keep] for k in Rays.__dataclass_fields__}) for r in (out, rays))
    back = trace(reverse(lens), retraced(lens, arrived))
    assert back.ok.all()
    to_plane = -start.z / start.dz  # the reversed lens ends in the plane z = 0 of the lens frame
    np.testing.assert_allclose(-back.x, start.x + to_plane * start.dx, atol=1e-12)
    np.testing.assert_allclose(back.y, start.y + to_plane * start.dy, atol=1e-12)
    np.testing.assert_allclose(back.opl_mm, arrived.opl_mm - to_plane * lens.indices(600.0)[0], atol=1e-11)


@every_kind
def test_its_numbers_change_one_at_a_time_and_by_temperature(shape):
    lens = lens_with(shape)
    for field in fields(shape):
        if not isinstance(getattr(shape, field.name), float):
            continue
        changed = change_shape(lens, 1, field.name, 0.01).surfaces[1].shape
        assert changed == replace(shape, **{field.name: getattr(shape, field.name) + 0.01})
    warm = change_temperature(lens, 45.0, housing_cte_per_k=23.6e-6).surfaces[1].shape
    growth = math.exp(lens.glasses["N-BK7"].cte_per_k * (45.0 - lens.environment.temperature_c))
    assert warm == shape.scaled(growth)


@every_kind
def test_paraxial_quantities_exist_for_surfaces_of_revolution_only(shape):
    lens = lens_with(shape)
    if shape.rotational:
        assert paraxial(lens).efl_mm != 0.0
    else:
        refuses(DomainError, "not a surface of revolution", paraxial, lens)


@pytest.mark.parametrize(
    ("keys", "shape"),
    [
        ({}, Plane()),
        ({"radius_mm": math.inf, "conic": -0.5}, Plane()),
        ({"radius_mm": 20.0}, Sphere(radius_mm=20.0)),
        ({"radius_mm": 20.0, "conic": -0.5}, Conic(radius_mm=20.0, conic=-0.5)),
        ({"asphere": (1e-5,)}, EvenAsphere(asphere=(1e-5,))),
    ],
)
def test_without_kind_the_simplest_shape_comes_out(keys, shape):
    assert EvenAsphere(**keys).simplest() == shape


def test_a_sphere_with_a_conic_constant_is_a_conic():
    assert Sphere(radius_mm=9.0).changed("conic", 0.2) == Conic(radius_mm=9.0, conic=0.2)
