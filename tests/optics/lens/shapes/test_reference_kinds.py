"""Where rays meet surfaces, and their normals, against optiland's geometries, which iterate in their own way."""

import warnings

import numpy as np
import pytest

from optics.arrays import NUMPY
from optics.lens.shapes import forbes_asphere, odd_asphere, toroid, xy_polynomial
from optics.lens.shapes.zernike import Zernike

pytestmark = [pytest.mark.reference, pytest.mark.slow]

A = (0.01, -0.02, 0.015, 0.03, -0.01, 0.02, 0.005, -0.004, 0.003)
PRECISE = {"tol": 1e-14}


def powers():
    """The coefficients of a polynomial as optiland's grid over powers of x and y."""
    grid = np.zeros((4, 4))
    order = [(1, 0), (0, 1), (2, 0), (1, 1), (0, 2), (3, 0), (2, 1), (1, 2), (0, 3)]
    for (i, j), a in zip(order, A, strict=True):
        grid[i, j] = a * 9.0 ** -(i + j)
    return grid


def theirs(name, place):
    geometries = pytest.importorskip("optiland.geometries")  # three seconds, which no collection should take
    match name:
        case "odd_asphere":
            return geometries.OddAsphere(place, 45.0, 0.4, coefficients=[0.0, 1e-3, 2e-5, -1e-6], **PRECISE)
        case "toroid":
            return geometries.ToroidalGeometry(place, -25.0, 40.0, -0.5, [1e-3, 2e-6], **PRECISE)
        case "polynomial":
            return geometries.PolynomialGeometry(place, 50.0, 0.5, coefficients=powers(), **PRECISE)
        case "zernike noll" | "zernike fringe":
            return geometries.ZernikePolynomialGeometry(
                place, 50.0, -1.0, coefficients=list(A), zernike_type=name.split()[1], norm_radius=9.0, **PRECISE
            )
        case "qbfs":
            from optiland.geometries import forbes

            terms = dict(enumerate((0.05, -0.02, 0.01, 0.003)))
            config = forbes.ForbesSurfaceConfig(radius=-35.0, conic=0.0, terms=terms, norm_radius=9.0)
            return forbes.ForbesQNormalSlopeGeometry(place, config, forbes.ForbesSolverConfig(tol=1e-14))


OURS = {
    "odd_asphere": odd_asphere.OddAsphere(radius_mm=45.0, conic=0.4, terms=(0.0, 1e-3, 2e-5, -1e-6)),
    "toroid": toroid.Toroid(radius_mm=40.0, conic=-0.5, terms=(1e-3, 2e-6), rotation_radius_mm=-25.0),
    "polynomial": xy_polynomial.XYPolynomial(radius_mm=50.0, conic=0.5, norm_radius_mm=9.0, coefficients_mm=A),
    "zernike noll": Zernike(radius_mm=50.0, conic=-1.0, norm_radius_mm=9.0, ordering="noll", coefficients_mm=A),
    "zernike fringe": Zernike(radius_mm=50.0, conic=-1.0, norm_radius_mm=9.0, ordering="fringe", coefficients_mm=A),
    "qbfs": forbes_asphere.Qbfs(radius_mm=-35.0, norm_radius_mm=9.0, q_mm=(0.05, -0.02, 0.01, 0.003)),
}


@pytest.mark.parametrize("name", OURS)
def test_rays_meet_the_surface_where_optiland_s_do(name):
    pytest.importorskip("optiland")
    from optiland.coordinate_system import CoordinateSystem
    from optiland.rays import RealRays

    random = np.random.default_rng(9)
    x, y = random.uniform(-5.0, 5.0, (2, 200))
    slope = random.uniform(-0.2, 0.2, (2, 200))
    d = np.array([*slope, np.ones(200)]) / np.sqrt(1.0 + (slope**2).sum(0))
    shape = OURS[name]
    hit = shape.intersect(shape.parameters(), x, y, d, NUMPY)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        other = theirs(name, CoordinateSystem())
        rays = RealRays(x.copy(), y.copy(), np.zeros(200), *d, np.ones(200), np.full(200, 0.6))
        path = np.asarray(other.distance(rays))
        np.testing.assert_allclose(hit.path, path, atol=2e-12)
        rays.x, rays.y, rays.z = hit.x, hit.y, hit.z
        normal = np.array(other.surface_normal(rays))
    normal = normal * np.sign(normal[2])
    np.testing.assert_allclose([hit.nx, hit.ny, hit.nz], normal, atol=1e-12)
