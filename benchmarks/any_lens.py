"""Every experiment with every lens: processor time of the --quick run, against the built-in lens on the same detector.

A lens whose stop lies inside has beams whose outlines must be found, one whose apertures cut the light has outlines
with kinks: neither may cost much. The detector is the same for all (cmv4000).

    python benchmarks/any_lens.py [--names hsfe budget] [--lenses star_tracker_26mm my.toml] [--rounds 3]
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

ROOT = Path(__file__).parents[1]
REFERENCE = "star_camera_206mm"
NAMES = ("chromatic", "temporal", "hsfe", "distortion", "budget", "turntable", "fisher")
SETTINGS = (  # a window that all these lenses fill
    "instrument.detector=cmv4000",
    "instrument.width_px=1024",
    "instrument.height_px=1024",
    "instrument.defocus_mm=0",
    "instrument.absorption=false",
)
LENSES = ("star_tracker_26mm", "double_gauss_50mm", str(ROOT / "docs/examples/triplet_50mm/lens.toml"))
OWN = {
    "double_gauss_50mm": ("instrument.defocus_mm=0.07", "instrument.f_number=4")
}  # a photographic lens, stopped down


def processor_seconds(name: str, lens: str, folder: Path) -> tuple[float, str]:
    """Processor time of a run [s], and what it ended with if that is no result."""
    out = Path(tempfile.mkdtemp(dir=folder)) / "out"
    settings = [f"instrument.lens={lens}", *SETTINGS, *OWN.get(lens, ())]
    command = [sys.executable, "-m", f"experiments.{name}", "--quick", "--out", str(out)]
    before = os.times()
    done = subprocess.run(
        [*command, *(word for one in settings for word in ("--set", one))], capture_output=True, text=True, check=False
    )
    after = os.times()
    used = after.children_user + after.children_system - before.children_user - before.children_system
    return used, "" if done.returncode in (0, 1) else (done.stderr.strip().splitlines() or ["no result"])[-1]


def main() -> None:
    """Measure and print a table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--names", nargs="+", default=list(NAMES))
    parser.add_argument("--lenses", nargs="+", default=list(LENSES))
    parser.add_argument("--rounds", type=int, default=1)
    options = parser.parse_args()
    lenses = [REFERENCE, *options.lenses]
    print("| experiment | " + " | ".join(lens if "/" not in lens else Path(lens).parent.name for lens in lenses) + " |")
    print("|---" * (len(lenses) + 1) + "|")
    with tempfile.TemporaryDirectory() as folder:
        for name in options.names:
            found = [[processor_seconds(name, lens, Path(folder)) for lens in lenses] for _ in range(options.rounds)]
            seconds = np.median([[used for used, _ in row] for row in found], axis=0)
            cells = [
                said or f"{value:.1f} s" + ("" if place == 0 else f", {value / seconds[0]:.2f} x")
                for place, (value, (_, said)) in enumerate(zip(seconds, found[-1], strict=True))
            ]
            print(f"| {name} | " + " | ".join(cells) + " |", flush=True)


if __name__ == "__main__":
    main()
