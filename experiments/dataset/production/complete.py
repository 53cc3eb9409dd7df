"""A dataset brought to the frames asked for: those that are there and whole are kept, the others are made."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass

from experiments.dataset.production.folder import DatasetFolder, StorageError, numbers
from experiments.dataset.production.job import Job
from experiments.dataset.production.schedule import make_frames
from experiments.dataset.settings import Config
from experiments.dataset.truth.frame_record import FrameRecord
from experiments.harness.progress import Progress
from experiments.harness.system import prompt_pool

SMALLEST_SHARE = {"none": 1.0, "rice": 0.1, "gzip": 0.1}
"""No frame with noise is packed smaller than this."""
FAINTEST_SHARE = 0.5
"""The first one may hold the Moon, or a mask that the others lack."""

__all__ = ["Completed", "complete", "in_words"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Completed:
    """All frames, and how the missing ones were made."""

    records: tuple[FrameRecord, ...]  # One per frame, in their order
    made: int  # Frames made now; the others were there
    damaged: tuple[int, ...]  # Frames that were there and damaged; they were made again
    # Frames per second from the first finished one to the last, all workers together; NaN for fewer than two
    frames_per_s: float
    workers: int  # Processes that made them


def complete(config: Config, output: DatasetFolder, job: Job, *, pixels: int, progress: Progress) -> Completed:
    """Make what is missing."""
    if output.repaired:
        progress.note(f"{output.shown}: {output.repaired}")
    records = _whole_frames(output, progress)
    damaged = tuple(frame for frame in numbers(output.path) if frame not in records)
    missing = [frame for frame in range(config.frames) if frame not in records]
    if missing:
        output.check_room(len(missing) * 2 * pixels * SMALLEST_SHARE[config.files.compression])
    times: list[tuple[float, int]] = []
    with progress.stage("make frames", total=len(missing)) as stage:

        def done(some: Sequence[FrameRecord]) -> None:
            records.update({one.frame: one for one in some})
            if not times and config.files.compression != "none":  # by now it is known how well frames are packed
                output.check_room((len(missing) - len(some)) * some[0].frame_bytes * FAINTEST_SHARE)
            times.append((time.perf_counter(), len(some)))
            stage.advance(len(some))

        try:
            workers = make_frames(
                job, missing, workers=1 if output.only_here else config.workers, scheduler=config.scheduler, done=done
            )
        except StorageError as error:
            raise StorageError(
                f"{output.shown}: {error}; {output.count()} of {config.frames} frames are whole and kept: make room "
                "and run the same command again"
            ) from None
    rate = math.nan
    if len(times) > 1:
        rate = sum(count for _, count in times[1:]) / (times[-1][0] - times[0][0])
    ordered = tuple(records[frame] for frame in range(config.frames))
    output.digests |= {one.file: one.sha256 for one in ordered}
    if damaged:
        progress.note(f"{output.shown}: frames that were damaged and are made again: {in_words(damaged)}")
    return Completed(records=ordered, made=len(missing), damaged=damaged, frames_per_s=rate, workers=workers)


def in_words(frames: Sequence[int]) -> str:
    """Numbers of frames, the first twenty."""
    return ", ".join(map(str, frames[:20])) + (f" and {len(frames) - 20} more" if len(frames) > 20 else "")


def _whole_frames(output: DatasetFolder, progress: Progress) -> dict[int, FrameRecord]:
    """Frames that are there and whole, by number."""
    there = numbers(output.path)
    if not there:
        return {}
    with prompt_pool() as pool:
        found = progress.track(pool.map(output.checked, there), "look at the frames there are", total=len(there))
        return {one.frame: one for one in found if one is not None}
