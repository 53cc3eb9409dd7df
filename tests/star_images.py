"""Star images from closed forms, independent of the models under test."""

import numpy as np
from scipy.special import erf

from calib.records import NoiseModel, SensorImage, Stamps
from render.records import EffectivePsf, Frame

SIZE = 11
NOISE = NoiseModel(read_noise_e=5.0)


def gaussian_stars(x, y, sigma_px, height=SIZE, width=SIZE):
    """Unit Gaussian stars (n,) integrated over pixels by differences of the error function, (n, height, width)."""

    def along(centre, size):
        edge = np.arange(size + 1) - 0.5 - np.asarray(centre)[:, None]
        return 0.5 * np.diff(erf(edge / (np.sqrt(2) * sigma_px)))

    return along(y, height)[:, :, None] * along(x, width)[:, None, :]


def star_field(x, y, flux_e, sigma_px, shape):
    """Expected electrons of stars (n,) in an image of a shape (h, w), without background."""
    flux = np.broadcast_to(flux_e, len(x))
    return np.tensordot(flux, gaussian_stars(x, y, sigma_px, *shape), axes=1)


def gaussian_epsf(sigma_px, oversampling=4, half_px=8):
    """The same star sampled around its centre."""
    offset = np.arange(-half_px * oversampling, half_px * oversampling + 1) / oversampling
    profile = 0.5 * (erf((offset + 0.5) / (np.sqrt(2) * sigma_px)) - erf((offset - 0.5) / (np.sqrt(2) * sigma_px)))
    return EffectivePsf(values=np.outer(profile, profile), oversampling=oversampling)


def stamps_of(electrons, start_x, start_y, background_e=0.0, valid=None, corner=(0, 0)):
    """Stamps that start at positions (n,) in windows (n, h, w), whose first pixel is ``corner``, () or (n, 2)."""
    electrons = np.asarray(electrons, dtype=float)
    n = len(electrons)
    mask = np.ones(electrons.shape, bool) if valid is None else valid
    return Stamps(
        electrons=np.where(mask, electrons, 0.0),
        valid=mask,
        corner_px=np.broadcast_to(corner, (n, 2)),
        background_e=np.full(n, float(background_e)),
        start_px=np.column_stack([start_x, start_y]) + np.asarray(corner, dtype=float),
        flags=np.zeros(n, np.uint32),
        psf_index=np.zeros(n, np.int64),
    )


def noisy(expected_e, read_noise_e, rng):
    """Poisson electrons plus normal read noise."""
    return rng.poisson(expected_e) + rng.normal(0.0, read_noise_e, np.shape(expected_e))


def image_of(dn, noise=NOISE, valid=None, saturated=None):
    """An image (h, w); pixels that are not finite are not valid."""
    return SensorImage(
        dn=np.nan_to_num(dn),
        valid=np.isfinite(dn) if valid is None else valid,
        saturated=np.zeros(dn.shape, bool) if saturated is None else saturated,
        noise=noise,
        source="drawn",
    )


def frame_of(dn, defect=None, **noise):
    """A frame without saturated pixels; its noise model by keywords."""
    nothing = np.zeros(dn.shape, bool)
    given = {"dn": dn, "saturated": nothing, "defect": nothing if defect is None else defect}
    return Frame(**given, exposure_s=0.1, band="open", index=0, **noise)


def sampled_stars(draw, rng, count, background_e, read_noise_e=5.0):
    """Columns and rows (n,) at random phases of the middle pixel, and noisy stamps of the light ``draw(x, y)``.
    Starts are off by 0.1 px (RMS)."""
    x, y = SIZE // 2 + rng.uniform(-0.5, 0.5, (2, count))
    electrons = noisy(draw(x, y) + background_e, read_noise_e, rng)
    start_x, start_y = np.stack([x, y]) + rng.normal(0.0, 0.1, (2, count))
    return x, y, stamps_of(electrons, start_x, start_y, background_e=background_e)
