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
"""Level of the flat over the saturation."""
BLOCK_PX = 32
"""Side of a gain block: from 20 frames, the gain of a block has an error of 1 %, that of a pixel of a third."""


def write_calibration(scene: DatasetScene, folder: Path, frames: int, done: Callable[[], None]) -> str:
    """Write the products of a dataset."""
    from render.detector.maps import sensor_maps

    config, chip = scene.config.instrument, scene.instrument.detector
    root = folder / FOLDER
    try:
        root.mkdir(exist_ok=True)
    except OSError as error:
        raise storage_error(root, error) from None
    bias = _master(scene, "bias", frames, 0.0, SHORTEST_S)
    done()
    dark = _master(scene, "dark", frames, 0.0, config.exposure_s)
    done()
    flat = _master(scene, "flat", frames, FLAT_FRACTION * chip.saturation_e, config.exposure_s)
    signal, signal_error = flat.mean_dn - dark.mean_dn, np.hypot(flat.error_dn, dark.error_dn)
    level = float(np.median(signal))
    gain, gain_error = block_gain(flat, dark, block_px=BLOCK_PX)
    for name, image, noise, unit in (
        ("bias", bias.mean_dn, bias.error_dn, "adu"),
        ("dark", dark.mean_dn, dark.error_dn, "adu"),
        ("flat", signal / level, signal_error / level, ""),
        ("gain_map", gain, gain_error, "adu/electron"),
    ):
        seconds = SHORTEST_S if name == "bias" else config.exposure_s
        cards = [("IMAGETYP", name, "calibration product"), ("NCOMBINE", frames, "frames"), ("BUNIT", unit, "")]
        header = fits.Header([*cards, ("EXPTIME", seconds, "[s]"), *instrument_cards(scene.instrument)])
        extension = fits.Header([("EXTNAME", "ERR", "standard error"), ("BUNIT", unit, "")])
        units = [fits.PrimaryHDU(image.astype(np.float32), header), fits.ImageHDU(noise.astype(np.float32), extension)]
        write_whole(root / f"{name}.fits", fits_bytes(units))
    cards = [("IMAGETYP", "defect_map", "1: hot, dead, or in a gap"), *instrument_cards(scene.instrument)]
    defect = fits.PrimaryHDU(sensor_maps(chip).defect.astype(np.uint8), fits.Header(cards))
    write_whole(root / "defect_map.fits", fits_bytes([defect]))
    done()
    return f"bias, dark, flat, gain map and defect map of {frames} frames each, with their standard errors"


def _master(scene: DatasetScene, name: str, frames: int, electrons: float, exposure_s: float) -> MeanFrame:
    instrument = replace(scene.instrument, config=scene.instrument.config.model_copy(update={"exposure_s": exposure_s}))
    streams, label = scene.plan.streams.child("calibration").child(name), scene.light.band[0]
    return mean_frame(
        empty_frame(instrument, frame, streams=streams, label=label, flat_e=electrons).dn for frame in range(frames)
    )


def fits_bytes(units: list[Any]) -> bytes:
    """FITS file of header units, with checksums; the same input gives the same bytes."""
    content, stream = fits.HDUList(units), io.BytesIO()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", VerifyWarning)  # comments behind long names are cut off
        content.update_extend()
        for unit in content:
            unit.add_checksum(when=" ")  # without a time, which would change the bytes
        content.writeto(stream)
    return stream.getvalue()
