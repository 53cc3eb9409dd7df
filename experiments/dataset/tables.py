"""Tables of a dataset's frames, for the report and as ECSV files."""

from __future__ import annotations

from collections.abc import Mapping

from experiments.harness.pivot import Pivot
from experiments.harness.quantities import Outcome
from experiments.harness.tables import Cell, Table

__all__ = ["tables"]


def tables(outcome: Outcome) -> Mapping[str, Table | Pivot]:
    """Tables by file name; none where no frame was looked at."""
    evaluation = outcome.result.evaluation
    if evaluation is None:
        return {}
    made: dict[str, Table | Pivot] = {
        "completeness": Pivot(
            rows="magnitude",
            columns="magnitude_stars magnitude_share magnitude_interval",
            caption="Completeness of the detection.",
            note="Stars that lose light over the detector's edge do not count. Wilson intervals.",
        ),
        "centroids": Pivot(
            rows="centroid_bin",
            hidden="centroid_bin",
            columns="centroid_snr centroid_stars centroid_error_px centroid_bound_px centroid_ratio",
            caption="Centroid error of undisturbed stars against the bound.",
            note="Error: 1.4826 times the median absolute deviation, per axis. Bound: median; PSF of the lens, each "
            "star at its own place on the pixels, position and flux unknown, background known. Ratio: the same "
            "deviation, of every error over its own bound.",
        ),
        "flags": Pivot(
            rows="flag",
            columns="flag_meaning flag_stars flag_found flag_fit flag_blend",
            caption="What the truth says of the stars, and what the detection made of them.",
            note="Fit: the measurement sees nothing wrong with it, so that it counts in an attitude. Seen as blend: "
            "of those found.",
        ),
    }
    if not evaluation.solved:
        return made
    return made | {
        "solver": _solver(outcome),
        "solved_frames": Pivot(
            rows="tried",
            across="axis",
            columns="status detected fit identified used frame_error_arcsec frame_sigma_arcsec message",
            caption="Every frame that was tried.",
        ),
    }


def _solver(outcome: Outcome) -> Table:
    """One quantity per row."""
    value = outcome.value
    rows: list[tuple[Cell, ...]] = [
        ("frames solved", f"{value('solved')} of {value('attempted')}"),
        ("boresight error, median [″]", value("median_arcsec")),
        ("boresight error, 95 % below [″]", value("p95_arcsec")),
        ("boresight error, largest [″]", value("largest_arcsec")),
        ("boresight error, median, all matched stars weighing the same [″]", value("equal_weights_arcsec")),
        ("roll error, median [″]", value("roll_arcsec")),
        (
            "error over predicted sigma, RMS: x, y, roll",
            " / ".join(f"{one:.2f}" for one in outcome.values("pull_rms")),
        ),
        ("mirrored, wrong", f"{value('mirrored')}, {value('wrong')}"),
    ]
    return Table(
        columns=("Quantity", "Found"),
        rows=rows,
        caption="Frames solved blind by tetra3rs, attitudes against the truth."
        if outcome.result.evaluation.blind
        else "Frames solved from a rough attitude, attitudes against the truth.",
    )
