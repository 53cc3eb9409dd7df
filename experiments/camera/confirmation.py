"""Measured beside predicted: what the rendered frames say about the prediction, with its uncertainty."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq

from experiments.camera.records import CameraPrediction
from experiments.camera.rendered import Rendered
from optics.arrays import FloatArray

__all__ = ["Comparison", "compare"]


WIDEST_MAG = 3.0
UNFIT_SHARE = 0.05
"""Stars whose fit does not converge, or that look too sharp: known to so much of their number."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Comparison:
    """One quantity, measured in frames and predicted for the same stars and attitudes."""

    name: str  # What it is
    label: str  # What it is
    unit: str  # What it is
    measured: float  # Values
    predicted: float  # Values
    error: float  # Standard deviation of their difference
    n: int  # Samples behind the measured value

    @property
    def pull(self) -> float:
        """Difference in standard deviations."""
        return (self.measured - self.predicted) / self.error if self.error > 0 else float("nan")


def compare(prediction: CameraPrediction, rendered: Rendered) -> tuple[Comparison, ...]:
    """All comparisons of a run."""
    return (
        _electrons(prediction, rendered),
        _noise(prediction, rendered),
        _limit(prediction, rendered),
        _alarms(prediction, rendered),
        *_stars(prediction, rendered),
        *_attitude(prediction, rendered),
    )


def bright_stars(prediction: CameraPrediction, rendered: Rendered) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Errors (k, n, 2) [px], electrons and distances (n,) of the chart's bright stars that are fit in all readouts."""
    chart = rendered.chart
    good = (chart.magnitude == chart.bright_mag) & np.isfinite(chart.error_px).all(axis=(0, 2))
    return chart.error_px[:, good], chart.electrons[good], chart.radius_px[good]


def _electrons(prediction: CameraPrediction, rendered: Rendered) -> Comparison:
    """Light of the renderer, beside lens area times throughput by another trace with other rays."""
    chart = rendered.chart
    whole = chart.magnitude == chart.bright_mag
    kelvin = prediction.config.star.temperature_k
    expected = prediction.electrons(chart.magnitude[whole], kelvin, chart.radius_px[whole])
    # both are quadratures of the pupil: a part in a thousand is what they promise
    return Comparison(
        name="electrons",
        label=f"Electrons of a star of {chart.bright_mag:.2f} mag",
        unit="e-",
        measured=float(chart.electrons[whole].mean()),
        predicted=float(expected.mean()),
        error=1e-3 * float(expected.mean()),
        n=int(whole.sum()),
    )


def _noise(prediction: CameraPrediction, rendered: Rendered) -> Comparison:
    errors, electrons, radius = bright_stars(prediction, rendered)
    readouts, stars = errors.shape[:2]
    scale, star = prediction.state.pixel_arcsec, prediction.stars
    seen = float(np.sqrt(errors.var(axis=0, ddof=1).mean())) * scale
    expected = float(np.sqrt((star.sigma_at(star.centroid.noise_px, electrons, radius) ** 2).mean())) * scale
    samples = 2 * stars * (readouts - 1)
    # pixels differ in read noise: of the some 4 pi s^2 under a star each has its own
    pixel = prediction.processing.pixel
    under = max(4.0 * np.pi * (prediction.state.fwhm_px / 2.3548) ** 2 * stars, 1.0)
    chips = 0.5 * np.sqrt(pixel.floor_e4 / under) / pixel.floor_e2
    return Comparison(
        name="nea",
        label=f"NEA of a star of {rendered.chart.bright_mag:.2f} mag",
        unit="arcsec",
        measured=seen,
        predicted=expected,
        error=expected * float(np.hypot(1.0 / np.sqrt(2.0 * samples), chips)),
        n=samples,
    )


def _limit(prediction: CameraPrediction, rendered: Rendered) -> Comparison:
    """Shift of the predicted completeness curve that makes the chart's faint stars found as often as they were."""
    chart, star = rendered.chart, prediction.stars
    faint = chart.magnitude != chart.bright_mag
    electrons, radius, seen = chart.electrons[faint], chart.radius_px[faint], chart.found[:, faint].mean(axis=0)

    def share(shift_mag: float) -> FloatArray:
        return star.found_at(electrons * 10.0 ** (0.4 * shift_mag), radius)

    def excess(shift_mag: float) -> float:
        return float(share(shift_mag).mean() - seen.mean())

    limit = prediction.value("limiting_magnitude_mag")
    inside = excess(-WIDEST_MAG) < 0.0 < excess(WIDEST_MAG)
    shift = float(brentq(excess, -WIDEST_MAG, WIDEST_MAG)) if inside else float("nan")
    slope = (excess(0.02) - excess(-0.02)) / 0.04
    spread = (seen - share(0.0)).std(ddof=1) / np.sqrt(len(seen))  # stars differ; readouts of one star share its place
    return Comparison(
        name="limiting_magnitude",
        label="Limiting magnitude, half are found",
        unit="mag",
        measured=limit + shift,
        predicted=limit,
        error=float(spread / slope),
        n=int(seen.size * len(chart.found)),
    )


def _alarms(prediction: CameraPrediction, rendered: Rendered) -> Comparison:
    counts = np.concatenate([rendered.chart.false_alarms, rendered.sky.false_alarms])
    expected = prediction.value("false_alarms_per_frame") * len(counts)
    # Poisson, and the mean dark frame is the same in all frames: its noise repeats
    repeated = 1.0 + len(counts) / (1.0 + prediction.config.dark_frames)
    return Comparison(
        name="false_alarms",
        label=f"False alarms in {len(counts)} frames",
        unit="",
        measured=float(counts.sum()),
        predicted=expected,
        error=float(np.sqrt(expected * repeated + 1.0 + (0.1 * expected) ** 2)),
        n=int(counts.sum()),
    )


def _stars(prediction: CameraPrediction, rendered: Rendered) -> tuple[Comparison, ...]:
    forecast, frames = prediction.attitude, len(rendered.sky.found)
    variance = float(forecast.found_variance[:frames].sum())
    return tuple(
        Comparison(
            name=name,
            label=words,
            unit="",
            measured=float(seen.sum()),
            predicted=float(expected[:frames].sum()),
            error=float(np.sqrt(variance + 1.0 + (share * expected[:frames].sum()) ** 2)),
            n=frames,
        )
        for name, words, seen, expected, share in (
            ("stars", f"Stars found in {frames} frames of the sky", rendered.sky.found, forecast.found, 0.0),
            ("fit_stars", "of them fit for an attitude", rendered.sky.fit, forecast.stars, UNFIT_SHARE),
        )
    )


def _attitude(prediction: CameraPrediction, rendered: Rendered) -> tuple[Comparison, ...]:
    """Root mean square of the errors, beside that of the standard deviations predicted for the same attitudes."""
    error = rendered.sky.error_arcsec
    solved = np.isfinite(error).all(axis=1)
    sigma = prediction.attitude.total_arcsec[: len(error)][solved]
    found: list[Comparison] = []
    if not solved.any():
        return ()
    for name, columns, words in (("cross", slice(0, 2), "across"), ("roll", slice(2, 3), "roll")):
        seen, expected = error[solved][:, columns], sigma[:, columns]
        typical = float(np.sqrt((expected**2).mean()))
        # the mean square of normal errors of different sigma
        spread = float(np.sqrt(2.0 * (expected**4).sum())) / expected.size / (2.0 * typical)
        found.append(
            Comparison(
                name=f"attitude_{name}",
                label=f"Attitude {words}, RMS of {int(solved.sum())} frames",
                unit="arcsec",
                measured=float(np.sqrt((seen**2).mean())),
                predicted=typical,
                error=spread,
                n=int(seen.size),
            )
        )
    return tuple(found)
