"""Focal length against temperature (LSFE-T), ACC18's second source of LSFE (section 1.1), for which it has no test.

A camera is calibrated at one temperature of lens and housing and used at others. The error is the change of the map
from directions to pixels; the common shift is removed, because the attitude absorbs it. To first order the change is e
= s dT, so that over a field of stars and a temperature of standard deviation sigma_T

    LSFE-T (3 sigma) = RMS over the field of s x 3 sigma_T

with ``thermal.stability_k`` for 3 sigma_T. The prediction traces the warmed and the cooled lens, and is compared with
the paraxial chief ray, which is independent of the trace. The measurement calibrates the camera in a chamber at either
end by a cubic polynomial through centres of gravity of rendered frames, and divides the difference of both calibrations
by the temperature difference of the lens's thermometer. The centre of gravity is used for every main centroider,
because the traced mean predicts it; a fitted PSF follows the core of a defocused spot, which may grow at another rate.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from calib.cameras.field_map import growth_along_axes, smooth_map_rms
from experiments.budget.laboratory import BudgetLaboratory, build_laboratory
from experiments.harness.sections import Section, agree, col
from experiments.harness.summary import Measured, measured
from experiments.laboratory.bench.point_bench import one_filter
from experiments.laboratory.bench.points import nominal_px, point_scene, read_points
from experiments.laboratory.bench.ray_prediction import bundle_prediction
from optics.arrays import FloatArray
from optics.errors import DomainError
from optics.rays.thermal_sensitivity import paraxial_change_per_k
from render.engine.random import Streams

METHOD = "cog"
BRIGHT_E = 6000.0
"""Least electrons per star and frame; below, read noise dominates a centre of gravity."""
GRID = (8, 6)
"""Stars along a row and a column."""
STEP_K = 1.0
"""Of the derivatives of focus and paraxial scale."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ThermalTerm:
    """LSFE-T, 3 sigma, and its contributions."""

    calibrated_at_c: float = col("Calibrated at", "degC", "g")
    stars: int = col("Stars of the thermal test")
    signal_e: float = col("Signal of the thermal test", "e-", ".0f")
    predicted_arcsec: FloatArray = col("LSFE-T, predicted", "arcsec", ".3f", "axis")
    measured_arcsec: Sequence[Measured] = col("LSFE-T, measured", "arcsec", dims="axis")
    total_predicted_arcsec: FloatArray | None = col("Total with it, predicted", "arcsec", ".3f", "axis", default=None)
    total_measured_arcsec: FloatArray | None = col("Total with it, measured", "arcsec", ".3f", "axis", default=None)
    scale_ppm_per_k: FloatArray = col("Scale, traced", "1e-6/K", ".2f", "axis")
    measured_scale_ppm_per_k: Sequence[Measured] = col("Scale, measured", "1e-6/K", dims="axis")
    paraxial_ppm_per_k: float = col("Scale, paraxial", "1e-6/K", ".2f")
    focus_um_per_k: float = col("Focus behind the detector", "um/K", "+.2f")
    outermost_star_px_per_k: float = col("Outermost star", "px/K", ".3f")


def in_chamber(lab: BudgetLaboratory, temperature_c: float) -> BudgetLaboratory:
    """The laboratory with lens and housing at a temperature; everything else unchanged, the focus too."""
    config = lab.config
    instrument = config.instrument.model_copy(update={"lens_temperature_c": temperature_c})
    return build_laboratory(config.model_copy(update={"instrument": instrument}))


def warmed(lab: BudgetLaboratory, kelvin: float) -> BudgetLaboratory:
    """The laboratory with lens and housing warmer than at their calibration."""
    return in_chamber(lab, thermometer_c(lab) + kelvin)


def thermometer_c(lab: BudgetLaboratory) -> float:
    """Temperature of the lens."""
    return lab.instrument.camera.lens.environment.temperature_c


def field_directions(lab: BudgetLaboratory) -> FloatArray:
    """Unit vectors (n, 3) in cam of stars spread evenly over the detector, at all fractions of a pixel."""
    camera = lab.instrument.camera
    columns, rows = GRID
    cell = np.arange(columns * rows)
    fraction = np.modf(np.outer(cell + 1.0, [0.7549, 0.5698]))[0]  # additive recurrence: all differ
    x = (cell % columns + 0.5) * camera.width_px / columns - 0.5 + fraction[:, 0]
    y = (cell // columns + 0.5) * camera.height_px / rows - 0.5 + fraction[:, 1]
    return camera.nominal_direction(x, y, lab.instrument.focal_length_mm)


def thermal_term(lab: BudgetLaboratory, streams: Streams) -> ThermalTerm | str:
    """Predict and measure the term, or state the reason for its absence."""
    span = lab.config.thermal.stability_k
    if not span:
        return "thermal.stability_k is 0"
    try:
        ends = [warmed(lab, -span), warmed(lab, span)]
        chambers = [in_chamber(lab, thermometer_c(lab) + excursion) for excursion in (-span, span)]
        cold, warm = (warmed(lab, step).instrument.camera.focused_lens for step in (-STEP_K, STEP_K))
    except DomainError as error:
        return str(error)
    direction = field_directions(lab)
    nominal = nominal_px(lab.instrument, direction)
    traced_px = [bundle_prediction(one_filter(end.bench), end.instrument, direction[None])[0, :, 0] for end in ends]
    centroid_px = _mean_centroids(lab, chambers, direction, streams)
    readings_c = [thermometer_c(chamber) for chamber in chambers]
    predicted_px_per_k = (traced_px[1] - traced_px[0]) / (2.0 * span)
    measured_px_per_k = (centroid_px[1] - centroid_px[0]) / (readings_c[1] - readings_c[0])
    scale = span * lab.instrument.pixel_arcsec  # the excursion is three sigma already
    rms_arcsec, rms_sigma_arcsec = scale * np.array(smooth_map_rms(nominal, measured_px_per_k))
    growth, focus = paraxial_change_per_k(cold, warm, STEP_K)
    relative_px_per_k = predicted_px_per_k - predicted_px_per_k.mean(0)
    return ThermalTerm(
        calibrated_at_c=thermometer_c(lab),
        stars=len(nominal),
        signal_e=max(lab.bench.signal_e, BRIGHT_E),
        predicted_arcsec=scale * predicted_px_per_k.std(axis=0),
        measured_arcsec=measured(rms_arcsec, rms_sigma_arcsec, nominal.size * lab.bench.frames),
        scale_ppm_per_k=1e6 * growth_along_axes(nominal, predicted_px_per_k)[0],
        measured_scale_ppm_per_k=measured(*(1e6 * np.array(growth_along_axes(nominal, measured_px_per_k)))),
        paraxial_ppm_per_k=1e6 * growth,
        focus_um_per_k=focus,
        outermost_star_px_per_k=float(np.hypot(*relative_px_per_k.T).max()),
    )


def _mean_centroids(
    lab: BudgetLaboratory, ends: list[BudgetLaboratory], direction: FloatArray, streams: Streams
) -> tuple[FloatArray, FloatArray]:
    """Mean centroids (n, 2) of frames through each lens."""
    psf = point_scene(lab.bench, lab.instrument).psfs(direction[:1]) * len(direction)  # the centroider uses none
    centroid_px = []
    for name, end in zip(("cold", "warm"), ends, strict=True):
        bright = max(end.bench.signal_e, BRIGHT_E)
        scene = point_scene(replace(end.bench, methods=(METHOD,), signal_e=bright), end.instrument)
        light = scene.light(direction, streams.child(name), f"{name} lens", psf=psf)
        frames = read_points(light, scene.bench, end.instrument, streams=streams.child(name, "frames"))
        centroid_px.append(frames.mean_px(METHOD))
    return centroid_px[0], centroid_px[1]


THERMAL = Section(
    record=ThermalTerm,
    table="thermal",
    rows="axis",
    columns="predicted_arcsec measured_arcsec total_predicted_arcsec total_measured_arcsec scale_ppm_per_k "
    "measured_scale_ppm_per_k",
    caption="LSFE-T, the total (eq. 32) including it, and the scale change of the image; 3 sigma.",
    verdicts=[
        agree(
            "measured_scale_ppm_per_k",
            with_="scale_ppm_per_k",
            title="LSFE-T: growth of the image with temperature, frames against ray trace",
        )
    ],
)
