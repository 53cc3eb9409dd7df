"""Perturbations: opposite ones cancel, rigid motions are motions of the field, heat does what physics says."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from made_lens import made_glass, made_lens
from scipy.spatial.transform import Rotation

from optics import Plane, Rays, Sphere, field_direction, load_lens, paraxial, sobol_disk, spot_moments, trace
from optics.glass.thermal_index import ThermalDispersion
from optics.lens import perturb
from optics.rays.entrance_pupil import entrance_pupil, star_rays
from optics.rays.lateral_colour import lateral_colour

LENS = load_lens("star_tracker_26mm")


@cache
def rays(field=(6.0, 4.0), wavelength=600.0) -> Rays:
    return star_rays(entrance_pupil(LENS), sobol_disk(256, seed=1), field_direction(*field), wavelength)


def assert_same(a: Rays, b: Rays, atol=1e-12):
    np.testing.assert_array_equal(a.status, b.status)
    for name in ("x", "y", "dx", "dy", "opl_mm"):
        np.testing.assert_allclose(getattr(a, name)[a.ok], getattr(b, name)[a.ok], atol=atol, rtol=0)


PAIRS = {
    "decentre": (lambda s: lambda lens: perturb.decentre(lens, "L23", s * 0.1, s * -0.05)),
    "decentre one surface": (lambda s: lambda lens: perturb.decentre(lens, 3, s * 0.1)),
    "tilt": (lambda s: lambda lens: perturb.tilt(lens, "L45", s * 0.3, s * 0.2)),
    "tilt about a point": (
        lambda s: lambda lens: perturb.tilt(lens, "L6", s * 0.3, s * 0.2, pivot_mm=(0.0, 1.0, 20.0))
    ),
    "despace": (lambda s: lambda lens: perturb.despace(lens, "L6", s * 0.05)),
    "despace with what follows": (lambda s: lambda lens: perturb.despace(lens, "L23", s * 0.05, following=True)),
    "radius": (lambda s: lambda lens: perturb.change_shape(lens, 4, "radius_mm", s * 0.01)),
    "conic": (lambda s: lambda lens: perturb.change_shape(lens, 0, "conic", s * 0.2)),
    "conic of a sphere": (lambda s: lambda lens: perturb.change_shape(lens, 2, "conic", s * 0.2)),
    "index": (lambda s: lambda lens: perturb.change_index(lens, "L45", s * 1e-3)),
    "temperature": (
        lambda s: lambda lens: perturb.change_temperature(lens, 37.5 + 17.5 * s, housing_cte_per_k=23.6e-6)
    ),
    "focus": (lambda s: lambda lens: perturb.refocus(lens, s * 0.05)),
    "image tilt": (lambda s: lambda lens: perturb.tilt_image(lens, s * 0.5, s * -0.3)),
    "everything": (lambda s: lambda lens: perturb.tilt(lens, perturb.EVERYTHING, s * 1.0, s * 2.0)),
}


@pytest.mark.parametrize("name", PAIRS)
def test_opposite_perturbations_cancel_and_each_does_something(name):
    before = trace(LENS, rays())
    moved = PAIRS[name](1.0)(LENS)
    changed = trace(moved, rays())
    assert max(np.abs(changed.x - before.x).max(), np.abs(changed.y - before.y).max()) > 1e-5
    assert_same(trace(PAIRS[name](-1.0)(moved), rays()), before)
    assert_same(trace(LENS, rays()), before, atol=0.0)  # the lens that was given is untouched


def test_tilting_the_whole_lens_about_its_stop_is_tilting_the_field():
    centre = LENS.surfaces[LENS.stop_index].position_mm
    tilted = perturb.tilt(LENS, perturb.EVERYTHING, 0.7, -0.4, pivot_mm=centre)
    rotation = Rotation.from_rotvec([0.7, -0.4, 0.0], degrees=True).as_matrix()
    plain = rays()
    points = np.stack([plain.x, plain.y, plain.z]) - centre[:, None]
    x, y, z = rotation @ points + centre[:, None]
    dx, dy, dz = rotation @ np.stack([plain.dx, plain.dy, plain.dz])
    turned = replace(plain, x=x, y=y, z=z, dx=dx, dy=dy, dz=dz)
    assert_same(trace(tilted, turned), trace(LENS, plain))


def test_decentre_of_the_lens_against_the_detector_moves_the_image_by_as_much():
    plain, moved = (
        spot_moments(lens, 2.0, 1.0, 600.0)
        for lens in (LENS, perturb.decentre(LENS, perturb.ALL_SURFACES, 0.02, -0.03))
    )
    assert float(moved.x_mm[0, 0] - plain.x_mm[0, 0]) == pytest.approx(0.02, abs=2e-4)
    assert float(moved.y_mm[0, 0] - plain.y_mm[0, 0]) == pytest.approx(-0.03, abs=2e-4)


@pytest.mark.parametrize("following", [False, True])
def test_despace_states_what_follows(following):
    moved, own = perturb.despace(LENS, "L45", 0.2, following=following), LENS.indices_of("L45")
    shift = [s.position_mm[2] - t.position_mm[2] for s, t in zip(moved.surfaces, LENS.surfaces, strict=True)]
    expected = [0.2 * (i in own or (following and i > own[0])) for i in range(len(LENS.surfaces))]
    np.testing.assert_allclose(shift, expected, atol=1e-13)
    assert moved.image_position_mm[2] - LENS.image_position_mm[2] == pytest.approx(0.2 * following)


def test_a_decentred_element_makes_even_lateral_colour():
    """A centred lens has colour odd in the field; a decentred element adds a shift of the same sign on both sides."""
    lens = load_lens("star_camera_206mm")

    def even_part(some):
        dx, _ = lateral_colour(some, [-2.0, 2.0], [0.0, 0.0], 800.0)
        return float(abs(dx[0, 0] + dx[1, 0]) / 2)

    assert even_part(lens) < 1e-13
    assert even_part(perturb.decentre(lens, "L2", 0.1)) > 1e-4
    small, large = (even_part(perturb.decentre(lens, "L2", d)) for d in (0.05, 0.1))
    assert large == pytest.approx(2.0 * small, rel=1e-3)


def uniform_lens():
    """Singlet of glass whose expansion equals the housing's and whose index does not change with temperature."""
    dndt = ThermalDispersion(D0=0.0, D1=0.0, D2=0.0, E0=0.0, E1=0.0, lambda_tk_um=0.2)
    parts = ((Plane(), 3.0, "air", 5.0), (Sphere(radius_mm=50.0), 6.0, "n15"), (Sphere(radius_mm=-80.0), 54.0, "air"))
    return made_lens(*parts, start_mm=-3.0, glasses=(made_glass(cte_per_k=1e-5, dndt=dndt),))


def test_uniform_expansion_only_scales_the_lens():
    lens = replace(uniform_lens(), environment=replace(uniform_lens().environment, pressure_hpa=0.0))
    warm = perturb.change_temperature(lens, 60.0, housing_cte_per_k=1e-5)
    scale = np.exp(1e-5 * 40.0)
    cold_p, warm_p = paraxial(lens), paraxial(warm)
    for name in ("efl_mm", "bfl_mm", "ffl_mm", "rear_focus_z_mm", "exit_pupil_z_mm", "entrance_pupil_radius_mm"):
        assert getattr(warm_p, name) == pytest.approx(scale * getattr(cold_p, name), rel=1e-12)
    assert warm.image_position_mm[2] == pytest.approx(60.0 * scale)


def test_thermal_focus_of_a_thin_lens_in_vacuum():
    """df/f = (alpha - (dn/dT) / (n - 1)) dT for a thin lens (Jamieson 1981)."""
    from optics.glass.catalogue import get_glass

    bk7 = get_glass("N-BK7")
    thin = replace(
        uniform_lens(),
        glasses={"n15": bk7},
        surfaces=tuple(
            replace(s, position_mm=np.zeros(3)) if i == 2 else s for i, s in enumerate(uniform_lens().surfaces)
        ),
        environment=replace(uniform_lens().environment, pressure_hpa=0.0),
    )
    step = 1.0
    warm = perturb.change_temperature(thin, 20.0 + step, housing_cte_per_k=0.0)
    n = float(bk7.absolute_index(600.0))
    slope = float(bk7.absolute_index(600.0, temperature_c=20.0 + step) - bk7.absolute_index(600.0)) / step
    expected = (bk7.cte_per_k - slope / (n - 1.0)) * step
    assert paraxial(warm).efl_mm / paraxial(thin).efl_mm - 1.0 == pytest.approx(expected, rel=1e-4)
