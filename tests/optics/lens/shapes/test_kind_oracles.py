"""Each kind of surface against numbers from elsewhere: printed polynomials, closed forms, other representations."""

import math

import numpy as np
import pytest
from numpy.polynomial.polynomial import polyval2d

from optics import CATALOGUE_AIR, VACUUM, Conic, EvenAsphere, Rays, trace, zernikes
from optics.arrays import NUMPY
from optics.lens.geometry import axial_ray
from optics.lens.prescription import lens_from_table
from optics.lens.shapes import biconic, forbes_asphere, odd_asphere, xy_polynomial, zernike
from optics.lens.shapes.cylinder import Cylinder
from optics.lens.shapes.toroid import Toroid
from optics.rays.paraxial import axial_paraxial

R, RHO = 30.0, 9.0
U = np.linspace(0.0, 1.0, 11)
NOTHING = np.zeros_like(U)

# Forbes 2007, Opt. Express 15, 5218, as printed: tables of the first polynomials in x = u^2
QCON_PRINTED = (
    lambda x: 1.0 + 0.0 * x,
    lambda x: -(5 - 6 * x),
    lambda x: 15 - 14 * x * (3 - 2 * x),
    lambda x: -(35 - 12 * x * (14 - x * (21 - 10 * x))),
    lambda x: 70 - 3 * x * (168 - 5 * x * (84 - 11 * x * (8 - 3 * x))),
    lambda x: -(126 - x * (1260 - 11 * x * (420 - x * (720 - 13 * x * (45 - 14 * x))))),
)
QBFS_PRINTED = (
    lambda x: 1.0 + 0.0 * x,
    lambda x: (13 - 16 * x) / math.sqrt(19),
    lambda x: math.sqrt(2 / 95) * (29 - 4 * x * (25 - 19 * x)),
    lambda x: math.sqrt(2 / 2545) * (207 - 4 * x * (315 - x * (577 - 320 * x))),
    lambda x: (7737 - 16 * x * (4653 - 2 * x * (7381 - 8 * x * (1168 - 509 * x)))) / (3 * math.sqrt(131831)),
    lambda x: (
        (66657 - 32 * x * (28338 - x * (135325 - 8 * x * (35884 - x * (34661 - 12432 * x))))) / (3 * math.sqrt(6632213))
    ),
)


def one(m):
    return (0.0,) * m + (1e-2,)


@pytest.mark.parametrize("m", range(6))
def test_forbes_polynomials_are_the_printed_ones(m):
    r, x = RHO * U, U**2
    conic = Conic(radius_mm=R, conic=-0.7).sag(r, NOTHING)
    qcon = forbes_asphere.Qcon(radius_mm=R, conic=-0.7, norm_radius_mm=RHO, q_mm=one(m)).sag(r, NOTHING)
    np.testing.assert_allclose(qcon - conic, 1e-2 * U**4 * QCON_PRINTED[m](x), atol=1e-14)
    sphere = R - np.sqrt(R**2 - r**2)
    qbfs = forbes_asphere.Qbfs(radius_mm=R, norm_radius_mm=RHO, q_mm=one(m)).sag(r, NOTHING)
    bump = U**2 * (1 - U**2) / np.sqrt(1 - (r / R) ** 2)
    np.testing.assert_allclose(qbfs - sphere, 1e-2 * bump * QBFS_PRINTED[m](x), atol=1e-14)


@pytest.mark.parametrize("k", [-2.0, -1.0, -0.55, 0.7])
def test_mild_forbes_asphere_departs_along_the_normal_of_its_conic(k):
    """Forbes 2007 eq. 3.1: the departure along z is that along the normal times sqrt(1 + slope^2); by differences."""
    r, step = RHO * U, 1e-6
    conic = Conic(radius_mm=R, conic=k)
    slope = (conic.sag(r + step, NOTHING) - conic.sag(r - step, NOTHING)) / (2 * step)
    shape = forbes_asphere.Qbfs(radius_mm=R, conic=k, norm_radius_mm=RHO, q_mm=one(2))
    normal = 1e-2 * U**2 * (1 - U**2) * QBFS_PRINTED[2](U**2)
    np.testing.assert_allclose(shape.sag(r, NOTHING) - conic.sag(r, NOTHING), normal * np.hypot(1.0, slope), atol=1e-11)


def test_forbes_mild_polynomials_have_orthonormal_slopes_to_high_order():
    """What they are made for: the mean over u of dS_m/du dS_n/du with weight 1/sqrt(1 - u^2) is 1 for m = n, 0 else."""
    theta = (np.arange(200) + 0.5) * math.pi / 400
    u, flat = np.sin(theta), 1e9
    slopes = []
    for m in range(20):
        shape = forbes_asphere.Qbfs(radius_mm=flat, norm_radius_mm=1.0, q_mm=(0.0,) * m + (1.0,))
        slope = shape.profile(shape.parameters(), u**2, NUMPY)[1] - 0.5 / flat  # dz/d(u^2)
        slopes.append(2 * u * slope)
    gram = np.mean(np.array(slopes)[:, None] * np.array(slopes)[None], axis=-1)
    np.testing.assert_allclose(gram, np.eye(20), atol=1e-10)


def test_an_odd_asphere_without_odd_terms_is_an_even_one():
    r = RHO * U
    even = EvenAsphere(radius_mm=R, conic=-0.4, asphere=(2e-5, -1e-7, 3e-10))
    odd = odd_asphere.OddAsphere(radius_mm=R, conic=-0.4, terms=(0.0, 0.0, 0.0, 2e-5, 0.0, -1e-7, 0.0, 3e-10))
    np.testing.assert_allclose(odd.sag(r, NOTHING), even.sag(r, NOTHING), atol=1e-15)
    # a paraboloid is a plane with a term in r^2, of the same curvature
    bowl = odd_asphere.OddAsphere(terms=(0.0, 0.5 / R))
    np.testing.assert_allclose(bowl.sag(r, NOTHING), Conic(radius_mm=R, conic=-1.0).sag(r, NOTHING), atol=1e-15)
    assert bowl.curvature == pytest.approx(1.0 / R, rel=1e-15)
    cubic = odd_asphere.OddAsphere(radius_mm=R, terms=(0.0, 0.0, 1e-4))
    np.testing.assert_allclose(cubic.sag(r, NOTHING) - Conic(radius_mm=R, conic=0.0).sag(r, NOTHING), 1e-4 * r**3)


@pytest.mark.parametrize(("ordering", "count"), [("noll", 231), ("fringe", 37)])
def test_zernike_sag_is_the_sum_of_jacobi_polynomials(ordering, count):
    random = np.random.default_rng(3)
    x, y = random.uniform(-RHO / 1.5, RHO / 1.5, (2, 40))
    a = 1e-3 * random.normal(size=count)
    shape = zernike.Zernike(norm_radius_mm=RHO, ordering=ordering, coefficients_mm=tuple(a))
    expected = a @ zernikes(x / RHO, y / RHO, count, ordering)
    np.testing.assert_allclose(shape.sag(x, y), expected, atol=2e-11 if count > 100 else 1e-14)


def test_a_polynomial_has_its_terms_in_the_order_of_design_programs():
    random = np.random.default_rng(4)
    x, y = random.uniform(-RHO / 1.5, RHO / 1.5, (2, 40))
    names = ["x", "y", "xx", "xy", "yy", "xxx", "xxy", "xyy", "yyy", "xxxx", "xxxy", "xxyy"]
    a = 1e-2 * random.normal(size=len(names))
    grid = np.zeros((5, 5))
    for name, value in zip(names, a, strict=True):
        grid[name.count("x"), name.count("y")] = value
    shape = xy_polynomial.XYPolynomial(radius_mm=R, conic=0.3, norm_radius_mm=RHO, coefficients_mm=tuple(a))
    conic = Conic(radius_mm=R, conic=0.3).sag(x, y)
    np.testing.assert_allclose(shape.sag(x, y) - conic, polyval2d(x / RHO, y / RHO, grid), atol=1e-14)


def test_a_toroid_is_its_profile_turned_about_the_axis():
    """Points of the profile, carried round the axis x = 0, z = R by hand."""
    turn_mm, y = -25.0, np.linspace(-8.0, 8.0, 9)[:, None]
    angle = np.linspace(-0.3, 0.3, 7)
    profile = y**2 / 40.0 / (1.0 + np.sqrt(1.0 - 0.5 * (y / 40.0) ** 2)) + 1e-3 * y**2 + 2e-6 * y**4
    lever = turn_mm - profile
    x, z = lever * np.sin(angle), turn_mm - lever * np.cos(angle)
    toroid = Toroid(radius_mm=40.0, conic=-0.5, terms=(1e-3, 2e-6), rotation_radius_mm=turn_mm)
    np.testing.assert_allclose(toroid.sag(x, y + 0.0 * x), z, atol=1e-14)
    straight = Toroid(radius_mm=40.0, conic=-0.5)
    cylinder = Cylinder(radius_mm=40.0, conic=-0.5)
    np.testing.assert_allclose(straight.sag(x, y + 0.0 * x), cylinder.sag(x, y + 0.0 * x), atol=1e-15)
    np.testing.assert_allclose(
        cylinder.sag(x, y + 0.0 * x)[:, 0], Conic(radius_mm=40.0, conic=-0.5).sag(y[:, 0], 0.0), atol=1e-15
    )


def test_a_biconic_is_a_conic_along_each_axis():
    shape = biconic.Biconic(radius_x_mm=25.0, radius_y_mm=-60.0, conic_x=0.3, conic_y=-1.2)
    r = RHO * U
    np.testing.assert_allclose(shape.sag(r, NOTHING), Conic(radius_mm=25.0, conic=0.3).sag(r, NOTHING), atol=1e-15)
    np.testing.assert_allclose(shape.sag(NOTHING, r), Conic(radius_mm=-60.0, conic=-1.2).sag(r, NOTHING), atol=1e-15)
    x, y = np.random.default_rng(5).uniform(-6.0, 6.0, (2, 30))
    same = biconic.Biconic(radius_x_mm=25.0, radius_y_mm=25.0, conic_x=0.3, conic_y=0.3)
    np.testing.assert_allclose(same.sag(x, y), Conic(radius_mm=25.0, conic=0.3).sag(x, y), atol=1e-15)


HEAD = {"name": "test", "source": "closed form", "design_wavelength_nm": 600.0, "max_field_deg": 30.0}
STOP = {"kind": "plane", "thickness_mm": 10.0, "medium": "air", "stop": True, "semi_diameter_mm": 8.0}


def grid_rays(half, direction=(0.0, 0.0, 1.0), z=-10.0):
    x, y = (v.ravel() for v in np.meshgrid(*2 * [np.linspace(-half, half, 9)]))
    return Rays.create(x_mm=x, y_mm=y, z_mm=z, direction=direction, wavelength_nm=600.0)


@pytest.mark.parametrize("focal", [50.0, -80.0])
@pytest.mark.parametrize("slope", [(0.0, 0.0), (0.3, -0.5)])
def test_an_ideal_lens_images_stars_to_f_tan_field_with_equal_paths(focal, slope):
    table = {**HEAD, "surface": [STOP, {"kind": "paraxial", "focal_length_mm": focal, "thickness_mm": focal,
                                       "medium": "air"}]}  # fmt: skip
    lens = lens_from_table(table, where="test")
    start = grid_rays(5.0, (*slope, 1.0))
    out = trace(lens, start)
    n = float(lens.indices(600.0)[0])
    np.testing.assert_allclose(out.x, focal * slope[0], atol=1e-12)
    np.testing.assert_allclose(out.y, focal * slope[1], atol=1e-12)
    paths = out.opl_mm + n * (start.x * start.dx + start.y * start.dy + start.z * start.dz)
    np.testing.assert_allclose(paths, paths[0], atol=1e-12)


@pytest.mark.parametrize("environment", [CATALOGUE_AIR, VACUUM])
def test_the_focal_length_of_an_ideal_lens_is_that_in_its_surroundings(environment):
    """Between air and glass the focus lies at n'/n0 f (Gauss); by real rays, by matrices, and from the file's rows."""
    thin = {"kind": "paraxial", "focal_length_mm": 100.0, "thickness_mm": 7.0, "medium": "N-BK7"}
    face = {"kind": "plane", "thickness_mm": 60.0, "medium": "air"}
    lens = lens_from_table({**HEAD, "surface": [STOP, thin, face]}, where="test", environment=environment)
    n = lens.indices(600.0)
    ratio = float(n[2] / n[0])
    assert axial_paraxial(lens, 600.0).efl_mm == pytest.approx(100.0, abs=1e-12)
    assert axial_paraxial(lens, 600.0).bfl_mm == pytest.approx(100.0 - 7.0 / ratio, abs=1e-12)
    assert axial_ray(lens)[1] == pytest.approx(100.0, abs=1e-12)
    out = trace(lens, Rays.create(x_mm=1e-4, y_mm=0.0, z_mm=0.0, direction=[0, 0, 1.0], wavelength_nm=600.0))
    assert float(-out.x / out.dx * out.dz) + 60.0 == pytest.approx(100.0 - 7.0 / ratio, abs=1e-8)
