"""Star images from closed forms, independent of the models under test."""

from collections.abc import Callable

import calibration_scene
import numpy as np
import pytest
from scipy.special import erf

from calib.records import NoiseModel, Stamps
from render.records import EffectivePsf

SIZE = 11


def pixel_gaussian(x, y, sigma_px, height=SIZE, width=SIZE):
    """Unit Gaussian stars integrated over pixels by differences of the error function, (n, height, width)."""

    def along(centre, size):
        low = (np.arange(size)[None, :] - 0.5 - np.asarray(centre)[:, None]) / (np.sqrt(2) * sigma_px)
        high = (np.arange(size)[None, :] + 0.5 - np.asarray(centre)[:, None]) / (np.sqrt(2) * sigma_px)
        return 0.5 * (erf(high) - erf(low))

    return along(y, height)[:, :, None] * along(x, width)[:, None, :]


def gaussian_epsf(sigma_px, oversampling=4, half_px=8):
    """The same star sampled around its centre."""
    offset = np.arange(-half_px * oversampling, half_px * oversampling + 1) / oversampling
    profile = 0.5 * (erf((offset + 0.5) / (np.sqrt(2) * sigma_px)) - erf((offset - 0.5) / (np.sqrt(2) * sigma_px)))
    return EffectivePsf(values=np.outer(profile, profile), oversampling=oversampling)


def stamps_of(electrons, start_x, start_y, background_e=0.0, valid=None, corner=(0, 0)):
    """Stamps with plain masks and flags."""
    electrons = np.asarray(electrons, dtype=float)
    n = len(electrons)
    mask = np.ones(electrons.shape, bool) if valid is None else valid
    return Stamps(
        electrons=np.where(mask, electrons, 0.0),
        valid=mask,
        corner_px=np.tile(np.asarray(corner, dtype=np.int64), (n, 1)),
        background_e=np.full(n, float(background_e)),
        start_px=np.column_stack([start_x, start_y]) + np.asarray(corner, dtype=float),
        flags=np.zeros(n, np.uint32),
        psf_index=np.zeros(n, np.int64),
    )


class Sky:
    """What the tests draw with."""

    size = SIZE
    gaussian: Callable = staticmethod(pixel_gaussian)
    epsf: Callable = staticmethod(gaussian_epsf)
    stamps: Callable = staticmethod(stamps_of)

    @staticmethod
    def noisy(expected_e, read_noise_e, rng):
        """Poisson electrons plus normal read noise."""
        return rng.poisson(expected_e) + rng.normal(0.0, read_noise_e, np.shape(expected_e))


@pytest.fixture(scope="session")
def sky():
    return Sky


@pytest.fixture(scope="session")
def noise():
    return NoiseModel(read_noise_e=5.0)


@pytest.fixture(scope="session")
def scenes():
    """Star lists with known truth."""
    return calibration_scene
