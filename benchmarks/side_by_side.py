"""Four experiments at once: linear algebra on one thread each, against as many threads as there are processors.

Each round runs the same command once alone and four times at once, both ways, in turn. The result is the time of the
slowest of the four over the time of the command alone, compared with the limit set by the processors.

    python benchmarks/side_by_side.py [--names acf turntable] [--rounds 2] [--copies 4]
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from experiments.harness.system import THREADS

PRODUCTS = """
import numpy as np
a, b, s = np.ones((200, 40)), np.ones((40, 200)), np.eye(80)
for _ in range(6000):
    a @ b
    np.linalg.solve(s, np.ones(80))
"""
"""Small matrices alone, as fits and predictions have them."""


def command_of(name: str, out: Path) -> list[str]:
    """Command of a run: an experiment, or matrix products alone."""
    if name == "products":
        return [sys.executable, "-c", PRODUCTS]
    return [sys.executable, "-m", f"experiments.{name}", "--quick", "--out", str(out)]


def seconds(name: str, copies: int, threads: int | None, folder: Path) -> tuple[float, float]:
    """Wall and processor time [s] of a number of runs at once; ``threads`` None leaves the choice to the program."""
    environment = {key: value for key, value in os.environ.items() if key not in THREADS}
    if threads is not None:
        environment |= dict.fromkeys(THREADS, str(threads))
    elif name == "products":
        environment |= dict.fromkeys(THREADS, "1")  # as `one_thread` has it in a command
    out = Path(tempfile.mkdtemp(dir=folder))
    before, start = os.times(), time.perf_counter()
    running = [
        subprocess.Popen(
            command_of(name, out / str(copy)),
            env=environment,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        for copy in range(copies)
    ]
    codes = [process.wait() for process in running]
    wall, after = time.perf_counter() - start, os.times()
    if any(code not in (0, 1) for code in codes):
        raise SystemExit(f"{name}: exit codes {codes}")
    used = after.children_user + after.children_system - before.children_user - before.children_system
    return wall, used


def main() -> None:
    """Measure and print a table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--names", nargs="+", default=["products", "fisher", "turntable"])
    parser.add_argument("--rounds", type=int, default=2)
    parser.add_argument("--copies", type=int, default=4)
    options = parser.parse_args()
    processors = os.cpu_count() or 1
    print(f"{processors} processors, {options.copies} runs at once, median of {options.rounds}\n")
    print("| experiment --quick | threads | alone [s] | at once [s] | processor time at once [s] | at once / alone |")
    print("|---|---|---|---|---|---|")
    with tempfile.TemporaryDirectory() as folder:
        for name in options.names:
            rows: dict[int | None, list[tuple[float, float, float]]] = {None: [], processors: []}
            for _ in range(options.rounds):
                for threads, found in rows.items():
                    alone, _ = seconds(name, 1, threads, Path(folder))
                    found.append((alone, *seconds(name, options.copies, threads, Path(folder))))
            for threads, found in rows.items():
                alone, wall, used = np.median(found, axis=0)
                label = "one (ours)" if threads is None else str(threads)
                print(f"| {name} | {label} | {alone:.1f} | {wall:.1f} | {used:.1f} | {wall / alone:.2f} |", flush=True)


if __name__ == "__main__":
    main()
