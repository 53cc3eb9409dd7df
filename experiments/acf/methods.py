"""Fig. 5 of ACF17: attitudes linked by a gyro (ACC) against interstar angles (IAC), and against the bound.

Further methods: a gyro of stated noise, free attitudes in every frame, and interstar angles with their full covariance,
which keep 2n - 3 measurements of a frame and are as accurate as free attitudes.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from calib.cameras.line_of_sight import expected_rms
from calib.fitting.normal_errors import correlated_errors, normalised_squares
from experiments.acf.reprojection import root_mean_square
from experiments.acf.settings import Config
from experiments.acf.simulate import build_scene
from experiments.acf.table2 import Covariances, covariances
from experiments.acf.trials import COMPARED, Method, Point, Trials, field_of, table1_gyro
from experiments.harness.drawings import Drawing, curves
from experiments.harness.sections import Section, col, ratio_near
from experiments.harness.summary import Measured, measured
from optics.arrays import FloatArray
from render.engine.random import Streams

ERRORS = ("x0", "y0", "f", "distortion", "line_of_sight")
"""By which Fig. 5 judges a method: three parameters, the largest residual distortion; and the line of sight."""
RATIOS: dict[str, tuple[Method, Method]] = {
    "iac_over_acc": ("iac", "acc"),
    "iac_full_over_free": ("iac_full", "free"),
    "free_over_acc": ("free", "acc"),
}
BOUNDS = {"acc": "acc", "linked": "linked", "free": "free", "iac_full": "free"}
"""Method -> covariance that predicts it; full weights are as good as free attitudes."""
DRAWS = 400
"""Of the predicted errors, for the expected largest residual distortion."""
SIGHT_FREEDOM = 4.0
"""Effective degrees of freedom of the mean-square map error: five or so independent shapes of unequal size."""

Row = Sequence[Measured]


def fig5_points(config: Config) -> list[Point]:
    """One point per noise, Table 1's gyro, all methods, all frames."""
    return [
        Point(
            name=f"fig5 {noise:g} px",
            runs=config.runs,
            noise_px=noise,
            gyro=(table1_gyro(config),),
            methods=COMPARED,
            frames="all",
        )
        for noise in config.noise_px
    ]


@dataclass(frozen=True, slots=True, kw_only=True)
class MethodErrors:
    """RMS errors of a method, mean of the largest residual distortion, by noise; with their expectation from the
    design."""

    x0_px: FloatArray = col("x0", "px", ".3f", "noise")
    expected_x0_px: FloatArray = col("Expected", "px", ".3f", "noise", shown=False)
    y0_px: FloatArray = col("y0", "px", ".3f", "noise")
    expected_y0_px: FloatArray = col("Expected", "px", ".3f", "noise", shown=False)
    focal_length_mm: FloatArray = col("f", "mm", ".5f", "noise")
    expected_focal_length_mm: FloatArray = col("Expected", "mm", ".5f", "noise", shown=False)
    distortion_px: Row = col(
        "Largest residual distortion",
        "px",
        dims="noise",
    )
    expected_distortion_px: FloatArray = col("Expected", "px", ".3f", "noise", shown=False)
    sight_arcsec: Row = col(
        "Line of sight",
        "arcsec",
        dims="noise",
    )
    expected_sight_arcsec: FloatArray = col("Expected", "arcsec", ".3f", "noise")


@dataclass(frozen=True, slots=True, kw_only=True)
class Pooled:
    """Errors of a method per pixel of star noise, all noises together."""

    x0_px: float = col("x0", "px", ".2f")
    y0_px: float = col("y0", "px", ".2f")
    f_um: float = col("f", "um", ".2f")
    distortion_px: float = col("Distortion, largest", "px", ".3f")
    sight_arcsec: float = col("Line of sight", "arcsec", ".2f")
    expected_sight_arcsec: float = col("Expected", "arcsec", ".2f")
    over_expected: Measured = col("Over expected", shown=False)
    over_acc: float = col("Error / error of ACC", "", ".3f")


@dataclass(frozen=True, slots=True, kw_only=True)
class Ratio:
    """Ratio of the errors of two methods, all noises together."""

    ratio: Sequence[float] = col("Ratio of errors", "", ".2f", "error")


@dataclass(frozen=True, slots=True, kw_only=True)
class Pull:
    """RMS error of an unknown over a predicted standard deviation, all noises of Fig. 5 together."""

    own: float = col("ACC, own covariance", "", ".3f")
    carried: float = col("ACC, gyro's error included", "", ".3f")
    linked: Measured = col("Gyro of stated noise, own covariance")


@dataclass(frozen=True, slots=True, kw_only=True)
class Fig5:
    """Numbers of all methods together."""

    fig5_n: int = col("Runs")
    pull_n: int = col("Runs")
    nees_ratio: Measured = col("Errors of the 14 unknowns over their covariance, gyro of stated noise")


def methods(config: Config, trials: Mapping[str, Trials]) -> dict[str, object]:
    """Sections of Fig. 5: errors by noise, pooled, their ratios, and pulls."""
    points = fig5_points(config)
    runs = [trials[point.name] for point in points]
    expected = [covariances(config, point) for point in points]
    by_noise = {method: of_method(config, method, runs, expected) for method in COMPARED}
    noise = np.array(config.noise_px)
    sizes = {method: pooled_errors(method, runs, noise) for method in COMPARED}
    both = {
        name: ratios(by_noise[one], by_noise[other], sizes[one], sizes[other]) for name, (one, other) in RATIOS.items()
    }
    n = config.runs * len(points)
    return {
        "fig5": list(by_noise.values()),
        "methods": [pooled(one, by_noise["acc"], sizes[method], noise, n) for method, one in by_noise.items()],
        "ratios": [Ratio(ratio=ratio) for ratio in both.values()],
        "pulls": pulls(runs, expected),
        "fig5_all": Fig5(fig5_n=config.runs, pull_n=n, nees_ratio=nees_ratio(runs, expected)),
    }


def of_method(config: Config, method: str, runs: Sequence[Trials], expected: Sequence[Covariances]) -> MethodErrors:
    """Errors of a method by noise."""
    error, distortion, sight = (
        np.stack([one.of(method, what) for one in runs]) for what in ("error", "distortion_px", "sight_arcsec")
    )
    camera = np.sqrt((error[:, :, :8] ** 2).mean(1))
    bent, bent_error = distortion.mean(1), distortion.std(1, ddof=1) / np.sqrt(distortion.shape[1])
    rms, rms_error = root_mean_square(sight**2, 1)
    should = expected_errors(config, method, runs, expected)
    return MethodErrors(
        x0_px=camera[:, 0],
        expected_x0_px=should[0],
        y0_px=camera[:, 1],
        expected_y0_px=should[1],
        focal_length_mm=camera[:, 2],
        expected_focal_length_mm=should[2],
        distortion_px=measured(bent, bent_error),
        expected_distortion_px=should[3],
        sight_arcsec=measured(rms, rms_error),
        expected_sight_arcsec=should[4],
    )


def expected_errors(config: Config, method: str, runs: Sequence[Trials], expected: Sequence[Covariances]) -> FloatArray:
    """Expected errors of a method (5, s), from the design.

    For unweighted angles the parameters' are what the method's own covariance says, on average; the others are NaN.
    """
    if method not in BOUNDS:
        sigma = np.sqrt(np.stack([(one.of(method, "sigma")[:, :3] ** 2).mean(0) for one in runs]))
        return np.concatenate([sigma.T, np.full((2, len(sigma)), np.nan)])
    camera = [getattr(one, BOUNDS[method])[:8, :8] for one in expected]
    matrix = field_of(config, None).mean_square
    sight = np.array([expected_rms(matrix, one) for one in camera])
    return np.stack(
        [*np.stack([np.sqrt(np.diag(one)[:3]) for one in camera]).T, largest_distortion(config, camera), sight]
    )


def largest_distortion(config: Config, camera: Sequence[FloatArray]) -> FloatArray:
    """Expected largest residual distortion [px]: the mean over draws of the coefficients' errors."""
    true, grid = build_scene(config).camera, field_of(config, None)
    by_coefficient = true.project_jacobian(grid.direction).by_parameter[:, :, 3:]
    draw = Streams(config.seed).child("acf").generator("expected distortion").standard_normal((DRAWS, 5))
    largest = []
    for covariance in camera:
        errors = correlated_errors(covariance[3:, 3:], draw)
        moved = np.moveaxis(by_coefficient @ errors.T, 1, 0)  # (2, n, d)
        largest.append(float(np.hypot(*moved).max(axis=0).mean()))
    return np.array(largest)


def pooled_errors(method: str, runs: Sequence[Trials], noise: FloatArray) -> FloatArray:
    """RMS errors (3,) of x0, y0 and f per pixel of noise."""
    error = np.stack([one.of(method, "error")[:, :8] for one in runs])
    return np.asarray(np.sqrt(((error / noise[:, None, None]) ** 2).mean((0, 1)))[:3])


def pooled(one: MethodErrors, acc: MethodErrors, sizes: FloatArray, noise: FloatArray, n: int) -> Pooled:
    """Errors of a method per pixel of noise."""
    bent, sight, reference = (_values(row) for row in (one.distortion_px, one.sight_arcsec, acc.sight_arcsec))
    over = float(np.sqrt(np.mean((sight / one.expected_sight_arcsec) ** 2)))
    return Pooled(
        x0_px=float(sizes[0]),
        y0_px=float(sizes[1]),
        f_um=1e3 * float(sizes[2]),
        distortion_px=float((bent / noise).mean()),
        sight_arcsec=float((sight / noise).mean()),
        expected_sight_arcsec=float((one.expected_sight_arcsec / noise).mean()),
        over_expected=Measured(value=over, uncertainty=float(np.sqrt(1.0 / (2.0 * SIGHT_FREEDOM * n))), n=n),
        over_acc=float((sight / reference).mean()),
    )


def ratios(one: MethodErrors, other: MethodErrors, sizes: FloatArray, other_sizes: FloatArray) -> list[float]:
    """Ratios of the `ERRORS` of two methods."""
    maps = [
        float(np.mean(_values(getattr(one, name)) / _values(getattr(other, name))))
        for name in ("distortion_px", "sight_arcsec")
    ]
    return [*(sizes / other_sizes).tolist(), *maps]


def _values(row: Row) -> FloatArray:
    return np.array([one.value for one in row])


def pulls(runs: Sequence[Trials], expected: Sequence[Covariances]) -> list[Pull]:
    """RMS pulls of the 14 unknowns. ACC's own covariance takes the gyro as perfect."""
    own = np.concatenate([one.of("acc", "error") / one.of("acc", "sigma") for one in runs])
    carried = np.concatenate(
        [one.of("acc", "error") / np.sqrt(np.diag(should.acc)) for one, should in zip(runs, expected, strict=True)]
    )
    linked = np.concatenate([one.of("linked", "error") / one.of("linked", "sigma") for one in runs])
    rms = [np.sqrt((pull**2).mean(0)) for pull in (own, carried, linked)]
    rms[2] = measured(rms[2], 1.0 / np.sqrt(2 * len(own)))
    return [Pull(own=a, carried=b, linked=c) for a, b, c in zip(*rms, strict=True)]


def nees_ratio(runs: Sequence[Trials], expected: Sequence[Covariances]) -> Measured:
    """Root of the normalised estimation error squared over its 14 degrees of freedom, all noises of Fig. 5 together."""
    pairs = zip(runs, expected, strict=True)
    square = np.concatenate([normalised_squares(one.of("linked", "error"), should.linked) for one, should in pairs])
    unknowns = len(expected[0].linked)
    ratio = float(np.sqrt(square.mean() / unknowns))
    return Measured(value=ratio, uncertainty=float(1.0 / np.sqrt(2.0 * unknowns * len(square))), n=len(square))


def panel(name: str, label: str) -> Drawing:
    """One panel of Fig. 5."""
    return curves("noise", points=name, lines=f"expected_{name}", by="method", y=label, width="half", aspect_ratio=1.0)


METHODS = {
    "fig5": Section(
        record=MethodErrors,
        dim="method",
        caption="ACF17 Fig. 5 with further methods: RMS errors; mean of the largest residual distortion.",
        figures={
            "fig5_distortion": panel("distortion_px", "Largest residual distortion"),
            "fig5_sight": panel("sight_arcsec", "Line of sight, RMS error"),
        },
    ),
    "methods": Section(
        record=Pooled,
        dim="method",
        caption="Errors of the methods of Fig. 5 per pixel of star noise, for all noise values together.",
        note="Line of sight: RMS over the detector after the best rotation.",
        verdicts=[
            ratio_near(
                "over_expected",
                within=0.05,
                at={"method": method},
                title="line-of-sight error over that expected from the design",
                advice="check that every calibration converged",
            )
            for method in ("acc", "free")
        ],
    ),
    "ratios": Section(record=Ratio, dim="ratio"),
    "pulls": Section(
        record=Pull,
        dim="unknown",
        caption="RMS pull (error over predicted standard deviation) of the 14 unknowns; expected 1.",
    ),
    "fig5_all": Section(
        record=Fig5,
        verdicts=[
            ratio_near(
                "nees_ratio",
                within=0.03,
                title="errors of the 14 unknowns over their covariance (NEES), gyro of stated noise",
                advice="a bias or a wrong covariance: check that the calibrations converged",
            )
        ],
    ),
}
