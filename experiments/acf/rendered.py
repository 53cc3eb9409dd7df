"""The same calibration on rendered frames: the experiment ``skycal``, run and read through its declaration."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from experiments.acf.result import Result
from experiments.acf.settings import Config
from experiments.harness.progress import Progress
from experiments.harness.quantities import Outcome
from experiments.harness.summary import Criterion

__all__ = ["calibrate_rendered", "criteria", "draw", "results"]


def calibrate_rendered(config: Config, progress: Progress) -> Outcome | None:
    """The calibration on pixels, if it is wanted."""
    if config.rendered.which == "none":
        return None
    from experiments.skycal.experiment import Config as SkyConfig
    from experiments.skycal.experiment import experiment

    wanted = SkyConfig(seed=config.seed, which=config.rendered.which, frames=config.rendered.frames)
    return experiment.outcome(wanted, experiment.run(wanted, progress=progress))


def results(result: Result) -> dict[str, Any]:
    """``rendered`` of ``summary.json``: map errors of the rendered cameras [arcsec]; null where none was rendered."""
    found = result.rendered
    if found is None:
        return {"rendered": None}

    def one(camera: str) -> dict[str, Any]:
        def errors(method: str) -> dict[str, float]:
            return {
                name: float(found.values(f"measured_{name}_arcsec", method=method, camera=camera))
                for name in ("rms", "max", "predicted")
            }

        parts = found.quantity("part_rms_arcsec", camera=camera).values
        return {
            **{name: found.values(name, camera=camera) for name in ("lens", "field_deg", "frames", "stars_per_frame")},
            "map_error_arcsec": errors("free"),
            "map_error_with_gyro_arcsec": errors("linked"),
            "parts_arcsec": dict(zip(found.data.coords["part"].values.tolist(), parts, strict=True)),
        }

    return {"rendered": {camera: one(camera) for camera in found.data.coords["camera"].values.tolist()}}


def criteria(outcome: Outcome) -> list[Criterion]:
    """The criteria of the rendered cameras."""
    if outcome.result.rendered is None:
        return []
    from experiments.skycal.experiment import experiment

    return experiment.judge(outcome.result.rendered)


def draw(rendered: Outcome) -> Callable[..., Any]:
    """``draw(name, camera)``: a figure of a rendered camera."""
    from experiments.skycal.experiment import experiment

    return experiment.draw(rendered)
