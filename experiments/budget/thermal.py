"""Focal length against temperature, ACC18's second source of LSFE (section 1.1), for which it has no test: LSFE-T.

A camera is calibrated at one temperature of lens and housing and used at others. What its calibration has not seen is
the change of the map from directions to pixels; the common shift is taken out, since an attitude takes it. To first
order that change is e = s dT, so that over a field of stars and a temperature of standard deviation sigma_T

    LSFE-T (3 sigma) = RMS over the field of s x 3 sigma_T

with ``thermal.stability_k`` for 3 sigma_T. Predicted by ray trace of the warmed and the cooled lens, measured by the
centre of gravity on frames rendered through both, and set beside the paraxial chief ray, which shares no trace with
them. The centre of gravity is taken whatever centroider counts: it is what the traced mean predicts. A PSF that is
fitted follows the core of a spot whose focus has changed, and that may grow at another rate.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from experiments.budget.combine import Value
from experiments.budget.laboratory import Laboratory, build_laboratory
from experiments.budget.tolerances import cubic_basis
from experiments.laboratory.point_frames import read_points
from experiments.laboratory.point_scene import one_filter, point_scene
from experiments.laboratory.points import nominal_px
from experiments.laboratory.ray_prediction import bundle_prediction
from optics.arrays import FloatArray
from optics.errors import DomainError
from optics.lens.system import LensSystem
from optics.rays.paraxial import axial_paraxial
from render.engine.random import Streams

__all__ = ["ThermalTerm", "field_directions", "thermal_term", "warmed"]


METHOD = "cog"
BRIGHT_E = 6000.0
"""Electrons per star and frame at least: a centre of gravity that drowns in read noise says nothing of the lens."""
PLACES = (8, 6)
"""Stars along a row and a column."""
STEP_K = 1.0
"""Of the derivatives of focus and paraxial scale."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ThermalTerm:
    """LSFE-T of an instrument."""

    temperature_c: float  # At which the camera is calibrated
    stability_k: float  # Temperature about it, 3 sigma
    signal_e: float  # Of a star, per frame
    predicted: Value  # The term
    measured: Value  # The term
    place_px: FloatArray  # (n, 2) Stars, as an ideal lens images them
    predicted_px: FloatArray  # (n, 2) Change of the images by ``stability_k``, common shift taken out
    measured_px: FloatArray  # (n, 2) Change of the images by ``stability_k``, common shift taken out
    # (2,) Growth of the image along x and y: by ray trace, from frames, standard deviation of the latter
    scale_ppm_per_k: FloatArray
    # (2,) Growth of the image along x and y: by ray trace, from frames, standard deviation of the latter
    measured_scale_ppm_per_k: FloatArray
    # (2,) Growth of the image along x and y: by ray trace, from frames, standard deviation of the latter
    scale_sigma_ppm_per_k: FloatArray
    paraxial_ppm_per_k: float  # The same of the paraxial chief ray
    focus_um_per_k: float  # Paraxial focus against the detector, positive behind it

    @property
    def corner_px_per_k(self) -> float:
        """Motion of the outermost star by one kelvin, by ray trace."""
        return float(np.hypot(*self.predicted_px.T).max() / self.stability_k)


def warmed(lab: Laboratory, kelvin: float) -> Laboratory:
    """The laboratory with lens and housing warmer by so much; everything else as it was, the focus too."""
    config = lab.config
    temperature = lab.instrument.camera.lens.environment.temperature_c + kelvin
    instrument = config.instrument.model_copy(update={"lens_temperature_c": temperature})
    return build_laboratory(config.model_copy(update={"instrument": instrument}))


def field_directions(lab: Laboratory) -> FloatArray:
    """Unit vectors (n, 3) in cam of stars spread evenly over the detector, at all fractions of a pixel."""
    camera = lab.instrument.camera
    columns, rows = PLACES
    cell = np.arange(columns * rows)
    fraction = np.modf(np.outer(cell + 1.0, [0.7549, 0.5698]))[0]  # additive recurrence: no two at one fraction
    x = (cell % columns + 0.5) * camera.width_px / columns - 0.5 + fraction[:, 0]
    y = (cell // columns + 0.5) * camera.height_px / rows - 0.5 + fraction[:, 1]
    return camera.nominal_direction(x, y, lab.instrument.focal_length_mm)


def thermal_term(lab: Laboratory, streams: Streams) -> ThermalTerm | str | None:
    """Predict and measure the term."""
    span = lab.config.thermal.stability_k
    if not span:
        return None
    try:
        ends = [warmed(lab, -span), warmed(lab, span)]
        slopes = [warmed(lab, -STEP_K), warmed(lab, STEP_K)]
    except DomainError as error:
        return str(error)
    direction = field_directions(lab)
    place = nominal_px(lab.instrument, direction)
    traced = [bundle_prediction(one_filter(end.bench), end.instrument, direction[None])[0, :, 0] for end in ends]
    seen = _images(lab, ends, direction, streams)
    basis, centred = cubic_basis(place), place - lab.instrument.camera.centre_px
    predicted, measured = ((warm - cold) / 2.0 for cold, warm in (traced, seen))
    scale = lab.instrument.pixel_arcsec  # the excursion is three sigma already
    noise = _left(basis, measured)
    count, free = basis.shape
    smooth = basis @ np.linalg.lstsq(basis, measured, rcond=None)[0]
    square = smooth.var(axis=0) - noise**2 * (free - 1) / count
    slope, spread = _slopes(centred, measured)
    paraxial = [_paraxial(one.instrument.camera.focused_lens) for one in slopes]
    return ThermalTerm(
        temperature_c=lab.instrument.camera.lens.environment.temperature_c,
        stability_k=span,
        signal_e=max(lab.bench.signal_e, BRIGHT_E),
        predicted=Value(arcsec=predicted.std(axis=0) * scale),
        measured=Value(
            arcsec=np.sqrt(np.maximum(square, 0.0)) * scale,
            uncertainty_arcsec=noise / np.sqrt(count) * scale,
            n=2 * count * lab.bench.frames,
        ),
        place_px=place,
        predicted_px=predicted - predicted.mean(0),
        measured_px=measured - measured.mean(0),
        scale_ppm_per_k=_slopes(centred, predicted)[0] * 1e6 / span,
        measured_scale_ppm_per_k=slope * 1e6 / span,
        scale_sigma_ppm_per_k=spread * 1e6 / span,
        paraxial_ppm_per_k=float(np.log(paraxial[1][0] / paraxial[0][0]) / (2.0 * STEP_K) * 1e6),
        focus_um_per_k=(paraxial[1][1] - paraxial[0][1]) / (2.0 * STEP_K) * 1e3,
    )


def _images(
    lab: Laboratory, ends: list[Laboratory], direction: FloatArray, streams: Streams
) -> tuple[FloatArray, FloatArray]:
    """Mean centroids (n, 2) of frames through each lens."""
    psf = point_scene(lab.bench, lab.instrument).psfs(direction[:1]) * len(direction)  # the centroider uses none
    found = []
    for name, end in zip(("cold", "warm"), ends, strict=True):
        bright = max(end.bench.signal_e, BRIGHT_E)
        scene = point_scene(replace(end.bench, methods=(METHOD,), signal_e=bright), end.instrument)
        light = scene.light(direction, streams.child(name), f"{name} lens", psf=psf)
        frames = read_points(light, scene.bench, end.instrument, streams=streams.child(name, "frames"))
        found.append(frames.mean_px(METHOD))
    return found[0], found[1]


def _left(basis: FloatArray, shift_px: FloatArray) -> FloatArray:
    """RMS (2,) about a smooth map, free parameters counted: noise, S-curve and response of the chip."""
    left = shift_px - basis @ np.linalg.lstsq(basis, shift_px, rcond=None)[0]
    return np.asarray(np.sqrt((left**2).sum(0) / (len(basis) - basis.shape[1])))


def _slopes(place_px: FloatArray, shift_px: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Growth (2,) of x along x and of y along y by straight lines, and its standard deviation."""
    design = np.column_stack([np.ones(len(place_px)), place_px])
    coefficient = np.linalg.lstsq(design, shift_px, rcond=None)[0]
    left = shift_px - design @ coefficient
    sigma = np.sqrt((left**2).sum(0) / (len(design) - design.shape[1]))
    spread = np.sqrt(np.diag(np.linalg.inv(design.T @ design)))
    return np.diag(coefficient[1:]), spread[1:] * sigma


def _paraxial(lens: LensSystem) -> tuple[float, float]:
    """Height of the chief ray on the detector over the slope of the star, and focus behind the detector [mm]."""
    p = axial_paraxial(lens, lens.design_wavelength_nm)
    z = float(lens.image_position_mm[2])
    # through the rear nodal point a star stays at efl x slope in the focal plane; from there along the chief ray
    lever = (z - p.exit_pupil_z_mm) / (p.rear_focus_z_mm - p.exit_pupil_z_mm) if np.isfinite(p.exit_pupil_z_mm) else 1.0
    return p.efl_mm * lever, float(lens.axis[-1][2]) * (p.rear_focus_z_mm - z)
