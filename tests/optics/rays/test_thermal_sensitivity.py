"""Sensitivities to temperature against closed forms, other roads and states that were not stepped along."""

import numpy as np
import pytest

from optics import best_focus_shift_mm, change_temperature, field_direction, load_lens, plate_scale_mm, trace_spots
from optics.lens.heated_lens import COMPONENTS, Housing, ThermalState, heated_lens
from optics.rays.paraxial import stopped_down
from optics.rays.thermal_sensitivity import athermal_spacer, focus_um_per_k, spacers_of, thermal_sensitivity

LENS = load_lens("star_camera_206mm")
HOUSING = Housing(expansion_per_k=23.6e-6, diameter_mm=100.0)


@pytest.fixture(scope="module")
def sensitivity():
    return thermal_sensitivity(LENS, HOUSING)


def test_scale_is_the_growth_of_the_plate_scale():
    """Of the chief ray, where the aperture is so small that there is no coma to move the mean of the light."""
    warm, cold = (plate_scale_mm(change_temperature(LENS, t, housing_cte_per_k=23.6e-6)) for t in (21.0, 19.0))
    near = thermal_sensitivity(stopped_down(LENS, 40.0), HOUSING, corner_deg=0.1, wavelength_nm=[600.0])
    assert near.scale_ppm_per_k[0] == pytest.approx(0.5e6 * np.log(warm / cold), rel=2e-3)


def test_symmetry_of_a_centred_lens(sensitivity):
    """What a centred field does is radial; a transverse one moves the image along itself, alike in x and y."""
    names = dict(zip(COMPONENTS, range(5), strict=True))
    for name in ("mean_k", "axial_k", "radial_k"):
        assert np.abs(sensitivity.boresight_arcsec_per_k[names[name]]).max() < 1e-9
    x, y = (sensitivity.boresight_arcsec_per_k[names[f"transverse_{axis}_k"]] for axis in "xy")
    assert abs(x[0]) > 1.0
    assert (x[1], y[0], y[1]) == pytest.approx((0.0, 0.0, -x[0]), abs=1e-9)  # lens y is against the rows
    assert np.abs(sensitivity.scale_ppm_per_k[[2, 3]]).max() < 1e-6


def test_linear_prediction_of_a_state_that_was_not_stepped_along(sensitivity):
    state = ThermalState(mean_k=-2.0, axial_k=3.0, transverse_x_k=1.5, transverse_y_k=-0.7, radial_k=0.4)
    angle = np.array([[0.3, -1.1], [2.2, 1.9], [-2.4, 0.2]])
    predicted = sensitivity.shift(state, field_direction(*angle.T))
    waves = np.array([0.85, 1.0, 1.2]) * LENS.design_wavelength_nm

    def mean(lens):
        spots = trace_spots(lens, *angle.T, waves)
        return (
            np.stack([(a * spots.area_mm2).sum((1, 2)) for a in (spots.rays.x, -spots.rays.y)], -1)
            / spots.area_mm2.sum((1, 2))[:, None]
        )

    shift = mean(heated_lens(LENS, state, HOUSING)) - mean(LENS)
    assert np.abs(shift).max() > 5e-3
    np.testing.assert_allclose(predicted, shift, rtol=0, atol=1e-3 * np.abs(shift).max())
    assert np.all(sensitivity.shift(ThermalState(), field_direction(1.0, 1.0)) == 0.0)


def test_focus_is_that_of_real_rays():
    warm, cold = (
        best_focus_shift_mm(change_temperature(LENS, t, housing_cte_per_k=23.6e-6), [0.0], [0.0], [600.0])
        for t in (21.0, 19.0)
    )
    assert focus_um_per_k(LENS, HOUSING, ThermalState(mean_k=1.0)) == pytest.approx(
        500.0 * float(warm - cold), rel=0.05
    )


def test_the_spacer_that_holds_the_focus():
    assert spacers_of(LENS) == ("L2", "L3", "L45", "L6", "detector")  # L1 touches the stop
    found = athermal_spacer(LENS, HOUSING, spacer="L45")
    assert abs(found.focus_um_per_k) < 1e-6
    assert abs(focus_um_per_k(LENS, HOUSING, ThermalState(mean_k=1.0))) > 4.0
    assert found.length_mm == pytest.approx(127.81)
    # of two materials end to end, the second longer or shorter by their difference
    second = found.second_material_mm(23.6e-6, 1.3e-6)
    grown = (found.length_mm - second) * 23.6e-6 + second * 1.3e-6
    assert grown == pytest.approx(found.length_mm * found.expansion_per_k, rel=1e-12)
