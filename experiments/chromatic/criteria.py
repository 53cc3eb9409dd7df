"""What has to hold for a chromatic test to count as passed."""

from __future__ import annotations

from typing import Any

import numpy as np

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
"""With 3 sigma for each of eight entries of Table 1, one seed in fifty fails by chance."""


def criteria(outcome: Outcome) -> list[Criterion]:
    """Both lenses: frames against light, light against rays and prediction; and the wanted mean shift."""
    found = [
        criterion
        for lens, label in (("centred", "centred lens"), ("moved", "moved element"))
        for criterion in _of_lens(outcome, lens, label)
    ]
    wanted = outcome.config.decentre
    reached = outcome.value("table1_px", lens="moved", pair=outcome.config.pair, axis=wanted.axis)
    found.append(
        Criterion(
            name=f"moved element: the wanted {wanted.wanted_px:g} px is measured",
            value=abs(reached.value - wanted.wanted_px) / reached.uncertainty,
            limit=SIGMA_LIMIT,
            unit="sigma",
        )
    )
    return [*found, *_end_to_end(outcome)]


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
    evaluation = getattr(outcome.result, lens)
    photon, bundle = evaluation.measurement.photon_px, evaluation.measurement.bundle_px
    light = [
        Criterion(
            name=f"{label}: light on the detector, before pixels, against the traced bundle",
            value=float(np.nanmax(np.abs(photon - bundle))),
            limit=1e-4,
            unit="px",
        )
    ]
    apart = outcome.values("photon_shift_px", lens=lens) - outcome.values("predicted_shift_px", lens=lens)
    light.append(
        Criterion(
            name=f"{label}: noiseless light against ray-trace prediction, largest shift",
            value=float(np.abs(apart).max()),
            limit=1e-4
            if stop_in_front(outcome.result.instrument.camera.lens)
            else 1e-3,  # Sobol sums where kinks wander
            unit="px",
        )
    )
    return [
        Criterion(
            name=f"{label}: Table 1 measured against noiseless photon centroid",
            value=_largest_pull(outcome, lens, "photon_table1_px"),
            limit=SIGMA_LIMIT,
            unit="sigma",
        ),
        Criterion(
            name=f"{label}: Table 1 measured against ray-trace prediction",
            value=_largest_pull(outcome, lens, "predicted_table1_px"),
            limit=SIGMA_LIMIT,
            unit="sigma",
        ),
        Criterion(
            name=f"{label}: largest deviation of a single shift from the noiseless light",
            value=outcome.value("largest_pull", lens=lens),
            limit=two_sided_limit(evaluation.chi2_n, 0.01),
            unit="sigma",
        ),
        Criterion(
            name=f"{label}: mean squared deviation over its variance",
            value=outcome.value("mean_squared_pull", lens=lens),
            about=1.0,
            # the two pairs share the reference band, so their pulls are correlated by 1/2
            limit=4.0 * float(np.sqrt(2.5 / evaluation.chi2_n)),
        ),
        *light,
    ]


def _largest_pull(outcome: Outcome, lens: str, against: str) -> float:
    """Largest distance of a Table 1 entry from another value, in standard deviations."""
    apart: Any = outcome.values("table1_px", lens=lens) - outcome.values(against, lens=lens)
    return float(np.abs(apart / outcome.errors("table1_px", lens=lens)).max())
