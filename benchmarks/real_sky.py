"""Statistics of a real camera's twin: python benchmarks/real_sky.py FOLDER [--pitch-um 6.9] [--realisations 5].

FOLDER holds night frames of one camera. A set that anyone can fetch (ESA's tetra3, Apache License 2.0; eight frames):

    git clone --depth 1 https://github.com/esa/tetra3 && python benchmarks/real_sky.py tetra3/test_data --pitch-um 6.9
"""

from __future__ import annotations

import argparse
import sys

from experiments.harness.run import run_experiment
from experiments.twin.settings import experiment

TABLES = ("camera", "orders", "comparison", "completeness", "frames", "detections", "residuals")


def main() -> int:
    """Print the tables and the verdicts; 1 if a verdict does not hold."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("folder")
    parser.add_argument("--pitch-um", type=float)
    parser.add_argument("--realisations", type=int, default=5)
    given = parser.parse_args()
    settings: dict[str, object] = {"frames": given.folder, "realisations": given.realisations}
    if given.pitch_um is not None:
        settings["camera.pixel_pitch_um"] = given.pitch_um
    run = run_experiment(experiment, settings)
    for name in TABLES:
        if name in run.tables:
            print(f"\n{name}")
            run.table(name).pprint(max_lines=-1, max_width=-1)
    for criterion in run.criteria:
        word = "holds" if criterion.passed else "small sample" if criterion.passed is None else "missed"
        print(f"{word:12s} {criterion.name}: {criterion.value:.4g}, limit {criterion.limit:.4g}")
    return int(any(one.failed for one in run.criteria))


if __name__ == "__main__":
    sys.exit(main())
