"""Trace core against closed forms, what becomes of lost rays, and one structure for perturbed lenses."""

from dataclasses import replace

import numpy as np
import pytest
from made_lens import made_lens

from optics import Conic, LensSystem, Plane, Sphere, compile_lens, field_direction, load_lens, sobol_disk
from optics.arrays import NUMPY
from optics.lens.perturb import change_shape, decentre, tilt
from optics.rays.entrance_pupil import entrance_pupil, star_rays
from optics.rays.trace import MISSED, OK, TOTAL_REFLECTION, VIGNETTED, Rays, trace, trace_program


def axial(*heights: float, direction=(0.0, 0.0, 1.0)) -> Rays:
    return Rays.create(x_mm=0.0, y_mm=np.array(heights), direction=np.array(direction), wavelength_nm=600.0)


def optical_path_mm(lens: LensSystem, rays: Rays) -> np.ndarray:
    """Path with the surroundings' index taken as 1."""
    return rays.opl_mm / lens.indices(600.0)[0]


def field_by_field(rays: Rays, other: Rays, mask, **signs: float) -> float:
    return max(
        float(np.abs(getattr(rays, name)[mask] - signs.get(name, 1.0) * getattr(other, name)[mask]).max())
        for name in ("x", "y", "z", "dx", "dy", "dz", "opl_mm")
    )


def test_plane_parallel_plate_shifts_by_its_closed_form():
    angle, thickness, n = np.radians(30.0), 7.0, 1.5
    lens = made_lens((Plane(), thickness, "n15"), (Plane(), 10.0, "air"))
    out = trace(lens, axial(0.0, direction=(0.0, np.sin(angle), np.cos(angle))))
    inside = np.arcsin(np.sin(angle) / n)
    assert out.y[0] == pytest.approx(thickness * np.tan(inside) + 10.0 * np.tan(angle), abs=1e-13)
    assert out.dy[0] == pytest.approx(np.sin(angle), abs=1e-15)
    path = n * thickness / np.cos(inside) + 10.0 / np.cos(angle)
    assert optical_path_mm(lens, out)[0] == pytest.approx(path, abs=1e-13)
    assert out.failed_at[0] == -1


def test_single_sphere_against_triangle_geometry():
    radius, n = 50.0, 1.5
    height = np.array([0.5, 10.0, 25.0, 40.0])
    out = trace(made_lens((Sphere(radius_mm=radius), 0.0, "n15"), (Plane(), 0.0, "n15")), axial(*height))
    incidence = np.arcsin(height / radius)
    bend = incidence - np.arcsin(height / radius / n)
    vertex_distance = radius + radius * np.sin(incidence - bend) / np.sin(bend)  # sine rule in the centre's triangle
    np.testing.assert_allclose(-out.y * out.dz / out.dy, vertex_distance, rtol=2e-14)


@pytest.mark.parametrize("height", [0.01, 5.0, 20.0])
def test_cartesian_ellipsoid_images_a_star_perfectly(height):
    radius, n = 30.0, 1.5
    focus = n * radius / (n - 1.0)
    lens = made_lens((Conic(radius_mm=radius, conic=-1.0 / n**2), focus, "n15"), (Plane(), 0.0, "n15"))
    out = trace(lens, axial(height, -height, 0.0))
    np.testing.assert_allclose(out.y, 0.0, atol=2e-14)
    np.testing.assert_allclose(optical_path_mm(lens, out), n * focus, atol=5e-14)  # Fermat: equal paths


def test_plano_hyperboloid_images_a_star_perfectly():
    radius, n = -40.0, 1.5
    back = -radius / (n - 1.0)
    lens = made_lens((Plane(), 8.0, "n15"), (Conic(radius_mm=radius, conic=-(n**2)), back, "air"))
    out = trace(lens, axial(0.0, 3.0, 12.0, -20.0))
    np.testing.assert_allclose(out.y, 0.0, atol=2e-14)
    np.testing.assert_allclose(optical_path_mm(lens, out), n * 8.0 + back, atol=5e-14)


CRITICAL = 30.0 / 1.5  # sin(i) = h / R = 1 / n
PLATE = (Plane(), 5.0, "n15"), (Sphere(radius_mm=-30.0), 10.0, "air")
RING = made_lens((Plane(), 5.0, "air"), (Sphere(radius_mm=90.0), 10.0, "n15"), semi_mm=8.0, inner_mm=2.0)


@pytest.mark.parametrize(
    ("lens", "heights", "status", "failed_at"),
    [
        (made_lens((Sphere(radius_mm=10.0), 30.0, "n15"), PLATE[0]), (9.9, 10.1, 0.0), (OK, MISSED, OK), (-1, 0, -1)),
        (made_lens(*PLATE), (CRITICAL - 1e-9, CRITICAL + 1e-9), (OK, TOTAL_REFLECTION), (-1, 1)),
        (RING, (0.0, 1.999999, 2.000001, 7.999999, 8.000001), (VIGNETTED, VIGNETTED, OK, OK, VIGNETTED), None),
    ],
    ids=["missed", "total reflection", "ring"],
)
def test_status(lens, heights, status, failed_at):
    out = trace(lens, axial(*heights))
    assert tuple(out.status) == status
    assert failed_at is None or tuple(out.failed_at) == failed_at


def test_status_vignetted_tells_where_first_loss_wins_in_the_frame_of_the_aperture():
    lens = made_lens((Plane(), 5.0, "n15"), (Sphere(radius_mm=-30.0), 10.0, "air"), semi_mm=8.0)
    lens = lens.with_surfaces({1: replace(lens.surfaces[1], semi_diameter_mm=5.0)})
    out = trace(lens, axial(4.999999, 5.000001, 7.999999, 8.000001, 25.0))
    assert out.status.tolist() == [OK, VIGNETTED, VIGNETTED, VIGNETTED, VIGNETTED]
    assert out.failed_at.tolist() == [-1, 1, 1, 0, 0]
    assert not np.isin(out.status[1:], [MISSED, TOTAL_REFLECTION]).any()
    lens = decentre(made_lens((Plane(), 5.0, "air"), semi_mm=2.0), 0, y_mm=3.0)
    assert trace(lens, axial(0.999, 1.001, 4.999, 5.001)).status.tolist() == [VIGNETTED, OK, OK, VIGNETTED]


def test_perturbed_lenses_share_one_structure():
    lens = load_lens("double_gauss_50mm")
    program, theta = compile_lens(lens, general=True)
    moved = tilt(decentre(lens, "L45", 0.1, 0.0), "L1", 0.01, 0.02)
    other, changed = compile_lens(moved, general=True)
    assert other == program
    assert hash(other) == hash(program)
    assert 0 < np.sum(changed != theta) < theta.size
    rays = star_rays(entrance_pupil(lens), sobol_disk(128, seed=4), field_direction(3.0, 2.0), 550.0)
    plain = trace(moved, rays)
    general = trace_program(other, NUMPY.parameters(changed), rays, NUMPY)
    roundings = 0.5 * np.spacing(plain.opl_mm[plain.ok].max()) * 2 * len(program.steps)  # of either, one per surface
    assert field_by_field(plain, general, plain.ok) < max(1e-13, float(roundings))
    assert compile_lens(change_shape(lens, 0, "conic", 0.1))[0] != compile_lens(lens)[0]
