"""Datasets of star frames with exact truth: thousands of frames of the real sky, for whoever builds star sensors.

Every frame is the real sky through a traced lens, read out with noise, beside a table that says where each star truly
is. Frame k is the same bytes whether it is made alone, in any order, or by many workers. What was made stays: run the
same command again after an interrupt, a killed machine or a full disk, and it goes on where it stopped; ask for more
frames, and the dataset grows.
"""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from experiments.dataset.folder import DatasetFolder
from experiments.dataset.identity import for_workers, identity
from experiments.dataset.settings import Config
from experiments.harness.legacy import legacy_command as command
from experiments.harness.progress import Progress
from experiments.harness.summary import Criterion
from optics.errors import ConfigError
from render.engine import Engine

if TYPE_CHECKING:
    from experiments.dataset.evaluate import Evaluation
    from experiments.dataset.facts import FrameFacts
    from experiments.dataset.result import Result
    from experiments.dataset.resume_test import ResumeTest
    from experiments.dataset.scene import Scene
    from experiments.dataset.work import Job
    from experiments.harness.report import Report
    from experiments.harness.tables import Table

__all__ = ["Config", "main", "report", "run", "summary"]


def output(path: str, config: Config) -> DatasetFolder:
    """The folder of the dataset, new or begun."""
    return DatasetFolder(path, config=identity(config), frames=config.frames, truth=config.files.truth)


def run(config: Config, *, progress: Progress, output: DatasetFolder) -> Result:
    """Make the frames that are missing.

    Parameters
    ----------
    config : Config
        Settings.
    progress : Progress
        Where to report.
    output : DatasetFolder
        Where they go.

    Raises
    ------
    StarbenchError
        On anything the user can mend; see `experiments.dataset.scene.build_scene`, `experiments.dataset.folder` and
        `experiments.dataset.schedule`.
    """
    from experiments.dataset.finish import write_exports
    from experiments.dataset.result import Result
    from experiments.dataset.scene import build_scene
    from experiments.dataset.schedule import software
    from experiments.dataset.shards import check_webdataset
    from experiments.dataset.work import Job
    from experiments.harness.provenance import peak_memory_mb, process_seconds

    with progress.stage("prepare"):
        if "webdataset" in config.exports:
            check_webdataset()
        scene = build_scene(config)
        _check_window(config, scene)
    backend = Engine.active().backend
    job = Job(config=for_workers(config).model_dump_json(), folder=str(output.path), backend=backend)
    output.open(software(backend))
    try:
        facts = _look(config, output, progress)
        before = len(facts)
        started = time.perf_counter()
        pixels = scene.instrument.camera.width_px * scene.instrument.camera.height_px
        rate, workers = _make(config, output, job, facts, pixels, progress)
        seconds = time.perf_counter() - started
        ordered = tuple(facts[frame] for frame in range(config.frames))
        exports = write_exports(scene, output.path, ordered, progress)
        evaluation = _evaluate(config, output, scene, ordered, progress)
        return Result(
            config=config,
            folder=output.path,
            scene=scene,
            facts=ordered,
            made=config.frames - before,
            seconds=seconds,
            frames_per_s=rate,
            workers=workers,
            runtime_s=process_seconds(),
            peak_memory_mb=peak_memory_mb(),
            exports=exports,
            resume=_resume(config, job, ordered, progress),
            evaluation=evaluation,
        )
    except BaseException:
        output.close()
        raise


def _check_window(config: Config, scene: Scene) -> None:
    """Refuse a detector that is too small to look at its frames, before they are made."""
    camera = scene.instrument.camera
    if config.verify.frames and min(camera.width_px, camera.height_px) < config.verify.window_px:
        raise ConfigError(
            f"verify.window_px = {config.verify.window_px} px; the window does not fit the detector of "
            f"{camera.width_px} x {camera.height_px} px: take a larger camera.height_px or camera.width_px, or set "
            "verify.frames = 0"
        )


def _look(config: Config, output: DatasetFolder, progress: Progress) -> dict[int, FrameFacts]:
    """Frames that are there and whole."""
    from concurrent.futures import ThreadPoolExecutor
    from functools import partial

    from experiments.dataset.folder import checked_frame
    from experiments.dataset.schedule import processors

    numbers = output.numbers()
    if not numbers:
        return {}
    check = partial(checked_frame, output.path, truth=config.files.truth)
    with ThreadPoolExecutor(processors()) as pool:
        found = progress.track(pool.map(check, numbers), "look at the frames there are", total=len(numbers))
        return {facts.frame: facts for facts in found if facts is not None}


def _make(
    config: Config, output: DatasetFolder, job: Job, facts: dict[int, FrameFacts], pixels: int, progress: Progress
) -> tuple[float, int]:
    """Make what is missing; frames per second and the number of processes."""
    from experiments.dataset.folder import StorageError
    from experiments.dataset.schedule import make_frames

    missing = [frame for frame in range(config.frames) if frame not in facts]
    if config.files.compression == "none":
        output.check_room(len(missing) * 2 * pixels)
    times: list[tuple[float, int]] = []
    with progress.stage("make frames", total=len(missing)) as stage:

        def done(some: Sequence[FrameFacts]) -> None:
            facts.update({one.frame: one for one in some})
            times.append((time.perf_counter(), len(some)))
            stage.advance(len(some))

        try:
            workers = make_frames(job, missing, workers=config.workers, scheduler=config.scheduler, done=done)
        except StorageError as error:
            raise StorageError(
                f"{output.shown}: {error}; {output.count()} of {config.frames} frames are whole and kept: make room "
                "and run the same command again"
            ) from None
    rate = math.nan
    if len(times) > 1:
        rate = sum(count for _, count in times[1:]) / (times[-1][0] - times[0][0])
    return rate, workers


def _evaluate(
    config: Config, output: DatasetFolder, scene: Scene, facts: tuple[FrameFacts, ...], progress: Progress
) -> Evaluation | None:
    """Look at the first frames, as others will."""
    from experiments.dataset.evaluate import evaluate

    looked_at = facts[: config.verify.frames]
    if not looked_at:
        return None
    with progress.stage("look at frames", total=len(looked_at)) as stage:
        return evaluate(output.path, scene, looked_at, advance=stage.advance)


def _resume(config: Config, job: Job, facts: tuple[FrameFacts, ...], progress: Progress) -> ResumeTest | None:
    """Kill a run of the first frames and take it up again, somewhere else."""
    from experiments.dataset.resume_test import try_to_resume

    some = facts[: config.verify.resume_frames]
    if len(some) < 2:
        return None
    with progress.stage("kill a run and take it up"):
        return try_to_resume(job, some, truth=config.files.truth)


def tables(result: Result) -> Mapping[str, Table]:
    """Tables written beside the report."""
    from experiments.dataset.tables import all_tables

    return all_tables(result)


def files(result: Result, folder: Path) -> None:
    """Index, data card and contact sheet, beside what the command line writes."""
    from experiments.dataset.finish import write_closing_files

    write_closing_files(result, folder)


def summary(result: Result) -> tuple[dict[str, Any], list[Criterion]]:
    """What goes into ``summary.json``."""
    from experiments.dataset.checks import criteria, results

    return results(result), criteria(result)


def report(result: Result) -> Report:
    """What ``report.html`` shows."""
    from experiments.dataset.report import build_report

    return build_report(result)


main = command(
    "dataset",
    config=Config,
    run=run,
    report=report,
    summary=summary,
    tables=tables,
    files=files,
    output=output,
    options={
        "frames": ("frames", "Frames in all."),
        "workers": ("workers", "Processes; 0: one per processor."),
        "scheduler": ("scheduler", "Address of a Dask scheduler."),
    },
    quick={"frames": 6, "camera.width_px": 512, "camera.height_px": 512},
)
