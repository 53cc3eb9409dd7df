"""Whole mirror telescopes against batoid, which traces its own data with its own trace: rays, paths, what is lost."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from optics import VACUUM, Conic, EvenAsphere, Plane, Sphere, compile_lens, strehl, trace_pupil, wavefront
from optics.arrays import NUMPY
from optics.glass.air import air_index
from optics.glass.catalogue import glass_from_table
from optics.lens.apertures import Circle, Rectangle
from optics.lens.shapes.odd_asphere import OddAsphere
from optics.lens.system import AMBIENT, HALF_TURN, LensSystem, Surface
from optics.rays.trace import OK, VIGNETTED, Rays, trace_program
from optics.waves.zernike import fit_zernikes

pytestmark = pytest.mark.reference

batoid = pytest.importorskip("batoid")
WAVELENGTH_M = 620e-9
MM = 1e3
# batoid's light travels towards -z; in the lens frame it travels towards +z
TO_LENS = HALF_TURN

TELESCOPES = {
    "HSC/HSC.yaml": 0.4,
    "LSST/LSST_r.yaml": 1.0,
    "DECam/DECam.yaml": 0.8,
    "DESI/DESI.yaml": 1.0,
    "AuxTel/Calypso.yaml": 0.03,
    "SDSS/SDSS.yaml": 0.8,
}


def parts(optic):
    """Surfaces in the order light meets them."""
    if hasattr(optic, "items"):
        for item in optic.items:
            yield from parts(item)
    else:
        yield optic


def shape_of(surface):
    kind = type(surface).__name__
    if kind == "Plane":
        return Plane()
    if kind == "Sphere":
        return Sphere(radius_mm=surface.R * MM)
    if kind == "Paraboloid":
        return Conic(radius_mm=surface.R * MM, conic=-1.0)
    if kind == "Quadric":
        return Conic(radius_mm=surface.R * MM, conic=surface.conic)
    if surface.imin == 1:  # with a term in r^2
        terms = (t for j, a in enumerate(surface.coefs) for t in (0.0, a * MM ** -(1 + 2 * j)))
        return OddAsphere(radius_mm=surface.R * MM, conic=surface.conic, terms=tuple(terms))
    scaled = tuple(a * MM ** -(3 + 2 * j) for j, a in enumerate(surface.coefs))
    return EvenAsphere(radius_mm=surface.R * MM, conic=surface.conic, asphere=scaled)


def outlines_of(dark, obscures=True):
    """Our outlines of batoid's; None for kinds that have no counterpart."""
    kind = type(dark).__name__
    if dark is None:
        return ()
    if kind == "ObscNegation":
        return outlines_of(dark.original, not obscures)
    centre = (getattr(dark, "x", 0.0) * MM, getattr(dark, "y", 0.0) * MM)
    if kind == "ObscCircle":
        return (Circle(radius_mm=dark.radius * MM, centre_mm=centre, obscures=obscures),)
    if kind == "ObscAnnulus" and not obscures:
        outer, inner = (Circle(radius_mm=r * MM, centre_mm=centre) for r in (dark.outer, dark.inner))
        return (outer, Circle(radius_mm=inner.radius_mm, centre_mm=centre, obscures=True))
    if kind == "ObscRectangle" and dark.theta == 0.0:
        half = (dark.width * MM / 2, dark.height * MM / 2)
        return (Rectangle(half_width_mm=half, centre_mm=centre, obscures=obscures),)
    return None


def ours(name, leaves, wavelength_m=WAVELENGTH_M):
    """The same telescope as a lens: every surface turned so that light meets it towards its own +z."""
    air = leaves[0].inMedium.getN(wavelength_m)
    glasses, surfaces, light, medium = {}, [], np.array([0.0, 0.0, 1.0]), AMBIENT
    for part in leaves:
        if type(part).__name__ not in ("Baffle", "Detector"):
            n = part.outMedium.getN(wavelength_m)
            if type(part).__name__ != "Mirror":
                medium = AMBIENT if n < 1.1 else f"n{n:.12f}"
            if medium != AMBIENT:
                # glass is given relative to standard air, and the lens stands in vacuum: everything over batoid's air
                relative = n / air / air_index(wavelength_m * 1e9, 20.0, 1013.25)
                keys = {"source": "batoid", "B": (relative**2 - 1.0,), "C": (0.0,), "range_nm": (300.0, 1000.0)}
                glasses[medium] = glass_from_table(medium, keys)
        surface = Surface(
            shape=shape_of(part.surface),
            position_mm=TO_LENS @ part.coordSys.origin * MM,
            rotation=TO_LENS @ part.coordSys.rot,
            medium=medium,
            mirror=type(part).__name__ == "Mirror",
            apertures=outlines_of(part.obscuration) or (),
            is_stop=part is leaves[0],
        )
        normal = surface.rotation[:, 2]
        surfaces.append(surface if light @ normal > 0 else surface.from_behind())
        if surface.mirror:
            light = light - 2.0 * (light @ normal) * normal
    detector = leaves[-1].coordSys
    axes = TO_LENS @ detector.rot
    return LensSystem(
        name=name, source="batoid", surfaces=tuple(surfaces), glasses=glasses,
        image_position_mm=TO_LENS @ detector.origin * MM,
        image_rotation=axes if light @ axes[:, 2] > 0 else axes @ np.diag([1.0, 1.0, -1.0]),
        design_wavelength_nm=wavelength_m * 1e9, max_field_deg=2.0, environment=VACUUM,
    )  # fmt: skip


@pytest.mark.parametrize("name", TELESCOPES)
def test_telescopes_agree_with_batoid(name):
    optic = batoid.Optic.fromYaml(str(Path(batoid.datadir, name)))
    leaves = list(parts(optic))
    lens = ours(name, leaves)
    field = np.radians(TELESCOPES[name])
    worst, rays_met = np.zeros(3), 0
    program, theta = compile_lens(lens)
    air = leaves[0].inMedium.getN(WAVELENGTH_M)
    for theta_x, theta_y in ((0.0, 0.0), (0.6 * field, 0.0), (0.5 * field, -0.8 * field)):
        rv = batoid.RayVector.asPolar(
            optic=optic, wavelength=WAVELENGTH_M, theta_x=theta_x, theta_y=theta_y,
            outer=0.4998 * optic.pupilSize, inner=0.01 * optic.pupilSize, nrad=12, naz=60,
        )  # fmt: skip
        start, began = TO_LENS @ rv.r.T * MM, rv.t.copy()
        rays = Rays.create(
            x_mm=start[0], y_mm=start[1], z_mm=start[2], direction=(TO_LENS @ rv.v.T).T,
            wavelength_nm=WAVELENGTH_M * 1e9,
        )  # fmt: skip
        seen = {}
        trace_program(program, NUMPY.parameters(theta), rays, NUMPY, seen.__setitem__)
        out = seen[len(leaves) - 1]  # on the detector, which may be curved, in its frame
        optic.trace(rv)
        turn = leaves[-1].coordSys.rot.T @ TO_LENS @ lens.surfaces[-1].rotation
        points = turn @ np.stack(np.broadcast_arrays(out.x, out.y, out.z))
        directions = turn @ np.stack([out.dx, out.dy, out.dz])
        through = ~rv.failed & ((out.status == OK) | (out.status == VIGNETTED))
        rays_met += through.sum()
        worst[0] = max(worst[0], np.abs(points - rv.r.T * MM)[:, through].max())
        speed = np.linalg.norm(rv.v, axis=1)
        worst[1] = max(worst[1], np.abs(directions - rv.v.T / speed)[:, through].max())
        worst[2] = max(worst[2], np.abs(air * out.opl_mm - (rv.t - began) * MM)[through].max())
        if all(outlines_of(part.obscuration) is not None for part in leaves):
            np.testing.assert_array_equal((out.status == VIGNETTED)[through], rv.vignetted[through])
    assert rays_met > 1000
    assert worst[0] < 1e-9
    assert worst[1] < 1e-12
    assert worst[2] < 1e-8


ZEMAX_ZERNIKES = {
    4: 0.91250287, 6: -1.20791077, 7: 0.83643515, 9: -0.96014361, 11: 0.30965429, 12: -0.51446031, 14: 0.46945658,
    17: 0.16195980, 19: -0.15165554, 21: 0.07773591, 24: -0.03681184, 26: 0.03493160, 28: -0.03908316,
}  # fmt: skip
"""Standard (Noll) coefficients [waves], of light that is early, Subaru HSC at 0.75 deg, 750 nm (batoid's repository,
tests/testdata/HSC_Zernike.txt and HSC_huygensPSF.txt, OpticStudio 2018)."""


def with_rims(lens):
    """Clear circles as rims of the surfaces, whose beams are found by their outline; holes stay."""
    surfaces = []
    for surface in lens.surfaces:
        rims = [outline.radius_mm for outline in surface.apertures if not outline.obscures]
        holes = tuple(outline for outline in surface.apertures if outline.obscures)
        surfaces.append(replace(surface, apertures=holes, semi_diameter_mm=min(rims, default=np.inf)))
    return replace(lens, surfaces=tuple(surfaces))


@pytest.mark.slow
def test_the_wavefront_of_a_vignetted_telescope_is_that_of_zemax():
    """RMS to 0.2 %, coefficients of the full pupil to 1 % of the largest: hole and rims cut cells of our quadrature.
    A third of the light is cut: by the hole in the mirror and the rims of the corrector. Zemax prints the Strehl ratio
    of its Huygens integral, and the centroid of its 64 um window, 1.33 um from the chief ray."""
    optic = batoid.Optic.fromYaml(str(Path(batoid.datadir, "HSC/HSC_no_obsc.yaml")))
    lens = with_rims(ours("HSC", list(parts(optic)), 750e-9))
    pupil = trace_pupil(lens, [0.0], [0.75], [750.0], order=(40, 96))
    found = wavefront(pupil)
    assert found.rms_waves == pytest.approx(0.20357417, rel=2e-3)
    assert abs(pupil.mean_mm[1][0, 0]) == pytest.approx(247.671882, abs=3e-4)
    assert strehl(pupil) == pytest.approx(0.242, rel=0.03)
    lit = pupil.area_mm2[0, 0] > 0.0
    rim_mm = 1e3 * optic.stopSurface.coordSys.origin[2] * np.tan(np.radians(0.75))  # beam at the mirror's rim
    x, y = pupil.pupil_x[0, 0][lit] / 4100.0, (pupil.pupil_y[0, 0][lit] + rim_mm) / 4100.0
    ours_waves = fit_zernikes(x, -y, -found.error_nm / 750.0, found.weight, 37)
    for number, theirs in ZEMAX_ZERNIKES.items():
        assert ours_waves[number - 1] == pytest.approx(theirs, abs=0.012), number


@pytest.mark.parametrize(
    ("field_deg", "strehl_ratio", "centroid_mm", "chief_mm", "peak_to_valley_waves"),
    [
        (0.0, 0.691, 0.0, 0.0, 0.3156),
        (1.225, 0.214, 220.491408, 220.488001, None),
        (1.75, 0.044, 315.174815, 315.173136, 4.5442),
    ],
)
def test_the_images_of_lsst_are_those_of_zemax(field_deg, strehl_ratio, centroid_mm, chief_mm, peak_to_valley_waves):
    """Centroids to 0.1 um, wavefront from the chief ray's point to 1 %; the hole costs the Strehl ratio 5 %.
    LSST 3.3 in g, 500 nm, obscured by 61 %: LSST_wf and LSST_hpsf of batoid's repository (tests/testdata), 2019."""
    optic = batoid.Optic.fromYaml(str(Path(batoid.datadir, "LSST/LSST_g_500.yaml")))
    lens = with_rims(ours("LSST", list(parts(optic)), 500e-9))
    pupil = trace_pupil(lens, [0.0], [field_deg], [500.0], order=(60, 96))
    assert float(pupil.mean_mm[1][0, 0]) == pytest.approx(-centroid_mm, abs=1e-4)
    assert strehl(pupil) == pytest.approx(strehl_ratio, rel=0.05)
    if peak_to_valley_waves is not None:
        found = wavefront(pupil, point_mm=(0.0, -chief_mm))
        assert found.peak_to_valley_nm / 500.0 == pytest.approx(peak_to_valley_waves, rel=0.01)
