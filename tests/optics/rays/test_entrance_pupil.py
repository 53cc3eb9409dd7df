"""Pupil sampling: order of exactness, area preservation, and a launch disk that loses no light."""

import numpy as np
import pytest

from optics import decentre, field_direction, load_lens, tilt, trace
from optics.rays.entrance_pupil import EntrancePupil, entrance_pupil, star_rays
from optics.rays.pupil_sampling import disk_from_square, gauss_disk, sobol_disk


def disk_moment(a: int, b: int) -> float:
    """Mean of x^a y^b over the unit disk: products of double factorials over a power of two."""
    if a % 2 or b % 2:
        return 0.0
    from math import gamma, pi

    return 2.0 / (a + b + 2.0) * gamma((a + 1) / 2) * gamma((b + 1) / 2) / gamma((a + b + 2) / 2) / pi


@pytest.mark.parametrize(("rings", "arms"), [(1, 4), (2, 8), (3, 12), (4, 16), (6, 24)])
def test_gauss_disk_is_exact_to_its_degree_and_not_beyond(rings, arms):
    s = gauss_disk(rings, arms)
    degree = min(4 * rings - 1, arms - 1)
    for a in range(degree + 1):
        for b in range(degree + 1 - a):
            assert np.sum(s.weight * s.x**a * s.y**b) == pytest.approx(disk_moment(a, b), abs=2e-15)
    beyond = 4 * rings  # both limits are met by r^(4 rings)
    assert abs(np.sum(s.weight * np.hypot(s.x, s.y) ** beyond) - 2.0 / (beyond + 2.0)) > 1e-9


def test_sobol_points_converge_faster_than_chance_and_their_map_keeps_areas():
    s = sobol_disk(4096, seed=7)
    assert np.sum(s.weight) == pytest.approx(1.0, abs=1e-14)
    assert np.hypot(s.x, s.y).max() <= 1.0
    chance = 0.5 / np.sqrt(4096)
    assert abs(np.sum(s.weight * s.x)) < 0.1 * chance
    np.testing.assert_array_equal(s.x, sobol_disk(4096, seed=7).x)
    assert not np.array_equal(s.x, sobol_disk(4096, seed=8).x)
    u, v = np.meshgrid((np.arange(400) + 0.5) / 400, (np.arange(400) + 0.5) / 400)
    x, _ = disk_from_square(u.ravel(), v.ravel())
    cap = np.mean(x > 0.5)  # a circular segment of height 1/2
    assert cap == pytest.approx((np.arccos(0.5) - 0.5 * np.sqrt(0.75)) / np.pi, abs=1e-4)


def test_stop_in_front_is_the_entrance_pupil_exactly():
    lens = load_lens("star_camera_206mm")
    assert entrance_pupil(lens) == EntrancePupil(z_mm=0.0, radius_mm=35.0, exact=True)
    moved = entrance_pupil(decentre(lens, 0, 0.5, -0.25))
    assert (moved.x_mm, moved.y_mm, moved.exact) == (0.5, -0.25, True)
    assert not entrance_pupil(tilt(lens, 0, 0.5)).exact


@pytest.mark.parametrize("name", ["double_gauss_50mm", "star_tracker_26mm"])
@pytest.mark.parametrize("perturbed", [False, True])
def test_no_ray_is_lost_by_the_launch_disk(name, perturbed):
    lens = load_lens(name)
    lens = decentre(tilt(lens, "L45", 0.3), "L23", 0.2, 0.1) if perturbed else lens
    pupil = entrance_pupil(lens)
    wide = EntrancePupil(z_mm=pupil.z_mm, radius_mm=1.6 * pupil.radius_mm, exact=False)
    samples = sobol_disk(1 << 14, seed=3)
    for part, azimuth in ((0.0, 0.0), (0.4, 1.0), (0.9, 2.5), (1.0, 4.4)):
        field = part * lens.max_field_deg
        star = field_direction(field * np.cos(azimuth), field * np.sin(azimuth))
        rays = trace(lens, star_rays(wide, samples, star, lens.design_wavelength_nm))
        arrived = wide.radius_mm * np.hypot(samples.x, samples.y)[rays.ok]
        assert arrived.size > 500
        assert arrived.max() <= pupil.radius_mm
    assert pupil.radius_mm < 1.15 * 0.5 * {"double_gauss_50mm": 25.0, "star_tracker_26mm": 12.8}[name]


def test_wavefront_reference_is_the_plane_through_the_origin():
    pupil = EntrancePupil(z_mm=-5.0, radius_mm=3.0, exact=False)
    star = field_direction(10.0, 5.0)
    rays = star_rays(pupil, gauss_disk(2, 4), star, 500.0, ambient_index=1.5)
    # going back along the ray by opl / n ends in the plane through the origin, square to the light
    back = [p - rays.opl_mm / 1.5 * d for p, d in ((rays.x, rays.dx), (rays.y, rays.dy), (rays.z, rays.dz))]
    np.testing.assert_allclose(back[0] * rays.dx + back[1] * rays.dy + back[2] * rays.dz, 0.0, atol=1e-14)
