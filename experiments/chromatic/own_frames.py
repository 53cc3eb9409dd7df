"""Chromatic error of a laboratory's own frames (ACC18 eq. 13-16): every series is a filter at a place of the field."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from experiments.harness.pivot import Pivot
from experiments.harness.plotting import PALETTE, new_figure
from experiments.harness.quantities import Outcome, Quantities
from experiments.laboratory import point_figures
from experiments.laboratory.bench import band_pairs
from experiments.laboratory.chromatic_error import after_calibration, rms, shifts, table1
from experiments.laboratory.own_frames.experiment import FramesTest
from experiments.laboratory.own_frames.folder import FrameFolder
from experiments.laboratory.own_frames.series import SeriesFrames, reduce_series
from experiments.laboratory.own_frames.settings import SETTINGS_FILE, Layout
from optics.arrays import FloatArray
from optics.errors import ConfigError

__all__ = ["FilterFrames", "own_frames", "reduce"]


@dataclass(frozen=True, slots=True, kw_only=True)
class FilterFrames:
    """Positions of j points at p places behind b filters."""

    pixel_arcsec: float  # Angle of a pixel
    centre_px: FloatArray  # (2,) Middle of the frames, or what the folder says
    # Central wavelengths, rising; ``reference`` indexes the one the others are compared with
    filters_nm: tuple[float, ...]
    reference: int  # See ``filters_nm``
    grid: tuple[tuple[SeriesFrames, ...], ...]  # Place by place, filter by filter

    @property
    def series(self) -> tuple[SeriesFrames, ...]:
        """All of them, place by place."""
        return tuple(one for row in self.grid for one in row)

    @property
    def pairs(self) -> list[tuple[str, int, int]]:
        """Differences between the filters (`experiments.laboratory.bench.band_pairs`)."""
        return band_pairs(self.filters_nm, self.reference)

    def mean_px(self, method: str) -> FloatArray:
        """Mean centroids (p, j, b, 2)."""
        return np.stack([np.stack([one.points.mean_px(method) for one in row], axis=1) for row in self.grid])

    def shift_px(self, method: str) -> dict[str, FloatArray]:
        """Shifts (p, j, 2) of every pair (eq. 15)."""
        return shifts(self.mean_px(method), self.pairs)

    def shift_sigma_px(self, method: str) -> dict[str, FloatArray]:
        """Standard deviations (p, j, 2) of the shifts by the noise model; what both filters share cancels."""
        found = {}
        for name, high, low in self.pairs:
            rows = []
            for row in self.grid:
                temporal = sum(row[b].predicted_px(method) ** 2 / row[b].frames for b in (high, low))
                fixed = ((row[high].pattern_px - row[low].pattern_px) ** 2).sum((2, 3))
                rows.append(np.sqrt(temporal + fixed))
            found[name] = np.stack(rows)
        return found

    def residual_px(self, method: str, pair: str) -> dict[str, float]:
        """RMS length of the shifts of a pair, as found and with camera parameters of its own for the filter."""
        place = self.mean_px(method)[:, :, self.reference] - self.centre_px
        left = after_calibration(self.shift_px(method)[pair], place)
        return {step: float(np.linalg.norm(rms(values))) for step, values in left.items()}


def reduce(folder: FrameFolder, methods: Sequence[str], config: Any) -> FilterFrames:
    """Chromatic error of a folder in which every place is seen through every filter once."""
    found: dict[tuple[str, float], SeriesFrames] = {}
    for one in folder.series:
        key = (one.settings.place, float(one.settings.filter_nm or 0.0))
        if key in found:
            raise ConfigError(
                f"{SETTINGS_FILE}: {found[key].name} and {one.name} are both of {key[1]:g} nm at place {key[0]!r}; "
                "one series for every filter and place is needed, with all its files"
            )
        found[key] = reduce_series(folder, one, methods)
    places, filters = list(dict.fromkeys(place for place, _ in found)), sorted({nm for _, nm in found})
    missing = [(place, nm) for place in places for nm in filters if (place, nm) not in found]
    if missing:
        raise ConfigError(
            f"{SETTINGS_FILE}: no series of {missing[0][1]:g} nm at place {missing[0][0]!r}; every place must be seen "
            f"through every filter ({', '.join(f'{nm:g}' for nm in filters)} nm)"
        )
    if len(filters) < 2:
        raise ConfigError(f"{SETTINGS_FILE}: one filter, {filters[0]:g} nm; at least two are needed for a difference")
    reference = folder.settings.reference_nm or config.filters.reference_nm
    if reference not in filters:
        raise ConfigError(
            f"{SETTINGS_FILE}: the reference filter, {reference:g} nm, is none of those of the series "
            f"({', '.join(f'{nm:g}' for nm in filters)} nm); give reference_nm"
        )
    return FilterFrames(
        pixel_arcsec=folder.settings.pixel_arcsec,
        centre_px=folder.centre_px,
        filters_nm=tuple(filters),
        reference=filters.index(reference),
        grid=tuple(tuple(found[place, nm] for nm in filters) for place in places),
    )


def _describe(q: Quantities, reduced: FilterFrames, methods: Sequence[str]) -> None:
    names = [name for name, _, _ in reduced.pairs]
    q.axis("pair", names, "Pair")
    q.axis("step", ["as found", "principal point", "focal length", "both"], "Calibration of the band")
    q.add("filters_nm", list(reduced.filters_nm), "Filters", unit="nm", dims="filter")
    sigma = reduced.shift_sigma_px(methods[0])
    count = sigma[names[0]][..., 0].size
    error = [np.sqrt((sigma[n] ** 2).sum((0, 1))) / (2 * count) for n in names]
    every = {m: reduced.shift_px(m) for m in methods}
    found = np.array([[table1(every[m][n]) for n in names] for m in methods])
    q.add(
        "table1_px",
        found[0],
        "Mean shift, halved",
        unit="px",
        dims="pair axis",
        error=error,
        n=count,
        json="table1_px[pair][axis]",
    )
    q.add("method_table1_px", found, "Mean shift, halved", unit="px", dims="method pair axis", format=".4f")
    residual = [list(reduced.residual_px(methods[0], n).values()) for n in names]
    q.add("residual_px", residual, "RMS length", unit="px", dims="pair step", format=".4f")
    mean = reduced.mean_px(methods[0])[:, :, reduced.reference].reshape(-1, 2)
    q.axis("point", np.arange(len(mean)) + 1, "Point")
    points = {"unit": "px", "format": ".4f"}
    q.add("place_px", mean, "Place", **points, dims="point axis", key="{axis}_px", json="")
    values = np.stack([every[methods[0]][n].reshape(-1, 2) for n in names])
    errors = np.stack([sigma[n].reshape(-1, 2) for n in names])
    q.add("shift_px", values, "Shift", **points, dims="pair point axis", error=errors, key="shift_{axis}_px", json="")


def _headline(outcome: Outcome) -> Mapping[str, Any]:
    return {
        f"{pair} nm, {axis}: mean shift, halved": outcome.quantity("table1_px", pair=pair, axis=axis)
        for pair in outcome.data["pair"].values.tolist()
        for axis in "xy"
    }


def _tables(outcome: Outcome) -> Mapping[str, Pivot]:
    return {"table1": _TABLE1, "calibration": _CALIBRATION, "centroiders": _CENTROIDERS, "points": _POINTS}


_TABLE1 = Pivot(
    rows="pair axis",
    columns="table1_px",
    caption="Mean shift between filters, halved (ACC18 Table 1, eq. 16).",
    note="One standard deviation, by the stated noise. A shift that is the same everywhere is that of the lens, of a "
    "wedge of the filters, or of a target that moved between two series: frames cannot tell.",
)
_CALIBRATION = Pivot(
    rows="pair",
    across="step",
    columns="residual_px",
    caption="RMS length of the shift of a point, as found and with camera parameters of its own for each band.",
    note="Noise of the centroids included.",
)
_CENTROIDERS = Pivot(
    rows="method", across="pair axis", columns="method_table1_px", caption="The same frames through every centroider."
)
_POINTS = Pivot(rows="pair point", across="axis", columns="place_px shift_px", caption="All points.")


def _arrows(outcome: Outcome) -> Figure:
    """Shifts of every pair as arrows over the detector."""
    reduced, folder, pairs = outcome.result.reduced, outcome.result.folder, outcome.data["pair"].values.tolist()
    figure, axes = new_figure(1, len(pairs), aspect_ratio=0.5, sharey=True)
    for panel, pair in zip(np.atleast_1d(axes), pairs, strict=True):
        error, reach = outcome.values("shift_px", pair=pair) * reduced.pixel_arcsec, 0.09 * folder.width_px
        place = outcome.values("place_px")
        longest = point_figures.arrows(panel, place, error, longest_px=reach, color=PALETTE[0], width=0.005)
        point_figures.detector_outline(panel, folder.width_px, folder.height_px)
        panel.set(xlabel="column [px]", title=f"{pair} nm: longest {longest:.2f}″")
    np.atleast_1d(axes)[0].set_ylabel("row [px]")
    return figure


own_frames = FramesTest(
    title="Chromatic error",
    layout=Layout(needs=("filter_nm",), same_scene="place"),
    reduce=reduce,
    describe=_describe,
    headline=_headline,
    tables=_tables,
    figures={"shifts": (_arrows, "Shift of every point between two filters.")},
    show=("table1",),
)
