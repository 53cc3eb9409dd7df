"""Effects of the collimator's errors on the document's numbers: in closed form, and as measured on frames.

The closed forms share no equation with the rendered light (`experiments.laboratory.devices.collimator`):

* a thin prism turns light by (n - 1) times the angle between its faces, n the maker's index;
* air of a gradient dT/dx bends it over the path L by L (n - 1) / T dT/dx (Gladstone-Dale, ideal gas);
* a target that is p behind the focus F has the vergence -p / F^2: seen at a distance d from the axis of the beam it is
  displaced by p d / F^2, and the focus of a camera of focal length f moves by f^2 p / F^2;
* a disk of the radius R adds R^2 / 4 to the variance of the image along an axis;
* the mean over the exposure T of a vibration at f keeps the part sinc(f T)^2 of its power (`Collimator.power_arcsec2`).

All but the blur by vergence is constant over the field, where the lateral colour of a centred lens is odd: eq. 16
contains the full half difference of two filters.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from calib.accuracy.chromatic import shifts, table1
from experiments.harness.quantities import Quantities
from experiments.harness.sections import Section, agree, col, ratio_near
from experiments.harness.summary import Measured, measured
from experiments.laboratory.bench.point_bench import Bench
from experiments.laboratory.bench.ray_prediction import ORDER, bundle_prediction, node_weights, spots_of
from experiments.laboratory.settings.collimator import FilteredCollimatorConfig
from optics.arrays import FloatArray
from optics.frames import field_angles_deg
from optics.glass.air import air_index
from optics.glass.catalogue import get_glass
from optics.rays.spots import SpotMoments, spot_moments
from optics.units import ARCSEC_RAD, DEG_RAD, UM_MM
from render.sensor_file.instrument import Instrument

PARTS = {"wedge": "wedge", "air": "air", "decollimation": "decollimation"}
"""Causes of an image shift that depends on the wavelength."""
KELVIN = 273.15  # 0 C
MOTION_RATIO = 0.01
"""Relative error of a line-of-sight motion in addition to noise, for some sixty rays of each bundle."""
SPOT_RATIO = 0.03
"""Largest relative error of the radius of a spot by a paraxial change of focus."""
FIELD_RATIO = 0.03
"""Change of the image scale over the field, by distortion and the slope of its plane."""


def closed_form_shift_px(bench: Bench, instrument: Instrument) -> dict[str, FloatArray]:
    """Shift of the image (b, 2) [px] behind every filter by each of `PARTS`."""
    collimator, camera = bench.collimator, instrument.camera
    shift_px = dict.fromkeys(PARTS, np.zeros((len(bench.filters), 2)))
    if collimator is None:
        return shift_px
    config, f = collimator.config, collimator.config.focal_length_mm
    wavelength, weight = node_weights(bench, instrument)
    px_per_rad = instrument.focal_length_mm / camera.pixel_pitch_mm
    if isinstance(config, FilteredCollimatorConfig):
        n_minus_one = (weight * (get_glass(config.wedge_glass).index(wavelength) - 1.0)).sum(1)
        wedge_arcsec, azimuth_deg = np.array([collimator.wedge.get(band.name, (0.0, 0.0)) for band in bench.filters]).T
        deviation_rad = collimator.wedge_lever * n_minus_one * wedge_arcsec * ARCSEC_RAD
        direction = np.stack([np.cos(azimuth_deg * DEG_RAD), np.sin(azimuth_deg * DEG_RAD)], axis=1)
        shift_px["wedge"] = px_per_rad * deviation_rad[:, None] * direction
    air = camera.lens.environment
    if any(config.air_gradient_k_per_m):
        n_minus_one = (weight * (air_index(wavelength, air.temperature_c, air.pressure_hpa) - 1.0)).sum(1)
        rad_per_gradient = config.air_path_m * n_minus_one / (KELVIN + air.temperature_c)
        shift_px["air"] = px_per_rad * rad_per_gradient[:, None] * np.array(config.air_gradient_k_per_m)
    p_mm = config.decollimation_um * UM_MM - (weight * collimator.focus_mm(wavelength)).sum(1)
    shift_px["decollimation"] = px_per_rad * (p_mm / f**2)[:, None] * np.array(config.offset_mm)
    return shift_px


def closed_form_spot_um(bench: Bench, instrument: Instrument, direction: FloatArray) -> FloatArray:
    """RMS radius (b,) [um] of the spots of points (p, j, 3): the camera refocused for every colour, and the disk."""
    collimator = bench.collimator
    assert collimator is not None
    config, camera = collimator.config, instrument.camera
    wavelength, weight = node_weights(bench, instrument)
    field = field_angles_deg(direction.reshape(-1, 3))
    p_mm = config.decollimation_um * UM_MM - collimator.focus_mm(wavelength).ravel()
    focus_mm = (instrument.focal_length_mm / config.focal_length_mm) ** 2 * p_mm
    spots = [
        spot_moments(replace(camera, defocus_mm=camera.defocus_mm + shift).focused_lens, *field, node_nm, order=ORDER)
        for shift, node_nm in zip(focus_mm, wavelength.ravel(), strict=True)
    ]
    moments = {name: np.concatenate([getattr(spot, name) for spot in spots], axis=1) for name in SpotMoments.__slots__}
    _, radius_px, _ = spots_of(SpotMoments(**moments), weight, instrument, direction.shape[:2])
    disk_px = collimator.source_radius_rad / (instrument.pixel_arcsec * ARCSEC_RAD)
    return np.asarray(np.hypot(radius_px, disk_px / 2.0**0.5).mean((0, 1)) * camera.pixel_pitch_mm / UM_MM)


@dataclass(frozen=True, slots=True, kw_only=True)
class CollimatorShift:
    """Contribution of the collimator to Table 1; the dimensions ``pair``, ``axis`` and ``band`` are those of
    the experiment."""

    closed_form_px: FloatArray = col("Closed form", "px", "+.4f", "part pair axis")
    closed_form_sum_px: FloatArray = col("Together", "px", "+.4f", "pair axis")
    measured_px: Any = col("Measured", "px", dims="pair axis")
    spot_ratio: FloatArray | None = col(
        "Radius of the rendered spots over the closed form", dims="band", shown=False, default=None
    )


def _parts_axis(q: Quantities, _: Any) -> None:
    q.axis("part", list(PARTS), "Part", names=PARTS)


COLLIMATOR = Section(
    record=CollimatorShift,
    axes=_parts_axis,
    table="collimator",
    rows="pair axis",
    across="part",
    caption="Contributions of the collimator to Table 1.",
    note="*Measured*: Table 1 of the frames minus Table 1 traced through the lens alone.",
    verdicts=[
        agree(
            "measured_px",
            "closed_form_sum_px",
            slack=FIELD_RATIO,
            title="collimator in Table 1, measured against (n - 1) wedge, air and decollimation",
        ),
        ratio_near(
            "spot_ratio",
            within=SPOT_RATIO,
            title="radius of rendered spots over its closed form (refocused camera, disk)",
        ),
    ],
)


def collimator_shift(
    bench: Bench,
    instrument: Instrument,
    direction: FloatArray,
    table1_px: FloatArray,
    sigma_px: FloatArray,
    spot_um: FloatArray | None = None,
) -> CollimatorShift | None:
    """Closed forms against measured Table 1 (pair, 2) and spot radii (b,); None for a perfect collimator."""
    if bench.collimator is None:
        return None
    without = shifts(bundle_prediction(replace(bench, collimator=None), instrument, direction), bench.pairs)
    parts = np.array(
        [
            [(shift_px[high] - shift_px[low]) / 2.0 for _, high, low in bench.pairs]
            for shift_px in closed_form_shift_px(bench, instrument).values()
        ]
    )
    difference_px = table1_px - np.array([table1(shift) for shift in without.values()])
    ratio = None if spot_um is None else spot_um / closed_form_spot_um(bench, instrument, direction)
    return CollimatorShift(
        closed_form_px=parts,
        closed_form_sum_px=parts.sum(0),
        measured_px=measured(difference_px, sigma_px),
        spot_ratio=ratio,
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class LineOfSightMotion:
    """Motion of the line of sight in the laboratory, per axis, 3 sigma: closed form, and motion common to the stars."""

    frame_to_frame_arcsec: float = col("Line of sight from frame to frame, predicted", "arcsec", ".3f")
    within_frame_arcsec: float = col("Line of sight within a frame, predicted", "arcsec", ".3f")
    measured_arcsec: Sequence[Measured] = col("Line of sight from frame to frame, measured", "arcsec", dims="axis")
    ratio: Sequence[Measured] = col("Measured / predicted motion of the line of sight", dims="axis")


LINE_OF_SIGHT = Section(record=LineOfSightMotion, verdicts=[ratio_near("ratio", within=MOTION_RATIO)])


def line_of_sight(bench: Bench, instrument: Instrument, motion_px2: FloatArray) -> LineOfSightMotion | None:
    """Motion common to the stars (levels, 2, 2) [px^2] against the integral of the spectrum.

    None for a line of sight at rest, or of a single star.
    """
    between, within = np.sqrt(bench.power_px2(instrument))
    if not between or not np.isfinite(motion_px2).all():
        return None
    variance_px2, star_mean_px2 = motion_px2.mean(0)
    scale, motion_px = 3.0 * instrument.pixel_arcsec, np.sqrt(np.maximum(variance_px2, 0.0))
    # of a standard deviation from so many frames, to which the mean error of the stars adds its variance
    relative = (1.0 + star_mean_px2.mean() / between**2) / np.sqrt(2.0 * bench.frames * len(motion_px2))
    return LineOfSightMotion(
        frame_to_frame_arcsec=float(scale * between),
        within_frame_arcsec=float(scale * within),
        measured_arcsec=measured(scale * motion_px, np.full(2, scale * between * relative)),
        ratio=measured(motion_px / between, np.full(2, relative)),
    )
