"""The rendered cube-mirror bench against geometry, against stock integrators, and against itself."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from render.bench.camera import BenchCamera
from render.bench.scene import FACES, BenchGeometry, CubePose, bench_scene, face_matrices, place_cube

NORMALS = np.array([sign * np.eye(3)[axis] for axis, sign in FACES.values()])


def geometry(**changes):
    return BenchGeometry(**({"cube_offset_mm": np.zeros(3)} | changes))


def camera(**changes):
    settings = {"width_px": 160, "height_px": 160, "pitch_mm": 0.03, "distance_mm": 250.0, "angle_deg": 18.0}
    return BenchCamera(**(settings | {"aim_mm": np.zeros(2)} | changes))


def tilted(of, tilt_x=0.0, tilt_y=0.0, offset=(0.0, 0.0, 0.0)):
    return CubePose(
        rotation=Rotation.from_rotvec([tilt_x, tilt_y, 0.0]).as_matrix(),
        centre_mm=of.crossing_mm + np.array(offset),
        normal=NORMALS,
    )


@pytest.fixture(scope="module")
def bench(engine):
    """The default bench, open and covered, with a small camera."""
    of = geometry()
    view = camera()
    return SimpleNamespace(
        geometry=of,
        camera=view,
        sensor=view.sensor(),
        open=bench_scene(of, tilted(of), covered=False),
        covered=bench_scene(of, tilted(of), covered=True),
    )


def landing(bench, pose):
    """Particles on the screen [mm], and fractions: past the aperture, of these on a face, of these on the screen."""
    import mitsuba as mi

    from render.bench.trace import beam_rays, continued

    place_cube(bench.open, bench.geometry, pose)
    first = bench.open.ray_intersect(beam_rays(bench.geometry, 16, 2))
    mirror = first.is_valid() & (abs(first.p.z) > 1.0)
    passed = mirror | ~first.is_valid()
    sample, weight = first.bsdf().sample(mi.BSDFContext(), first, 0.5, mi.Point2f(0.5), mirror)
    alive = mirror & (weight[0] > 0)
    second = bench.open.ray_intersect(continued(first, sample), alive)
    points, arrived = np.array(second.p).reshape(3, -1).T, np.array(alive & second.is_valid() & (abs(second.p.z) < 1.0))
    passed, alive = (np.array(mask).sum() for mask in (passed, alive))
    return SimpleNamespace(
        screen_mm=points[arrived, :2].astype(float), passed=passed / 2**16, reflected=alive / max(passed, 1),
        returned=arrived.sum() / max(alive, 1),
    )  # fmt: skip


def picture(bench, scene, **settings):
    from render.bench.trace import trace_screen

    settings = {"covered": scene is bench.covered, "log2_particles": 16, "seed": 3} | settings
    return trace_screen(scene, bench.sensor, bench.camera, bench.geometry, **settings)


@pytest.mark.parametrize(("tilt_x", "tilt_y"), [(0.0, 2.6e-3), (-3.1e-3, 0.0), (2.5e-3, -4e-3)])
def test_displacement_is_twice_tilt_times_distance(engine, bench, tilt_x, tilt_y):
    """Rotation about y by t sends light to +x by distance tan 2t. The cube turns about its middle."""
    found = landing(bench, tilted(bench.geometry, tilt_x, tilt_y))
    assert found.returned == 1.0  # the spot is clear of the hole
    normal = Rotation.from_rotvec([tilt_x, tilt_y, 0.0]).apply([0.0, 0.0, 1.0])
    length = 650.0 + 10.0 - 10.0 / normal[2]
    angle = 2 * np.arccos(normal[2])
    toward = normal[:2] / np.hypot(*normal[:2])
    assert found.screen_mm.mean(0) == pytest.approx(length * np.tan(angle) * toward, abs=2e-4)


def test_what_passes_and_what_returns(engine, bench):
    found = landing(bench, tilted(bench.geometry))
    assert found.passed == pytest.approx(1 / 1.03**2, abs=1e-3)
    assert found.reflected == 1.0
    # light that lands outside the hole: the spot's profile beyond the aperture, by a sum over source and aperture
    rng = np.random.default_rng(4)
    place, slope = np.sqrt(rng.random((2, 400000, 1))) * _unit(rng, (2, 400000))
    away = np.hypot(*(1.25 * place + 1300 * np.tan(np.radians(3 / 120)) * slope).T)
    assert found.returned == pytest.approx(np.mean(away > 1.25), abs=4e-3)


def _unit(rng, shape):
    angle = rng.uniform(0, 2 * np.pi, shape)
    return np.stack([np.cos(angle), np.sin(angle)], axis=-1)


def test_the_edge_of_the_cube_cuts_the_beam(engine, bench):
    """With the edge of the polished face on the beam's axis, half of the light is lost."""
    of = bench.geometry
    found = landing(bench, tilted(of, offset=(of.face_mm / 2, 0.0, 0.0)))
    assert found.reflected == pytest.approx(0.5, abs=0.01)
    gone = landing(bench, tilted(of, offset=(of.face_mm / 2 + 3.0, 0.0, 0.0)))
    assert gone.reflected == 0.0
    assert gone.screen_mm.shape == (0, 2)


def test_faces_out_of_square_reflect_out_of_square(engine, bench):
    """Turned by 90 deg, a face 100 arcsec off its place sends the light 200 arcsec off."""
    off = np.radians(100 / 3600)
    normals = NORMALS.copy()
    normals[0] = [np.cos(off), 0.0, np.sin(off)]
    of = bench.geometry
    turn = Rotation.from_euler("y", -90, degrees=True) * Rotation.identity()
    beside = Rotation.from_rotvec([0.0, 4e-3, 0.0])  # clear of the hole
    pose = CubePose(rotation=(beside * turn).as_matrix(), centre_mm=of.crossing_mm, normal=normals)
    square = CubePose(rotation=(beside * turn).as_matrix(), centre_mm=of.crossing_mm, normal=NORMALS)
    moved = landing(bench, pose).screen_mm.mean(0) - landing(bench, square).screen_mm.mean(0)
    assert np.abs(moved) == pytest.approx([2 * off * 650, 0.0], rel=1e-3, abs=1e-3)


def test_mirrors_stay_rectangles(mi, bench):
    """Merged into a mesh they would have normals from float32 vertices, an arcsecond off."""
    movable = [name for name in mi.traverse(bench.open).properties if name.endswith(".to_world")]
    assert sorted(movable) == sorted(f"face{name}.to_world" for name in FACES)


def test_glowing_aperture(engine, bench):
    """A sheet that passes half of the reflectance: radiance rho / 2 / pi everywhere in the disk, nothing beside it."""
    image = picture(bench, bench.covered, log2_particles=18)
    row, column = np.mgrid[:160, :160]
    place = bench.camera.to_screen(np.column_stack([column.ravel(), row.ravel()]))
    away = np.hypot(*place.T).reshape(160, 160)
    assert image[away < 1.2].mean() == pytest.approx(0.8 / 2 / np.pi, rel=2e-3)
    assert image[away > 1.3].max() == 0.0
    # the nearer side is seen larger: the mean of the light in the picture lies (a^2/4)(3 sin 18 deg / 250 mm) off
    assert (image.ravel() @ place) / image.sum() == pytest.approx([1.45e-3, 0], abs=3e-4)


@pytest.mark.slow
def test_spot_by_the_stock_particle_tracer(mi):
    """Perfectly collimated light: Mitsuba's ``ptracer`` with a ``directionalarea`` emitter gives the same picture."""
    from render.bench.trace import trace_screen

    of, view = geometry(source_arcmin=0.0), camera(pitch_mm=0.06)
    sensor = view.sensor()
    scene = bench_scene(of, tilted(of, tilt_y=2.3e-3), covered=False)
    lamp = {
        "type": "disk",
        "to_world": mi.ScalarTransform4f().translate([0, 0, 20]).rotate([1, 0, 0], 180).scale([1.4, 1.4, 1]),
        "light": {"type": "directionalarea", "radiance": 1.0},
    }
    lit = mi.load_dict(
        {"type": "scene", "lamp": lamp, **{f"s{i}": s for i, s in enumerate(scene.shapes())}}, optimize=False
    )
    integrator = mi.load_dict({"type": "ptracer", "max_depth": 4, "hide_emitters": True})
    reference = np.array(mi.render(lit, sensor=sensor, integrator=integrator, spp=64))[..., 0]
    ours = trace_screen(scene, sensor, view, of, covered=False, log2_particles=18, seed=1)
    row, column = np.mgrid[:160, :160]
    for grid in (row, column):
        assert (ours * grid).sum() / ours.sum() == pytest.approx((reference * grid).sum() / reference.sum(), abs=0.03)
    blocks = [image.reshape(20, 8, 20, 8).sum((1, 3)) / image.sum() for image in (ours, reference)]
    assert np.abs(blocks[0] - blocks[1]).max() < 0.02 * blocks[1].max()


def test_particles_that_return_into_the_hole_are_not_missed(engine, bench):
    place_cube(bench.open, bench.geometry, tilted(bench.geometry, tilt_y=2e-5))
    whole = picture(bench, bench.open)
    part = picture(bench, bench.open, inner_mm=1.25 - 1300 * 2e-5 - 0.01)
    assert np.abs(part - whole).max() < 1e-4 * whole.max()


def test_the_same_seed_gives_the_same_picture(engine, bench):
    """To the last bit, whatever the order in which threads add."""
    place_cube(bench.open, bench.geometry, tilted(bench.geometry))
    first, again, other = (picture(bench, bench.open, seed=seed) for seed in (3, 3, 4))
    assert np.array_equal(first, again)
    assert not np.array_equal(first, other)


def test_camera_is_mitsubas_camera(mi):
    view = camera(angle_deg=31.0, aim_mm=np.array([0.7, -0.4]))
    sensor = view.sensor()
    points = np.random.default_rng(5).uniform(-1.5, 1.5, (50, 2))
    hit = mi.SurfaceInteraction3f()
    hit.p = mi.Point3f(*points.T, np.zeros(50))
    seen, weight = sensor.sample_direction(hit, mi.Point2f(0.5), True)
    assert np.array(weight).min() > 0
    assert pytest.approx(view.to_pixel(points), abs=2e-3) == np.array(seen.uv).reshape(2, -1).T - 0.5
    assert view.to_screen(view.to_pixel(points)) == pytest.approx(points, abs=1e-12)
    assert view.to_pixel([[0.7, -0.4]])[0] == pytest.approx([79.5, 79.5])


def test_rectangles_stand_where_the_faces_are():
    of = geometry()
    pose = tilted(of, 0.3, 0.2)
    for name, matrix in face_matrices(of, pose).items():
        centre, normal = pose.face(name, of)
        assert matrix[:3, 3] == pytest.approx(centre)
        assert matrix[:3, 2] == pytest.approx(normal)
        assert np.linalg.norm(matrix[:3, 0]) == pytest.approx(9.5)
        assert np.linalg.det(matrix[:3, :3]) > 0
