"""Focal length against temperature (LSFE-T), ACC18's second source of LSFE (section 1.1), for which it has no test.

A camera is calibrated at one temperature of lens and housing and used at others. The error is the change of the map
from directions to pixels; the common shift is removed, because the attitude absorbs it. To first order

    e(x, y) = s(x, y) dT
    LSFE-T (3 sigma) = 3 sigma_T x RMS of s over the field

with s [px/K] at a field position, the temperature offset dT of standard deviation sigma_T, and ``thermal.stability_k``
for 3 sigma_T. The prediction traces the lens at -3 sigma_T and +3 sigma_T, and is compared with the paraxial chief ray,
which is independent of the trace. The measurement calibrates the camera at the same two temperatures, taken as exact,
by a cubic polynomial through centres of gravity of rendered frames, and divides the difference of both calibrations by
6 sigma_T. The centre of gravity is used for every main centroider, because the traced mean predicts it; a fitted PSF
follows the core of a defocused spot, which may grow at another rate.
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
"""Smallest signal of a star per frame; below it read noise dominates a centre of gravity."""
GRID = (8, 6)
"""Stars along a row and a column."""
STEP_K = 1.0
"""Temperature step on either side for the derivatives of focus and paraxial scale."""
R2_SEQUENCE = (0.7549, 0.5698)
"""1/g and 1/g^2 with the plastic number g = 1.3247 (g^3 = g + 1), steps of the two-dimensional additive recurrence
R2 (Roberts 2018): its fractions fill the unit square evenly."""


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

    def with_totals(self, predicted_arcsec: FloatArray, measured_arcsec: FloatArray) -> ThermalTerm:
        """The term with the totals (eq. 32) that include it, from totals (2,) without it."""
        lsfe_t_arcsec = np.array([axis.value for axis in self.measured_arcsec])
        return replace(
            self,
            total_predicted_arcsec=np.hypot(self.predicted_arcsec, predicted_arcsec),
            total_measured_arcsec=np.hypot(lsfe_t_arcsec, measured_arcsec),
        )


def with_lens_offset(lab: BudgetLaboratory, offset_k: float) -> BudgetLaboratory:
    """The laboratory with lens and housing above their calibration temperature; focus and detector are unchanged."""
    temperature_c = lab.instrument.camera.lens.environment.temperature_c + offset_k
    instrument = lab.config.instrument.model_copy(update={"lens_temperature_c": temperature_c})
    return build_laboratory(lab.config.model_copy(update={"instrument": instrument}))


def field_directions(lab: BudgetLaboratory) -> FloatArray:
    """Unit vectors (n, 3) in the camera frame of stars at evenly spread field positions and pixel phases."""
    camera = lab.instrument.camera
    columns, rows = GRID
    cell = np.arange(columns * rows)
    phase_px = np.modf(np.outer(cell + 1.0, R2_SEQUENCE))[0]
    x = (cell % columns + 0.5) * camera.width_px / columns - 0.5 + phase_px[:, 0]
    y = (cell // columns + 0.5) * camera.height_px / rows - 0.5 + phase_px[:, 1]
    return camera.nominal_direction(x, y, lab.instrument.focal_length_mm)


def thermal_term(lab: BudgetLaboratory, streams: Streams) -> ThermalTerm | str:
    """Predict and measure the term, or state the reason for its absence."""
    stability_k = lab.config.thermal.stability_k
    if not stability_k:
        return "thermal.stability_k is 0"
    try:
        cold_warm = [with_lens_offset(lab, -stability_k), with_lens_offset(lab, stability_k)]
        cold, warm = (with_lens_offset(lab, step).instrument.camera.focused_lens for step in (-STEP_K, STEP_K))
    except DomainError as error:
        return str(error)
    direction = field_directions(lab)
    nominal = nominal_px(lab.instrument, direction)
    cold_px, warm_px = (
        bundle_prediction(one_filter(lab_at.bench), lab_at.instrument, direction[None])[0, :, 0] for lab_at in cold_warm
    )
    predicted_px_per_k = _sensitivity_px_per_k(cold_px, warm_px, stability_k)
    measured_px_per_k = _sensitivity_px_per_k(*_measure_centroids(lab, cold_warm, direction, streams), stability_k)
    scale = stability_k * lab.instrument.pixel_arcsec  # stability_k is 3 sigma_T
    rms_arcsec, rms_sigma_arcsec = scale * np.array(smooth_map_rms(nominal, measured_px_per_k))
    scale_change_per_k, focus_um_per_k = paraxial_change_per_k(cold, warm, STEP_K)
    relative_px_per_k = predicted_px_per_k - predicted_px_per_k.mean(0)
    return ThermalTerm(
        calibrated_at_c=lab.instrument.camera.lens.environment.temperature_c,
        stars=len(nominal),
        signal_e=max(lab.bench.signal_e, BRIGHT_E),
        predicted_arcsec=scale * predicted_px_per_k.std(axis=0),
        measured_arcsec=measured(rms_arcsec, rms_sigma_arcsec, nominal.size * lab.bench.frames),
        scale_ppm_per_k=1e6 * growth_along_axes(nominal, predicted_px_per_k)[0],
        measured_scale_ppm_per_k=measured(*(1e6 * np.array(growth_along_axes(nominal, measured_px_per_k)))),
        paraxial_ppm_per_k=1e6 * scale_change_per_k,
        focus_um_per_k=focus_um_per_k,
        outermost_star_px_per_k=float(np.hypot(*relative_px_per_k.T).max()),
    )


def _sensitivity_px_per_k(cold_px: FloatArray, warm_px: FloatArray, stability_k: float) -> FloatArray:
    """s (n, 2) of positions at -``stability_k`` and +``stability_k``."""
    return (warm_px - cold_px) / (2.0 * stability_k)


def _measure_centroids(
    lab: BudgetLaboratory, cold_warm: list[BudgetLaboratory], direction: FloatArray, streams: Streams
) -> tuple[FloatArray, FloatArray]:
    """Mean centroids (n, 2) of frames through the cold and through the warm lens."""
    psf = point_scene(lab.bench, lab.instrument).psfs(direction[:1]) * len(direction)  # the centroider uses none
    centroid_px = []
    for name, lab_at in zip(("cold", "warm"), cold_warm, strict=True):
        signal_e = max(lab_at.bench.signal_e, BRIGHT_E)
        scene = point_scene(replace(lab_at.bench, methods=(METHOD,), signal_e=signal_e), lab_at.instrument)
        light = scene.light(direction, streams.child(name), f"{name} lens", psf=psf)
        frames = read_points(light, scene.bench, lab_at.instrument, streams=streams.child(name, "frames"))
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
