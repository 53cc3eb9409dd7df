"""Transmittance of lens and baffle: scatter in proportion to its laws, shade, the pattern over the pixels."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from lens_texts import table_lens

from optics.light.bsdf import polished
from optics.rays.ghosts import ghost_irradiance
from render.baffle.light import BaffleLight
from render.baffle.transmittance import CAUSES, lens_transmittance, sensor_transmittance
from render.camera import Camera

SINGLET = table_lens(
    {"radius_mm": 25.0, "thickness_mm": 3.0, "medium": "N-BK7", "semi_diameter_mm": 5.0, "stop": True},
    {"radius_mm": float("inf"), "thickness_mm": 46.0, "medium": "air", "semi_diameter_mm": 6.0},
    max_field_deg=10.0,
)
CAMERA = Camera(lens=SINGLET, width_px=100, height_px=80, pixel_pitch_mm=0.08)
LAW, ANGLES = polished(1e-3, 0.01, -1.5).bsdf, [4.0, 20.0, 30.0, 90.0]


def bare(**changes):
    both, first = {0: LAW, 1: LAW}, {0: LAW}
    laws = {"polish": both, "dust": first, "dust 500": {0: lambda delta: 3.0 * LAW(delta)}}
    return lens_transmittance(
        CAMERA, 48.0, laws, ANGLES, [0.0, 45.0],
        points=3, pupil=(2, 8), ghost_rays=(4, 8), **{"absorption": False, "shade_deg": 25.0} | changes,
    )  # fmt: skip


@pytest.fixture(scope="module")
def lens():
    return bare()


def tube(tube_is_round):
    """A baffle whose lit part and light are a function of the angle, with the directions that it was asked for."""
    asked = []

    def light(v_source, weight, *, error, number, least):
        asked.append(number)
        angle = float(np.degrees(np.arccos(v_source[2])))
        walls = 0.0 if angle > 89.0 else 1e-3 * float(weight(np.radians(angle)))
        return BaffleLight(
            direct=float(np.clip((25.0 - angle) / 10.0, 0.0, 1.0)), walls=walls, walls_error=error * walls,
            edges=1e-7, edges_error=1e-8, rays=1000,
        )  # fmt: skip

    return SimpleNamespace(baffle="round" if tube_is_round else None, light=light), asked


def test_scatter_is_in_proportion_to_its_law_and_ghosts_are_those_of_all_pairs(lens):
    assert lens.field_deg == pytest.approx(np.degrees(np.arctan(np.hypot(4.0, 3.2) / 48.0)), rel=1e-3)
    assert lens.entrance_mm == pytest.approx(5.0)
    np.testing.assert_allclose(lens.value["dust 500"], 3.0 * lens.value["dust"], rtol=1e-12)
    assert (lens.value["polish"] >= lens.value["dust"]).all()
    assert (lens.value["polish"][:, 0] > lens.value["polish"][:, 1]).all()
    np.testing.assert_allclose(lens.points["polish"].mean(axis=(2, 3)), lens.value["polish"])
    source = np.array([np.sin(np.radians(20.0)), 0.0, np.cos(np.radians(20.0))])
    pairs = ghost_irradiance(SINGLET, source, (4.0, 3.2), rings=4, arms=8, absorption=False)
    assert lens.value["ghosts"][0, 1] == pytest.approx(sum(value for value, _ in pairs.values()))
    assert lens.ghosts_error[0, 1] == pytest.approx(np.sqrt(sum(error**2 for _, error in pairs.values())))


def test_in_the_shade_every_azimuth_has_the_light_of_the_first(lens):
    np.testing.assert_array_equal(lens.value["polish"][1, 2:], lens.value["polish"][0, 2:])
    assert lens.value["polish"][0, 3] == 0.0  # no light from 90 deg
    whole = bare(shade_deg=90.0)
    assert whole.value["polish"][1, 2] != whole.value["polish"][0, 2]
    np.testing.assert_array_equal(whole.value["polish"][:, :2], lens.value["polish"][:, :2])


def test_a_baffle_passes_the_lit_part_and_adds_its_own_light(lens):
    ticks, (scene, asked) = [], tube(True)
    found = sensor_transmittance(lens, scene, error=0.3, source="test", advance=lambda: ticks.append(1))
    assert (len(ticks), len(asked), found.rays) == (8, 4, 4000)  # a tube is round: asked at the first azimuth alone
    assert (found.pst.causes, found.pst.source) == (CAUSES, "test")
    np.testing.assert_allclose(found.direct, np.tile([1.0, 0.5, 0.0, 0.0], (2, 1)))
    for row, cause in enumerate(("ghosts", "polish", "dust")):
        np.testing.assert_allclose(found.pst.value[row], lens.value[cause] * found.direct)
    np.testing.assert_allclose(found.pst.error[0], lens.ghosts_error * found.direct)
    # the light of the baffle comes in at angles whose weight is the bare lens's transmittance
    whole = sum(lens.value[cause] for cause in ("ghosts", "polish", "dust")).mean(axis=0)
    np.testing.assert_allclose(found.pst.value[3, :, :3], np.tile(1e-3 * whole[:3], (2, 1)), rtol=1e-9)
    assert found.worst_percent == pytest.approx(30.0)


def test_some_angles_with_other_dust_behind_a_mesh(lens):
    scene, asked = tube(False)
    some = sensor_transmittance(lens, scene, dust="dust 500", chosen=[1, 2])
    assert asked == [1, 2, 1001, 1002]  # a mesh at every azimuth; the numbers of the rays are those of the whole table
    np.testing.assert_allclose(some.pst.angle_deg, ANGLES[1:3])
    np.testing.assert_allclose(some.pst.value[2], 3.0 * lens.value["dust"][:, 1:3] * some.direct)


def test_over_the_pixels_scatter_falls_as_at_the_points_and_the_mean_stays(lens):
    bare_lens = sensor_transmittance(lens, None)
    np.testing.assert_array_equal(bare_lens.pst.value[3:], 0.0)
    assert bare_lens.worst_percent == 0.0
    image = bare_lens.over_pixels(4.0, (80, 100))
    mean = bare_lens.pst.total[0, 0]
    assert image.mean() == pytest.approx(mean, rel=1e-12)
    assert image[40, 90] > 1.02 * image[40, 10]  # brighter towards the source
    np.testing.assert_allclose(image, image[::-1], rtol=1e-6)  # mirror symmetry across it
    points = (lens.points["polish"] + lens.points["dust"])[0, 0]
    even = mean - (lens.value["polish"] + lens.value["dust"])[0, 0]
    ratio = (image[40, [16, 49, 83]] - even) / points[1]
    np.testing.assert_allclose(ratio, ratio[0], rtol=0.03)
    table = replace(bare_lens, lens=None)
    np.testing.assert_allclose(table.over_pixels(4.0, (4, 5)), mean, rtol=1e-12)
