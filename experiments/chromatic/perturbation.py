"""Misalignment (decentre or tilt) of a lens element that gives a required entry of Table 1, solved by ray trace."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from calib.accuracy.chromatic import shifts, table1
from calib.measure.targets.target_points import SEARCH_MARGIN_PX
from experiments.chromatic.settings import ChromaticConfig
from experiments.harness.progress import Progress
from experiments.harness.sections import Section, col
from experiments.laboratory.bench.point_bench import Bench, point_field
from experiments.laboratory.bench.points import bundle_means
from optics.arrays import FloatArray
from optics.errors import ConvergenceError, DomainError
from optics.lens.movement import moved_element, refined_movement, smallest_movement
from optics.lens.system import LensSystem
from render.camera import PathLosses
from render.sensor_file.instrument import Instrument

REFINED_PX = 3e-7
"""Tolerance of the entry of Table 1 with weighted rays [px]."""
LIMIT = {"decentre": 3.0, "tilt": 3.0}
"""Largest movement in the search [mm, deg]."""
UNIT = {"decentre": 1e3, "tilt": 60.0}
"""um per mm, arcmin per deg: `ElementMovement.amount` against the argument of `moved_element`."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ElementMovement:
    """Misalignment of one element that gives the required entry of Table 1; NaN if none within `LIMIT` does."""

    element: str = col("Element")
    movement: str = col("Movement")
    mean_shift_px: FloatArray = col("Mean shift", "px", ".4f", "pair")  # Along `DecentreConfig.axis`
    image_px: float = col("Image shift", "px", "+.0f")
    kind: str = col("Kind", shown=False)
    amount: float = col("Amount", shown=False)
    unit: str = col("Unit", shown=False)
    table1_px: FloatArray = col("Table 1", "px", ".4f", "pair axis", shown=False)
    boresight_px: FloatArray = col("Image shift", "px", ".1f", "axis", shown=False)  # In the reference band

    @property
    def label(self) -> str:
        """Moved element and movement: "L2 decentred +117 µm"."""
        return f"{self.element} {self.movement}"

    def apply(self, lens: LensSystem, axis: int) -> LensSystem:
        """The lens with the element moved by this amount; see `moved_element`."""
        return moved_element(lens, self.element, self.kind, axis, self.amount / UNIT[self.kind])


ELEMENTS = Section(
    record=ElementMovement,
    dim="solution",
    table="elements",
    hidden="solution",
    across="pair",
    caption="Movement of each element that gives the wanted entry of ACC18 Table 1, and the resulting "
    "entries of the other pairs.",
    note="By ray trace, with equal weights except for the rendered movement. Empty: not within 3 mm "
    "or 3 deg. Tilts are about the element's first vertex. Decentres are positive along "
    "increasing column (x) and decreasing row (y).",
)


@dataclass(frozen=True, slots=True, kw_only=True)
class RenderedMovement:
    """The misalignment that is rendered."""

    element: str = col("Element")
    kind: str = col("Movement")
    amount: float = col("Amount")
    unit: str = col("Unit")
    wanted_px: float = col("Wanted entry of Table 1", "px", "g")
    image_px: float = col("Image shift", "px", ".0f")
    image_arcsec: float = col("Image shift", "arcsec", ".0f")


MOVEMENT = Section(record=RenderedMovement)


def solve_rendered_element(
    config: ChromaticConfig, bench: Bench, instrument: Instrument, direction: FloatArray, progress: Progress
) -> tuple[list[ElementMovement], ElementMovement]:
    """Solutions of all elements, and the solution to be rendered: that of the selected element with weighted rays."""
    solutions = solve_all_elements(config, bench, instrument, direction, progress)
    selected = select_element(config, bench, instrument.camera.lens, solutions)
    refined = solve_perturbation(
        bench,
        instrument,
        direction,
        element=selected.element,
        kind=selected.kind,
        pair=config.pair,
        axis="xy".index(config.decentre.axis),
        wanted_px=config.decentre.wanted_px,
    )
    return [refined if solution is selected else solution for solution in solutions], refined


def solve_all_elements(
    config: ChromaticConfig, bench: Bench, instrument: Instrument, direction: FloatArray, progress: Progress
) -> list[ElementMovement]:
    """Every element, decentred and tilted; rays have equal weights, which changes a solution by about 1 %."""
    moves = [(element, kind) for kind in LIMIT for element in instrument.camera.lens.elements]
    return [
        solve_perturbation(
            bench,
            instrument,
            direction,
            element=element,
            kind=kind,
            pair=config.pair,
            axis="xy".index(config.decentre.axis),
            wanted_px=config.decentre.wanted_px,
            weighted=False,
        )
        for element, kind in progress.track(moves, "element movements")
    ]


def solve_perturbation(
    bench: Bench,
    instrument: Instrument,
    direction: FloatArray,
    *,
    element: str,
    kind: str,
    pair: str,
    axis: int,
    wanted_px: float,
    weighted: bool = True,
) -> ElementMovement:
    """Misalignment of one element for which the entry of one pair of bands is ``wanted_px``.

    ``weighted``: rays are weighted by the transmission along their path, which takes seconds in place of tenths.
    """
    lens = instrument.camera.lens
    stars = point_field(bench, instrument, direction.reshape(-1, 3))

    def mean_positions_px(amount: float, losses: PathLosses | None) -> FloatArray:
        moved = moved_element(lens, element, kind, axis, amount)
        mean_px = bundle_means(replace(instrument.camera, lens=moved, losses=losses), stars)
        return mean_px.reshape(*direction.shape[:2], len(bench.filters), 2)

    def excess(amount: float, losses: PathLosses | None = None) -> float:
        return float(table1(shifts(mean_positions_px(amount, losses), bench.pairs)[pair])[axis]) - wanted_px

    weights = instrument.camera.losses if weighted else None
    centred_px = mean_positions_px(0.0, weights)
    amount = smallest_movement(excess, LIMIT[kind])
    if np.isfinite(amount) and weights is not None:
        amount = refined_movement(partial(excess, losses=weights), excess, amount, REFINED_PX)
    moved_px = mean_positions_px(amount, weights) if np.isfinite(amount) else np.full_like(centred_px, np.nan)
    entries = np.array([table1(shift) for shift in shifts(moved_px, bench.pairs).values()])
    boresight = (moved_px - centred_px)[:, :, bench.reference].mean((0, 1))
    amount_text = f"{amount * 1e3:+.0f} µm" if kind == "decentre" else f"{amount * 60.0:+.1f} arcmin"
    amount_text = amount_text.replace("-", "\N{MINUS SIGN}")
    verb = {"decentre": "decentred", "tilt": "tilted"}[kind]
    return ElementMovement(
        element=element,
        kind=kind,
        movement=f"{verb} {amount_text}" if np.isfinite(amount) else f"{verb}: not within reach",
        amount=amount * UNIT[kind],
        unit={"decentre": "um", "tilt": "arcmin"}[kind],
        table1_px=entries,
        mean_shift_px=entries[:, axis],
        boresight_px=boresight,
        image_px=float(boresight[axis]),
    )


def select_element(
    config: ChromaticConfig, bench: Bench, lens: LensSystem, solutions: Sequence[ElementMovement]
) -> ElementMovement:
    """The configured element, or the one with the smallest misalignment of the configured kind.

    Raises
    ------
    ConvergenceError
        If no element gives the required entry within `LIMIT`.
    DomainError
        If the image shifts by more than the search for the target points can follow.
    """
    required = config.decentre
    candidates = [
        solution
        for solution in solutions
        if solution.kind == required.kind
        and required.element in ("auto", solution.element)
        and np.isfinite(solution.amount)
    ]
    if not candidates:
        subject = "any element" if required.element == "auto" else f"element {required.element}"
        limit = "3 mm" if required.kind == "decentre" else "3 deg"
        if not lens.glasses:
            raise ConvergenceError(
                f"lens {lens.name!r} has no glass, hence no chromatic shift: no movement gives a mean shift of "
                f"decentre.wanted_px = {required.wanted_px:g} px; set decentre.wanted_px = 0"
            )
        raise ConvergenceError(
            f"no {required.kind} of {subject} up to {limit} gives a mean shift of decentre.wanted_px = "
            f"{required.wanted_px:g} px in {config.pair}, {required.axis}; lower it, or choose another "
            "decentre.element or decentre.kind"
        )
    selected = min(candidates, key=lambda solution: abs(solution.amount))
    shift_px = float(np.abs(selected.boresight_px).max())
    margin_px = min(float(SEARCH_MARGIN_PX), bench.target.edge_px - bench.window_px // 2 - 1)
    if shift_px > margin_px:
        raise DomainError(
            f"a mean shift of decentre.wanted_px = {required.wanted_px:g} px needs a {selected.kind} of "
            f"{selected.element} by {selected.amount:.0f} {selected.unit}, which moves the whole image by "
            f"{shift_px:.0f} px; at most {margin_px:.0f} px can be followed (target.edge_px = "
            f"{bench.target.edge_px:g} px, and {SEARCH_MARGIN_PX} px in any case): "
            "lower decentre.wanted_px or name another decentre.element"
        )
    return selected
