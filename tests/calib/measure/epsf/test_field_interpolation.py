"""PSFs between their nodes: interpolation exact for a quadratic, its error of third order."""

import numpy as np
import pytest
from star_images import stamps_of

from calib.measure.epsf.field_interpolation import PsfBank
from calib.records import NoiseModel
from render.records import EffectivePsf


def gaussian_bank(size=600, nodes=5, half=9, oversampling=4):
    """PSFs whose width grows and whose centre wanders across the field, quadratically."""
    offset = np.arange(-half * oversampling, half * oversampling + 1) / oversampling
    at = np.linspace(0, 1, nodes)
    psfs = []
    for v in at:
        for u in at:
            x, y = np.meshgrid(offset - shift(u, v)[0], offset - shift(u, v)[1])
            sigma = 0.8 + 0.1 * u * v
            psfs.append(EffectivePsf(values=np.exp(-(x**2 + y**2) / (2 * sigma**2)), oversampling=oversampling))
    return PsfBank(tuple(psfs), nodes, nodes, (size, size))


def shift(u, v):
    """Where the light of a star is, against its nominal place: what the origin of a PSF knows."""
    return 0.2 * u * u - 0.1 * v, 0.15 * u * v


def test_psf_between_its_nodes():
    """Stars drawn with the shape and offset of their own place, without noise, are found at their nominal place."""
    bank, rng = gaussian_bank(), np.random.default_rng(2)
    count, window = 40, 15
    true = rng.uniform(30, 570, (count, 2))
    u, v = (true.T + 0.5) / 600
    light = true + np.stack(shift(u, v), axis=1)
    corner = np.rint(true).astype(np.int64) - window // 2
    grid = np.arange(window)
    x = (corner[:, 0, None] + grid)[:, None, :] - light[:, 0, None, None]
    y = (corner[:, 1, None] + grid)[:, :, None] - light[:, 1, None, None]
    sigma = (0.8 + 0.1 * u * v)[:, None, None]
    start = (true - corner + rng.normal(0, 0.2, true.shape)).T
    stamps = stamps_of(1e5 * np.exp(-(x**2 + y**2) / (2 * sigma**2)), *start, corner=corner)
    error = bank.measure(stamps, NoiseModel(read_noise_e=1.0)).pixel_px - true
    # centres are quadratic in the field and interpolated as such; widths act on symmetric stars in second order only
    assert np.abs(error).max() < 1e-3
    nearest = np.abs(np.stack(shift(u, v), axis=1)).max()
    assert nearest > 0.05  # what a PSF of another place would cost


def test_weights_of_the_nodes_reproduce_a_quadratic():
    bank, rng = gaussian_bank(nodes=6), np.random.default_rng(3)
    x, y = rng.uniform(-0.5, 599.5, (2, 200))
    index, weight = bank.neighbours(x, y)
    assert weight.sum(1) == pytest.approx(np.ones(200))
    assert np.all(weight[:, 0] == weight.max(1))
    row, column = np.divmod(index, 6)
    u, v = (x + 0.5) / 600 * 5, (y + 0.5) / 600 * 5
    assert (weight * (column**2 - 3 * column * row)).sum(1) == pytest.approx(u**2 - 3 * u * v, abs=1e-9)


def test_the_error_of_a_bank_is_that_of_a_third_order():
    """Spots that move by a c^3 from node to node: nodes two apart miss the next one by 3 a, nodes one apart an 8th."""
    place, step, nodes = np.arange(-24, 25) / 4.0, 1e-4, 7
    spots = [np.exp(-((place - step * node**3) ** 2) / 2.0) for node in range(nodes)]
    rows = tuple(EffectivePsf(values=np.exp(-(place[:, None] ** 2) / 2.0) * one, oversampling=4) for one in spots)
    error = PsfBank(rows * 3, nodes, 3, (700, 300)).error_px()
    assert error == pytest.approx(3.0 * step / 8.0 / np.sqrt(2.0), rel=0.02)  # along columns alone
