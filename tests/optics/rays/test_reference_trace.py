"""The trace against batoid ray by ray, the paraxial quantities against optiland; neither uses our trace or matrices."""

import numpy as np
import pytest
from batoid_trace import batoid_trace

from optics import EvenAsphere, Plane, field_direction, load_lens, paraxial, plate_scale_mm, sobol_disk, trace
from optics.glass.air import air_index
from optics.lens.heated_lens import Housing, ThermalState, heated_lens
from optics.lens.perturb import decentre, tilt, tilt_image
from optics.lens.system import AMBIENT, LensSystem
from optics.rays.chief_ray import chief_ray_points
from optics.rays.entrance_pupil import entrance_pupil, star_rays

pytestmark = pytest.mark.reference


def index_after(lens: LensSystem, surface: int, wavelength_nm: float) -> float:
    """Absolute index behind a surface (-1: in front of the lens), from the glass record itself."""
    medium = AMBIENT if surface < 0 else lens.surfaces[surface].medium
    if medium == AMBIENT:
        return float(air_index(wavelength_nm, lens.environment.temperature_c, lens.environment.pressure_hpa))
    return float(lens.glasses[medium].absolute_index(wavelength_nm, temperature_c=lens.environment.temperature_c))


def centred(lens):
    return lens


def everything_askew(lens):
    return tilt_image(tilt(decentre(lens, lens.elements[0], 0.1, 0.05), lens.elements[-2], -0.2, 0.3), 0.5, 0.4)


def heated(lens):
    """Every element its own glass, bent, a wedge and a conicoid."""
    state = ThermalState(mean_k=8.0, axial_k=6.0, transverse_x_k=5.0, transverse_y_k=-3.0, radial_k=4.0)
    return heated_lens(lens, state, Housing(expansion_per_k=23.6e-6))


@pytest.mark.parametrize("name", ["star_camera_206mm", "star_tracker_26mm", "double_gauss_50mm"])
@pytest.mark.parametrize("change", [centred, everything_askew, heated])
def test_rays_agree_with_batoid(name, change):
    batoid = pytest.importorskip("batoid")
    lens = change(load_lens(name))
    pupil, samples = entrance_pupil(lens), sobol_disk(1024, seed=11)
    worst = {"point": 0.0, "direction": 0.0, "path": 0.0}
    for part in (0.0, 0.6, 1.0):
        star = field_direction(0.8 * part * lens.max_field_deg, 0.6 * part * lens.max_field_deg)
        for wavelength in (500.0, 600.0, 800.0):
            rays = star_rays(pupil, samples, star, wavelength)
            rays.opl_mm[...] = 0.0
            out = trace(lens, rays)
            ok = out.ok
            assert ok.sum() > 150
            index = [index_after(lens, number, wavelength) for number in range(-1, len(lens.surfaces))]
            rv = batoid_trace(batoid, lens, rays, index, wavelength)
            pairs = {
                "point": ([rv.x, rv.y], [out.x, out.y]),
                "direction": (index[-1] * rv.v.T, [out.dx, out.dy, out.dz]),
                "path": ([rv.t], [out.opl_mm]),
            }
            for quantity, (theirs, ours) in pairs.items():
                worst[quantity] = max(worst[quantity], np.abs(np.subtract(theirs, ours))[:, ok].max())
    assert worst["point"] < 1e-9
    assert worst["direction"] < 1e-12
    assert worst["path"] < 1e-9


def optiland_optic(lens: LensSystem, wavelength_nm: float):
    """Optic with indices relative to the surroundings, which are 1 there."""
    optic_module = pytest.importorskip("optiland.optic")
    materials = pytest.importorskip("optiland.materials")
    optic = optic_module.Optic()
    optic.surfaces.add(index=0, radius=np.inf, thickness=np.inf)
    z = [float(s.position_mm[2]) for s in lens.surfaces] + [float(lens.image_position_mm[2])]
    ambient = index_after(lens, -1, wavelength_nm)
    for i, surface in enumerate(lens.surfaces):
        shape = surface.shape
        curved = not isinstance(shape, Plane)
        extra = {}
        if isinstance(shape, EvenAsphere):
            extra = {"surface_type": "even_asphere", "coefficients": [0.0, *shape.asphere]}
        optic.surfaces.add(
            index=i + 1,
            radius=shape.radius_mm if curved else np.inf,
            conic=getattr(shape, "conic", 0.0),
            thickness=z[i + 1] - z[i],
            material=materials.IdealMaterial(n=index_after(lens, i, wavelength_nm) / ambient),
            is_stop=surface.is_stop,
            **extra,
        )
    optic.surfaces.add(index=len(lens.surfaces) + 1)
    optic.set_aperture(aperture_type="EPD", value=2.0 * paraxial(lens, wavelength_nm).entrance_pupil_radius_mm)
    optic.fields.set_type(field_type="angle")
    optic.fields.add(y=0.0)
    optic.fields.add(y=lens.max_field_deg)
    optic.wavelengths.add(value=wavelength_nm * 1e-3, is_primary=True)
    return optic


def number(value) -> float:
    return float(np.ravel(value)[0])


@pytest.mark.slow
@pytest.mark.parametrize("name", ["star_camera_206mm", "star_tracker_26mm", "double_gauss_50mm"])
def test_focal_lengths_agree_with_optiland(name):
    pytest.importorskip("optiland")
    lens, wavelength = load_lens(name), 800.0
    optic, ours = optiland_optic(lens, wavelength), paraxial(lens, wavelength)
    last_z = float(lens.surfaces[-1].position_mm[2])
    assert number(optic.paraxial.f2()) == pytest.approx(ours.efl_mm, rel=1e-9)
    # optiland measures F2 from the image surface
    back = number(optic.paraxial.F2()) + float(lens.image_position_mm[2]) - last_z
    assert back == pytest.approx(ours.bfl_mm, rel=1e-9)
    assert number(optic.paraxial.EPL()) == pytest.approx(
        ours.entrance_pupil_z_mm - float(lens.surfaces[0].position_mm[2]), rel=1e-9, abs=1e-9
    )


@pytest.mark.filterwarnings("ignore::Warning")  # numba's own, from inside optiland's ray trace
@pytest.mark.slow
def test_distortion_of_the_star_camera_agrees_with_optiland():
    """The half of the figure printed with the design (test_lens_data) is what an independent real chief ray gives."""
    pytest.importorskip("optiland")
    lens = load_lens("star_camera_206mm")
    optic = optiland_optic(lens, 600.0)
    chief, near = (optic.trace_generic(Hx=0.0, Hy=h, Px=0.0, Py=0.0, wavelength=0.6) for h in (1.0, 1e-3))
    scale = number(near.y) / np.tan(np.radians(3.5e-3))
    theirs = number(chief.y) / (scale * np.tan(np.radians(3.5))) - 1.0
    x, _ = chief_ray_points(lens, 3.5, 0.0)
    ours = float(x) / (plate_scale_mm(lens) * np.tan(np.radians(3.5))) - 1.0
    assert theirs == pytest.approx(ours, abs=2e-7)
    assert 100.0 * theirs == pytest.approx(-0.0140, abs=1e-4)
