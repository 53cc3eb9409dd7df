"""Sensitivities: the predicted total when one parameter moves to either end of its tolerance."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from experiments.budget.predict import coarse_terms
from experiments.budget.settings import Config
from experiments.harness.drawings import bars
from experiments.harness.quantities import Quantities
from experiments.harness.range import value_at, with_value
from experiments.harness.sections import Section, col
from optics.arrays import FloatArray
from optics.errors import StarbenchError
from render.detector.spec import load_detector


@dataclass(frozen=True, slots=True, kw_only=True)
class Swing:
    """What one parameter does."""

    label: str  # What readers see along the axis
    key: str = col("Key")
    low: float = col("Low", format=".5g")
    high: float = col("High", format=".5g")
    total_change_arcsec: FloatArray = col("Change", "arcsec", "+.4f", "end axis", key="{axis}_{end}_arcsec")

    @property
    def size(self) -> float:
        """Largest change of the total; 0 where both ends are refused."""
        found = np.abs(self.total_change_arcsec)
        return float(np.nanmax(found)) if np.isfinite(found).any() else 0.0


def parameters(config: Config) -> Sequence[tuple[str, str, float, float]]:
    """Key, label, low and high of the parameters of the chart."""
    detector, change, source = load_detector(config.instrument.detector), config.tornado, config.source
    by_star, moved = source.magnitude_mag is not None, f" of {config.moved.element}"
    relative = (
        *(() if by_star else (("source.signal_e", "signal [e⁻]", source.default_signal_e),)),
        ("detector.read_noise_e", "read noise [e⁻]", detector.read_noise_e),
        ("detector.prnu", "PRNU", detector.prnu),
        ("detector.diffusion_sigma_um", "charge diffusion [µm]", detector.diffusion_sigma_mm * 1e3),
        ("detector.dark_current_e_per_s", "dark current [e⁻/s]", detector.dark_current_e_per_s),
        ("grid.marking_error_arcsec", "target marking error [″]", config.grid.marking_error_arcsec),
        ("hexapod.roll_error_arcsec", "roll of the platform [″]", config.hexapod.roll_error_arcsec),
    )
    absolute = (
        *((("source.magnitude_mag", "star [mag]", 2.5 * np.log10(1.0 + change.change_fraction)),) if by_star else ()),
        ("instrument.defocus_mm", "defocus [mm]", change.focus_mm),
        ("instrument.chip_temperature_c", "chip temperature [°C]", change.chip_k),
        ("moved.decentre_x_um", f"decentre x{moved} [µm]", change.decentre_um),
        ("moved.decentre_y_um", f"decentre y{moved} [µm]", change.decentre_um),
        ("moved.tilt_x_arcmin", f"tilt x{moved} [arcmin]", change.tilt_arcmin),
        ("moved.tilt_y_arcmin", f"tilt y{moved} [arcmin]", change.tilt_arcmin),
    )
    rows = []
    for key, label, default in relative:
        given = value_at(config, key)
        centre = float(default if given is None else given)
        rows.append((key, label, centre, change.change_fraction * centre))
    rows += [(key, label, float(value_at(config, key)), step) for key, label, step in absolute]
    wanted = [row for row in rows if row[0].replace("magnitude_mag", "signal_e") in change.parameters and row[3] > 0]
    return [(key, label, centre - step, centre + step) for key, label, centre, step in wanted]


def tornado(config: Config, *, advance: Callable[[], None] = lambda: None) -> list[Swing]:
    """Every parameter moved down and up by its tolerance, the others as they are; the largest change first."""

    def total(key: str, value: float) -> FloatArray:
        try:
            found = coarse_terms(with_value(config, key, value)).budget.total.arcsec
        except (StarbenchError, ValueError):
            found = np.full(2, np.nan)  # Refused
        advance()
        return found

    here = coarse_terms(config).budget.total.arcsec
    advance()
    swings = []
    for key, label, low, high in parameters(config):
        change = np.stack([total(key, value) - here for value in (low, high)])
        swings.append(Swing(label=label, key=key, low=low, high=high, total_change_arcsec=change))
    return sorted(swings, key=lambda swing: -swing.size)


def _axes(q: Quantities, swings: Sequence[Swing]) -> None:
    q.axis("swing", np.arange(len(swings)) + 1, "Parameter", key="parameter", names=[one.label for one in swings])
    q.axis("end", ["low", "high"], "End", names=["parameter lower", "parameter higher"])


TORNADO = Section(
    record=Swing,
    dim="swing",
    prefix="swing_",
    place="tornado[swing]",
    axes=_axes,
    table="tornado",
    rows="swing",
    across="axis end",
    caption="Change of the predicted total, 3 sigma, when one parameter moves by its tolerance.",
    figures={
        "tornado_chart": bars("swing", bars="swing_total_change_arcsec", by="end", panels="axis", aspect_ratio=0.6)
    },
)
