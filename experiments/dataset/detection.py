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


# --- Which star a detection belongs to

MATCH_PX = 2.0
"""A detection this near to the light of a star is that star; both must be each other's nearest. Saturated stars:
`NEAR_PX`."""
NEAR_PX = 4.0
"""A detection farther than this from every rendered star is false."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FoundStars:
    """Stars of one or more frames, and their detections."""

    magnitude: FloatArray  # (n,) Of every star of which light reaches the detector
    snr: FloatArray  # (n,)
    electrons: FloatArray  # (n,)
    flags: NDArray[np.int32]  # (n,) Of the truth (`experiments.dataset.truth.FLAGS`)
    matched: NDArray[np.bool_]  # (n,) Whether a detection belongs to it
    fit: NDArray[np.bool_]  # (n,) Whether that detection has no flag of the measurement
    blend_seen: NDArray[np.bool_]  # (n,) Whether that detection is flagged ``BLEND``
    error_px: FloatArray  # (n, 2) Centroid minus mean of all light of the star; NaN where there is no centroid
    smear_px: FloatArray  # (n,) Length of its trail
    position_px: FloatArray  # (n, 2) Mean of all its light
    radius_px: FloatArray  # (n,) Distance from the middle of the detector
    false: NDArray[np.int64]  # (f,) Frames of detections without a star
    false_spike: NDArray[np.bool_]  # (f,) Whether these are flagged as sharper than a star or as defective
    frames: int  # Number of frames

    def __post_init__(self) -> None:
        sizes: dict[str, int] = {}
        for name in ("magnitude", "snr", "electrons", "smear_px", "radius_px"):
            freeze(self, name, shape=("n",), sizes=sizes)
        for name, kind in (("flags", np.int32), ("matched", np.bool_), ("fit", np.bool_), ("blend_seen", np.bool_)):
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
        """Stars at rest that nothing disturbs: no flag of the truth but a vignetted pupil."""
        return np.asarray(((self.flags & ~np.int32(FLAGS["vignetted"][0])) == 0) & (self.smear_px <= SMEAR_PX))


def compare_frame(
    frame: int, measured: MeasuredFrame, truth: dict[str, Any], *, width_px: int, height_px: int
) -> FoundStars:
    """Match the detections of a frame to its truth."""
    lit = (np.asarray(truth["flags"]) & FLAGS["no_light"][0]) == 0
    star = np.column_stack([truth["photon_x_px"], truth["photon_y_px"]])[lit]
    detected = measured.detected_px
    n = len(star)
    smear = np.nan_to_num(np.hypot(truth["smear_x_px"], truth["smear_y_px"]))[lit]
    burnt = (np.asarray(truth["flags"])[lit] & FLAGS["saturated"][0]) != 0  # the top of a plateau is anywhere on it
    pairs = nearest_pairs(star, detected, np.where(burnt, NEAR_PX, MATCH_PX))
    partner, lonely = pairs.detection, np.ones(len(detected), bool)
    if n and len(detected):
        lonely = pairs.distance_px > NEAR_PX + smear[pairs.star] / 2.0  # a faint trail may break up
    matched = partner >= 0
    error = np.full((n, 2), np.nan)
    error[matched] = measured.stars.pixel_px[partner[matched]] - star[matched]
    flags = np.zeros(n, np.uint32)
    flags[matched] = measured.stars.flags[partner[matched]]
    middle = np.array([(width_px - 1) / 2, (height_px - 1) / 2])
    return FoundStars(
        magnitude=np.asarray(truth["magnitude"])[lit],
        snr=np.asarray(truth["snr"])[lit],
        electrons=np.asarray(truth["electrons"])[lit],
        flags=np.asarray(truth["flags"], np.int32)[lit],
        matched=matched,
        fit=matched & ~has_flag(flags, UNFIT),
        blend_seen=has_flag(flags, StarFlag.BLEND),
        error_px=error,
        smear_px=smear,
        position_px=star,
        radius_px=np.hypot(*(star - middle).T) if n else np.zeros(0),
        false=np.full(np.count_nonzero(lonely), frame),
        false_spike=measured.stars.sharp[lonely],
        frames=1,
    )


def joined(parts: list[FoundStars]) -> FoundStars:
    """Stars of several frames as one record."""
    return concatenated(parts, frames=sum(part.frames for part in parts))


# --- Cramer-Rao bound of centroids

BOUND_RADII = (0.0, 0.5, 0.9)
"""Where PSFs for the bound are taken: parts of the largest distance of a PSF from the middle."""


def dataset_bound(scene: DatasetScene, psfs: PsfGrid, sky_e: float) -> CentroidBound:
    """Bound with the PSFs of the lens on an even sky; dark charge and the noise of the mean dark count."""
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


# --- World coordinates


def wcs_misses_px(path: str | Path, truth: dict[str, Any], *, width_px: int, height_px: int) -> FloatArray:
    """Distances (n,) [px] of star positions by astropy's WCS of a file from their chief rays."""
    from astropy.io import fits
    from astropy.wcs import WCS, FITSFixedWarning

    with fits.open(path) as content, warnings.catch_warnings():
        warnings.simplefilter("ignore", FITSFixedWarning)
        image = next(hdu for hdu in content if hdu.header.get("NAXIS", 0) == 2 or hdu.header.get("ZNAXIS", 0) == 2)
        wcs = WCS(image.header)
        x, y = np.asarray(truth["chief_x_px"]), np.asarray(truth["chief_y_px"])
        inside = (x >= -0.5) & (x <= width_px - 0.5) & (y >= -0.5) & (y <= height_px - 0.5)
        inside &= (np.asarray(truth["flags"]) & FLAGS["no_light"][0]) == 0
        if not inside.any():
            return np.zeros(0)
        ra, dec = np.asarray(truth["ra_deg"])[inside], np.asarray(truth["dec_deg"])[inside]
        at = np.column_stack(pixel_from_fits(*wcs.all_world2pix(ra, dec, 1, tolerance=1e-6)))
    return np.asarray(np.hypot(at[:, 0] - x[inside], at[:, 1] - y[inside]))


# --- What the sections hold

BRIGHT_SNR = 10.0
"""From here on a star that nothing disturbs is detected."""
BOUND_SNR = (8.0, 25.0)
"""Between these noise alone decides: below, only stars that the noise helped are seen; above, colours and response."""
FEWEST_IN_BIN = 8
"""Stars in a bin for a centroid error, and for a share of detected stars to count."""
BOUND_STARS = 300
"""Fewer tell the ratio to worse than 5 %: an excess of 25 % would pass."""
BOUND_MARGIN = 1.05
"""Ratio that interpolation of PSFs and sharp spots explain."""
MISSED_SHARE = 0.01
"""Of bright stars that nothing disturbs, not detected."""
FALSE_ALARM = 1e-3
"""Probability that a limit is passed by chance."""
BINS_PER_DECADE = 6
MAGNITUDE_STEP = 0.25
SNR_BINS, LEAST_SNR = 23, 0.5


@dataclass(frozen=True, slots=True, kw_only=True)
class Example:
    """A frame to be shown."""

    frame: int  # Its number
    electrons: NDArray[np.float32]  # (h, w) Above the dark
    measured: MeasuredFrame  # What was detected
    truth: dict[str, Any]  # Columns of its truth


@dataclass(frozen=True, slots=True, kw_only=True)
class Detection:
    """Bright stars, false detections, world coordinates."""

    frames_looked_at: int = col("Frames evaluated")
    bright_stars: int = col("Stars of SNR 10 and more", json="completeness.stars")
    bright_share: float = col("Fraction of these detected", json="completeness.share")
    bright_undisturbed: float = col("Fraction of the undisturbed stars", json="completeness.undisturbed")
    bright_missed: float | None = col("Share of undisturbed stars of SNR 10 and more not detected", json="")
    bright_missed_limit: float = col("Largest fraction consistent with 1 % of stars missed", json="")
    magnitude_of_half: float = col(
        "Magnitude at which half of the stars are detected", "mag", ".2f", json="completeness.magnitude_of_half"
    )
    false_all: float = col("False detections per frame", format=".2f", json="false_detections_per_frame.all")
    false_not_flagged: float = col(
        "Unflagged false detections per frame", format=".2f", json="false_detections_per_frame.not_flagged"
    )
    false_in_empty_frames: float = col(
        "Unflagged detections in frames without stars, per frame",
        format=".2f",
        json="false_detections_per_frame.in_empty_frames",
    )
    false_excess: float | None = col("Unflagged false detections, excess over frames without stars", "sigma", json="")
    bound_ratio: Measured | None = col(
        f"Centroid error over its Cramér-Rao bound, SNR {BOUND_SNR[0]:g} to {BOUND_SNR[1]:g}", json=""
    )
    bound_limit: float = col("Largest ratio", json="")
    wcs_max_error_px: float = col("World coordinates in astropy against chief rays, largest", "px")
    wcs_judged_px: float | None = col("World coordinates in astropy against chief rays, largest", "px", json="")
    example: Example | None  # The first frame with stars


@dataclass(frozen=True, slots=True, kw_only=True)
class CompletenessBin:
    """Stars detected in a bin; stars cut by the detector's edge are excluded."""

    bin: Any  # Magnitude, its range, or signal-to-noise ratio
    stars: int = col("Stars", json="")
    share_found: Measured = col("Detected", format=".4f", json="")
    low: float = col("68 % interval, from", format=".3f", json="", shown=False)
    high: float = col("to", format=".3f", json="", shown=False)


@dataclass(frozen=True, slots=True, kw_only=True)
class FlagGroup:
    """Stars that the truth flags."""

    flag: str = col("Flag", json="")
    meaning: str = col("Meaning", json="")
    stars: int = col("Stars", json="")
    share_found: float = col("Detected", format=".3f", json="")
    share_fit: float = col("Usable", format=".3f", json="")
    share_blend: float = col("Flagged as blend", format=".3f", json="")


@dataclass(frozen=True, slots=True, kw_only=True)
class CentroidBin:
    """Centroid errors of undisturbed stars in a bin of signal-to-noise ratio."""

    snr: float = col("Signal-to-noise ratio", format=".1f")
    stars: int = col("Stars")
    error_px: Measured = col("Error per axis", "px", json_error="error_sigma_px")
    bound_px: float = col("Cramér-Rao bound", "px")
    ratio: float = col("Ratio", format=".2f")


def detection(
    stars: FoundStars,
    bound: CentroidBound,
    *,
    empty_frames: int,
    empty_detections: int,
    wcs_misses: FloatArray,
    cosmic_rays: bool,
    example: Example | None,
) -> dict[str, Any]:
    """Sections of the stars of all frames; ``empty_*``: frames without stars, and unflagged detections in them."""
    lonely = int((~stars.false_spike).sum())
    bright = shares(stars, stars.snr, np.array([BRIGHT_SNR, np.inf]))
    even = stars.clean & (stars.snr >= BRIGHT_SNR)
    undisturbed = mean_of(stars.matched, even)
    fine = shares(stars, stars.magnitude, even_edges(stars.magnitude, MAGNITUDE_STEP))
    bins = centroid_bins(stars, bound)
    miss = float(wcs_misses.max()) if len(wcs_misses) else float("nan")
    some, (ratio, count) = len(stars.magnitude) > 0, mean_ratio(bins)
    spread, limit = robust_ratio_limit(count, BOUND_MARGIN, FALSE_ALARM)
    excess = rate_excess_sigma(lonely, stars.frames, empty_detections, empty_frames)
    return {
        "detection": Detection(
            frames_looked_at=stars.frames,
            bright_stars=bright[0].stars if bright else 0,
            bright_share=bright[0].share_found.value if bright else float("nan"),
            bright_undisturbed=undisturbed,
            bright_missed=1.0 - undisturbed if np.isfinite(undisturbed) else None,
            bright_missed_limit=missed_limit(int(even.sum()), MISSED_SHARE, FALSE_ALARM),
            magnitude_of_half=limiting_magnitude(stars.magnitude[stars.clean], stars.matched[stars.clean]),
            false_all=len(stars.false) / stars.frames,
            false_not_flagged=lonely / stars.frames,
            false_in_empty_frames=empty_detections / empty_frames,
            false_excess=excess if some and not cosmic_rays else None,  # a track looks like a star to the detection
            bound_ratio=Measured(value=ratio, uncertainty=spread, n=count) if count >= BOUND_STARS else None,
            bound_limit=limit,
            wcs_max_error_px=miss,
            wcs_judged_px=miss if len(wcs_misses) and some else None,
            example=example,
        ),
        "magnitudes": shares(stars, stars.magnitude, even_edges(stars.magnitude, 1.0), "{low:g} … {high:g}") or None,
        "magnitude_curve": fine or None,
        "snr_curve": shares(stars, stars.snr, snr_edges(stars.snr)) or None,
        "flags": flag_groups(stars),
        "centroids": bins or None,
    }


def shares(stars: FoundStars, value: FloatArray, edges: FloatArray, name: str = "") -> list[CompletenessBin]:
    """Fraction of detected stars in non-empty bins of a value per star; Wilson intervals."""
    inside = ~stars.has("off_edge")
    total, _ = np.histogram(value[inside], edges)
    detected, _ = np.histogram(value[inside & stars.matched], edges)
    bins = []
    for k in np.flatnonzero(total):
        low, high = (float(v) for v in binom_conf_interval(detected[k], total[k], interval="wilson"))
        share = Measured(value=float(detected[k] / total[k]), uncertainty=(high - low) / 2, n=int(total[k]))
        bin_ = name.format(low=edges[k], high=edges[k + 1]) if name else float((edges[k] + edges[k + 1]) / 2)
        bins.append(CompletenessBin(bin=bin_, stars=int(total[k]), share_found=share, low=low, high=high))
    return bins


def even_edges(values: FloatArray, step: float) -> FloatArray:
    """Edges of bins of equal width from the whole number below the smallest value; two of them hold no values."""
    if not len(values):
        return np.array([0.0, step])
    return np.arange(np.floor(values.min()), values.max() + step, step)


def snr_edges(snr: FloatArray) -> FloatArray:
    positive = snr[snr > 0]
    if not positive.max(initial=0.0) > LEAST_SNR:
        return np.ones(2)
    return np.geomspace(max(LEAST_SNR, positive.min()), positive.max() * 1.001, SNR_BINS + 1)


def mean_of(values: NDArray[np.bool_], which: NDArray[np.bool_]) -> float:
    """Share of the chosen stars for which something holds; NaN where none is chosen."""
    return float(values[which].mean()) if which.any() else float("nan")


def flag_groups(stars: FoundStars) -> list[FlagGroup]:
    """Detection of the flagged stars, by flag."""
    groups = {name: (about, stars.has(name)) for name, (_, about) in FLAGS.items()}
    groups = {name: group for name, group in groups.items() if group[1].any()} | {"none": ("undisturbed", stars.clean)}
    return [
        FlagGroup(
            flag=name,
            meaning=about,
            stars=int(mine.sum()),
            share_found=mean_of(stars.matched, mine),
            share_fit=mean_of(stars.fit, mine),
            share_blend=mean_of(stars.blend_seen, mine & stars.matched),
        )
        for name, (about, mine) in groups.items()
    ]


def centroid_bins(stars: FoundStars, bound: CentroidBound) -> list[CentroidBin]:
    """Errors of the stars that no flag, of truth or measurement, speaks against."""
    good = stars.clean & stars.fit & np.isfinite(stars.error_px).all(axis=1) & (stars.snr > 0)
    snr, error = stars.snr[good], stars.error_px[good]
    limit = bound.at(stars.electrons[good], stars.position_px[good], stars.radius_px[good])
    number = np.floor(np.log10(snr) * BINS_PER_DECADE).astype(int)
    bins = []
    for k in np.unique(number):
        mine = number == k
        count = int(mine.sum())
        if count < FEWEST_IN_BIN:
            continue
        spread, uncertainty = robust_scatter(error[mine])
        off = error[mine] - np.median(error[mine], axis=0)
        bins.append(
            CentroidBin(
                snr=float(np.median(snr[mine])),
                stars=count,
                error_px=Measured(value=spread, uncertainty=uncertainty),
                bound_px=float(np.median(limit[mine])),
                ratio=robust_rms(off / limit[mine]),
            )
        )
    return bins


def mean_ratio(bins: Sequence[CentroidBin]) -> tuple[float, int]:
    """Mean ratio of error and bound where noise alone decides (`BOUND_SNR`), NaN for none, and its stars."""
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
    place, fit = example.measured.detected_px, example.measured.fit
    axis.scatter(*place[fit].T, s=26, facecolors="none", edgecolors=PALETTE[5], linewidths=0.8)
    axis.scatter(*place[~fit].T, s=26, marker="s", facecolors="none", edgecolors=PALETTE[4], linewidths=0.8)
    return figure


def _axis(dim: str, label: str) -> Any:
    return lambda q, bins: q.axis(dim, [bin_.bin for bin_ in bins], label, key=dim)


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
        prefix="magnitude_",
        table="completeness",
        caption="Completeness of the detection.",
        note="Without stars cut by the detector's edge. ±: half of the 68 % confidence interval (Wilson).",
    ),
    "magnitude_curve": Section(
        record=CompletenessBin,
        dim="magnitude_step",
        axes=_axis("magnitude_step", "Magnitude"),
        prefix="magnitude_step_",
        figures={"magnitude_curve": curves("magnitude_step", points="magnitude_step_share_found", **HALF)},
    ),
    "snr_curve": Section(
        record=CompletenessBin,
        dim="snr_step",
        axes=_axis("snr_step", "Signal-to-noise ratio"),
        prefix="snr_step_",
        figures={"snr_curve": curves("snr_step", points="snr_step_share_found", log="x", **HALF)},
    ),
    "flags": Section(
        record=FlagGroup,
        dim="flag",
        along="flag",
        prefix="flag_",
        caption="Flags of the truth, and detection of these stars.",
        note="Usable: detected and without a flag. Flagged as blend: fraction of the detected stars.",
    ),
    "centroids": Section(
        record=CentroidBin,
        dim="centroid_bin",
        hidden="centroid_bin",
        prefix="centroid_",
        place="centroids",
        caption="Centroid error of undisturbed stars against the bound.",
        note="Error: 1.4826 times the median absolute deviation, per axis. Bound: median, for the "
        "lens's PSF at each star's pixel phase, position and flux unknown, background known. "
        "Ratio: the same statistic of the errors divided by their bounds.",
        figures={
            "centroid_curve": curves(
                "centroid_snr", points="centroid_error_px", lines="centroid_bound_px", log="xy", y="Centroid error"
            )
        },
    ),
}
