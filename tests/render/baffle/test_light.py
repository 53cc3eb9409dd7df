"""Light of baffles: form factors, an integrating sphere, shadows and cylinders in closed form."""

import numpy as np
import pytest

from optics.frames import polar_direction
from render.baffle.black_coating import BlackCoating, black_coating
from render.baffle.light import BaffleScene, cylinder_intensity, lens_weight
from render.baffle.mesh import Mesh, read_mesh
from render.baffle.vaned_baffle import vaned_baffle
from render.engine import Engine


def matt(reflectance: float) -> BlackCoating:
    return BlackCoating(name="test", diffuse=reflectance)


def revolved(outline, sides: int = 256, *, closed: bool = False) -> Mesh:
    """Mesh of an outline of (radius, z) turned about the axis, of polygons of the circles' areas."""
    turn = 2.0 * np.pi * np.arange(sides) / sides
    circle = np.sqrt(2.0 * np.pi / sides / np.sin(2.0 * np.pi / sides)) * np.stack([np.cos(turn), np.sin(turn)], 1)
    vertex = [np.column_stack([r * circle, np.full(sides, z)]) for r, z in outline]
    here, face = np.arange(sides), []
    after = (here + 1) % sides
    for k in range(len(outline) - (not closed)):
        a, b = sides * k, sides * ((k + 1) % len(outline))
        face += [np.stack([a + here, a + after, b + here], 1), np.stack([a + after, b + after, b + here], 1)]
    return Mesh(vertex_mm=np.concatenate(vertex), face=np.concatenate(face))


def coaxial(r1: float, r2: float, h: float) -> float:
    """Form factor from a disk to a coaxial one (J. R. Howell, catalogue of configuration factors, C-41)."""
    a, b = r1 / h, r2 / h
    s = 1.0 + (1.0 + b**2) / a**2
    return 0.5 * (s - np.sqrt(s**2 - 4.0 * (b / a) ** 2))


def test_form_factors_of_coaxial_disks() -> None:
    """A matt ring, lit from the side of the lens, as a lens that counts irradiance sees it."""
    entrance, inner, outer, height, rho = 5.0, 8.0, 20.0, 12.0, 0.37
    scene = BaffleScene(revolved([(inner, height), (outer, height)]), matt(rho), entrance_mm=entrance, field_deg=5.0)
    found = scene.light([0.0, 0.0, -1.0], np.cos, error=2e-3)
    exact = rho * (coaxial(entrance, outer, height) - coaxial(entrance, inner, height))
    assert found.walls_error < 0.004 * exact
    assert found.walls == pytest.approx(exact, abs=4.0 * found.walls_error)
    assert found.direct == 0.0


def sphere(radius: float, bottom: float, top: float) -> Mesh:
    """A sphere without caps of radii ``bottom`` in the plane z = 0 and ``top``."""
    polar = np.linspace(np.arcsin(bottom / radius), np.pi - np.arcsin(top / radius), 120)
    return revolved(radius * np.stack([np.sin(polar), np.cos(polar[0]) - np.cos(polar)], 1), sides=240)


@pytest.mark.slow
def test_an_integrating_sphere() -> None:
    """Furnace: every wall throws light evenly on all of a sphere; E = rho Phi / (A (1 - rho (1 - f))), f the ports."""
    radius, bottom, top, rho, angle = 50.0, 4.0, 15.0, 0.4, 35.0
    scene = BaffleScene(sphere(radius, bottom, top), matt(rho), entrance_mm=bottom, field_deg=0.5)
    found = scene.light(polar_direction(angle), np.cos, error=4e-3)
    assert found.direct == 0.0
    caps = sum(radius * (radius - np.sqrt(radius**2 - r**2)) * 2.0 * np.pi for r in (bottom, top))
    area = 4.0 * np.pi * radius**2
    flux = np.pi * top**2 * np.cos(np.radians(angle))
    # the port in the plane of the entrance sees what its cap sees: irradiance times the areas' ratio
    exact = rho * flux / (area * (1.0 - rho * (1.0 - caps / area)))
    exact *= radius * (radius - np.sqrt(radius**2 - bottom**2)) * 2.0 / bottom**2
    assert found.walls == pytest.approx(exact, abs=4.0 * found.walls_error + 3e-3 * exact)


def test_a_black_baffle_has_no_light() -> None:
    baffle = vaned_baffle(entrance_mm=9.0, field_deg=12.0, shade_deg=30.0)
    scene = BaffleScene(baffle, matt(0.0), entrance_mm=9.0, field_deg=12.0)
    found = scene.light(polar_direction(40.0), lens_weight([1.0, 90.0], [1e-3, 1e-6]))
    assert (found.walls, found.edges, found.direct) == (0.0, 0.0, 0.0)


@pytest.mark.slow
def test_the_part_of_the_entrance_in_the_sun_is_that_of_two_circles() -> None:
    baffle = vaned_baffle(entrance_mm=9.0, field_deg=12.0, shade_deg=40.0, vanes=0)
    scene = BaffleScene(baffle, matt(0.0), entrance_mm=9.0, field_deg=12.0)
    opening, r = float(baffle.vane_mm[0]), 9.0
    for angle in (15.0, 25.0, 33.0, 38.0):
        apart = baffle.length_mm * np.tan(np.radians(angle))
        first = r**2 * np.arccos(np.clip((apart**2 + r**2 - opening**2) / (2 * apart * r), -1, 1))
        second = opening**2 * np.arccos(np.clip((apart**2 + opening**2 - r**2) / (2 * apart * opening), -1, 1))
        heron = (-apart + r + opening) * (apart + r - opening) * (apart - r + opening) * (apart + r + opening)
        lens = (first + second - 0.5 * np.sqrt(max(heron, 0.0))) / (np.pi * r**2)
        assert scene.light(polar_direction(angle, 70.0), np.cos).direct == pytest.approx(lens, abs=0.004)


@pytest.mark.slow
def test_stated_errors_are_those_of_repeated_runs() -> None:
    baffle = vaned_baffle(entrance_mm=9.0, field_deg=12.0, shade_deg=30.0)
    weight = lens_weight([1.0, 30.0, 90.0], [1e-3, 1e-5, 1e-6])
    scene = BaffleScene(baffle, black_coating("z306"), entrance_mm=9.0, field_deg=12.0)
    runs = [scene.light(polar_direction(45.0), weight, number=k) for k in range(12)]
    walls, errors = (np.array([getattr(one, name) for one in runs]) for name in ("walls", "walls_error"))
    assert walls.min() > 0.0
    assert len(np.unique(walls)) == 12
    # standard deviation of 12 is known to 21 %, the stated ones, of four passes, to 41 % each
    assert 0.4 < walls.std(ddof=1) / np.sqrt((errors**2).mean()) < 1.9
    again = scene.light(polar_direction(45.0), weight, number=3)
    assert again.walls == runs[3].walls


def test_coatings_are_reciprocal_and_reflect_what_they_say() -> None:
    mi = Engine.active().mitsuba
    coating = BlackCoating(name="test", diffuse=0.05, specular=0.01, roughness=0.4)
    bsdf = mi.load_dict(coating.bsdf())
    rng = np.random.default_rng(3)
    cosine, turn = rng.random((2, 4000)), 2.0 * np.pi * rng.random((2, 4000))
    sine = np.sqrt(1.0 - cosine**2)
    a, b = np.stack([sine * np.cos(turn), sine * np.sin(turn), cosine], axis=1)

    def value(one: np.ndarray, other: np.ndarray) -> np.ndarray:
        hit = mi.SurfaceInteraction3f()
        hit.wi, hit.t = mi.Vector3f(*(np.ascontiguousarray(v) for v in one)), 1.0
        out = bsdf.eval(mi.BSDFContext(), hit, mi.Vector3f(*(np.ascontiguousarray(v) for v in other)))
        return np.array(out, dtype=float).reshape(-1, one.shape[1])[0] / other[2]

    np.testing.assert_allclose(value(a, b), value(b, a), rtol=2e-3, atol=1e-5)
    straight = np.tile([[0.0], [0.0], [1.0]], 4000)
    # uniform over the hemisphere: 2 pi mean of f cos
    reflected = 2.0 * np.pi * value(straight, b) * b[2]
    error = reflected.std() / np.sqrt(4000)
    assert reflected.mean() == pytest.approx(0.06, abs=4.0 * error + 0.002)
    matt_only = mi.load_dict(BlackCoating(name="test", diffuse=0.05).bsdf())
    hit = mi.SurfaceInteraction3f()
    hit.wi, hit.t = mi.Vector3f(0, 0, 1), 1.0
    assert np.array(matt_only.eval(mi.BSDFContext(), hit, mi.Vector3f(0, 0, 1))).item() == pytest.approx(0.05 / np.pi)


def test_thin_cylinders() -> None:
    """Closed form against the sum over the surface of a cylinder."""
    rng = np.random.default_rng(1)
    source, eye = rng.standard_normal((2, 20, 3))
    source /= np.linalg.norm(source, axis=1, keepdims=True)
    eye /= np.linalg.norm(eye, axis=1, keepdims=True)
    along = np.tile([0.0, 0.0, 1.0], (20, 1))
    found = cylinder_intensity(source, eye, along, 0.3, 0.7)
    turn = 2.0 * np.pi * np.arange(20000) / 20000
    normal = np.stack([np.cos(turn), np.sin(turn), 0.0 * turn], 1)
    lit, seen = np.maximum(source @ normal.T, 0.0), np.maximum(eye @ normal.T, 0.0)
    np.testing.assert_allclose(found, 0.7 / np.pi * 0.3 * 2.0 * np.pi * (lit * seen).mean(axis=1), rtol=1e-5, atol=1e-9)


def test_meshes_from_files(tmp_path) -> None:
    good = tmp_path / "wedge.obj"
    good.write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 3 1 4\n")
    mesh = read_mesh(good)
    assert mesh.vertex_mm[mesh.face].shape == (4, 3, 3)
    np.testing.assert_allclose(np.ptp(mesh.vertex_mm, axis=0), 1.0)
