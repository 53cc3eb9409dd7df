"""Pulls of the error budget: predicted minus measured in standard deviations, chips and noise drawn anew for each seed.

    python benchmarks/pulls.py --seeds 20
    python benchmarks/pulls.py --seeds 20 --set instrument.lens=my_triplet.toml --out pulls_triplet

Right predictions with right uncertainties have pulls of mean 0 and RMS 1, for every term and every centroider. The test
is smaller than the published one (fewer frames, one place of the step test), so that a seed takes some 20 s. Finished
runs are kept in the output folder, and the same command continues from there.
"""

from __future__ import annotations

import argparse
import json
import sys
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

METHODS = ("cog", "tcog", "windowed", "gaussian", "epsf", "epsf_measured")
TERMS = ("TE", "HSFE", "LSFE-S", "LSFE-C1")
DRAWS = 80
SMALL = (
    "centroid=cog",
    f"compare={json.dumps(METHODS[1:])}",
    "target.rows=3",
    "target.columns=3",
    "filters.centres_nm=[600, 800]",
    "frames=12",
    "dark_frames=40",
    "steps.places=1",
    "steps.positions=5",
)


def pulls_of(seed: int, settings: tuple[str, ...] = ()) -> dict[str, dict[str, list[float]]]:
    """Pulls by centroider and term: x and y; of the chromatic term those of every entry of Table 1.

    Parameters
    ----------
    seed : int
        Of the noise, the target and the chip.
    settings : tuple of str
        Of the budget, as on its command line.
    """
    from experiments.budget.experiment import deviations
    from experiments.budget.laboratory import build_laboratory
    from experiments.budget.measure import measure_terms
    from experiments.budget.predict import predict_terms
    from experiments.budget.settings import BudgetConfig
    from experiments.harness.config import load_config

    given = [*SMALL, f"seed={seed}", f"detector.sensor_seed={1000 + seed}", *settings]
    lab = build_laboratory(load_config(BudgetConfig, settings=given))
    predicted, measured = predict_terms(lab, draws=DRAWS, step_draws=DRAWS), measure_terms(lab)
    return {
        method: {term: np.ravel(deviations(predicted[method], measured[method], term)).tolist() for term in TERMS}
        for method in lab.bench.methods
    }


def table(found: list[dict[str, dict[str, list[float]]]]) -> str:
    """Mean and RMS of the pulls, Markdown."""
    lines = [
        "| centroider | " + " | ".join(f"{term}: mean, RMS" for term in TERMS) + " |",
        "|---" * (1 + len(TERMS)) + "|",
    ]
    for method in METHODS:
        cells = []
        for term in TERMS:
            pulls = np.concatenate([one[method][term] for one in found])
            lost = int(np.isnan(pulls).sum())  # a bad pixel in the middle of a point
            cells.append(
                f"{np.nanmean(pulls):+.2f}, {np.sqrt(np.nanmean(pulls**2)):.2f}" + (f" ({lost} lost)" if lost else "")
            )
        lines.append(f"| {method} | " + " | ".join(cells) + " |")
    counts = {term: sum(len(one[METHODS[0]][term]) for one in found) for term in TERMS}
    expected = ", ".join(
        f"{term} {n}: ± {1 / np.sqrt(n):.2f}, ± {1 / np.sqrt(2 * n):.2f}" for term, n in counts.items()
    )
    return "\n".join(
        [*lines, "", f"Pulls behind each pair, and one standard deviation of mean and RMS if independent: {expected}."]
    )


def main() -> None:
    """Run the seeds that are not done yet, print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=20, help="number of seeds")
    parser.add_argument("--first", type=int, default=1, help="first seed")
    parser.add_argument("--jobs", type=int, default=1, help="processes")
    parser.add_argument("--set", dest="settings", action="append", default=[], help="KEY=VALUE of the budget")
    parser.add_argument("--out", type=Path, default=Path("pulls"), help="folder of finished runs")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    files = {seed: options.out / f"{seed:03d}.json" for seed in range(options.first, options.first + options.seeds)}
    missing = [seed for seed, file in files.items() if not file.exists()]
    with ProcessPoolExecutor(options.jobs) as pool:
        for seed, found in zip(
            missing, pool.map(pulls_of, missing, [tuple(options.settings)] * len(missing)), strict=True
        ):
            files[seed].write_text(json.dumps(found), encoding="utf-8")
            print(f"seed {seed} done", flush=True)
    print(table([json.loads(file.read_text(encoding="utf-8")) for file in files.values()]))


if __name__ == "__main__":
    main()
