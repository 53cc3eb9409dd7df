"""Frames of a laboratory's target as NumPy draws them: Gaussian spots, photon and read noise, a folder's settings."""

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from astropy.io import fits

GAIN, OFFSET, READ = 0.25, 60.0, 12.0  # DN/e-, DN, e-
HEAD = f"gain_dn_per_e = {GAIN}\noffset_dn = {OFFSET}\nread_noise_e = {READ}\npixel_arcsec = 5.5\n"


def spots(shape: tuple[int, int], places_px: Iterable[Any], electrons: float, sigma_px: float = 1.0) -> Any:
    """Light [e-] of spots at (column, row), sampled at pixel centres."""
    row, column = np.indices(shape)
    light = np.zeros(shape)
    for x, y in places_px:
        light += np.exp(-((column - x) ** 2 + (row - y) ** 2) / (2 * sigma_px**2))
    return electrons / (2 * np.pi * sigma_px**2) * light


def readout(
    light_e: Any,
    rng: np.random.Generator,
    *,
    gain: float = GAIN,
    offset: float = OFFSET,
    read: float = READ,
    top: int = 65535,
    step: int = 1,
) -> Any:
    """Digital numbers in steps, up to the highest reading."""
    electrons = rng.poisson(light_e) + rng.normal(0.0, read, np.shape(light_e))
    return (np.rint((offset + gain * electrons) / step) * step).clip(0, top).astype(np.uint16)


def write(path: Path, dn: Any, **cards: Any) -> None:
    fits.PrimaryHDU(np.asarray(dn), fits.Header(list(cards.items()))).writeto(path)
