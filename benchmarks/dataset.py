"""Frames per second of `python -m experiments.dataset`, from attitude to files on disk: against stars, pixels, workers.

Run from the repository root: ``python benchmarks/dataset.py`` (some minutes); ``--figure`` also draws
docs/pictures/dataset_cost.png. The first two rows are the required rates: 1024 x 1024 px of 12.4 deg to G = 8 on two
workers (20 frames/s), and 4096 x 2048 px to G = 10 (2 frames/s).

The time is that of the command without the evaluation of finished frames: from the first finished frame to the last,
all workers together. Frames are noisy, written with truth and digest, uncompressed. One process per worker, each with
one thread where there are as many workers as processors. The parts are medians of the processor time of one process:
they hold on a busy machine too, the rates do not.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

FIGURE = ROOT / "docs" / "pictures" / "dataset_cost.png"
SMALL = ["catalogue.faintest_mag=8"]
LARGE = [
    *(
        "instrument.lens=star_camera_206mm",
        "instrument.detector=acc18_mosaic",
        "instrument.width_px=0",
        "instrument.height_px=0",
    ),
    "catalogue.faintest_mag=10",
]
MAGNITUDES = (4.0, 6.0, 7.0, 8.0, 9.0, 10.0)
SIDES_PX = (256, 512, 1024, 1536)
"""The field grows with the side; the stars are kept at some 60 by the magnitude limit."""
MAGNITUDE_OF_SIDE = {256: 9.6, 512: 8.1, 1024: 6.6, 1536: 5.8}


def rate(settings: list[str], frames: int, workers: int) -> dict[str, Any]:
    """Results of one run of the command."""
    options = [part for setting in (*settings, "verify.frames=0") for part in ("--set", setting)]
    environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1"}
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "dataset"
        command = [sys.executable, "-m", "experiments.dataset", "--frames", str(frames), "--workers", str(workers)]
        done = subprocess.run(
            [*command, "--out", str(out), *options],
            cwd=ROOT,
            env=environment,
            capture_output=True,
            text=True,
            check=False,
        )
        if done.returncode:
            sys.exit(done.stderr or done.stdout)
        results = json.loads((out / "summary.json").read_text(encoding="utf-8"))["results"]
        found: dict[str, Any] = {name: number.get("value") for name, number in results["frames"].items()}
        size = sum(file.stat().st_size for part in ("frames", "truth") for file in (out / part).iterdir())
    found["stars_per_frame"] = found["stars"] / found["frames"]
    found["megabytes_per_frame"] = size / found["frames"] / 1e6
    return found


def parts(settings: list[str], frames: int) -> dict[str, float]:
    """Milliseconds of processor time of the parts of a frame, in this process on one thread."""
    from experiments.dataset.settings import DatasetConfig
    from experiments.harness.config import load_config
    from render.engine import Engine

    Engine.start("llvm")
    import drjit as dr

    from experiments.dataset import job as work
    from experiments.dataset.frame import FrameRenderer
    from experiments.dataset.scene import build_scene
    from render import simulator
    from render.sky.sky import Sky

    dr.set_thread_count(1)
    maker = FrameRenderer(build_scene(load_config(DatasetConfig, settings=settings)))
    times: dict[str, list[float]] = {}

    def timed(name: str, function: Any) -> Any:
        def call(*arguments: Any, **options: Any) -> Any:
            start = time.process_time()
            try:
                return function(*arguments, **options)
            finally:
                times.setdefault(name, []).append(time.process_time() - start)

        return call

    from experiments.dataset import frame as module

    replaced = {
        (Sky, "field"): ("stars of the field", Sky.field),
        (simulator, "expose"): ("read out", simulator.expose),
        (module, "star_rows"): ("truth and flags", module.star_rows),
        (work, "_write_fits"): ("write FITS", work._write_fits),
        (work, "truth_bytes"): ("write truth", work.truth_bytes),
    }
    for (owner, name), (label, function) in replaced.items():
        setattr(owner, name, timed(label, function))
    renderer = maker.scene.simulator._renderer(None)
    renderer.trace = timed("trace and splat", renderer.trace)  # type: ignore[method-assign]
    total = timed("all", work._write)
    with tempfile.TemporaryDirectory() as folder:
        for part in ("frames", "truth"):
            (Path(folder) / part).mkdir()
        for frame in range(frames):
            total(work.PreparedRenderer(maker, "timed"), Path(folder), frame)
    for (owner, name), (_, function) in replaced.items():
        setattr(owner, name, function)
    found = {name: 1e3 * float(np.median(values[frames // 4 :])) for name, values in times.items()}
    found["rest"] = found["all"] - sum(value for name, value in found.items() if name != "all")
    return found


def main() -> None:
    """Print the tables; draw the figure."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--figure", action="store_true", help=f"draw {FIGURE.relative_to(ROOT)}")
    parser.add_argument("--quick", action="store_true", help="the two required rates only")
    parser.add_argument("--parts", action="store_true", help="the parts of a frame of 1024 x 1024 px only")
    arguments = parser.parse_args()
    if arguments.parts:
        _print_parts(SMALL)
        return
    print("required: 20 and 2 frames/s on two cores")
    for name, settings, frames in (("1024 x 1024, G < 8", SMALL, 200), ("4096 x 2048, G < 10", LARGE, 24)):
        for workers in (1, 2):
            _print(name, workers, rate(settings, frames, workers))
        _print_parts(settings)
    if arguments.quick:
        return
    series = {
        "stars": [(limit, rate([f"catalogue.faintest_mag={limit}"], 100, 2)) for limit in MAGNITUDES],
        "pixels": [(side, rate(_square(side), 100, 2)) for side in SIDES_PX],
        "workers": [(count, rate(SMALL, 120, count)) for count in (1, 2, 3, 4)],
    }
    for name, found in series.items():
        print(f"against {name}")
        for value, result in found:
            _print(f"{value:g}", result["workers"], result)
    if arguments.figure:
        draw(series)
        print(f"wrote {FIGURE.relative_to(ROOT)}")


def _square(side: int) -> list[str]:
    return [
        f"instrument.width_px={side}",
        f"instrument.height_px={side}",
        f"catalogue.faintest_mag={MAGNITUDE_OF_SIDE[side]}",
    ]


def _print_parts(settings: list[str]) -> None:
    for part, value in parts(settings, 16).items():
        print(f"    {part:24s} {value:8.1f} ms")


def _print(name: str, workers: int, found: dict[str, Any]) -> None:
    print(
        f"{name:24s} {workers} workers {found['frames_per_s']:8.2f} frames/s {found['stars_per_frame']:8.1f} stars "
        f"{found['megabytes_per_frame']:7.2f} MB"
    )


def draw(series: dict[str, list[tuple[float, dict[str, Any]]]]) -> None:
    """Three panels: frames per second against stars, megapixels and workers."""
    from experiments.harness.plotting import PALETTE, figure_png, house_style, new_figure

    with house_style():
        figure, axes = new_figure(1, 3, aspect_ratio=0.36)
        panels = (
            ("stars", "stars per frame, 1024 × 1024 px", lambda value, found: found["stars_per_frame"]),
            ("pixels", "megapixels, 60 stars or so", lambda value, found: value**2 / 1e6),
            ("workers", "workers on two processors", lambda value, found: value),
        )
        for place, (name, label, across) in zip(axes, panels, strict=True):
            x = [across(value, found) for value, found in series[name]]
            y = [found["frames_per_s"] for _, found in series[name]]
            place.plot(x, y, "o-", color=PALETTE[0])
            place.set_xlabel(label)
            if name == "workers":
                place.set_ylim(0.0, 1.15 * max(y))
            else:
                place.set_xscale("log")
                place.set_yscale("log")
                place.set_ylim(1.0, 200.0)
            if name == "stars":
                place.axhline(20.0, color=PALETTE[1], lw=0.9, ls="--")
                place.annotate("required", (x[0], 20.0), xytext=(0, -11), textcoords="offset points", color=PALETTE[1])
        axes[0].set_ylabel("frames per second")
        axes[2].set_xticks([1, 2, 3, 4])
        FIGURE.write_bytes(figure_png(figure, dpi=180))


if __name__ == "__main__":
    main()
