"""Performance of your star sensor from its sensor file: predicted in seconds, confirmed by rendered frames.

`predict` is the fast path without frames, for sweeps and comparisons.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from experiments.camera.settings import Config
    from experiments.laboratory.sensor_prediction import CameraPrediction

__all__ = ["predict"]


def predict(config: Config) -> CameraPrediction:
    """Predicted performance of the configured sensor; see `experiments.laboratory.sensor_prediction.predict_camera`."""
    from experiments.laboratory.sensor_prediction import predict_camera

    return predict_camera(config)
