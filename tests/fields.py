"""Made-up catalogues and fields of stars."""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from render import StarCatalog, StarField


def star_catalog(count: int = 5, seed: int = 2, **changes: Any) -> StarCatalog:
    """Stars all over the sky, of magnitude 0 to 10."""
    rng = np.random.default_rng(seed)
    v = rng.normal(size=(count, 3))
    fields = {
        "name": "random",
        "source": "made up",
        "epoch_year": 2016.0,
        "magnitude_system": "G",
        "id": np.arange(count),
        "direction": v / np.linalg.norm(v, axis=1)[:, None],
        "magnitude": rng.uniform(0, 10, count),
    }
    return StarCatalog(**fields | changes)


def star_field(direction: ArrayLike, wavelength_nm: ArrayLike, rate: ArrayLike = 1.0) -> StarField:
    """Stars (n, 3) of one band, whose nodes have the rates [photons/s/mm^2]."""
    directions, waves = np.atleast_2d(direction), np.atleast_2d(np.asarray(wavelength_nm, float))
    rates = np.broadcast_to(np.asarray(rate, float), (len(directions), *waves.shape))
    return StarField(direction=directions, wavelength_nm=waves, photon_rate=rates, band=("b",))
