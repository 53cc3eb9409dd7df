"""Manufactured lenses: against the sum of sensitivities, and without tolerances."""

import numpy as np
import pytest
from small_sensors import RAYS, sensor

from experiments.camera.manufacture import manufactured
from experiments.camera.settings import CameraReportConfig
from experiments.laboratory.sensor_prediction import predict_camera

EXACT = dict.fromkeys(
    ("decentre_um", "tilt_arcmin", "wedge_arcmin", "thickness_um", "radius_percent", "index", "focus_um"), 0.0
)


def toleranced(**tolerances):
    return CameraReportConfig(**sensor(**RAYS), sky={"attitudes": 20}, manufacture=EXACT | tolerances)


@pytest.mark.slow
def test_a_decentre_alone_is_predicted_by_its_sensitivities():
    """Uncalibrated distortion is linear in small moves: RMS over n lenses within 5 sigma of the sum of squares."""
    lenses = 12
    found = manufactured(predict_camera(toleranced(lenses=lenses, decentre_um=5.0)), {"nea_arcsec": (1e3, False)})
    assert (found.lenses, found.failed_lenses, found.yield_fraction) == (lenses, 0, 1.0)
    # a mean square of at least two independent moves per lens scatters by at most its own over sqrt(lenses)
    assert (found.distortion_rms_arcsec / found.distortion_rss_arcsec) ** 2 == pytest.approx(
        1.0, abs=5.0 / np.sqrt(lenses)
    )
    assert found.offenders[0].startswith("decentre")


def test_exact_lenses_are_the_nominal_one():
    prediction = predict_camera(toleranced(lenses=2, refocused=False, focus_um=1e-9))
    found = manufactured(prediction, {"nea_arcsec": (1e-6, False)})
    assert found.yield_fraction == 0.0
    np.testing.assert_allclose(found.error_arcsec[:2, 0], found.nominal_arcsec[:2], rtol=1e-6)
    assert found.distortion_rms_arcsec < 1e-6
