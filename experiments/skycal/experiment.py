"""Calibration of star cameras under a rendered sky: the run and the declaration."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from experiments.harness.cli import command
from experiments.harness.experiment import Experiment
from experiments.harness.progress import Progress
from experiments.skycal.settings import Config

if TYPE_CHECKING:
    from experiments.skycal.result import CameraResult, Result
    from experiments.skycal.scene import Scene
    from render.engine.random import Streams

__all__ = ["Config", "experiment", "main", "run"]


def run(config: Config, *, progress: Progress) -> Result:
    """Render, read out, measure, match, calibrate and compare."""
    from experiments.skycal.result import Result
    from experiments.skycal.scene import build_scene
    from render.engine.random import Streams

    root = Streams(config.seed).child("skycal")
    scenes = {name: build_scene(name, config, root.child(name)) for name in config.cameras}
    cameras = {name: _camera(scene, config, root.child(name), progress) for name, scene in scenes.items()}
    return Result(config=config, cameras=cameras)


def _camera(scene: Scene, config: Config, streams: Streams, progress: Progress) -> CameraResult:
    """All of one camera."""
    from experiments.skycal.evaluate import evaluate
    from experiments.skycal.match import match_frames
    from experiments.skycal.measure import record
    from experiments.skycal.result import CameraResult

    with progress.stage(f"{scene.name}: frames", total=scene.frames) as stage:
        recording = record(scene, config, streams, advance=stage.advance)
    with progress.stage(f"{scene.name}: matches"):
        matched = match_frames(scene, recording, config)
    with progress.stage(f"{scene.name}: calibrations", total=len(scene.config.models) + 3) as stage:
        found = evaluate(scene, recording, matched, config, streams, advance=stage.advance)
    return CameraResult(scene=scene, recording=recording, matched=matched, evaluation=found)


def files(result: Result, folder: Path) -> None:
    """One frame of each camera as FITS."""
    from render.fits.files import write_frame

    for name, camera in result.cameras.items():
        write_frame(camera.recording.example, folder / f"frame_{name}.fits")


experiment = Experiment(
    name="skycal",
    config=Config,
    run=run,
    takes="3 min (--quick: 1 min)",
    examples={
        "--quick": "six frames, fewer stars",
        "--set which=wide --set frames=20": "the wide lens alone, 20 frames",
        "--set centroid=gaussian": "another centroider",
    },
    show=("cameras", "parts"),
    files=files,
    quick={
        "frames": 6,
        "dark_frames": 5,
        "motion.rate_deg_per_s": 3.0,
        "map_points": 13,
        "narrow.faintest_mag": 8.7,
        "narrow.psf_spacing_px": 400.0,
        "narrow.models": ["pinhole", "brown_conrady", "polynomial_3"],
        "wide.faintest_mag": 6.2,
        "wide.psf_spacing_px": 170.0,
        "wide.models": ["pinhole", "brown_conrady", "polynomial_5"],
    },
)
main = command(experiment)
