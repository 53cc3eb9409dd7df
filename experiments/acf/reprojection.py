"""Fig. 3 and 4 of ACF17: stars of the even frames, free of noise, reprojected with a calibration from the odd ones.

The expectation propagates star noise and gyro error through eq. 11 to the even frames, where the gyro's error enters a
second time. For an error-free gyro and even frames like the odd ones it is sigma sqrt(14 / n) with 14
unknowns and n stars that calibrate, for any camera; the published RMS therefore implies the number of stars.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from calib.calibration.linked_design import Reprojection, reprojections, stars_of_reprojection
from experiments.acf.settings import AcfCameraConfig, AcfConfig
from experiments.acf.trials import TrialPoint, Trials, gyro_drift, sky_of, table1_gyro
from experiments.harness.drawings import curves
from experiments.harness.sections import Section, col, ratio_near
from experiments.harness.summary import Measured, measured
from optics.arrays import FloatArray

FIG4_RMS_PX = np.array([0.0132, 0.0123])
"""ACF17 Fig. 4: RMS reprojection error, x and y, for 0.1 px of star noise and the gyro of Table 1."""
N_UNKNOWNS = 14
"""Eight parameters of the camera, three angles of the first attitude, three of the installation. With design matrix B
of n stars and C = sigma^2 (B^T B)^-1, the mean square reprojection error is tr(B C B^T) / n = 14 sigma^2 / n."""
FIG4_LARGEST_PX = 0.04
"""ACF17 Fig. 4: all reprojection errors are below."""


def fig3_points(config: AcfConfig) -> list[TrialPoint]:
    """One point per noise; gyros: perfect, then the biases, then the random walks."""
    gyros = [(0.0, 0.0)]
    gyros += [(bias, 0.0) for bias in config.bias_deg_per_h]
    gyros += [(0.0, walk) for walk in config.angle_random_walk_deg_per_sqrt_h]
    return [
        TrialPoint(name=f"fig3 {noise:g} px", runs=config.runs, noise_px=noise, gyro=tuple(gyros), methods=("acc",))
        for noise in config.noise_px
    ]


def table2_point(config: AcfConfig) -> TrialPoint:
    """Table 2 and Fig. 4: the gyro of Table 1, then a perfect one."""
    return TrialPoint(
        name="table2",
        runs=config.runs,
        noise_px=config.table_noise_px,
        gyro=(table1_gyro(config), (0.0, 0.0)),
        methods=("acc",),
        keep_reprojection_errors=True,
    )


def inferred_point(config: AcfConfig, pixel_um: float, stars: int) -> TrialPoint:
    """Fig. 4 with the pixel and the number of stars inferred from ACF17's Table 2."""
    gyro = (table1_gyro(config),)
    return replace(table2_point(config), name="inferred", gyro=gyro, stars=stars, pixel_um=pixel_um)


def counts_points(config: AcfConfig) -> list[TrialPoint]:
    """One point per number of stars in every frame; a perfect gyro, then that of Table 1."""
    return [
        TrialPoint(
            name=f"counts {n}",
            runs=config.runs,
            noise_px=config.table_noise_px,
            gyro=((0.0, 0.0), table1_gyro(config)),
            methods=("acc",),
            stars=n,
        )
        for n in config.counts
    ]


def root_mean_square(square: FloatArray, axis: int) -> tuple[FloatArray, FloatArray]:
    """Root of the mean of squares m along an axis, and its standard error sigma(m) / (2 sqrt(m))."""
    rms = np.sqrt(square.mean(axis))
    return rms, square.std(axis, ddof=1) / np.sqrt(square.shape[axis]) / (2.0 * rms)


def expected_at(config: AcfConfig, point: TrialPoint, gyro: int, noises_px: Sequence[float] = ()) -> list[Reprojection]:
    """Expected reprojection error for the stars of a point, at its star noise or at each of several."""
    sky = sky_of(config, point, 0)
    noise = point.gyro[gyro]
    drift = gyro_drift(sky.scene, noise) if any(noise) else None
    return reprojections(sky.calibrating, sky.reprojected, noises_px or [point.noise_px], drift)


def rms_lengths(trials: Trials, gyro: int) -> FloatArray:
    """RMS length of the reprojection errors of every run."""
    return np.asarray(np.sqrt(trials.of("acc", "reprojection_px2", gyro).sum(-1)))


def mean_rms_length(trials: Trials, gyro: int) -> Measured:
    """Mean of the runs' RMS lengths."""
    length_px = rms_lengths(trials, gyro)
    error = float(length_px.std(ddof=1) / np.sqrt(len(length_px)))
    return Measured(value=float(length_px.mean()), unit="px", uncertainty=error, n=len(length_px))


@dataclass(frozen=True, slots=True, kw_only=True)
class ByBias:
    """Fig. 3a: random walk zero."""

    rms_px: Sequence[Sequence[Measured]] = col("RMS reprojection error", "px", ".4f", "noise bias")
    expected_px: FloatArray = col("Expected", "px", ".4f", "noise bias")
    n: int = col("Runs", shown=False)


@dataclass(frozen=True, slots=True, kw_only=True)
class ByWalk:
    """Fig. 3b: bias zero."""

    rms_px: Sequence[Sequence[Measured]] = col("RMS reprojection error", "px", ".4f", "noise walk")
    expected_px: FloatArray = col("Expected", "px", ".4f", "noise walk")
    n: int = col("Runs", shown=False)


def fig3(config: AcfConfig, trials: Mapping[str, Trials]) -> tuple[ByBias, ByWalk]:
    """Mean RMS reprojection error by noise and gyro, of the same stars at every noise."""
    points = fig3_points(config)
    by_gyro = [expected_at(config, points[0], k, config.noise_px) for k in range(len(points[0].gyro))]

    def panel(record: Any, gyros: Sequence[int]) -> Any:
        return record(
            rms_px=[[mean_rms_length(trials[point.name], k) for k in gyros] for point in points],
            expected_px=np.array([[by_gyro[k][s].mean_px for k in gyros] for s in range(len(points))]),
            n=config.runs,
        )

    first_walk = 1 + len(config.bias_deg_per_h)  # gyro 0 is perfect
    return panel(ByBias, range(first_walk)), panel(ByWalk, [0, *range(first_walk, len(by_gyro))])


@dataclass(frozen=True, slots=True, kw_only=True)
class Fig4:
    """Reprojection errors at the noise of Table 2, with the gyro of Table 1."""

    pixel_um: float = col("Pixel", "um", ".2f")
    stars_per_frame: float = col("Stars", "per frame", ".0f")
    rms_px: Sequence[Measured] = col("RMS", "px", dims="axis")
    expected_rms_px: FloatArray = col("Expected", "px", ".4f", "axis")
    published_rms_px: FloatArray | None = col("Published", "px", ".4f", "axis", default=None)
    rms_length_px: Measured = col("Length", "px")
    expected_rms_length_px: Measured = col("Expected, one run", "px")
    published_rms_length_px: float | None = col("Published", "px", ".4f", default=None)
    published_deviation_sigma: float | None = col("Published from expected", "sigma", "+.1f", shown=False, default=None)
    largest_px: float = col("Largest, median", "px", ".4f", shown=False)
    fraction_below_0_04_px: float = col("Fraction below 0.04 px", "", ".3f", shown=False)


def fig4(config: AcfConfig, trials: Mapping[str, Trials], inferred: TrialPoint) -> list[Fig4]:
    """Fig. 4 with assumed and with inferred pixel and stars; published numbers for the camera of ACF17 only."""
    cases = []
    for point in (table2_point(config), inferred):
        (expected,) = expected_at(config, point, 0)
        runs = trials[point.name]
        error_px = np.hypot(*np.moveaxis(runs.of("acc", "reprojection_error_px"), 2, 0))
        published_px = float(np.hypot(*FIG4_RMS_PX))
        published: dict[str, Any] = {
            "published_rms_px": FIG4_RMS_PX,
            "published_rms_length_px": published_px,
            "published_deviation_sigma": (published_px - expected.mean_px) / expected.scatter_px,
        }
        sky = sky_of(config, point, 0)
        cases.append(
            Fig4(
                pixel_um=point.pixel_um or config.camera.pixel_pitch_um,
                stars_per_frame=point.stars or len(sky.stars) / config.frames,
                rms_px=measured(*root_mean_square(runs.of("acc", "reprojection_px2"), 0)),
                expected_rms_px=expected.axis_px,
                rms_length_px=mean_rms_length(runs, 0),
                expected_rms_length_px=Measured(value=expected.mean_px, uncertainty=expected.scatter_px),
                largest_px=float(np.median(error_px.max(1))),
                fraction_below_0_04_px=float((error_px < FIG4_LARGEST_PX).mean()),
                **(published if config.camera == AcfCameraConfig() else {}),
            )
        )
    return cases


@dataclass(frozen=True, slots=True, kw_only=True)
class StarCountRow:
    """Mean RMS length for a number of stars in every frame."""

    stars_per_frame: int = col("Stars per frame")
    rms_px: Sequence[Measured] = col("RMS reprojection error", "px", dims="count_gyro")
    expected_px: FloatArray = col("Expected", "px", ".4f", "count_gyro")


def sweep_star_counts(config: AcfConfig, trials: Mapping[str, Trials]) -> list[StarCountRow]:
    """Reprojection error by stars per frame, for the gyros of `counts_points`."""
    return [
        StarCountRow(
            stars_per_frame=point.stars or 0,
            rms_px=[mean_rms_length(trials[point.name], k) for k in range(len(point.gyro))],
            expected_px=np.array([expected_at(config, point, k)[0].mean_px for k in range(len(point.gyro))]),
        )
        for point in counts_points(config)
    ]


@dataclass(frozen=True, slots=True, kw_only=True)
class PooledReprojectionRatio:
    """Reprojection error over its prediction, mean of all points of Fig. 3 and of the star counts."""

    ratio_to_expected: Measured = col("Reprojection error over its prediction, mean of all cells")


def pool_ratios(config: AcfConfig, trials: Mapping[str, Trials]) -> PooledReprojectionRatio:
    """Mean ratio over the points, each the mean over its gyros.

    The gyros of a point share their star noise, so that a run counts once; different points have independent noise, and
    the variances of their means add.
    """
    means, variances, runs = [], [], 0
    for point in (*fig3_points(config), *counts_points(config)):
        ratio = np.mean(
            [
                rms_lengths(trials[point.name], k) / expected_at(config, point, k)[0].mean_px
                for k in range(len(point.gyro))
            ],
            axis=0,
        )
        means.append(float(ratio.mean()))
        variances.append(float(ratio.var(ddof=1)) / len(ratio))
        runs += len(ratio)
    error = float(np.sqrt(np.sum(variances))) / len(means)
    return PooledReprojectionRatio(ratio_to_expected=Measured(value=float(np.mean(means)), uncertainty=error, n=runs))


@dataclass(frozen=True, slots=True, kw_only=True)
class StarCountFromPublishedRms:
    """Stars per frame at which the expected reprojection error is the published one, for one pixel pitch."""

    pixel_um: float = col("Pixel", "um", ".2f")
    stars_per_frame_perfect_gyro: float = col("Stars, perfect gyro", "per frame", ".0f")  # From sigma sqrt(14 / n)
    # With Table 1's gyro; infinite if the error by the gyro alone exceeds the published RMS
    stars_per_frame: float = col("Stars, Table 1's gyro", "per frame", ".0f")
    gyro_rms_px: float = col("Error by the gyro alone", "px", ".4f")
    # Interval in which expected and published RMS differ by less than the standard deviation of a run; NaN: empty
    stars_per_frame_range: FloatArray = col("Stars within one sigma of a run", "per frame", ".0f", "end")


def infer_star_count(config: AcfConfig, pixel_um: float, stars: int = 40) -> StarCountFromPublishedRms:
    """Solve published RMS^2 = a / n + b for n: a / n is the part of the star noise, b that of the gyro."""
    sigma_px = config.table_noise_px
    noise = table1_gyro(config)
    point = TrialPoint(name="", runs=0, noise_px=sigma_px, gyro=(noise,), methods=(), stars=stars, pixel_um=pixel_um)
    sky = sky_of(config, point, 0)
    published_px2 = float(FIG4_RMS_PX @ FIG4_RMS_PX)
    drift = gyro_drift(sky.scene, noise)
    factor, gyro_px2 = stars_of_reprojection(sky.calibrating, sky.reprojected, sigma_px, drift, published_px2)
    grid = np.geomspace(5.0, 125.0, 25)
    expected = expected_at(config, point, 0, [sigma_px * float(np.sqrt(stars / n)) for n in grid])
    within = grid[[abs(np.sqrt(published_px2) - rms.mean_px) < rms.scatter_px for rms in expected]]
    return StarCountFromPublishedRms(
        pixel_um=pixel_um,
        stars_per_frame_perfect_gyro=N_UNKNOWNS * sigma_px**2 / published_px2 / ((config.frames + 1) // 2),
        stars_per_frame=stars * factor,
        gyro_rms_px=float(np.sqrt(gyro_px2)),
        stars_per_frame_range=within[[0, -1]] if len(within) else np.full(2, np.nan),
    )


def fig3_section(panel: str, record: type, gyro: str) -> Section:
    """Section of panel "a" or "b" of Fig. 3."""
    return Section(
        record=record,
        table=f"fig3{panel}",
        caption=f"ACF17 Fig. 3{panel}: mean RMS reprojection error of the runs.",
        figures={
            f"fig3{panel}_curves": curves(
                "noise",
                points="rms_px",
                lines="expected_px",
                by=gyro,
                y="RMS reprojection error",
                width="half",
                aspect_ratio=0.9,
            )
        },
    )


REPROJECTION = {
    "fig3a": fig3_section("a", ByBias, "bias"),
    "fig3b": fig3_section("b", ByWalk, "walk"),
    "fig4": Section(
        record=Fig4,
        dim="case",
        across="axis",
        columns="pixel_um stars_per_frame rms_px expected_rms_px published_rms_px",
        caption="ACF17 Fig. 4: reprojection of noise-free even frames, noise of its Table 2, gyro of its Table 1.",
        note="RMS over all runs, by axis. Inferred: pixel pitch and star count implied by ACF17 Table 2. The "
        "published RMS is of a single run with a standard deviation of some 15 %: it cannot detect "
        "an error of 25 % and is not judged.",
    ),
    "counts": Section(
        record=StarCountRow,
        dim="count",
        along="stars_per_frame",
        caption="Mean RMS reprojection error at the noise of ACF17 Table 2 against the number of stars in every frame.",
    ),
    "reprojection": Section(
        record=PooledReprojectionRatio,
        verdicts=[
            ratio_near(
                "ratio_to_expected",
                within=0.03,
                title="Fig. 3 and star counts: mean reprojection error over its prediction",
                advice="check that every calibration converged, or raise runs",
            )
        ],
    ),
    "matching": Section(record=StarCountFromPublishedRms, dim="pixel"),
}
