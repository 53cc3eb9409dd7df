"""Real frames and the twin's, reduced by the same code: statistics of each.

Every statistic is computed from a set of frames. The twin renders the set several times; the scatter of these sets is
the standard deviation of one set, real or rendered, and divided by the root of their number that of the twin's mean.
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

THRESHOLDS = (5.0, 6.0)
CLIP_PX = 0.7
ISOLATED_PX, EDGE_PX = 8.0, 4.0
BRIGHT_MAG, BIN_MAG = 1.5, 0.25
"""Magnitudes above the limit of bright stars, and half of the bin in which their significance is stated."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FrameStatistics:
    """One frame, reduced."""

    magnitude: FloatArray  # (n,) Catalogue stars on the detector
    height: FloatArray  # (n,) Significance at which each was detected; 0 if it was not
    false: FloatArray  # (f,) Significance of detections without a star
    trail: int  # Detections along lines, which are not counted as false
    star_magnitude: FloatArray  # (m,) Of matched, isolated, well measured stars
    star_colour: IntArray  # (m,) Their colour class
    width_px: FloatArray  # (m,) Of a Gaussian fit
    residual_px: FloatArray  # (m, 2) Of the camera, attitude of this frame
    position_px: FloatArray  # (m, 2)
    blocks: SkyBlocks
    fluxes: dict[str, Any]  # Of the isolated bright stars
    halves_arcsec: FloatArray  # (3,) Between the attitudes by every other star, over 2
    solved: bool  # Blind


def frame_statistics(
    known: PreparedNight,
    number: int,
    image: SensorImage,
    fit: CameraFit,
    identifier: BlindIdentifier,
    noise: FilteredNoise | None = None,
) -> FrameStatistics:
    """Reduce one frame with the camera that is believed; ``noise`` sets the limit of detection, if not the frame's."""
    detected = detections(image, noise=noise)
    frame = replace(known.night.frames[number], image=image, detected=detected)
    rows, stars = frame.matched(fit.attitudes[number], fit.camera, PAIR_PX)
    table = detected.stars.select(rows)
    matched = Observations(
        pixel_px=table.pixel_px,
        covariance_px2=table.covariance[:, :2, :2] + fit.floor_px**2 * np.eye(2),
        direction=frame.direction[stars],
        frame=np.zeros(len(rows), np.int64),
        frames=1,
    )
    residual, used = predicted_residuals(matched, fit.camera)
    field = field_stars(frame, known.night.sky, fit.camera, frame_attitude(matched, fit.camera))
    inside = fit.camera.geometry.contains(field.position_px, margin_px=-EDGE_PX)
    height, false = detected.pairs(field)
    trail = has_flag(detected.stars.flags[false], StarFlag.TRAIL)
    row_of = {int(row): k for k, row in enumerate(field.row)}
    at = np.array([row_of.get(int(row), -1) for row in frame.rows[stars]], np.int64)
    good = used & (at >= 0)
    good[good] &= isolated(field.position_px, field.magnitude, ISOLATED_PX)[at[good]]
    return FrameStatistics(
        magnitude=field.magnitude[inside],
        height=height[inside],
        false=detected.significance[false[~trail]],
        trail=int(trail.sum()),
        star_magnitude=field.magnitude[at[good]],
        star_colour=field.colour_class[at[good]],
        width_px=table.width_px[good],
        residual_px=residual[good],
        position_px=table.pixel_px[good],
        blocks=sky_blocks(image.dn, masked_pixels(image, field, detected, known.hot, known.width_px)),
        fluxes=star_fluxes(known, [frame], [field], fit.noise, fit.psf),
        halves_arcsec=split_half_error_arcsec(matched.select(used), fit.camera),
        solved=identify(detected, identifier)[0].ok,
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class Statistic:
    """Statistic of the comparison."""

    key: str
    label: str
    unit: str
    value: float
    limit: float  # Largest deviation that is allowed; NaN where it is only shown
    relative: bool  # Whether the deviation is relative to the real value


def joined(frames: Sequence[FrameStatistics], name: str) -> FloatArray:
    """A column of all frames."""
    return np.concatenate([getattr(frame, name) for frame in frames])


def limit_of(frames: Sequence[FrameStatistics], threshold: float) -> float:
    """Magnitude at which half of the stars are detected."""
    return limiting_magnitude(joined(frames, "magnitude"), joined(frames, "height") >= threshold)


def statistics_of(frames: Sequence[FrameStatistics], limit_mag: float, airmass: FloatArray) -> list[Statistic]:
    """All statistics of a set; ``limit_mag`` sets the classes of magnitude, the same for real and twin."""
    out: list[Statistic] = []

    def add(key: str, label: str, value: float, unit: str = "", limit: float = np.nan, relative: bool = True) -> None:
        out.append(Statistic(key=key, label=label, unit=unit, value=float(value), limit=limit, relative=relative))

    height = joined(frames, "height")
    for sigma in THRESHOLDS:
        add(f"stars_{sigma:g}", f"stars in all frames, {sigma:g} sigma", (height >= sigma).sum(), limit=0.02)
        words = f"magnitude at which half are detected, {sigma:g} sigma"
        add(f"limit_{sigma:g}_mag", words, limit_of(frames, sigma), "mag", 0.05, relative=False)
    blocks = [frame.blocks for frame in frames]
    noise = float(np.mean([np.sqrt(np.nanmedian(block.variance_dn2)) for block in blocks]))
    add("noise_dn", "noise of the background, mean of the frames", noise, "DN", 0.01)
    _add_shapes(add, frames, limit_mag)
    scatter = _scatter(frames)
    add_scatter = {"all": ("", np.ones(len(frames), bool))}
    if np.isfinite(airmass).all() and np.ptp(airmass) > 0.1:
        deep = airmass > 0.5 * (airmass.min() + airmass.max())
        add_scatter = {"low": (", low frames", deep), "high": (", high frames", ~deep)}
    for name, (words, chosen) in add_scatter.items():
        add(f"scatter_{name}_mag", f"scatter of photometry{words}", clipped_mean(scatter[chosen]), "mag", 0.15)
    rows = (np.abs(joined(frames, "magnitude") - (limit_mag - BRIGHT_MAG)) < BIN_MAG) & (height > 0)
    add("snr", f"signal over noise at {limit_mag - BRIGHT_MAG:.1f} mag", np.median(height[rows]))
    x, y, _ = neighbour_correlation(blocks)
    add("correlation", "correlation of neighbouring pixels", (x + y) / 2.0, limit=0.01, relative=False)
    for side, ratio in zip((2, 8, 32), averaging_ratio(blocks), strict=True):
        add(f"averaging_{side}", f"noise of means of {side} × {side} px over that of white noise", ratio)
    add("tail", "fraction of background pixels beyond 3 sigma", 100.0 * tail_fraction(blocks), "percent")
    across, roll = (
        float(np.sqrt(np.nanmean([np.mean(frame.halves_arcsec[axes] ** 2) for frame in frames])))
        for axes in (slice(2), slice(2, 3))
    )
    add("attitude_arcsec", "attitude error across, from two halves of the stars", across, "arcsec")
    add("roll_arcsec", "attitude error in roll, from two halves of the stars", roll, "arcsec")
    solved = float(np.mean([frame.solved for frame in frames]))
    add("solved", "fraction of frames solved blind", solved, limit=0.0, relative=False)
    return out


def _add_shapes(add: Any, frames: Sequence[FrameStatistics], limit_mag: float) -> None:
    """Widths of bright stars by colour, residuals by magnitude."""
    magnitude, width, colour, residual = (
        joined(frames, name) for name in ("star_magnitude", "width_px", "star_colour", "residual_px")
    )
    bright = magnitude < limit_mag - BRIGHT_MAG
    add("width_px", "width of stars, Gaussian fit", clipped_mean(width[bright]), "px", 0.02)
    add("width_spread_px", "spread of the width", quantile_sigma(width[bright]), "px", 0.25)
    for k, words in enumerate(COLOUR_NAMES):
        mean = clipped_mean(width[bright & (colour == k)])
        add(f"width_{k}_px", f"width, stars {words}", mean, "px", 0.04)
    edges = (-np.inf, limit_mag - 2.0, limit_mag - 1.0, np.inf)
    for low, high, words in zip(edges, edges[1:], ("bright", "middle", "faint"), strict=False):
        rms = rms_within(residual[(magnitude >= low) & (magnitude < high)], CLIP_PX)
        add(f"residual_{words}_px", f"residual of the camera, {words} stars", rms, "px", 0.10)


def _scatter(frames: Sequence[FrameStatistics]) -> FloatArray:
    """Photometric scatter of each frame [mag], all frames fitted together."""
    columns: dict[str, Any] = {
        name: np.concatenate([frame.fluxes[name] for frame in frames]) for name in frames[0].fluxes
    }
    columns["frame"] = np.repeat(np.arange(len(frames)), [len(frame.fluxes["frame"]) for frame in frames])
    return fit_photometry(**columns, frames=len(frames)).scatter_mag
