"""What ``summary.json`` says of a dataset, and what has to hold."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from experiments.dataset.statistics import centroid_bins, completeness, solver
from experiments.harness.summary import Criterion

if TYPE_CHECKING:
    from experiments.dataset.evaluate import Evaluation
    from experiments.dataset.result import Result

__all__ = ["criteria", "results"]

UNSOLVED_SHARE = 0.005
"""One frame may fail anyway."""
LARGEST_MEDIAN_ARCSEC = 0.5
MEDIAN_PIXEL_ARCSEC = 44.32
"""The median was asked for at 1024 pixels over 12 deg; other cameras are judged by the same part of a pixel."""
TWICE = 2.0
"""Where few or faint stars make attitudes worse than that, the error may be twice the predicted one."""
WCS_LIMIT_PX = 0.01
PULL_LIMIT = 1.3
BRIGHT_SNR = 10.0
LEAST_COMPLETE = 0.99
BOUND_SNR = (8.0, 25.0)
"""Between these noise alone decides: below, only stars that the noise helped are seen; above, colours and response."""
BOUND_RATIO = (0.93, 1.3)
BOUND_STARS = 200
"""Fewer tell the ratio to worse than 5 %."""
FALSE_SIGMA = 4.0


def results(result: Result) -> dict[str, Any]:
    """The numbers."""
    evaluation = result.evaluation
    return {
        "frames": len(result.facts),
        "frames_made": result.made,
        "frames_per_s": result.frames_per_s,
        "workers": result.workers,
        "stars": sum(one.stars for one in result.facts),
        "frames_without_stars": sum(one.stars == 0 for one in result.facts),
        "exports": dict(result.exports),
        "resume_test": result.resume,
        **(_found(evaluation) if evaluation is not None else {}),
        "runtime_s": result.runtime_s,
        "peak_memory_mb": result.peak_memory_mb,
    }


def _found(evaluation: Evaluation) -> dict[str, Any]:
    stars, bins = evaluation.stars, centroid_bins(evaluation)
    one = completeness(stars, stars.snr, np.array([BRIGHT_SNR, np.inf]))
    undisturbed = stars.clean & (stars.snr >= BRIGHT_SNR)
    found: dict[str, Any] = {
        "frames_looked_at": evaluation.frames,
        "wcs_max_error_px": _largest(evaluation),
        "completeness": {
            "snr_above": BRIGHT_SNR,
            "stars": int(one.stars[0]),
            "share": float(one.share[0]),
            "undisturbed": float(stars.found[undisturbed].mean()) if undisturbed.any() else float("nan"),
            "magnitude_of_half": _magnitude_of_half(evaluation),
        },
        "blends": _blends(evaluation),
        "false_detections_per_frame": {
            "all": len(stars.false) / stars.frames,
            "not_flagged": int((~stars.false_spike).sum()) / stars.frames,
            "in_empty_frames": evaluation.empty_detections / evaluation.empty_frames,
        },
        "centroids": {
            "snr": bins.snr.tolist(),
            "error_px": bins.error_px.tolist(),
            "bound_px": bins.bound_px.tolist(),
            "ratio": bins.ratio.tolist(),
        },
        "camera_model_max_px": evaluation.calibration.max_px,
    }
    if evaluation.solved:
        judged = solver(evaluation.solved)
        found["solver"] = {
            "solved": judged.solved,
            "attempted": judged.attempted,
            "median_arcsec": judged.median_arcsec,
            "median_sigma_arcsec": judged.median_error_arcsec,
            "p95_arcsec": judged.p95_arcsec,
            "equal_weights_median_arcsec": judged.equal_median_arcsec,
            "roll_median_arcsec": judged.roll_median_arcsec,
            "pull_rms": judged.pull.tolist(),
            "parity_ok": judged.parity_ok,
        }
    else:
        found["solver"] = {"attempted": 0, "why": evaluation.without_solver}
    return found


def _blends(evaluation: Evaluation) -> dict[str, Any]:
    """Blended stars: how many there are, which part is found, and which part of those the measurement calls blends."""
    stars = evaluation.stars
    blended = stars.has("blended")
    found = blended & stars.found
    return {
        "stars": int(blended.sum()),
        "found_share": float(stars.found[blended].mean()) if blended.any() else None,
        "flagged_share_of_found": float(stars.blend_seen[found].mean()) if found.any() else None,
        "flagged_share_of_single": float(stars.blend_seen[~blended & stars.found].mean())
        if (~blended & stars.found).any()
        else None,
    }


def _false_excess(evaluation: Evaluation) -> float:
    """False detections per frame less those of empty frames, in standard deviations of both counts."""
    stars = evaluation.stars
    mine, empty = int((~stars.false_spike).sum()), evaluation.empty_detections
    spread = np.sqrt((mine + 1) / stars.frames**2 + (empty + 1) / evaluation.empty_frames**2)
    return float((mine / stars.frames - empty / evaluation.empty_frames) / spread)


def _largest(evaluation: Evaluation) -> float:
    return float(evaluation.wcs_miss_px.max()) if len(evaluation.wcs_miss_px) else float("nan")


def _magnitude_of_half(evaluation: Evaluation) -> float | None:
    """Where the completeness falls below one half for good; None where it never does."""
    stars = evaluation.stars
    if not len(stars.magnitude):
        return None
    edges = np.arange(np.floor(stars.magnitude.min()), stars.magnitude.max() + 0.25, 0.25)
    one = completeness(stars, stars.magnitude, edges)
    enough = one.stars >= 5
    middle, share = one.middle[enough], one.share[enough]
    below = np.flatnonzero(share >= 0.5)
    if not len(below) or below[-1] + 1 >= len(share):
        return None
    k = int(below[-1])
    return float(np.interp(0.5, [share[k + 1], share[k]], [middle[k + 1], middle[k]]))


def criteria(result: Result) -> list[Criterion]:
    """What has to hold."""
    made = [
        Criterion(
            name="frames that are there and whole", value=len(result.facts), limit=result.config.frames, relation=">="
        )
    ]
    if result.resume is not None:
        made.append(
            Criterion(
                name="frames that differ after a killed run was taken up again",
                value=result.resume.frames - result.resume.same_bytes,
                limit=0,
            )
        )
    evaluation = result.evaluation
    if evaluation is None or not len(evaluation.stars.magnitude):
        return made
    stars = evaluation.stars
    undisturbed = stars.clean & (stars.snr >= BRIGHT_SNR)
    if undisturbed.any():
        made.append(
            Criterion(
                name=f"share of undisturbed stars of SNR {BRIGHT_SNR:g} and more that are detected",
                value=float(stars.found[undisturbed].mean()),
                limit=LEAST_COMPLETE,
                relation=">=",
            )
        )
    made += _centroids(evaluation)
    if result.config.radiation.environment == "none":  # a track looks like a star to the detection
        made.append(
            Criterion(
                name="detections without star and flag, more than in frames without stars by",
                value=_false_excess(evaluation),
                limit=FALSE_SIGMA,
                unit="sigma",
            )
        )
    if len(evaluation.wcs_miss_px):
        made.append(
            Criterion(
                name="world coordinates in astropy against chief rays, largest",
                value=_largest(evaluation),
                limit=WCS_LIMIT_PX,
                unit="px",
            )
        )
    return made + (_attitude(result, evaluation) if evaluation.solved else [])


def _centroids(evaluation: Evaluation) -> list[Criterion]:
    """Errors may not be below the bound, and not far above it."""
    bins = centroid_bins(evaluation)
    inside = (bins.snr >= BOUND_SNR[0]) & (bins.snr <= BOUND_SNR[1])
    if bins.stars[inside].sum() < BOUND_STARS:
        return []
    ratio = float(np.average(bins.ratio[inside], weights=bins.stars[inside]))
    name = f"centroid error over its Cramer-Rao bound, SNR {BOUND_SNR[0]:g} to {BOUND_SNR[1]:g}"
    return [
        Criterion(name=f"{name}, not less than", value=ratio, limit=BOUND_RATIO[0], relation=">="),
        Criterion(name=f"{name}, not more than", value=ratio, limit=BOUND_RATIO[1]),
    ]


def _attitude(result: Result, evaluation: Evaluation) -> list[Criterion]:
    judged = solver(evaluation.solved)
    scale = result.scene.instrument.pixel_arcsec / MEDIAN_PIXEL_ARCSEC
    return [
        Criterion(
            name=f"frames that tetra3rs does not solve, of {judged.attempted}",
            value=judged.attempted - judged.solved,
            limit=max(1, math.floor(UNSOLVED_SHARE * judged.attempted)),
        ),
        Criterion(
            name="boresight error, median",
            value=judged.median_arcsec,
            limit=round(max(LARGEST_MEDIAN_ARCSEC * scale, TWICE * judged.sigma_arcsec), 3),
            unit="arcsec",
        ),
        Criterion(name="frames that match a mirrored sky", value=judged.mirrored, limit=0),
        Criterion(
            name="attitude error over its predicted sigma, RMS of x, y and roll",
            value=float(np.sqrt(np.mean(judged.pull**2))),
            limit=PULL_LIMIT * (1.0 + 3.0 / math.sqrt(6 * max(judged.solved, 1))),
        ),
    ]
