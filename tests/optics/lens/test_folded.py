"""Mirrors, coordinate breaks, tilted image planes: closed forms, and rotations written out by hand."""

import math
import re
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from lens_texts import TABLE_HEAD as HEAD
from scipy.optimize import minimize_scalar

from optics import Conic, Rays, chief_ray_points, draw_lens, load_lens, spot_moments, trace
from optics.glass.catalogue import get_glass, glass_from_table
from optics.lens.perturb import EVERYTHING, change_temperature, decentre, despace, tilt
from optics.lens.prescription import lens_from_table
from optics.rays.paraxial import paraxial, refocused
from optics.rays.reverse import retraced, reverse

PAGE = Path(__file__).resolve().parents[3] / "docs" / "lens_file.md"

# Cassegrain: primary of focal length 1000, secondary 700 in front of it, images its focus 300 behind onto 1200
# (1/1200 - 1/300 = 2/R2), eccentricity (1200 + 300)/(1200 - 300)
CASSEGRAIN = {
    **HEAD,
    "surface": [
        {"radius_mm": -2000.0, "conic": -1.0, "thickness_mm": -700.0, "medium": "mirror", "stop": True,
         "semi_diameter_mm": 100.0, "inner_semi_diameter_mm": 30.0, "element": "M1"},
        {"radius_mm": -800.0, "conic": -((1500 / 900) ** 2), "thickness_mm": 1200.0, "medium": "mirror",
         "semi_diameter_mm": 40.0, "element": "M2"},
    ],
}  # fmt: skip


def bent(*tilt_deg):
    """The telescope with a flat mirror that bends its axis 200 mm in front of the focus."""
    primary, secondary = CASSEGRAIN["surface"]
    flat = {"kind": "plane", "tilt_deg": tilt_deg, "carry": "bend", "thickness_mm": -200.0, "medium": "mirror"}
    table = {**CASSEGRAIN, "surface": [primary, {**secondary, "thickness_mm": 1000.0}, flat]}
    return lens_from_table(table, where="test")


def grid(half, count=21):
    side = np.linspace(-half, half, count)
    return (v.ravel() for v in np.meshgrid(side, side))


def rays(half, direction=(0.0, 0.0, 1.0), z=-10.0):
    x, y = grid(half)
    return Rays.create(x_mm=x, y_mm=y, z_mm=z, direction=direction, wavelength_nm=600.0)


def kept(bundle, keep):
    return Rays(**{name: getattr(bundle, name)[keep] for name in Rays.__dataclass_fields__})


def test_a_cassegrain_has_a_perfect_focus_and_equal_paths():
    lens = lens_from_table(CASSEGRAIN, where="test")
    out = trace(lens, rays(95.0, z=-1000.0))
    assert 200 < out.ok.sum() < 441  # the hole and the corners are dark
    assert np.hypot(out.x, out.y)[out.ok].max() < 1e-11
    air = float(lens.indices(600.0)[0])
    # the axial ray runs 1000 to M1, 700 back and 1200 to the focus
    np.testing.assert_allclose(out.opl_mm[out.ok], air * (1000.0 + 700.0 + 1200.0), atol=1e-9)
    first = paraxial(lens)
    assert first.efl_mm == pytest.approx(1000.0 * 1200.0 / 300.0, rel=1e-12)
    assert first.bfl_mm == pytest.approx(1200.0, rel=1e-12)
    assert first.rear_focus_z_mm == pytest.approx(500.0, rel=1e-12)


def test_a_parabola_alone_has_its_image_in_front_of_it_the_right_way_round():
    primary = {**CASSEGRAIN["surface"][0], "thickness_mm": -1000.0}
    lens = lens_from_table({**HEAD, "surface": [primary]}, where="test")
    slope = 0.002
    out = trace(lens, rays(1e-3, (slope, slope, 1.0)))
    # a ray near the axis lands at f tan(field) along both axes, as behind a lens
    assert out.y.mean() == pytest.approx(1000.0 * slope, rel=1e-6)
    assert out.x.mean() == pytest.approx(1000.0 * slope, rel=1e-6)
    np.testing.assert_allclose(refocused(lens).image_position_mm, [0.0, 0.0, -1000.0], atol=1e-9)


@pytest.mark.parametrize("which", ["cassegrain", "folded"])
def test_light_goes_back_through_mirrors_the_way_it_came(which):
    lens = bent(40.0, 20.0) if which == "folded" else lens_from_table(CASSEGRAIN, where="test")
    start = rays(95.0, (0.003, 0.001, 1.0))
    out = trace(lens, start)
    start, out = kept(start, out.ok), kept(out, out.ok)
    back = trace(reverse(lens), retraced(lens, out))
    assert back.ok.all()
    np.testing.assert_allclose(-back.x, start.x + 10.0 * 0.003, atol=1e-11)
    np.testing.assert_allclose(back.y, start.y + 10.0 * 0.001, atol=1e-11)
    np.testing.assert_allclose(back.opl_mm, out.opl_mm - 10.0 * lens.indices(600.0)[0] / start.dz, atol=1e-10)
    again = trace(reverse(reverse(lens)), start)
    hand = np.linalg.det(lens.image_rotation)  # left-handed behind the three mirrors; a reversed lens is right-handed
    np.testing.assert_allclose([hand * again.x, again.y], [out.x, out.y], atol=1e-11)


def test_a_bent_axis_meets_the_middle_of_the_image():
    """A flat mirror anywhere in a converging beam folds the focus and nothing else."""
    for angles in ((45.0, 0.0), (0.0, -30.0), (20.0, 35.0)):
        lens = bent(*angles)
        out = trace(lens, rays(95.0))
        assert np.hypot(out.x, out.y)[out.ok].max() < 1e-11
        # the image plane stands square to the folded axis: its normal is the mirrored z axis
        normal = lens.surfaces[2].rotation[:, 2]
        np.testing.assert_allclose(lens.image_rotation[:, 2], [0, 0, 1] - 2 * normal[2] * normal, atol=1e-15)


def blocks_of_the_page():
    return re.findall(r"```toml\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.S)


def test_the_ritchey_chretien_of_the_page_has_no_coma(tmp_path):
    (tmp_path / "lens.toml").write_text(blocks_of_the_page()[0])
    lens = load_lens(tmp_path / "lens.toml")
    assert paraxial(lens).efl_mm == pytest.approx(400.0, rel=1e-12)
    assert paraxial(lens).rear_focus_z_mm == pytest.approx(lens.image_position_mm[2], rel=1e-12)

    def coma(table):
        """Mean of the light, from the chief ray on."""
        chief = chief_ray_points(table, 0.2, 0.0, 600.0)[0]
        return float(spot_moments(table, [0.2], [0.0], 600.0).x_mm[0, 0] - chief)

    # a classical Cassegrain has the coma of a parabola of its focal ratio: sagittal coma f tan(field) / (16 N^2); the
    # mean over an annulus of obscuration e moves by (1 + e^2) of it (Wilson, sec. 3.2; Welford 1986, sec. 6.4)
    expected = 400.0 * math.tan(math.radians(0.2)) / (16.0 * 8.0**2) * (1.0 + 0.4**2)
    m1, m2 = lens.surfaces[1:]
    classical = -(((400 / 120 + 1) / (400 / 120 - 1)) ** 2)
    parabola = lens.with_surfaces(
        {
            1: replace(m1, shape=Conic(radius_mm=m1.shape.radius_mm, conic=-1.0)),
            2: replace(m2, shape=Conic(radius_mm=m2.shape.radius_mm, conic=classical)),
        }
    )
    assert abs(coma(parabola)) == pytest.approx(expected, rel=0.02)
    assert abs(coma(lens)) < 0.01 * expected
    assert draw_lens(lens).axes[0].lines


def test_the_tables_of_the_page_are_valid(tmp_path):
    breaking, glasses, error = (tomllib.loads(text) for text in blocks_of_the_page()[1:])
    np.save(tmp_path / error["surface"]["error"]["file"], np.zeros((7, 7)))
    surface = {**CASSEGRAIN["surface"][0], "semi_diameter_mm": 29.0, "inner_semi_diameter_mm": 1.0}
    table = {**HEAD, "surface": [*breaking["surface"], {**surface, "error": error["surface"]["error"]}]}
    lens = lens_from_table(table, where="page", folder=tmp_path)
    np.testing.assert_allclose(lens.surfaces[0].rotation, turn("x", 45.0), atol=1e-15)
    of_file, coefficients = glasses["glass"].values()
    assert set(of_file) == {"file", "name"}
    assert float(glass_from_table("melt", coefficients).index(587.5618)) == pytest.approx(1.5168, abs=5e-6)  # N-BK7


def test_the_spherical_mirror_with_a_schmidt_plate_has_no_spherical_aberration():
    """Plate at the centre of curvature, ground to (r^4 - 1.5 a^2 r^2) / (4 (n - 1) R^3) (Born & Wolf, sec. 6.4)."""
    radius, half = 400.0, 40.0
    plain = {"kind": "plane", "thickness_mm": 6.0, "medium": "N-BK7", "stop": True, "semi_diameter_mm": half}
    n = float(get_glass("N-BK7").index(600.0))
    depth = 1.0 / (4.0 * (n - 1.0) * radius**3)
    # the depth that light gains in the glass: sag of the far side of the plate, whose middle is thickest
    ground = {"kind": "odd_asphere", "terms": [0.0, -1.5 * half**2 * depth, 0.0, depth], "medium": "air"}
    mirror = {"kind": "sphere", "radius_mm": -radius, "medium": "mirror"}

    def blur(back, focus):
        surfaces = [plain, {**back, "thickness_mm": radius}, {**mirror, "thickness_mm": -focus}]
        out = trace(lens_from_table({**HEAD, "surface": surfaces}, where="test"), rays(0.7 * half, z=-20.0))
        return float(np.sqrt(np.mean(out.x**2 + out.y**2)))

    def sharpest(back):
        return minimize_scalar(lambda focus: blur(back, focus), bounds=(190.0, 204.0), method="bounded").fun

    without = sharpest({"kind": "plane", "medium": "air"})
    assert without > 0.02
    assert sharpest(ground) < without / 50


def image_of_the_axis(lens):
    spot = spot_moments(lens, [0.0], [0.0], 600.0)
    return np.array([float(spot.x_mm[0, 0]), float(spot.y_mm[0, 0])])


def test_mirrors_that_move_move_the_image_as_the_mirror_equation_says():
    lens = lens_from_table(CASSEGRAIN, where="test")
    at, small = image_of_the_axis(lens), 1e-3
    # the secondary magnifies fourfold: the prime focus, beside its axis by -s, is imaged to s - 4 s; to half a percent,
    # because the mean of the light has the coma of a decentred secondary
    moved = image_of_the_axis(decentre(lens, "M2", small, 2 * small)) - at
    np.testing.assert_allclose(moved, [-3.0 * small, -6.0 * small], rtol=5e-3)
    # further from the primary it stands nearer to the prime focus, whose image it carries along: 1 + 4^2 times as far
    near = refocused(despace(lens, "M2", -small)).image_position_mm[2] - refocused(lens).image_position_mm[2]
    assert near == pytest.approx(-17.0 * small, rel=1e-3)
    # a flat mirror 200 mm in front of the image turns the beam by twice its tilt
    folded = bent(45.0, 0.0)
    tilted = image_of_the_axis(tilt(folded, 2, x_deg=math.degrees(1e-5))) - image_of_the_axis(folded)
    np.testing.assert_allclose(np.abs(tilted), [0.0, 2e-5 * 200.0], rtol=1e-4, atol=1e-9)
    # all of it together moves nothing
    whole = decentre(folded, EVERYTHING, 0.3, -0.2)
    np.testing.assert_allclose(image_of_the_axis(whole), image_of_the_axis(folded), atol=1e-9)


def test_a_telescope_of_one_material_stays_in_focus_and_one_with_glass_mirrors_does_not():
    lens = lens_from_table(CASSEGRAIN, where="test")
    cte, kelvin = 23.6e-6, 20.0
    warm = change_temperature(lens, lens.environment.temperature_c + kelvin, housing_cte_per_k=cte)
    growth = math.exp(cte * kelvin)
    assert paraxial(warm).efl_mm == pytest.approx(4000.0 * growth, rel=1e-12)
    assert paraxial(warm).rear_focus_z_mm == pytest.approx(warm.image_position_mm[2], abs=1e-9)
    mirrors = [{**surface, "cte_per_k": 0.0} for surface in CASSEGRAIN["surface"]]
    glass = lens_from_table({**CASSEGRAIN, "surface": mirrors}, where="test")
    warm = change_temperature(glass, glass.environment.temperature_c + kelvin, housing_cte_per_k=cte)
    # mirrors keep their powers; the secondary is carried from 300 to 300 - 700 (growth - 1) before the prime focus
    before = 300.0 - 700.0 * (growth - 1.0)
    focus = 1.0 / (1.0 / before - 1.0 / 400.0)
    assert paraxial(warm).bfl_mm == pytest.approx(focus, rel=1e-9)
    folded = bent(45.0, 0.0)
    warm = change_temperature(folded, folded.environment.temperature_c + kelvin, housing_cte_per_k=cte)
    for cold, hot in zip(folded.poses, warm.poses, strict=True):
        np.testing.assert_allclose(hot[0], growth * cold[0], atol=1e-9)


def turn(axis, degrees):
    c, s = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    matrix = {
        "x": [[1, 0, 0], [0, c, -s], [0, s, c]],
        "y": [[c, 0, s], [0, 1, 0], [-s, 0, c]],
        "z": [[c, -s, 0], [s, c, 0], [0, 0, 1]],
    }[axis]
    return np.array(matrix)


ALPHA, BETA, GAMMA = 3.0, 5.0, 10.0
BREAK = {"kind": "coordinate_break", "decentre_mm": [0.5, -0.3], "tilt_deg": [ALPHA, BETA, GAMMA]}
PLATE = {"kind": "plane", "thickness_mm": 7.0, "medium": "N-BK7"}
STOP = {"kind": "plane", "thickness_mm": 20.0, "medium": "air", "stop": True, "semi_diameter_mm": 3.0}


@pytest.mark.parametrize("axes", ["fixed", "moving"])
@pytest.mark.parametrize("first", ["decentre", "tilt"])
def test_a_coordinate_break_carries_forward(axes, first):
    broken = {**BREAK, "axes": axes, "first": first, "thickness_mm": 2.0}
    table = {**HEAD, "surface": [STOP, broken, PLATE, {**STOP, "stop": False, "thickness_mm": 30.0}]}
    lens = lens_from_table(table, where="test")
    x, y, z = turn("x", ALPHA), turn("y", BETA), turn("z", GAMMA)
    rotation = z @ y @ x if axes == "fixed" else x @ y @ z
    shift = np.array([0.5, -0.3, 0.0])
    origin = np.array([0.0, 0.0, 20.0]) + (shift if first == "decentre" else rotation @ shift)
    for number, along in ((1, 2.0), (2, 9.0)):
        np.testing.assert_allclose(lens.surfaces[number].rotation, rotation, atol=1e-15)
        np.testing.assert_allclose(lens.surfaces[number].position_mm, origin + along * rotation[:, 2], atol=1e-14)
    np.testing.assert_allclose(lens.image_position_mm, origin + 39.0 * rotation[:, 2], atol=1e-13)
    np.testing.assert_allclose(lens.image_rotation, rotation, atol=1e-15)


def test_a_tilt_of_one_surface_does_not_carry_and_carry_forward_does():
    tilted = {**PLATE, "tilt_deg": [ALPHA, BETA], "decentre_mm": [0.1, 0.2, 0.3]}
    behind = {**STOP, "stop": False}
    alone = lens_from_table({**HEAD, "surface": [STOP, tilted, behind]}, where="t")
    np.testing.assert_array_equal(alone.surfaces[2].rotation, np.eye(3))
    np.testing.assert_allclose(alone.surfaces[2].position_mm, [0.0, 0.0, 27.0])
    carried = lens_from_table({**HEAD, "surface": [STOP, {**tilted, "carry": "forward"}, behind]}, where="t")
    moved = {"kind": "coordinate_break", "tilt_deg": [ALPHA, BETA], "decentre_mm": [0.1, 0.2, 0.3]}
    broken = lens_from_table({**HEAD, "surface": [STOP, moved, PLATE, behind]}, where="t")
    for one, other in zip(carried.poses, broken.poses, strict=True):
        np.testing.assert_array_equal(one[0], other[0])
        np.testing.assert_array_equal(one[1], other[1])


def test_the_image_plane_is_tilted_from_the_file():
    table = {**CASSEGRAIN, "image": {"tilt_deg": [2.0, 0.0], "decentre_mm": [0.0, 1.0]}}
    lens = lens_from_table(table, where="test")
    np.testing.assert_allclose(lens.image_rotation, turn("x", 2.0), atol=1e-15)
    out = trace(lens, rays(95.0))
    # the focus lies 1 mm below the middle: rays of slope s cross the tilted plane tan(2 deg) mm beside it
    assert np.abs(out.y[out.ok] + 1.0).max() < 0.02
    assert np.ptp(out.y[out.ok]) > 1e-3
