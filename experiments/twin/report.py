"""Results of a run: records of numbers, tables, curves, verdicts, pictures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from calib.calibration.frame_attitudes import camera_residuals
from calib.fitting.misfit import two_sided_quantile
from calib.measure.detection.limiting_magnitude import completeness
from calib.measure.statistics.separability import FEATURES, Separability, separability, window_features
from calib.photometry.zero_point import COLOUR_KNOTS
from experiments.harness.drawings import bars, curves
from experiments.harness.quantities import Outcome, Quantities, shown_unit
from experiments.harness.sections import Section, Verdict, agree, below, col
from experiments.harness.summary import Criterion, Measured, measured
from experiments.twin.compare import BRIGHT_MAG, CLIP_PX, THRESHOLDS, FrameStatistics, joined, limit_of, statistics_of
from experiments.twin.hold_out import HeldOut
from experiments.twin.measure import CameraFit, Centroids
from experiments.twin.pipeline import MeasuredNight
from experiments.twin.prescription import LensPose
from experiments.twin.synthetic import KnownNight, true_values
from experiments.twin.twin import Twin
from optics.arrays import FloatArray, IntArray

FALSE_ALARM = 0.01
COMPLETENESS_LIMIT = 0.03
FRAME_LIMIT, NOISE_LIMIT = 0.07, 0.01
FALSE_LIMIT_SIGMA = two_sided_quantile(FALSE_ALARM)
FEWEST_IN_BIN, FEWEST_TO_TELL, FEWEST_CAUSES = 30, 30, 8
CLASSIFIED_MAG = 1.0
"""Magnitudes above the limit of the stars whose windows are classified."""
STRETCH_PERCENT = (20.0, 99.7)


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraNumbers:
    """Measured properties of the camera."""

    frames: int = col("Frames solved")
    frames_given: int = col("Frames given")
    order: str = col("Camera model")
    focal_length_px: Measured = col("Focal length", "px")
    focal_length_mm: Measured = col("Focal length", "mm")
    field_width_deg: float = col("Field, width", "deg", ".3f")
    centre_x_px: Measured = col("Principal point from the middle, columns", "px")
    centre_y_px: Measured = col("Principal point from the middle, rows", "px")
    corner_px: float = col("Distortion at the corner", "px", ".3f")
    floor_px: float = col("Error per axis beyond the noise of centroids", "px", ".3f")
    width_px: Measured = col("Width of the PSF's core, reference colour", "px")
    gain_e_per_dn: Measured = col("Gain", "e-/DN")
    read_noise_low_e: float = col("Read noise, black level lowest", "e-", ".2f")
    read_noise_high_e: float = col("Read noise, black level highest", "e-", ".2f")
    black_low_dn: float = col("Black level, lowest", "DN", ".1f")
    black_high_dn: float = col("Black level, highest", "DN", ".1f")
    dsnu_dn: Measured = col("DSNU", "DN")
    prnu_percent: Measured = col("PRNU", "percent")
    hot_pixels: int = col("Hot pixels")
    saturation_dn: float = col("Saturation", "DN", "g")
    zero_point_mag: Measured = col("Zero point: G of 1 e- per exposure", "mag")
    extinction_mag: Measured | None = col("Extinction per airmass", "mag", default=None)
    vignetting_mag: Measured = col("Vignetting at the corner", "mag")
    limit_mag: float = col("Half of the stars detected at 5 sigma, G", "mag", ".2f")
    latitude_deg: Measured | None = col("Latitude", "deg", default=None)
    longitude_deg: Measured | None = col("Longitude", "deg", default=None)
    refraction_arcsec: Measured | None = col("Refraction / tan z from the frames", "arcsec", default=None)


def camera_numbers(night: MeasuredNight, compared: HeldOut, limit_mag: float) -> CameraNumbers:
    """The camera in numbers."""
    whole = night.whole
    model, noise, light = whole.calibration.model, whole.noise, whole.photometry
    sigma = np.sqrt(np.diag(whole.calibration.covariance))

    def parameter(name: str, scale: float = 1.0) -> Measured:
        if name not in model.parameter_names:
            return Measured(value=float("nan"))
        at = model.parameter_names.index(name)
        return measured(model.parameters[at] * scale, sigma[at] * scale)

    geometry, focal = model.geometry, parameter("focal_length_mm", 1.0 / night.pitch_mm)
    edges = model.unproject(geometry.centre_px + np.array([[-0.5, 0.0], [0.5, 0.0]]) * geometry.width_px)
    ray = model.unproject(geometry.corners_px)
    principal = geometry.centre_px + np.nan_to_num([parameter("x0_px").value, parameter("y0_px").value])
    distortion = geometry.corners_px - (principal + focal.value * ray[:, :2] / ray[:, 2:])
    width, width_error = compared.bias.off(whole).psf.central_width_px
    site, refraction = night.zenith, night.refraction_arcsec
    return CameraNumbers(
        frames=len(night.rows),
        frames_given=len(night.solved),
        order=whole.order,
        focal_length_px=focal,
        focal_length_mm=parameter("focal_length_mm"),
        field_width_deg=float(np.degrees(np.arccos(np.clip(edges[0] @ edges[1], -1, 1)))),
        centre_x_px=parameter("x0_px"),
        centre_y_px=parameter("y0_px"),
        corner_px=float(np.hypot(*distortion.T).mean()),
        floor_px=whole.floor_px,
        width_px=measured(width, width_error),
        gain_e_per_dn=measured(noise.gain_e_per_dn, noise.gain_error_e_per_dn, noise.blocks),
        read_noise_low_e=noise.read_noise_e[0],
        read_noise_high_e=noise.read_noise_e[1],
        black_low_dn=noise.black_level_dn[0],
        black_high_dn=noise.black_level_dn[1],
        dsnu_dn=measured(noise.dsnu_dn, noise.dsnu_error_dn),
        prnu_percent=measured(100.0 * noise.prnu, 100.0 * noise.prnu_error),
        hot_pixels=int(night.known.hot.sum()),
        saturation_dn=night.saturation_dn,
        # what is folded into the twin's light makes up for its PSF: the zero point is that of the stars
        zero_point_mag=measured(light.above_mag, light.above_error_mag, light.frames, "mag"),
        extinction_mag=None
        if np.isnan(light.extinction_mag)
        else measured(light.extinction_mag, light.extinction_error_mag, light.frames),
        vignetting_mag=measured(light.vignetting_at(1.0), light.vignetting_error_at(1.0)),
        limit_mag=limit_mag,
        latitude_deg=None if site is None else measured(site.latitude_deg, site.error_deg),
        longitude_deg=None if site is None else measured(site.longitude_deg, site.error_deg),
        refraction_arcsec=None if refraction is None else measured(*refraction),
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameNumbers:
    """One frame of the folder."""

    name: str = col("Frame", shown=False)
    found: int = col("Detections")
    identified: int = col("Identified")
    seconds: float = col("Time", "s", ".2f")
    background_dn: float = col("Background", "DN", ".0f")
    stars: float = col("Stars at 5 sigma", "", ".0f")
    rendered_stars: Measured = col("Twin")
    off_percent: float = col("Difference", "percent", ".1f")
    noise_dn: float = col("Noise", "DN", ".3f")
    rendered_noise_dn: Measured = col("Twin's noise", "DN")
    noise_percent: float = col("Difference", "percent", ".2f")
    scatter_mag: float = col("Scatter of photometry", "mag", ".3f")
    trail: int = col("Detections on trails")


def frame_numbers(night: MeasuredNight, compared: HeldOut) -> list[FrameNumbers]:
    """Solved frames, real and rendered."""
    out = []
    for number, row in enumerate(night.rows):
        solved, real = night.solved[row], compared.real[number]
        stars, noise = (
            np.array([float(quantity(frames[number])) for frames in (compared.real, *compared.sets)])
            for quantity in (_stars, _noise)
        )
        out.append(
            FrameNumbers(
                name=solved.name,
                found=len(solved.detected.stars),
                identified=len(solved.identification.detected),
                seconds=solved.seconds,
                background_dn=float(np.median(real.blocks.level_dn)),
                stars=stars[0],
                rendered_stars=_of_sets(stars[1:]),
                off_percent=100.0 * (stars[1:].mean() / max(stars[0], 1) - 1.0),
                noise_dn=noise[0],
                rendered_noise_dn=_of_sets(noise[1:]),
                noise_percent=100.0 * (noise[1:].mean() / noise[0] - 1.0),
                scatter_mag=float(night.whole.photometry.scatter_mag[number]),
                trail=real.trail,
            )
        )
    return out


def _stars(frame: FrameStatistics) -> int:
    return int((frame.height >= THRESHOLDS[0]).sum())


def _noise(frame: FrameStatistics) -> float:
    return float(np.sqrt(np.nanmedian(frame.blocks.variance_dn2)))


def _of_sets(values: FloatArray, spread: float | None = None) -> Measured:
    """Mean of the rendered sets; the standard deviation of one is ``spread``, or follows from their scatter."""
    spread = float(values.std(ddof=1)) if spread is None else spread
    return measured(values.mean(), spread / np.sqrt(len(values)), len(values))


@dataclass(frozen=True, slots=True, kw_only=True)
class OrderNumbers:
    """A camera model, each frame predicted from the others."""

    name: str = col("Model", shown=False)
    parameters: int = col("Parameters")
    chi2: float = col("χ² per degree of freedom", "", ".4f")
    residual_px: float = col("Residual of predicted frames", "px", ".4f")


@dataclass(frozen=True, slots=True, kw_only=True)
class TransferPoint:
    """Blocks of like background."""

    level_dn: float = col("Background", "DN", ".1f")
    variance_dn2: float = col("Variance of a pixel", "DN2", ".2f")
    fitted_dn2: float = col("Photon transfer and pattern", "DN2", ".2f")


@dataclass(frozen=True, slots=True, kw_only=True)
class ColourPoint:
    """Colour term at a knot."""

    colour: float = col("5040 K / T", "", ".2f")
    measured_mag: Measured = col("Excess brightness over G", "mag")
    twin_mag: float = col("The twin's response", "mag", ".3f")


@dataclass(frozen=True, slots=True, kw_only=True)
class Cause:
    """Part of the residual of bright stars, per axis."""

    name: str = col("Cause", shown=False)
    part_px: float = col("RMS per axis", "px", ".4f")


def causes(fit: CameraFit, compared: HeldOut, limit_mag: float) -> list[Cause]:
    """Contributions to the residuals of bright stars."""

    def rms(stars: Centroids) -> tuple[float, float]:
        residual = camera_residuals(stars.observations, fit.camera, fit.attitudes)
        bright = (stars.magnitude < limit_mag - BRIGHT_MAG) & (np.hypot(*residual.T) < CLIP_PX)
        if bright.sum() < FEWEST_CAUSES:
            return float("nan"), float("nan")
        return float(np.sqrt((residual[bright] ** 2).mean())), float(np.sqrt((stars.noise_px[bright] ** 2).mean()))

    (gaussian, noise), (fitted, noise_psf) = rms(fit.gaussian), rms(fit.fitted)
    method = compared.bias.floor_px
    parts = {
        "Gaussian fits, total residual": gaussian,
        "Gaussian fits, noise of the centroids": noise,
        "Gaussian fits, S-curve (no error of PSF fits)": float(np.sqrt(max(gaussian**2 - fitted**2, 0.0))),
        "PSF fits, total residual": fitted,
        "PSF fits, noise of the centroids": noise_psf,
        "PSF fits, error of the method (from rendered frames)": method,
        "PSF fits, remainder (seeing, catalogue, PSF)": float(np.sqrt(max(fitted**2 - noise_psf**2 - method**2, 0.0))),
    }
    return [Cause(name=name, part_px=part) for name, part in parts.items()]


@dataclass(frozen=True, slots=True, kw_only=True)
class Compared:
    """A statistic of real and of rendered frames."""

    key: str = col("Key", shown=False)
    label: str
    unit: str = col("Unit")
    real: Measured = col("Real", "{statistic}")
    twin: Measured = col("Twin", "{statistic}")
    off: Measured = col("Difference")
    allowed: float | None = col("Allowed", "", ".3g")
    within: str = col("Within", "")


@dataclass(frozen=True, slots=True, kw_only=True)
class HalfMagnitude:
    """Completeness between two magnitudes."""

    magnitude_mag: float = col("G", "mag", ".2f")
    count: int = col("Stars")
    real_5: Measured = col("Real, 5 sigma")
    twin_5: Measured = col("Twin, 5 sigma")
    real_6: Measured = col("Real, 6 sigma")
    twin_6: Measured = col("Twin, 6 sigma")


@dataclass(frozen=True, slots=True, kw_only=True)
class Detected:
    """False detections in all frames, and separability of stars."""

    false_5: Measured = col("False detections at 5 sigma")
    false_twin_5: Measured = col("Twin's false detections at 5 sigma")
    false_6: Measured = col("False detections at 6 sigma")
    false_twin_6: Measured = col("Twin's false detections at 6 sigma")
    false_pull: float = col("Difference over its standard deviation, 5 sigma", "sigma", ".2f")
    trails: int = col("Detections on trails, not counted")
    area: Measured | None = col("Area under the ROC curve, real against rendered", default=None)
    told_by: str = col("Feature with the largest difference", default="")


@dataclass(frozen=True, slots=True, kw_only=True)
class Feature:
    """Difference of real and rendered star windows in a feature."""

    name: str = col("Feature", shown=False)
    effect: float = col("Rendered minus real", "sigma", ".3f")


@dataclass(frozen=True, slots=True, kw_only=True)
class TrueNumber:
    """A measured number and the truth of the rendering camera."""

    name: str = col("Number", shown=False)
    unit: str = col("Unit")
    found: Measured = col("Measured", "{parameter}")
    true: float = col("Truth", "{parameter}", ".5g")
    pull: float = col("Difference", "sigma", ".2f")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Kept:
    """What files and pictures are made of; no numbers."""

    name: str
    twin: Twin
    limit_mag: float
    real: tuple[FloatArray, ...]  # Frames as read
    rendered: tuple[FloatArray, ...]
    notes: tuple[str, ...]
    prescription: str = ""


def records(
    night: MeasuredNight,
    compared: HeldOut,
    twin: Twin,
    *,
    truth: KnownNight | None,
    name: str,
    pose: LensPose | None = None,
    prescription: str = "",
) -> dict[str, Any]:
    """Section -> record or records."""
    limit = limit_of(compared.real, THRESHOLDS[0])
    numbers = camera_numbers(night, compared, limit)
    noise, light = night.whole.noise, night.whole.photometry
    roc = classified(night, compared)
    return {
        "kept": Kept(
            name=name,
            twin=twin,
            limit_mag=limit,
            real=tuple(frame.image.dn for frame in night.known.night.frames),
            rendered=tuple(image.dn for image in compared.images),
            notes=night.notes,
            prescription=prescription,
        ),
        "camera": numbers,
        "frames": frame_numbers(night, compared),
        "orders": [
            OrderNumbers(
                name=model.order, parameters=model.parameters, chi2=model.mean_chi2, residual_px=model.residual_px
            )
            for model in night.orders
        ]
        or None,
        "transfer": [
            TransferPoint(level_dn=float(m), variance_dn2=float(v), fitted_dn2=float(noise.variance_dn2(m)))
            for m, v in zip(noise.levels_dn, noise.variances_dn2, strict=True)
        ],
        "colours": [
            ColourPoint(
                colour=float(COLOUR_KNOTS[k]),
                measured_mag=measured(light.colour_mag[k], light.colour_error_mag[k]),
                twin_mag=float(twin.response_mag[k]),
            )
            for k in np.flatnonzero(np.isfinite(light.colour_mag))
        ],
        "causes": causes(night.whole, compared, limit),
        "comparison": comparison(compared, limit),
        "completeness": completeness_bins(compared, limit),
        "detected": detected(compared, roc),
        "features": None
        if roc is None
        else [Feature(name=name, effect=float(effect)) for name, effect in zip(FEATURES, roc.effect, strict=True)],
        "pose": pose,
        "truth": None
        if truth is None
        else [
            TrueNumber(
                name=name,
                unit=shown_unit(unit),
                found=replace(value, unit=unit),
                true=true,
                pull=float((value.value - true) / (value.uncertainty or np.nan)),
            )
            for name, unit, value, true in true_values(truth, numbers, night.whole)
        ],
    }


def comparison(compared: HeldOut, limit_mag: float) -> list[Compared]:
    """Every statistic of the real and of the rendered sets."""
    sets = [statistics_of(frames, limit_mag, compared.airmass) for frames in (compared.real, *compared.sets)]
    out = []
    for real, *rendered in zip(*sets, strict=True):
        drawn = np.array([statistic.value for statistic in rendered])
        spread = float(drawn.std(ddof=1))
        scale = real.value if real.relative and real.value else 1.0
        off = (float(drawn.mean()) - real.value) / scale
        error = spread * np.sqrt(1.0 + 1.0 / len(drawn)) / abs(scale)
        judged = np.isfinite(real.limit) and np.isfinite(off)
        out.append(
            Compared(
                key=real.key,
                label=real.label,
                unit=shown_unit(real.unit),
                real=measured(real.value, spread, unit=real.unit),
                twin=_of_sets(drawn),
                off=measured(off, error),
                allowed=float(real.limit),
                within=("yes" if abs(off) <= real.limit else "no") if judged else "",
            )
        )
    return out


def completeness_bins(compared: HeldOut, limit_mag: float) -> list[HalfMagnitude]:
    """Detected fraction per half magnitude about the limit."""
    edges = np.arange(np.floor(2.0 * limit_mag) / 2.0 - 1.5, limit_mag + 1.01, 0.5)

    def of_sets(sigma: float) -> tuple[IntArray, FloatArray]:
        sets = [
            completeness(joined(frames, "magnitude"), joined(frames, "height") >= sigma, edges)
            for frames in (compared.real, *compared.sets)
        ]
        return sets[0][0], np.array([fraction for _, fraction in sets])

    (count, five), (_, six) = (of_sets(sigma) for sigma in THRESHOLDS)
    out = []
    for k in np.flatnonzero(count >= FEWEST_IN_BIN):
        # of one set: every star is detected or not
        spread = [float(np.sqrt(p * (1.0 - p) / count[k])) for p in (five[:, k].mean(), six[:, k].mean())]
        real = measured([five[0, k], six[0, k]], spread, int(count[k]))
        out.append(
            HalfMagnitude(
                magnitude_mag=float(edges[k] + 0.25),
                count=int(count[k]),
                real_5=real[0],
                twin_5=_of_sets(five[1:, k], spread[0]),
                real_6=real[1],
                twin_6=_of_sets(six[1:, k], spread[1]),
            )
        )
    return out


def classified(night: MeasuredNight, compared: HeldOut) -> Separability | None:
    """Separability of windows about the bright stars of real and rendered frames; None where there are too few."""
    faintest = night.known.limit_mag - CLASSIFIED_MAG
    images = [frame.image for frame in night.known.night.frames], compared.images
    features = [
        window_features(image.dn, frame.position_px[frame.star_magnitude < faintest])
        for some, frames in zip(images, (compared.real, compared.sets[0]), strict=True)
        for image, frame in zip(some, frames, strict=True)
    ]
    count, frames = [len(part) for part in features], len(compared.real)
    kind, frame = (np.repeat(numbers, count) for numbers in np.divmod(np.arange(2 * frames), frames))
    values = np.concatenate(features)
    good = np.isfinite(values).all(axis=1)
    if np.bincount(kind[good], minlength=2).min() < FEWEST_TO_TELL:
        return None
    return separability(values[good], kind[good], frame[good])


def detected(compared: HeldOut, roc: Separability | None) -> Detected:
    """False detections of the real and of the rendered sets."""

    def false(sigma: float) -> tuple[Measured, Measured]:
        real, *drawn = ((joined(frames, "false") >= sigma).sum() for frames in (compared.real, *compared.sets))
        mean = float(np.mean(drawn))
        return measured(real, np.sqrt(max(real, 1))), measured(mean, np.sqrt(max(mean, 0.5) / len(drawn)))

    (real_5, twin_5), (real_6, twin_6) = (false(sigma) for sigma in THRESHOLDS)
    spread = np.hypot(real_5.uncertainty or 1.0, twin_5.uncertainty or 0.0)
    return Detected(
        false_5=real_5,
        false_twin_5=twin_5,
        false_6=real_6,
        false_twin_6=twin_6,
        false_pull=float((twin_5.value - real_5.value) / spread),
        trails=sum(frame.trail for frame in compared.real),
        area=None if roc is None else measured(roc.area, roc.error, roc.first),
        told_by="" if roc is None else FEATURES[int(np.argmax(np.abs(roc.effect)))],
    )


def agreement_lines(statistics: Sequence[Compared], detected: Detected) -> list[str]:
    """Agreement of twin and camera for users of its frames: a line per judged statistic."""
    out = []
    for statistic in statistics:
        if statistic.within:
            unit = f" {statistic.real.unit}" if statistic.real.unit else ""
            beyond = "" if statistic.within == "yes" else " (above the allowed difference)"
            out.append(
                f"{statistic.label}: real {statistic.real.value:.4g}, rendered {statistic.twin.value:.4g}{unit}{beyond}"
            )
    if detected.area is not None:
        out.append(
            f"star windows: area under the ROC curve of the classifier {detected.area.value:.2f} (0.5: not separable)"
        )
    return out


def axes(config: Any) -> Quantities:
    """No dimension is known before the frames are read."""
    del config
    return Quantities()


def _named(dim: str, label: str, key: str = "name", names: str = "name", units: str = "") -> Any:
    """Axis whose coordinates are the field ``key`` of the records, numbered where it is not unique, shown as ``names``;
    ``units``: measured number whose unit is that of the row."""

    def describe(q: Quantities, rows: Sequence[Any]) -> None:
        keys = [getattr(row, key) for row in rows]
        if len(set(keys)) < len(keys):
            keys = [f"{n + 1} {row}" for n, row in enumerate(keys)]
        of_rows = [getattr(row, units).unit for row in rows] if units else ()
        q.axis(dim, keys, label, names=[getattr(row, names) for row in rows], units=of_rows)

    return describe


def _verdict(judge: Any, *names: str) -> Verdict:
    judge.names = names
    verdict: Verdict = judge
    return verdict


def _error(quantity: Any) -> FloatArray:
    """Standard deviations; 0 where there are none."""
    return np.zeros(np.shape(quantity.values)) if quantity.error is None else np.nan_to_num(quantity.error)


def _criterion(name: str, value: float, limit: float, advice: str = "") -> Criterion:
    noticed = limit if limit > 0 else None
    return Criterion(name=name, value=value, limit=limit, false_alarm=FALSE_ALARM, notices=noticed, advice=advice)


def _within(outcome: Outcome) -> list[Criterion]:
    """Each statistic within what is allowed and what noise does."""
    out = []
    labels = outcome.names("statistic")
    for k, label in enumerate(labels):
        off, allowed = outcome.quantity("off").at(statistic=k), float(outcome.values("allowed")[k])
        if not np.isfinite(allowed) or not np.isfinite(off.values):
            continue
        limit = allowed + two_sided_quantile(FALSE_ALARM, outcome.config.realisations - 1) * float(_error(off))
        words = "see the table of causes and the features of the classifier"
        out.append(_criterion(f"twin against real: {label}", float(abs(off.values)), limit, words))
    return out


def _complete(outcome: Outcome) -> list[Criterion]:
    out = []
    for sigma in ("5", "6"):
        real, twin = outcome.quantity(f"real_{sigma}"), outcome.quantity(f"twin_{sigma}")
        off = np.abs(real.values - twin.values)
        error = np.hypot(_error(real), _error(twin))
        worst = int(np.argmax(off - FALSE_LIMIT_SIGMA * error))
        limit = COMPLETENESS_LIMIT + FALSE_LIMIT_SIGMA * float(error[worst])
        name = f"completeness per half magnitude, {sigma} sigma: twin against real, the worst"
        out.append(_criterion(name, float(off[worst]), limit))
    return out


def _each_frame(outcome: Outcome) -> list[Criterion]:
    out = []
    sets = float(outcome.config.realisations)
    for name, field, base, allowed in (
        ("stars per frame", "off_percent", "stars", FRAME_LIMIT),
        ("noise of the background per frame", "noise_percent", "noise_dn", NOISE_LIMIT),
    ):
        off, level = np.abs(outcome.values(field)) / 100.0, outcome.values(base)
        drawn = outcome.quantity(f"rendered_{base}")
        # the scatter of a few sets says little of one frame: pooled over the frames, as counts scatter
        relative = _error(drawn) * np.sqrt(sets + 1.0) / np.sqrt(level)
        error = np.sqrt(np.mean(relative**2) / level)
        worst = int(np.argmax(off - error))
        limit = allowed + two_sided_quantile(FALSE_ALARM / len(off), len(off) * (sets - 1.0)) * float(error[worst])
        out.append(_criterion(f"{name}: twin against real, the worst of {len(off)}", float(off[worst]), limit))
    return out


def pictures(outcome: Outcome, number: int, half_px: int | None = None) -> Figure:
    """A real frame and its twin, the same stretch; of ``half_px`` the middle, enlarged."""
    from experiments.harness.plotting import new_figure

    kept: Kept = outcome.result["kept"]
    real, rendered = kept.real[number], kept.rendered[number]
    if half_px is not None:
        cut = tuple(slice(max(n // 2 - half_px, 0), n // 2 + half_px) for n in real.shape)
        real, rendered = real[cut], rendered[cut]
    height, width = real.shape
    figure, grid = new_figure(1, 2, width="full", aspect_ratio=0.52 * height / width + 0.06)
    low, high = np.percentile(real, STRETCH_PERCENT)
    for panel, image, words in zip(np.ravel(grid), (real, rendered), ("real", "twin"), strict=True):
        panel.imshow(image, cmap="gray", vmin=low, vmax=high, interpolation="auto" if half_px is None else "nearest")
        panel.set(title=words)
        panel.set_axis_off()
    return figure


SECTIONS: dict[str, Section] = {
    "kept": Section(
        record=Kept,
        figures={
            "first": partial(pictures, number=0),
            "last": partial(pictures, number=-1),
            "close": partial(pictures, number=0, half_px=96),
        },
    ),
    "camera": Section(record=CameraNumbers, vertical=True, caption="Measured properties of the camera."),
    "frames": Section(
        record=FrameNumbers,
        dim="frame",
        axes=_named("frame", "Frame"),
        caption="Frames, and frames rendered by twins measured without them.",
        verdicts=[_verdict(_each_frame, "off_percent", "noise_percent")],
    ),
    "orders": Section(
        record=OrderNumbers,
        dim="order",
        axes=_named("order", "Model"),
        caption="Camera models, cross-validated: each frame predicted from the others.",
        note="Chosen: the simplest within one standard error of the best, paired by frames.",
    ),
    "transfer": Section(
        record=TransferPoint,
        dim="level",
        along="level_dn",
        figures={"photon_transfer": curves("level", points="variance_dn2", lines="fitted_dn2", aspect_ratio=0.4)},
    ),
    "colours": Section(
        record=ColourPoint,
        dim="knot",
        along="colour",
        caption="Colour term, zero at 5040 K.",
        figures={"colour_term": curves("knot", points="measured_mag", lines="twin_mag", aspect_ratio=0.4)},
    ),
    "causes": Section(
        record=Cause,
        dim="cause",
        axes=_named("cause", "Cause"),
        caption="Residuals of bright stars after the calibration; contributions add in quadrature.",
    ),
    "comparison": Section(
        record=Compared,
        dim="statistic",
        axes=_named("statistic", "Statistic", "key", "label", "real"),
        columns="unit real twin off allowed within",
        caption="Real and rendered frames; each frame is rendered by a twin measured without it.",
        note="Difference: (twin − real) / real (for magnitudes, correlations and fractions: twin − real); ±: "
        "noise of a single set, from the scatter of the rendered sets.",
        verdicts=[_verdict(_within, "off", "allowed")],
    ),
    "completeness": Section(
        record=HalfMagnitude,
        dim="bin",
        along="magnitude_mag",
        caption="Fraction of the catalogue stars detected, per half magnitude.",
        figures={
            "completeness_plot": curves(
                "bin", points="real_5 real_6", lines="twin_5 twin_6", y="Fraction detected", aspect_ratio=0.42
            )
        },
        verdicts=[_verdict(_complete, "real_5", "twin_5", "real_6", "twin_6")],
    ),
    "detected": Section(
        record=Detected,
        vertical=True,
        caption="False detections in all frames, and separability of real and rendered stars.",
        verdicts=[
            below(
                "false_pull",
                FALSE_LIMIT_SIGMA,
                title="false detections at 5 sigma: twin against real",
                size=True,
                false_alarm=FALSE_ALARM,
            )
        ],
    ),
    "features": Section(
        record=Feature,
        dim="feature",
        axes=_named("feature", "Feature"),
        caption="Differences between real and rendered star windows.",
        figures={"feature_bars": bars("feature", bars="effect")},
    ),
    "pose": Section(
        record=LensPose,
        vertical=True,
        caption="Detector position behind the known lens, from the frames.",
    ),
    "truth": Section(
        record=TrueNumber,
        dim="parameter",
        axes=_named("parameter", "Number", units="found"),
        caption="Measured values and true values of the rendering camera.",
        verdicts=[agree("found", with_="true", each="parameter", false_alarm=2e-3, title="measured against truth")],
    ),
}
