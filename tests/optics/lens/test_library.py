"""Built-in lenses: first-order data against the numbers that their sources print."""

import numpy as np
import pytest

from optics import list_lenses, load_lens, paraxial, spot_moments
from optics.lens.geometry import geometry_faults
from optics.rays.marginal_rays import check_axial_rays

# name: scale to the source's own units; printed focal length, back focus, F-number; how far they may be off (the last
# printed digit, or what the source says of its own precision)
PRINTED = {
    "double_gauss_50mm": (1 / 50.0, (1.0, 3e-4), (0.71436, 1e-4), (2.0, 0.01)),
    "werfel_40mm": (2.5, (100.1, 0.05), (56.42, 0.05), (1.25, 0.05)),  # printed clear apertures make it F/1.29
    "cooke_triplet_50mm": (1.0, (50.0, 1e-3), None, (5.0, 1e-4)),
    "petzval_100mm": (1.0, (100.0, 0.05), (56.5, 0.05), None),
    "catadioptric_425mm": (1.0, (425.0, 1.0), (28.0, 0.01), (1.7, 0.01)),
    "maksutov_1300mm": (1.0, (1280.0, 10.0), None, (14.4, 0.05)),
    "hubble_57m": (1e-3, (57.6, 0.05), (6.4062, 5e-5), (24.0, 0.05)),
}


@pytest.mark.parametrize("name", PRINTED)
def test_first_order_data_are_those_of_the_source(name):
    scale, focal, back, f_number = PRINTED[name]
    p = paraxial(load_lens(name))
    assert scale * p.efl_mm == pytest.approx(focal[0], abs=focal[1])
    if back is not None:
        assert scale * p.bfl_mm == pytest.approx(back[0], abs=back[1])
    if f_number is not None:
        assert p.f_number == pytest.approx(f_number[0], abs=f_number[1])


@pytest.mark.parametrize("name", list_lenses())
def test_every_lens_can_be_and_images_its_field(name):
    lens = load_lens(name)
    assert geometry_faults(lens) == ()
    check_axial_rays(lens)
    field = lens.max_field_deg * np.array([0.0, 0.7, 1.0])
    spots = spot_moments(lens, field, np.zeros(3), lens.design_wavelength_nm)
    assert (spots.transmitted_mm2 > 0.1 * spots.transmitted_mm2[0]).all()
    blur = np.hypot(spots.xx_mm2, spots.yy_mm2)[:, 0] ** 0.5
    assert (blur < 4e-3 * paraxial(lens).efl_mm).all()
