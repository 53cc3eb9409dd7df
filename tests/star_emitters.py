"""Films and star fields as Mitsuba's dictionaries."""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike


def film(width: int, height: int) -> dict[str, Any]:
    """A film of one channel whose pixels are boxes."""
    size = {"width": width, "height": height, "rfilter": {"type": "box"}}
    return {"type": "hdrfilm", "pixel_format": "luminance", "component_format": "float32"} | size


def star_emitter(
    direction: ArrayLike, wavelength_nm: ArrayLike, photon_rate: ArrayLike, **properties: Any
) -> dict[str, Any]:
    """Stars (n, 3) with rates (n, b, m) at wavelengths (b, m)."""
    import mitsuba as mi

    tensors = {"direction": direction, "wavelength_nm": wavelength_nm, "photon_rate": photon_rate}
    loaded = {name: mi.TensorXf64(np.asarray(values, float)[None]) for name, values in tensors.items()}
    return {"type": "star_field"} | loaded | properties
