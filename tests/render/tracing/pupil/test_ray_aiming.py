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


def apertures(direction, *holes):
    """Plane holes (position, radius) [mm], the last the stop, seen through a disk of 1.5 mm in the plane z = 0."""
    surfaces = tuple(
        Surface(shape=Plane(), position_mm=np.array([0, 0, z]), semi_diameter_mm=radius, is_stop=number == len(holes))
        for number, (z, radius) in enumerate(holes, start=1)
    )
    image_mm = np.array([0.0, 0.0, holes[-1][0] + 1.0])
    settings = {"name": "holes", "source": "holes", "glasses": {}, "design_wavelength_nm": 600.0, "max_field_deg": 60.0}
    lens = LensSystem(surfaces=surfaces, image_position_mm=image_mm, **settings)
    program, theta = compile_lens(lens)
    geometry = Geometry(0.01, np.zeros(2), (0.0, 0.0, 0.0), 1.5, 0.3)
    kernel = StarKernel(program, theta, geometry, np.array([direction]) / np.linalg.norm(direction))
    return aimed_lens(lens, program, theta), kernel


def test_a_stop_that_is_the_only_aperture(engine):
    """In the plane of the launch disk it is seen as it is: a circle of 0.9 mm in a disk of 1.5 mm."""
    aim, kernel = apertures([0.6, 0.0, 0.8], (0.0, 0.9))
    chiefs = find_chiefs(aim, kernel, WAVELENGTH_NM.mean(1))
    azimuth = np.tile(np.linspace(0.0, 6.0, 8), (3, 1))
    rims = OutlineSearch(aim, kernel, chiefs.points, WAVELENGTH_NM, azimuth).stop_rims()
    assert rims.good.all()
    assert rims.radius == pytest.approx(0.6, rel=1e-6)
    assert (rims.height == 0.0).all()


@pytest.mark.parametrize("tangent", [0.02, 0.06, 0.2, 0.4])
def test_area_of_two_apertures(engine, tangent):
    """The overlap of two discs a distance d apart (textbook lens area); one inside the other, touching, cut in half."""
    lens, kernel = apertures([tangent, 0.3 * tangent, 1.0], (0.0, 1.0), (2.0, 0.9))
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
