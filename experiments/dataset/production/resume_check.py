"""Check that a killed run can be resumed, on the first frames of the dataset itself."""

from __future__ import annotations

import dataclasses
import hashlib
import multiprocessing
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from experiments.dataset.production.folder import FRAMES, TRUTH, checked_frame
from experiments.dataset.production.job import Job, make_frame
from experiments.dataset.truth.frame_record import FrameRecord

__all__ = ["ResumeCheck", "check_resume"]

PATIENCE_S = 120.0
POLL_S = 2e-3


@dataclass(frozen=True, slots=True, kw_only=True)
class ResumeCheck:
    """What became of it."""

    frames: int  # How many were asked for
    whole_when_killed: int  # Whole frames that the killed process left
    same_bytes: int  # Frames whose file and truth are, after the second run, those of the dataset, byte for byte

    @property
    def passed(self) -> bool:
        """Whether nothing was lost and nothing differs."""
        return self.same_bytes == self.frames


def check_resume(job: Job, records: Sequence[FrameRecord], *, truth: str) -> ResumeCheck:
    """Make frames of a dataset once more in a process that is killed half-way (SIGKILL), and go on in this one."""
    numbers = [one.frame for one in records][::-1]
    with tempfile.TemporaryDirectory(prefix="starbench-resume-", ignore_cleanup_errors=True) as scratch:
        again = dataclasses.replace(job, folder=scratch)
        for name in (FRAMES, TRUTH):
            (Path(scratch) / name).mkdir()
        process = multiprocessing.get_context("spawn").Process(target=_make, args=(again, numbers), daemon=True)
        process.start()
        try:
            _wait(Path(scratch) / TRUTH, truth, len(numbers) // 2, process)
        finally:
            if process.is_alive():
                process.kill()
            process.join()
        whole = sum(checked_frame(Path(scratch), number, truth) is not None for number in numbers)
        for number in numbers:
            make_frame(again, number)
        same = sum(
            all(_digest(Path(scratch) / name) == _digest(Path(job.folder) / name) for name in (one.file, one.truth))
            for one in records
        )
    return ResumeCheck(frames=len(numbers), whole_when_killed=whole, same_bytes=same)


def _make(job: Job, numbers: Sequence[int]) -> None:
    for number in numbers:
        make_frame(job, number)


def _wait(folder: Path, truth: str, count: int, process: multiprocessing.process.BaseProcess) -> None:
    """Until so many frames are there, or the process has ended."""
    end = time.monotonic() + PATIENCE_S
    while process.is_alive() and time.monotonic() < end:
        if sum(1 for _ in folder.glob(f"frame_*.{truth}")) >= count:
            return
        time.sleep(POLL_S)


def _digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()
