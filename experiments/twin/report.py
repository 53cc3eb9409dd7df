"""Results of a run: records of numbers, tables, curves, verdicts, pictures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure
from scipy.stats import norm
from scipy.stats import t as student

from experiments.harness.drawings import bars, curves
from experiments.harness.quantities import Outcome, Quantities, shown_unit
from experiments.harness.sections import Section, Verdict, agree, col
from experiments.harness.summary import Criterion, Measured
from experiments.twin.classify import FEATURES, Told
from experiments.twin.compare import (
    FrameStats,
    false_detections,
    half_magnitudes,
    limit_of,
    statistics_of,
)
from experiments.twin.hold_out import HeldOut
from experiments.twin.measure import CameraFit, Centroids, residuals
from experiments.twin.photometry import COLOUR_KNOTS
from experiments.twin.prescription import LensPose
from experiments.twin.synthetic import KnownNight, true_values
from experiments.twin.twin import Twin
from optics.arrays import FloatArray

if TYPE_CHECKING:
    from experiments.twin.pipeline import Reduced

FALSE_ALARM = 0.01
COMPLETENESS_LIMIT = 0.03
FRAME_LIMIT, NOISE_LIMIT = 0.07, 0.01
FALSE_LIMIT_SIGMA = float(norm.isf(0.5 * FALSE_ALARM))
FEWEST_IN_BIN = 30
STRETCH_PERCENT = (20.0, 99.7)


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraNumbers:
    """Measured properties of the camera."""

    frames: int = col("Frames solved", json="frames_solved")
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


def camera_numbers(reduced: Reduced, whole: CameraFit, compared: HeldOut, limit_mag: float) -> CameraNumbers:
    """The camera in numbers."""
    made, noise, light = whole.calibration, whole.noise, whole.photometry
    names, sigma = made.model.parameter_names, np.sqrt(np.diag(made.covariance))
    pitch = reduced.pitch_mm

    def parameter(name: str, scale: float = 1.0) -> Measured:
        if name not in names:
            return Measured(value=float("nan"))
        at = names.index(name)
        return Measured(value=float(made.model.parameters[at]) * scale, uncertainty=float(sigma[at]) * scale)

    geometry = made.model.geometry
    edges = made.model.unproject(geometry.centre_px + np.array([[-0.5, 0.0], [0.5, 0.0]]) * geometry.width_px)
    corners = geometry.corners_px
    focal = parameter("focal_length_mm", 1.0 / pitch)
    ray = made.model.unproject(corners)
    principal = geometry.centre_px + np.nan_to_num([parameter("x0_px").value, parameter("y0_px").value])
    ideal = principal + focal.value * ray[:, :2] / ray[:, 2:]
    psf_sigma = np.sqrt(np.diag(whole.psf.covariance))
    site = reduced.zenith
    width = whole.psf.width_px((np.array([whole.psf.size_px]) - 1.0) / 2.0, np.array([1]))[0]
    return CameraNumbers(
        frames=len(reduced.known.night),
        frames_given=len(reduced.solved),
        order=whole.order,
        focal_length_px=focal,
        focal_length_mm=parameter("focal_length_mm"),
        field_width_deg=float(np.degrees(np.arccos(np.clip(edges[0] @ edges[1], -1, 1)))),
        centre_x_px=parameter("x0_px"),
        centre_y_px=parameter("y0_px"),
        corner_px=float(np.linalg.norm(corners - ideal, axis=1).mean()),
        floor_px=whole.floor_px,
        width_px=Measured(value=float(width), uncertainty=float(width * np.hypot(psf_sigma[3], psf_sigma[4]) / 2.0)),
        gain_e_per_dn=Measured(value=noise.gain_e_per_dn, uncertainty=noise.gain_error_e_per_dn, n=noise.blocks),
        read_noise_low_e=noise.read_noise_e[0],
        read_noise_high_e=noise.read_noise_e[1],
        black_low_dn=noise.black_level_dn[0],
        black_high_dn=noise.black_level_dn[1],
        dsnu_dn=Measured(value=noise.dsnu_dn, uncertainty=noise.dsnu_error_dn),
        prnu_percent=Measured(value=100.0 * noise.prnu, uncertainty=100.0 * noise.prnu_error),
        hot_pixels=int(reduced.known.hot.sum()),
        saturation_dn=reduced.saturation_dn,
        zero_point_mag=light.zero_point_above_mag or Measured(value=float("nan")),
        extinction_mag=light.extinction_mag,
        vignetting_mag=Measured(value=float(light.loss_at(np.ones(1))[0]), uncertainty=light.loss_error_at(1.0)),
        limit_mag=limit_mag,
        latitude_deg=None if site is None else Measured(value=site.latitude_deg, uncertainty=site.error_deg),
        longitude_deg=None if site is None else Measured(value=site.longitude_deg, uncertainty=site.error_deg),
        refraction_arcsec=None
        if reduced.refraction_arcsec is None
        else Measured(value=reduced.refraction_arcsec[0], uncertainty=reduced.refraction_arcsec[1]),
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameNumbers:
    """One frame of the folder."""

    name: str = col("Frame", shown=False)
    found: int = col("Detections")
    identified: int = col("Identified")
    seconds: float = col("Time", "s", ".2f", json="")
    background_dn: float = col("Background", "DN", ".0f")
    stars: float = col("Stars at 5 sigma", "", ".0f")
    rendered_stars: Measured = col("Twin")
    off_percent: float = col("Difference", "percent", ".1f")
    noise_dn: float = col("Noise", "DN", ".3f")
    rendered_noise_dn: Measured = col("Twin's noise", "DN")
    noise_percent: float = col("Difference", "percent", ".2f", key="noise_off_percent")
    scatter_mag: float = col("Scatter of photometry", "mag", ".3f")
    trail: int = col("Detections on trails")


def frame_numbers(reduced: Reduced, whole: CameraFit, compared: HeldOut) -> list[FrameNumbers]:
    """Solved frames, real and rendered."""
    out = []
    for number, row in enumerate(reduced.rows):
        one, real = reduced.solved[row], compared.real[number]
        sets = [frames[number] for frames in compared.sets]
        stars = _stars(real)
        many, noise = np.array([_stars(s) for s in sets], float), np.array([_noise(s) for s in sets])
        out.append(
            FrameNumbers(
                name=one.name,
                found=len(one.seen.stars),
                identified=one.identified,
                seconds=one.seconds,
                background_dn=float(np.median(real.blocks.level_dn)),
                stars=stars,
                rendered_stars=_of(many),
                off_percent=100.0 * (many.mean() / max(stars, 1) - 1.0),
                noise_dn=_noise(real),
                rendered_noise_dn=_of(noise),
                noise_percent=100.0 * (noise.mean() / _noise(real) - 1.0),
                scatter_mag=float(whole.photometry.scatter_mag[number]),
                trail=real.trail,
            )
        )
    return out


def _stars(one: FrameStats) -> int:
    return int((one.height >= 5.0).sum())


def _noise(one: FrameStats) -> float:
    return float(np.sqrt(np.nanmedian(one.blocks.variance_dn2)))


def _of(values: FloatArray) -> Measured:
    """Mean of the rendered sets, and its standard deviation."""
    return Measured(
        value=float(values.mean()), uncertainty=float(values.std(ddof=1) / np.sqrt(len(values))), n=len(values)
    )


def _share(values: FloatArray, spread: float) -> Measured:
    """Mean of the rendered sets; ``spread`` is the standard deviation of one."""
    return Measured(value=float(values.mean()), uncertainty=spread / np.sqrt(len(values)), n=len(values))


@dataclass(frozen=True, slots=True, kw_only=True)
class OrderNumbers:
    """A camera model, each frame predicted from the others."""

    name: str = col("Model", shown=False)
    parameters: int = col("Parameters")
    chi2: float = col("χ² per degree of freedom", "", ".4f", key="chi2")
    residual_px: float = col("Residual of predicted frames", "px", ".4f", key="predicted_residual_px")


@dataclass(frozen=True, slots=True, kw_only=True)
class TransferPoint:
    """Blocks of like background."""

    level_dn: float = col("Background", "DN", ".1f")
    variance_dn2: float = col("Variance of a pixel", "{DN2}", ".2f")
    fitted_dn2: float = col("Photon transfer and pattern", "{DN2}", ".2f")


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

    def of(one: Centroids) -> tuple[float, float]:
        left = residuals(one.observations, fit.camera, fit.attitudes)
        bright = (one.magnitude < limit_mag - 1.5) & (np.linalg.norm(left, axis=1) < 0.7)
        if bright.sum() < 8:
            return float("nan"), float("nan")
        return float(np.sqrt((left[bright] ** 2).mean())), float(np.sqrt((one.noise_px[bright] ** 2).mean()))

    (gaussian, noise), (fitted, own) = of(fit.gaussian), of(fit.fitted)
    method = compared.bias.floor_px
    left = fitted**2 - own**2
    return [
        Cause(name="Gaussian fits, total residual", part_px=gaussian),
        Cause(name="Gaussian fits, noise of the centroids", part_px=noise),
        Cause(name="Gaussian fits, S-curve (no error of PSF fits)", part_px=_root(gaussian**2 - fitted**2)),
        Cause(name="PSF fits, total residual", part_px=fitted),
        Cause(name="PSF fits, noise of the centroids", part_px=own),
        Cause(name="PSF fits, error of the method (from rendered frames)", part_px=method),
        Cause(name="PSF fits, remainder (seeing, catalogue, PSF)", part_px=_root(left - method**2)),
    ]


def _root(square: float) -> float:
    return float(np.sqrt(max(square, 0.0)))


@dataclass(frozen=True, slots=True, kw_only=True)
class Compared:
    """A statistic of real and of rendered frames."""

    key: str = col("Key", shown=False)
    unit: str = col("Unit", json="")
    real: Measured = col("Real", "{statistic}")
    twin: Measured = col("Twin", "{statistic}", key="rendered")
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
    unit: str = col("Unit", json="")
    found: Measured = col("Measured", "{parameter}")
    true: float = col("Truth", "{parameter}", ".5g", key="truth")
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


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Sections:
    """All that a run found, as records of its sections."""

    reduced: Reduced
    whole: CameraFit
    compared: HeldOut
    twin: Twin
    told: Told | None
    truth: KnownNight | None
    name: str
    pose: LensPose | None = None
    prescription: str = ""

    def records(self) -> dict[str, Any]:
        """Section -> record or records."""
        real, reduced = self.compared.real, self.reduced
        limit = limit_of(real, 5.0)
        numbers = camera_numbers(reduced, self.whole, self.compared, limit)
        noise = self.whole.noise
        light = self.whole.photometry
        return {
            "kept": Kept(
                name=self.name,
                twin=self.twin,
                limit_mag=limit,
                real=tuple(one.image.dn for one in reduced.known.night.frames),
                rendered=tuple(one.dn for one in self.compared.images),
                notes=reduced.notes,
                prescription=self.prescription,
            ),
            "camera": numbers,
            "frames": frame_numbers(reduced, self.whole, self.compared),
            "orders": [
                OrderNumbers(name=one.name, parameters=one.parameters, chi2=one.mean, residual_px=one.residual_px)
                for one in reduced.orders
            ]
            or None,
            "transfer": [
                TransferPoint(level_dn=float(m), variance_dn2=float(v), fitted_dn2=float(noise.variance_dn2(m)))
                for m, v in zip(noise.levels_dn, noise.variances_dn2, strict=True)
            ],
            "colours": [
                ColourPoint(
                    colour=float(COLOUR_KNOTS[k]),
                    measured_mag=Measured(
                        value=float(light.colour_mag[k]), uncertainty=float(light.colour_error_mag[k])
                    ),
                    twin_mag=float(self.twin.response_mag[k]),
                )
                for k in np.flatnonzero(np.isfinite(light.colour_mag))
            ],
            "causes": causes(self.whole, self.compared, limit),
            "comparison": self._statistics(limit),
            "completeness": self._completeness(limit),
            "detected": self._detected(),
            "features": None
            if self.told is None
            else [Feature(name=name, effect=float(one)) for name, one in zip(FEATURES, self.told.effect, strict=True)],
            "pose": self.pose,
            "truth": None if self.truth is None else self._truth(self.truth, numbers),
        }

    def _statistics(self, limit: float) -> list[Compared]:
        compared = self.compared
        real = statistics_of(compared.real, limit, compared.airmass)
        sets = [statistics_of(one, limit, compared.airmass) for one in compared.sets]
        out = []
        for statistic, value in real.items():
            drawn = np.array([one[statistic] for one in sets])
            spread = float(drawn.std(ddof=1))
            scale = value if statistic.relative and value else 1.0
            off = (float(drawn.mean()) - value) / scale
            error = spread * np.sqrt(1.0 + 1.0 / len(drawn)) / abs(scale)
            judged = np.isfinite(statistic.limit) and np.isfinite(off)
            out.append(
                Compared(
                    key=f"{statistic.key}|{statistic.label}|{statistic.unit}",
                    unit=shown_unit(statistic.unit),
                    real=Measured(value=value, unit=statistic.unit, uncertainty=spread),
                    twin=_of(drawn),
                    off=Measured(value=off, uncertainty=float(error)),
                    allowed=float(statistic.limit),
                    within=("yes" if abs(off) <= statistic.limit else "no") if judged else "",
                )
            )
        return out

    def _completeness(self, limit: float) -> list[HalfMagnitude]:
        edges = np.arange(np.floor(2.0 * limit) / 2.0 - 1.5, limit + 1.01, 0.5)
        five, six = (
            [half_magnitudes(one, edges, sigma) for one in (self.compared.real, *self.compared.sets)]
            for sigma in (5.0, 6.0)
        )
        out = []
        for k in range(len(edges) - 1):
            count = int(five[0][0][k])
            if count < FEWEST_IN_BIN:
                continue
            shares = [np.array([one[1][k] for one in some]) for some in (five, six)]
            # of one set: every star is found or not
            chance = [np.mean(one) for one in shares]
            spread = [float(np.sqrt(p * (1.0 - p) / count)) for p in chance]
            real = [Measured(value=float(s[0]), uncertainty=e, n=count) for s, e in zip(shares, spread, strict=True)]
            out.append(
                HalfMagnitude(
                    magnitude_mag=float(edges[k] + 0.25),
                    count=count,
                    real_5=real[0],
                    twin_5=_share(shares[0][1:], spread[0]),
                    real_6=real[1],
                    twin_6=_share(shares[1][1:], spread[1]),
                )
            )
        return out

    def _detected(self) -> Detected:
        real, sets = self.compared.real, self.compared.sets

        def both(sigma: float) -> tuple[Measured, Measured]:
            seen = false_detections(real, sigma)
            drawn = np.array([false_detections(one, sigma) for one in sets], float)
            mean = float(drawn.mean())
            return (
                Measured(value=float(seen), uncertainty=float(np.sqrt(max(seen, 1)))),
                Measured(value=mean, uncertainty=float(np.sqrt(max(mean, 0.5) / len(drawn)))),
            )

        (real_5, twin_5), (real_6, twin_6) = both(5.0), both(6.0)
        spread = np.hypot(real_5.uncertainty or 1.0, twin_5.uncertainty or 0.0)
        told = self.told
        best = "" if told is None else FEATURES[int(np.argmax(np.abs(told.effect)))]
        return Detected(
            false_5=real_5,
            false_twin_5=twin_5,
            false_6=real_6,
            false_twin_6=twin_6,
            false_pull=float((twin_5.value - real_5.value) / spread),
            trails=sum(one.trail for one in real),
            area=None if told is None else Measured(value=told.area, uncertainty=told.error, n=told.stars),
            told_by=best,
        )

    def _truth(self, truth: KnownNight, numbers: CameraNumbers) -> list[TrueNumber]:
        out = []
        for name, unit, found, true in true_values(truth, numbers, self.whole):
            pull = (found.value - true) / (found.uncertainty or np.nan)
            out.append(
                TrueNumber(name=f"{name}|{unit}", unit=shown_unit(unit), found=found, true=true, pull=float(pull))
            )
        return out


def compared_words(statistics: Sequence[Compared], detected: Detected) -> list[str]:
    """Agreement of twin and camera for users of its frames: a line per judged statistic."""
    out = []
    for one in statistics:
        _, label, unit = one.key.split("|")
        if one.within:
            values = f"{one.real.value:.4g}, rendered {one.twin.value:.4g}{' ' + unit if unit else ''}"
            out.append(f"{label}: real {values}{'' if one.within == 'yes' else ' (above the allowed difference)'}")
    if detected.area is not None:
        out.append(
            f"star windows: area under the ROC curve of the classifier {detected.area.value:.2f} (0.5: not separable)"
        )
    return out


def axes(config: Any) -> Quantities:
    """No dimension is known before the frames are read."""
    del config
    return Quantities()


def _named(dim: str, label: str, field: str = "name") -> Any:
    """Axis whose coordinates are names; of keys "key|label|unit" the parts."""

    def describe(q: Quantities, rows: Sequence[Any]) -> None:
        parts = [str(getattr(one, field)).split("|") for one in rows]
        keys = [one[0] for one in parts]
        if len(set(keys)) < len(keys):
            keys = [f"{n + 1} {key}" for n, key in enumerate(keys)]
        units = [one[-1] for one in parts] if all(len(one) > 1 for one in parts) else ()
        names = [one[1] if len(one) > 2 else one[0] for one in parts]
        q.axis(dim, keys, label, names=names, units=units)

    return describe


def _verdict(judge: Any, *names: str) -> Verdict:
    judge.names = names
    verdict: Verdict = judge
    return verdict


def _error(quantity: Any) -> FloatArray:
    """Standard deviations; 0 where there are none."""
    return np.zeros(np.shape(quantity.values)) if quantity.error is None else np.nan_to_num(quantity.error)


def _z(freedom: float = np.inf, alarm: float = FALSE_ALARM) -> float:
    """Standard deviations that noise alone exceeds by a false alarm; ``freedom`` of the deviation's own estimate."""
    return float(student.isf(alarm / 2.0, freedom))


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
        limit = allowed + _z(outcome.config.realisations - 1) * float(_error(off))
        words = "see the table of causes and the features of the classifier"
        out.append(_criterion(f"twin against real: {label}", float(abs(off.values)), limit, words))
    return out


def _complete(outcome: Outcome) -> list[Criterion]:
    out = []
    for sigma in ("5", "6"):
        real, twin = outcome.quantity(f"real_{sigma}"), outcome.quantity(f"twin_{sigma}")
        off = np.abs(real.values - twin.values)
        error = np.hypot(_error(real), _error(twin))
        worst = int(np.argmax(off - _z() * error))
        limit = COMPLETENESS_LIMIT + _z() * float(error[worst])
        name = f"completeness per half magnitude, {sigma} sigma: twin against real, the worst"
        out.append(_criterion(name, float(off[worst]), limit))
    return out


def _each_frame(outcome: Outcome) -> list[Criterion]:
    out = []
    for name, field, base, allowed in (
        ("stars per frame", "off_percent", "stars", FRAME_LIMIT),
        ("noise of the background per frame", "noise_percent", "noise_dn", NOISE_LIMIT),
    ):
        off = np.abs(outcome.values(f"frame_{field}")) / 100.0
        drawn = outcome.quantity("frame_rendered_stars" if base == "stars" else "frame_rendered_noise_dn")
        sets = float(outcome.config.realisations)
        level = outcome.values(f"frame_{base}")
        # the scatter of a few sets says little of one frame: pooled over the frames, as counts scatter
        relative = _error(drawn) * np.sqrt(sets + 1.0) / np.sqrt(level)
        error = np.sqrt(np.mean(relative**2) / level)
        worst = int(np.argmax(off - error))
        limit = allowed + _z(len(off) * (sets - 1.0), FALSE_ALARM / len(off)) * float(error[worst])
        out.append(_criterion(f"{name}: twin against real, the worst of {len(off)}", float(off[worst]), limit))
    return out


def _false(outcome: Outcome) -> list[Criterion]:
    value = float(abs(outcome.value("false_pull")))
    return [
        Criterion(
            name="false detections at 5 sigma: twin against real",
            value=value,
            limit=FALSE_LIMIT_SIGMA,
            unit="sigma",
            false_alarm=2.0 * float(norm.sf(FALSE_LIMIT_SIGMA)),
        )
    ]


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
        prefix="frame_",
        place="frames[frame]",
        caption="Frames, and frames rendered by twins measured without them.",
        verdicts=[_verdict(_each_frame, "frame_off_percent", "frame_noise_percent")],
    ),
    "orders": Section(
        record=OrderNumbers,
        dim="order_name",
        axes=_named("order_name", "Model"),
        prefix="order_",
        place="orders[order_name]",
        caption="Camera models, cross-validated: each frame predicted from the others.",
        note="Chosen: the simplest within one standard error of the best, paired by frames.",
    ),
    "transfer": Section(
        record=TransferPoint,
        dim="level",
        along="level_dn",
        prefix="transfer_",
        place="photon_transfer[level]",
        figures={
            "photon_transfer": curves(
                "level", points="transfer_variance_dn2", lines="transfer_fitted_dn2", aspect_ratio=0.4
            )
        },
    ),
    "colours": Section(
        record=ColourPoint,
        dim="knot",
        along="colour",
        prefix="colour_",
        place="colour_terms[knot]",
        caption="Colour term, zero at 5040 K.",
        figures={
            "colour_term": curves("knot", points="colour_measured_mag", lines="colour_twin_mag", aspect_ratio=0.4)
        },
    ),
    "causes": Section(
        record=Cause,
        dim="cause",
        axes=_named("cause", "Cause"),
        prefix="cause_",
        place="residuals[cause]",
        caption="Residuals of bright stars after the calibration; contributions add in quadrature.",
    ),
    "comparison": Section(
        record=Compared,
        dim="statistic",
        axes=_named("statistic", "Statistic", "key"),
        place="comparison[statistic]",
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
        place="completeness[bin]",
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
        verdicts=[_verdict(_false, "false_pull")],
    ),
    "features": Section(
        record=Feature,
        dim="feature",
        axes=_named("feature", "Feature"),
        prefix="feature_",
        place="features[feature]",
        caption="Differences between real and rendered star windows.",
        figures={"feature_bars": bars("feature", bars="feature_effect")},
    ),
    "pose": Section(
        record=LensPose,
        prefix="lens_",
        vertical=True,
        caption="Detector position behind the known lens, from the frames.",
    ),
    "truth": Section(
        record=TrueNumber,
        dim="parameter",
        axes=_named("parameter", "Number"),
        prefix="known_",
        place="truth[parameter]",
        caption="Measured values and true values of the rendering camera.",
        verdicts=[
            agree("known_found", with_="known_true", each="parameter", false_alarm=2e-3, title="measured against truth")
        ],
    ),
}
