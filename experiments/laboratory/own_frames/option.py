"""The key of a configuration that names a folder of own frames: one meaning in every experiment that takes them."""

from __future__ import annotations

from pydantic import Field

from experiments.harness.config import FolderName
from experiments.laboratory.sensor_file import SensorExperimentConfig

__all__ = ["OwnFramesConfig"]


class OwnFramesConfig(SensorExperimentConfig):
    """Of an experiment that renders frames, or reduces those of a folder (``--own-frames``)."""

    own_frames: FolderName | None = Field(
        default=None, description="reduce the FITS frames of this folder (frames.toml says which is which), render none"
    )
