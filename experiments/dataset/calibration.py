"""Calibration products of the detector: masters of a few frames, each with its own noise.

``calibration/``: ``bias`` (shortest exposure, no light), ``dark`` (the exposure and temperature of the frames),
``flat`` (uniform light, over its median), ``gain_map`` (photon transfer in blocks), each a float32 image with its
standard error as extension ``ERR``; and ``defect_map``, the detector's own list.
"""

from __future__ import annotations

import io
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from astropy.io import fits
from astropy.io.fits.verify import VerifyWarning
from numpy.typing import NDArray

from experiments.dataset.folder import storage_error, write_whole
from experiments.dataset.frame import instrument_cards

if TYPE_CHECKING:
    from experiments.dataset.scene import Scene


FOLDER = "calibration"
SHORTEST_S = 1e-6
FLAT_FRACTION = 0.5
"""Of the range to saturation."""
BLOCK_PX = 32
"""A pixel's own gain from 20 frames would be known to a third; that of a block of this side [px] to 1 %."""


@dataclass(frozen=True, slots=True)
class _Master:
    """Mean [DN], variance of a frame [DN^2], number of frames."""

    mean: NDArray[np.float64]
    variance: NDArray[np.float64]
    frames: int

    @property
    def error(self) -> NDArray[np.float64]:
        """Standard error of the mean."""
        return np.sqrt(self.variance / self.frames)


def write_calibration(scene: Scene, folder: Path, frames: int, done: Callable[[], None]) -> str:
    """Write the products of a dataset."""
    from render.detector.maps import sensor_maps

    config, chip = scene.config.instrument, scene.instrument.detector
    root = folder / FOLDER
    try:
        root.mkdir(exist_ok=True)
    except OSError as error:
        raise storage_error(root, error) from None
    span_e = min(chip.full_well_e, (chip.largest_dn - chip.offset_dn) / chip.gain_dn_per_e)
    bias = _master(scene, "bias", frames, 0.0, SHORTEST_S)
    done()
    dark = _master(scene, "dark", frames, 0.0, config.exposure_s)
    done()
    light = _master(scene, "flat", frames, FLAT_FRACTION * span_e, config.exposure_s)
    signal, signal_error = light.mean - dark.mean, np.hypot(light.error, dark.error)
    level = float(np.median(signal))
    gain, gain_error = _photon_transfer(light, dark)
    for name, image, noise, unit in (
        ("bias", bias.mean, bias.error, "adu"),
        ("dark", dark.mean, dark.error, "adu"),
        ("flat", signal / level, signal_error / level, ""),
        ("gain_map", gain, gain_error, "adu/electron"),
    ):
        seconds = SHORTEST_S if name == "bias" else config.exposure_s
        cards = [("IMAGETYP", name, "calibration product"), ("NCOMBINE", frames, "frames"), ("BUNIT", unit, "")]
        header = fits.Header([*cards, ("EXPTIME", seconds, "[s]"), *instrument_cards(scene.instrument)])
        _write(root / f"{name}.fits", header, image.astype(np.float32), noise.astype(np.float32))
    cards = [("IMAGETYP", "defect_map", "1: hot, dead, or in a gap"), *instrument_cards(scene.instrument)]
    _write(root / "defect_map.fits", fits.Header(cards), sensor_maps(chip).defect.astype(np.uint8), None)
    done()
    return f"bias, dark, flat, gain map and defect map of {frames} frames each, with their standard errors"


def _master(scene: Scene, name: str, frames: int, electrons: float, exposure_s: float) -> _Master:
    from render.detector.readout import expose

    chip = scene.instrument.detector
    image = np.full(chip.shape, electrons, np.float32)
    streams = scene.plan.streams.child("calibration").child(name)
    total, square = np.zeros(chip.shape), np.zeros(chip.shape)
    for frame in range(frames):
        read = expose(
            image,
            chip,
            streams=streams,
            frame=frame,
            exposure_s=exposure_s,
            temperature_c=scene.config.instrument.chip_temperature_c,
            band=scene.light.band[0],
        )
        dn = read.dn - chip.offset_dn  # near zero, so that squares keep their digits
        total += dn
        square += dn * dn
    mean = total / frames
    return _Master(chip.offset_dn + mean, (square - frames * mean * mean) / (frames - 1), frames)


def _photon_transfer(light: _Master, dark: _Master) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Gain K [DN/e-] in blocks, variance over mean (EMVA 1288 4.0, sec. 6.6), and its standard error.

    The variance of n frames is uncertain by sqrt(2 / (n - 1)) of itself; the error of the mean is negligible.
    """
    shape = light.mean.shape
    edges = [np.arange(0, size, BLOCK_PX) for size in shape]

    def blocks(values: NDArray[Any]) -> NDArray[np.float64]:
        return np.add.reduceat(np.add.reduceat(values, edges[0], axis=0), edges[1], axis=1, dtype=np.float64)

    pixels = blocks(np.ones(shape))
    gain = blocks(light.variance - dark.variance) / np.maximum(blocks(light.mean - dark.mean), 1e-9)
    error = gain * np.sqrt(2.0 / ((light.frames - 1) * pixels))

    def spread(values: NDArray[np.float64]) -> NDArray[np.float64]:
        whole = np.repeat(np.repeat(values, BLOCK_PX, axis=0), BLOCK_PX, axis=1)
        return whole[: shape[0], : shape[1]]

    return spread(gain), spread(error)


def _write(path: Path, header: fits.Header, image: NDArray[Any], error: NDArray[Any] | None) -> None:
    units = [fits.PrimaryHDU(image, header)]
    if error is not None:
        beside = fits.Header([("EXTNAME", "ERR", "standard error"), ("BUNIT", header["BUNIT"], "")])
        units.append(fits.ImageHDU(error, beside))
    write_whole(path, fits_bytes(units))


def fits_bytes(units: list[Any]) -> bytes:
    """FITS file of header units, with checksums; the same input gives the same bytes."""
    content, held = fits.HDUList(units), io.BytesIO()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", VerifyWarning)  # comments behind long names are cut off
        content.update_extend()
        for one in content:
            one.add_checksum(when=" ")  # no time in it: the same dataset has the same bytes
        content.writeto(held)
    return held.getvalue()
