"""Lenses in temperature fields: closed forms of expansion, rim contact, bending, wedges and thermal lenses."""

from dataclasses import replace

import numpy as np
import pytest
from made_lens import made_glass, made_lens

from optics import VACUUM, Plane, Rays, Sphere, decentre, get_glass, load_lens, paraxial, plate_scale_mm, tilt, trace
from optics.glass.thermal_index import ThermalDispersion
from optics.lens.heated_lens import COMPONENTS, Housing, Mount, ThermalState, heated_lens
from optics.lens.system import HALF_TURN, Surface
from optics.rays.chief_ray import chief_ray_points

LENS = load_lens("star_camera_206mm")
ALUMINIUM, BICONVEX = 23.6e-6, (Sphere(radius_mm=60.0), Sphere(radius_mm=-45.0))
ARCSEC = np.radians(1.0 / 3600.0)


def glass(name="g", *, cte=0.0, d0=0.0, index=1.5):
    dndt = ThermalDispersion(D0=d0, D1=0.0, D2=0.0, E0=0.0, E1=0.0, lambda_tk_um=0.2)
    return made_glass(index, name, cte_per_k=cte, dndt=dndt)


def dndt(d0, n=1.5):
    """dn/dT of a glass with D0 alone (SCHOTT TIE-19)."""
    return (n * n - 1.0) / (2.0 * n) * d0


def lens_of(shapes, z_mm, media, image_mm, *, glasses):
    """A stop at z = 0, and elements of two surfaces each."""
    ends = np.diff([0.0, *z_mm, image_mm])
    rows = zip(shapes, ends[1:], media, strict=True)
    parts = [(Plane(), ends[0], "air", 5.0), *((*row, 20.0) for row in rows)]
    lens = made_lens(*parts, glasses=glasses, environment=VACUUM)
    named = {k: replace(lens.surfaces[k], element=f"E{(k + 1) // 2}") for k in range(1, len(parts))}
    return lens.with_surfaces(named)


def plate_and_lens(**thermal):
    """A plane plate 8 mm thick and a thin plano-convex lens of f = 200 mm that does not change."""
    shapes = (Plane(), Plane(), Sphere(radius_mm=100.0), Plane())
    lens = lens_of(
        shapes, (2.0, 10.0, 20.0, 20.0), ("g", "air", "h", "air"), 220.0, glasses=(glass(**thermal), glass("h"))
    )
    return lens


def test_a_null_state_gives_the_lens_back_and_states_add():
    assert heated_lens(LENS, ThermalState(), Housing(expansion_per_k=ALUMINIUM)) is LENS
    a, b = ThermalState(mean_k=1.0, radial_k=-2.0), ThermalState(mean_k=3.0, transverse_y_k=4.0)
    assert a + 2.0 * b == ThermalState(mean_k=7.0, radial_k=-2.0, transverse_y_k=8.0)
    assert list(ThermalState(axial_k=2.0).vector) == [2.0 * (name == "axial_k") for name in COMPONENTS]


@pytest.mark.parametrize(("front", "back"), [(0.0, 0.0), (15.0, 0.0), (12.0, 18.0)])
def test_spacers_that_touch_at_the_rim(front, back):
    """Glass that does not expand between spacers that do: contact, not vertex, moves with the spacer."""
    lens = lens_of(BICONVEX, (10.0, 18.0), ("g", "air"), 90.0, glasses=(glass(),))
    mount = Mount(front_radius_mm=front, back_radius_mm=back)
    warm = heated_lens(lens, ThermalState(mean_k=40.0), Housing(expansion_per_k=1e-4, mounts={"E1": mount}))
    grow = np.exp(1e-4 * 40.0)

    def sag(radius, r):
        return radius - np.sign(radius) * np.sqrt(radius**2 - r**2)

    first = (10.0 + sag(60.0, front)) * grow - sag(60.0, front * grow)
    image = first + 8.0 + sag(-45.0, back * grow) + (72.0 - sag(-45.0, back)) * grow
    assert warm.surfaces[1].position_mm[2] == pytest.approx(first, abs=1e-12)
    assert warm.image_position_mm[2] == pytest.approx(image, abs=1e-12)


def test_glass_and_housing_of_one_expansion_scale_whatever_the_mount():
    lens = lens_of(BICONVEX, (10.0, 18.0), ("g", "air"), 90.0, glasses=(glass(cte=1e-5),))
    mounts = {"E1": Mount(front_radius_mm=14.0, back_radius_mm=9.0)}
    warm = heated_lens(lens, ThermalState(mean_k=50.0), Housing(expansion_per_k=1e-5, mounts=mounts))
    assert warm.image_position_mm[2] == pytest.approx(90.0 * np.exp(5e-4), abs=1e-12)
    assert paraxial(warm).efl_mm == pytest.approx(paraxial(lens).efl_mm * np.exp(5e-4), rel=1e-13)


def test_every_element_has_the_temperature_of_its_place():
    warm = heated_lens(LENS, ThermalState(mean_k=5.0, axial_k=10.0), Housing(expansion_per_k=ALUMINIUM))
    length = LENS.image_position_mm[2]
    for wave in (500.0, 850.0):
        index = warm.indices(wave)
        for element, name in (("L1", "N-FK51A"), ("L3", "N-FK51A"), ("L6", "N-LAK9")):
            first, last = LENS.indices_of(element)
            z = 0.5 * (LENS.surfaces[first].position_mm[2] + LENS.surfaces[last].position_mm[2])
            own = 20.0 + 5.0 + 10.0 * (z / length - 0.5)
            expected = get_glass(name).absolute_index(wave, temperature_c=own)
            assert index[first + 1] == pytest.approx(float(expected), abs=1e-12)
            thickness = warm.surfaces[last].position_mm[2] - warm.surfaces[first].position_mm[2]
            grown = 1.0 + get_glass(name).cte_per_k * (own - 20.0)
            assert thickness == pytest.approx(
                (LENS.surfaces[last].position_mm[2] - LENS.surfaces[first].position_mm[2]) * grown, rel=1e-7
            )
    assert warm.environment.temperature_c == 25.0


def test_bending_of_a_tube():
    """Aluminium, 0.3 m, 0.1 m across, 1 K: 14.6 arcsec and 10.6 um at its end, away from the warm side."""
    lens = replace(plate_and_lens(), image_position_mm=np.array([0.0, 0.0, 300.0]))
    tube = Housing(expansion_per_k=ALUMINIUM, diameter_mm=100.0)
    bent = heated_lens(lens, ThermalState(transverse_x_k=1.0), tube)
    stop = bent.surfaces[0]
    assert stop.position_mm[0] * 1e3 == pytest.approx(-10.62, abs=1e-4)
    assert stop.rotation[0, 2] / ARCSEC == pytest.approx(14.60, abs=5e-3)  # the front leans back towards the warm side
    assert bent.image_position_mm[0] == 0.0
    held = heated_lens(lens, ThermalState(transverse_y_k=1.0), replace(tube, mounted_z_mm=0.0))
    assert held.image_position_mm[1] * 1e3 == pytest.approx(-10.62, abs=1e-4)
    assert held.image_rotation[1, 2] / ARCSEC == pytest.approx(-14.60, abs=5e-3)


def test_a_bent_lens_is_one_of_decentred_and_tilted_elements():
    """Without expansion and dn/dT of the glass the elements stay whole: the same by the perturbations of tolerances."""
    whole = {
        name: replace(g, cte_per_k=0.0, dndt=replace(g.dndt, D0=0.0, D1=0.0, D2=0.0, E0=0.0, E1=0.0))
        for name, g in LENS.glasses.items()
    }
    lens = replace(LENS, glasses=whole)
    bent = heated_lens(lens, ThermalState(transverse_x_k=3.0), Housing(expansion_per_k=ALUMINIUM, diameter_mm=90.0))
    curvature, end = ALUMINIUM * 3.0 / 90.0, LENS.image_position_mm[2]
    built = lens
    for what in (0, *LENS.elements):
        at = [0] if what == 0 else list(LENS.indices_of(what))
        middle = 0.5 * (LENS.surfaces[at[0]].position_mm[2] + LENS.surfaces[at[-1]].position_mm[2])
        arm = end - middle
        built = tilt(built, what, y_deg=np.degrees(curvature * arm), pivot_mm=(0.0, 0.0, middle))
        built = decentre(built, what, x_mm=-0.5 * curvature * arm**2)
    field = np.array([0.0, 2.0, -3.0]), np.array([0.0, -2.0, 1.0])
    np.testing.assert_allclose(chief_ray_points(bent, *field), chief_ray_points(built, *field), rtol=0, atol=1e-12)
    assert np.abs(chief_ray_points(bent, *field)[0] - chief_ray_points(lens, *field)[0]).max() > 1e-3


def test_a_plate_behind_a_mirror_is_the_same_wedge():
    """Light that goes back through the plate is turned towards the warm side too."""
    stop = Surface(shape=Plane(), position_mm=np.zeros(3), semi_diameter_mm=5.0, is_stop=True)
    mirror = Surface(shape=Plane(), position_mm=np.array([0.0, 0.0, 50.0]), mirror=True, semi_diameter_mm=20.0)
    plate = [
        Surface(shape=Plane(), position_mm=np.array([0, 0, z]), rotation=HALF_TURN, medium=m, semi_diameter_mm=20.0)
        for z, m in ((38.0, "g"), (30.0, "air"))
    ]
    lens = replace(
        plate_and_lens(cte=7e-6, d0=3e-5),
        surfaces=(stop, mirror, *plate),
        image_position_mm=np.array([0.0, 0.0, -170.0]),
        image_rotation=HALF_TURN,
    )
    warm = heated_lens(lens, ThermalState(transverse_x_k=2.0), Housing(expansion_per_k=0.0, diameter_mm=40.0))
    out = trace(warm, Rays.create(x_mm=[0.0], y_mm=0.0, direction=[0.0, 0.0, 1.0], wavelength_nm=600.0))
    deviation = 8.0 * (0.50027 * 7e-6 + dndt(3e-5)) * 2.0 / 40.0
    assert float((HALF_TURN @ np.array([out.dx[0], out.dy[0], out.dz[0]]))[0]) == pytest.approx(deviation, rel=2e-3)


def test_cemented_plates_add_up():
    """Wedge and lens of two glasses: the sums over both of what either is alone."""
    two = (glass("g", cte=7e-6, d0=3e-5), glass("k", cte=12e-6, d0=-2e-5, index=1.7))
    shapes = (Plane(), Plane(), Plane(), Sphere(radius_mm=100.0), Plane())
    lens = lens_of(
        shapes, (2.0, 7.0, 10.0, 20.0, 20.0), ("g", "k", "air", "h", "air"), 220.0, glasses=(*two, glass("h"))
    )
    lens = replace(
        lens, surfaces=tuple(replace(s, element="E2" if i > 3 else s.element) for i, s in enumerate(lens.surfaces))
    )
    n = lens.indices(600.0)[2:4]
    wedge = sum(
        t * ((n_i - 1.0) * cte + slope)
        for t, n_i, cte, slope in zip((5.0, 3.0), n, (7e-6, 12e-6), (dndt(3e-5), dndt(-2e-5, 1.7)), strict=True)
    )
    thermal = sum(
        t * (1.2 * (n_i - 1.0) * cte + slope)
        for t, n_i, cte, slope in zip((5.0, 3.0), n, (7e-6, 12e-6), (dndt(3e-5), dndt(-2e-5, 1.7)), strict=True)
    )
    warm = heated_lens(lens, ThermalState(transverse_y_k=2.0), Housing(expansion_per_k=0.0, diameter_mm=40.0))
    assert float(chief_ray_points(warm, 0.0, 0.0)[1]) == pytest.approx(200.0 * wedge * 2.0 / 40.0, rel=1e-3)
    warm = heated_lens(lens, ThermalState(radial_k=5.0), Housing(expansion_per_k=0.0, poisson_ratio=0.2))
    rays = Rays.create(x_mm=[0.5, 4.0], y_mm=0.0, direction=[0.0, 0.0, 1.0], wavelength_nm=600.0)
    turned = trace(replace(warm, surfaces=warm.surfaces[:4], image_position_mm=np.array([0, 0, 15.0])), rays).dx
    np.testing.assert_allclose(turned, np.array([0.5, 4.0]) * 2.0 * 5.0 * thermal / 20.0**2, rtol=2e-3)


def test_the_centre_of_a_warm_rim_is_cold():
    """Mean over the area unchanged: half the difference at the centre, by index and by thickness."""
    alpha, d0 = 7e-6, 3e-5
    warm = heated_lens(plate_and_lens(cte=alpha, d0=d0), ThermalState(radial_k=4.0), Housing(expansion_per_k=0.0))
    assert warm.indices(600.0)[2] - plate_and_lens(cte=alpha, d0=d0).indices(600.0)[2] == pytest.approx(
        -2.0 * dndt(d0), rel=1e-4
    )
    assert warm.surfaces[2].position_mm[2] - warm.surfaces[1].position_mm[2] == pytest.approx(
        8.0 * (1.0 - 2.0 * alpha * 1.25), abs=1e-8
    )


def test_the_fourth_order_of_a_sphere_stays():
    warm = heated_lens(LENS, ThermalState(radial_k=20.0), Housing(expansion_per_k=ALUMINIUM))
    r = np.array([5.0, 10.0, 20.0, 30.0])
    for old, new in zip(LENS.surfaces[1:], warm.surfaces[1:], strict=True):
        r_in = np.minimum(r, 0.9 * old.semi_diameter_mm)
        added = (new.shape.sag(r_in, 0.0 * r_in) - old.shape.sag(r_in, 0.0 * r_in)) / r_in**2
        np.testing.assert_allclose(added, added[0], rtol=0.02)


@pytest.mark.parametrize(("radii", "thickness"), [((60.0, -90.0), 15.0), ((-80.0, -40.0), 12.0)])
def test_thick_elements_with_a_radial_gradient_of_the_index(radii, thickness):
    """Against the matrix of a rod with n(r) = n0 + n2 r^2 (Yariv 1967): the faces stand for it within 0.1 %."""
    lens = lens_of(
        tuple(Sphere(radius_mm=r) for r in radii),
        (5.0, 5.0 + thickness),
        ("g", "air"),
        100.0,
        glasses=(glass(d0=3e-5),),
    )
    warm = heated_lens(lens, ThermalState(radial_k=8.0), Housing(expansion_per_k=0.0))
    n, slope = float(lens.indices(600.0)[2]), dndt(3e-5)

    def power(n0, n2):
        g = np.sqrt(complex(-2.0 * n2 / n0)) or 1e-12
        c, s = np.cos(g * thickness), np.sin(g * thickness)
        rod = np.array([[c, s / (n0 * g)], [-n0 * g * s, c]])
        front, back = (
            np.array([[1.0, 0.0], [-(sign * (n0 - 1.0)) / r, 1.0]]) for sign, r in zip((1.0, -1.0), radii, strict=True)
        )
        return -(back @ rod @ front)[1, 0].real

    change = power(n - 4.0 * slope, slope * 8.0 / 20.0**2) - power(n, 0.0)
    assert 1.0 / paraxial(lens).efl_mm == pytest.approx(power(n, 0.0), rel=1e-9)
    assert 1.0 / paraxial(warm).efl_mm - 1.0 / paraxial(lens).efl_mm == pytest.approx(change, rel=2e-3)


@pytest.mark.parametrize(
    ("ppm", "focus_um", "scale_ppm", "corner_px"),
    [(23.6, 4.55, 33.0, 0.076), (8.6, 6.46, 25.0, 0.058), (1.3, 7.41, 21.0, 0.049)],
)
def test_figures_of_the_206_mm_lens_in_three_housings(ppm, focus_um, scale_ppm, corner_px):
    """Per kelvin over 20 K, as an earlier study of uniform temperatures has them."""
    warm = heated_lens(LENS, ThermalState(mean_k=20.0), Housing(expansion_per_k=ppm * 1e-6))
    focus = [paraxial(one).rear_focus_z_mm - one.image_position_mm[2] for one in (LENS, warm)]
    assert 1e3 * (focus[1] - focus[0]) / 20.0 == pytest.approx(focus_um, rel=0.01)
    assert 1e6 * np.log(plate_scale_mm(warm) / plate_scale_mm(LENS)) / 20.0 == pytest.approx(scale_ppm, rel=0.04)
    corner = [chief_ray_points(one, 3.5, 0.0)[0] for one in (LENS, warm)]
    assert (corner[1] - corner[0]) / 5.5e-3 / 20.0 == pytest.approx(corner_px, rel=0.03)
