"""What a run of the dataset experiment has to show."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from experiments.dataset.frames.scene import Scene
from experiments.dataset.settings import Config
from experiments.dataset.truth.frame_record import FrameRecord

if TYPE_CHECKING:
    from experiments.dataset.evaluation.evaluate import Evaluation
    from experiments.dataset.production.resume_check import ResumeCheck

__all__ = ["Result"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Result:
    """A dataset that is complete."""

    config: Config  # The configuration
    folder: Path  # Where it is
    scene: Scene  # What the frames have in common
    records: tuple[FrameRecord, ...]  # One per frame, in their order
    made: int  # Frames made by this run; the others were there
    damaged: tuple[int, ...]  # Frames that were there and damaged; they were made again
    # Frames per second from the first finished one to the last, all workers together; NaN for fewer than two
    frames_per_s: float
    workers: int  # Processes that made them
    exports: Mapping[str, str] = field(default_factory=dict)  # Name of an export -> what was written, in words
    # What became of a run that was killed and taken up again; None if it was not tried
    resume: ResumeCheck | None = None
    evaluation: Evaluation | None = None  # What was found in the frames; None if they were not looked at
