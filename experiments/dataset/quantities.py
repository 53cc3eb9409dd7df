"""The numbers of a dataset and of what is found in its frames, each described once."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from experiments.dataset.evaluation.statistics import (
    BRIGHT_SNR,
    Completeness,
    bound_ratio,
    centroid_bins,
    completeness,
    even_edges,
    false_excess,
    magnitude_of_half,
    mean_of,
    solver_statistics,
)
from experiments.dataset.truth.star_truth import FLAGS
from experiments.harness.quantities import Quantities

if TYPE_CHECKING:
    from experiments.dataset.evaluation.evaluate import Evaluation
    from experiments.dataset.result import Result

__all__ = ["describe", "extra"]

MAGNITUDE_STEP = 0.25
SNR_BINS, LEAST_SNR = 23, 0.5


def describe(result: Result) -> Quantities:
    """Quantities of a run; those of the frames' evaluation where they were looked at, of attitudes where solved."""
    q, stars = Quantities(), [one.stars for one in result.records]
    q.add("frames", len(result.records), "Frames")
    q.add("frames_made", result.made, "Frames made by this run")
    q.add("frames_per_s", result.frames_per_s, "Frames per second")
    q.add("workers", result.workers, "Processes")
    q.add("stars", sum(stars), "Star images")
    q.add("frames_without_stars", stars.count(0), "Frames without stars")
    if result.resume is not None:
        for name in ("frames", "whole_when_killed", "same_bytes"):
            q.add(f"resume_{name}", getattr(result.resume, name), json=f"resume_test.{name}")
    if result.evaluation is not None:
        _detections(q, result.evaluation)
        _flags(q, result.evaluation)
        _centroids(q, result.evaluation)
        _independent(q, result.evaluation)
        _attitudes(q, result.evaluation)
    return q


def extra(result: Result) -> dict[str, Any]:
    """What ``summary.json`` says in words."""
    return {"exports": dict(result.exports)} | ({} if result.resume is not None else {"resume_test": None})


def _detections(q: Quantities, evaluation: Evaluation) -> None:
    """Completeness and false detections."""
    stars = evaluation.stars
    bright = completeness(stars, stars.snr, np.array([BRIGHT_SNR, np.inf]))
    fine = completeness(stars, stars.magnitude, even_edges(stars.magnitude, MAGNITUDE_STEP))
    q.add("frames_looked_at", evaluation.frames, "Frames looked at")
    undisturbed = mean_of(stars.found, stars.clean & (stars.snr >= BRIGHT_SNR))
    for name, value, label in (
        ("snr_above", BRIGHT_SNR, "Signal-to-noise ratio of bright stars"),
        ("stars", int(bright.stars[0]), "Bright stars"),
        ("share", float(bright.share[0]), "Bright stars found"),
        ("undisturbed", undisturbed, "Undisturbed bright stars found"),
        ("magnitude_of_half", magnitude_of_half(fine), "Magnitude of which half is found"),
    ):
        q.add(f"bright_{name}", value, label, json=f"completeness.{name}")
    _curve(q, "magnitude", "magnitude", fine, fine.middle)
    positive = stars.snr[stars.snr > 0]
    edges = np.ones(2)
    if positive.max(initial=0.0) > LEAST_SNR:
        edges = np.geomspace(max(LEAST_SNR, positive.min()), positive.max() * 1.001, SNR_BINS + 1)
    _curve(q, "snr", "signal-to-noise ratio", completeness(stars, stars.snr, edges), np.sqrt(edges[1:] * edges[:-1]))
    whole = completeness(stars, stars.magnitude, even_edges(stars.magnitude, 1.0))
    some = np.flatnonzero(whole.stars)
    q.axis("magnitude", [f"{whole.edges[k]:g} … {whole.edges[k + 1]:g}" for k in some], "Magnitude")
    q.add("magnitude_stars", whole.stars[some], "Stars", dims="magnitude", key="stars", json="")
    share = {"dims": "magnitude", "key": "share_found", "json": ""}
    q.add("magnitude_share", whole.share[some], "Found", format=".4f", **share)
    intervals = [f"{whole.low[k]:.3f} … {whole.high[k]:.3f}" for k in some]
    q.add("magnitude_interval", intervals, "68 % interval", dims="magnitude", key="interval", json="")
    for name, count, frames, label in (
        ("all", len(stars.false), stars.frames, "Detections without a star"),
        ("not_flagged", int((~stars.false_spike).sum()), stars.frames, "Those without a flag"),
        ("in_empty_frames", evaluation.empty_detections, evaluation.empty_frames, "In frames without stars"),
    ):
        q.add(f"false_{name}_count", count, label, json="")
        q.add(f"false_{name}", count / frames, label, json=f"false_detections_per_frame.{name}", format=".2f")
    q.add("false_excess", false_excess(evaluation), "Excess over empty frames", unit="sigma", json="")


def _curve(q: Quantities, name: str, label: str, one: Completeness, middle: Any) -> None:
    """Completeness in fine bins, those that hold stars."""
    some = one.stars > 0
    q.axis(f"{name}_bin", middle[some], label)
    for part, what in (("share", "share found"), ("low", "68 % interval, from"), ("high", "to")):
        q.add(f"{name}_bin_{part}", getattr(one, part)[some], what, dims=f"{name}_bin", json="")


def _flags(q: Quantities, evaluation: Evaluation) -> None:
    """What became of the stars that the truth says something of."""
    stars = evaluation.stars
    groups = {name: (about, stars.has(name)) for name, (_, about) in FLAGS.items()}
    groups = {name: group for name, group in groups.items() if group[1].any()} | {"none": ("undisturbed", stars.clean)}
    q.axis("flag", list(groups), "Flag")
    q.add("flag_meaning", [about for about, _ in groups.values()], "Meaning", dims="flag", key="meaning", json="")
    chosen = [mine for _, mine in groups.values()]
    q.add("flag_stars", [int(mine.sum()) for mine in chosen], "Stars", dims="flag", key="stars", json="")
    for name, label, values in (
        ("found", "Found", [mean_of(stars.found, mine) for mine in chosen]),
        ("fit", "And fit", [mean_of(stars.fit, mine) for mine in chosen]),
        ("blend", "Seen as blend", [mean_of(stars.blend_seen, mine & stars.found) for mine in chosen]),
    ):
        q.add(f"flag_{name}", values, label, dims="flag", key=f"share_{name}", format=".3f", json="")
    blended = stars.has("blended")
    for name, value, label in (
        ("stars", int(blended.sum()), "Blended stars"),
        ("found_share", mean_of(stars.found, blended), "Blended stars found"),
        ("flagged_share_of_found", mean_of(stars.blend_seen, blended & stars.found), "Those seen as blends"),
        ("flagged_share_of_single", mean_of(stars.blend_seen, ~blended & stars.found), "Single stars seen as blends"),
    ):
        q.add(f"blends_{name}", value, label, json=f"blends.{name}")


def _centroids(q: Quantities, evaluation: Evaluation) -> None:
    """Centroid errors beside their bound, and world coordinates."""
    bins, place = centroid_bins(evaluation), "centroids."
    ratio, count = bound_ratio(bins)
    of_bin: dict[str, Any] = {"dims": "centroid_bin"}
    q.add("centroid_snr", bins.snr, "SNR", key="snr", json=f"{place}snr", format=".1f", **of_bin)
    q.add("centroid_stars", bins.stars, "Stars", key="stars", json=f"{place}stars", **of_bin)
    q.add(
        "centroid_error_px",
        bins.error_px,
        "Error per axis",
        unit="px",
        error=bins.error_sigma_px,
        key="error_px",
        json=f"{place}error_px",
        json_error=f"{place}error_sigma_px",
        **of_bin,
    )
    bound = {"unit": "px", "key": "bound_px", "json": f"{place}bound_px"}
    q.add("centroid_bound_px", bins.bound_px, "Cramér-Rao bound", **bound, **of_bin)
    q.add("centroid_ratio", bins.ratio, "Ratio", key="ratio", json=f"{place}ratio", format=".2f", **of_bin)
    q.add("bound_ratio", ratio, "Error over bound", n=count, json="")
    largest = float(evaluation.wcs_miss_px.max()) if len(evaluation.wcs_miss_px) else float("nan")
    q.add("wcs_max_error_px", largest, "Largest WCS error", unit="px")
    q.add("camera_model_max_px", evaluation.calibration.max_px, "Camera model, largest misfit", unit="px", format=".1e")


def _independent(q: Quantities, evaluation: Evaluation) -> None:
    """Written attitudes against the pixels of the files, by no detection, camera model or attitude of this project."""
    plain = evaluation.plain
    q.axis("plain_axis", ["x", "y", "roll"], "Axis")
    error = np.array([one.error_arcsec for one in plain]).reshape(-1, 3)
    sigma = np.array([one.sigma_arcsec for one in plain]).reshape(-1, 3)
    q.add("plain_frames", len(plain), "Frames judged by plain NumPy", json="independent.frames")
    q.add("plain_square", float(((error / sigma) ** 2).sum()), "Sum of their squared errors over sigma", json="")
    mean = error.mean(0) if len(plain) else np.full(3, np.nan)
    spread = np.sqrt((sigma**2).sum(0)) / max(len(plain), 1)
    q.add(
        "plain_mean_arcsec",
        mean,
        "Pixels minus written attitude, mean",
        unit="arcsec",
        dims="plain_axis",
        error=spread,
        n=len(plain),
        json="independent.mean_error_arcsec",
    )
    least = min((one.found for one in plain), default=float("nan"))
    q.add("plain_found", least, "Stars where the written attitude puts them, least part", json="independent.found")
    q.add(
        "pointing_off_arcsec",
        float(evaluation.pointing_off_arcsec.max()),
        "Written boresight and roll off",
        unit="arcsec",
    )
    q.add("turned_off_sigma", evaluation.turned_off_sigma, "Blind solution of turned stars, off", unit="sigma")


def _attitudes(q: Quantities, evaluation: Evaluation) -> None:
    """Frames solved blind, one by one and together."""
    frames, place = evaluation.solved, "solver."
    q.add("attempted", len(frames), "Frames tried", json=f"{place}attempted")
    if not frames:
        q.add("without_solver", evaluation.without_solver, "Why none was tried", json=f"{place}why")
        return
    found = solver_statistics(frames)
    q.add("solved", found.solved, "Frames solved", json=f"{place}solved")
    q.add("parity_ok", found.parity_ok, "No frame mirrored", json=f"{place}parity_ok")
    q.add("mirrored", found.mirrored, "Mirrored", json="")
    q.add("wrong", found.wrong, "Wrong", json="")
    for name, value, label, json in (
        ("p95", found.p95_arcsec, "Boresight error, 95 % below", f"{place}p95_arcsec"),
        ("largest", found.largest_arcsec, "Boresight error, largest", ""),
        ("sigma", found.sigma_arcsec, "Boresight error, predicted", ""),
        ("equal_weights", found.equal_median_arcsec, "The same, equal weights", f"{place}equal_weights_median_arcsec"),
        ("roll", found.roll_median_arcsec, "Roll error, median", f"{place}roll_median_arcsec"),
    ):
        q.add(f"{name}_arcsec", value, label, unit="arcsec", json=json)
    q.add(
        "median_arcsec",
        found.median_arcsec,
        "Boresight error, median",
        unit="arcsec",
        error=found.median_error_arcsec,
        n=found.solved,
        json=f"{place}median_arcsec",
        json_error=f"{place}median_sigma_arcsec",
        format=".2f",
    )
    q.add("pull_rms", found.pull, "Error over predicted sigma, RMS", dims="rotation", json=f"{place}pull_rms")
    q.axis("axis", ["x", "y", "roll"], "Axis")
    q.axis("tried", [one.frame for one in frames], "Frame")
    for name in ("status", "detected", "fit", "identified", "used", "message"):
        q.add(name, [getattr(one, name) for one in frames], name.capitalize(), dims="tried", json="")
    for name, label in (("error", "Error"), ("sigma", "σ")):
        values = [getattr(one, f"{name}_arcsec") for one in frames]
        key = f"{name}_{{axis}}_arcsec"
        q.add(f"frame_{name}_arcsec", values, label, unit="arcsec", dims="tried axis", key=key, json="")
    judged = [one.common_px for one in frames if np.isfinite(one.common_px)]
    common = float(np.median(judged)) if judged else float("nan")
    q.add("common_px", common, "Common centroid error, median", unit="px", format=".3f", json="")
