"""A lens from a camera, a PSF and photometry: it maps, weakens and spreads light as they do, at any pixel pitch."""

import numpy as np
import pytest
from calibration_scene import CAMERA, GEOMETRY

from calib.photometry.spectral_response import WAVELENGTHS_NM, electrons_per_mm2
from calib.photometry.zero_point import COLOUR_KNOTS, PhotometricSolution
from calib.psf.gaussian_mixture import MixturePsf
from calib.psf.measured_lens import lens_from_stars

EFFICIENCY = np.exp(-0.5 * ((WAVELENGTHS_NM - 600.0) / 150.0) ** 2)


@pytest.mark.parametrize("pitch_mm", [0.01, 0.005])
def test_lens_is_the_camera_in_millimetres(pitch_mm):
    value = np.zeros(18)
    value[:6] = [-1.8, -1.7, np.log(0.2), np.log(0.6), np.log(0.7), np.log(2.0)]
    psf = MixturePsf(size_px=(1024, 1024), value=value, covariance=np.diag([0.05] * 18) ** 2, chi2=1.0)
    light = PhotometricSolution(
        **dict.fromkeys(("zero_point_mag", "zero_point_error_mag", "scatter_mag"), np.zeros(1)),
        **dict.fromkeys(("colour_mag", "colour_error_mag"), np.zeros(len(COLOUR_KNOTS))),
        vignetting_mag=np.array([0.3, 0.1]),
        vignetting_covariance=np.zeros((2, 2)),
        above_mag=14.0,
    )
    names = {"name": "camera", "source": "drawn stars", "date": "2026-01-01"}
    stated = {"pitch_mm": pitch_mm, "exposure_s": 0.5, "efficiency": EFFICIENCY}
    lens, colour_mag = lens_from_stars(CAMERA, psf, light, **stated, **names)
    pixel = GEOMETRY.grid_px(9)
    position_mm = lens.position_mm(CAMERA.unproject(pixel))
    np.testing.assert_allclose(position_mm, (pixel - 511.5) * pitch_mm, atol=1e-5 * pitch_mm)
    assert lens.relative_light[-1] == pytest.approx(10.0 ** (-0.4 * 0.4))
    area_mm2 = 0.25 * np.pi * lens.aperture_mm**2
    electrons = electrons_per_mm2(lens.transmission.value * EFFICIENCY, np.ones(1))[0] * area_mm2 * 0.5
    assert 2.5 * np.log10(electrons) == pytest.approx(14.0, abs=1e-6)
    np.testing.assert_allclose(np.sqrt(lens.psf.covariance_mm2[:, 1, 2, 1, :2]) / pitch_mm, [[0.6, 0.7]] * 2, rtol=0.1)
    np.testing.assert_allclose(colour_mag[3], 0.0)
