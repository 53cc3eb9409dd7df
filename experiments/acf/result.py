"""What a run of the experiment found."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

from experiments.acf.expected import ExpectedResults
from experiments.acf.independent import Check
from experiments.acf.inference import Inference
from experiments.acf.monte_carlo import Trials
from experiments.acf.points import Plan
from experiments.acf.settings import Config
from experiments.acf.simulate import Scene, Stars

if TYPE_CHECKING:
    from experiments.harness.quantities import Outcome

__all__ = ["Result"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Result:
    """Everything the run found."""

    config: Config  # Settings
    scene: Scene  # Truth
    stars: Stars  # The sky of Fig. 3 to 5 and Table 2
    plan: Plan  # What was run
    trials: Mapping[str, Trials]  # By the name of the point
    expected: ExpectedResults  # From the design alone
    inference: Inference  # Pixel and stars from the document's own numbers
    rendered: Outcome | None  # The calibration on rendered frames, by the experiment ``skycal``
    check: Check  # The same night and adjustment by equations written out
