"""Failed criteria of quick runs over seeds: which fail by chance, how often, and whether their limits fit their noise.

    python benchmarks/false_alarm.py temporal hsfe --seeds 40 --out alarms
    python benchmarks/false_alarm.py fisher --seeds 40 --set instrument.detector=chip_{seed}.toml --out alarms_chips

Every run is the ``--quick`` run with another seed; ``{seed}`` in a setting is replaced by it. Finished runs are
appended to ``EXPERIMENT.jsonl`` in the output folder, and the same command continues from there. ``--table`` only
prints.
"""

from __future__ import annotations

import argparse
import json
import re
import sys
import time
from collections import defaultdict
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))


def criteria_of(name: str, seed: int, settings: tuple[str, ...]) -> list[dict[str, Any]]:
    """Criteria of a quick run, as ``summary.json`` has them."""
    from experiments.harness.progress import Progress
    from experiments.harness.registry import declared
    from experiments.harness.run import Options, perform
    from experiments.harness.summary import summary

    experiment = declared(name)
    given = tuple(one.replace("{seed}", str(seed)) for one in settings)
    with TemporaryDirectory() as folder:
        # Only an experiment that writes as it goes needs a folder
        out = None if experiment.output is None else f"{folder}/run"
        options = Options(settings=given, seed=seed, quick=True, out=out)
        run, _ = perform(experiment, options, Progress())
    criteria: list[dict[str, Any]] = summary(name, run.config, {}, run.criteria)["criteria"]
    return criteria


def table(runs: list[dict[str, Any]]) -> str:
    """Failures per criterion and how its value lies in its limit, Markdown."""
    rows = defaultdict(list)
    for run in runs:
        for one in run["criteria"]:
            rows[re.sub(r", (largest|mean) of \d+.*", "", one["name"])].append((run["seed"], one))
    lines = [
        "| criterion | failed | seeds | value | limit | value over limit: RMS, largest | pull RMS |",
        "|---" * 7 + "|",
    ]
    failed = judged = 0
    for name, found in rows.items():
        value, limit, about = (
            np.array([np.nan if one.get(key) is None else one[key] for _, one in found], float)
            for key in ("value", "limit", "about")
        )
        part = np.abs(value - np.nan_to_num(about)) / limit
        spread = f"{np.nanmean(value):.3g} ± {np.nanstd(value):.2g} | {np.nanmedian(limit):.3g}"
        lost = [seed for seed, one in found if one["passed"] is False]
        failed, judged = failed + len(lost), judged + sum(one["passed"] is not None for _, one in found)
        chance = np.array([one.get("chance") for _, one in found], float)
        lines.append(
            f"| {name} | {' '.join(map(str, lost))} | {len(found)} | {spread} | "
            f"{np.sqrt(np.nanmean(part**2)):.2f}, {np.nanmax(part):.2f} | {_rms(chance)} |"
        )
    seeds = len({run["seed"] for run in runs})
    return "\n".join([*lines, "", f"{failed} of {judged} criteria judged in {seeds} runs failed."])


def _rms(chance: np.ndarray) -> str:
    """RMS of the normal deviates that the chances stand for: 1 if the stated noise is right."""
    from scipy.stats import norm

    known = chance[~np.isnan(chance)]
    return f"{np.sqrt(np.mean(norm.isf(known / 2) ** 2)):.2f}" if known.size else ""


def main() -> None:
    """Run the seeds that are not done yet, print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("experiments", nargs="+", help="names")
    parser.add_argument("--seeds", type=int, default=40, help="number of seeds")
    parser.add_argument("--first", type=int, default=1, help="first seed")
    parser.add_argument("--set", dest="settings", action="append", default=[], help="KEY=VALUE of the experiment")
    parser.add_argument("--out", type=Path, default=Path("alarms"), help="folder of finished runs")
    parser.add_argument("--table", action="store_true", help="only print finished runs")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    for name in options.experiments:
        file = options.out / f"{name}.jsonl"
        runs = [json.loads(line) for line in file.read_text(encoding="utf-8").splitlines()] if file.exists() else []
        done = {run["seed"] for run in runs}
        seeds = range(options.first, options.first + options.seeds)
        for seed in [] if options.table else [one for one in seeds if one not in done]:
            began = time.perf_counter()
            criteria = criteria_of(name, seed, tuple(options.settings))
            runs.append({"seed": seed, "seconds": round(time.perf_counter() - began, 1), "criteria": criteria})
            with file.open("a", encoding="utf-8") as stream:
                stream.write(json.dumps(runs[-1]) + "\n")
        print(f"\n## {name}\n\n{table(runs)}" if runs else f"\n## {name}: nothing done", flush=True)


if __name__ == "__main__":
    main()
