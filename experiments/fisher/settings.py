"""Settings and declaration of the accuracy of star vectors."""

from __future__ import annotations

from typing import Annotated, ClassVar

from pydantic import Field, model_validator

from experiments.harness.cli import command
from experiments.harness.config import Sorted
from experiments.harness.experiment import Experiment
from experiments.laboratory.settings.own_frames import or_own_frames
from experiments.laboratory.settings.tables import SignalConfig
from experiments.laboratory.single_star.settings import SingleStarConfig, TurntableConfig
from optics.settings import StrictModel


def _table() -> TurntableConfig:
    # FISHER23 calls its table one "of high precision" and gives no number. Better than CUBE09's (0.3 and 0.4 arcsec),
    # with which the method would measure the table.
    return TurntableConfig(axes="xy", reading_noise_arcsec=(0.10,), non_orthogonality_arcsec=(5.0,))


class EvaluationConfig(SignalConfig):
    """Acquisition of the star vectors (S200): a frame and a table reading at every position."""

    default_signal_e: ClassVar[float] = 2000.0

    columns: int = Field(default=21, ge=2, le=200, description="positions along a row")
    rows: int = Field(default=11, ge=2, le=200, description="positions along a column")
    edge_px: float = Field(default=45.0, ge=0, le=1e5, description="distance of the outermost positions from the edge")
    signal_e: float | None = Field(
        default=None,
        gt=0,
        le=1e7,
        description="electrons per exposure of the evaluated star; default, without a magnitude: 2000",
    )
    outlier_probability: float = Field(
        default=0.01, gt=0, lt=0.5, description="false-alarm probability of the outlier test"
    )


class DynamicConfig(StrictModel):
    """Acquisition while the table moves."""

    rate_deg_per_s: float = Field(
        default=0.05,
        gt=0,
        le=10,
        description="speed of the second axis, which sweeps rows alternately forwards and backwards",
    )
    jitter_ms: float = Field(
        default=1.0, ge=0, le=1e3, description="standard deviation of the time from mid-exposure to reading"
    )
    samples: int = Field(default=10, ge=2, le=500, description="rendered instants per exposure")


class FieldConfig(StrictModel):
    """Ideal cameras over a range of fields: result of the pixel-residual method for the same vectors."""

    field_deg: Annotated[tuple[Annotated[float, Field(ge=0.1, le=120)], ...], Sorted] = Field(
        default=(3.0, 5.0, 8.0, 12.0, 16.0, 20.0, 25.0, 30.0, 35.0, 40.0),
        min_length=2,
        description="full widths of square fields",
    )
    directions: int = Field(default=6000, ge=50, le=10**6, description="star vectors per run")
    runs: int = Field(default=40, ge=5, le=10**5, description="runs per field")
    sigma_arcsec: float = Field(default=1.0, gt=0, le=600, description="noise per axis at the boresight")


class FisherConfig(SingleStarConfig):
    """Bench and equations of FISHER23, which states no numbers: camera of ACC18, turntable better than CUBE09's."""

    table: TurntableConfig = Field(default_factory=_table)
    evaluation: EvaluationConfig = EvaluationConfig()
    dynamic: DynamicConfig = DynamicConfig()
    field: FieldConfig = FieldConfig()

    @model_validator(mode="after")
    def _evaluation_windows(self) -> FisherConfig:
        self.check_edge("evaluation.edge_px", self.evaluation.edge_px)
        return self


rendered = Experiment(
    name="fisher",
    config=FisherConfig,
    run="experiment:run",
    sections="experiment:SECTIONS",
    axes="accuracy:axes",
    takes="40 s (--quick: 20 s)",
    examples={
        "--quick": "a small run",
        "--set table.reading_noise_arcsec=[0.3,0.4]": "with the reading noise of CUBE09's turntable",
        "--set evaluation.signal_e=10000 --set dynamic.rate_deg_per_s=0.1": "a brighter star, a faster table",
    },
    show=("accuracy", "field_of_view"),
    quick={
        "grid.columns": 9,
        "grid.rows": 5,
        "evaluation.columns": 9,
        "evaluation.rows": 5,
        "dynamic.samples": 6,
        "field.field_deg": [3.0, 12.0, 20.0, 40.0],
        "field.directions": 2000,
        "field.runs": 20,
    },
)
experiment = or_own_frames(rendered)
main = command(experiment)
