"""What can be refused of a configuration before anything is rendered."""

from __future__ import annotations

from experiments.fisher.acquire import motion_of, smear_px
from experiments.fisher.settings import Config
from experiments.laboratory.instrument import Instrument
from experiments.laboratory.single_star.reduce import check_count
from experiments.laboratory.single_star.settings import GridConfig
from experiments.laboratory.single_star.setup import build_star, build_table, camera_under_test, check_table, grid_px
from optics.arrays import FloatArray
from optics.errors import ConfigError, DomainError

__all__ = ["check_config", "evaluation_px"]


LONGEST_SMEAR_PX = 40.0


def check_config(config: Config) -> Instrument:
    """The camera; whatever can be refused without rendering is refused here."""
    axes = len(build_table(config.table).axis)
    check_table("table", config.table, axes)
    if axes == 3 and len({round(roll % 360.0, 6) for roll in config.table.rolls_deg}) < 2:
        raise ConfigError(
            f"table.rolls_deg = {list(config.table.rolls_deg)}: a third axis that does not move says nothing about its "
            "angle to the second; give at least two angles, or take two axes"
        )
    check_count(config.grid.columns * config.grid.rows, build_table(config.table))
    instrument = camera_under_test(config)
    grid_px(config, instrument)
    evaluation_px(config, instrument)
    build_star(config, instrument)
    motion = motion_of(config.dynamic.rate_deg_per_s, config.dynamic.jitter_ms, config.dynamic.samples)
    if (smear := smear_px(motion, instrument)) > LONGEST_SMEAR_PX:
        raise ConfigError(
            f"dynamic.rate_deg_per_s = {config.dynamic.rate_deg_per_s:g} deg/s smears the image over {smear:.0f} px in "
            f"{config.instrument.exposure_s:g} s; at most {LONGEST_SMEAR_PX:g} px: lower it or instrument.exposure_s"
        )
    if config.dynamic.samples < smear:
        raise ConfigError(
            f"dynamic.samples = {config.dynamic.samples} for a streak of {smear:.1f} px; at least one per "
            "pixel is needed"
        )
    return instrument


def evaluation_px(config: Config, instrument: Instrument) -> FloatArray:
    """Places (n, 2) of the evaluation; checked like those of the calibration."""
    chosen = config.evaluation
    grid = GridConfig(columns=chosen.columns, rows=chosen.rows, edge_px=chosen.edge_px)
    try:
        check_count(chosen.columns * chosen.rows, build_table(config.table))
        return grid_px(config.model_copy(update={"grid": grid}), instrument)
    except DomainError as error:
        raise DomainError(str(error).replace("grid.", "evaluation.")) from None
