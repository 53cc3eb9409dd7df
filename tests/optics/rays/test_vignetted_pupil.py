"""Beams as the apertures cut them: closed forms of overlapping circles, counted rays, lenses without an edge."""

import math
from dataclasses import replace

import numpy as np
import pytest

from optics import Plane, Surface, collecting_area_mm2, decentre, field_direction, load_lens, sobol_disk, spot_moments
from optics.rays.marginal_rays import beam_semi_diameters
from optics.rays.trace import OK, Rays, trace
from optics.rays.vignetted_pupil import vignetted_pupils

CAMERA, GAUSS = load_lens("star_camera_206mm"), load_lens("double_gauss_50mm")


BALL = """
name = "ball"
source = "made up"
design_wavelength_nm = 587.6
max_field_deg = 0.5
surface = [
  { kind = "sphere", radius_mm = 20.0, thickness_mm = 20.0, medium = "N-BK7" },
  { kind = "plane", thickness_mm = 8.0, medium = "air" },
  { kind = "plane", stop = true, semi_diameter_mm = 5.5, thickness_mm = 5.0, medium = "air" },
]
"""


def with_hood(radius_mm, distance_mm):
    """The camera behind a round opening in front of its stop."""
    stop = CAMERA.surfaces[0]
    hood = Surface(shape=Plane(), position_mm=stop.position_mm - [0, 0, distance_mm], semi_diameter_mm=radius_mm)
    return replace(CAMERA, surfaces=(hood, *CAMERA.surfaces))


def overlap_mm2(a, b, apart):
    """Area that two circles share (any geometry text)."""
    if apart <= abs(a - b):
        return math.pi * min(a, b) ** 2
    first = a * a * math.acos((apart**2 + a * a - b * b) / (2 * apart * a))
    second = b * b * math.acos((apart**2 + b * b - a * a) / (2 * apart * b))
    kite = math.sqrt((a + b - apart) * (apart + a - b) * (apart - a + b) * (apart + a + b)) / 2
    return first + second - kite


@pytest.mark.parametrize(("hood_mm", "field_deg"), [(40.0, 2.0), (36.0, 3.0), (30.0, 3.5), (34.0, 0.0)])
def test_a_beam_cut_by_a_hood_is_the_overlap_of_two_circles(hood_mm, field_deg):
    distance, stop = 400.0, CAMERA.surfaces[0].semi_diameter_mm
    expected = overlap_mm2(hood_mm, stop, distance * math.tan(math.radians(field_deg)))
    beams = vignetted_pupils(
        with_hood(hood_mm, distance), field_direction([field_deg], [0.0]), [600.0], rings=5, arms=12
    )
    assert float(beams.area_mm2.sum()) == pytest.approx(expected, rel=2e-5)
    spot = spot_moments(with_hood(hood_mm, distance), field_deg, 0.0, 600.0)
    assert float(spot.transmitted_mm2[0, 0]) == pytest.approx(expected, rel=2e-5)


def test_a_beam_whose_chief_ray_is_blocked_is_found_all_the_same():
    distance, field = 1200.0, 2.6
    apart = distance * math.tan(math.radians(field))
    assert apart > 35.0 + 10.0  # neither circle holds the other's centre
    beams = vignetted_pupils(with_hood(30.0, distance), field_direction([field], [0.0]), [600.0], rings=5, arms=12)
    assert float(beams.area_mm2.sum()) == pytest.approx(overlap_mm2(30.0, 35.0, apart), rel=1e-3)


@pytest.mark.slow
def test_light_and_centroid_against_counted_rays_where_several_apertures_cut():
    waves = np.array([450.0, 520.0, 590.0, 730.0, 800.0])  # outlines are interpolated in wavelength
    here = spot_moments(GAUSS, 14.0, -8.0, waves, order=(5, 12))
    counted = spot_moments(GAUSS, 14.0, -8.0, waves[[1, 4]], samples=sobol_disk(1 << 20, seed=4))
    np.testing.assert_allclose(here.transmitted_mm2[:, [1, 4]], counted.transmitted_mm2, rtol=3e-4)
    np.testing.assert_allclose(here.x_mm[:, [1, 4]], counted.x_mm, atol=1e-5)
    # counting is good to 1e-3 of the radius
    np.testing.assert_allclose(here.rms_radius_mm[:, [1, 4]], counted.rms_radius_mm, rtol=1.5e-3)


def test_area_on_the_axis():
    assert collecting_area_mm2(CAMERA) == pytest.approx(math.pi * 35.0**2, rel=1e-13)
    moved = decentre(GAUSS, GAUSS.elements[0], 0.3)  # no symmetry left
    counted = spot_moments(moved, 0.0, 0.0, 600.0, samples=sobol_disk(1 << 16, seed=9)).transmitted_mm2
    assert collecting_area_mm2(moved, 600.0) == pytest.approx(float(counted[0, 0]), rel=1e-3)


@pytest.mark.parametrize("factors", [None, (0.1, -0.2, 0.3, 0.05, 25.0), (0.0, 0.15, 0.4, 0.0, -60.0)])
def test_vignetting_factors_move_narrow_and_turn_the_beam(factors):
    """On a plane in front of the stop the beam is an ellipse about the chief ray: decentred, cut to 1 - VC, turned."""
    distance, field = 400.0, np.array([2.0, 1.0])
    widths = beam_semi_diameters(
        with_hood(500.0, distance), field[None], [600.0], None if factors is None else [factors]
    )
    angle, radius = np.linspace(0.0, 2.0 * np.pi, 2000), CAMERA.surfaces[0].semi_diameter_mm
    dx, dy, cut_x, cut_y, turn = factors or (0.0,) * 5
    edge = radius * np.array([dx + (1.0 - cut_x) * np.cos(angle), dy + (1.0 - cut_y) * np.sin(angle)])
    c, s = np.cos(np.radians(turn)), np.sin(np.radians(turn))
    chief = -distance * np.tan(np.radians(field))  # in front of the stop, on the side the star stands on
    reach = np.hypot(*(chief[:, None] + np.array([[c, -s], [s, c]]) @ edge)).max()
    assert widths.semi_diameter_mm[0] == pytest.approx(reach, rel=2e-3)
    assert (widths.lost, widths.dark) == (0, ())


def test_rays_that_come_back_into_the_stop_do_not_belong_to_the_beam(tmp_path):
    """A ball's spherical aberration bends rays at 19 mm into the stop again, which those from 13 to 18 mm miss."""
    path = tmp_path / "ball.toml"
    path.write_text(BALL, encoding="utf-8")
    lens = load_lens(path)
    height = np.linspace(0.0, 19.4, 3881)
    rays = Rays.create(
        x_mm=height, y_mm=0.0 * height, z_mm=-1.0, direction=np.array([0.0, 0.0, 1.0]), wavelength_nm=587.6
    )
    glass = {i: replace(lens.surfaces[i], semi_diameter_mm=math.inf) for i in (0, 1)}
    opened = lens.with_surfaces(glass)
    passes = trace(opened, rays).status == OK
    first = float(height[np.argmin(passes)])
    assert passes[height > 19.0].any()
    widest = beam_semi_diameters(opened, [[0.0, 0.0]], [587.6]).semi_diameter_mm
    assert widest[0] == pytest.approx(first, abs=0.01)
    assert lens.surfaces[0].semi_diameter_mm < 1.2 * first  # found with the field of the file
