"""The bench of FISHER23 by a path of its own: written-out matrices, the traced lens without a model, known changes.

Three questions that a reduction cannot answer with the equations that it shares with the simulation:

* Do the images lie where v = A T^T s puts them, with the star, the installation and the axes as they were set, through
  the traced lens (a polynomial through its map, no camera model)?
* Do star and leans of the calibration agree with what was set?
* If the same data are moved by known amounts, does the calibration move by these and by nothing else? Images moved by
  d move the principal point by d. An offset e of the outermost reading turns the star about that axis by e; one of the
  innermost turns the installation about that axis, A -> A R(e). All three hold exactly.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from scipy.stats import chi2

from experiments.laboratory.plain_formulae import (
    ARCSEC,
    acf_matrix,
    small_turn_rad,
    star_vector,
    table_matrices,
    turn_matrix,
    two_sided,
)
from experiments.laboratory.single_star.reduce import Data, reduce_data
from experiments.laboratory.single_star.setup import averaged, build_table
from optics.arrays import FloatArray

if TYPE_CHECKING:
    from calib.calibration.record import Calibration
    from experiments.laboratory.single_star.settings import SingleStarConfig, TableConfig
    from experiments.turntable.case import Case
    from experiments.turntable.result import Result
    from experiments.turntable.traced import TracedMap

__all__ = ["Check", "Injection", "check_case"]


MAP_DEGREE = 9


@dataclass(frozen=True, slots=True, kw_only=True)
class Injection:
    """Known changes of the data: images [px], offsets of the outermost and the innermost reading [arcsec].

    Two fits that have converged differ by some 1e-5 sigma, and two axes in a narrow field know the principal point to
    25 px: the images move by enough pixels for that to be little.
    """

    image_px: tuple[float, float] = (6.0, -3.5)
    outer_arcsec: float = 60.0
    inner_arcsec: float = -40.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Check:
    """What came of the three questions, for one table."""

    image_probability: float  # Of residuals of the images at least as unlikely as those found, two-sided
    reading_probability: float  # The same of the readings against the angles that were set
    set_probability: float  # Of star and leans at least as far from what was set
    moved_part: float  # Largest difference of what the calibration moved by from what was injected, as part of it

    LABELS: ClassVar[dict[str, str]] = {
        "image_probability": "images where v = A Tᵀ s, written out, puts them in the traced lens, probability",
        "reading_probability": "readings about the angles that were set, probability",
        "set_probability": "star and leans against what was set, probability",
        "moved_part": "images and readings moved by known amounts: what came back differs by, part of them",
    }


def _leans(table: TableConfig) -> list[float]:
    count = len(table.axes.replace("-", "")) - 1
    given = list(table.non_orthogonality_arcsec)
    return given * count if len(given) == 1 else given


def _powers(slope: FloatArray) -> FloatArray:
    x, y = slope.T
    return np.column_stack([x**i * y**j for i in range(MAP_DEGREE + 1) for j in range(MAP_DEGREE + 1 - i)])


def _traced_px(traced: TracedMap, rays: FloatArray) -> FloatArray:
    """Images (n, 2) of directions, by a polynomial in their slopes through the traced map."""
    known, asked = (v[:, :2] / v[:, 2:] for v in (traced.direction, rays))
    scale = np.abs(known).max()
    coefficients = np.linalg.lstsq(_powers(known / scale), traced.pixel_px, rcond=None)[0]
    return np.asarray(_powers(asked / scale) @ coefficients)


def image_chi2(config: SingleStarConfig, table: TableConfig, case: Case, traced: TracedMap) -> tuple[float, int]:
    """Chi-square of the images against v = A T^T s at the angles that were set, and how many numbers are in it."""
    star = star_vector(np.radians(config.star.azimuth_deg), np.radians(config.star.elevation_deg))
    turn = np.radians(config.installation_deg)
    size = float(np.sqrt(turn @ turn))
    installation = turn_matrix(turn / size, size) if size > 0 else np.eye(3)
    tables = table_matrices(table.axes, case.measurement.visits.true_rad, _leans(table))
    rays = np.einsum("ij,nkj,k->ni", installation, tables, star)  # A T^T s
    apart = np.asarray(case.measurement.readings.position_px) - _traced_px(traced, rays)
    weight = np.linalg.inv(np.asarray(case.measurement.readings.covariance_px2))
    return float(np.einsum("ni,nij,nj->", apart, weight, apart)), apart.size


def reading_chi2(config: SingleStarConfig, table: TableConfig, case: Case) -> tuple[float, int]:
    """Chi-square of mean readings less the encoder's wave about the angles that were set; only of axes with noise."""
    visits = case.measurement.visits
    given, count = list(table.reading_noise_arcsec), np.shape(visits.true_rad)[1]
    sigma = np.array(given * count if len(given) == 1 else given) * ARCSEC / np.sqrt(config.frames)
    wave = table.encoder_amplitude_arcsec * ARCSEC * np.sin(table.encoder_cycles * np.asarray(visits.true_rad))
    pull = (visits.reading_rad - visits.true_rad - wave)[:, sigma > 0] / sigma[sigma > 0]
    return float((pull**2).sum()), pull.size


def set_chi2(config: SingleStarConfig, table: TableConfig, calibration: Calibration) -> tuple[float, int]:
    """Chi-square of star and leans against what was set, by the estimator's covariance."""
    truth = {
        "star_azimuth_rad": np.radians(config.star.azimuth_deg),
        "star_elevation_rad": np.radians(config.star.elevation_deg),
        **{f"lean{i + 1}_rad": lean * ARCSEC for i, lean in enumerate(_leans(table))},
    }
    names = list(calibration.solution.names)
    at = [names.index(name) for name in truth]
    apart = np.asarray(calibration.solution.value)[at] - np.array(list(truth.values()))
    covariance = np.asarray(calibration.solution.covariance)[np.ix_(at, at)]
    return float(apart @ np.linalg.solve(covariance, apart)), len(at)


def moved_by(before: Mapping[str, float], after: Mapping[str, float], table: TableConfig, known: Injection) -> float:
    """Largest difference of what two calibrations differ by from the injection, as part of what was injected."""

    def about(place: int, arcsec: float) -> FloatArray:
        angle = np.zeros((1, len(_leans(table)) + 1))
        angle[0, place] = arcsec * ARCSEC
        return np.asarray(table_matrices(table.axes, angle, _leans(table))[0])

    def star(values: Mapping[str, float]) -> FloatArray:
        return star_vector(values["star_azimuth_rad"], values["star_elevation_rad"])

    def installation(values: Mapping[str, float]) -> FloatArray:
        return acf_matrix(*(values[f"theta{i}_rad"] for i in (1, 2, 3)))

    outer, inner = abs(known.outer_arcsec) * ARCSEC, abs(known.inner_arcsec) * ARCSEC
    star_off = star(after) - about(0, known.outer_arcsec) @ star(before)
    mount_off = small_turn_rad(installation(after) @ (installation(before) @ about(-1, known.inner_arcsec)).T)
    shift_off = [
        abs(after[name] - before[name] - size) / abs(size)
        for name, size in zip(("x0_px", "y0_px"), known.image_px, strict=True)
    ]
    scale_off = abs(after["focal_length_mm"] / before["focal_length_mm"] - 1.0) / outer
    return float(max(np.abs(star_off).max() / outer, np.abs(mount_off).max() / inner, *shift_off, scale_off))


def check_case(result: Result, case: Case) -> Check:
    """All three questions for one table of a run."""
    config, table, known = result.config, case.config, Injection()
    measured = Data.of(case.measurement)
    offsets = np.zeros(np.shape(measured.reading_rad))
    offsets[:, 0] += known.outer_arcsec * ARCSEC
    offsets[:, -1] += known.inner_arcsec * ARCSEC
    moved = replace(
        measured, pixel_px=measured.pixel_px + np.array(known.image_px), reading_rad=measured.reading_rad + offsets
    )
    setup = case.coordinates
    before = case.reductions["estimated"].calibration
    axes = config.reduction.axes if len(_leans(table)) == 1 else None
    square = averaged(build_table(table, axes), config.frames).nominal
    after = reduce_data(moved, square, setup.start, leans=True, start_star=setup.start_star)
    first, second = (dict(zip(one.solution.names, one.solution.value, strict=True)) for one in (before, after))
    return Check(
        image_probability=two_sided(*image_chi2(config, table, case, result.traced)),
        reading_probability=two_sided(*reading_chi2(config, table, case)),
        set_probability=float(chi2.sf(*set_chi2(config, table, before))),
        moved_part=moved_by(first, second, table, known),
    )
