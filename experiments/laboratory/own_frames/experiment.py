"""Tests with point targets on frames from outside: no rendering, no truth.

What takes over from `temporal`, `hsfe` and `distortion` when their ``frames_folder`` names a folder.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Literal

from experiments.harness.experiment import Experiment
from experiments.harness.progress import Progress
from experiments.laboratory.centroid_methods import needs_epsf
from experiments.laboratory.own_frames.folder import FrameFolder, read_folder
from experiments.laboratory.own_frames.reduction import (
    GridFrames,
    StepFrames,
    TemporalFrames,
    distortion_from_frames,
    hsfe_from_frames,
    temporal_from_frames,
)
from experiments.laboratory.point_settings import PointConfig
from optics.errors import ConfigError

__all__ = ["FramesResult", "Test", "own_frames", "reduce_folder"]

Test = Literal["temporal", "hsfe", "distortion"]

MAIN_TABLE: Mapping[Test, str] = {"temporal": "temporal_error", "hsfe": "hsfe", "distortion": "distortion"}


@dataclass(frozen=True, slots=True, kw_only=True)
class FramesResult:
    """What a folder gave.

    Attributes
    ----------
    test : {"temporal", "hsfe", "distortion"}
        Which reduction.
    methods : tuple of str
        Centroiders, the one that counts first.
    folder : FrameFolder
        As read.
    reduced : TemporalFrames, StepFrames or GridFrames
        By test.
    """

    test: Test
    methods: tuple[str, ...]
    folder: FrameFolder
    reduced: TemporalFrames | StepFrames | GridFrames


def reduce_folder(test: Test, config: PointConfig, *, progress: Progress) -> FramesResult:
    """Read the folder of the configuration and reduce its frames.

    Parameters
    ----------
    test : {"temporal", "hsfe", "distortion"}
        Which reduction.
    config : PointConfig
        With ``frames_folder``, ``window_px`` and the centroiders; what describes a rendering has no meaning here.
    progress : Progress
        Where to report.

    Raises
    ------
    StarbenchError
        See `read_folder` and the reductions.
    """
    methods = tuple(m for m in config.methods if not needs_epsf(m))
    if config.frames_folder is None:
        raise ConfigError("frames_folder is not given: the folder with the frames and frames.toml")
    if not methods:
        raise ConfigError("frames from outside come without a PSF: name another centroid than epsf, e.g. gaussian")
    with progress.stage("read"):
        folder = read_folder(config.frames_folder, window_px=config.window_px)
    reduced: TemporalFrames | StepFrames | GridFrames
    with progress.stage("reduce"):
        if test == "temporal":
            reduced = temporal_from_frames(folder, methods)
        elif test == "hsfe":
            reduced = hsfe_from_frames(folder, methods)
        else:
            reduced = distortion_from_frames(folder, methods, order=getattr(config, "order", 3))
    return FramesResult(test=test, methods=methods, folder=folder, reduced=reduced)


def own_frames(test: Test) -> Callable[[PointConfig], Experiment | None]:
    """What takes over from a test with rendered frames (`Experiment.instead`) when ``frames_folder`` is given."""

    def run(config: PointConfig, *, progress: Progress) -> FramesResult:
        return reduce_folder(test, config, progress=progress)

    def instead(config: PointConfig) -> Experiment | None:
        if config.frames_folder is None:
            return None
        return Experiment(
            name=test,
            config=type(config),
            run=run,
            show=(MAIN_TABLE[test],),
            report=f"{test}.md",
            renders=lambda _: False,
        )

    return instead
