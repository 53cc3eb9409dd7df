"""Truth of a dataset's frame, or any table of positions, as marks of a zoomable page."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from optics.errors import ConfigError
from optics.frame_html import Marks

POSITION_COLUMNS = (("photon_x_px", "photon_y_px"), ("x_px", "y_px"), ("x", "y"), ("xcentroid", "ycentroid"))
BRIGHTNESS_COLUMNS = ("electrons", "flux_e", "flux")
LABELS = {
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


def truth_marks(table: Mapping[str, Any]) -> Marks:
    """Rows of a table of stars, brightest first."""
    arrays = {name: np.asarray(values) for name, values in table.items()}
    position = next((pair for pair in POSITION_COLUMNS if set(pair) <= set(arrays)), None)
    if position is None:
        raise ConfigError(f"table of stars: columns x_px and y_px are needed; it has {', '.join(arrays)}")
    x, y = (arrays[column].astype(np.float64) for column in position)
    light = next((arrays[column].astype(np.float64) for column in BRIGHTNESS_COLUMNS if column in arrays), None)
    order = np.arange(len(x)) if light is None else np.argsort(-light, kind="stable")
    if light is not None:
        order = order[light[order] > 0]
    columns = {label: arrays[column][order] for column, label in LABELS.items() if column in arrays}
    label = [f"{magnitude:.1f}" for magnitude in columns.get("magnitude", ())]
    return Marks(name="true stars", x_px=x[order], y_px=y[order], label=label, columns=columns)
