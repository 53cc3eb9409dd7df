"""Block-arrow normal equations against the same matrix written out."""

from dataclasses import replace

import numpy as np
import pytest

from calib.fitting.block_arrow import ArrowSystem, spectrum


def dense_of(system):
    """The whole matrix and gradient."""
    frames, common, size = system.border.shape
    total = common + frames * size
    matrix = np.zeros((total, total))
    matrix[:common, :common] = system.common
    for k in range(frames):
        place = slice(common + k * size, common + (k + 1) * size)
        matrix[:common, place] = system.border[k]
        matrix[place, :common] = system.border[k].T
        matrix[place, place] = system.block[k]
        if system.coupling is not None and k + 1 < frames:
            after = slice(common + (k + 1) * size, common + (k + 2) * size)
            matrix[place, after] = system.coupling[k]
            matrix[after, place] = system.coupling[k].T
    return matrix, np.concatenate([system.gradient, system.block_gradient.ravel()])


@pytest.fixture(params=[False, True], ids=["independent", "chained"])
def system(request):
    """A positive definite system of 4 common unknowns and 5 frames of 3."""
    rng = np.random.default_rng(4)
    p, f, b = 4, 5, 3
    rows = np.zeros((0, p + f * b))
    for k in range(f):
        block = np.zeros((12, p + f * b))
        block[:, :p] = rng.standard_normal((12, p)) * [1.0, 1e3, 1e-4, 1.0]
        block[:, p + k * b : p + (k + 1) * b] = rng.standard_normal((12, b))
        if request.param and k + 1 < f:
            block[:6, p + (k + 1) * b : p + (k + 2) * b] = rng.standard_normal((6, b))
        rows = np.vstack([rows, block])
    matrix, gradient = rows.T @ rows, rng.standard_normal(p + f * b)
    cut = [slice(p + k * b, p + (k + 1) * b) for k in range(f)]
    return ArrowSystem(
        common=matrix[:p, :p],
        gradient=gradient[:p],
        border=np.array([matrix[:p, c] for c in cut]),
        block=np.array([matrix[c, c] for c in cut]),
        block_gradient=gradient[p:].reshape(f, b),
        coupling=np.array([matrix[cut[k], cut[k + 1]] for k in range(f - 1)]) if request.param else None,
    )


@pytest.mark.parametrize("damping", [0.0, 0.3])
def test_step_solves_the_whole_system(system, damping):
    matrix, gradient = dense_of(system)
    common_scale, block_scale = system.diagonal()
    scale = np.concatenate([common_scale, block_scale.ravel()])
    step = system.step(damping, common_scale, block_scale)
    expected = -np.linalg.solve(matrix + damping * np.diag(scale), gradient)
    np.testing.assert_allclose(step.common, expected[:4], rtol=1e-9)
    np.testing.assert_allclose(step.block.ravel(), expected[4:], rtol=1e-9)
    curvature = expected @ matrix @ expected
    assert step.length == pytest.approx(np.sqrt(curvature), rel=1e-9)
    assert step.decrease == pytest.approx(-2 * gradient @ expected - curvature, rel=1e-9)


def test_reduced_information_is_the_inverse_of_the_covariance(system):
    matrix, _ = dense_of(system)
    reduced = system.reduce()
    inverse = np.linalg.inv(matrix)
    expected = np.linalg.inv(inverse[:4, :4])
    scale = np.sqrt(np.outer(np.diagonal(expected), np.diagonal(expected)))
    np.testing.assert_allclose(reduced.information / scale, expected / scale, atol=1e-9)


def test_frames_without_stars_do_no_harm(system):
    def padded(blocks):
        return None if blocks is None else np.concatenate([blocks, np.zeros((1, *blocks.shape[1:]))])

    names = ("border", "block", "block_gradient", "coupling")
    more = replace(system, **{name: padded(getattr(system, name)) for name in names})
    np.testing.assert_allclose(more.reduce().information, system.reduce().information, rtol=1e-10)


def test_spectrum_tells_what_is_not_determined():
    rows = np.random.default_rng(0).standard_normal((20, 3))
    rows[:, 2] = rows[:, 0] - 2.0 * rows[:, 1]
    reduced = ArrowSystem(common=rows.T @ rows, gradient=np.zeros(3)).reduce()
    _, vector, known = spectrum(reduced)
    assert known.tolist() == [False, True, True]
    lost = vector[:, 0] / reduced.scale
    np.testing.assert_allclose(lost / lost[2], [-1.0, 2.0, 1.0], rtol=1e-6)
