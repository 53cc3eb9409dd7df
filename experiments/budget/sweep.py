"""The budget against a parameter, and the sensitivities of all of them, by prediction.

Many settings are predicted, so each is made cheaper than the one of the main table: a target of 3 x 3 points over the
same area, half the positions of the step test on an ideal platform, fewer draws, and the same ones everywhere. The star
mean that eq. 8 removes takes 1/W of an independent error; the pixel term is scaled from W = 9 to the target's own.

Where a spot outgrows the window, the window is widened until it holds the light; the table says to what.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from experiments.budget.combine import Budget, Value, combine
from experiments.budget.laboratory import Laboratory, build_laboratory
from experiments.budget.measure import measure_terms
from experiments.budget.predict import predict_terms
from experiments.budget.settings import Config
from experiments.budget.terms import Measurement, Psfs
from experiments.harness.range import SweepRange, value_at, with_value
from experiments.laboratory.ray_prediction import expected_spots
from experiments.laboratory.target import corner_directions
from optics.arrays import FloatArray
from optics.errors import StarbenchError
from render.detector.spec import load_detector
from render.engine.random import Streams

__all__ = ["Setting", "Sweep", "Swing", "Tornado", "coarse_budget", "predict_sweep", "predict_tornado", "widened"]


POINTS = 3
POSITIONS = 6
DRAWS = 60
WIDEST_PX = 63


@dataclass(frozen=True, slots=True, kw_only=True)
class Setting:
    """One point of a sweep."""

    value: float  # Of the parameter
    window_px: int  # Window that was used
    predicted: Budget | None  # None where the laboratory refuses the setting
    measured: Measurement | None = None  # None where it was not asked for or is refused
    refusal: str = ""  # Why


@dataclass(frozen=True, slots=True, kw_only=True)
class Sweep:
    """The budget at all values of a parameter."""

    key: str
    settings: tuple[Setting, ...]

    def series(self, name: str) -> FloatArray:
        """A term or sum (n, 2) [arcsec, 3 sigma]; NaN where there is none."""
        rows = [np.full(2, np.nan) if one.predicted is None else one.predicted[name].arcsec for one in self.settings]
        return np.stack(rows)


@dataclass(frozen=True, slots=True, kw_only=True)
class Swing:
    """What one parameter does."""

    key: str  # Of the parameter
    label: str  # Of the parameter
    unit: str  # Of the parameter
    low: float  # Its two values
    high: float  # Its two values
    at_low: Budget | None  # None where the setting is refused
    at_high: Budget | None  # None where the setting is refused

    def change(self, name: str, base: Budget) -> FloatArray:
        """Change of a term (2, 2): rows low and high, columns x and y; NaN where refused."""
        nothing = np.full(2, np.nan)
        return np.stack(
            [nothing if b is None else b[name].arcsec - base[name].arcsec for b in (self.at_low, self.at_high)]
        )

    def size(self, base: Budget) -> float:
        """Largest change of the total."""
        found = np.abs(self.change("total", base))
        return float(np.nanmax(found)) if np.isfinite(found).any() else 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Tornado:
    """Sensitivities."""

    base: Budget  # At the configuration itself, predicted in the same way
    swings: tuple[Swing, ...]  # Largest first


def widened(config: Config) -> Config:
    """The configuration with windows that hold the spots of all its tests."""
    lab = build_laboratory(config)
    _, radius, _ = expected_spots(lab.filtered, lab.instrument, corner_directions(config.target, lab.instrument))
    least = int(np.ceil(5.0 * float(np.nanmax(radius))))
    wanted = min(max(config.window_px, least + 1 - least % 2), WIDEST_PX)
    return config if wanted == config.window_px else config.model_copy(update={"window_px": wanted})


def counting(config: Config) -> Config:
    """The configuration with the centroider that counts alone."""
    return config.model_copy(update={"compare": ()})


def _coarse(config: Config) -> tuple[Config, float]:
    """With a 3 x 3 target, and the factor of the pixel term."""
    target = config.target
    if target.rows != target.columns or target.rows <= POINTS:
        return config, 1.0
    # a third of a pixel, so that three points are at three different places of their pixels
    pitch = np.floor(target.pitch_px * (target.rows - 1) / (POINTS - 1)) - 2.0 / 3.0
    few = target.model_copy(update={"rows": POINTS, "columns": POINTS, "pitch_px": float(pitch)})
    factor = np.sqrt((1.0 - 1.0 / target.rows**2) / (1.0 - 1.0 / POINTS**2))
    steps = config.steps.model_copy(update={"positions": min(POSITIONS, config.steps.positions)})
    return config.model_copy(update={"target": few, "steps": steps}), float(factor)


def coarse_budget(config: Config, psfs: Psfs) -> Budget:
    """A budget predicted cheaply (see the module)."""
    from experiments.laboratory.checks import check_light

    few, factor = _coarse(counting(config))
    lab = build_laboratory(few)
    check_light(lab.filtered, lab.instrument, corner_directions(few.target, lab.instrument))
    check_full_well(lab)
    found = predict_terms(lab, psfs=psfs, draws=DRAWS, step_draws=DRAWS, coarse=True)
    budget = found[config.centroid].budget
    hsfe = budget["HSFE"]
    scaled = Value(arcsec=hsfe.arcsec * factor, uncertainty_arcsec=hsfe.uncertainty_arcsec * factor)
    return combine({**budget.term, "HSFE": scaled}, stars=budget.stars)


def check_full_well(lab: Laboratory) -> None:
    """Refuse points that would be saturated: a peak pixel holds about half of a sharp spot."""
    from optics.errors import DomainError

    chip, signal = lab.instrument.detector, lab.signal.signal_e
    top = min(chip.full_well_e, (chip.largest_dn - chip.offset_dn) / chip.gain_dn_per_e)
    _, radius, _ = expected_spots(lab.filtered, lab.instrument, corner_directions(lab.config.target, lab.instrument))
    sigma2 = float(np.nanmin(radius)) ** 2 / 2.0 + chip.diffusion_sigma_px**2 + 1.0 / 12.0
    if signal / (2.0 * np.pi * sigma2 + 1.0) > top:
        raise DomainError(
            f"source: a point of {signal:g} e- saturates its brightest pixel (it holds {top:.0f} e-); "
            "lower source.signal_e (raise source.magnitude_mag) or defocus"
        )


def predict_sweep(
    config: Config,
    sweep: SweepRange,
    psfs: Psfs,
    *,
    advance: Callable[[], None] = lambda: None,
) -> Sweep:
    """The budget at every value; measured too if the configuration asks for it."""
    found = []
    for number, value in enumerate(sweep.values):
        found.append(_setting(config, sweep.key, value, psfs, number))
        advance()
    return Sweep(key=sweep.key, settings=tuple(found))


def _setting(config: Config, key: str, value: float, psfs: Psfs, number: int) -> Setting:
    window = config.window_px
    try:
        changed = widened(with_value(config, key, value))
        window = changed.window_px
        predicted = coarse_budget(changed, psfs)
    except (StarbenchError, ValueError) as error:
        return Setting(value=value, window_px=window, predicted=None, refusal=str(error).splitlines()[0])
    measured, refusal = None, ""
    if config.sweep_measured:
        try:
            streams = Streams(config.seed).child("budget", "sweep").child(f"point {number}")
            measured = measure_terms(build_laboratory(counting(changed)), streams=streams)[config.centroid]
        except StarbenchError as error:
            refusal = str(error).splitlines()[0]
    return Setting(value=value, window_px=window, predicted=predicted, measured=measured, refusal=refusal)


def _parameters(config: Config) -> Sequence[tuple[str, str, str, float, float]]:
    """Key, label, unit, low and high of the parameters of the tornado chart."""
    detector, change, source = load_detector(config.instrument.detector), config.tornado, config.source
    by_star = source.magnitude_mag is not None
    relative = (
        *(() if by_star else (("source.signal_e", "signal", "e⁻", source.default_signal_e),)),
        ("detector.read_noise_e", "read noise", "e⁻", detector.read_noise_e),
        ("detector.prnu", "PRNU", "", detector.prnu),
        ("detector.diffusion_sigma_um", "charge diffusion", "µm", detector.diffusion_sigma_mm * 1e3),
        ("detector.dark_current_e_per_s", "dark current", "e⁻/s", detector.dark_current_e_per_s),
        ("grid.marking_error_arcsec", "target marking error", "″", config.grid.marking_error_arcsec),
        ("hexapod.roll_error_arcsec", "roll of the platform", "″", config.hexapod.roll_error_arcsec),
    )
    moved = f" of {config.moved.element}"
    absolute = (
        *((("source.magnitude_mag", "star", "mag", 2.5 * np.log10(1.0 + change.change_fraction)),) if by_star else ()),
        ("instrument.defocus_mm", "defocus", "mm", change.focus_mm),
        ("instrument.chip_temperature_c", "chip temperature", "°C", change.chip_k),
        ("moved.decentre_x_um", "decentre x" + moved, "µm", change.decentre_um),
        ("moved.decentre_y_um", "decentre y" + moved, "µm", change.decentre_um),
        ("moved.tilt_x_arcmin", "tilt x" + moved, "arcmin", change.tilt_arcmin),
        ("moved.tilt_y_arcmin", "tilt y" + moved, "arcmin", change.tilt_arcmin),
    )
    out = []
    for key, label, unit, default in relative:
        given = value_at(config, key)
        centre = float(default if given is None else given)
        step = change.change_fraction * centre
        out.append((key, label, unit, centre - step, centre + step))
    for key, label, unit, step in absolute:
        centre = float(value_at(config, key))
        out.append((key, label, unit, centre - step, centre + step))
    return [row for row in out if row[3] < row[4] and row[0].replace("magnitude_mag", "signal_e") in change.parameters]


def tornado_size(config: Config) -> int:
    """How many settings `predict_tornado` predicts."""
    return 1 + 2 * len(_parameters(config))


def predict_tornado(config: Config, psfs: Psfs, *, advance: Callable[[], None] = lambda: None) -> Tornado:
    """Every parameter moved down and up by its tolerance, the others as they are."""
    base = coarse_budget(config, psfs)
    advance()
    swings = []
    for key, label, unit, low, high in _parameters(config):
        ends: list[Budget | None] = []
        for value in (low, high):
            try:
                ends.append(coarse_budget(with_value(config, key, value), psfs))
            except (StarbenchError, ValueError):
                ends.append(None)
            advance()
        swings.append(Swing(key=key, label=label, unit=unit, low=low, high=high, at_low=ends[0], at_high=ends[1]))
    return Tornado(base=base, swings=tuple(sorted(swings, key=lambda swing: -swing.size(base))))
