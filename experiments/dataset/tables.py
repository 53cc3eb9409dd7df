"""Tables of the report on a dataset."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from experiments.dataset.statistics import centroid_bins, completeness, solver
from experiments.dataset.truth import FLAGS
from experiments.harness.summary import Measured
from experiments.harness.tables import Cell, Column, Table

if TYPE_CHECKING:
    from experiments.dataset.evaluate import Evaluation
    from experiments.dataset.result import Result

__all__ = ["all_tables"]


def all_tables(result: Result) -> Mapping[str, Table]:
    """Every table by its file name."""
    evaluation = result.evaluation
    if evaluation is None:
        return {}
    tables = {
        "completeness": _completeness(evaluation),
        "centroids": _centroids(evaluation),
        "flags": _flags(evaluation),
    }
    if evaluation.solved:
        tables |= {"solver": _solver(evaluation), "solved_frames": _frames(evaluation)}
    return tables


def _solver(evaluation: Evaluation) -> Table:
    found = solver(evaluation.solved)
    rows: list[tuple[Cell, ...]] = [
        ("frames solved", f"{found.solved} of {found.attempted}"),
        ("boresight error, median [″]", _arcsec(found.median_arcsec, found.median_error_arcsec, found.solved)),
        ("boresight error, 95 % below [″]", found.p95_arcsec),
        ("boresight error, largest [″]", found.largest_arcsec),
        ("boresight error, median, all matched stars weighing the same [″]", found.equal_median_arcsec),
        ("roll error, median [″]", found.roll_median_arcsec),
        ("error over predicted sigma, RMS: x, y, roll", " / ".join(f"{value:.2f}" for value in found.pull)),
        ("mirrored, wrong", f"{found.mirrored}, {found.wrong}"),
    ]
    return Table(
        columns=("Quantity", "Found"),
        rows=rows,
        caption="Frames solved blind by tetra3rs, attitudes against the truth.",
    )


def _arcsec(value: float, error: float, n: int) -> Measured:
    return Measured(value=value, uncertainty=error, n=n)


def _frames(evaluation: Evaluation) -> Table:
    rows: list[tuple[Cell, ...]] = []
    for one in evaluation.solved:
        error = [float(v) if np.isfinite(v) else None for v in (*one.error_arcsec, *one.sigma_arcsec)]
        rows.append((one.frame, one.status, one.detected, one.fit, one.identified, one.used, *error, one.message))
    return Table(
        columns=(
            Column(name="Frame", key="frame"),
            Column(name="Status", key="status"),
            Column(name="Detected", key="detected"),
            Column(name="Fit", key="fit"),
            Column(name="Identified", key="identified"),
            Column(name="Used", key="used"),
            *(Column(name=f"Error {axis}", unit="″", key=f"error_{axis}_arcsec") for axis in ("x", "y", "roll")),
            *(Column(name=f"σ {axis}", unit="″", key=f"sigma_{axis}_arcsec") for axis in ("x", "y", "roll")),
            Column(name="Message", key="message"),
        ),
        rows=rows,
        caption="Every frame that was tried.",
    )


def _completeness(evaluation: Evaluation) -> Table:
    stars = evaluation.stars
    edges = np.arange(np.floor(stars.magnitude.min()) if len(stars.magnitude) else 0.0, 30.0)
    edges = edges[: int(np.searchsorted(edges, stars.magnitude.max() if len(stars.magnitude) else 1.0, "right")) + 1]
    one = completeness(stars, stars.magnitude, edges)
    rows: list[tuple[Cell, ...]] = []
    for k, number in enumerate(one.stars):
        if number:
            bounds = f"{one.low[k]:.3f} … {one.high[k]:.3f}"
            rows.append((f"{one.edges[k]:g} … {one.edges[k + 1]:g}", int(number), float(one.share[k]), bounds))
    return Table(
        columns=(
            Column(name="Magnitude", key="magnitude"),
            Column(name="Stars", key="stars"),
            Column(name="Found", key="share_found", format=".4f"),
            Column(name="68 % interval", key="interval"),
        ),
        rows=rows,
        caption="Completeness of the detection.",
        note="Stars that lose light over the detector's edge do not count. Wilson intervals.",
    )


def _centroids(evaluation: Evaluation) -> Table:
    bins = centroid_bins(evaluation)
    rows: list[tuple[Cell, ...]] = [
        (
            float(bins.snr[k]),
            int(bins.stars[k]),
            Measured(value=float(bins.error_px[k]), uncertainty=float(bins.error_sigma_px[k])),
            float(bins.bound_px[k]),
            float(bins.ratio[k]),
        )
        for k in range(len(bins.snr))
    ]
    return Table(
        columns=(
            Column(name="SNR", key="snr", format=".1f"),
            Column(name="Stars", key="stars"),
            Column(name="Error per axis", unit="px", key="error_px"),
            Column(name="Cramér-Rao bound", unit="px", key="bound_px"),
            Column(name="Ratio", key="ratio", format=".2f"),
        ),
        rows=rows,
        caption="Centroid error of undisturbed stars against the bound.",
        note="Error: 1.4826 times the median absolute deviation, per axis. Bound: median; PSF of the lens, each star "
        "at its own place on the pixels, position and flux unknown, background known. Ratio: the same deviation, of "
        "every error over its own bound.",
    )


def _flags(evaluation: Evaluation) -> Table:
    stars = evaluation.stars
    rows: list[tuple[Cell, ...]] = []
    for name, (_, about) in FLAGS.items():
        mine = stars.has(name)
        count = int(mine.sum())
        if count:
            share = float(stars.found[mine].mean())
            fit = float(stars.fit[mine].mean())
            blend = float(stars.blend_seen[mine & stars.found].mean()) if (mine & stars.found).any() else None
            rows.append((name, about, count, share, fit, blend))
    rows.append(("none", "undisturbed", int(stars.clean.sum()), *_shares(evaluation)))
    return Table(
        columns=(
            Column(name="Flag", key="flag"),
            Column(name="Meaning", key="meaning"),
            Column(name="Stars", key="stars"),
            Column(name="Found", key="share_found", format=".3f"),
            Column(name="And fit", key="share_fit", format=".3f"),
            Column(name="Seen as blend", key="share_blend", format=".3f"),
        ),
        rows=rows,
        caption="What the truth says of the stars, and what the detection made of them.",
        note="Fit: the measurement sees nothing wrong with it, so that it counts in an attitude. Seen as blend: of "
        "those found.",
    )


def _shares(evaluation: Evaluation) -> tuple[Cell, Cell, Cell]:
    stars = evaluation.stars
    if not (stars.clean & stars.found).any():
        return None, None, None
    return (
        float(stars.found[stars.clean].mean()),
        float(stars.fit[stars.clean].mean()),
        float(stars.blend_seen[stars.clean & stars.found].mean()),
    )
