"""Settings and declaration of the turntable calibration."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from experiments.harness.cli import command
from experiments.harness.config import Sorted
from experiments.harness.experiment import Experiment
from experiments.laboratory.settings.own_frames import or_own_frames
from experiments.laboratory.single_star.settings import (
    LARGEST_STAR_ANGLE_DEG,
    SingleStarConfig,
    TurntableConfig,
)
from optics.settings import StrictModel


def _two_axes() -> TurntableConfig:
    # 0.3 and 0.4 arcsec: the table of CUBE09. FISHER23 does not give its table's errors.
    return TurntableConfig(axes="xy", reading_noise_arcsec=(0.3, 0.4), non_orthogonality_arcsec=(5.0,))


def _three_axes() -> TurntableConfig:
    return TurntableConfig(
        axes="xyz",
        reading_noise_arcsec=(0.3, 0.4, 0.4),
        non_orthogonality_arcsec=(5.0, -4.0),
        rolls_deg=(0.0, 90.0, 180.0, 270.0),
    )


StarDeg = Annotated[float, Field(ge=-LARGEST_STAR_ANGLE_DEG, le=LARGEST_STAR_ANGLE_DEG)]


class ReductionConfig(StrictModel):
    """Assumptions of the reduction."""

    focal_length_mm: float | None = Field(
        default=None, gt=0, le=1e5, description="start value; default: the lens's paraxial focal length rounded to 5 %"
    )
    axes: str | None = Field(default=None, description="assumed axes of the two-axis table; default: the true axes")
    star_deg: tuple[StarDeg, StarDeg] = Field(
        default=(0.0, 0.0), description="start value of the star direction, azimuth and elevation"
    )


class StudyConfig(StrictModel):
    """Monte Carlo and sweeps with simulated coordinates, without frames."""

    runs: int = Field(default=400, ge=20, le=100000, description="Monte Carlo runs per table")
    sweep_runs: int = Field(default=50, ge=5, le=10000, description="runs per point of a sweep")
    reading_noise_arcsec: Annotated[tuple[Annotated[float, Field(ge=0, le=1e5)], ...], Sorted] = Field(
        default=(0.003, 0.01, 0.03, 0.1, 0.3, 1.0, 3.0),
        min_length=2,
        description="swept errors of the mean reading of a position",
    )
    field_deg: Annotated[tuple[Annotated[float, Field(ge=0.5, le=100)], ...], Sorted] = Field(
        default=(3.0, 4.0, 6.0, 8.0, 12.0, 16.0, 20.0, 28.0, 40.0), min_length=2, description="swept full fields"
    )


class TurntableCalibrationConfig(SingleStarConfig):
    """Bench and unknowns of FISHER23, which states no numbers: camera of ACC18, turntable of CUBE09."""

    two_axis: TurntableConfig = Field(default_factory=_two_axes)
    three_axis: TurntableConfig = Field(default_factory=_three_axes)
    reduction: ReductionConfig = ReductionConfig()
    study: StudyConfig = StudyConfig()


rendered = Experiment(
    name="turntable",
    config=TurntableCalibrationConfig,
    run="experiment:run",
    sections="experiment:SECTIONS",
    axes="experiment:axes",
    takes="1 min (--quick: 20 s)",
    examples={
        "--quick": "few poses and runs",
        "--set two_axis.non_orthogonality_arcsec=[20] --set two_axis.reading_noise_arcsec=[0.1]": "more axis lean, "
        "less reading noise",
        "--set reduction.axes=x-y": "wrong sign of the inner axis in the reduction: refused",
    },
    show=("unknowns", "map_error"),
    quick={
        "grid.columns": 9,
        "grid.rows": 9,
        "study.runs": 60,
        "study.sweep_runs": 8,
        "study.reading_noise_arcsec": [0.01, 0.1, 0.3],
        "study.field_deg": [3.0, 6.0, 12.0, 20.0, 40.0],
    },
)
experiment = or_own_frames(rendered)
main = command(experiment)
