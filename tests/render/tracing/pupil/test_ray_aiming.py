"""Outlines of beams: against rays traced by NumPy just inside and outside of them, closed forms, and convergence."""

import numpy as np
import pytest

from optics.frames import light_direction
from optics.lens.shapes.plane import Plane
from optics.lens.system import LensSystem, Surface
from optics.rays.program import compile_lens
from optics.rays.trace import OK, VIGNETTED, Rays, trace, trace_path
from render.tracing.pupil.outlines import find_arcs, find_outlines, node_picks, outline_series
from render.tracing.pupil.ray_aiming import OutlineSearch, aimed_lens, find_chiefs
from render.tracing.rays.kernel import Geometry, StarKernel
from render.tracing.tracer import Tracer

WAVELENGTH_NM = np.array([[520.0, 650.0, 800.0]])


def aimed(bench, name, x, y):
    """A built-in lens ready for aiming at stars near some pixels of its detector, and where it was made."""
    camera = bench.camera_of(name, film=False)
    tracer = Tracer(camera)
    exposure = tracer.planner.exposure(tracer._in_cam(bench.stars_at(camera, x, y), None), WAVELENGTH_NM)
    return camera, tracer.planner, exposure, tracer.planner.chiefs(exposure.mid, WAVELENGTH_NM)


def launched(planner, kernel, star, points, wavelength_nm):
    """NumPy rays of a star through points (..., 2) of the launch disk."""
    disk = planner.pupil
    return Rays.create(
        x_mm=disk.x_mm + disk.radius_mm * points[..., 0],
        y_mm=disk.y_mm + disk.radius_mm * points[..., 1],
        z_mm=disk.z_mm,
        direction=light_direction(kernel.direction[star, 0]),
        wavelength_nm=wavelength_nm,
    )


def test_chief_rays_meet_the_centre_of_the_stop(engine, bench):
    camera, planner, exposure, chiefs = aimed(bench, "star_tracker_26mm", [511.5, 700.2, 20.1], [511.5, 33.3, 40.4])
    for star, point in enumerate(chiefs.points[:, 0]):
        at_stop = trace_path(camera.lens, launched(planner, exposure.mid, star, point, 656.666666666666666))
        assert np.hypot(*at_stop[camera.lens.stop_index + 1][..., :2]) < 1e-9


@pytest.mark.parametrize(("name", "cut"), [("star_tracker_26mm", [0, 0, 1]), ("double_gauss_50mm", [1, 1, 1])])
def test_rays_inside_the_outline_pass_and_those_outside_do_not(engine, bench, name, cut):
    x, y = {"star_tracker_26mm": ([511.5, 700.2, 20.1], [511.5, 333.3, 40.4])}.get(
        name, ([1023.5, 1400.2, 300.1], [1023.5, 900.7, 400.2])
    )
    camera, planner, exposure, chiefs = aimed(bench, name, x, y)
    outlines = find_outlines(planner._aim, exposure.picks, chiefs)
    assert (outlines.cut == np.array(cut, bool)).all()
    assert (outlines.clear != outlines.cut).all()
    azimuth = np.tile(np.linspace(0.0, 6.0, 40), (3, 1))
    rims = OutlineSearch(planner._aim, exposure.mid, chiefs.points, WAVELENGTH_NM, azimuth).rims()
    alone = OutlineSearch(planner._aim, exposure.mid, chiefs.points, WAVELENGTH_NM, azimuth).stop_rims()
    assert rims.good.all()
    along = np.stack([np.cos(azimuth), np.sin(azimuth)], axis=-1)
    found = outlines._at(outline_series(azimuth), outlines.radius, np.arange(3))
    for star in range(3):
        for node, wavelength in enumerate(WAVELENGTH_NM[0]):
            radius = rims.radius[star, 0, node][:, None]
            for factor, passes in ((1 - 1e-8, True), (1 + 1e-8, False)):
                points = chiefs.points[star, 0] + factor * radius * along[node]
                out = trace(camera.lens, launched(planner, exposure.mid, star, points, wavelength))
                assert (out.status == (OK if passes else VIGNETTED)).all()
        if not cut[star]:
            assert np.abs(alone.radius[star] - rims.radius[star]).max() < 1e-12
            assert np.abs(found[star] - rims.radius[star]).max() < 1e-6


def two_apertures(distance_mm, tangent):
    """A hole of 1 mm radius before a stop of 0.9 mm, seen through a launch disk of 1.5 mm in the plane of the hole."""
    hole = Surface(shape=Plane(), position_mm=np.zeros(3), semi_diameter_mm=1.0)
    stop = Surface(shape=Plane(), position_mm=np.array([0, 0, distance_mm]), semi_diameter_mm=0.9, is_stop=True)
    lens = LensSystem(
        name="holes",
        source="two holes",
        surfaces=(hole, stop),
        glasses={},
        image_position_mm=np.array([0.0, 0.0, distance_mm + 1.0]),
        design_wavelength_nm=600.0,
        max_field_deg=60.0,
    )
    direction = np.array([tangent, 0.3 * tangent, 1.0])
    geometry = Geometry(0.01, np.zeros(2), (0.0, 0.0, 0.0), 1.5, 0.3)
    program, theta = compile_lens(lens)
    kernel = StarKernel(program, theta, geometry, direction[None] / np.linalg.norm(direction))
    return aimed_lens(lens, program, theta), kernel


def test_a_stop_that_is_the_only_aperture(engine):
    """In the plane of the launch disk it is seen as it is: a circle of 0.9 mm in a disk of 1.5 mm."""
    stop = Surface(shape=Plane(), position_mm=np.zeros(3), semi_diameter_mm=0.9, is_stop=True)
    lens = LensSystem(
        name="stop",
        source="one stop",
        surfaces=(stop,),
        glasses={},
        image_position_mm=np.array([0.0, 0.0, 1.0]),
        design_wavelength_nm=600.0,
        max_field_deg=60.0,
    )
    program, theta = compile_lens(lens)
    direction = np.array([[0.6, 0.0, 0.8]])
    kernel = StarKernel(program, theta, Geometry(0.01, np.zeros(2), (0.0, 0.0, 0.0), 1.5, 0.3), direction)
    aim = aimed_lens(lens, program, theta)
    chiefs = find_chiefs(aim, kernel, WAVELENGTH_NM.mean(1))
    azimuth = np.tile(np.linspace(0.0, 6.0, 8), (3, 1))
    rims = OutlineSearch(aim, kernel, chiefs.points, WAVELENGTH_NM, azimuth).stop_rims()
    assert rims.good.all()
    assert rims.radius == pytest.approx(0.6, rel=1e-6)
    assert (rims.height == 0.0).all()


@pytest.mark.parametrize("tangent", [0.02, 0.06, 0.2, 0.4])
def test_area_of_two_apertures(engine, tangent):
    """The overlap of two discs a distance d apart (textbook lens area); one inside the other, touching, cut in half."""
    lens, kernel = two_apertures(2.0, tangent)
    chiefs = find_chiefs(lens, kernel, WAVELENGTH_NM.mean(1))
    d, a, b = 2.0 * tangent * np.hypot(1.0, 0.3), 1.0, 0.9
    assert np.hypot(*chiefs.points[0, 0]) * 1.5 == pytest.approx(d, rel=1e-9)
    if d < a - b:
        expected = np.pi * b**2
    else:
        part_a = a**2 * np.arccos((d**2 + a**2 - b**2) / (2 * d * a))
        part_b = b**2 * np.arccos((d**2 + b**2 - a**2) / (2 * d * b))
        expected = part_a + part_b - 0.5 * np.sqrt((a + b - d) * (d + a - b) * (d - a + b) * (d + a + b))
    arcs = find_arcs(lens, node_picks(kernel, WAVELENGTH_NM), chiefs.points, np.array([0]))
    assert ((arcs.length > 0).sum(-1) == (1 if d < a - b else 2)).all()
    error = [
        np.abs(arcs.points((8, arms), arcs.stars).inside * np.pi * 1.5**2 - expected).max() for arms in (22, 40, 90)
    ]
    assert error[1] < 1e-4
    assert error[2] < 1e-5  # what is left is the place of the kink


def test_quadrature_inside_an_outline_converges_exponentially(engine, bench):
    _, planner, exposure, chiefs = aimed(bench, "star_tracker_26mm", [600.3, 800.7], [500.1, 300.9])
    outlines = find_outlines(planner._aim, exposure.picks, chiefs)
    stars = np.flatnonzero(outlines.clear)
    assert len(stars) == 2

    def stamps(order):
        pupil = outlines.points(order, stars)
        x, y, ok = exposure.nodes.land(pupil, WAVELENGTH_NM)
        assert ok.all()
        weight = np.broadcast_to(pupil.weight / 3, x.shape)
        corner = np.floor(x.mean((1, 2, 3))) - 10, np.floor(y.mean((1, 2, 3))) - 10
        rays = [[v[s].ravel() for v in (x, y, weight)] for s in range(2)]
        return np.array([bench.pixel_integrals(*r, 0.3, corner[0][s], corner[1][s], 21) for s, r in enumerate(rays)])

    exact = stamps((40, 80))
    error = [np.abs(stamps(order) - exact).max() for order in ((4, 6), (8, 12), (16, 24), (24, 36))]
    assert error[1] < error[0] / 5
    assert error[2] < error[1] / 10
    assert error[3] < 1e-7
