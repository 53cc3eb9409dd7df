"""What has to hold for a chromatic test to count as passed."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.stats import chi2

from experiments.harness.quantities import Outcome
from experiments.harness.summary import Criterion, farthest_from_one
from experiments.laboratory import as_printed
from experiments.laboratory.collimator_effects import chromatic_criteria
from experiments.laboratory.criteria import (
    MOTION_RATIO,
    as_the_paper,
    centroids_on_the_light,
    pixel_angle,
    two_sided_limit,
)
from optics.rays.pupil import stop_in_front

__all__ = ["criteria"]


SIGMA_LIMIT = 3.0
"""With 3 sigma for each of four entries of Table 1, a lens fails by chance once in a hundred seeds."""
SQUARES_FALSE_ALARM = 1e-3
LIGHT_PX = 1e-4
"""Below the standard deviation of an entry of Table 1 of the published run, 1.4e-4 px."""


def criteria(outcome: Outcome) -> list[Criterion]:
    """Both lenses: frames against prediction and light, light against prediction; and the wanted mean shift."""
    found = [
        criterion
        for lens, label in (("centred", "centred lens"), ("moved", "moved element"))
        for criterion in _of_lens(outcome, lens, label)
    ]
    wanted = outcome.config.decentre
    # that frames give it too is part of Table 1 against the ray trace, by which the movement was found
    reached = outcome.value("photon_table1_px", lens="moved", pair=outcome.config.pair, axis=wanted.axis)
    found.append(
        Criterion(
            name=f"moved element: noiseless light of Table 1 against the wanted {wanted.wanted_px:g} px",
            value=abs(reached - wanted.wanted_px),
            limit=_light_limit(outcome),
            unit="px",
        )
    )
    return [*found, _squares(outcome), *_end_to_end(outcome)]


def _light_limit(outcome: Outcome) -> float:
    """What the rendered light may be beside its prediction [px]: Sobol sums where kinks wander do worse."""
    return LIGHT_PX if stop_in_front(outcome.result.instrument.camera.lens) else 10.0 * LIGHT_PX


def _squares(outcome: Outcome) -> Criterion:
    """Squared deviations of the single shifts of both lenses, in units of their predicted variance.

    The two pairs share the reference band, so their deviations are correlated by 1/2: the squares scatter as if there
    were 1 / (1 + 1/4) times as many.
    """
    both = [getattr(outcome.result, lens) for lens in ("centred", "moved")]
    count = sum(one.chi2_n for one in both)
    freedom = count / 1.25
    return Criterion(
        name=f"both lenses: mean of {count} squared deviations of single shifts from the light, over their variance",
        value=sum(one.chi2 * one.chi2_n for one in both) / count,
        about=1.0,
        limit=float(chi2.isf(SQUARES_FALSE_ALARM / 2, freedom)) / freedom - 1.0,
    )


def _end_to_end(outcome: Outcome) -> list[Criterion]:
    """By paths that share no equation with the reduction: a known motion, the printed equations, the light itself."""
    result, filters = outcome.result, outcome.config.filters
    wedge = result.wedged
    pair, sign = wedge.pair
    half = sign * wedge.motion_px / 2.0
    band = f"{filters.centres_nm[wedge.band]:g} nm"
    motion = ", ".join(f"{value:+.3f}" for value in wedge.motion_px)
    found = [
        Criterion(
            name=f"wedge in the {band} filter, image moved by ({motion}) px: Table 1, {pair}, changes by half of it, "
            "ratio",
            value=farthest_from_one(wedge.change_px / half),
            about=1.0,
            limit=MOTION_RATIO + float((two_sided_limit(2) * wedge.sigma_px / 2.0 / np.abs(half)).max()),
        ),
        pixel_angle(result.instrument),
    ]
    stated = outcome.value("pixel_arcsec")
    reported, printed, angles, expected = [], [], [], []
    for lens in ("centred", "moved"):
        measured = getattr(result, lens).measurement
        for method in result.bench.methods:
            table = as_printed.chromatic_px(measured.mean_px[method], filters.centres_nm, filters.reference_nm)
            reported += [outcome.values("method_table1_px", lens=lens, method=method, pair=name) for name in table]
            printed += list(table.values())
            if method == result.bench.methods[0]:
                reported += [outcome.values("table1_px", lens=lens, pair=name) for name in table]
                printed += list(table.values())
                angles.append(outcome.values("lsfe_arcsec", lens=lens))
                expected.append(as_printed.chromatic_arcsec(table, stated))
    found.append(as_the_paper("Table 1 of both lenses", reported, printed, "px"))
    found.append(as_the_paper("chromatic LSFE of both lenses", angles, expected, "arcsec"))
    measured = result.centred.measurement
    still = measured.common_mean_px / np.sqrt(measured.photon_px.shape[0] * measured.photon_px.shape[2])
    if result.collimator is not None:
        found += chromatic_criteria(result.collimator)
    return [*found, *centroids_on_the_light("centred lens, ", measured.mean_px, measured.photon_px, still)]


def _of_lens(outcome: Outcome, lens: str, label: str) -> list[Criterion]:
    apart = outcome.values("photon_shift_px", lens=lens) - outcome.values("predicted_shift_px", lens=lens)
    return [
        Criterion(
            name=f"{label}: Table 1 measured against ray-trace prediction",
            value=_largest_pull(outcome, lens, "predicted_table1_px"),
            limit=SIGMA_LIMIT,
            unit="sigma",
        ),
        Criterion(
            name=f"{label}: largest deviation of a single shift from the noiseless light",
            value=outcome.value("largest_pull", lens=lens),
            limit=two_sided_limit(getattr(outcome.result, lens).chi2_n, 0.01),
            unit="sigma",
        ),
        Criterion(
            name=f"{label}: noiseless light against ray-trace prediction, largest shift",
            value=float(np.abs(apart).max()),
            limit=_light_limit(outcome),
            unit="px",
        ),
    ]


def _largest_pull(outcome: Outcome, lens: str, against: str) -> float:
    """Largest distance of a Table 1 entry from another value, in standard deviations."""
    apart: Any = outcome.values("table1_px", lens=lens) - outcome.values(against, lens=lens)
    return float(np.abs(apart / outcome.errors("table1_px", lens=lens)).max())
