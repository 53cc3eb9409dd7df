"""Truth of a dataset's frame, or any table of places, as marks of a page to zoom into."""

from __future__ import annotations

from typing import Any

import numpy as np

from optics.errors import ConfigError
from optics.frame_page import Marks

__all__ = ["truth_marks"]

PLACES = (("photon_x_px", "photon_y_px"), ("x_px", "y_px"), ("x", "y"), ("xcentroid", "ycentroid"))
BRIGHTNESS = ("electrons", "flux_e", "flux")
SHOWN = {
    "star_id": "star",
    "id": "star",
    "magnitude": "magnitude",
    "temperature_k": "temperature [K]",
    "electrons": "light [e-]",
    "flux_e": "light [e-]",
    "flux": "light",
    "snr": "signal to noise",
    "ra_deg": "right ascension [deg]",
    "dec_deg": "declination [deg]",
    "flags": "flags",
}


def truth_marks(table: Any, name: str = "true stars") -> Marks:
    """Rows of a table of stars, brightest first.

    Parameters
    ----------
    table : astropy.table.Table
        With columns ``photon_x_px, photon_y_px`` as the truth of a dataset, or ``x_px, y_px``.
    name : str
        Of the layer.

    Raises
    ------
    ConfigError
        No columns of places.
    """
    found = next((pair for pair in PLACES if set(pair) <= set(table.colnames)), None)
    if found is None:
        raise ConfigError(f"table of stars: columns x_px and y_px are needed; it has {', '.join(table.colnames)}")
    x, y = (np.asarray(table[column], np.float64) for column in found)
    light = next((np.asarray(table[one], np.float64) for one in BRIGHTNESS if one in table.colnames), None)
    order = np.arange(len(table)) if light is None else np.argsort(-light, kind="stable")
    if light is not None:
        order = order[light[order] > 0]
    columns = {shown: np.asarray(table[column])[order] for column, shown in SHOWN.items() if column in table.colnames}
    magnitude = columns.get("magnitude", ())
    return Marks(name=name, x_px=x[order], y_px=y[order], label=[f"{one:.1f}" for one in magnitude], columns=columns)
