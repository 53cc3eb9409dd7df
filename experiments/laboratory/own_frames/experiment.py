"""Tests with point targets on frames from outside: no rendering, no truth.

It takes over from `temporal`, `hsfe` and `distortion` when their ``frames_folder`` names a folder.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Literal

from experiments.harness.experiment import Experiment
from experiments.harness.progress import Progress
from experiments.laboratory.centroid_methods import needs_epsf
from experiments.laboratory.point_settings import PointConfig
from optics.errors import ConfigError

if TYPE_CHECKING:
    from experiments.laboratory.own_frames.folder import FrameFolder
    from experiments.laboratory.own_frames.reduction import GridFrames, StepFrames, TemporalFrames

__all__ = ["FramesResult", "Test", "or_own_frames", "reduce_folder"]

Test = Literal["temporal", "hsfe", "distortion"]


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
    from experiments.laboratory.own_frames import reduction
    from experiments.laboratory.own_frames.folder import read_folder

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
            reduced = reduction.temporal_from_frames(folder, methods)
        elif test == "hsfe":
            reduced = reduction.hsfe_from_frames(folder, methods)
        else:
            reduced = reduction.distortion_from_frames(folder, methods, order=getattr(config, "order", 3))
    return FramesResult(test=test, methods=methods, folder=folder, reduced=reduced)


def or_own_frames(test: Experiment) -> Experiment:
    """A test with rendered frames that reduces those of a folder instead where ``frames_folder`` is given.

    Parameters
    ----------
    test : Experiment
        `temporal`, `hsfe` or `distortion`, on rendered frames.

    Returns
    -------
    Experiment
        The same with an option ``--frames``; both print the same table in the terminal.
    """
    name: Any = test.name

    def run(config: PointConfig, *, progress: Progress) -> FramesResult:
        return reduce_folder(name, config, progress=progress)

    def instead(config: PointConfig) -> Experiment | None:
        if config.frames_folder is None:
            return None
        report = f"{name}.md"
        return Experiment(
            name=name, config=test.config, run=run, show=test.show, report=report, renders=lambda _: False
        )

    return replace(
        test,
        examples={**test.examples, "--frames my_frames": "reduce the FITS frames of a laboratory"},
        options={"frames": ("frames_folder", "Reduce the FITS frames of a folder that holds frames.toml.")},
        instead=instead,
    )
