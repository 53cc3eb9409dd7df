"""Detections against the truth: completeness, false detections, centroid errors.

Centroid errors are compared with the Cramer-Rao bound of the same stars.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from astropy.stats import binom_conf_interval
from matplotlib.figure import Figure
from numpy.typing import NDArray

from calib.flags import UNFIT, StarFlag, has_flag
from calib.measure.centroid_error.prediction import CentroidBound, centroid_bound
from calib.measure.detection.limiting_magnitude import limiting_magnitude
from calib.measure.detection.scores import missed_limit, nearest_pairs, rate_excess_sigma, robust_ratio_limit
from calib.measure.reduced_frame import SMEAR_PX, MeasuredFrame
from calib.measure.statistics.robust import robust_rms, robust_scatter
from experiments.dataset.truth import FLAGS
from experiments.harness.drawings import curves
from experiments.harness.quantities import Outcome
from experiments.harness.sections import Section, below, col
from experiments.harness.summary import Measured
from experiments.laboratory.bench.readout.frames import true_noise
from optics.arrays import FloatArray
from optics.frames import pixel_from_fits
from optics.records import concatenated, freeze

if TYPE_CHECKING:
    from experiments.dataset.scene import DatasetScene
    from render.records import PsfGrid


MATCH_PX = 2.0
"""Largest distance of a detection from its star, if each is the nearest of the other; `NEAR_PX` for saturated stars."""
NEAR_PX = 4.0
"""A detection farther than this from every rendered star is false."""


@dataclass(frozen=True, slots=True, kw_only=True)
class MatchedStars:
    """Stars of one or more frames, and their detections."""

    magnitude: FloatArray  # (n,) Magnitude of every star with light on the detector
    snr: FloatArray  # (n,)
    electrons: FloatArray  # (n,)
    flags: NDArray[np.int32]  # (n,) Sums of bits of `experiments.dataset.truth.FLAGS`
    matched: NDArray[np.bool_]  # (n,) Whether it is detected
    fit: NDArray[np.bool_]  # (n,) Whether its detection has no flag
    blend_flagged: NDArray[np.bool_]  # (n,) Whether its detection is flagged ``BLEND``
    error_px: FloatArray  # (n, 2) Centroid minus mean of all light of the star; NaN without a centroid
    smear_px: FloatArray  # (n,) Length of its trail
    position_px: FloatArray  # (n, 2) Mean of all its light
    radius_px: FloatArray  # (n,) Distance from the centre of the detector
    false: NDArray[np.int64]  # (f,) Frames of detections without a star
    false_spike: NDArray[np.bool_]  # (f,) Whether these are flagged as sharper than a star or as defective
    frames: int  # Number of frames

    def __post_init__(self) -> None:
        sizes: dict[str, int] = {}
        for name in ("magnitude", "snr", "electrons", "smear_px", "radius_px"):
            freeze(self, name, shape=("n",), sizes=sizes)
        for name, kind in (("flags", np.int32), ("matched", np.bool_), ("fit", np.bool_), ("blend_flagged", np.bool_)):
            freeze(self, name, shape=("n",), dtype=kind, sizes=sizes)
        for name in ("error_px", "position_px"):
            freeze(self, name, shape=("n", 2), finite=False, sizes=sizes)
        freeze(self, "false", shape=("f",), dtype=np.int64, sizes=sizes)
        freeze(self, "false_spike", shape=("f",), dtype=np.bool_, sizes=sizes)

    def has(self, flag: str) -> NDArray[np.bool_]:
        """Stars with a flag of the truth."""
        return np.asarray((self.flags & FLAGS[flag][0]) != 0)

    @property
    def clean(self) -> NDArray[np.bool_]:
        """Undisturbed stars at rest: no flag of the truth except for a vignetted pupil."""
        return np.asarray(((self.flags & ~np.int32(FLAGS["vignetted"][0])) == 0) & (self.smear_px <= SMEAR_PX))


def compare_frame(
    frame: int, measured: MeasuredFrame, truth: dict[str, Any], *, width_px: int, height_px: int
) -> MatchedStars:
    """Match the detections of a frame to its truth."""
    lit = (truth["flags"] & FLAGS["no_light"][0]) == 0
    position_px = np.column_stack([truth["photon_x_px"], truth["photon_y_px"]])[lit]
    true_flags, detected_px = truth["flags"][lit], measured.detected_px
    n = len(position_px)
    smear_px = np.nan_to_num(np.hypot(truth["smear_x_px"], truth["smear_y_px"]))[lit]
    saturated = (true_flags & FLAGS["saturated"][0]) != 0  # detected anywhere on its plateau
    pairs = nearest_pairs(position_px, detected_px, np.where(saturated, NEAR_PX, MATCH_PX))
    detection, false = pairs.detection, np.ones(len(detected_px), bool)
    if n and len(detected_px):
        false = pairs.distance_px > NEAR_PX + smear_px[pairs.star] / 2.0  # a faint trail may break up
    matched = detection >= 0
    error_px, flags = np.full((n, 2), np.nan), np.zeros(n, np.uint32)
    error_px[matched] = measured.stars.pixel_px[detection[matched]] - position_px[matched]
    flags[matched] = measured.stars.flags[detection[matched]]
    centre_px = np.array([(width_px - 1) / 2, (height_px - 1) / 2])
    return MatchedStars(
        magnitude=truth["magnitude"][lit],
        snr=truth["snr"][lit],
        electrons=truth["electrons"][lit],
        flags=true_flags,
        matched=matched,
        fit=matched & ~has_flag(flags, UNFIT),
        blend_flagged=has_flag(flags, StarFlag.BLEND),
        error_px=error_px,
        smear_px=smear_px,
        position_px=position_px,
        radius_px=np.hypot(*(position_px - centre_px).T),
        false=np.full(np.count_nonzero(false), frame),
        false_spike=measured.stars.sharp[false],
        frames=1,
    )


def joined(parts: list[MatchedStars]) -> MatchedStars:
    """Stars of several frames in a single record."""
    return concatenated(parts, frames=sum(part.frames for part in parts))


BOUND_RADII = (0.0, 0.5, 0.9)
"""Positions of the PSFs for the bound: fractions of the largest distance of a PSF from the centre."""


def dataset_bound(scene: DatasetScene, psfs: PsfGrid, sky_e: float) -> CentroidBound:
    """Bound with the PSFs of the lens on a uniform sky, dark charge and noise of the mean dark frame included."""
    distance = np.hypot(*(psfs.place_px - scene.instrument.camera.centre_px).T)
    chosen = [int(np.abs(distance - part * distance.max()).argmin()) for part in BOUND_RADII]
    return centroid_bound(
        [psfs.psfs[k] for k in chosen],
        distance[chosen],
        noise=true_noise(scene.instrument, dark_frames=scene.config.verify.dark_frames),
        background_e=sky_e,
        window_px=scene.config.window_px,
        electrons=(30.0, 10.0 * scene.instrument.detector.full_well_e),
    )


def wcs_misses_px(path: str | Path, truth: dict[str, Any], *, width_px: int, height_px: int) -> FloatArray:
    """Distances (n,) [px] of star positions by astropy's WCS of a file from their chief rays."""
    from astropy.io import fits
    from astropy.wcs import WCS, FITSFixedWarning

    with fits.open(path) as content, warnings.catch_warnings():
        warnings.simplefilter("ignore", FITSFixedWarning)
        image = next(hdu for hdu in content if hdu.header.get("NAXIS", 0) == 2 or hdu.header.get("ZNAXIS", 0) == 2)
        wcs = WCS(image.header)
        x, y = truth["chief_x_px"], truth["chief_y_px"]
        inside = (x >= -0.5) & (x <= width_px - 0.5) & (y >= -0.5) & (y <= height_px - 0.5)
        inside &= (truth["flags"] & FLAGS["no_light"][0]) == 0
        if not inside.any():
            return np.zeros(0)
        sky_deg = truth["ra_deg"][inside], truth["dec_deg"][inside]
        wcs_x, wcs_y = pixel_from_fits(*wcs.all_world2pix(*sky_deg, 1, tolerance=1e-6))
    return np.asarray(np.hypot(wcs_x - x[inside], wcs_y - y[inside]))


# --- Sections

BRIGHT_SNR = 10.0
"""From here on an undisturbed star is detected."""
BOUND_SNR = (8.0, 25.0)
"""Range dominated by noise: below, detected stars are biased by their noise; above, colours and response dominate."""
MIN_STARS_IN_BIN = 8
"""Fewest stars in a bin for a centroid error."""
BOUND_STARS = 300
"""Fewer give the ratio to worse than 5 %: an excess of 25 % would pass."""
BOUND_MARGIN = 1.05
"""Ratio due to interpolation of PSFs and sharp spots."""
MISSED_FRACTION = 0.01
"""Allowed fraction of missed stars among bright undisturbed ones."""
FALSE_ALARM = 1e-3
"""Probability that a limit is exceeded by chance."""
BINS_PER_DECADE = 6
MAGNITUDE_STEP = 0.25
SNR_BINS = 23
MIN_SNR = 0.5


@dataclass(frozen=True, slots=True, kw_only=True)
class Example:
    """Frame of the report."""

    frame: int
    electrons: NDArray[np.float32]  # (h, w) Electrons above the mean dark frame
    measured: MeasuredFrame
    truth: dict[str, Any]  # Columns


@dataclass(frozen=True, slots=True, kw_only=True)
class Detection:
    """Bright stars, false detections, world coordinates."""

    frames_looked_at: int = col("Frames evaluated")
    bright_stars: int = col("Stars of SNR 10 and more")
    bright_share: float = col("Fraction of these detected")
    bright_undisturbed: float = col("Fraction of the undisturbed stars")
    bright_missed: float | None = col("Share of undisturbed stars of SNR 10 and more not detected")
    bright_missed_limit: float = col("Largest fraction consistent with 1 % of stars missed")
    magnitude_of_half: float = col("Magnitude at which half of the stars are detected", "mag", ".2f")
    false_all: float = col("False detections per frame", format=".2f")
    false_not_flagged: float = col("Unflagged false detections per frame", format=".2f")
    false_in_empty_frames: float = col(
        "Unflagged detections in frames without stars, per frame",
        format=".2f",
    )
    false_excess: float | None = col("Unflagged false detections, excess over frames without stars", "sigma")
    bound_ratio: Measured | None = col(
        f"Centroid error over its Cramér-Rao bound, SNR {BOUND_SNR[0]:g} to {BOUND_SNR[1]:g}"
    )
    bound_limit: float = col("Largest ratio")
    wcs_max_error_px: float = col("World coordinates in astropy against chief rays, largest", "px")
    wcs_judged_px: float | None = col("World coordinates in astropy against chief rays, largest", "px")
    example: Example | None  # The first frame with stars


@dataclass(frozen=True, slots=True, kw_only=True)
class CompletenessBin:
    """Stars detected in a bin; stars cut by the detector's edge are excluded."""

    bin: Any  # Magnitude, its range, or signal-to-noise ratio
    stars: int = col("Stars")
    share_found: Measured = col("Detected", format=".4f")
    low: float = col("68 % interval, from", format=".3f", shown=False)
    high: float = col("to", format=".3f", shown=False)


@dataclass(frozen=True, slots=True, kw_only=True)
class FlagGroup:
    """Stars that the truth flags."""

    flag: str = col("Flag")
    meaning: str = col("Meaning")
    stars: int = col("Stars")
    share_found: float = col("Detected", format=".3f")
    share_fit: float = col("Usable", format=".3f")
    share_blend: float = col("Flagged as blend", format=".3f")


@dataclass(frozen=True, slots=True, kw_only=True)
class CentroidBin:
    """Centroid errors of undisturbed stars in a bin of signal-to-noise ratio."""

    snr: float = col("Signal-to-noise ratio", format=".1f")
    stars: int = col("Stars")
    error_px: Measured = col("Error per axis", "px")
    bound_px: float = col("Cramér-Rao bound", "px")
    ratio: float = col("Ratio", format=".2f")


def detection(
    stars: MatchedStars,
    bound: CentroidBound,
    *,
    empty_frames: int,
    empty_detections: int,
    wcs_misses: FloatArray,
    cosmic_rays: bool,
    example: Example | None,
) -> dict[str, Any]:
    """Sections of the stars of all frames; ``empty_*``: frames without stars, and unflagged detections in them."""
    unflagged = int((~stars.false_spike).sum())
    bright = completeness(stars, stars.snr, np.array([BRIGHT_SNR, np.inf]))
    undisturbed = stars.clean & (stars.snr >= BRIGHT_SNR)
    detected_fraction = mean_of(stars.matched, undisturbed)
    curve = completeness(stars, stars.magnitude, even_edges(stars.magnitude, MAGNITUDE_STEP))
    bins = centroid_bins(stars, bound)
    wcs_error_px = float(wcs_misses.max()) if len(wcs_misses) else float("nan")
    any_star, (ratio, count) = len(stars.magnitude) > 0, mean_ratio(bins)
    spread, limit = robust_ratio_limit(count, BOUND_MARGIN, FALSE_ALARM)
    excess = rate_excess_sigma(unflagged, stars.frames, empty_detections, empty_frames)
    return {
        "detection": Detection(
            frames_looked_at=stars.frames,
            bright_stars=bright[0].stars if bright else 0,
            bright_share=bright[0].share_found.value if bright else float("nan"),
            bright_undisturbed=detected_fraction,
            bright_missed=1.0 - detected_fraction if np.isfinite(detected_fraction) else None,
            bright_missed_limit=missed_limit(int(undisturbed.sum()), MISSED_FRACTION, FALSE_ALARM),
            magnitude_of_half=limiting_magnitude(stars.magnitude[stars.clean], stars.matched[stars.clean]),
            false_all=len(stars.false) / stars.frames,
            false_not_flagged=unflagged / stars.frames,
            false_in_empty_frames=empty_detections / empty_frames,
            false_excess=excess if any_star and not cosmic_rays else None,  # tracks are detected as stars
            bound_ratio=Measured(value=ratio, uncertainty=spread, n=count) if count >= BOUND_STARS else None,
            bound_limit=limit,
            wcs_max_error_px=wcs_error_px,
            wcs_judged_px=wcs_error_px if len(wcs_misses) and any_star else None,
            example=example,
        ),
        "magnitudes": completeness(stars, stars.magnitude, even_edges(stars.magnitude, 1.0), "{low:g} … {high:g}")
        or None,
        "magnitude_curve": curve or None,
        "snr_curve": completeness(stars, stars.snr, snr_edges(stars.snr)) or None,
        "flags": flag_groups(stars),
        "centroids": bins or None,
    }


def completeness(stars: MatchedStars, value: FloatArray, edges: FloatArray, name: str = "") -> list[CompletenessBin]:
    """Fraction of detected stars in non-empty bins of a value per star, with Wilson intervals."""
    inside = ~stars.has("off_edge")
    total, _ = np.histogram(value[inside], edges)
    detected, _ = np.histogram(value[inside & stars.matched], edges)
    bins = []
    for k in np.flatnonzero(total):
        low, high = (float(v) for v in binom_conf_interval(detected[k], total[k], interval="wilson"))
        fraction = Measured(value=float(detected[k] / total[k]), uncertainty=(high - low) / 2, n=int(total[k]))
        bin_ = name.format(low=edges[k], high=edges[k + 1]) if name else float((edges[k] + edges[k + 1]) / 2)
        bins.append(CompletenessBin(bin=bin_, stars=int(total[k]), share_found=fraction, low=low, high=high))
    return bins


def even_edges(values: FloatArray, step: float) -> FloatArray:
    """Edges of bins of equal width from the integer below the smallest value; two without values."""
    if not len(values):
        return np.array([0.0, step])
    return np.arange(np.floor(values.min()), values.max() + step, step)


def snr_edges(snr: FloatArray) -> FloatArray:
    positive = snr[snr > 0]
    if not positive.max(initial=0.0) > MIN_SNR:
        return np.ones(2)
    return np.geomspace(max(MIN_SNR, positive.min()), positive.max() * 1.001, SNR_BINS + 1)


def mean_of(values: NDArray[np.bool_], selected: NDArray[np.bool_]) -> float:
    """Fraction of the selected stars with a property; NaN without selected stars."""
    return float(values[selected].mean()) if selected.any() else float("nan")


def flag_groups(stars: MatchedStars) -> list[FlagGroup]:
    """Detection of the flagged stars, by flag."""
    groups = {name: (meaning, stars.has(name)) for name, (_, meaning) in FLAGS.items()}
    groups = {name: group for name, group in groups.items() if group[1].any()} | {"none": ("undisturbed", stars.clean)}
    return [
        FlagGroup(
            flag=name,
            meaning=meaning,
            stars=int(members.sum()),
            share_found=mean_of(stars.matched, members),
            share_fit=mean_of(stars.fit, members),
            share_blend=mean_of(stars.blend_flagged, members & stars.matched),
        )
        for name, (meaning, members) in groups.items()
    ]


def centroid_bins(stars: MatchedStars, bound: CentroidBound) -> list[CentroidBin]:
    """Errors of undisturbed stars whose detection has no flag."""
    good = stars.clean & stars.fit & np.isfinite(stars.error_px).all(axis=1) & (stars.snr > 0)
    snr, error = stars.snr[good], stars.error_px[good]
    limit = bound.at(stars.electrons[good], stars.position_px[good], stars.radius_px[good])
    number = np.floor(np.log10(snr) * BINS_PER_DECADE).astype(int)
    bins = []
    for k in np.unique(number):
        members = number == k
        count = int(members.sum())
        if count < MIN_STARS_IN_BIN:
            continue
        spread, uncertainty = robust_scatter(error[members])
        deviation = error[members] - np.median(error[members], axis=0)
        bins.append(
            CentroidBin(
                snr=float(np.median(snr[members])),
                stars=count,
                error_px=Measured(value=spread, uncertainty=uncertainty),
                bound_px=float(np.median(limit[members])),
                ratio=robust_rms(deviation / limit[members]),
            )
        )
    return bins


def mean_ratio(bins: Sequence[CentroidBin]) -> tuple[float, int]:
    """Mean ratio of error and bound within `BOUND_SNR`, NaN for none, and its number of stars."""
    inside = [bin_ for bin_ in bins if BOUND_SNR[0] <= bin_.snr <= BOUND_SNR[1]]
    count = sum(bin_.stars for bin_ in inside)
    return (sum(bin_.ratio * bin_.stars for bin_ in inside) / count if count else float("nan")), count


def example_frame(outcome: Outcome) -> Figure:
    """The first frame with detections circled by class."""
    from experiments.harness.plotting import PALETTE, new_figure
    from optics.figures import draw_image

    example = outcome.result["detection"].example
    height, width = example.electrons.shape
    figure, axis = new_figure(aspect_ratio=min(0.75, 0.08 + 0.92 * height / width))
    draw_image(example.electrons, axis)
    position_px, fit = example.measured.detected_px, example.measured.fit
    axis.scatter(*position_px[fit].T, s=26, facecolors="none", edgecolors=PALETTE[5], linewidths=0.8)
    axis.scatter(*position_px[~fit].T, s=26, marker="s", facecolors="none", edgecolors=PALETTE[4], linewidths=0.8)
    return figure


def _axis(dim: str, label: str) -> Any:
    return lambda q, bins: q.axis(dim, [bin_.bin for bin_ in bins], label)


HALF: dict[str, Any] = {"width": "half", "aspect_ratio": 0.7}
SECTIONS = {
    "detection": Section(
        record=Detection,
        figures={"example_frame": example_frame},
        verdicts=[
            below(
                "bright_missed",
                "bright_missed_limit",
                title="share of undisturbed stars of SNR 10 and more that are not detected",
                advice="threshold_sigma is too high, or the frames are smeared",
            ),
            below(
                "false_excess",
                4.0,
                title="unflagged false detections, excess over frames without stars",
                advice="other light is detected as stars: raise threshold_sigma",
            ),
            below(
                "bound_ratio",
                "bound_limit",
                title="centroid error over its Cramér-Rao bound, SNR 8 to 25",
                advice="use another centroid or window_px",
            ),
            below(
                "wcs_judged_px",
                0.01,
                title="world coordinates in astropy against chief rays, largest",
                advice="TAN-SIP does not describe the lens: use the positions of the truth",
            ),
        ],
    ),
    "magnitudes": Section(
        record=CompletenessBin,
        dim="magnitude",
        axes=_axis("magnitude", "Magnitude"),
        table="completeness",
        caption="Completeness of the detection.",
        note="Without stars cut by the detector's edge. ±: half of the 68 % confidence interval (Wilson).",
    ),
    "magnitude_curve": Section(
        record=CompletenessBin,
        dim="magnitude_step",
        axes=_axis("magnitude_step", "Magnitude"),
        figures={"magnitude_curve": curves("magnitude_step", points="share_found", **HALF)},
    ),
    "snr_curve": Section(
        record=CompletenessBin,
        dim="snr_step",
        axes=_axis("snr_step", "Signal-to-noise ratio"),
        figures={"snr_curve": curves("snr_step", points="share_found", log="x", **HALF)},
    ),
    "flags": Section(
        record=FlagGroup,
        dim="flag",
        along="flag",
        caption="Flags of the truth, and detection of these stars.",
        note="Usable: detected and without a flag. Flagged as blend: fraction of the detected stars.",
    ),
    "centroids": Section(
        record=CentroidBin,
        dim="centroid_bin",
        hidden="centroid_bin",
        caption="Centroid error of undisturbed stars against the bound.",
        note="Error: 1.4826 times the median absolute deviation, per axis. Bound: median, for the "
        "lens's PSF at each star's pixel phase, position and flux unknown, background known. "
        "Ratio: the same statistic of the errors divided by their bounds.",
        figures={"centroid_curve": curves("snr", points="error_px", lines="bound_px", log="xy", y="Centroid error")},
    ),
}
