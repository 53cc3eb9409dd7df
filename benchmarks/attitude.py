"""Attitude from star directions: accuracy over the Cramer-Rao bound and time per frame, compared with scipy on the same
stars.

    python benchmarks/attitude.py [--frames N] [--stars N ...] [--seed N]

Stars are spread evenly over a square field of 20 deg with errors of 5 microradian (1 arcsec) per axis. Error over bound
is the RMS over all frames of the error in units of its predicted standard deviation, about the axes across the
boresight and in roll; with N frames it is known to 1 / sqrt(2 N). The prediction is ours for all methods (scipy's
`align_vectors` has none for one frame without a second call). Times are medians of repeats: ours for all frames in one
call, with covariance, loss test and parity; ours frame by frame; scipy frame by frame, the rotation only.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table
from scipy.spatial.transform import Rotation

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from calib.attitude.attitude_solution import solve_wahba, solve_wahba_many
from optics.attitude import attitude_error_arcsec

SIGMA_RAD = 5e-6
HALF_WIDTH = np.tan(np.radians(10.0))
REPEATS = 7


def measured_frames(frames: int, stars: int, rng: np.random.Generator) -> tuple[Rotation, Any, Any, Any]:
    """True attitudes, measured and reference directions, and the frame of each star."""
    truth = Rotation.random(frames, rng=rng)
    v = np.column_stack([rng.uniform(-HALF_WIDTH, HALF_WIDTH, (frames * stars, 2)), np.ones(frames * stars)])
    v /= np.linalg.norm(v, axis=1, keepdims=True)
    frame = np.repeat(np.arange(frames), stars)
    reference = truth[frame].inv().apply(v)
    error = SIGMA_RAD * rng.standard_normal(v.shape)
    seen = v + error - np.sum(error * v, axis=1, keepdims=True) * v
    return truth, seen / np.linalg.norm(seen, axis=1, keepdims=True), reference, frame


def timed(work: Callable[[], Any]) -> tuple[Any, float]:
    """Result and median time [s]."""
    times = []
    for _ in range(REPEATS):
        start = time.perf_counter()
        result = work()
        times.append(time.perf_counter() - start)
    return result, float(np.median(times))


def rows_for(frames: int, stars: int, rng: np.random.Generator) -> list[tuple[str, ...]]:
    """One row of the table for each method."""
    truth, seen, reference, frame = measured_frames(frames, stars, rng)
    parts = [(seen[k * stars : (k + 1) * stars], reference[k * stars : (k + 1) * stars]) for k in range(frames)]
    methods: dict[str, Callable[[], Any]] = {
        "ours, SVD, at once": lambda: solve_wahba_many(seen, reference, frame, sigma_rad=SIGMA_RAD),
        "ours, QUEST, at once": lambda: solve_wahba_many(seen, reference, frame, sigma_rad=SIGMA_RAD, method="quest"),
        "ours, SVD, one by one": lambda: Rotation.concatenate(
            [solve_wahba(a, b, sigma_rad=SIGMA_RAD).rotation for a, b in parts]
        ),
        "scipy align_vectors": lambda: Rotation.concatenate([Rotation.align_vectors(a, b)[0] for a, b in parts]),
    }
    sigma = solve_wahba_many(seen, reference, frame, sigma_rad=SIGMA_RAD).sigma_arcsec
    rows = []
    for name, work in methods.items():
        result, seconds = timed(work)
        rotation = result if isinstance(result, Rotation) else result.rotation
        pulls = attitude_error_arcsec(rotation, truth) / sigma
        across, roll = np.sqrt(np.mean(pulls[:, :2] ** 2)), np.sqrt(np.mean(pulls[:, 2] ** 2))
        rows.append((f"{stars}", name, f"{across:.3f}", f"{roll:.3f}", f"{seconds / frames * 1e6:.1f}"))
    return rows


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--frames", type=int, default=500)
    parser.add_argument("--stars", type=int, nargs="+", default=[3, 10, 30, 100])
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    table = Table(title=f"attitude of {arguments.frames} frames, seed {arguments.seed}")
    for head in ("stars", "method", "across / bound", "roll / bound", "us per frame"):
        table.add_column(head, justify="left" if head == "method" else "right")
    for stars in arguments.stars:
        for row in rows_for(arguments.frames, stars, np.random.default_rng([arguments.seed, stars])):
            table.add_row(*row)
        table.add_section()
    Console().print(table)


if __name__ == "__main__":
    main()
