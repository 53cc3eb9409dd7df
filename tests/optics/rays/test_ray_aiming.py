"""Aiming against rays traced out of the stop by a two-dimensional trace of its own; what is refused; loneliness."""

import math
from dataclasses import replace

import numpy as np
import pytest
from made_lens import made_glass, made_lens
from scipy.optimize import brentq

from optics import Plane, Sphere, chief_ray_points, decentre, load_lens, sobol_disk, spot_moments
from optics.errors import ConvergenceError
from optics.frames import field_direction, light_direction
from optics.rays.entrance_pupil import launch_disks, star_rays
from optics.rays.ray_aiming import aim_at_stop
from optics.rays.trace import Rays, trace, trace_path

CROWN, STOP = 1.52, 6
FISHEYE = [  # radius, thickness, index behind, semi-diameter: two menisci of strong negative power, a stop, a singlet
    (60.0, 2.0, CROWN, 45.0),
    (13.0, 11.0, 1.0, 12.9),
    (90.0, 2.0, CROWN, 14.0),
    (9.0, 14.0, 1.0, 8.9),
    (30.0, 6.0, CROWN, 9.0),
    (-16.0, 3.0, 1.0, 9.0),
    (math.inf, 3.0, 1.0, 2.0),
    (15.0, 4.0, CROWN, 6.0),
    (-14.0, 18.0, 1.0, 6.0),
]


LENS = made_lens(
    *(
        (Sphere(radius_mm=r) if math.isfinite(r) else Plane(), thickness, "crown" if index > 1.0 else "air", semi)
        for r, thickness, index, semi in FISHEYE
    ),
    stop=STOP,
    glasses=(made_glass(CROWN, "crown"),),
    max_field_deg=80.0,
)


def meridional(height, angle, surfaces):
    """Height and angle of a ray of one plane behind (radius, distance to it, index before, index behind), by sines.
    The scheme of hand calculation (Kingslake 1978, *Lens Design Fundamentals*, ch. 2): Q / r + sin U = sin I. Heights
    are those of the ray's line in the vertex plane."""
    for radius, distance, before, behind in surfaces:
        height += distance * math.tan(angle)
        if math.isinf(radius):
            angle = math.asin(before / behind * math.sin(angle))
            continue
        sine = math.sin(angle) + height * math.cos(angle) / radius  # distance from the centre of curvature over r
        normal = angle - math.asin(sine)
        angle = normal + math.asin(before / behind * sine)
        height = -radius * math.sin(normal) - radius * (1.0 - math.cos(normal)) * math.tan(angle)
    return height, angle


def out_of_the_stop(angle):
    """Field [rad] and image height [mm] of the ray that crosses the centre of the stop at an angle."""
    index = [1.0, *(row[2] for row in FISHEYE)]
    behind, distance = [], 0.0
    for k in range(STOP, len(FISHEYE)):
        behind.append((FISHEYE[k][0], distance, index[k], index[k + 1]))
        distance = FISHEYE[k][1]
    height, last = meridional(0.0, angle, behind)
    height += distance * math.tan(last)
    ahead, distance = [], 0.0
    for k in range(STOP - 1, -1, -1):  # against the light: seen from there radii change sign, and so does the angle
        ahead.append((-FISHEYE[k][0], distance + FISHEYE[k][1], index[k + 1], index[k]))
    _, first = meridional(0.0, -angle, ahead)
    return -first, height


@pytest.mark.parametrize("field_deg", [5.0, 35.0, 50.0, 65.0, 78.0])
def test_chief_rays_of_a_fisheye_are_those_that_leave_the_stop(field_deg):
    angle = brentq(lambda u: out_of_the_stop(u)[0] - math.radians(field_deg), 0.0, 0.55, xtol=1e-15)
    x, y = chief_ray_points(LENS, [field_deg], [0.0])
    assert x[0] == pytest.approx(out_of_the_stop(angle)[1], abs=1e-9)
    assert abs(y[0]) < 1e-12


def test_what_becomes_of_a_ray_does_not_depend_on_its_company():
    fields = np.array([1.0, 20.0, 50.0, 79.0])
    x, _ = chief_ray_points(LENS, fields, 0.3 * fields)
    alone = [chief_ray_points(LENS, [f], [0.3 * f])[0][0] for f in fields]
    assert x.tolist() == alone


@pytest.mark.parametrize("field_deg", [40.0, 75.0])
def test_all_light_of_a_wide_lens_is_found_where_the_pupil_has_wandered_to(field_deg):
    """Against rays that start in a square of six times the width, in the plane of the first vertex."""
    star = field_direction([field_deg], [0.0])
    disks = launch_disks(LENS, star, [600.0])
    count = 1 << 18
    direction = light_direction(star[0])
    wide = sobol_disk(count, seed=1)
    reach = 3.0 * float(disks.radius_mm[0, 0, 0])
    centre = float(disks.x_mm[0, 0, 0]) + 0.5 * float(disks.radius_mm[0, 0, 0])
    x, y = centre + reach * wide.x, reach * wide.y
    rays = trace(LENS, Rays.create(x_mm=x, y_mm=y, z_mm=disks.z_mm, direction=direction, wavelength_nm=600.0))
    counted = rays.ok.mean() * math.pi * reach**2
    spot = spot_moments(LENS, [field_deg], [0.0], [600.0])
    assert float(spot.transmitted_mm2[0, 0]) == pytest.approx(counted, rel=4e-3)
    assert float(spot.x_mm[0, 0]) == pytest.approx(float(rays.x[rays.ok].mean()), abs=2e-3)
    inside = trace(LENS, star_rays(disks, wide, star[:, None], [600.0])).ok.mean() * float(disks.area_mm2[0, 0, 0])
    assert inside == pytest.approx(counted, rel=4e-3)


def test_a_blocked_chief_ray_is_refused_unless_it_is_followed():
    lens = load_lens("double_gauss_50mm")
    with pytest.raises(ConvergenceError, match=r"field \(33, 0\) deg at 587.6 nm is stopped by the rim of surface 0"):
        chief_ray_points(lens, [0.0, 33.0], [0.0, 0.0])
    x, _ = chief_ray_points(lens, [33.0], [0.0], blocked="follow")
    assert 30.0 < x[0] < 50.0 * math.tan(math.radians(33.0))
    with pytest.raises(ConvergenceError, match="does not reach the centre of the stop"):
        chief_ray_points(lens, [85.0], [0.0], blocked="follow")


def test_chief_rays_pass_the_vertex_of_a_curved_stop_and_the_centre_of_a_moved_one():
    lens = load_lens("double_gauss_50mm")
    at = lens.stop_index
    curved = lens.with_surfaces({at: replace(lens.surfaces[at], shape=Sphere(radius_mm=-30.0))})
    np.testing.assert_allclose(chief_ray_points(curved, 8.0, 5.0), chief_ray_points(lens, 8.0, 5.0), atol=1e-10)
    moved = decentre(lens, at, 3.0, -2.0)
    direction = light_direction(field_direction(8.0, 5.0))
    aimed = aim_at_stop(moved, direction, 600.0)
    rays = Rays.create(x_mm=aimed.x_mm, y_mm=aimed.y_mm, z_mm=aimed.z_mm, direction=direction, wavelength_nm=600.0)
    np.testing.assert_allclose(trace_path(moved, rays)[at + 1], moved.surfaces[at].position_mm, atol=1e-9)
