"""Statistics of real and rendered frames, both reduced by the same code.

Every statistic is computed from a set of frames. The twin renders the set several times; the scatter of these sets is
the standard deviation of a single set, real or rendered; over the root of the number of sets, that of their mean.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from calib.attitude.identify_unknown_scale import BlindIdentifier
from calib.calibration.frame_attitudes import frame_attitude, predicted_residuals, split_half_error_arcsec
from calib.calibration.observations import Observations
from calib.detector.sky_photon_transfer import (
    SkyBlocks,
    averaging_ratio,
    neighbour_correlation,
    sky_blocks,
    tail_fraction,
)
from calib.flags import StarFlag, has_flag
from calib.measure.detection.filtered_noise import FilteredNoise
from calib.measure.detection.limiting_magnitude import limiting_magnitude
from calib.measure.statistics.robust import clipped_mean, quantile_sigma, rms_within
from calib.photometry.zero_point import fit_photometry
from calib.psf.gaussian_mixture import COLOUR_NAMES
from calib.psf.star_windows import isolated
from calib.records import SensorImage
from experiments.twin.measure import CameraFit, PreparedNight, star_fluxes
from experiments.twin.night import PAIR_PX, detections, field_stars, identify, masked_pixels
from optics.arrays import FloatArray, IntArray

THRESHOLDS_SIGMA = (5.0, 6.0)
CLIP_PX = 0.7
ISOLATED_PX = 8.0
"""Least distance of an isolated star from its neighbours."""
EDGE_PX = 4.0
"""Least distance of a star from the edge."""
BRIGHT_MAG = 1.5
"""Bright stars: brighter than the limiting magnitude by this."""
HALF_BIN_MAG = 0.25
"""Half width of the magnitude bin in which the median SNR is stated."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FrameStatistics:
    """Reduction of a frame: n catalogue stars, f false detections, m matched, isolated stars with a valid fit."""

    magnitude: FloatArray  # (n,) Magnitudes of the catalogue stars on the detector
    significance: FloatArray  # (n,) Significance of these stars; 0 if not detected
    false_significance: FloatArray  # (f,) Significance of detections without a star
    trail_detections: int  # Number of detections along lines; not false detections
    star_magnitude: FloatArray  # (m,)
    star_colour: IntArray  # (m,) Colour class
    width_px: FloatArray  # (m,) Width of a Gaussian fit
    residual_px: FloatArray  # (m, 2) Residual of the camera model, the attitude fitted to this frame
    position_px: FloatArray  # (m, 2)
    blocks: SkyBlocks
    fluxes: dict[str, Any]  # Columns of `star_fluxes`: isolated bright stars
    split_half_arcsec: FloatArray  # (3,) Half the difference of the attitudes from two halves of the stars
    solved: bool  # Whether the blind identification succeeds


def frame_statistics(
    prepared: PreparedNight,
    number: int,
    image: SensorImage,
    fit: CameraFit,
    identifier: BlindIdentifier,
    noise: FilteredNoise | None = None,
) -> FrameStatistics:
    """Reduce a frame with a measured camera; ``noise`` sets the detection limit in place of the frame's noise."""
    detected = detections(image, noise=noise)
    frame = replace(prepared.night.frames[number], image=image, detected=detected)
    rows, star_rows = frame.matched(fit.attitudes[number], fit.camera, PAIR_PX)
    table = detected.stars.select(rows)
    matched = Observations(
        pixel_px=table.pixel_px,
        covariance_px2=table.covariance[:, :2, :2] + fit.floor_px**2 * np.eye(2),
        direction=frame.direction[star_rows],
        frame=np.zeros(len(rows), np.int64),
        frames=1,
    )
    residual, used = predicted_residuals(matched, fit.camera)
    field = field_stars(frame, prepared.night.sky, fit.camera, frame_attitude(matched, fit.camera))
    inside = fit.camera.geometry.contains(field.position_px, margin_px=-EDGE_PX)
    significance, false = detected.match(field)
    on_trail = has_flag(detected.stars.flags[false], StarFlag.TRAIL)
    field_row = {int(row): k for k, row in enumerate(field.row)}
    field_rows = np.array([field_row.get(int(row), -1) for row in frame.rows[star_rows]], np.int64)
    good = used & (field_rows >= 0)
    good[good] &= isolated(field.position_px, field.magnitude, ISOLATED_PX)[field_rows[good]]
    good_rows = field_rows[good]
    return FrameStatistics(
        magnitude=field.magnitude[inside],
        significance=significance[inside],
        false_significance=detected.significance[false[~on_trail]],
        trail_detections=int(on_trail.sum()),
        star_magnitude=field.magnitude[good_rows],
        star_colour=field.colour_class[good_rows],
        width_px=table.width_px[good],
        residual_px=residual[good],
        position_px=table.pixel_px[good],
        blocks=sky_blocks(image.dn, masked_pixels(image, field, detected, prepared.hot, prepared.width_px)),
        fluxes=star_fluxes(prepared, [frame], [field], fit.noise, fit.psf),
        split_half_arcsec=split_half_error_arcsec(matched.select(used), fit.camera),
        solved=identify(detected, identifier)[0].ok,
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class Statistic:
    """Statistic of a set of frames."""

    key: str
    label: str
    unit: str
    value: float
    limit: float  # Allowed difference of twin and real; NaN where it is not judged
    relative: bool  # Whether the difference is relative to the real value


def joined(frames: Sequence[FrameStatistics], name: str) -> FloatArray:
    """A field of all frames, concatenated."""
    return np.concatenate([getattr(frame, name) for frame in frames])


def half_detected_mag(frames: Sequence[FrameStatistics], threshold: float) -> float:
    """Magnitude at which half of the stars are detected."""
    return limiting_magnitude(joined(frames, "magnitude"), joined(frames, "significance") >= threshold)


def statistics_of(frames: Sequence[FrameStatistics], limit_mag: float, airmass: FloatArray) -> list[Statistic]:
    """All statistics of a set; the magnitude classes follow from ``limit_mag``, the same for real and rendered."""
    out: list[Statistic] = []

    def add(key: str, label: str, value: float, unit: str = "", limit: float = np.nan, relative: bool = True) -> None:
        out.append(Statistic(key=key, label=label, unit=unit, value=float(value), limit=limit, relative=relative))

    significance = joined(frames, "significance")
    for sigma in THRESHOLDS_SIGMA:
        add(f"stars_{sigma:g}", f"stars in all frames, {sigma:g} sigma", (significance >= sigma).sum(), limit=0.02)
        label = f"magnitude at which half are detected, {sigma:g} sigma"
        add(f"limit_{sigma:g}_mag", label, half_detected_mag(frames, sigma), "mag", 0.05, relative=False)
    blocks = [frame.blocks for frame in frames]
    noise = float(np.mean([np.sqrt(np.nanmedian(block.variance_dn2)) for block in blocks]))
    add("noise_dn", "noise of the background, mean of the frames", noise, "DN", 0.01)
    _add_widths_and_residuals(add, frames, limit_mag)
    scatter = _scatter(frames)
    altitudes = {"all": ("", np.ones(len(frames), bool))}
    if np.isfinite(airmass).all() and np.ptp(airmass) > 0.1:
        low = airmass > 0.5 * (airmass.min() + airmass.max())
        altitudes = {"low": (", low frames", low), "high": (", high frames", ~low)}
    for name, (suffix, selected) in altitudes.items():
        add(f"scatter_{name}_mag", f"scatter of photometry{suffix}", clipped_mean(scatter[selected]), "mag", 0.15)
    bright_mag = limit_mag - BRIGHT_MAG
    in_bin = (np.abs(joined(frames, "magnitude") - bright_mag) < HALF_BIN_MAG) & (significance > 0)
    add("snr", f"signal over noise at {bright_mag:.1f} mag", np.median(significance[in_bin]))
    x, y, _ = neighbour_correlation(blocks)
    add("correlation", "correlation of neighbouring pixels", (x + y) / 2.0, limit=0.01, relative=False)
    for side, ratio in zip((2, 8, 32), averaging_ratio(blocks), strict=True):
        add(f"averaging_{side}", f"noise of means of {side} × {side} px over that of white noise", ratio)
    add("tail", "fraction of background pixels beyond 3 sigma", 100.0 * tail_fraction(blocks), "percent")
    across, roll = (
        float(np.sqrt(np.nanmean([np.mean(frame.split_half_arcsec[axes] ** 2) for frame in frames])))
        for axes in (slice(2), slice(2, 3))
    )
    add("attitude_arcsec", "attitude error across, from two halves of the stars", across, "arcsec")
    add("roll_arcsec", "attitude error in roll, from two halves of the stars", roll, "arcsec")
    solved = float(np.mean([frame.solved for frame in frames]))
    add("solved", "fraction of frames solved blind", solved, limit=0.0, relative=False)
    return out


def _add_widths_and_residuals(add: Any, frames: Sequence[FrameStatistics], limit_mag: float) -> None:
    """Widths of bright stars by colour, residuals by magnitude."""
    magnitude, width, colour, residual = (
        joined(frames, name) for name in ("star_magnitude", "width_px", "star_colour", "residual_px")
    )
    bright = magnitude < limit_mag - BRIGHT_MAG
    add("width_px", "width of stars, Gaussian fit", clipped_mean(width[bright]), "px", 0.02)
    add("width_spread_px", "spread of the width", quantile_sigma(width[bright]), "px", 0.25)
    for k, colour_name in enumerate(COLOUR_NAMES):
        mean = clipped_mean(width[bright & (colour == k)])
        add(f"width_{k}_px", f"width, stars {colour_name}", mean, "px", 0.04)
    edges = (-np.inf, limit_mag - 2.0, limit_mag - 1.0, np.inf)
    for low, high, name in zip(edges, edges[1:], ("bright", "middle", "faint"), strict=False):
        rms = rms_within(residual[(magnitude >= low) & (magnitude < high)], CLIP_PX)
        add(f"residual_{name}_px", f"residual of the camera, {name} stars", rms, "px", 0.10)


def _scatter(frames: Sequence[FrameStatistics]) -> FloatArray:
    """Photometric scatter of each frame [mag] about the fit to all."""
    columns: dict[str, Any] = {
        name: np.concatenate([frame.fluxes[name] for frame in frames]) for name in frames[0].fluxes
    }
    columns["frame"] = np.repeat(np.arange(len(frames)), [len(frame.fluxes["frame"]) for frame in frames])
    return fit_photometry(**columns, frames=len(frames)).scatter_mag
