"""What has to hold for a run of the cube-mirror experiment to count as passed."""

from __future__ import annotations

import numpy as np

from experiments.cube.budget import DETECTOR_RELATIVE, SENSOR_RELATIVE, BudgetRow, face_angles_deg
from experiments.cube.result import Result, offset_errors_px
from experiments.harness.quantities import Outcome
from experiments.harness.summary import Criterion

__all__ = ["criteria"]

CHECK_DEG = 90.0121
"""Angle between the faces that the angles of Table 1 give with the corrected eq. 8."""

RATIO_LIMIT = 0.15
MANY = 100
CHANCE_SIGMAS = 3.29
"""0.1 %, two-sided."""
WRITTEN_OUT_ARCSEC = 0.02
"""First order of rotation vectors of 0.01 rad."""
DIFFERENCES = 1e-4
OFFSET_SIGMAS = 3.0
"""Room for the shown bench's offsets, in scatters of a picture with the particles of the Monte-Carlo; it has more."""


def ratio_limit(row: BudgetRow) -> float:
    """15 %; with fewer than a hundred benches three standard deviations of the sample, if that is more."""
    chance = row.ratio / float(np.sqrt(2 * row.benches * row.acts.sum()))  # independent draws: not too small
    return RATIO_LIMIT if row.benches >= MANY else max(RATIO_LIMIT, 3 * chance)


def few(row: BudgetRow) -> float:
    """Room for the scatter of a standard deviation from few benches; 1 from a hundred on."""
    return 1.0 if row.benches >= MANY else 1.0 + 3.0 / float(np.sqrt(2 * row.benches))


def _widened(limit: float, asked: float, benches: int) -> str:
    """Says in the name of a criterion that its limit is not what is asked."""
    return "" if limit <= asked else f"; limit widened from {asked:g}, only {benches} benches"


def _independent(outcome: Outcome) -> list[Criterion]:
    """By written-out equations, by differences, and noise against what detector and light predict."""
    sensor, count = outcome.value("r_sr_error_over_predicted"), outcome.result.repeatability.pictures
    made = [
        Criterion(
            name=f"scatter of the offset by the detector, {count} pictures of one light, over its prediction, {name}",
            value=float(ratio),
            about=1.0,
            limit=DETECTOR_RELATIVE + CHANCE_SIGMAS * float(error),
        )
        for name, ratio, error in zip(
            ("aperture and spot apart", "both from one"),
            outcome.values("detector_noise_ratio"),
            outcome.errors("detector_noise_ratio"),
            strict=True,
        )
    ]
    off = float(outcome.values("written_out_off_arcsec"))
    if np.isfinite(off):
        name = "R_sp of the shown bench, written out from readings and spots, against that found"
        made.append(Criterion(name=name, value=off, limit=WRITTEN_OUT_ARCSEC, unit="arcsec"))
    return [
        *made,
        Criterion(
            name="errors of R_sr over what the noise of the spots predicts, RMS",
            value=sensor.value,
            about=1.0,
            limit=SENSOR_RELATIVE + CHANCE_SIGMAS * float(sensor.uncertainty or 0.0),
        ),
        Criterion(
            name="what uneven readings of outer and inner axis do, the budget's term against differences",
            value=float(outcome.values("reading_off")),
            limit=DIFFERENCES,
        ),
        Criterion(
            name="covariance of R_sp of a cube and a sensor that stand askew, against differences",
            value=float(outcome.values("covariance_off")),
            limit=DIFFERENCES,
        ),
    ]


def criteria(outcome: Outcome) -> list[Criterion]:
    """Light against closed forms, offsets against the truth, prediction against measurement, the document's claim."""
    result: Result = outcome.result
    found = [
        Criterion(
            name="offsets measured on the shown bench against the true ones, worst",
            value=float(np.max(np.abs(offset_errors_px(result)))),
            limit=OFFSET_SIGMAS * result.repeatability.own_px,
            unit="px",
        ),
        Criterion(
            name="faces of Table 1 by the corrected eq. 8 against 90.0121 deg",
            value=abs(face_angles_deg()[0] - CHECK_DEG),
            limit=5.1e-5,
            unit="deg",
        ),
        Criterion(
            name="rendered displacement against 2 x tilt x distance",
            value=result.light.worst_displacement_um,
            limit=0.1,
            unit="um",
        ),
        Criterion(
            name="rendered edge of the spot against the closed form, part of full brightness",
            value=result.light.worst_profile,
            limit=0.02,
        ),
    ]
    found += _independent(outcome)
    for row in result.budget:
        found.append(
            Criterion(
                name=f"predicted / measured − 1, {row.label}{_widened(ratio_limit(row), RATIO_LIMIT, row.benches)}",
                value=abs(row.ratio - 1.0),
                limit=ratio_limit(row),
            )
        )
    for name in ("all", "procedure"):
        row = result.row(name)
        found.append(
            Criterion(
                name=f"R_sp, {row.label}, worst axis (CUBE09: better than 4 arcsec"
                f"{_widened(4.0 * few(row), 4.0, row.benches)})",
                value=float(row.measured_arcsec.max()),
                limit=4.0 * few(row),
                unit="arcsec",
                relation="<",
            )
        )
    improved = result.row("improved")
    found.append(
        Criterion(
            name=f"R_sp, the same pictures reduced better, worst axis{_widened(few(improved), 1.0, improved.benches)}",
            value=float(improved.measured_arcsec.max()),
            limit=few(improved),
            unit="arcsec",
            relation="<",
        )
    )
    return found
