"""What a run of the experiment found."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

from experiments.acf.forecast import Forecast
from experiments.acf.inference import Inference
from experiments.acf.plan import Outcome, Plan
from experiments.acf.settings import Config
from experiments.acf.simulate import Scene, Stars

if TYPE_CHECKING:
    from experiments.skycal.result import Result as Rendered

__all__ = ["Result"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Result:
    """Everything the run found.

    Attributes
    ----------
    config : Config
        Settings.
    scene : Scene
        Truth.
    stars : Stars
        The sky of Fig. 3 to 5 and Table 2.
    plan : Plan
        What was run.
    outcome : dict of str to Outcome
        By the name of the point.
    forecast : Forecast
        What was expected.
    inference : Inference
        Pixel and stars from the document's own numbers.
    rendered : experiments.skycal.result.Result or None
        The calibration on rendered frames.
    runtime_s, peak_memory_mb : float
        Of the process up to the end of the run.
    """

    config: Config
    scene: Scene
    stars: Stars
    plan: Plan
    outcome: Mapping[str, Outcome]
    forecast: Forecast
    inference: Inference
    rendered: Rendered | None
    runtime_s: float
    peak_memory_mb: float

    @property
    def stars_per_frame(self) -> float:
        """Mean number of stars."""
        return len(self.stars) / self.config.frames
