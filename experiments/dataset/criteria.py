"""What has to hold for a dataset and for what is found in its frames."""

from __future__ import annotations

import math

import numpy as np

from experiments.dataset.evaluation.statistics import BOUND_SNR, BRIGHT_SNR
from experiments.harness.quantities import Outcome
from experiments.harness.summary import Criterion

__all__ = ["criteria"]

UNSOLVED_SHARE = 0.005
"""One frame may fail anyway."""
LARGEST_MEDIAN_ARCSEC = 0.5
MEDIAN_PIXEL_ARCSEC = 44.32
"""The median was asked for at 1024 pixels over 12 deg; other cameras are judged by the same part of a pixel."""
TWICE = 2.0
"""Where few or faint stars make attitudes worse than that, the error may be twice the predicted one."""
WCS_LIMIT_PX = 0.01
PULL_LIMIT = 1.3
LEAST_COMPLETE = 0.99
BOUND_RATIO = (0.93, 1.3)
BOUND_STARS = 200
"""Fewer tell the ratio to worse than 5 %."""
FALSE_SIGMA = 4.0


def criteria(outcome: Outcome) -> list[Criterion]:
    """Frames that are whole and resumed alike; of frames with stars: detection, centroids, coordinates, attitudes."""
    config, evaluation = outcome.config, outcome.result.evaluation
    made = [
        Criterion(
            name="frames that are there and whole", value=outcome.value("frames"), limit=config.frames, relation=">="
        )
    ]
    if outcome.result.resume is not None:
        made.append(
            Criterion(
                name="frames that differ after a killed run was taken up again",
                value=outcome.value("resume_frames") - outcome.value("resume_same_bytes"),
                limit=0,
            )
        )
    if evaluation is None or not len(evaluation.stars.magnitude):
        return made
    made += _detections(outcome)
    if len(evaluation.wcs_miss_px):
        made.append(
            Criterion(
                name="world coordinates in astropy against chief rays, largest",
                value=outcome.value("wcs_max_error_px"),
                limit=WCS_LIMIT_PX,
                unit="px",
            )
        )
    return made + (_attitudes(outcome) if evaluation.solved else [])


def _detections(outcome: Outcome) -> list[Criterion]:
    """Bright stars are found, centroid errors neither below their bound nor far above it, noise not taken for stars."""
    made, found = [], outcome.value("bright_undisturbed")
    if np.isfinite(found):
        name = f"share of undisturbed stars of SNR {BRIGHT_SNR:g} and more that are detected"
        made.append(Criterion(name=name, value=found, limit=LEAST_COMPLETE, relation=">="))
    ratio = outcome.value("bound_ratio")
    if ratio.n >= BOUND_STARS:
        name = f"centroid error over its Cramer-Rao bound, SNR {BOUND_SNR[0]:g} to {BOUND_SNR[1]:g}"
        made += [
            Criterion(name=f"{name}, not less than", value=ratio.value, limit=BOUND_RATIO[0], relation=">="),
            Criterion(name=f"{name}, not more than", value=ratio.value, limit=BOUND_RATIO[1]),
        ]
    if outcome.config.radiation.environment == "none":  # a track looks like a star to the detection
        made.append(
            Criterion(
                name="detections without star and flag, more than in frames without stars by",
                value=outcome.value("false_excess"),
                limit=FALSE_SIGMA,
                unit="sigma",
            )
        )
    return made


def _attitudes(outcome: Outcome) -> list[Criterion]:
    """Nearly all frames are solved, and as well as their covariances say."""
    attempted, solved = outcome.value("attempted"), outcome.value("solved")
    scale = outcome.result.scene.instrument.pixel_arcsec / MEDIAN_PIXEL_ARCSEC
    return [
        Criterion(
            name=f"frames that tetra3rs does not solve, of {attempted}",
            value=attempted - solved,
            limit=max(1, math.floor(UNSOLVED_SHARE * attempted)),
        ),
        Criterion(
            name="boresight error, median",
            value=outcome.value("median_arcsec").value,
            limit=round(max(LARGEST_MEDIAN_ARCSEC * scale, TWICE * outcome.value("sigma_arcsec")), 3),
            unit="arcsec",
        ),
        Criterion(name="frames that match a mirrored sky", value=outcome.value("mirrored"), limit=0),
        Criterion(
            name="attitude error over its predicted sigma, RMS of x, y and roll",
            value=float(np.sqrt(np.mean(outcome.values("pull_rms") ** 2))),
            limit=PULL_LIMIT * (1.0 + 3.0 / math.sqrt(6 * max(solved, 1))),
        ),
    ]
