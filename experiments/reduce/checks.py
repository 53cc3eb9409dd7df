"""Checks of own frames from their own pixels: gain, motion, noise, order, duplicates, range of the converter.

Every number has its own statistic, and none needs more than the frames:

``gain``
    Photon transfer of flats (`calib.detector.photon_transfer`), if there are several; else of the windows
    (`calib.detector.window_photon_transfer`).
``motion``
    Common motion of all points of a frame, against the noise of the points by Fisher's F
    (`calib.measure.statistics.frame_positions`).
``moved``, ``light``, ``lag``
    Jumps and drift of position and light, correlation from frame to frame (`calib.accuracy.frame_sequence`).
``shared``
    Noise that two frames have in common (`calib.detector.window_photon_transfer`).
``noise``
    Standard deviation of the centroids over that of the noise model.
``copies``, ``disorder``
    Frames of the folder that equal another one; frames that were taken before the one that they follow.
``step``, ``clipped``, ``zero``
    Common divisor of all readings; how often the highest reading comes against the four below it; fraction of readings
    of 0 (`calib.detector.adc_range`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import chain, pairwise

import numpy as np
from numpy.typing import NDArray

from calib.accuracy.frame_sequence import Change, largest_change, scatter_ratio
from calib.detector.adc_range import converter_range
from calib.detector.photon_transfer import PhotonTransfer
from calib.detector.window_photon_transfer import FEWEST_PIXELS, common_noise, window_photon_transfer
from calib.measure.statistics.frame_positions import common_motion_limit, common_motion_px2
from experiments.harness.quantities import Outcome
from experiments.harness.sections import Section, Verdict, below, col, ratio_near, two_sided_limit
from experiments.harness.summary import Measured
from experiments.reduce.folder import FrameFolder, FrameSeries
from experiments.reduce.series import FALSE_ALARM, FrameStatistic, SeriesFrames
from optics.arrays import FloatArray

GAIN_ALLOWANCE = 0.05
"""Largest relative error of photon transfer: charge shared between pixels lowers the variance by some per cent."""
NOISE_ALLOWANCE = 0.05
"""Largest relative error of the noise model: tolerated motion adds 3 %, and read noise differs from pixel to pixel."""
LIGHT_ALLOWANCE = 0.05
"""Tolerated relative change of light: it changes the noise by less than 3 %."""
MOTION_ALLOWANCE = 0.06
"""Tolerated variance of the motion over that of a point, whose scatter then grows by 3 %."""
COMMON_NOISE = 0.2
"""Tolerated correlation of the noise of two frames, due to crosstalk and slow patterns."""
FEWEST_FOR_MOTION = 3
SHOWN = 3
"""Frames named in a message."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameChecks:
    """All series of a folder together; None for a check without enough frames, points or light."""

    stated_gain: float = col("Gain, stated", "DN/e-")
    transfer_gain: Measured | None = col("Gain, photon transfer", "DN/e-")
    gain_ratio: Measured | None = col("Gain by photon transfer over stated gain")  # None where it says nothing
    noise_ratio: Measured | None = col("Scatter over noise model")
    # The most significant of all series against its limit each, None where no series has points or frames enough
    findings: Mapping[str, FrameStatistic | None]  # Of motion, moved, light, lag, shared
    common_motion_px: float | None = col("Common motion", "px", ".4f")
    motion_limit_px: float | None = col("Tolerated common motion", "px", ".4f")
    moved_px: float | None = col("Jump or drift of the target", "px", ".4f")
    moved_limit_px: float | None = col("Jump or drift expected from noise", "px", ".4f")
    light_change: float | None = col("Jump or drift of the light")
    light_limit: float | None = col("Tolerated jump or drift of the light")
    lag_correlation: float | None = col("Correlation of a frame with the next one")
    lag_limit: float | None = col("Correlation expected from white noise")
    shared_noise: float | None = col("Correlation of the noise of two frames")
    shared_limit: float | None = col("Tolerated correlation of the noise of two frames")
    disorder: Sequence[str]  # "FILE after FILE", of frames that were taken before the one that they follow
    disordered: int = col("Frames out of the order of exposure")
    frames: int  # Of all series
    copied: Sequence[str]  # "FILE = FILE", of frames that equal an earlier one of the folder
    copies: int = col("Frames identical to another frame")
    step_dn: int = col("Largest number that divides all differences of readings", "DN")
    top_dn: int = col("Highest reading", "DN")
    top_count: int = col("Pixels at the highest reading")
    top_limit: int = col("Pixels at the highest reading expected by chance")
    zero_fraction: float = col("Share of readings of 0")
    flat_pattern: tuple[float, float]  # Response from pixel to pixel that the flat shows, and its noise
    flat_noise: float | None = col("Noise of the mean flat over its pattern")


def check_frames(folder: FrameFolder, reduced: Sequence[SeriesFrames], method: str) -> FrameChecks:
    """Check all series of a folder; ``method`` is the main centroider."""
    series, stated, tests = folder.series, folder.settings.gain_dn_per_e, len(reduced)
    repeated = [frames for frames in series if len(frames.windows.dn) > 1]
    findings = {
        "motion": _worst(chain.from_iterable(_motions(centroids, method, tests) for centroids in reduced)),
        "moved": _worst(chain.from_iterable(_moves(centroids, method, tests) for centroids in reduced)),
        "light": _worst(_light(centroids, tests) for centroids in reduced),
        "lag": _worst(lag for centroids in reduced for lag in centroids.lags),
        "shared": _worst(_shared(frames, tests) for frames in repeated),
    }
    value = {name: None if statistic is None else statistic.value for name, statistic in findings.items()}
    limit = {name: None if statistic is None else statistic.limit for name, statistic in findings.items()}
    gain = _gain(folder, repeated)
    copied, disorder = _copied(series), _disorder(series)
    readings = (frames.windows.dn[_unique(frames)][:, ~frames.windows.defect] for frames in series)
    converter = converter_range(readings, false_alarm=FALSE_ALARM)
    flat = folder.flat
    pattern = (0.0, 0.0) if flat is None else (flat.response.pixel_to_pixel, flat.response.noise)
    return FrameChecks(
        stated_gain=stated,
        transfer_gain=gain,
        gain_ratio=None
        if gain is None
        else Measured(value=gain.value / stated, uncertainty=(gain.uncertainty or 0.0) / stated, n=gain.n),
        noise_ratio=_noise_ratio(reduced, method),
        findings=findings,
        common_motion_px=value["motion"],
        motion_limit_px=limit["motion"],
        moved_px=value["moved"],
        moved_limit_px=limit["moved"],
        light_change=value["light"],
        light_limit=None if limit["light"] is None else max(limit["light"], LIGHT_ALLOWANCE),
        lag_correlation=value["lag"],
        lag_limit=limit["lag"],
        shared_noise=value["shared"],
        shared_limit=limit["shared"],
        disorder=disorder,
        disordered=len(disorder),
        frames=sum(len(frames.windows.dn) for frames in series),
        copied=copied,
        copies=len(copied),
        step_dn=converter.step_dn,
        top_dn=converter.top_dn,
        top_count=converter.top_count,
        top_limit=converter.top_limit,
        zero_fraction=converter.zero_fraction,
        flat_pattern=pattern,
        flat_noise=None if flat is None else pattern[1] / max(pattern[0], 1e-12),
    )


def _worst(findings: Iterable[FrameStatistic | None]) -> FrameStatistic | None:
    """The statistic with the largest ratio to its limit."""
    return max(filter(None, findings), key=lambda statistic: abs(statistic.value) / statistic.limit, default=None)


def _gain(folder: FrameFolder, repeated: Sequence[FrameSeries]) -> Measured | None:
    """Gain by the flats, or by the windows; None without two frames of enough pixels."""
    transfer: PhotonTransfer | None = None if folder.flat is None else folder.flat.transfer
    usable = [~frames.windows.defect for frames in repeated]
    if transfer is None and sum(map(np.count_nonzero, usable)) >= FEWEST_PIXELS:
        transfer = window_photon_transfer([frames.windows.dn for frames in repeated], usable)
    if transfer is None:
        return None
    value, error = transfer.gain_dn_per_e, transfer.gain_error_dn_per_e
    return Measured(value=value, unit="DN/e-", uncertainty=error, n=transfer.pixels)


def _complete(position_px: FloatArray) -> NDArray[np.bool_]:
    """Frames (f,) in which every point has a centroid (f, j, 2)."""
    return np.asarray(np.isfinite(position_px).all((1, 2)))


def _motions(centroids: SeriesFrames, method: str, tests: int) -> Iterator[FrameStatistic]:
    """Common motion along x and y; none for a single point or fewer than three complete frames."""
    position_px = centroids.points.position_px[method]
    position_px = position_px[_complete(position_px)]
    frames, points, _ = position_px.shape
    if points < 2 or frames < FEWEST_FOR_MOTION:
        return
    motion, noise = common_motion_px2(position_px)
    ratio = common_motion_limit(frames, points, FALSE_ALARM / (2 * tests))
    limit = np.sqrt(np.maximum(noise, 1e-24) * ratio * (1.0 + points * MOTION_ALLOWANCE))
    for axis, rms_px in enumerate(np.sqrt(motion + noise)):
        text = (
            f"the image moves by {rms_px:.2g} px from frame to frame, all points alike ({centroids.name}, "
            f"{'xy'[axis]}): vibration, or a target that is not at rest"
        )
        yield FrameStatistic(value=float(rms_px), limit=float(limit[axis]), text=text)


def _changed(
    change: Change | None, names: Sequence[str], series: str, what: str, *, format: str
) -> FrameStatistic | None:
    """A change in words: frame, kind and size."""
    if change is None:
        return None
    size = f"{change.size:{format}} ± {change.error:{format.lstrip('+')}}{'' if '%' in format else ' px'}"
    frame, previous = names[change.frame], names[max(change.frame - 1, 0)]
    text = {
        "drift": f"{what} drifts by {size} from the first to the last frame of {series}",
        "frame": f"{what} is off by {size} in {frame} alone ({series})",
        "step": f"{what} jumps by {size} between {previous} and {frame} ({series})",
    }[change.kind]
    return FrameStatistic(value=change.size, limit=change.limit, text=text)


def _moves(centroids: SeriesFrames, method: str, tests: int) -> Iterator[FrameStatistic | None]:
    """Changes of the mean position of all points, along x and y."""
    position_px = centroids.points.position_px[method]
    complete = np.flatnonzero(_complete(position_px))
    names = [centroids.origin[number] for number in complete]
    for axis in range(2):
        change = largest_change(position_px[complete, :, axis].mean(1), false_alarm=FALSE_ALARM / (2 * tests))
        yield _changed(change, names, centroids.name, f"the image ({'xy'[axis]})", format="+.3f")


def _light(centroids: SeriesFrames, tests: int) -> FrameStatistic | None:
    change = largest_change(centroids.light, false_alarm=FALSE_ALARM / tests)
    return _changed(change, centroids.origin, centroids.name, "the light", format="+.1%")


def _shared(frames: FrameSeries, tests: int) -> FrameStatistic | None:
    """Noise common to two frames, without copies."""
    unique = _unique(frames)
    pair = common_noise(frames.windows.dn[unique], ~frames.windows.defect, false_alarm=FALSE_ALARM / tests)
    if pair is None:
        return None
    first, second = (frames.origin[unique[number]] for number in pair.frames)
    text = f"the noise of {first} and {second} ({frames.name}) is {pair.correlation:.0%} the same"
    return FrameStatistic(value=pair.correlation, limit=max(pair.limit, COMMON_NOISE), text=text)


def _copied(series: Sequence[FrameSeries]) -> list[str]:
    """Frames that equal an earlier one: in all pixels within the folder, or in the windows within their series."""
    by_digest: dict[str, str] = {}
    copied = []
    for frames in series:
        by_windows: dict[bytes, str] = {}
        for frame, name, digest in zip(frames.windows.dn, frames.origin, frames.digest, strict=True):
            equal = by_digest.setdefault(digest, name), by_windows.setdefault(frame.tobytes(), name)
            copied += [f"{name} = {original}" for original in equal if original != name][:1]
    return copied


def _disorder(series: Sequence[FrameSeries]) -> list[str]:
    """Files of a series that were taken before the preceding file."""
    disorder = []
    for frames in series:
        files = dict.fromkeys(name.partition("[")[0] for name in frames.origin)
        times = zip(pairwise(files), pairwise(frames.taken), strict=False)
        disorder += [f"{later} after {earlier}" for (earlier, later), (time, next_time) in times if next_time < time]
    return disorder


def _unique(series: FrameSeries) -> list[int]:
    """Numbers of the frames of a series without copies of earlier ones."""
    first: dict[bytes, int] = {}
    for number, frame in enumerate(series.windows.dn):
        first.setdefault(frame.tobytes(), number)
    return list(first.values())


def _noise_ratio(reduced: Sequence[SeriesFrames], method: str) -> Measured | None:
    """Scatter of the centroids over the noise model, points, axes and series together."""
    repeated = [centroids for centroids in reduced if centroids.frames > 1]
    if not repeated:
        return None
    predicted = [centroids.predicted_px(method).ravel() ** 2 for centroids in repeated]
    frames, counts = np.array([centroids.frames for centroids in repeated]), [len(row) for row in predicted]
    ratio, error = scatter_ratio(
        np.concatenate([centroids.points.sigma_px(method).ravel() ** 2 for centroids in repeated]),
        np.concatenate(predicted),
        degrees=np.repeat(frames - 1.0, counts),
        effective_fraction=np.repeat([centroids.effective_frames for centroids in repeated] / frames, counts),
    )
    return Measured(value=ratio, uncertainty=error, n=int(frames @ counts) // 2)


def _advice(name: str, outcome: Outcome) -> str:
    """Text on a violated check: result, likely causes, remedy."""
    return ADVICE[name](outcome.result["checks"])


def _exceeded(checks: FrameChecks, name: str) -> str:
    """Text of a statistic beyond its limit, otherwise empty."""
    statistic = checks.findings[name]
    return statistic.text if statistic is not None and abs(statistic.value) > statistic.limit else ""


def _some(names: Sequence[str]) -> str:
    more = f" and {len(names) - SHOWN} more" if len(names) > SHOWN else ""
    return ", ".join(names[:SHOWN]) + more


def _moved(checks: FrameChecks) -> str:
    text = _exceeded(checks, "moved")
    return text and f"{text}: the target or the camera is not at rest; split the series there"


def _motion(checks: FrameChecks) -> str:
    return _moved(checks) or _exceeded(checks, "motion")


def _lag(checks: FrameChecks) -> str:
    """Text on frames with correlated noise."""
    if (checks.lag_correlation or 0.0) < 0:
        cause = "a vibration near half of the frame rate, which N frames average out better than white noise"
    else:
        cause = (
            "drift, air, or a vibration that the frame rate aliases; N frames equal N (1 - r) / (1 + r) "
            "independent ones, as the stated errors assume"
        )
    return f"{_exceeded(checks, 'lag')}: {cause}"


def _gain_text(checks: FrameChecks) -> str:
    """Text on the motion, which disturbs photon transfer, or on a gain beyond its limit."""
    gain, ratio, stated = checks.transfer_gain, checks.gain_ratio, checks.stated_gain
    motion = _motion(checks)
    if motion or gain is None or ratio is None:
        return motion
    noise = two_sided_limit(1, FALSE_ALARM) * (ratio.uncertainty or 0.0)
    if abs(ratio.value - 1.0) <= GAIN_ALLOWANCE + noise:
        return ""
    text = f"variance against mean gives {gain.value:.3g} ± {gain.uncertainty:.1g} DN/e⁻, gain_dn_per_e is {stated:.3g}"
    if abs(gain.value * stated - 1.0) < 0.3:
        return f"{text}, the reciprocal: it was given in e⁻/DN"
    return f"{text}: wrong for this gain setting, or frames were averaged, scaled or smoothed before they were stored"


def _noise(checks: FrameChecks) -> str:
    ratio = float("nan") if checks.noise_ratio is None else checks.noise_ratio.value
    if checks.copies:
        cause = f"{checks.copies} frames are copies"
    elif not (cause := _gain_text(checks)):
        cause = "points scatter less than by photon and read noise (frames averaged or smoothed, read_noise_e)"
        if ratio > 1.0:
            cause = (
                "points scatter more than by photon and read noise (vibration, air, a flickering lamp, or "
                "read_noise_e is the median of pixels that differ, where the RMS is needed)"
            )
    return f"the ratio is {ratio:.3g}: {cause}"


ADVICE: Mapping[str, Callable[[FrameChecks], str]] = {
    "copies": lambda c: (
        f"{c.copies} of {c.frames} frames are copies ({_some(c.copied)}): a frame was stored several times, or the "
        "camera did not refresh; copies have no independent noise: remove them"
    ),
    "shared_noise": lambda c: (
        f"{_exceeded(c, 'shared')}: one was made from the other, or the camera averages over frames (noise "
        "reduction); frames must be independent"
    ),
    "disordered": lambda c: (
        f"{_some(c.disorder)}, but taken earlier by DATE-OBS or FRAMENUM: frames are read in the order of their "
        "names; list the files in the order of their exposure, otherwise drift and correlation are wrong"
    ),
    "step_dn": lambda c: (
        f"all readings are {c.step_dn} DN apart or a multiple: a converter of fewer bits, shifted to the left; divide "
        "the frames (and gain_dn_per_e, offset_dn, saturation_dn) by this step"
    ),
    "top_count": lambda c: (
        f"the highest reading occurs {c.top_count} times, at most {c.top_limit} times by chance: pixels are "
        f"saturated there; state saturation_dn = {c.top_dn} and lower the lamp or the exposure"
    ),
    "zero_fraction": lambda _: (
        "noise is clipped at zero: raise the camera's offset; or dark frames were already subtracted"
    ),
    "gain_ratio": _gain_text,
    "common_motion_px": _motion,
    "moved_px": _moved,
    "light_change": lambda c: f"{_exceeded(c, 'light')}: the lamp, the exposure time, or a frame behind another filter",
    "lag_correlation": _lag,
    "noise_ratio": _noise,
    "flat_noise": lambda c: (
        f"the flat shows {c.flat_pattern[0]:.2%} from pixel to pixel, of which {c.flat_pattern[1]:.2%} is its own "
        "noise: it adds more noise than it corrects; average more or brighter flats, or leave it out"
    ),
}


def _limit(name: str, limit: str | float, title: str, *, size: bool = False) -> Verdict:
    return below(name, limit, title=title, size=size, advice=partial(_advice, name))


def _ratio(name: str, within: float, title: str) -> Verdict:
    return ratio_near(name, within=within, false_alarm=FALSE_ALARM, title=title, advice=partial(_advice, name))


CHECKS = Section(
    record=FrameChecks,
    verdicts=[
        _limit("copies", 0, "frames identical to another frame"),
        _limit("shared_noise", "shared_limit", "common noise of two frames"),
        _limit("disordered", 0, "frames out of the order of exposure"),
        _limit("step_dn", 1, "common step of all readings"),
        _limit("top_count", "top_limit", "pixels at the highest reading"),
        _limit("zero_fraction", 1e-3, "share of readings of 0 DN"),
        _ratio("gain_ratio", GAIN_ALLOWANCE, "gain by photon transfer over stated gain"),
        _limit(
            "common_motion_px",
            "motion_limit_px",
            "common motion of all points from frame to frame, the largest of all series",
        ),
        _limit(
            "moved_px",
            "moved_limit_px",
            "jump or drift of the image within a series, the most significant",
            size=True,
        ),
        _limit(
            "light_change",
            "light_limit",
            "jump or drift of the light within a series, the most significant",
            size=True,
        ),
        _limit(
            "lag_correlation", "lag_limit", "correlation of frames with the next one, the most significant", size=True
        ),
        _ratio("noise_ratio", NOISE_ALLOWANCE, "centroid scatter over its prediction from the stated noise"),
        # A flat must know the response better than leaving it out does
        _limit("flat_noise", 0.5**0.5, "noise of the mean flat over its pixel-to-pixel pattern"),
    ],
)
