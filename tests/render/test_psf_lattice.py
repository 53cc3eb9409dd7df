"""PSFs on a grid over the detector: the nearest, and those between the nodes."""

from __future__ import annotations

import numpy as np

from render.psf_lattice import refined
from render.records import EffectivePsf, PsfGrid


def test_the_nearest_psf_of_a_grid():
    place = np.array([[10.0, 10.0], [50.0, 10.0], [10.0, 40.0]])
    psf = EffectivePsf(values=np.ones((9, 9)), oversampling=2)
    grid = PsfGrid(psfs=(psf,) * 3, place_px=place)
    assert grid.nearest(np.array([12.0, 31.0, 9.0, 60.0]), np.array([9.0, 10.0, 26.0, 0.0])).tolist() == [0, 1, 2, 1]


def test_a_refined_grid_of_psfs_is_linear_between_its_nodes():
    x, y = np.meshgrid([0.0, 10.0, 20.0], [0.0, 8.0])
    shape = np.arange(81.0).reshape(9, 9) + 1.0
    psfs = tuple(
        EffectivePsf(values=(1.0 + a + 3.0 * b) * shape, oversampling=4) for a, b in zip(x.flat, y.flat, strict=True)
    )
    found = refined(PsfGrid(psfs=psfs, place_px=np.column_stack([x.ravel(), y.ravel()])), 4)
    assert len(found.psfs) == 9 * 5
    for psf, (a, b) in zip(found.psfs, found.place_px, strict=True):
        np.testing.assert_allclose(psf.values, (1.0 + a + 3.0 * b) * shape)
    assert {tuple(one) for one in found.place_px} >= {(2.5, 2.0), (20.0, 8.0), (17.5, 6.0)}
