"""Manufactured lenses: Monte-Carlo over decentre, tilt and despace of every element, by ray trace.

For every lens the document's chromatic statistic (eq. 16, over the target in four corners) and the distortion over the
field follow from traced bundle means. Distortion is stated twice: the residual after a cubic polynomial for each lens
(ACC18 eq. 19), and the error of the design's map after a common shift and roll (elements that moved after the
calibration).

The linear prediction of the chromatic entries adds the sensitivities of all movements, each traced once, in quadrature.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from experiments.budget.laboratory import Laboratory
from experiments.budget.settings import ToleranceConfig
from experiments.harness.drawings import maps
from experiments.harness.quantities import Quantities
from experiments.harness.sections import Section, col
from experiments.laboratory.bench import point_field
from experiments.laboratory.chromatic_error import shifts, table1
from experiments.laboratory.target import corner_directions
from optics.arrays import FloatArray
from optics.errors import ConvergenceError, DomainError
from optics.lens.perturb import decentre, despace, tilt
from optics.lens.system import LensSystem
from optics.units import UM_MM
from render.engine.random import Streams
from render.tracing.tracer import Tracer

MOVES = ("decentre x", "decentre y", "tilt x", "tilt y", "despace")
GRID = (9, 5)
"""Field points of the distortion, columns x rows."""
EDGE_PX = 60.0


BUILT = {
    "chromatic_arcsec_3sigma": "LSFE-S, chromatic",
    "distortion_residual_arcsec_3sigma": "distortion, calibrated",
    "lsfe_arcsec_3sigma": "both",
    "uncalibrated_arcsec_3sigma": "distortion, moved after calibration",
}
"""Errors of a built lens: ACC18's chromatic term (largest entry of Table 1); three times the RMS residual of a cubic
polynomial fitted to that very lens; both; three times the RMS change of the map against the design, mean shift and roll
removed."""
PERCENT = (50, 90, 95, 99)


@dataclass(frozen=True, slots=True, kw_only=True)
class Built:
    """Manufactured lenses, 3 sigma."""

    elements: tuple[str, ...]  # Names along ``element``
    lenses: int = col("Lenses")
    lost: int = col("Lenses left out")  # No light, or the image moved beyond the limit
    design_arcsec: FloatArray = col("Design", "arcsec", ".3f", "built_error axis", json="")
    built_arcsec: FloatArray = col(
        "Below", "arcsec", ".3f", "built_error percentile axis", json="[built_error]", key="p{percentile}_arcsec"
    )
    signed_arcsec: FloatArray = col("Entry of Table 1", "arcsec", dims="lens pair axis", json="")
    nominal_arcsec: FloatArray = col("Entry of the nominal lens", "arcsec", dims="pair axis", json="")
    # Scatter of the signed entries by the sum of squares of the sensitivities
    linear_arcsec: FloatArray = col("Scatter, linear", "arcsec", ".3f", "pair axis", json="")
    sensitivity_arcsec: FloatArray = col("Chromatic term per 1σ", "arcsec", ".3f", "element movement", json="")
    largest_cause: str = col("Largest cause", json="")


@dataclass(frozen=True, slots=True)
class _Traced:
    """What is read from one lens."""

    signed_px: FloatArray  # (p, 2)
    map_px: FloatArray  # (g, 2) displacement from the ideal image


class _Probe:
    """Traces perturbed copies of a lens at the same stars."""

    def __init__(self, lab: Laboratory) -> None:
        self.lab, self.instrument = lab, lab.instrument
        camera = self.instrument.camera
        self.corners = corner_directions(lab.filtered.target, self.instrument)
        x = np.linspace(EDGE_PX, camera.width_px - 1 - EDGE_PX, GRID[0])
        y = np.linspace(EDGE_PX, camera.height_px - 1 - EDGE_PX, GRID[1])
        self.grid_px = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
        grid = camera.nominal_direction(self.grid_px[:, 0], self.grid_px[:, 1], self.instrument.focal_length_mm)
        stars = np.concatenate([self.corners.reshape(-1, 3), grid])
        self.stars = point_field(lab.filtered, self.instrument, stars)
        self.pairs = lab.filtered.pairs

    def trace(self, lens: LensSystem) -> _Traced:
        # rays weigh alike: their transmission changes the entries of Table 1 by 1 %, and takes ten times as long
        camera = replace(self.instrument.camera, lens=lens, losses=None)
        mean = Tracer(camera, general=True).bundle_means(self.stars, rings=4, arms=12)
        split = self.corners.shape[0] * self.corners.shape[1]
        place = mean[:split].reshape(*self.corners.shape[:2], *mean.shape[1:])
        signed = np.stack([table1(v) for v in shifts(place, self.pairs).values()])
        return _Traced(signed, mean[split:, self.lab.filtered.reference] - self.grid_px)


def tolerance_study(lab: Laboratory, streams: Streams, *, advance: Callable[[], None] = lambda: None) -> Built:
    """Build lenses with the tolerances of the configuration and trace them.

    Raises
    ------
    DomainError
        If fewer than two lenses can be used.
    """
    config, lens = lab.config.tolerances, lab.instrument.camera.lens
    probe, scale = _Probe(lab), lab.instrument.pixel_arcsec
    design, basis, rigid = probe.trace(lens), cubic_basis(probe.grid_px), _rigid_basis(probe.grid_px)
    amounts = streams.generator("built lenses").standard_normal((config.draws, len(lens.elements), len(MOVES)))
    signed, left, moved = [], [], []
    for draw in amounts:
        traced = _try(probe, built(lens, config, draw))
        advance()
        if traced is None or not np.abs((traced.map_px - design.map_px).mean(0)).max() <= config.limit_px:
            continue
        signed.append(traced.signed_px)
        left.append(_fitted(basis, traced.map_px))
        moved.append(_fitted(rigid, traced.map_px - design.map_px))
    if len(signed) < 2:
        raise DomainError(
            f"{len(signed)} of {config.draws} lenses can be used (light lost, or the image moved by more than "
            f"tolerances.limit_px = {config.limit_px:g} px); lower tolerances.decentre_um, tilt_arcmin or despace_um"
        )
    entries, sensitivity = np.stack(signed) * scale, _sensitivities(probe, lens, config, design) * scale
    chromatic, distortion, after = np.abs(entries).max(1), 3.0 * scale * np.stack(left), 3.0 * scale * np.stack(moved)
    errors = (chromatic, distortion, np.hypot(chromatic, distortion), after)
    of_design = np.abs(design.signed_px).max(0) * scale, 3.0 * scale * _fitted(basis, design.map_px)
    square = sensitivity**2
    element, movement = np.unravel_index(int(square.sum(3).max(2).argmax()), square.shape[:2])
    return Built(
        elements=lens.elements,
        lenses=len(entries),
        lost=config.draws - len(entries),
        design_arcsec=np.array([*of_design, np.hypot(*of_design), np.zeros(2)]),
        built_arcsec=np.array([np.percentile(values, PERCENT, axis=0) for values in errors]),
        signed_arcsec=entries,
        nominal_arcsec=design.signed_px * scale,
        linear_arcsec=np.sqrt(square.sum((0, 1))),
        sensitivity_arcsec=np.sqrt(square.sum(3).max(2)),
        largest_cause=f"{MOVES[movement]} of {lens.elements[element]}",
    )


def built(lens: LensSystem, config: ToleranceConfig, amounts: FloatArray) -> LensSystem:
    """The lens with every element moved."""
    for element, (dx, dy, tx, ty, dz) in zip(lens.elements, amounts, strict=True):
        size = config.tilt_arcmin / 60.0
        lens = tilt(lens, element, float(tx) * size, float(ty) * size)
        lens = decentre(lens, element, float(dx) * config.decentre_um * UM_MM, float(dy) * config.decentre_um * UM_MM)
        lens = despace(lens, element, float(dz) * config.despace_um * UM_MM)
    return lens


def _try(probe: _Probe, lens: LensSystem) -> _Traced | None:
    """Trace, or None where no light gets through."""
    try:
        found = probe.trace(lens)
    except (ConvergenceError, DomainError):
        return None
    return found if np.isfinite(found.signed_px).all() and np.isfinite(found.map_px).all() else None


def _sensitivities(probe: _Probe, lens: LensSystem, config: ToleranceConfig, design: _Traced) -> FloatArray:
    """Change of the signed entries (e, 5, p, 2) [px] by one standard deviation; central differences."""
    out = np.zeros((len(lens.elements), len(MOVES), *design.signed_px.shape))
    for e in range(len(lens.elements)):
        for m in range(len(MOVES)):
            step = np.zeros((len(lens.elements), len(MOVES)))
            step[e, m] = 1.0
            up, down = (probe.trace(built(lens, config, sign * step)).signed_px for sign in (1.0, -1.0))
            out[e, m] = (up - down) / 2.0
    return out


def cubic_basis(place_px: FloatArray) -> FloatArray:
    """Values (n, 10) of the monomials up to the third degree (ACC18 eq. 19), coordinates scaled to -1 ... 1."""
    low, high = place_px.min(0), place_px.max(0)
    x, y = ((2.0 * place_px - low - high) / (high - low)).T
    return np.stack([x**i * y**j for i in range(4) for j in range(4 - i)], axis=1)


def _rigid_basis(place_px: FloatArray) -> FloatArray:
    """Shift and roll: (n, 2, 3)."""
    centred = place_px - place_px.mean(0)
    out = np.zeros((len(place_px), 2, 3))
    out[:, 0, 0] = out[:, 1, 1] = 1.0
    out[:, 0, 2], out[:, 1, 2] = -centred[:, 1], centred[:, 0]
    return out


def _fitted(basis: FloatArray, shift_px: FloatArray) -> FloatArray:
    """RMS (2,) of what a least-squares fit leaves; free parameters are counted."""
    if basis.ndim == 2:
        left = shift_px - basis @ np.linalg.lstsq(basis, shift_px, rcond=None)[0]
        free = len(basis) - basis.shape[1]
        return np.asarray(np.sqrt((left**2).sum(0) / free))
    design, data = basis.reshape(-1, basis.shape[2]), shift_px.ravel()
    left = (data - design @ np.linalg.lstsq(design, data, rcond=None)[0]).reshape(shift_px.shape)
    return np.asarray(np.sqrt((left**2).mean(0)))


def _axes(q: Quantities, study: Built) -> None:
    q.axis("built_error", list(BUILT), "Error", key="error", names=list(BUILT.values()))
    q.axis("percentile", [str(p) for p in PERCENT], "Share of the lenses", names=[f"{p} %" for p in PERCENT])
    q.axis("element", list(study.elements), "Element")
    q.axis("movement", list(MOVES), "Movement")


TOLERANCES = Section(
    record=Built,
    place="tolerances",
    axes=_axes,
    table="tolerances",
    rows="built_error axis",
    across="percentile",
    columns="design_arcsec built_arcsec",
    caption="Manufactured lenses: error not exceeded by the stated fraction of lenses, 3 sigma.",
    note="Chromatic: centroid of all light, by ray trace.",
    figures={"element_map": maps("sensitivity_arcsec", width="half", aspect_ratio=0.75)},
)
