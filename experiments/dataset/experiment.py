"""Datasets of star frames with exact truth: the declaration, and the run that makes what is missing."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import click

from experiments.dataset.production.folder import DatasetFolder
from experiments.dataset.production.identity import for_workers, identity, software
from experiments.dataset.production.remote import RemoteDataset, is_url, working_copy
from experiments.dataset.settings import Config
from experiments.harness.cli import command
from experiments.harness.experiment import Experiment
from experiments.harness.interrupts import EXIT_FAILED, EXIT_GOOD, interrupts
from experiments.harness.progress import Progress, terminal_progress
from optics.errors import ConfigError
from render.engine import Engine

if TYPE_CHECKING:
    from experiments.dataset.evaluation.evaluate import Evaluation
    from experiments.dataset.frames.scene import Scene
    from experiments.dataset.production.job import Job
    from experiments.dataset.production.resume_check import ResumeCheck
    from experiments.dataset.result import Result
    from experiments.dataset.truth.frame_record import FrameRecord

__all__ = ["Config", "experiment", "main", "run"]


def output(path: str, config: Config) -> DatasetFolder:
    """The folder of the dataset, new or begun, or a URL."""
    if is_url(path):
        remote = RemoteDataset(path, config=identity(config), frames=config.frames, truth=config.files.truth)
        if remote.only_here and (config.workers > 1 or config.scheduler):
            raise ConfigError(f"{path}: is seen by this process alone; set workers = 1 and no scheduler")
        return remote
    return DatasetFolder(path, config=identity(config), frames=config.frames, truth=config.files.truth)


def run(config: Config, *, progress: Progress, output: DatasetFolder) -> Result:
    """Make the frames that are missing."""
    from experiments.dataset.exports.webdataset_shards import check_webdataset
    from experiments.dataset.exports.write import write_exports
    from experiments.dataset.frames.scene import build_scene
    from experiments.dataset.production.complete import complete
    from experiments.dataset.production.job import Job
    from experiments.dataset.result import Result
    from experiments.laboratory.checks import focus_remark

    with progress.stage("prepare"):
        if "webdataset" in config.exports:
            check_webdataset()
        scene = build_scene(config)
        _check_window(config, scene)
    if remark := focus_remark(scene.instrument.camera, scene.light.wavelength_nm.ravel()):
        progress.note(remark)
    backend, camera = Engine.active().backend, scene.instrument.camera
    job = Job(config=for_workers(config).model_dump_json(), folder=str(output.path), backend=backend, url=output.url)
    output.open(software(backend))
    try:
        there = complete(config, output, job, pixels=camera.width_px * camera.height_px, progress=progress)
        output.fetch(_needed(config, output, there.records))
        exports = write_exports(scene, output.path, there.records, progress)
        evaluation = _evaluate(config, output, scene, there.records, progress)
        return Result(
            config=config,
            folder=output.path,
            scene=scene,
            records=there.records,
            made=there.made,
            damaged=there.damaged,
            frames_per_s=there.frames_per_s,
            workers=there.workers,
            exports=exports,
            resume=_resume(config, job, there.records, progress),
            evaluation=evaluation,
        )
    except BaseException:
        output.close()
        raise


def _needed(config: Config, output: DatasetFolder, records: Sequence[FrameRecord]) -> list[str]:
    """Files that are looked at on this machine: every truth, and frames for exports, report and contact sheet."""
    from experiments.dataset.exports.contact_sheet import chosen
    from experiments.dataset.exports.write import EXPORTS

    exported = bool(config.exports) or any((output.path / name).is_dir() for name in EXPORTS)
    seen = max(config.verify.frames, config.verify.resume_frames)
    some = records if exported else (*records[:seen], *chosen(records))
    return list(dict.fromkeys([*(one.truth for one in records), *(one.file for one in some)]))


def _check_window(config: Config, scene: Scene) -> None:
    """Refuse a detector that is too small to look at its frames, before they are made."""
    camera = scene.instrument.camera
    if config.verify.frames and min(camera.width_px, camera.height_px) < config.window_px:
        raise ConfigError(
            f"window_px = {config.window_px} px; the window does not fit the detector of "
            f"{camera.width_px} x {camera.height_px} px: take a larger instrument.height_px or width_px, or set "
            "verify.frames = 0"
        )


def _evaluate(
    config: Config, output: DatasetFolder, scene: Scene, records: tuple[FrameRecord, ...], progress: Progress
) -> Evaluation | None:
    """Look at the first frames, as others will."""
    from experiments.dataset.evaluation.evaluate import evaluate
    from experiments.dataset.evaluation.solve import star_patterns

    looked_at = records[: config.verify.frames]
    if not looked_at:
        return None
    with progress.stage("star patterns of the sky (made once, then kept on disk)"):
        patterns = star_patterns(scene)
    with progress.stage("look at frames", total=len(looked_at)) as stage:
        return evaluate(output.path, scene, looked_at, patterns=patterns, advance=stage.advance)


def _resume(config: Config, job: Job, records: tuple[FrameRecord, ...], progress: Progress) -> ResumeCheck | None:
    """Kill a run of the first frames and take it up again, somewhere else."""
    from experiments.dataset.production.resume_check import check_resume

    some = records[: config.verify.resume_frames]
    if len(some) < 2:
        return None
    with progress.stage("kill a run and take it up"):
        return check_resume(replace(job, url=""), some, truth=config.files.truth)


def files(result: Result, folder: Path) -> None:
    """Index, data card and contact sheet, beside what the command line writes."""
    from experiments.dataset.exports.write import write_closing_files

    write_closing_files(result, folder)


experiment = Experiment(
    name="dataset",
    config=Config,
    run=run,
    takes="50 s (--quick: 12 s)",
    examples={
        "--frames 1000 --out sky": "the real sky, 1024 x 1024 px, random attitudes; the same command goes on",
        "--frames 5000 --workers 8 --out sky": "let it grow, sooner",
        "check sky": "read every file, say what is damaged and what a run would make again",
        "--sensor my.toml --set 'exports=[\"coco\"]'": "another sensor, copies for learning programs",
    },
    extra="quantities:extra",
    files=files,
    output=output,
    options={
        "frames": ("frames", "Frames in all."),
        "workers": ("workers", "Processes; 0: one per processor."),
        "scheduler": ("scheduler", "Address of a Dask scheduler."),
    },
    quick={"frames": 6, "instrument.width_px": 512, "instrument.height_px": 512},
)


main = command(experiment)


@main.command(help="Read every file of a dataset and say what is damaged, and what a run would make again.")
@click.argument("folder", metavar="FOLDER_OR_URL")
def check(folder: str) -> int:
    """0 if every file is as it was written, 1 if not."""
    from experiments.dataset.production.check import check as checked

    interrupts.at_once, interrupts.said = False, lambda: "interrupted; nothing was changed"
    with working_copy(folder) if is_url(folder) else nullcontext(Path(folder)) as held:
        found = checked(held, terminal_progress())
    click.echo("\n".join(found.lines()))
    return EXIT_FAILED if found.damaged or found.missing else EXIT_GOOD
