"""What a run of the dataset experiment has to show."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from experiments.dataset.facts import FrameFacts
from experiments.dataset.scene import Scene
from experiments.dataset.settings import Config

if TYPE_CHECKING:
    from experiments.dataset.evaluate import Evaluation
    from experiments.dataset.resume_test import ResumeTest

__all__ = ["Result"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Result:
    """A dataset that is complete.

    Attributes
    ----------
    config : Config
        The configuration.
    folder : pathlib.Path
        Where it is.
    scene : Scene
        What the frames have in common.
    facts : tuple of FrameFacts
        One per frame, in their order.
    made : int
        Frames made by this run; the others were there.
    seconds : float
        Time this run took to make them, the start of the workers included.
    frames_per_s : float
        Frames per second from the first finished one to the last, all workers together; NaN for fewer than two.
    workers : int
        Processes that made them.
    runtime_s, peak_memory_mb : float
        Of this process.
    exports : mapping
        Name of an export -> what was written, in words.
    resume : ResumeTest or None
        A run that was killed and taken up again; None if it was not tried.
    evaluation : Evaluation or None
        What was found in the frames; None if they were not looked at.
    """

    config: Config
    folder: Path
    scene: Scene
    facts: tuple[FrameFacts, ...]
    made: int
    seconds: float
    frames_per_s: float
    workers: int
    runtime_s: float
    peak_memory_mb: float
    exports: Mapping[str, str] = field(default_factory=dict)
    resume: ResumeTest | None = None
    evaluation: Evaluation | None = None
