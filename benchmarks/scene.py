"""Cost of star frames by ``mi.render`` of a scene, compared with the bare tracer on the same stars.

Run from the repository root: ``python benchmarks/scene.py`` (two minutes); ``--repeat N`` for more pairs of frames.

Scene: `render.forward.StarRenderer.trace`, one scene kept, stars and attitude handed over through ``mi.traverse`` and
rendered by ``mi.render``. Tracer: `render.tracing.tracer.Tracer.render`, plain records, no Mitsuba. Both make the same
image from the same rays. Dataset: 1024 x 1024 px, 240 stars in one band, another field and attitude in every frame.
Chromatic: the star grid of ``experiments.chromatic`` with its bands on its detector, the same in every frame.

In one process the two take turns, each frame in the other order than the last. The result is the median of the pairs'
ratios of processor time and its standard error (1.25 sigma / sqrt(n), sigma from the quartiles). Exit status 1 if the
cost is above 5 % by more than three of these errors.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.frame import make_camera, make_stars
from experiments.chromatic.settings import ChromaticConfig
from experiments.chromatic.stars import NODES
from optics.light.band import band_nodes
from optics.light.spectrum import Blackbody
from render.camera import Camera
from render.engine import Engine
from render.forward import StarRenderer
from render.records import StarField
from render.sensor_file.filters import open_band
from render.sensor_file.instrument import build_instrument
from render.tracing.tracer import Tracer

LIMIT = 0.05
WARM_UP = 2
STARS, SIDE_PX = 240, 1024

Frame = tuple[StarField, np.ndarray]


def dataset_frames(count: int) -> tuple[Camera, list[Frame]]:
    """Stars of a dataset's frames, each with its own attitude."""
    camera = make_camera()
    camera = replace(camera, width_px=SIDE_PX, height_px=SIDE_PX, centre_px=np.full(2, 0.5 * (SIDE_PX - 1)))
    rng, frames = np.random.default_rng(1), []
    for _ in range(count):
        turn = Rotation.from_rotvec(rng.normal(size=3)).as_matrix()
        x, y = rng.uniform(0.0, SIDE_PX - 1.0, (2, STARS))
        there = camera.nominal_direction(x, y, 206.2) @ turn
        stars = replace(make_stars(camera, STARS), direction=there / np.linalg.norm(there, axis=1, keepdims=True))
        frames.append((stars, turn))
    return camera, frames


def chromatic_frames(count: int) -> tuple[Camera, list[Frame]]:
    """The star grid of the chromatic experiment, every temperature at every field point, by rays."""
    config = ChromaticConfig()
    instrument = build_instrument(config.instrument)
    camera, side = replace(instrument.camera, diffraction="rays"), config.stars.grid
    x, y = ((np.arange(side) + 0.5) / side * size - 0.5 for size in (camera.width_px, camera.height_px))
    x, y = np.meshgrid(x, y)
    field = camera.nominal_direction(x.ravel(), y.ravel(), instrument.focal_length_mm)
    nodes = band_nodes([open_band(config.passband, instrument)], NODES)
    light = nodes.weight_nm * nodes.transmission
    spectra = [
        light * Blackbody(temperature_k=k).photon_density(nodes.wavelength_nm) for k in config.stars.temperatures_k
    ]
    stars = StarField(
        direction=np.tile(field, (len(spectra), 1)),
        wavelength_nm=nodes.wavelength_nm,
        photon_rate=np.repeat(np.stack([one / one.sum() for one in spectra]), len(field), axis=0),
        band=("full",),
    )
    return camera, [(stars, camera.rotation_cam_from_world)] * count


def spent(run: Callable[[], Any]) -> float:
    """Processor time [s]."""
    start = time.process_time()
    run()
    return time.process_time() - start


def compare(name: str, camera: Camera, frames: list[Frame]) -> bool:
    """Whether the scene costs no more than `LIMIT`."""
    scene, tracer = StarRenderer(camera), Tracer(camera)
    pairs = []
    for i, (stars, turn) in enumerate(frames):
        runs = [
            lambda stars=stars, turn=turn: scene.trace(stars, rotation_cam_from_world=turn),
            lambda stars=stars, turn=turn: tracer.render(stars, exposure_s=1.0, rotation_cam_from_world=turn),
        ]
        order = (0, 1) if i % 2 else (1, 0)
        took = {which: spent(runs[which]) for which in order}
        if i >= WARM_UP:
            pairs.append((took[0], took[1]))
    taken = np.array(pairs)
    ratio = taken[:, 0] / taken[:, 1]
    low, middle, high = np.percentile(ratio, [25, 50, 75])
    error = 1.2533 * (high - low) / 1.349 / np.sqrt(len(ratio))
    ms = 1e3 * np.median(taken, axis=0)
    print(
        f"{name:10s} {camera.width_px} x {camera.height_px} px {len(frames[0][0]):5d} stars   scene {ms[0]:7.1f} ms   "
        f"tracer {ms[1]:7.1f} ms   cost {100 * (middle - 1):+.1f} +- {100 * error:.1f} %   ({len(ratio)} pairs)",
        flush=True,
    )
    return bool(middle - 3.0 * error < 1.0 + LIMIT)


def main() -> None:
    """Run both."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeat", type=int, default=200, help="pairs of frames of each kind")
    count = parser.parse_args().repeat
    Engine.start("auto")
    good = [
        compare("dataset", *dataset_frames(count + WARM_UP)),
        compare("chromatic", *chromatic_frames(max(count // 20, 3) + WARM_UP)),
    ]
    sys.exit(0 if all(good) else 1)


if __name__ == "__main__":
    main()
