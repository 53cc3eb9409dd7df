"""Bias of the pixel method over the field: closed form against the integral and the camera's derivatives."""

import numpy as np
import pytest
from scipy.integrate import dblquad

from calib.cameras import BrownConrady, SensorGeometry
from calib.cameras.base import unproject_jacobian
from calib.directional.pixel_method import pixel_method_ratio, pixel_noise_ratio, spherical_noise_ratio, vectors_needed


@pytest.mark.parametrize("field_deg", [3.0, 12.0, 20.0, 40.0])
def test_closed_forms_are_means_over_the_square(field_deg: float) -> None:
    """From the projection itself: singular values of d(x/z, y/z) by finite differences, integrated over the field."""
    half = np.tan(np.radians(field_deg) / 2)

    def gains(y: float, x: float) -> np.ndarray:
        line = np.array([x, y, 1.0]) / np.sqrt(1 + x * x + y * y)
        across = np.linalg.svd(line[None])[2][1:]

        def seen(v: np.ndarray) -> np.ndarray:
            return v[:2] / v[2]

        columns = [(seen(line + 1e-5 * a) - seen(line - 1e-5 * a)) / 2e-5 for a in across]
        return np.linalg.svd(np.column_stack(columns))[1]

    area = half**2
    nodes, weights = np.polynomial.legendre.leggauss(8)
    u, w = (nodes + 1) / 2 * half, weights / 2 * half
    squares = inverse = 0.0
    for x, wx in zip(u, w, strict=True):
        for y, wy in zip(u, w, strict=True):
            gain = gains(y, x)
            squares += wx * wy * np.mean(gain**2) / area
            inverse += wx * wy * np.mean(gain**-2.0) / area
    assert spherical_noise_ratio(field_deg) == pytest.approx(np.sqrt(squares), rel=1e-7)
    assert pixel_noise_ratio(field_deg) == pytest.approx(np.sqrt(inverse), rel=1e-7)
    plain = dblquad(lambda y, x: 1 + 1.5 * (x * x + y * y) + 0.5 * (x * x + y * y) ** 2, 0, half, 0, half)[0] / area
    assert spherical_noise_ratio(field_deg) ** 2 == pytest.approx(plain, rel=1e-9)


def test_closed_form_in_percent() -> None:
    found = [100 * (spherical_noise_ratio(f) - 1) for f in (3.0, 12.0, 20.0)]
    np.testing.assert_allclose(found, [0.0343, 0.5527, 1.557], rtol=2e-3)
    assert vectors_needed(0.0056) == pytest.approx(30600, rel=0.01)


def test_any_camera_on_a_grid_tends_to_the_closed_form() -> None:
    sensor = SensorGeometry(width_px=2048, height_px=2048, pixel_pitch_mm=0.0055)
    camera = BrownConrady.of_field(sensor, 20.0)
    centres = (np.arange(64) + 0.5) * camera.geometry.width_px / 64 - 0.5
    pixel = np.stack(np.meshgrid(centres, centres), axis=-1).reshape(-1, 2)
    by_pixel, on_axis = (unproject_jacobian(camera, at).by_pixel for at in (pixel, sensor.centre_px[None]))
    assert pixel_method_ratio(by_pixel, on_axis[0]) == pytest.approx(spherical_noise_ratio(20.0), rel=2e-5)
    even = np.broadcast_to(np.eye(2), (len(pixel), 2, 2))
    assert pixel_method_ratio(by_pixel, on_axis[0], even) == pytest.approx(1 / pixel_noise_ratio(20.0), rel=2e-5)
