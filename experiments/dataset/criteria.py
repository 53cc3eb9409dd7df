"""What has to hold for a dataset and for what is found in its frames."""

from __future__ import annotations

import math

import numpy as np
from scipy.stats import f

from experiments.dataset.evaluation.independent import LEAST_KEPT, TURN_DEG
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
POINTING_ARCSEC = 1e-3
PLAIN_FOUND = 0.5
"""Faint stars, and stars with unseen neighbours, fall out of the fit: a quarter at most. Of empty windows all do."""
FALSE_ALARM = 1e-3
TURNED_SIGMA = 1.0
"""The same noise in the same stars; those that change are few."""


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
    made += _independent(outcome)
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


def _independent(outcome: Outcome) -> list[Criterion]:
    """By plain NumPy and astropy from files and records, and a turn that was put in."""
    frames, turned = int(outcome.values("plain_frames")), float(outcome.values("turned_off_sigma"))
    made = [
        Criterion(
            name="written boresight and roll against the written quaternion, by astropy, largest",
            value=float(outcome.values("pointing_off_arcsec")),
            limit=POINTING_ARCSEC,
            unit="arcsec",
        )
    ]
    if frames:
        made += [
            Criterion(
                name=f"stars of {frames} files where written quaternion and a pinhole put them, least part",
                value=float(outcome.values("plain_found")),
                limit=PLAIN_FOUND,
                relation=">=",
            ),
            Criterion(
                name=f"written attitudes of {frames} files against their pixels by plain NumPy, RMS in sigma",
                value=float(np.sqrt(outcome.values("plain_square") / (3 * frames))),
                limit=float(np.sqrt(f.isf(FALSE_ALARM, 3 * frames, 2 * LEAST_KEPT - 6))),
            ),
        ]
    if np.isfinite(turned):
        name = f"stars turned by {TURN_DEG:g} deg about the middle: blind attitude off that turn, sense included"
        made.append(Criterion(name=name, value=turned, limit=TURNED_SIGMA, unit="sigma"))
    return made


def _attitudes(outcome: Outcome) -> list[Criterion]:
    """Nearly all frames are solved, and as well as their covariances say."""
    attempted, solved = outcome.value("attempted"), outcome.value("solved")
    solver = "tetra3rs" if outcome.result.evaluation.blind else "a rough attitude"
    scale = outcome.result.scene.instrument.pixel_arcsec / MEDIAN_PIXEL_ARCSEC
    return [
        Criterion(
            name=f"frames that {solver} does not solve, of {attempted}",
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
