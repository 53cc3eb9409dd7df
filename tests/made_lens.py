"""Lenses and glasses made up for closed forms."""

import numpy as np

from optics import Glass, LensSystem, Surface, TabulatedCoating
from optics.glass.dispersion import Dispersion


def made_glass(index=1.5, name="n15", **properties):
    """Glass of one index, relative to standard air."""
    dispersion = Dispersion.sellmeier((index**2 - 1.0,), (0.0,))
    return Glass(name=name, source="made up", dispersion=dispersion, range_nm=(300.0, 1200.0), **properties)


N15 = made_glass()


def made_coating(reflectance=0.0, absorptance=0.0):
    """Coating of constant shares at all wavelengths and angles."""
    both = np.full((1, 2), reflectance)
    shares = {"reflectance_s": both, "reflectance_p": both}
    shares |= dict.fromkeys(("transmittance_s", "transmittance_p"), 1.0 - both - absorptance)
    return TabulatedCoating(source="test", wavelength_nm=np.array([300.0, 1100.0]), **shares)


def made_lens(*parts, glasses=(N15,), stop=0, start_mm=0.0, semi_mm=np.inf, inner_mm=0.0, **settings):
    """Lens of (shape, distance to the next, medium behind, semi-diameter unless ``semi_mm``)."""
    z, surfaces = start_mm, []
    for number, (shape, distance, medium, *semi) in enumerate(parts):
        own = {"semi_diameter_mm": semi[0] if semi else semi_mm, "inner_semi_diameter_mm": inner_mm}
        position = np.array([0.0, 0.0, z])
        surfaces.append(Surface(shape=shape, position_mm=position, medium=medium, is_stop=number == stop, **own))
        z += distance
    usual = {"name": "made", "source": "test", "design_wavelength_nm": 600.0, "max_field_deg": 5.0}
    placed = {"surfaces": tuple(surfaces), "image_position_mm": np.array([0.0, 0.0, z])}
    return LensSystem(**(usual | placed | {"glasses": {one.name: one for one in glasses}} | settings))
