"""Checks of own frames from their own pixels: gain, motion, noise, order, duplicates, range of the converter.

Every number has its own statistic, and none needs more than the frames:

``gain``
    Photon transfer (Janesick 2007; EMVA 1288 Release 4.0, sec. 6.6): the temporal variance of a pixel grows with its
    mean by K. Of flats, if there are several; else of the windows, from which what a moving image and a flickering lamp
    add is projected out frame by frame (the mean image, and itself shifted by whole pixels, of which a shift by parts
    of one is made); the variance that the projection takes from every pixel is accounted for.
``motion``
    What all points of a frame have in common. Without motion J times the variance of the common part over the variance
    of what is left of the points follows Fisher's F with (N - 1) and (N - 1)(J - 1) degrees of freedom; with a motion
    of the variance m^2 it is larger by 1 + J m^2 / s^2.
``moved``, ``light``, ``lag``, ``shared``
    Jumps and drift of place and light, correlation from frame to frame, noise that two frames share
    (`experiments.reduce.sequence`).
``noise``
    Standard deviation of the centroids over that of the noise model.
``copies``, ``disorder``
    Frames of the folder that equal another one; frames that were taken before the one that they follow.
``step``, ``clipped``, ``zero``
    Common divisor of all readings; how often the highest reading comes against the four below it; share of readings of
    0.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import convolve
from scipy.stats import f as fisher_f
from scipy.stats import poisson

from experiments.harness.quantities import Outcome
from experiments.harness.sections import Section, below, col, ratio_near, two_sided_limit
from experiments.harness.summary import Measured
from experiments.reduce.folder import FrameFolder, FrameSeries
from experiments.reduce.sequence import (
    FALSE_ALARM,
    Change,
    Lag,
    Shared,
    largest_change,
    shared_noise,
    without_modes,
)
from experiments.reduce.series import SeriesFrames
from optics.arrays import FloatArray

GAIN_ALLOWANCE = 0.05
"""Largest relative error of photon transfer: charge shared between pixels lowers the variance by some per cent."""
NOISE_ALLOWANCE = 0.05
"""Largest relative error of the noise model: motion that is let pass makes 3 %, and read noise differs from pixel to
pixel."""
LIGHT_ALLOWANCE = 0.05
"""Change of light that is let pass: it changes the noise by less than 3 %."""
MOTION_SHARE = 0.06
"""Motion that raises the scatter of a point by 3 % is let pass: its variance over that of the point."""
FEWEST_FOR_MOTION = 3
TOP_READINGS = 5
FEWEST_PIXELS = 30
ITERATIONS = 8
SHOWN = 3
"""Frames that a message names."""
AROUND = np.array([[1.0, 1.0, 1.0], [1.0, 0.0, 1.0], [1.0, 1.0, 1.0]])


@dataclass(frozen=True, slots=True, kw_only=True)
class Motion:
    """Common motion of the points of a series along an axis."""

    series: str  # Where
    axis: str  # Where
    rms_px: float  # Standard deviation of the common part from frame to frame, noise of the points included
    limit_px: float  # What it may be (see the module)


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameChecks:
    """All series of a folder together. Gain without two frames in a series or enough light: None; so is the rest."""

    stated_gain: float = col("Gain, stated", "DN/e-", json="gain_dn_per_e.stated")
    transfer_gain: Measured | None = col("Gain, photon transfer", "DN/e-", json="gain_dn_per_e.photon_transfer")
    gain_ratio: Measured | None = col("Gain by photon transfer over stated gain", json="")  # None where it says nothing
    noise_ratio: Measured | None = col("Scatter over noise model")
    motion: Motion | None  # The largest against its limit; None for single points or fewer than three frames
    common_motion_px: float | None = col("Common motion", "px", ".4f")
    motion_limit_px: float | None = col("Tolerated common motion", "px", ".4f", json="")
    # The most significant of all series against its limit each, None where no series has frames enough
    moved: Change | None
    moved_px: float | None = col("Jump or drift of the target", "px", ".4f")
    moved_limit_px: float | None = col("Jump or drift expected from noise", "px", ".4f", json="")
    light: Change | None
    light_change: float | None = col("Jump or drift of the light")
    light_limit: float | None = col("Tolerated jump or drift of the light", json="")
    lag: Lag | None
    lag_correlation: float | None = col("Correlation of a frame with the next one")
    lag_limit: float | None = col("Correlation expected from white noise", json="")
    shared: Shared | None
    shared_noise: float | None = col("Correlation of the noise of two frames")
    shared_limit: float | None = col("Tolerated correlation of the noise of two frames", json="")
    disorder: Sequence[str]  # "FILE after FILE", of frames that were taken before the one that they follow
    disordered: int = col("Frames out of the order of exposure", json="")
    frames: int  # Of all series
    copied: Sequence[str]  # "FILE = FILE", of frames that equal an earlier one of the folder
    copies: int = col("Frames identical to another frame", json="")
    step_dn: int = col("Largest number that divides all differences of readings", "DN", json="")
    top_dn: int = col("Highest reading", "DN", json="")
    top_count: int = col("Pixels at the highest reading", json="")
    top_limit: int = col("Pixels at the highest reading expected by chance", json="")
    zero_fraction: float = col("Share of readings of 0", json="")
    flat_pattern: tuple[float, float] | None  # Response from pixel to pixel that the flat shows, and its noise
    flat_noise: float | None = col("Noise of the mean flat over its pattern", json="")


def check_frames(folder: FrameFolder, reduced: Sequence[SeriesFrames], method: str) -> FrameChecks:
    """Check all series of a folder; ``method`` is the main centroider."""
    series, stated, tests = folder.series, folder.settings.gain_dn_per_e, len(reduced)
    several = [one for one in series if len(one.windows.dn) > 1]
    motions = [
        motion for one in reduced for motion in common_motion(one.points.position_px[method], one.name, tests=2 * tests)
    ]
    motion = max(motions, key=lambda one: one.rms_px / one.limit_px, default=None)
    gain = None if folder.flat is None else folder.flat.gain
    gain = gain or photon_transfer([one.windows.dn for one in several], [~one.windows.defect for one in several])
    moved = _farthest(change for one in reduced for change in _moves(one, method, tests))
    light = _farthest(
        largest_change(one.light, one.origin, one.name, "the light", false_alarm=FALSE_ALARM / tests) for one in reduced
    )
    lag = _farthest(lag for one in reduced for lag in one.lags)
    shared = _farthest(_shared(one, tests) for one in several)
    copied, disorder = _copied(series), _disorder(series)
    pattern = None if folder.flat is None else folder.flat.pattern
    return FrameChecks(
        stated_gain=stated,
        transfer_gain=gain,
        gain_ratio=_gain_ratio(gain, stated),
        noise_ratio=_noise_ratio(reduced, method),
        motion=motion,
        common_motion_px=None if motion is None else motion.rms_px,
        motion_limit_px=None if motion is None else motion.limit_px,
        moved=moved,
        moved_px=None if moved is None else moved.size,
        moved_limit_px=None if moved is None else moved.limit,
        light=light,
        light_change=None if light is None else light.size,
        light_limit=None if light is None else max(light.limit, LIGHT_ALLOWANCE),
        lag=lag,
        lag_correlation=None if lag is None else lag.value,
        lag_limit=None if lag is None else lag.limit,
        shared=shared,
        shared_noise=None if shared is None else shared.value,
        shared_limit=None if shared is None else shared.limit,
        disorder=disorder,
        disordered=len(disorder),
        frames=sum(len(one.windows.dn) for one in series),
        copied=copied,
        copies=len(copied),
        **_converter(series),
        flat_pattern=pattern,
        flat_noise=None if pattern is None else pattern[1] / max(pattern[0], 1e-12),
    )


def _farthest(found: Iterable[Any]) -> Any:
    """The value that exceeds its limit most, or comes nearest to it."""
    there = [one for one in found if one is not None]
    return max(there, key=lambda one: abs(one.value) / one.limit, default=None)


def _moves(one: SeriesFrames, method: str, tests: int) -> Iterator[Change | None]:
    """Changes of place of all points together, along x and y."""
    place = one.points.position_px[method]
    whole = np.flatnonzero(np.isfinite(place).all((1, 2)))
    names = [one.origin[number] for number in whole]
    for axis in range(2):
        track = place[whole, :, axis].mean(1)
        yield largest_change(track, names, one.name, f"the image ({'xy'[axis]})", false_alarm=FALSE_ALARM / (2 * tests))


def _shared(one: FrameSeries, tests: int) -> Shared | None:
    """Noise that two frames share, copies left out."""
    kept = _unique(one)
    return shared_noise(
        one.windows.dn[kept],
        ~one.windows.defect,
        [one.origin[number] for number in kept],
        one.name,
        false_alarm=FALSE_ALARM / tests,
    )


def _copied(series: Sequence[FrameSeries]) -> list[str]:
    """Frames that equal an earlier one: all pixels of any in the folder, or the windows of one of their series."""
    first: dict[str, str] = {}
    found = []
    for one in series:
        seen: dict[bytes, str] = {}
        for frame, name, digest in zip(one.windows.dn, one.origin, one.digest, strict=True):
            before = first.setdefault(digest, name), seen.setdefault(frame.tobytes(), name)
            other = next((earlier for earlier in before if earlier != name), None)
            if other is not None:
                found.append(f"{name} = {other}")
    return found


def _disorder(series: Sequence[FrameSeries]) -> list[str]:
    """Files of a series that were taken before the one that they follow."""
    found = []
    for one in series:
        files = list(dict.fromkeys(name.partition("[")[0] for name in one.origin))
        pairs = zip(files, files[1:], one.taken, one.taken[1:], strict=False)
        found += [f"{later} after {earlier}" for earlier, later, before, after in pairs if after < before]
    return found


def _converter(series: Sequence[FrameSeries]) -> dict[str, Any]:
    """The ends and the step of the converter."""
    readings = [np.unique(_each_once(one), return_counts=True) for one in series]
    top, count, limit = _top(readings)
    zero = sum(int(counts[values == 0].sum()) for values, counts in readings)
    steps = np.concatenate([np.diff(values.astype(np.int64)) for values, _ in readings])
    return {
        "step_dn": int(np.gcd.reduce(steps)) if steps.size else 1,
        "top_dn": top,
        "top_count": count,
        "top_limit": limit,
        "zero_fraction": zero / sum(int(counts.sum()) for _, counts in readings),
    }


def _gain_ratio(gain: Measured | None, stated: float) -> Measured | None:
    """Photon transfer over the stated gain."""
    if gain is None or gain.uncertainty is None:
        return None
    return Measured(value=gain.value / stated, uncertainty=gain.uncertainty / stated, n=gain.n)


def _unique(series: FrameSeries) -> list[int]:
    """Numbers of the frames of a series that equal none before them."""
    seen: dict[bytes, int] = {}
    for number, frame in enumerate(series.windows.dn):
        seen.setdefault(frame.tobytes(), number)
    return list(seen.values())


def _each_once(series: FrameSeries) -> NDArray[np.uint16]:
    """Readings of usable pixels, copies of frames left out."""
    return np.asarray(series.windows.dn[_unique(series)][:, ~series.windows.defect])


def _top(readings: Sequence[tuple[NDArray[np.uint16], NDArray[np.int64]]]) -> tuple[int, int, int]:
    """Highest reading, how often it comes, and how often a Poisson variate with the mean of the four below it would."""
    top = max(int(values[-1]) for values, _ in readings)
    steps = [int(np.diff(values.astype(np.int64)).min()) for values, _ in readings if len(values) > 1]
    step = min(steps, default=1)
    counts = np.zeros(TOP_READINGS, np.int64)
    for values, number in readings:
        below = (top - values.astype(np.int64)) // step
        near = below < TOP_READINGS
        np.add.at(counts, below[near], number[near])
    expected = max(float(counts[1:].mean()), 1.0)
    return top, int(counts[0]), int(poisson.isf(FALSE_ALARM, expected))


def common_motion(position_px: FloatArray, name: str, *, tests: int = 1) -> list[Motion]:
    """Common motion along x and y from centroids (f, j, 2); nothing for one point or fewer than three whole frames."""
    place = position_px[np.isfinite(position_px).all((1, 2))]
    frames, points, _ = place.shape
    if points < 2 or frames < FEWEST_FOR_MOTION:
        return []
    apart = place - place.mean(0)
    common = apart.mean(1)
    left = ((apart - common[:, None]) ** 2).sum((0, 1)) / ((frames - 1) * (points - 1))
    quantile = float(fisher_f.isf(FALSE_ALARM / tests, frames - 1, (frames - 1) * (points - 1)))
    limit = np.sqrt(np.maximum(left, 1e-24) / points * quantile * (1.0 + points * MOTION_SHARE))
    rms = np.sqrt((common**2).sum(0) / (frames - 1))
    return [Motion(series=name, axis="xy"[a], rms_px=float(rms[a]), limit_px=float(limit[a])) for a in range(2)]


def _noise_ratio(reduced: Sequence[SeriesFrames], method: str) -> Measured | None:
    """Root of the sum of measured variances over that of modelled ones, points, axes and series together."""
    seen = modelled = spread = 0.0
    samples = 0
    for one in reduced:
        if one.frames < 2:
            continue
        model = one.predicted_px(method) ** 2
        seen += float(np.nansum(one.points.sigma_px(method) ** 2) * (one.frames - 1))
        modelled += float(model.sum() * (one.frames - 1))
        spread += float(2.0 * (model**2).sum() * (one.frames - 1)) * one.frames / one.effective_frames
        samples += one.frames * len(model)
    if not modelled:
        return None
    ratio = float(np.sqrt(seen / modelled))
    return Measured(value=ratio, uncertainty=0.5 * float(np.sqrt(spread)) / modelled, n=samples)


def photon_transfer(dn: Sequence[NDArray[np.uint16]], usable: Sequence[NDArray[np.bool_]]) -> Measured | None:
    """System gain K [DN/e-] by the growth of the temporal variance of pixels with their mean.

    Offsets differ from pixel to pixel, so that the mean of a pixel is its light with an error, which would lower the
    slope of least squares; the mean of its neighbours has the light without that error and serves as the instrument
    (Durbin 1954). Offsets that scatter by 3 % of the brightest pixel still lower K by some 6 %. The standard deviation
    is that of White (1980): it needs no word about how read noise differs.
    """
    parts = [_window_variances(np.asarray(one, float), ok) for one, ok in zip(dn, usable, strict=True)]
    if not parts or sum(len(variance) for variance, *_ in parts) < FEWEST_PIXELS:
        return None
    variance, design, instrument, degrees = (np.concatenate(column) for column in zip(*parts, strict=True))
    weight = degrees / np.maximum(np.full(len(variance), variance.mean()), 1e-12) ** 2
    for _ in range(ITERATIONS):
        back = np.linalg.pinv(instrument.T @ (weight[:, None] * design))
        found = back @ (instrument.T @ (weight * variance))
        expected = np.maximum(design @ found, max(1e-3 * float(variance.mean()), 1e-12))
        weight = degrees / expected**2
    moved = back @ (instrument * (weight * (variance - design @ found))[:, None]).T
    covariance = moved @ moved.T
    return Measured(value=float(found[1]), unit="DN/e-", uncertainty=float(np.sqrt(covariance[1, 1])), n=len(variance))


def _window_variances(
    dn: FloatArray, usable: NDArray[np.bool_]
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Temporal variances (n,) of pixels, what multiplies (floor, K) in their expectation (n, 2), degrees of freedom.

    Third of four: the same with the mean of a pixel's neighbours in place of its own (n, 2).

    With M the projection on what is neither the mean image nor a shifted one, the residual of pixel i has the variance
    sum_k M_ik^2 v_k, v_k = floor + K mean_k.
    """
    frames = len(dn)
    variances, designs, instruments = [], [], []
    for number in range(dn.shape[1]):
        mean, ok = dn[:, number].mean(0), usable[number]
        left, keep = without_modes(dn[:, number], ok)
        taken = keep**2
        variances.append((left**2).sum(0) / (frames - 1))
        around = convolve(np.where(ok, mean, 0.0), AROUND) / np.maximum(convolve(ok.astype(float), AROUND), 1.0)
        designs.append(np.column_stack([taken.sum(1), taken @ mean[ok]]))
        instruments.append(np.column_stack([taken.sum(1), taken @ around[ok]]))
    variance = np.concatenate(variances)
    return variance, np.concatenate(designs), np.concatenate(instruments), np.full(len(variance), frames - 1.0)


def _checks(outcome: Outcome) -> FrameChecks:
    checks: FrameChecks = outcome.result["checks"]
    return checks


def _some(names: Sequence[str]) -> str:
    more = f" and {len(names) - SHOWN} more" if len(names) > SHOWN else ""
    return ", ".join(names[:SHOWN]) + more


def _copies_advice(outcome: Outcome) -> str:
    checks = _checks(outcome)
    return (
        f"{checks.copies} of {checks.frames} frames are copies ({_some(checks.copied)}): a frame was stored several "
        "times, or the camera did not refresh; copies have no independent noise: remove them"
    )


def _shared_advice(outcome: Outcome) -> str:
    shared = _checks(outcome).shared
    assert shared is not None
    return (
        f"the noise of {shared.frames[0]} and {shared.frames[1]} ({shared.series}) is {shared.value:.0%} the same: one "
        "was made from the other, or the camera averages over frames (noise reduction); frames must be independent"
    )


def _disorder_advice(outcome: Outcome) -> str:
    return (
        f"{_some(_checks(outcome).disorder)}, but taken earlier by DATE-OBS or FRAMENUM: frames are read in the order "
        "of their names; list the files in the order of their exposure, otherwise drift and correlation are wrong"
    )


def _moved_advice(outcome: Outcome) -> str:
    """Words on a jump or drift beyond its limit; none for less."""
    moved = _checks(outcome).moved
    if moved is None or not moved.found:
        return ""
    return f"{moved.words('+.3f', ' px')}: the target or the camera is not at rest; split the series there"


def _light_advice(outcome: Outcome) -> str:
    light = _checks(outcome).light
    assert light is not None
    return f"{light.words('+.1%', '')}: the lamp, the exposure time, or a frame behind another filter"


def _lag_advice(outcome: Outcome) -> str:
    """Words on frames that are no white noise."""
    lag = _checks(outcome).lag
    assert lag is not None
    where = f"frames of {lag.series} are not independent: {lag.what}, correlation {lag.value:+.2f} with the next frame"
    if lag.value < 0:
        return f"{where}: a vibration near half of the frame rate, which N frames average out better than white noise"
    return (
        f"{where}: drift, air, or a vibration that the frame rate aliases; N frames equal N (1 - r) / (1 + r) "
        "independent ones, as the stated errors assume"
    )


def _step_advice(outcome: Outcome) -> str:
    return (
        f"all readings are {_checks(outcome).step_dn} DN apart or a multiple: a converter of fewer bits, shifted to "
        "the left; divide the frames (and gain_dn_per_e, offset_dn, saturation_dn) by this step"
    )


def _top_advice(outcome: Outcome) -> str:
    one = _checks(outcome)
    return (
        f"the highest reading occurs {one.top_count} times, at most {one.top_limit} times by chance: pixels are "
        f"saturated there; state saturation_dn = {one.top_dn} and lower the lamp or the exposure"
    )


def _motion_advice(outcome: Outcome) -> str:
    """Words on a motion beyond its limit; none for less."""
    motion = _checks(outcome).motion
    if motion is None or motion.rms_px <= motion.limit_px:
        return _moved_advice(outcome)
    return _moved_advice(outcome) or (
        f"the image moves by {motion.rms_px:.2g} px from frame to frame, all points alike ({motion.series}, "
        f"{motion.axis}): vibration, or a target that is not at rest"
    )


def _gain_advice(outcome: Outcome) -> str:
    """Words on the motion, which disturbs photon transfer, or on a gain beyond its limit."""
    checks = _checks(outcome)
    gain, ratio, stated = checks.transfer_gain, checks.gain_ratio, checks.stated_gain
    moves = _motion_advice(outcome)
    if moves or gain is None or ratio is None:
        return moves
    noise = two_sided_limit(1, FALSE_ALARM) * (ratio.uncertainty or 0.0)
    if abs(ratio.value - 1.0) <= GAIN_ALLOWANCE + noise:
        return ""
    words = (
        f"variance against mean gives {gain.value:.3g} ± {gain.uncertainty:.1g} DN/e⁻, gain_dn_per_e is {stated:.3g}"
    )
    if abs(gain.value * stated - 1.0) < 0.3:
        return f"{words}, the reciprocal: it was given in e⁻/DN"
    return f"{words}: wrong for this gain setting, or frames were averaged, scaled or smoothed before they were stored"


def _noise_advice(outcome: Outcome) -> str:
    checks = _checks(outcome)
    ratio = float("nan") if checks.noise_ratio is None else checks.noise_ratio.value
    if checks.copies:
        cause = f"{checks.copies} frames are copies"
    elif not (cause := _gain_advice(outcome)):
        more = (
            "points scatter more than by photon and read noise (vibration, air, a flickering lamp, or "
            "read_noise_e is the median of pixels that differ, where the RMS is needed)"
        )
        less = "points scatter less than by photon and read noise (frames averaged or smoothed, read_noise_e)"
        cause = more if ratio > 1.0 else less
    return f"the ratio is {ratio:.3g}: {cause}"


def _flat_advice(outcome: Outcome) -> str:
    spread, noise = _checks(outcome).flat_pattern or (0.0, 0.0)
    return (
        f"the flat shows {spread:.2%} from pixel to pixel, of which {noise:.2%} is its own noise: it adds more "
        "noise than it corrects; average more or brighter flats, or leave it out"
    )


CHECKS = Section(
    record=FrameChecks,
    verdicts=[
        below("copies", 0, title="frames identical to another frame", advice=_copies_advice),
        below("shared_noise", "shared_limit", title="common noise of two frames", advice=_shared_advice),
        below("disordered", 0, title="frames out of the order of exposure", advice=_disorder_advice),
        below("step_dn", 1, title="common step of all readings", advice=_step_advice),
        below("top_count", "top_limit", title="pixels at the highest reading", advice=_top_advice),
        below(
            "zero_fraction",
            1e-3,
            title="share of readings of 0 DN",
            advice="noise is clipped at zero: raise the camera's offset; or dark frames were already subtracted",
        ),
        ratio_near(
            "gain_ratio",
            within=GAIN_ALLOWANCE,
            false_alarm=FALSE_ALARM,
            title="gain by photon transfer over stated gain",
            advice=_gain_advice,
        ),
        below(
            "common_motion_px",
            "motion_limit_px",
            title="common motion of all points from frame to frame, the largest of all series",
            advice=_motion_advice,
        ),
        below(
            "moved_px",
            "moved_limit_px",
            size=True,
            title="jump or drift of the image within a series, the most significant",
            advice=_moved_advice,
        ),
        below(
            "light_change",
            "light_limit",
            size=True,
            title="jump or drift of the light within a series, the most significant",
            advice=_light_advice,
        ),
        below(
            "lag_correlation",
            "lag_limit",
            size=True,
            title="correlation of frames with the next one, the most significant",
            advice=_lag_advice,
        ),
        ratio_near(
            "noise_ratio",
            within=NOISE_ALLOWANCE,
            false_alarm=FALSE_ALARM,
            title="centroid scatter over its prediction from the stated noise",
            advice=_noise_advice,
        ),
        below(
            "flat_noise",
            0.5**0.5,  # A flat must know the response better than leaving it out does
            title="noise of the mean flat over its pixel-to-pixel pattern",
            advice=_flat_advice,
        ),
    ],
)
