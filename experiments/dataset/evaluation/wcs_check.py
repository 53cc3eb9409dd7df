"""Whether astropy lands on the stars: header of a written frame, directions of its truth, pixels of its truth."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import numpy as np

from experiments.dataset.truth.star_truth import FLAGS
from optics.arrays import FloatArray
from optics.frames import pixel_from_fits

__all__ = ["wcs_misses_px"]


def wcs_misses_px(path: str | Path, truth: dict[str, Any], *, width_px: int, height_px: int) -> FloatArray:
    """Distances (n,) [px] between where astropy's WCS of a file puts stars and their chief rays."""
    from astropy.io import fits
    from astropy.wcs import WCS, FITSFixedWarning

    with fits.open(path) as content, warnings.catch_warnings():
        warnings.simplefilter("ignore", FITSFixedWarning)
        image = next(hdu for hdu in content if hdu.header.get("NAXIS", 0) == 2 or hdu.header.get("ZNAXIS", 0) == 2)
        wcs = WCS(image.header)
        x, y = np.asarray(truth["chief_x_px"]), np.asarray(truth["chief_y_px"])
        inside = (x >= -0.5) & (x <= width_px - 0.5) & (y >= -0.5) & (y <= height_px - 0.5)
        inside &= (np.asarray(truth["flags"]) & FLAGS["no_light"][0]) == 0
        if not inside.any():
            return np.zeros(0)
        ra, dec = np.asarray(truth["ra_deg"])[inside], np.asarray(truth["dec_deg"])[inside]
        at = np.column_stack(pixel_from_fits(*wcs.all_world2pix(ra, dec, 1, tolerance=1e-6)))
    return np.asarray(np.hypot(at[:, 0] - x[inside], at[:, 1] - y[inside]))
