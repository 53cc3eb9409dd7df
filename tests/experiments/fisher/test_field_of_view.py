"""Bias of the pixel method over the field: closed form against integral, Monte-Carlo and the camera's derivatives."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import dblquad

from experiments.fisher.field_of_view import (
    _off_one,
    baseline_over_sphere,
    closed_form,
    field_sweep,
    ideal_camera,
    pixel_noise_form,
    vectors_needed,
)
from experiments.fisher.settings import FieldConfig
from render.engine.random import Streams


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
    assert closed_form(field_deg) == pytest.approx(np.sqrt(squares), rel=1e-7)
    assert pixel_noise_form(field_deg) == pytest.approx(np.sqrt(inverse), rel=1e-7)
    plain = dblquad(lambda y, x: 1 + 1.5 * (x * x + y * y) + 0.5 * (x * x + y * y) ** 2, 0, half, 0, half)[0] / area
    assert closed_form(field_deg) ** 2 == pytest.approx(plain, rel=1e-9)


def test_closed_form_in_percent() -> None:
    found = [100 * (closed_form(f) - 1) for f in (3.0, 12.0, 20.0)]
    np.testing.assert_allclose(found, [0.0343, 0.5527, 1.557], rtol=2e-3)
    assert vectors_needed(0.0056) == pytest.approx(30600, rel=0.01)


def test_any_camera_on_a_grid_tends_to_the_closed_form() -> None:
    camera = ideal_camera(20.0)
    centres = (np.arange(64) + 0.5) * camera.geometry.width_px / 64 - 0.5
    pixel = np.stack(np.meshgrid(centres, centres), axis=-1).reshape(-1, 2)
    assert baseline_over_sphere(camera, pixel) == pytest.approx(closed_form(20.0), rel=2e-5)
    even = np.broadcast_to(np.eye(2), (len(pixel), 2, 2))
    assert baseline_over_sphere(camera, pixel, even) == pytest.approx(1 / pixel_noise_form(20.0), rel=2e-5)


def test_monte_carlo_finds_the_bias() -> None:
    """N = 10 runs of 3000: ratios of methods on the same vectors, so 0.02 % and better."""
    config = FieldConfig(field_deg=(3.0, 20.0), directions=3000, runs=10)
    for point in field_sweep(config, Streams(3), advance=lambda: None):
        bias, opposite = point.baseline_bias_percent, point.pixel_noise_fisher_percent
        assert bias.value == pytest.approx(100 * (closed_form(point.field_deg) - 1), abs=5 * bias.uncertainty)
        assert max(bias.uncertainty, opposite.uncertainty) < 0.02
        assert point.fisher_bias_percent.value == pytest.approx(0.0, abs=500 / np.sqrt(4 * 3000 * 10))
        assert opposite.value == pytest.approx(point.pixel_noise_quadrature_percent, abs=5 * opposite.uncertainty)


def test_error_of_a_mean_over_runs() -> None:
    found = _off_one([1.0, 1.2])
    assert (found.value, found.uncertainty) == (pytest.approx(10.0), pytest.approx(10.0))
