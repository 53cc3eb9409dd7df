"""What has to hold for frames from outside: they are what the folder says they are. Each says what is likely wrong."""

from __future__ import annotations

from experiments.harness.quantities import Outcome
from experiments.harness.summary import Criterion
from experiments.laboratory.own_frames.checks import FrameChecks
from experiments.laboratory.own_frames.masters import Flat

__all__ = ["criteria"]

SIGMA_LIMIT = 4.0
GAIN_ALLOWANCE = 0.15
"""What photon transfer may be off: charge shared between pixels and the growth of images with brightness lower the
variance by up to a tenth in many detectors."""
NOISE_ALLOWANCE = 0.15
"""What the noise model may be off: motion that is let pass makes 10 %, and read noise differs from pixel to pixel."""
GAIN_DETERMINED = 0.1
"""Photon transfer worse than this part of its value says nothing."""


def criteria(outcome: Outcome) -> list[Criterion]:
    """Of the frames themselves, then those of the experiment's own reduction."""
    result = outcome.result
    checks: FrameChecks = result.checks
    return [
        Criterion(
            name="frames that gave a position, smallest share over points and centroiders",
            value=float(outcome.values("usable_fraction").min()),
            limit=0.9,
            relation=">=",
            advice="points are too faint for this centroider, or windows too small for the spot",
        ),
        *_of_readings(checks),
        *_of_statistics(checks, result.folder.settings.gain_dn_per_e),
        *_of_the_flat(result.folder.flat),
        *result.test.criteria(outcome),
    ]


def _of_readings(checks: FrameChecks) -> list[Criterion]:
    return [
        Criterion(
            name="frames that repeat another frame of their series, pixel by pixel",
            value=checks.copies,
            limit=0,
            advice=f"{checks.copies} of {checks.frames} frames are copies: one frame was stored several times, or the "
            "camera did not refresh; noise of copies is not noise",
        ),
        Criterion(
            name="common step of all readings",
            value=checks.step_dn,
            limit=1,
            unit="DN",
            advice=f"all readings are {checks.step_dn} DN apart or a multiple: a converter of fewer bits, shifted to "
            "the left; divide the frames (and gain_dn_per_e, offset_dn, saturation_dn) by it",
        ),
        Criterion(
            name=f"pixels at the highest reading of all, {checks.top_dn} DN",
            value=checks.top_count,
            limit=checks.top_limit,
            advice=f"the highest reading comes {checks.top_count} times, chance lets it come {checks.top_limit} times: "
            f"pixels are saturated there; state saturation_dn = {checks.top_dn} and lower the lamp or the exposure",
        ),
        Criterion(
            name="share of readings of 0 DN",
            value=checks.zero_fraction,
            limit=1e-3,
            advice="noise is cut off at zero: raise the offset of the camera, or dark frames were taken away before",
        ),
    ]


def _of_statistics(checks: FrameChecks, stated_gain: float) -> list[Criterion]:
    found, gain, motion, ratio = [], checks.gain_dn_per_e, checks.motion, checks.noise_ratio
    moves = "" if motion is None or motion.rms_px <= motion.limit_px else _motion_words(checks)
    wrong_gain = ""
    if gain is not None and gain.uncertainty is not None and gain.uncertainty <= GAIN_DETERMINED * max(gain.value, 0.0):
        off, limit = gain.value / stated_gain, GAIN_ALLOWANCE + SIGMA_LIMIT * gain.uncertainty / stated_gain
        if abs(off - 1.0) > limit:
            wrong_gain = _gain_words(gain.value, gain.uncertainty, stated_gain)
        found.append(
            Criterion(
                name="gain by the frames' own photon transfer over the stated one",
                value=off,
                about=1.0,
                limit=limit,
                advice=moves or wrong_gain,
            )
        )
    if motion is not None:
        found.append(
            Criterion(
                name=f"common motion of all points from frame to frame, largest: {motion.series}, {motion.axis}",
                value=motion.rms_px,
                limit=motion.limit_px,
                unit="px",
                advice=moves,
            )
        )
    if ratio is not None and ratio.uncertainty is not None:
        cause = (
            f"{checks.copies} frames are copies" if checks.copies else moves or wrong_gain or _noise_words(ratio.value)
        )
        found.append(
            Criterion(
                name="scatter of the centroids over what the stated noise gives",
                value=ratio.value,
                about=1.0,
                limit=NOISE_ALLOWANCE + SIGMA_LIMIT * ratio.uncertainty,
                advice=f"the ratio is {ratio.value:.3g}: {cause}",
            )
        )
    return found


def _motion_words(checks: FrameChecks) -> str:
    motion = checks.motion
    assert motion is not None
    where = f"{motion.series}, {motion.axis}"
    if motion.drift_share > 0.5:
        return (
            f"the image drifts by {abs(motion.drift_px):.2g} px from the first to the last frame ({where}): the target "
            "or the camera is not at rest"
        )
    return (
        f"the image moves by {motion.rms_px:.2g} px from frame to frame, all points alike ({where}): vibration, or a "
        "target that is not at rest"
    )


def _gain_words(found: float, error: float, stated: float) -> str:
    said = f"variance against mean gives {found:.3g} ± {error:.1g} DN/e⁻, gain_dn_per_e says {stated:.3g}"
    if abs(found * stated - 1.0) < 0.3:
        return f"{said}, the reciprocal: it was given in e⁻/DN"
    return f"{said}: wrong for this gain setting, or frames were averaged, scaled or smoothed before they were stored"


def _noise_words(ratio: float) -> str:
    if ratio > 1.0:
        return "points scatter more than photons and read noise make them (vibration, air, a flickering lamp)"
    return "points scatter less than photons and read noise make them (frames averaged or smoothed, read_noise_e)"


def _of_the_flat(flat: Flat | None) -> list[Criterion]:
    """A flat must know the response better than leaving it out does."""
    if flat is None:
        return []
    spread, noise = flat.pattern
    return [
        Criterion(
            name="noise of the mean flat over the pattern from pixel to pixel that it shows",
            value=noise / max(spread, 1e-12),
            limit=0.5**0.5,
            advice=f"the flat shows {spread:.2%} from pixel to pixel, of which {noise:.2%} is its own noise: it adds "
            "more than it takes away; average more or brighter flats, or leave it out",
        )
    ]
