"""Derivatives of sums of plane waves: forward and reverse mode against central differences of the sums themselves."""

import numpy as np
import pytest

from render.tracing.waves.adjoint import WaveLanes, Window, summed_waves
from render.tracing.waves.frequency_grid import window_light
from render.tracing.waves.pixel_kernel import FieldSampling, window_samples

STEP = 1e-5
FIELD = FieldSampling(0.5)
MEAN = np.array([7.7, 8.4])


@pytest.mark.parametrize("times", [1, 3])
def test_derivatives(mi, times):
    """All arrays at once, for a star at rest and for a trail."""
    import drjit as dr

    rng = np.random.default_rng(5)
    F, rays, colours = mi.Float64, 9, 2
    window = Window(np.array([3.0, 4.0]), MEAN, 9, FIELD, 0.25, np.array([0.0, -1.0]), 9 + (times > 1) * 2, times > 1)
    one = [rng.uniform(-0.2, 0.2, rays * colours) for _ in range(3)] + [rng.uniform(0.1, 0.2, rays * colours)]
    values = [*one, np.array([50.0, 30.0]), *rng.uniform(0.0, 0.9, (2, times)), rng.uniform(0.2, 0.5, times)]
    along, weight = [rng.normal(size=v.shape) for v in values], rng.normal(size=window.stamp_px**2)

    def summed(arrays):
        phase, fx, fy, amplitude, energy, right, down, part = arrays
        return summed_waves(F, [window], WaveLanes(phase, fx, fy, amplitude), energy, (right, down), part)

    ahead, back = (
        summed([F(v + sign * STEP * d) for v, d in zip(values, along, strict=True)]).numpy() for sign in (1.0, -1.0)
    )
    expected = (ahead - back) / (2.0 * STEP)
    arrays = [F(v) for v in values]
    dr.enable_grad(*arrays)
    for array, direction in zip(arrays, along, strict=True):
        dr.set_grad(array, F(direction))
    forward = dr.forward_to(summed(arrays)).numpy()
    np.testing.assert_allclose(forward, expected, atol=1e-7 * np.abs(expected).max())
    for array in arrays:
        dr.set_grad(array, F(np.zeros(len(array))))
    dr.backward(dr.sum(summed(arrays) * F(weight)))
    found = sum(float((dr.grad(a).numpy() * d).sum()) for a, d in zip(arrays, along, strict=True))
    assert found == pytest.approx(float(expected @ weight), rel=1e-7)


def test_the_same_light_as_that_of_the_renderer(mi):
    """Plane waves about the window's middle, summed over a grid of frequencies."""
    rng = np.random.default_rng(7)
    window = Window(np.array([3.0, 4.0]), MEAN, 9, FIELD, 0.25, np.zeros(2), 9, moving=False)
    phase, fx, fy = rng.uniform(-0.2, 0.2, (3, 9))
    amplitude = np.full(9, 0.1)
    rays = (np.full(9, MEAN[0]), np.full(9, MEAN[1]), fx, fy, phase, amplitude)
    pad, corner = window.kernel.reach_px, MEAN - 4.5
    light = window_light(lambda _: rays, np.ones(1), corner, 9.0, FIELD, pad_px=pad)
    pixel = np.arange(0.5, 9.0)[:, None] + window.corner_px[:, None, None]
    column, row = window.kernel(pixel - corner[:, None, None] - window_samples(FIELD, 9.0, pad)) * FIELD.light_step
    expected = row @ light @ column.T
    F, zero = mi.Float64, mi.Float64(0.0)
    lanes = WaveLanes(F(phase), F(fx), F(fy), F(amplitude))
    found = summed_waves(F, [window], lanes, F(1.0), (zero, zero), F(1.0)).numpy().reshape(9, 9)
    disk = np.hypot(np.arange(9) - 4.0, (np.arange(9) - 4.0)[:, None]) <= 4.0
    np.testing.assert_allclose(found, expected * disk, atol=3e-6 * expected.max())
