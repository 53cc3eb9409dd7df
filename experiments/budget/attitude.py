"""Attitude from N stars by Monte-Carlo through the estimator, against the rule total / sqrt(N) (ACC18 section 2.4).

Stars lie evenly over the detector. Temporal and pixel errors are independent from star to star. Of the low-frequency
error three readings are tried:

* independent from star to star, which is what dividing the *total* by sqrt(N) takes for granted;
* as it is: the chromatic part moves all stars alike (eq. 16 is a mean over the field), the distortion part is a smooth
  map, here a random cubic polynomial over the field, new in every trial;
* common: all of it moves all stars alike.

Pointing errors are given as the displacement of the boresight along x and y (a turn about y displaces along x), roll
about the boresight.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from calib.attitude.solve import solve_wahba_many
from experiments.budget.combine import Budget
from experiments.budget.settings import AttitudeConfig
from experiments.laboratory.instrument import Instrument
from optics.arrays import FloatArray
from optics.attitude import attitude_error_arcsec
from optics.units import ARCSEC_RAD
from render.engine.random import Streams

__all__ = ["LAYOUTS", "READINGS", "AttitudeStudy", "StarErrors", "attitude_study"]


READINGS = ("independent", "as it is", "common")
LAYOUTS = ("whole field", "left half", "upper quarter band", "one corner")
DEGREE = 3
"""Of the smooth map: the polynomial of ACC18 eq. 19 is cubic."""


@dataclass(frozen=True, slots=True, kw_only=True)
class StarErrors:
    """Errors of one star, 3 sigma (2,) [arcsec]."""

    random_arcsec: FloatArray  # (2,) Temporal and pixel error
    chromatic_arcsec: FloatArray  # (2,) Low-frequency error
    distortion_arcsec: FloatArray  # (2,) Low-frequency error

    @classmethod
    def of(cls, budget: Budget) -> StarErrors:
        """From a budget: the total is the same."""
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
class AttitudeStudy:
    """Attitude errors, 3 sigma [arcsec]; columns are x, y (displacement of the boresight) and roll."""

    stars: int  # N of the budget
    counts: NDArray[np.int64]  # (c,) Numbers of stars of the curves
    trials: int  # Fields per number
    curve: Mapping[str, FloatArray]  # (c, 3) By reading of the low-frequency error
    # (c, 3) Total / sqrt(N); for roll divided by the RMS distance of a star from the middle of the field, in radians
    rule: FloatArray
    bound: FloatArray  # (c, 3) Root mean variance that the estimator states for independent errors
    at: Mapping[str, FloatArray]  # (3,) At N of the budget, by reading
    rule_at: FloatArray  # (3,) The rule there
    # (3,) At N of the budget, independent errors, stars only in a part of the field, by name
    layout: Mapping[str, FloatArray]
    failed: int  # Trials in which the estimator gave no attitude; left out

    @property
    def relative_uncertainty(self) -> float:
        """Of every error: a standard deviation from so many trials."""
        return float(1.0 / np.sqrt(2.0 * self.trials))


@dataclass(frozen=True, slots=True)
class _Field:
    """The detector as a field of stars."""

    half_rad: FloatArray  # (2,) half width and half height as tangents
    part: tuple[float, float, float, float] = (-1.0, 1.0, -1.0, 1.0)

    def places(self, shape: tuple[int, int], rng: np.random.Generator) -> FloatArray:
        """Places (trials, n, 2), evenly spread over the part, in half widths from the middle."""
        low, high = np.array(self.part[::2]), np.array(self.part[1::2])
        return np.asarray(rng.uniform(low, high, (*shape, 2)))

    @property
    def spread_rad(self) -> float:
        """RMS distance of a star from the middle of the part."""
        low, high = np.array(self.part[::2]), np.array(self.part[1::2])
        return float(np.sqrt((((high - low) * self.half_rad) ** 2 / 12.0).sum()))


_PARTS = {
    "whole field": (-1.0, 1.0, -1.0, 1.0),
    "left half": (-1.0, 0.0, -1.0, 1.0),
    "upper quarter band": (-1.0, 1.0, -1.0, -0.5),
    "one corner": (-1.0, 0.0, -1.0, 0.0),
}


def attitude_study(
    instrument: Instrument,
    errors: StarErrors,
    config: AttitudeConfig,
    streams: Streams,
    *,
    advance: Callable[[], None] = lambda: None,
) -> AttitudeStudy:
    """Monte-Carlo of the attitude."""
    camera = instrument.camera
    half_px = np.array([camera.width_px, camera.height_px]) / 2.0
    field = _Field(half_px * camera.pixel_pitch_mm / instrument.focal_length_mm)
    failed = 0
    curve: dict[str, list[FloatArray]] = {name: [] for name in READINGS}
    bound = []
    for count in config.counts:
        for name in READINGS:
            found, stated, lost = _scatter(
                field, errors, name, count, config.trials, streams.child("curve", count).generator(name)
            )
            curve[name].append(found)
            failed += lost
            if name == READINGS[0]:
                bound.append(stated)
        advance()
    at, layout = {}, {}
    for name in READINGS:
        at[name], _, lost = _scatter(
            field, errors, name, config.stars, config.trials, streams.child("at").generator(name)
        )
        failed += lost
    for name in LAYOUTS:
        part = _Field(field.half_rad, _PARTS[name])
        layout[name], _, lost = _scatter(
            part, errors, READINGS[0], config.stars, config.trials, streams.child("layout").generator(name)
        )
        failed += lost
    counts = np.array(config.counts, np.int64)
    return AttitudeStudy(
        stars=config.stars,
        counts=counts,
        trials=config.trials,
        curve={name: np.stack(values) for name, values in curve.items()},
        rule=np.stack([_rule(errors, field, int(n)) for n in counts]),
        bound=np.stack(bound),
        at=at,
        rule_at=_rule(errors, field, config.stars),
        layout=layout,
        failed=failed,
    )


def _rule(errors: StarErrors, field: _Field, count: int) -> FloatArray:
    total = errors.total_arcsec
    per_axis = total / np.sqrt(count)
    share = field.half_rad**2 / (field.half_rad**2).sum()
    # stars at a distance along x turn the field by their error along y, and the other way round
    across = np.sqrt(share[0] * total[1] ** 2 + share[1] * total[0] ** 2) / np.sqrt(count)
    return np.array([*per_axis, across / field.spread_rad])


def _scatter(
    field: _Field, errors: StarErrors, reading: str, count: int, trials: int, rng: np.random.Generator
) -> tuple[FloatArray, FloatArray, int]:
    """3 sigma of x, y, roll; the same as stated by the estimator; trials without an attitude."""
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
    return 3.0 * square[order], 3.0 * stated[order], int(np.count_nonzero(~usable))


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
    """Random cubic maps (trials, n, 2) of unit variance over the field, each with its own coefficients.

    Products of Legendre polynomials up to the third degree, without the constant (a calibration would have taken it),
    scaled to mean square one over the field; all coefficients have the same variance.
    """
    x, y = place[..., 0], place[..., 1]
    terms: Sequence[tuple[int, int]] = [(i, j) for i in range(DEGREE + 1) for j in range(DEGREE + 1 - i) if i + j > 0]
    of_x, of_y = (np.polynomial.legendre.legvander(v, DEGREE) for v in (x, y))
    size = np.sqrt(2.0 * np.arange(DEGREE + 1) + 1.0)
    basis = np.stack([size[i] * size[j] * of_x[..., i] * of_y[..., j] for i, j in terms], axis=-1)
    weight = rng.standard_normal((len(place), len(terms), 2)) / np.sqrt(len(terms))
    return np.asarray(np.einsum("tnk,tka->tna", basis, weight))
