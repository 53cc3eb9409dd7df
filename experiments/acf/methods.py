"""Fig. 5 of ACF17: calibration with a gyro (ACC) against interstar angles (IAC), and against the Cramer-Rao bound.

ACC takes the gyro as error-free. Further methods: a gyro weighted by its noise ("linked"), an independent attitude in
every frame ("free"), and interstar angles with their full covariance, which keep 2n - 3 measurements of a frame and are
as accurate as independent attitudes.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from calib.cameras.line_of_sight import expected_rms
from calib.fitting.normal_errors import correlated_errors, normalised_squares
from experiments.acf.reprojection import root_mean_square
from experiments.acf.settings import AcfConfig
from experiments.acf.simulate import build_scene
from experiments.acf.table2 import CAMERA, DISTORTION, PINHOLE, Covariances, covariances
from experiments.acf.trials import COMPARED, Method, TrialPoint, Trials, map_grid, table1_gyro
from experiments.harness.drawings import Drawing, curves
from experiments.harness.sections import Section, col, ratio_near
from experiments.harness.summary import Measured, measured
from optics.arrays import FloatArray
from render.engine.random import Streams

ERRORS = ("x0", "y0", "f", "distortion", "line_of_sight")
"""Errors that Fig. 5 compares, three parameters and the largest residual distortion, and the line-of-sight error."""
RATIOS: dict[str, tuple[Method, Method]] = {
    "iac_over_acc": ("iac", "acc"),
    "iac_full_over_free": ("iac_full", "free"),
    "free_over_acc": ("free", "acc"),
}
BOUNDS = {"acc": "acc", "linked": "linked", "free": "free", "iac_full": "free"}
"""Method -> field of `Covariances` that predicts it; fully weighted angles are as accurate as free attitudes."""
DRAWS = 400
"""Errors drawn from a predicted covariance, for the expected largest residual distortion."""
MAP_DEGREES_OF_FREEDOM = 4.0
"""Effective degrees of freedom of the mean-square line-of-sight error e^T M e with e of covariance C, by Satterthwaite:
tr(MC)^2 / tr((MC)^2), 3.8 to 4.0 for the published camera."""


def fig5_points(config: AcfConfig) -> list[TrialPoint]:
    """One point per noise, Table 1's gyro, all methods, all frames."""
    return [
        TrialPoint(
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
    """RMS errors of a method, and mean of its largest residual distortion, by noise."""

    x0_px: FloatArray = col("x0", "px", ".3f", "noise")
    expected_x0_px: FloatArray = col("Expected", "px", ".3f", "noise", shown=False)
    y0_px: FloatArray = col("y0", "px", ".3f", "noise")
    expected_y0_px: FloatArray = col("Expected", "px", ".3f", "noise", shown=False)
    focal_length_mm: FloatArray = col("f", "mm", ".5f", "noise")
    expected_focal_length_mm: FloatArray = col("Expected", "mm", ".5f", "noise", shown=False)
    residual_distortion_px: Sequence[Measured] = col("Largest residual distortion", "px", dims="noise")
    expected_residual_distortion_px: FloatArray = col("Expected", "px", ".3f", "noise", shown=False)
    line_of_sight_arcsec: Sequence[Measured] = col("Line of sight", "arcsec", dims="noise")
    expected_line_of_sight_arcsec: FloatArray = col("Expected", "arcsec", ".3f", "noise")
    n: int = col("Runs", shown=False)


@dataclass(frozen=True, slots=True, kw_only=True)
class NormalisedErrors:
    """Errors of a method divided by the star noise, mean over all noises of Fig. 5."""

    x0_px: float = col("x0", "px", ".2f")
    y0_px: float = col("y0", "px", ".2f")
    f_um: float = col("f", "um", ".2f")
    residual_distortion_px: float = col("Distortion, largest", "px", ".3f")
    line_of_sight_arcsec: float = col("Line of sight", "arcsec", ".2f")
    expected_line_of_sight_arcsec: float = col("Expected", "arcsec", ".2f")
    ratio_to_expected: Measured = col("Over expected", shown=False)
    ratio_to_acc: float = col("Error / error of ACC", "", ".3f")


@dataclass(frozen=True, slots=True, kw_only=True)
class Ratio:
    """Ratio of the errors of two methods, all noises together."""

    error_ratio: Sequence[float] = col("Ratio of errors", "", ".2f", "error")


@dataclass(frozen=True, slots=True, kw_only=True)
class RmsPull:
    """RMS error of an unknown over a predicted standard deviation, all noises of Fig. 5 together."""

    # The covariance of the ACC fit, eq. 11, lacks the gyro's error; the second column includes it
    acc: float = col("ACC, covariance of the fit", "", ".3f")
    acc_with_gyro_error: float = col("ACC, gyro's error included", "", ".3f")
    linked: Measured = col("Gyro weighted by its noise, covariance of the fit")
    n: int = col("Runs", shown=False)


@dataclass(frozen=True, slots=True, kw_only=True)
class Nees:
    """Consistency of the estimates of all 14 unknowns with their covariance."""

    root_mean_nees: Measured = col("Root of mean NEES over 14 degrees of freedom, gyro weighted by its noise")


def compare_methods(config: AcfConfig, trials: Mapping[str, Trials]) -> dict[str, object]:
    """Sections of Fig. 5: errors by noise, errors per pixel of noise, ratios of methods, pulls, and NEES."""
    points = fig5_points(config)
    runs = [trials[point.name] for point in points]
    predicted = [covariances(config, point) for point in points]
    by_noise = {method: method_errors(config, method, runs, predicted) for method in COMPARED}
    noise_px = np.array(config.noise_px)
    per_px = {method: errors_per_px(method, runs, noise_px) for method in COMPARED}
    n = config.runs * len(points)
    return {
        "fig5": list(by_noise.values()),
        "methods": [
            normalise_errors(errors, by_noise["acc"], per_px[method], noise_px, n)
            for method, errors in by_noise.items()
        ],
        "ratios": [
            Ratio(error_ratio=error_ratios(by_noise[method], by_noise[reference], per_px[method], per_px[reference]))
            for method, reference in RATIOS.values()
        ],
        "pulls": rms_pulls(runs, predicted),
        "nees": Nees(root_mean_nees=root_mean_nees(runs, predicted)),
    }


def method_errors(
    config: AcfConfig, method: str, runs: Sequence[Trials], predicted: Sequence[Covariances]
) -> MethodErrors:
    """RMS errors of a method and their expectation, for every noise."""
    parameter_errors, distortion, line_of_sight = (
        np.stack([trials.of(method, quantity) for trials in runs])
        for quantity in ("error", "residual_distortion_px", "line_of_sight_arcsec")
    )
    x0_px, y0_px, focal_length_mm = np.sqrt((parameter_errors[:, :, PINHOLE] ** 2).mean(1)).T
    expected = expected_errors(config, method, runs, predicted)
    return MethodErrors(
        x0_px=x0_px,
        expected_x0_px=expected[0],
        y0_px=y0_px,
        expected_y0_px=expected[1],
        focal_length_mm=focal_length_mm,
        expected_focal_length_mm=expected[2],
        residual_distortion_px=measured(distortion.mean(1), distortion.std(1, ddof=1) / np.sqrt(distortion.shape[1])),
        expected_residual_distortion_px=expected[3],
        line_of_sight_arcsec=measured(*root_mean_square(line_of_sight**2, 1)),
        expected_line_of_sight_arcsec=expected[4],
        n=config.runs,
    )


def expected_errors(
    config: AcfConfig, method: str, runs: Sequence[Trials], predicted: Sequence[Covariances]
) -> FloatArray:
    """Expected `ERRORS` of a method (5, s) at s noises, from the design.

    IAC as published (unweighted angles): root of the mean variance that the fits state for x0, y0 and f; NaN for the
    largest residual distortion and the line of sight.
    """
    if method not in BOUNDS:
        sigma = np.sqrt(np.stack([(trials.of(method, "sigma")[:, PINHOLE] ** 2).mean(0) for trials in runs]))
        return np.concatenate([sigma.T, np.full((2, len(sigma)), np.nan)])
    camera = [getattr(covariance, BOUNDS[method])[CAMERA, CAMERA] for covariance in predicted]
    mean_square = map_grid(config, None).mean_square
    return np.stack(
        [
            *np.stack([np.sqrt(np.diag(covariance)[PINHOLE]) for covariance in camera]).T,
            largest_distortion(config, camera),
            np.array([expected_rms(mean_square, covariance) for covariance in camera]),
        ]
    )


def largest_distortion(config: AcfConfig, camera_covariances: Sequence[FloatArray]) -> FloatArray:
    """Expected largest residual distortion [px]: the mean over draws of the coefficients' errors."""
    true_camera = build_scene(config).camera
    jacobian = true_camera.project_jacobian(map_grid(config, None).direction).by_parameter[:, :, DISTORTION]
    deviates = (
        Streams(config.seed).child("acf").generator("expected distortion").standard_normal((DRAWS, jacobian.shape[2]))
    )
    largest = []
    for covariance in camera_covariances:
        errors = correlated_errors(covariance[DISTORTION, DISTORTION], deviates)
        displacement_px = np.moveaxis(jacobian @ errors.T, 1, 0)  # (2, points, draws)
        largest.append(float(np.hypot(*displacement_px).max(axis=0).mean()))
    return np.array(largest)


def errors_per_px(method: str, runs: Sequence[Trials], noise_px: FloatArray) -> FloatArray:
    """RMS errors (3,) of x0, y0 and f per pixel of noise."""
    error = np.stack([trials.of(method, "error")[:, PINHOLE] for trials in runs])
    return np.asarray(np.sqrt(((error / noise_px[:, None, None]) ** 2).mean((0, 1))))


def normalise_errors(
    errors: MethodErrors, acc: MethodErrors, per_px: FloatArray, noise_px: FloatArray, n: int
) -> NormalisedErrors:
    """Errors of a method divided by the star noise; uncertainty by `MAP_DEGREES_OF_FREEDOM` per run."""
    line_of_sight = _values(errors.line_of_sight_arcsec)
    expected = errors.expected_line_of_sight_arcsec
    return NormalisedErrors(
        x0_px=float(per_px[0]),
        y0_px=float(per_px[1]),
        f_um=1e3 * float(per_px[2]),
        residual_distortion_px=float((_values(errors.residual_distortion_px) / noise_px).mean()),
        line_of_sight_arcsec=float((line_of_sight / noise_px).mean()),
        expected_line_of_sight_arcsec=float((expected / noise_px).mean()),
        ratio_to_expected=Measured(
            value=float(np.sqrt(np.mean((line_of_sight / expected) ** 2))),
            uncertainty=float(np.sqrt(1.0 / (2.0 * MAP_DEGREES_OF_FREEDOM * n))),
            n=n,
        ),
        ratio_to_acc=float((line_of_sight / _values(acc.line_of_sight_arcsec)).mean()),
    )


def error_ratios(
    errors: MethodErrors, reference: MethodErrors, per_px: FloatArray, reference_per_px: FloatArray
) -> list[float]:
    """Ratios of the `ERRORS` of two methods."""
    map_ratios = [
        float(np.mean(_values(getattr(errors, name)) / _values(getattr(reference, name))))
        for name in ("residual_distortion_px", "line_of_sight_arcsec")
    ]
    return [*(per_px / reference_per_px).tolist(), *map_ratios]


def _values(row: Sequence[Measured]) -> FloatArray:
    return np.array([number.value for number in row])


def rms_pulls(runs: Sequence[Trials], predicted: Sequence[Covariances]) -> list[RmsPull]:
    """RMS pulls of the 14 unknowns: ACC with both covariances, and the gyro weighted by its noise."""
    acc = [trials.of("acc", "error") / trials.of("acc", "sigma") for trials in runs]
    linked = [trials.of("linked", "error") / trials.of("linked", "sigma") for trials in runs]
    with_gyro_error = [
        trials.of("acc", "error") / np.sqrt(np.diag(covariance.acc))
        for trials, covariance in zip(runs, predicted, strict=True)
    ]
    rms = [np.sqrt((np.concatenate(pull) ** 2).mean(0)) for pull in (acc, with_gyro_error, linked)]
    n = sum(len(pull) for pull in acc)
    linked_rms = measured(rms[2], 1.0 / np.sqrt(2 * n))
    return [
        RmsPull(acc=of_acc, acc_with_gyro_error=with_error, linked=of_linked, n=n)
        for of_acc, with_error, of_linked in zip(*rms[:2], linked_rms, strict=True)
    ]


def root_mean_nees(runs: Sequence[Trials], predicted: Sequence[Covariances]) -> Measured:
    """Root of the mean normalised estimation error squared over its 14 degrees of freedom, all noises of Fig. 5."""
    pairs = zip(runs, predicted, strict=True)
    square = np.concatenate(
        [normalised_squares(trials.of("linked", "error"), covariance.linked) for trials, covariance in pairs]
    )
    unknowns = len(predicted[0].linked)
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
            "fig5_distortion": panel("residual_distortion_px", "Largest residual distortion"),
            "fig5_line_of_sight": panel("line_of_sight_arcsec", "Line of sight, RMS error"),
        },
    ),
    "methods": Section(
        record=NormalisedErrors,
        dim="method",
        caption="Errors of the methods of Fig. 5 per pixel of star noise, for all noise values together.",
        note="Line of sight: RMS over the detector after the best rotation.",
        verdicts=[
            ratio_near(
                "ratio_to_expected",
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
        record=RmsPull,
        dim="unknown",
        caption="RMS pull (error over predicted standard deviation) of the 14 unknowns; expected 1.",
    ),
    "nees": Section(
        record=Nees,
        verdicts=[
            ratio_near(
                "root_mean_nees",
                within=0.03,
                title="errors of the 14 unknowns over their covariance (NEES), gyro weighted by its noise",
                advice="a bias or a wrong covariance: check that the calibrations converged",
            )
        ],
    ),
}
