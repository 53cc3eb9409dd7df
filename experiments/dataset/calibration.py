"""Calibration products of the detector: masters of a few frames, each with its own noise.

``calibration/``: ``bias`` (shortest exposure, no light), ``dark`` (the exposure and temperature of the frames),
``flat`` (uniform light, over its median), ``gain_map`` (photon transfer in blocks), each a float32 image with its
standard error as extension ``ERR``; and ``defect_map``, the detector's own list.
"""

from __future__ import annotations

import io
import warnings
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from astropy.io import fits
from astropy.io.fits.verify import VerifyWarning
from numpy.typing import NDArray

from calib.detector.mean_frame import MeanFrame, mean_frame
from calib.detector.photon_transfer import block_gain
from experiments.dataset.folder import storage_error, write_whole
from experiments.dataset.frame import instrument_cards
from experiments.laboratory.bench.readout.frames import empty_frame

if TYPE_CHECKING:
    from experiments.dataset.scene import DatasetScene


FOLDER = "calibration"
SHORTEST_S = 1e-6
FLAT_FRACTION = 0.5
"""Of the range to saturation."""
BLOCK_PX = 32
"""A pixel's own gain from 20 frames would be known to a third; that of a block of this side [px] to 1 %."""


def write_calibration(scene: DatasetScene, folder: Path, frames: int, done: Callable[[], None]) -> str:
    """Write the products of a dataset."""
    from render.detector.maps import sensor_maps

    config, chip = scene.config.instrument, scene.instrument.detector
    root = folder / FOLDER
    try:
        root.mkdir(exist_ok=True)
    except OSError as error:
        raise storage_error(root, error) from None
    span_e = chip.saturation_e
    bias = _master(scene, "bias", frames, 0.0, SHORTEST_S)
    done()
    dark = _master(scene, "dark", frames, 0.0, config.exposure_s)
    done()
    light = _master(scene, "flat", frames, FLAT_FRACTION * span_e, config.exposure_s)
    signal, signal_error = light.mean_dn - dark.mean_dn, np.hypot(light.error_dn, dark.error_dn)
    level = float(np.median(signal))
    gain, gain_error = block_gain(light, dark, block_px=BLOCK_PX)
    for name, image, noise, unit in (
        ("bias", bias.mean_dn, bias.error_dn, "adu"),
        ("dark", dark.mean_dn, dark.error_dn, "adu"),
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


def _master(scene: DatasetScene, name: str, frames: int, electrons: float, exposure_s: float) -> MeanFrame:
    instrument = replace(scene.instrument, config=scene.instrument.config.model_copy(update={"exposure_s": exposure_s}))
    streams, label = scene.plan.streams.child("calibration").child(name), scene.light.band[0]
    return mean_frame(
        empty_frame(instrument, frame, streams=streams, label=label, flat_e=electrons).dn for frame in range(frames)
    )


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
