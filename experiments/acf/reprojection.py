"""Fig. 3 and 4 of ACF17: stars of the even frames, free of noise, reprojected with a calibration from the odd ones.

The expectation comes from the design alone: star noise and gyro error carried through eq. 11 to the even frames, where
the gyro's error counts a second time. For a perfect gyro and even frames like the odd ones it is sigma sqrt(14 / n),
with the n stars that calibrate, for any camera; so the published RMS tells the number of stars.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from calib.calibration.linked_design import Reprojection, reprojections, stars_of_reprojection
from experiments.acf.settings import CameraConfig, Config
from experiments.acf.trials import Point, Trials, gyro_drift, sky_of, table1_gyro
from experiments.harness.drawings import curves
from experiments.harness.sections import Section, col, ratio_near
from experiments.harness.summary import Measured, measured
from optics.arrays import FloatArray

FIG4_RMS_PX = np.array([0.0132, 0.0123])
"""ACF17 Fig. 4: RMS reprojection error, x and y, for 0.1 px of star noise and the gyro of Table 1."""
FIG4_LARGEST_PX = 0.04
"""ACF17 Fig. 4: all reprojection errors are below."""
"""Pixel and stars of the settings, and as implied by Table 2 (`experiments.acf.table2.implied`)."""

Row = Sequence[Measured]


def fig3_points(config: Config) -> list[Point]:
    """One point per noise; gyros: perfect, then the biases, then the random walks."""
    gyros = [(0.0, 0.0)]
    gyros += [(bias, 0.0) for bias in config.bias_deg_per_h]
    gyros += [(0.0, walk) for walk in config.angle_random_walk_deg_per_sqrt_h]
    same: dict[str, Any] = {"runs": config.runs, "gyro": tuple(gyros), "methods": ("acc",)}
    return [Point(name=f"fig3 {noise:g} px", noise_px=noise, **same) for noise in config.noise_px]


def table2_point(config: Config) -> Point:
    """Table 2 and Fig. 4: the gyro of Table 1, then a perfect one."""
    return Point(
        name="table2",
        runs=config.runs,
        noise_px=config.table_noise_px,
        gyro=(table1_gyro(config), (0.0, 0.0)),
        methods=("acc",),
        keep_reprojections=True,
    )


def inferred_point(config: Config, pixel_um: float, stars: int) -> Point:
    """Fig. 4 with another pixel and number of stars."""
    gyro = (table1_gyro(config),)
    return replace(table2_point(config), name="inferred", gyro=gyro, stars=stars, pixel_um=pixel_um)


def counts_points(config: Config) -> list[Point]:
    """One point per number of stars in every frame; a perfect gyro, then that of Table 1."""
    return [
        Point(
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
    """Root of a mean of squares, and its standard error."""
    rms = np.sqrt(square.mean(axis))
    return rms, square.std(axis, ddof=1) / np.sqrt(square.shape[axis]) / (2.0 * rms)


def expected_at(config: Config, point: Point, gyro: int, noises_px: Sequence[float] = ()) -> list[Reprojection]:
    """Expectation for the stars of a point, at its noise or at several."""
    sky, pair = sky_of(config, point, 0), point.gyro[gyro]
    error = gyro_drift(sky.scene, pair) if any(pair) else None
    return reprojections(sky.calibrating, sky.judging, noises_px or [point.noise_px], error)


def lengths(trials: Trials, gyro: int) -> FloatArray:
    """RMS length of the reprojection errors of every run."""
    return np.asarray(np.sqrt(trials.of("acc", "reprojection_px2", gyro).sum(-1)))


def mean_length(trials: Trials, gyro: int) -> Measured:
    """Mean of the runs' RMS lengths."""
    length = lengths(trials, gyro)
    error = float(length.std(ddof=1) / np.sqrt(len(length)))
    return Measured(value=float(length.mean()), unit="px", uncertainty=error, n=len(length))


@dataclass(frozen=True, slots=True, kw_only=True)
class ByBias:
    """Fig. 3a: random walk zero."""

    rms_px: Sequence[Row] = col("RMS reprojection error", "px", ".4f", "noise bias")
    expected_px: FloatArray = col("Expected", "px", ".4f", "noise bias")
    n: int = col("Runs", shown=False)


@dataclass(frozen=True, slots=True, kw_only=True)
class ByWalk:
    """Fig. 3b: bias zero."""

    rms_px: Sequence[Row] = col("RMS reprojection error", "px", ".4f", "noise walk")
    expected_px: FloatArray = col("Expected", "px", ".4f", "noise walk")
    n: int = col("Runs", shown=False)


def fig3(config: Config, trials: Mapping[str, Trials]) -> tuple[ByBias, ByWalk]:
    """Mean RMS reprojection error by noise and gyro; all noises see the same stars."""
    points = fig3_points(config)
    by_gyro = [expected_at(config, points[0], k, config.noise_px) for k in range(len(points[0].gyro))]
    perfect, biases = 0, len(config.bias_deg_per_h)

    def part(record: Any, gyros: Sequence[int]) -> Any:
        return record(
            rms_px=[[mean_length(trials[point.name], k) for k in gyros] for point in points],
            expected_px=np.array([[by_gyro[k][s].mean_px for k in gyros] for s in range(len(points))]),
            n=config.runs,
        )

    walks = range(1 + biases, len(points[0].gyro))
    return part(ByBias, range(1 + biases)), part(ByWalk, [perfect, *walks])


@dataclass(frozen=True, slots=True, kw_only=True)
class Fig4:
    """Reprojection errors at the noise of Table 2, with the gyro of Table 1."""

    pixel_um: float = col("Pixel", "um", ".2f")
    stars: float = col("Stars", "per frame", ".0f")
    rms_px: Row = col("RMS", "px", dims="axis")
    expected_axis_px: FloatArray = col("Expected", "px", ".4f", "axis")
    published_px: FloatArray | None = col("Published", "px", ".4f", "axis", default=None)
    length_px: Measured = col("Length", "px")
    expected_px: Measured = col("Expected, one run", "px")
    published_length_px: float | None = col("Published", "px", ".4f", default=None)
    published_deviation: float | None = col("Published from expected", "sigma", "+.1f", shown=False, default=None)
    largest_px: float = col("Largest, median", "px", ".4f", shown=False)
    inside: float = col("Fraction below 0.04 px", "", ".3f", shown=False)


def fig4(config: Config, trials: Mapping[str, Trials], inferred: Point) -> list[Fig4]:
    """Fig. 4 with assumed and with inferred pixel and stars; published numbers for the camera of ACF17 only."""
    cases = []
    for point in (table2_point(config), inferred):
        (expected,), runs = expected_at(config, point, 0), trials[point.name]
        rms, error = root_mean_square(runs.of("acc", "reprojection_px2"), 0)
        length = np.hypot(*np.moveaxis(runs.of("acc", "reprojected_px"), 2, 0))
        published = float(np.hypot(*FIG4_RMS_PX))
        of_document: dict[str, Any] = {
            "published_px": FIG4_RMS_PX,
            "published_length_px": published,
            "published_deviation": (published - expected.mean_px) / expected.scatter_px,
        }
        sky = sky_of(config, point, 0)
        cases.append(
            Fig4(
                pixel_um=point.pixel_um or config.camera.pixel_pitch_um,
                stars=point.stars or len(sky.stars) / config.frames,
                rms_px=measured(rms, error),
                expected_axis_px=expected.axis_px,
                length_px=mean_length(runs, 0),
                expected_px=Measured(value=expected.mean_px, uncertainty=expected.scatter_px),
                largest_px=float(np.median(length.max(1))),
                inside=float((length < FIG4_LARGEST_PX).mean()),
                **(of_document if config.camera == CameraConfig() else {}),
            )
        )
    return cases


@dataclass(frozen=True, slots=True, kw_only=True)
class Count:
    """Mean RMS length for a number of stars in every frame."""

    stars: int = col("Stars per frame")
    rms_px: Row = col("RMS reprojection error", "px", dims="count_gyro")
    expected_px: FloatArray = col("Expected", "px", ".4f", "count_gyro")


def counts(config: Config, trials: Mapping[str, Trials]) -> list[Count]:
    """Reprojection error by stars per frame, perfect gyro and that of Table 1."""
    rows = []
    for point in counts_points(config):
        expected = [expected_at(config, point, k)[0] for k in range(len(point.gyro))]
        rows.append(
            Count(
                stars=point.stars or 0,
                rms_px=[mean_length(trials[point.name], k) for k in range(len(expected))],
                expected_px=np.array([one.mean_px for one in expected]),
            )
        )
    return rows


@dataclass(frozen=True, slots=True, kw_only=True)
class Overall:
    """All cells of Fig. 3 and of the star counts together."""

    reprojection_ratio: Measured = col("Reprojection error over its prediction, mean of all cells")


def overall(config: Config, trials: Mapping[str, Trials]) -> Overall:
    """Mean over points of the mean over gyros: gyros of a point see the same star noise, points have their own."""
    means, variances, runs = [], [], 0
    for point in (*fig3_points(config), *counts_points(config)):
        gyros = range(len(point.gyro))
        expected = [expected_at(config, point, k)[0].mean_px for k in gyros]
        ratio = np.mean([lengths(trials[point.name], k) / expected[k] for k in gyros], axis=0)
        means.append(float(ratio.mean()))
        variances.append(float(ratio.var(ddof=1)) / len(ratio))
        runs += len(ratio)
    error = float(np.sqrt(np.sum(variances))) / len(means)
    return Overall(reprojection_ratio=Measured(value=float(np.mean(means)), uncertainty=error, n=runs))


@dataclass(frozen=True, slots=True, kw_only=True)
class Matching:
    """Stars per frame for which the expected RMS is the published one, at one pixel."""

    pixel_um: float = col("Pixel", "um", ".2f")
    closed_form: float = col("Stars, perfect gyro", "per frame", ".0f")  # From sigma sqrt(14 / n)
    with_gyro: float = col("Stars, Table 1's gyro", "per frame", ".0f")  # Infinite where the gyro alone gives more
    gyro_px: float = col("Error by the gyro alone", "px", ".4f")
    # Between these the published value lies within one standard deviation of a run; NaN if nowhere
    range: FloatArray = col("Stars within one sigma of a run", "per frame", ".0f", "end")


def matching_stars(config: Config, pixel_um: float, stars: int = 40) -> Matching:
    """Solve for the number of stars: their part of the mean square is proportional to 1 / n, the gyro's is not."""
    sigma_px, pair = config.table_noise_px, table1_gyro(config)
    point = Point(name="", runs=0, noise_px=sigma_px, gyro=(pair,), methods=(), stars=stars, pixel_um=pixel_um)
    sky = sky_of(config, point, 0)
    tried = np.geomspace(5.0, 125.0, 25)
    expected = expected_at(config, point, 0, [sigma_px * float(np.sqrt(stars / n)) for n in tried])
    wanted_px2 = float(FIG4_RMS_PX @ FIG4_RMS_PX)
    drift = gyro_drift(sky.scene, pair)
    factor, gyro_px2 = stars_of_reprojection(sky.calibrating, sky.judging, sigma_px, drift, wanted_px2)
    within = tried[[abs(np.sqrt(wanted_px2) - one.mean_px) < one.scatter_px for one in expected]]
    return Matching(
        pixel_um=pixel_um,
        closed_form=14.0 * sigma_px**2 / wanted_px2 / ((config.frames + 1) // 2),
        with_gyro=stars * factor,
        gyro_px=float(np.sqrt(gyro_px2)),
        range=within[[0, -1]] if len(within) else np.full(2, np.nan),
    )


def fig3_section(record: type, part: str, gyro: str, words: str) -> Section:
    """Section of Fig. 3a or 3b."""
    return Section(
        record=record,
        table=part,
        caption=f"ACF17 {words}: mean RMS reprojection error of the runs.",
        figures={
            f"{part}_curves": curves(
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
    "fig3a": fig3_section(ByBias, "fig3a", "bias", "Fig. 3a"),
    "fig3b": fig3_section(ByWalk, "fig3b", "walk", "Fig. 3b"),
    "fig4": Section(
        record=Fig4,
        dim="case",
        across="axis",
        columns="pixel_um stars rms_px expected_axis_px published_px",
        caption="ACF17 Fig. 4: reprojection of noise-free even frames, noise of its Table 2, gyro of its Table 1.",
        note="RMS over all runs, by axis. Inferred: pixel pitch and star count implied by ACF17 Table 2. The "
        "published RMS is of a single run with a standard deviation of some 15 %: it cannot detect "
        "an error of 25 % and is not judged.",
    ),
    "counts": Section(
        record=Count,
        dim="count",
        along="stars",
        caption="Mean RMS reprojection error at the noise of ACF17 Table 2 against the number of stars in every frame.",
    ),
    "reprojection": Section(
        record=Overall,
        verdicts=[
            ratio_near(
                "reprojection_ratio",
                within=0.03,
                title="Fig. 3 and star counts: mean reprojection error over its prediction",
                advice="check that every calibration converged, or raise runs",
            )
        ],
    ),
    "matching": Section(record=Matching, dim="pixel"),
}
