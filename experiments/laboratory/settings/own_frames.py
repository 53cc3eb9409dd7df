"""``--own-frames FOLDER``: a laboratory's frames reduced in place of rendered ones (`experiments.reduce`)."""

from __future__ import annotations

from dataclasses import replace
from importlib import import_module
from typing import Any

from pydantic import Field

from experiments.harness.experiment import Experiment
from experiments.laboratory.settings.sensor_file import SensorExperimentConfig
from optics.settings import FolderName


class OwnFramesConfig(SensorExperimentConfig):
    """Settings of an experiment that renders frames, or reduces the frames of a folder."""

    own_frames: FolderName | None = Field(
        default=None,
        description="reduce the FITS frames of this folder, described by its frames.toml, instead of rendered ones",
    )


def or_own_frames(rendered: Experiment) -> Experiment:
    """The experiment; where ``own_frames`` is given, ``own_frames`` of its module ``own_frames`` takes over."""

    def instead(config: Any) -> Experiment | None:
        if config.own_frames is None:
            return None
        test = import_module(f"{rendered.package}.own_frames").own_frames  # `experiments.reduce.pipeline.FramesTest`
        taking_over: Experiment = test.experiment(rendered)
        return taking_over

    return replace(
        rendered,
        examples={**rendered.examples, "--own-frames my_frames": "reduce the FITS frames of a laboratory"},
        options={
            **rendered.options,
            "own-frames": ("own_frames", "Reduce the FITS frames of a folder that holds frames.toml."),
        },
        instead=instead,
    )
