"""Attitude from N stars by Monte-Carlo through the estimator, against the rule total / sqrt(N) (ACC18 section 2.4).

Stars are uniform over the detector. Temporal and pixel errors are independent from star to star. The low-frequency
error has three interpretations:

* independent from star to star, as dividing the *total* by sqrt(N) assumes;
* as it is: the chromatic part moves all stars alike (eq. 16 is a mean over the field), the distortion part is a smooth
  map, here a random cubic polynomial over the field in every trial;
* common: all of it moves all stars alike.

Pointing errors are displacements of the boresight along x and y (a turn about y displaces along x), and roll about the
boresight. The attitude of the measured budget is solved from stars with the measured errors, without the rule ``total /
sqrt(N)``. The expected attitude error of a field follows in closed form from its star positions (`_expected2`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from calib.accuracy.error_budget import ErrorBudget, ErrorTerm, over_stars
from calib.attitude.solve import solve_wahba_many
from experiments.budget.settings import AttitudeConfig
from experiments.harness.drawings import curves
from experiments.harness.quantities import Quantities
from experiments.harness.sections import Section, agree, col
from experiments.harness.summary import Measured, measured
from optics.arrays import FloatArray
from optics.attitude import attitude_error_arcsec
from optics.units import ARCSEC_RAD
from render.engine.random import Streams
from render.sensor_file.instrument import Instrument

READINGS = {
    "independent": "LSFE independent",
    "as it is": "chromatic LSFE common, distortion smooth",
    "common": "LSFE common",
}
FAR_FROM_THE_AXIS = 0.1
"""Part by which angles and their tangents may differ in a wide field."""
DEGREE = 3
"""Of the smooth map: the polynomial of ACC18 eq. 19 is cubic."""


@dataclass(frozen=True, slots=True, kw_only=True)
class StarErrors:
    """Errors of one star, 3 sigma (2,) [arcsec]."""

    random_arcsec: FloatArray  # (2,) Temporal and pixel error
    chromatic_arcsec: FloatArray  # (2,) Low-frequency error
    distortion_arcsec: FloatArray  # (2,)

    @classmethod
    def of(cls, budget: ErrorBudget) -> StarErrors:
        """Split of a budget; the total is the same."""
        return cls(
            random_arcsec=np.hypot(budget["TE"].arcsec, budget["HSFE"].arcsec),
            chromatic_arcsec=np.array(budget["LSFE-S"].arcsec),
            distortion_arcsec=budget["LSFE-C1"].arcsec + budget["LSFE-C2"].arcsec,
        )

    @property
    def total_arcsec(self) -> FloatArray:
        """Root sum of squares (2,)."""
        return np.sqrt(self.random_arcsec**2 + self.chromatic_arcsec**2 + self.distortion_arcsec**2)


@dataclass(frozen=True, slots=True, kw_only=True)
class Attitude:
    """The study, 3 sigma; components are x, y (displacement of the boresight) and roll."""

    stars: int = col("Stars")  # N of the budget
    trials: int = col("Trials")  # Fields of stars per number
    failed: int = col("Trials without an attitude", json="")
    # Total / sqrt(N); for roll divided by the RMS distance of a star from the middle of the field, in radians
    rule_arcsec: FloatArray = col("Rule", "arcsec", ".3f", "component", json="rule_arcsec_3sigma")
    relative_uncertainty: float = col("Uncertainty")  # Of every error: a standard deviation from so many trials
    # Errors in units of what the rule makes of each trial's stars, root mean square: the shift of their mean by
    # ``total / sqrt(N)``, carried to the boresight by the roll that they leave
    over_expected: Sequence[Measured] = col("Error / rule for the same stars", dims="component", json="over_expected")


@dataclass(frozen=True, slots=True, kw_only=True)
class Errors:
    """Attitude error at N of the budget, by reading of the low-frequency error."""

    arcsec: FloatArray = col("Attitude error", "arcsec", ".3f", "component", key="{component}_arcsec")
    over_rule: FloatArray = col("Error / rule", "", ".2f", "component", json="", key="{component}_ratio")


@dataclass(frozen=True, slots=True, kw_only=True)
class Number:
    """Attitude errors from a number of stars."""

    stars: int = col("Stars", json="", key="stars")
    arcsec: FloatArray = col(
        "Attitude error, 3σ", "arcsec", ".4g", "reading component", json="", key="{reading}_{component}_arcsec"
    )
    rule_arcsec: FloatArray = col("Rule 1/√N", "arcsec", ".4g", "component", json="", key="rule_{component}_arcsec")
    # Root mean variance that the estimator states for independent errors
    stated_arcsec: FloatArray = col(
        "Stated by the estimator", "arcsec", ".4g", "component", json="", key="stated_{component}_arcsec"
    )


@dataclass(frozen=True, slots=True)
class _Field:
    """The detector as a field of stars."""

    half_rad: FloatArray  # (2,) half width and half height as tangents

    @classmethod
    def of(cls, instrument: Instrument) -> _Field:
        """All of it."""
        camera = instrument.camera
        half_px = np.array([camera.width_px, camera.height_px]) / 2.0
        return cls(half_px * camera.pixel_pitch_mm / instrument.focal_length_mm)

    def places(self, shape: tuple[int, int], rng: np.random.Generator) -> FloatArray:
        """Places (trials, n, 2), evenly spread, in half widths from the middle."""
        return np.asarray(rng.uniform(-1.0, 1.0, (*shape, 2)))

    @property
    def spread_rad(self) -> float:
        """RMS distance of a star from the middle."""
        return float(np.sqrt((self.half_rad**2 / 3.0).sum()))


def attitude_study(
    instrument: Instrument,
    errors: StarErrors,
    config: AttitudeConfig,
    streams: Streams,
    *,
    advance: Callable[[], None] = lambda: None,
) -> dict[str, Any]:
    """Monte-Carlo of the attitude: the records of `SECTIONS`."""
    trials, failed, field = config.trials, 0, _Field.of(instrument)

    def scatter(reading: str, count: int, at: Streams) -> _Scatter:
        nonlocal failed
        found = _scatter(field, errors, reading, count, trials, at.generator(reading))
        failed += found.failed
        return found

    numbers = []
    for count in config.counts:
        found = [scatter(reading, count, streams.child("curve", count)) for reading in READINGS]
        numbers.append(
            Number(
                stars=count,
                arcsec=np.stack([one.arcsec for one in found]),
                rule_arcsec=_rule(errors, field, count),
                stated_arcsec=found[0].stated_arcsec,
            )
        )
        advance()
    rule = _rule(errors, field, config.stars)
    here = [scatter(reading, config.stars, streams.child("at")) for reading in READINGS]
    part = float(1.0 / np.sqrt(2.0 * trials))
    return {
        "attitude": Attitude(
            stars=config.stars,
            trials=trials,
            failed=failed,
            rule_arcsec=rule,
            relative_uncertainty=part,
            over_expected=measured(here[0].over_expected, here[0].over_expected * part, trials),
        ),
        "readings": [Errors(arcsec=one.arcsec, over_rule=one.arcsec / rule) for one in here],
        "attitude_curve": numbers,
    }


def solved_attitude(instrument: Instrument, budget: ErrorBudget, config: AttitudeConfig, streams: Streams) -> ErrorTerm:
    """Error of attitudes from N stars all over the field with the errors of a budget, independent from star to star."""
    found = _scatter(
        _Field.of(instrument),
        StarErrors.of(budget),
        next(iter(READINGS)),
        config.stars,
        config.trials,
        streams.generator("attitude"),
    )
    of_total = budget.total.uncertainty_arcsec / np.maximum(budget.total.arcsec, 1e-300)
    value = found.arcsec[:2]
    return ErrorTerm(
        arcsec=value, uncertainty_arcsec=value * np.hypot(of_total, 1.0 / np.sqrt(2.0 * config.trials)), n=config.trials
    )


def _rule(errors: StarErrors, field: _Field, count: int) -> FloatArray:
    total = errors.total_arcsec
    per_axis = over_stars(total, count)
    share = field.half_rad**2 / (field.half_rad**2).sum()
    # stars at a distance along x turn the field by their error along y, and the other way round
    across = over_stars(np.sqrt(share[0] * total[1] ** 2 + share[1] * total[0] ** 2), count)
    return np.array([*per_axis, across / field.spread_rad])


class _Scatter(NamedTuple):
    """Errors of solved attitudes: x, y, roll."""

    arcsec: FloatArray  # (3,) 3 sigma
    stated_arcsec: FloatArray  # (3,) The same as stated by the estimator
    over_expected: FloatArray  # (3,) In units of what the rule makes of each field, root mean square
    failed: int  # Trials without an attitude


def _expected2(plane: FloatArray, total_arcsec: FloatArray) -> FloatArray:
    """Square of the error (t, 3) that least squares make of independent errors of stars at (t, n, 2); the roll moves
    the boresight by the distance of the mean from there."""
    middle = plane.mean(1)
    xx, yy = np.moveaxis(((plane - middle[:, None]) ** 2).sum(1), -1, 0)
    roll = (total_arcsec[0] ** 2 * yy + total_arcsec[1] ** 2 * xx) / (xx + yy) ** 2
    shift = over_stars(total_arcsec, plane.shape[1]) ** 2
    return np.stack([shift[0] + middle[:, 1] ** 2 * roll, shift[1] + middle[:, 0] ** 2 * roll, roll], axis=1)


def _scatter(
    field: _Field, errors: StarErrors, reading: str, count: int, trials: int, rng: np.random.Generator
) -> _Scatter:
    """Solve attitudes of drawn stars."""
    place = field.places((trials, count), rng)
    plane = place * field.half_rad
    true = np.concatenate([plane, np.ones((trials, count, 1))], axis=2)
    true /= np.linalg.norm(true, axis=2, keepdims=True)
    shift = _errors(errors, reading, place, rng) * ARCSEC_RAD
    along = np.array([1.0, 0.0, 0.0]) - true * true[..., :1]
    along /= np.linalg.norm(along, axis=2, keepdims=True)
    seen = true + shift[..., :1] * along + shift[..., 1:] * np.cross(true, along)
    seen /= np.linalg.norm(seen, axis=2, keepdims=True)
    attitude = Rotation.random(trials, rng=rng)
    matrix = attitude.as_matrix()
    reference = np.einsum("tji,tnj->tni", matrix, true)
    sigma = float(np.sqrt((errors.total_arcsec**2).mean())) / 3.0 * ARCSEC_RAD
    solved = solve_wahba_many(
        seen.reshape(-1, 3),
        reference.reshape(-1, 3),
        np.repeat(np.arange(trials), count),
        frames=trials,
        sigma_rad=sigma,
    )
    usable = np.isfinite(np.einsum("fii->f", solved.covariance_rad2))
    turn = attitude_error_arcsec(solved.rotation, attitude)[usable]
    stated = np.sqrt(np.mean(solved.sigma_arcsec[usable] ** 2, axis=0))
    square = np.sqrt(np.mean(turn**2, axis=0))
    order = [1, 0, 2]  # a turn about y displaces the boresight along x
    expected2 = _expected2(plane, errors.total_arcsec)[usable] / 9.0
    return _Scatter(
        arcsec=3.0 * square[order],
        stated_arcsec=3.0 * stated[order],
        over_expected=np.sqrt(np.mean(turn[:, order] ** 2 / expected2, axis=0)),
        failed=int(np.count_nonzero(~usable)),
    )


def _errors(errors: StarErrors, reading: str, place: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Errors (trials, n, 2) [arcsec], 1 sigma drawn."""
    trials = len(place)
    random = errors.random_arcsec / 3.0 * rng.standard_normal(place.shape)
    chromatic, distortion = errors.chromatic_arcsec / 3.0, errors.distortion_arcsec / 3.0
    common = rng.standard_normal((2, trials, 1, 2))
    if reading == "independent":
        low = np.hypot(chromatic, distortion) * rng.standard_normal(place.shape)
    elif reading == "common":
        low = np.hypot(chromatic, distortion) * common[0]
    else:
        low = chromatic * common[0] + distortion * _smooth(place, rng)
    return np.asarray(random + low)


def _smooth(place: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Random cubic maps (trials, n, 2) of unit variance over the field, each with its own coefficients: products of
    Legendre polynomials without the constant, which a calibration would have taken."""
    x, y = place[..., 0], place[..., 1]
    terms: Sequence[tuple[int, int]] = [(i, j) for i in range(DEGREE + 1) for j in range(DEGREE + 1 - i) if i + j > 0]
    of_x, of_y = (np.polynomial.legendre.legvander(v, DEGREE) for v in (x, y))
    size = np.sqrt(2.0 * np.arange(DEGREE + 1) + 1.0)
    basis = np.stack([size[i] * size[j] * of_x[..., i] * of_y[..., j] for i, j in terms], axis=-1)
    weight = rng.standard_normal((len(place), len(terms), 2)) / np.sqrt(len(terms))
    return np.asarray(np.einsum("tnk,tka->tna", basis, weight))


def _axes(q: Quantities, _: Any) -> None:
    q.axis("component", ["x", "y", "roll"], "Component")
    q.axis("reading", list(READINGS), "Low-frequency error", names=READINGS)


SECTIONS = {
    "attitude": Section(
        record=Attitude,
        prefix="attitude_",
        place="attitude",
        axes=_axes,
        verdicts=[
            agree(
                "attitude_over_expected",
                1.0,
                slack=FAR_FROM_THE_AXIS,
                title="Attitude error from stars with the measured errors over total / √N for the same stars",
            )
        ],
    ),
    "readings": Section(
        record=Errors,
        place="attitude",
        across="component",
        dim="reading",
        prefix="attitude_",
        json={"arcsec": "monte_carlo_arcsec_3sigma"},
        table="attitude",
        caption="Attitude error for the budget's number of stars, 3 sigma, from solved attitudes of "
        "simulated star fields.",
        note="x, y: displacement of the boresight. Rule: total / √N; for roll also divided by the RMS distance of a "
        "star from the middle of the field.",
    ),
    "attitude_curve": Section(
        record=Number,
        dim="stars",
        along="stars",
        prefix="curve_",
        rows="stars",
        across="reading component",
        caption="Attitude error against the number of stars, 3 sigma.",
        figures={
            "attitude_curves": curves(
                "stars",
                points="curve_arcsec",
                lines="curve_rule_arcsec",
                by="reading",
                panels="component",
                log="xy",
                aspect_ratio=0.42,
            )
        },
    ),
}
