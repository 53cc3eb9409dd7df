"""Sequence of the reduction of own frames: folder, centroids of every series, consistency checks, method.

No rendering, no truth. Sections common to all methods are here; a method adds its own (`FramesTest`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from calib.accuracy.frame_sequence import FEWEST_FOR_LAG
from experiments.harness.drawings import cloud
from experiments.harness.experiment import Experiment
from experiments.harness.progress import Progress
from experiments.harness.quantities import Outcome, Quantities, Quantity, positions
from experiments.harness.sections import Section, above, col, judged
from experiments.laboratory.bench.centroid_methods import MethodLabels, needs_epsf
from experiments.reduce.checks import CHECKS, check_frames
from experiments.reduce.folder import FrameFolder, read_folder
from experiments.reduce.frames_toml import FolderLayout
from experiments.reduce.series import SeriesFrames
from optics.arrays import FloatArray
from optics.errors import ConfigError

Reduced = tuple[Sequence[SeriesFrames], Mapping[str, Any]]


@dataclass(frozen=True, slots=True, kw_only=True)
class FramesTest:
    """Reduction of own frames by a method."""

    title: str  # Title of the report
    layout: FolderLayout  # Requirements on a folder
    # ``reduce(folder, methods, config)``: centroids of the series, records of the sections of the method
    reduce: Callable[[FrameFolder, Sequence[str], Any], Reduced]
    sections: Mapping[str, Section]
    # Numbers at the head of the report: label -> (quantity, coordinates or positions along some dimensions)
    head: Mapping[str, tuple[str, Mapping[str, Any]]]
    captions: Mapping[str, str] = field(default_factory=dict)  # Captions of the figures by name
    series: str = "Series"  # Label of the axis of the series

    def run(self, config: Any, *, progress: Progress) -> dict[str, Any]:
        """Read the folder of the configuration, centroid its frames, reduce and judge them."""
        with progress.stage("read"):
            folder = read_folder(config.own_frames, window_px=config.window_px, layout=self.layout)
        main = () if folder.settings.centroid is None else (folder.settings.centroid,)
        requested = dict.fromkeys((*main, *getattr(config, "methods", ("gaussian",))))
        methods = tuple(method for method in requested if not needs_epsf(method))
        if not methods:
            raise ConfigError("own frames have no PSF: use a centroid other than epsf, e.g. gaussian")
        with progress.stage("reduce"):
            series, records = self.reduce(folder, methods, config)
        with progress.stage("check"):
            checks = check_frames(folder, series, methods[0])
        return {
            "folder": describe_folder(self, folder, series, methods),
            "series": [
                Series(
                    series_name=centroids.name,
                    frames=centroids.frames,
                    effective_frames=centroids.effective_frames,
                    signal_e=centroids.signal_e,
                    usable_fraction=centroids.usable_fraction,
                )
                for centroids in series
            ],
            "checks": checks,
            **records,
        }

    def experiment(self, rendered: Experiment) -> Experiment:
        """The experiment on own frames in place of rendered ones."""
        return Experiment(
            name=rendered.name,
            config=rendered.config,
            run=self.run,
            sections=self.parts,
            report=Path(__file__).with_name("report.md"),
            renders=lambda _: False,
            judged="reduction",
            show=self.tables[:1],
        )

    def parts(self, result: Mapping[str, Any]) -> dict[str, Section]:
        """Common sections and its own, whose first table has a note on short series."""
        sections = dict(self.sections)
        main = next(name for name, section in sections.items() if section.table_name(name))
        if "folder" in result and (remark := result["folder"].few_text):
            sections[main] = replace(sections[main], note=f"{remark} {sections[main].note}".strip())
        return {**COMMON, **sections}

    def wrong(self, outcome: Outcome) -> list[str]:
        """Faults, each cause once: advice of the criteria that do not hold, or their names."""
        criteria = judged(self.parts(outcome.result), outcome)
        causes = [criterion.advice or criterion.name for criterion in criteria if criterion.failed]
        return [cause for n, cause in enumerate(causes) if not any(earlier in cause for earlier in causes[:n])]

    @property
    def tables(self) -> list[str]:
        """Names of the tables of its sections, the main one first."""
        return [title for name, section in self.sections.items() if (title := section.table_name(name))]

    def headline(self, outcome: Outcome) -> dict[str, Quantity]:
        """Label -> number, for the head of the report, one for each element of the other dimensions."""
        numbers = {}
        for label, (name, selection) in self.head.items():
            named = {dim: key for dim, key in selection.items() if isinstance(key, str)}
            indexed = {dim: key for dim, key in selection.items() if not isinstance(key, str)}
            quantity = outcome.quantity(name, **named).at(**indexed)
            for index in positions(dict(zip(quantity.dims, quantity.values.shape, strict=True)), quantity.dims):
                names = [outcome.names(dim)[number] for dim, number in index.items()]
                numbers[", ".join([label, *names])] = quantity.at(**index)
        return numbers


@dataclass(frozen=True, slots=True, kw_only=True)
class Folder:
    """Contents of the folder, and treatment of its frames."""

    test: FramesTest
    methods: Sequence[str]  # Centroiders, the main one first
    names: Sequence[str]  # Names of the series
    source: str = col("Source", default="frames")
    points: int = col("Points")
    dark_frames: int = col("Dark frames")
    flat_frames: int = col("Flats")
    bad_pixels: int = col("Pixels of the bad-pixel map")
    frame_size_px: Sequence[int] = col("Size of a frame", "px", dims="side")
    pixel_arcsec: float = col("Angle of a pixel", "arcsec")
    fewest_frames: int = col("Frames of the shortest series")
    few_text: str = col("Remarks on the frames", shown=False)  # "" for `RECOMMENDED_FRAMES` or more
    prnu_fraction: float = col("Stated residual PRNU")
    # Without flats
    percent_px: float | None = col("Shift by a PRNU of 1 %", "px", ".4f", default=None)
    percent_over_noise: float | None = col("Over the noise of a mean", format=".2f", default=None)


RECOMMENDED_FRAMES = 30
"""Frames per series that ACC18 requires."""


def _short_series_remark(test: FramesTest, shortest: SeriesFrames) -> str:
    """Remark on series with fewer frames; poses are not judged by their number."""
    if test.layout.fewest < 2 or shortest.frames >= RECOMMENDED_FRAMES:
        return ""
    scatter = 100.0 / np.sqrt(2.0 * (shortest.frames - 1))
    return (
        f"Only {shortest.frames} frames in {shortest.name}, fewer than {RECOMMENDED_FRAMES}: the scatter of a point "
        f"is known to {scatter:.0f} %, and {'no' if shortest.frames < FEWEST_FOR_LAG else 'little'} drift or "
        "correlation of frames would be noticed."
    )


def describe_folder(
    test: FramesTest, folder: FrameFolder, series: Sequence[SeriesFrames], methods: Sequence[str]
) -> Folder:
    """Numbers of a folder; the effect of a missing flat is the largest over the series."""
    flat = folder.flat
    percent = np.array([centroids.percent_px for centroids in series])
    shortest = min(series, key=lambda centroids: centroids.frames)
    variance = [(centroids.predicted_px(methods[0]) ** 2).mean() / centroids.effective_frames for centroids in series]
    return Folder(
        test=test,
        methods=methods,
        names=[centroids.name for centroids in series],
        points=len(folder.series[0].detected_px),
        dark_frames=folder.dark_frames,
        flat_frames=0 if flat is None else flat.frames,
        bad_pixels=folder.bad_pixels,
        frame_size_px=[folder.width_px, folder.height_px],
        pixel_arcsec=folder.settings.pixel_arcsec,
        fewest_frames=shortest.frames,
        few_text=_short_series_remark(test, shortest),
        prnu_fraction=folder.settings.prnu_fraction,
        percent_px=float(percent.max()) if flat is None else None,
        percent_over_noise=float((percent / np.sqrt(variance)).max()) if flat is None else None,
    )


def _axes(quantities: Quantities, folder: Folder) -> None:
    quantities.axis("method", list(folder.methods), "Centroider", names=MethodLabels())
    quantities.axis("axis", ["x", "y"], "Axis")
    quantities.axis("series", np.arange(len(folder.names)) + 1, folder.test.series, names=folder.names)


@dataclass(frozen=True, slots=True, kw_only=True)
class Series:
    """Frames, signal and yield of a series."""

    series_name: str = col("Name", shown=False)
    frames: int = col("Frames")
    effective_frames: float = col("Independent", format=".1f")
    signal_e: float = col("Signal", "e-", ".0f")
    usable_fraction: float = col("Usable", format=".3f")


COMMON = {
    "folder": Section(record=Folder, axes=_axes),
    "series": Section(
        record=Series,
        dim="series",
        caption="Frames, equivalent independent frames, mean electrons in a window, smallest fraction of "
        "frames with a position.",
        verdicts=[
            above(
                "usable_fraction",
                0.9,
                title="fraction of frames with a position, smallest over points and centroiders",
                advice="points are too faint for this centroider, or windows too small for the spot",
            )
        ],
    ),
    "checks": CHECKS,
}


@dataclass(frozen=True, slots=True, kw_only=True)
class TargetPoint:
    """A target point in the last series, first centroider."""

    mean_px: FloatArray = col("Mean", "px", ".4f", "axis")
    sigma_px: FloatArray = col("σ", "px", ".4f", "axis")


@dataclass(frozen=True, slots=True, kw_only=True)
class Cloud:
    """Centroids of the last series about the mean of each point, first centroider."""

    deviation_arcsec: FloatArray = col("Centroids about their mean", "arcsec", dims="frame point axis")


def tabulate_points(folder: FrameFolder, series: SeriesFrames, method: str) -> dict[str, Any]:
    """Records of the sections `POINTS`."""
    points = series.points
    position_px = points.position_px[method]
    rows = zip(points.mean_px(method), points.sigma_px(method), strict=True)
    deviation_px = position_px - np.nanmean(position_px, axis=0)
    return {
        "points": [TargetPoint(mean_px=mean, sigma_px=sigma) for mean, sigma in rows],
        "cloud": Cloud(deviation_arcsec=folder.settings.pixel_arcsec * deviation_px),
    }


POINTS = {
    "points": Section(
        record=TargetPoint,
        dim="point",
        across="axis",
        caption="Centroids of the last series, first centroider; σ of a single frame.",
    ),
    "cloud": Section(record=Cloud, figures={"cloud": cloud("deviation_arcsec")}),
}
POINTS_CAPTION = {"cloud": "All frames of all points about the mean of each point, last series."}
