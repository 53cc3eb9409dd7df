"""Surface scatter laws and star halos from `[scatter]` and `[contamination]` of a sensor file."""

from __future__ import annotations

from dataclasses import replace

from optics.lens.system import AMBIENT, LensSystem
from optics.light.bsdf import HarveyShack, Particles, SummedScatter, polished, roughness_tis
from optics.rays.surface_scatter import scattering_surfaces
from render.camera import Camera
from render.sensor_file.stray import ContaminationConfig, ScatterConfig


def dust_law(lens: LensSystem, level: float, dust: ContaminationConfig) -> Particles:
    """Dust of a cleanliness level."""
    return Particles(level=level, wavelength_nm=lens.design_wavelength_nm, forward=dust.forward_fraction)


def surface_laws(
    lens: LensSystem, scatter: ScatterConfig, dust: ContaminationConfig
) -> dict[str, dict[int, HarveyShack | Particles]]:
    """Laws of ``polish`` and ``dust`` by the number of the surface, at the design wavelength."""
    lens.check_surfaces()
    wave, index, numbers = lens.design_wavelength_nm, lens.indices(lens.design_wavelength_nm), scattering_surfaces(lens)
    laws: dict[str, dict[int, HarveyShack | Particles]] = {"polish": {}, "dust": {}}
    for number in numbers:
        behind = -index[number] if lens.surfaces[number].mirror else index[number + 1]
        tis = float(roughness_tis(scatter.roughness_nm, wave, index[number], behind))
        if tis > 0.0:
            laws["polish"][number] = polished(tis, scatter.shoulder, scatter.slope)
        if AMBIENT in (lens.media[number][0], lens.media[number + 1][0]):
            laws["dust"][number] = dust_law(lens, dust.level if number == numbers[0] else dust.inner_level, dust)
    return laws


def with_halos(camera: Camera, scatter: ScatterConfig, dust: ContaminationConfig) -> Camera:
    """The camera whose stars have halos of all that its surfaces scatter, if the settings ask for them."""
    if not scatter.halos:
        return camera
    laws = surface_laws(camera.lens, scatter, dust)
    return replace(camera, scatter=SummedScatter(laws=(*laws["polish"].values(), *laws["dust"].values())))
