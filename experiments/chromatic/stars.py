"""Shift of stars with their colour through the full pass band, against ACC18's rule of one third.

The rule (ACC18 section 1.4.1): sigma of a star's chromatic shift is e_pair / 3, with e_pair the largest entry of Table
1, half the mean shift between two filters.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from experiments.harness.drawings import curves
from experiments.harness.sections import Section, col
from experiments.laboratory.settings.tables import StarsConfig
from optics.arrays import FloatArray
from optics.frames import field_angles_deg
from optics.light.band import Band, band_nodes
from optics.rays.stellar_chromatic_shift import stellar_chromatic_shift_mm
from render.sensor_file.instrument import Instrument

NODES = 48
"""Wavelength nodes over the full pass band."""
PUPIL_SAMPLING = (5, 12)
"""Rings and arms of the pupil quadrature."""


def stellar_shift(config: StarsConfig, band: Band, instrument: Instrument) -> tuple[FloatArray, FloatArray]:
    """Unit vectors (g, 3) of field points in the camera frame, and photocentres (t, g, 2) [px] of stars of every
    temperature minus that of the reference star at the same point; by ray trace."""
    camera = instrument.camera
    fraction = (np.arange(config.grid) + 0.5) / config.grid
    x, y = np.meshgrid(fraction * camera.width_px - 0.5, fraction * camera.height_px - 0.5)
    direction = camera.nominal_direction(x.ravel(), y.ravel(), instrument.focal_length_mm)
    nodes = band_nodes([band], NODES)
    wavelength_nm = nodes.wavelength_nm[0]
    response = nodes.weight_nm[0] * nodes.transmission[0] * camera.response_at(wavelength_nm)
    shift_mm = stellar_chromatic_shift_mm(
        camera.focused_lens,
        *field_angles_deg(direction),
        wavelength_nm=wavelength_nm,
        response=response,
        temperature_k=config.temperatures_k,
        reference_k=config.reference_k,
        order=PUPIL_SAMPLING,
    )
    row_against_y = [1.0, -1.0]  # rows increase against y of the lens
    return direction, shift_mm * row_against_y / camera.pixel_pitch_mm


def max_pairwise_rms_px(shift_px: FloatArray) -> float:
    """Largest RMS distance over the field between two of the stars; it does not depend on the reference star."""
    difference = shift_px[:, None] - shift_px[None]
    return float(np.sqrt((difference**2).sum(-1).mean(-1)).max())


@dataclass(frozen=True, slots=True, kw_only=True)
class StellarShifts:
    """Stars through one lens against the reference star, and ACC18's rule of one third."""

    rms_shift_px: FloatArray = col("RMS over the field", "px", ".4f", "temperature_k")
    mean_shift_length_px: FloatArray = col("Mean over the field", "px", ".4f", "temperature_k")
    max_shift_px: FloatArray = col("Largest in the field", "px", ".4f", "temperature_k")
    mean_shift_px: FloatArray = col("Mean shift", "px", ".4f", "temperature_k component")
    max_pairwise_rms_px: float = col("RMS distance of the two most different stars", "px", ".4f", shown=False)
    # Half the RMS shift between filters over the same field positions, largest pair
    half_filter_shift_px: float = col("Half the RMS shift between filters", "px", ".4f", shown=False)
    one_third_rule_px: float = col("One third rule", "px", ".3f", shown=False)


def stellar_shift_statistics(shift_px: FloatArray, filter_shift_px: Sequence[FloatArray]) -> StellarShifts:
    """Statistics over g field positions of star shifts (t, g, 2), and of the filter shifts (g, 2) of every pair."""
    half_filter_shift_px = max(np.sqrt((pair_shift**2).sum(-1).mean()) for pair_shift in filter_shift_px) / 2.0
    mean_px = shift_px.mean(1)
    return StellarShifts(
        rms_shift_px=np.sqrt((shift_px**2).sum(2).mean(1)),
        mean_shift_length_px=np.hypot(*mean_px.T),
        max_shift_px=np.hypot(*np.moveaxis(shift_px, 2, 0)).max(1),
        mean_shift_px=mean_px,
        max_pairwise_rms_px=max_pairwise_rms_px(shift_px),
        half_filter_shift_px=float(half_filter_shift_px),
        one_third_rule_px=float(half_filter_shift_px) / 3.0,
    )


STARS = Section(
    record=StellarShifts,
    dim="lens",
    table="stars",
    rows="lens temperature_k",
    columns="rms_shift_px mean_shift_length_px max_shift_px",
    caption="Shift of black-body stars against the reference star.",
    figures={
        "star_shifts": curves(
            "temperature_k",
            lines="rms_shift_px mean_shift_length_px max_shift_px",
            panels="lens",
            dashes="one_third_rule_px",
            log="x",
            y="Shift against the reference star",
            aspect_ratio=0.42,
        )
    },
)
