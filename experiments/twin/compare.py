"""Real frames and the twin's, reduced by the same code: statistics of each, and their differences.

Every statistic is computed from a set of frames. The twin renders the set several times; the scatter of these sets is
the standard deviation of one set, real or rendered, and divided by the root of their number that of the twin's mean.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import minimize
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from calib.calibration.observations import Observations
from calib.detector.sky_transfer import SkyBlocks, averaging_ratio, neighbour_correlation, sky_blocks
from calib.flags import StarFlag, has_flag
from calib.measure.filtered_noise import FilteredNoise
from calib.records import SensorImage
from experiments.twin.camera import predicted_residuals
from experiments.twin.measure import CameraFit, Prepared, attitude_of, star_fluxes
from experiments.twin.night import FieldStars, Night, field_stars, star_mask
from experiments.twin.photometry import fit_photometry
from experiments.twin.psf import COLOUR_NAMES
from experiments.twin.solve import Detections, detections, matched
from optics.arrays import FloatArray, IntArray
from optics.attitude import attitude_error_arcsec

PAIR_PX = 1.5
"""A detection within this distance of a catalogue star is that star."""
HIGH_SIGMA = 6.0
CLIP_PX = 0.7
FEWEST = 8
TAIL_SIGMA = 3.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FrameStats:
    """One frame, reduced."""

    magnitude: FloatArray  # (n,) Catalogue stars on the detector
    height: FloatArray  # (n,) Significance at which each was found; 0 if it was not
    false: FloatArray  # (f,) Significance of detections without a star
    false_px: FloatArray  # (f, 2) Where they are
    trail: int  # Detections along lines, which are not counted as false
    star_magnitude: FloatArray  # (m,) Of matched, isolated, well measured stars
    star_colour: IntArray  # (m,) Their colour class
    width_px: FloatArray  # (m,) Of a Gaussian fit
    residual_px: FloatArray  # (m, 2) Of the camera, attitude of this frame
    place_px: FloatArray  # (m, 2)
    blocks: SkyBlocks
    fluxes: object  # Of the isolated bright stars, `experiments.twin.measure.Fluxes`
    attitude: Rotation
    halves_arcsec: FloatArray  # (3,) Between the attitudes by every other star, over 2
    solved: bool  # Blind
    seen: Detections


def frame_stats(
    known: Prepared,
    number: int,
    image: SensorImage,
    fit: CameraFit,
    solve: Callable[[Detections], bool],
    noise: FilteredNoise | None = None,
) -> FrameStats:
    """Reduce one frame with the camera that is believed; ``noise`` sets the limit of detection, if not the frame's."""
    seen = detections(image, noise=noise)
    frame = replace(known.night.frames[number], image=image, seen=seen)
    rows, stars = matched(seen, frame.direction, fit.attitudes[number], fit.camera, PAIR_PX)
    table = seen.stars
    here = Observations(
        pixel_px=table.pixel_px[rows],
        covariance_px2=table.covariance[rows][:, :2, :2] + fit.floor_px**2 * np.eye(2),
        direction=frame.direction[stars],
        frame=np.zeros(len(rows), np.int64),
        frames=1,
        star=frame.rows[stars],
    )
    attitude = attitude_of(here, fit.camera)
    residual, kept = predicted_residuals(here, fit.camera)
    night = Night(frames=(frame,), sky=known.night.sky, refraction_arcsec=known.night.refraction_arcsec)
    field = field_stars(night, 0, fit.camera, attitude)
    inside = fit.camera.geometry.contains(field.place_px, margin_px=-4.0)
    height, false = _pairs(seen, field)
    trail = has_flag(table.flags[false], StarFlag.TRAIL)
    false = false[~trail]
    hot = known.hot
    one = replace(known, night=night, hot=hot)
    order = {int(row): k for k, row in enumerate(field.row)}
    at = np.array([order.get(int(row), -1) for row in frame.rows[stars]], np.int64)
    good = kept & (at >= 0)
    good[good] &= field.alone(8.0)[at[good]]
    chosen = rows[good]
    return FrameStats(
        magnitude=field.magnitude[inside],
        height=height[inside],
        false=seen.significance[false],
        false_px=seen.start_px[false],
        trail=int(trail.sum()),
        star_magnitude=field.magnitude[at[good]],
        star_colour=field.colour_class[at[good]],
        width_px=table.width_px[chosen],
        residual_px=residual[good],
        place_px=table.pixel_px[chosen],
        blocks=sky_blocks(image.dn, star_mask(image, field, seen, hot, known.width_px)),
        fluxes=star_fluxes(one, fit.noise, fit.psf, fit.camera, Rotation.concatenate([attitude]), [0]),
        attitude=attitude,
        halves_arcsec=_halves(here.select(kept), fit),
        solved=solve(seen),
        seen=seen,
    )


def star_heights(seen: Detections, field: FieldStars) -> FloatArray:
    """Significance at which each catalogue star (n,) was found; 0 if it was not."""
    return _pairs(seen, field)[0]


def _pairs(seen: Detections, field: FieldStars) -> tuple[FloatArray, IntArray]:
    """Significance of every catalogue star (n,), 0 if not found, and the rows of detections that are none of them."""
    rows = np.flatnonzero(np.isfinite(seen.significance) & ~seen.sharp)
    height = np.zeros(len(field))
    if not len(rows) or not len(field):
        return height, rows
    far, nearest = cKDTree(field.place_px).query(seen.start_px[rows], k=min(6, len(field)))
    far, nearest = (one.reshape(len(rows), -1) for one in (far, nearest))
    # of several stars within reach the brightest: the list is sorted by brightness
    star = np.where(far < PAIR_PX, nearest, len(field)).min(axis=1)
    found = star < len(field)
    np.maximum.at(height, star[found], seen.significance[rows[found]])
    return height, rows[~found]


def _halves(stars: Observations, fit: CameraFit) -> FloatArray:
    """Half of the difference (3,) of two attitudes, each by every other star: one attitude's error by all of them."""
    if len(stars) < 12:
        return np.full(3, np.nan)
    even, odd = (attitude_of(stars.select(np.arange(len(stars)) % 2 == part), fit.camera) for part in (0, 1))
    return attitude_error_arcsec(even, odd) / 2.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Statistic:
    """Statistic of the comparison."""

    key: str
    label: str
    unit: str
    limit: float  # Largest deviation that is allowed; NaN where it is only shown
    relative: bool  # Whether the deviation is a part of the real value


def limit_of(frames: Sequence[FrameStats], threshold: float) -> float:
    """Magnitude at which half of the stars are found: maximum likelihood of a logistic curve."""
    magnitude = np.concatenate([one.magnitude for one in frames])
    found = np.concatenate([one.height >= threshold for one in frames])
    if not found.any() or found.all():
        return float("nan")
    start = np.sort(magnitude)[int(found.sum())] if found.sum() < len(found) else magnitude.max()

    def loss(p: FloatArray) -> float:
        z = (p[0] - magnitude) / np.exp(p[1])
        return float(np.logaddexp(0.0, -z)[found].sum() + np.logaddexp(0.0, z)[~found].sum())

    return float(minimize(loss, [float(start), np.log(0.15)], method="Nelder-Mead").x[0])


def half_magnitudes(frames: Sequence[FrameStats], edges: FloatArray, threshold: float) -> tuple[IntArray, FloatArray]:
    """Stars and the share of them that is found, between edges."""
    magnitude = np.concatenate([one.magnitude for one in frames])
    found = np.concatenate([one.height >= threshold for one in frames])
    at = np.digitize(magnitude, edges) - 1
    count = np.array([(at == k).sum() for k in range(len(edges) - 1)])
    share = [found[at == k].mean() if count[k] else np.nan for k in range(len(edges) - 1)]
    return count, np.array(share)


def _rms(values: FloatArray) -> float:
    """Per axis, without what lies beyond `CLIP_PX`."""
    good = np.linalg.norm(values, axis=1) < CLIP_PX
    return float(np.sqrt((values[good] ** 2).mean())) if good.sum() >= FEWEST else float("nan")


def statistics_of(frames: Sequence[FrameStats], limit_mag: float, airmass: FloatArray) -> dict[Statistic, float]:
    """All statistics of a set; ``limit_mag`` sets the classes of magnitude, the same for real and twin."""
    out: dict[Statistic, float] = {}

    def add(key: str, label: str, value: float, unit: str = "", limit: float = np.nan, relative: bool = True) -> None:
        out[Statistic(key=key, label=label, unit=unit, limit=limit, relative=relative)] = float(value)

    magnitude, width, colour, residual = (
        np.concatenate([getattr(one, name) for one in frames])
        for name in ("star_magnitude", "width_px", "star_colour", "residual_px")
    )
    for threshold, words in ((5.0, "5"), (HIGH_SIGMA, "6")):
        add(
            f"stars_{words}",
            f"stars in all frames, {words} sigma",
            sum(int((one.height >= threshold).sum()) for one in frames),
            limit=0.02,
        )
        add(
            f"limit_{words}_mag",
            f"magnitude at which half are detected, {words} sigma",
            limit_of(frames, threshold),
            "mag",
            0.05,
            relative=False,
        )
    blocks = [one.blocks for one in frames]
    noise = np.array([np.sqrt(np.nanmedian(one.variance_dn2)) for one in blocks])
    add("noise_dn", "noise of the background, mean of the frames", float(noise.mean()), "DN", 0.01)
    bright = magnitude < limit_mag - 1.5
    add("width_px", "width of stars, Gaussian fit", _mean(width[bright]), "px", 0.02)
    add("width_spread_px", "spread of the width", _spread(width[bright]), "px", 0.25)
    for k, words in enumerate(COLOUR_NAMES):
        add(f"width_{k}_px", f"width, stars {words}", _mean(width[bright & (colour == k)]), "px", 0.04)
    edges = (-np.inf, limit_mag - 2.0, limit_mag - 1.0, np.inf)
    for low, high, words in zip(edges, edges[1:], ("bright", "middle", "faint"), strict=False):
        rows = (magnitude >= low) & (magnitude < high)
        add(f"residual_{words}_px", f"residual of the camera, {words} stars", _rms(residual[rows]), "px", 0.10)
    scatter = _scatter(frames)
    groups = {"all": np.ones(len(frames), bool)}
    if np.isfinite(airmass).all() and np.ptp(airmass) > 0.1:
        deep = airmass > 0.5 * (airmass.min() + airmass.max())
        groups = {"low": deep, "high": ~deep}
    for words, chosen in groups.items():
        where = {"all": "", "low": ", low frames", "high": ", high frames"}[words]
        add(f"scatter_{words}_mag", f"scatter of photometry{where}", _mean(scatter[chosen]), "mag", 0.15)
    height, stars = (np.concatenate([getattr(one, name) for one in frames]) for name in ("height", "magnitude"))
    rows = (np.abs(stars - (limit_mag - 1.5)) < 0.25) & (height > 0)
    add("snr", f"signal over noise at {limit_mag - 1.5:.1f} mag", float(np.median(height[rows])), limit=np.nan)
    x, y, _ = neighbour_correlation(blocks)
    add("correlation", "correlation of neighbouring pixels", (x + y) / 2.0, limit=0.01, relative=False)
    averaging = averaging_ratio(blocks)
    for side, value in zip((2, 8, 32), averaging, strict=True):
        add(f"averaging_{side}", f"noise of means of {side} × {side} px over that of white noise", value)
    add("tail", f"fraction of background pixels beyond {TAIL_SIGMA:g} sigma", _tail(blocks), "percent")
    add("attitude_arcsec", "attitude error across, from two halves of the stars", _across(frames), "arcsec")
    add(
        "roll_arcsec",
        "attitude error in roll, from two halves of the stars",
        float(np.sqrt(np.nanmean([one.halves_arcsec[2] ** 2 for one in frames]))),
        "arcsec",
    )
    add(
        "solved",
        "fraction of frames solved blind",
        float(np.mean([one.solved for one in frames])),
        limit=0.0,
        relative=False,
    )
    return out


def _mean(values: FloatArray) -> float:
    """Mean without outliers of 4 robust standard deviations."""
    good = np.isfinite(values)
    if good.sum() < 3:
        return float("nan")
    centre = np.median(values[good])
    spread = 1.4826 * np.median(np.abs(values[good] - centre)) + 1e-12
    return float(values[good & (np.abs(values - centre) < 4.0 * spread)].mean())


def _spread(values: FloatArray) -> float:
    """Standard deviation, by the quartiles: one blend in fifty does not matter."""
    good = values[np.isfinite(values)]
    if len(good) < FEWEST:
        return float("nan")
    low, high = np.quantile(good, [0.16, 0.84])
    return float(high - low) / 2.0


def _across(frames: Sequence[FrameStats]) -> float:
    return float(np.sqrt(np.nanmean([(one.halves_arcsec[:2] ** 2).mean() for one in frames])))


def _tail(blocks: Sequence[SkyBlocks]) -> float:
    """Share of unclipped pixels beyond `TAIL_SIGMA` [%]."""
    share = []
    for one in blocks:
        left = one.residual_dn[np.isfinite(one.residual_dn)]
        share.append((np.abs(left) > TAIL_SIGMA * left.std()).mean())
    return 100.0 * float(np.mean(share))


def _scatter(frames: Sequence[FrameStats]) -> FloatArray:
    """Photometric scatter of each frame [mag], all frames fitted together."""
    parts = [one.fluxes for one in frames]

    def joined(name: str) -> FloatArray:
        return np.concatenate([getattr(one, name) for one in parts])

    made = fit_photometry(
        magnitude=joined("magnitude"),
        colour=joined("colour"),
        u2=joined("u2"),
        frame=np.concatenate([np.full(len(one.flux_e), k) for k, one in enumerate(parts)]),  # type: ignore[attr-defined]
        frames=len(frames),
        flux_e=joined("flux_e"),
        flux_error_e=joined("error_e"),
    )
    return made.scatter_mag


def false_detections(frames: Sequence[FrameStats], threshold: float) -> int:
    """Detections that no catalogue star explains."""
    return int(sum((one.false >= threshold).sum() for one in frames))
