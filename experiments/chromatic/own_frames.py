"""Chromatic error of a laboratory's own frames (ACC18 eq. 13-16): every series is a filter at a place of the field."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from calib.accuracy.chromatic import CALIBRATIONS, after_calibration, band_pairs, rms_shift_px, shifts, table1
from calib.accuracy.filter_wedge import exchanged_filters, separate_wedge, spot_radius_px
from experiments.harness.drawings import arrows
from experiments.harness.quantities import Outcome, Quantities
from experiments.harness.sections import Section, below, col
from experiments.harness.summary import Measured, measured
from experiments.reduce.folder import FrameFolder
from experiments.reduce.frames_toml import SETTINGS_FILE, FolderLayout
from experiments.reduce.pipeline import FramesTest, Reduced
from experiments.reduce.series import SeriesFrames, reduce_series
from optics.arrays import FloatArray
from optics.errors import ConfigError


@dataclass(frozen=True, slots=True, kw_only=True)
class Pair:
    """Difference between two filters, first centroider."""

    pair_name: str = col("Pair")
    table1_px: Sequence[Measured] = col("Mean shift, halved", "px", dims="axis")
    shift_arcsec: FloatArray = col("Shift", "arcsec", ".3f", "point axis", shown=False)


@dataclass(frozen=True, slots=True, kw_only=True)
class Residual:
    """RMS length of the shifts of a pair, as found and with camera parameters of its own for the filter."""

    residual_px: FloatArray = col("RMS length", "px", ".4f", "step")


@dataclass(frozen=True, slots=True, kw_only=True)
class Constant:
    """Uniform part of a pair's shift, first centroider: by the lens, and by the filters."""

    constant_px: Sequence[Measured] = col("Uniform part", "px", dims="axis")
    lens_px: Sequence[Measured] = col("by the lens", "px", dims="axis")
    wedge_px: Sequence[Measured] = col("by the filters", "px", dims="axis")
    told_text: str = col("Separated")


@dataclass(frozen=True, slots=True, kw_only=True)
class Exchange:
    """Exchanged files of filters."""

    said: Sequence[str]  # In words
    exchanged: int = col("Exchanged filters")


@dataclass(frozen=True, slots=True, kw_only=True)
class Centroider:
    """Results of a centroider on the same frames."""

    method_table1_px: FloatArray = col("Mean shift, halved", "px", ".4f", "pair axis")


@dataclass(frozen=True, slots=True, kw_only=True)
class Points:
    """Points of all places, first centroider."""

    filters_nm: Sequence[float] = col("Filters", "nm", dims="filter", shown=False)
    place_px: FloatArray = col("Place", "px", ".4f", "point axis")
    shift_px: Sequence[Sequence[Sequence[Measured]]] = col("Shift", "px", ".4f", "pair point axis")


@dataclass(frozen=True, slots=True, kw_only=True)
class FilterFrames:
    """Positions of j points at p places behind b filters."""

    # Central wavelengths, rising; ``reference`` indexes the one the others are compared with
    filters_nm: tuple[float, ...]
    reference: int  # See ``filters_nm``
    grid: tuple[tuple[SeriesFrames, ...], ...]  # Place by place, filter by filter

    @property
    def pairs(self) -> list[tuple[str, int, int]]:
        """Differences between the filters (`experiments.laboratory.bench.point_bench.band_pairs`)."""
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


def filter_frames(folder: FrameFolder, methods: Sequence[str], config: Any) -> FilterFrames:
    """Series by place and filter; every place must be seen through every filter once."""
    found: dict[tuple[str, float], SeriesFrames] = {}
    for one in folder.series:
        key = (one.settings.place, float(one.settings.filter_nm or 0.0))
        if key in found:
            raise ConfigError(
                f"{SETTINGS_FILE}: {found[key].name} and {one.name} both have filter {key[1]:g} nm and place "
                f"{key[0]!r}; a single series per filter and place is needed, with all its files"
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
        raise ConfigError(
            f"{SETTINGS_FILE}: only filter {filters[0]:g} nm; at least two filters are needed for a difference"
        )
    reference = folder.settings.reference_nm or config.filters.reference_nm
    if reference not in filters:
        raise ConfigError(
            f"{SETTINGS_FILE}: the reference filter, {reference:g} nm, does not occur in the series "
            f"({', '.join(f'{nm:g}' for nm in filters)} nm); give reference_nm"
        )
    return FilterFrames(
        filters_nm=tuple(filters),
        reference=filters.index(reference),
        grid=tuple(tuple(found[place, nm] for nm in filters) for place in places),
    )


def reduce(folder: FrameFolder, methods: Sequence[str], config: Any) -> Reduced:
    """Chromatic error of a folder; uncertainties by the stated noise."""
    seen, first, scale = filter_frames(folder, methods, config), methods[0], folder.settings.pixel_arcsec
    names = [name for name, _, _ in seen.pairs]
    shift, sigma = seen.shift_px(first), seen.shift_sigma_px(first)
    place = seen.mean_px(first)[:, :, seen.reference]
    pairs, residuals, constants = [], [], []
    angles = np.array([[one.settings.angle_deg for one in row] for row in seen.grid])
    for name, high, low in seen.pairs:
        count = sigma[name][..., 0].size
        error = np.sqrt((sigma[name] ** 2).sum((0, 1))) / (2 * count)
        pairs.append(
            Pair(
                pair_name=name,
                table1_px=measured(table1(shift[name]), error, n=count),
                shift_arcsec=scale * shift[name].reshape(-1, 2),
            )
        )
        of = separate_wedge(shift[name], sigma[name], place - folder.centre_px, angles[:, high], angles[:, low])
        constants.append(
            Constant(
                constant_px=measured(of.constant_px, of.constant_sigma_px),
                lens_px=measured(of.lens_px, of.lens_sigma_px),
                wedge_px=measured(of.wedge_px, of.wedge_sigma_px),
                told_text=_told(bool(np.isfinite(of.wedge_px).all()), bool(np.ptp(angles) > 0)),
            )
        )
        left = after_calibration(shift[name], place - folder.centre_px)
        residuals.append(Residual(residual_px=np.array([np.hypot(*rms_shift_px(left[step])) for step in CALIBRATIONS])))
    swaps = exchange_text(seen)
    every = [seen.shift_px(m) for m in methods]
    whole, spread = (np.stack([one[name].reshape(-1, 2) for name in names]) for one in (shift, sigma))
    return [one for row in seen.grid for one in row], {
        "pairs": pairs,
        "constants": constants,
        "exchange": Exchange(said=swaps, exchanged=len(swaps)) if len(seen.grid) > 1 else None,
        "calibration": residuals,
        "centroiders": [Centroider(method_table1_px=np.array([table1(of[name]) for name in names])) for of in every],
        "points": Points(filters_nm=seen.filters_nm, place_px=place.reshape(-1, 2), shift_px=measured(whole, spread)),
    }


def exchange_text(seen: FilterFrames) -> list[str]:
    """Exchanged series by place and filter, in words."""
    rate = np.array([[one.light_per_s for one in row] for row in seen.grid])
    texts = []
    for place, one, other in exchanged_filters(
        rate, np.array([[spot_radius_px(s.mean_e) for s in r] for r in seen.grid])
    ):
        ratios = rate[:, other] / rate[:, one]
        low, high = f"{seen.filters_nm[one]:g}", f"{seen.filters_nm[other]:g}"
        texts.append(
            f"the files of {low} and {high} nm at place {seen.grid[place][one].settings.place!r} (light of {high} over "
            f"{low} nm is {ratios[place]:.3g} there, {np.delete(ratios, place).mean():.3g} elsewhere)"
        )
    return [" or ".join(texts)] if texts else []


def _told(apart: bool, turned: bool) -> str:
    if apart:
        return "yes"
    if turned:
        return "no: turn every filter, the reference too, or the camera"
    return "no: neither the filters nor the camera were turned"


def _exchange_advice(outcome: Outcome) -> str:
    said = "; ".join(outcome.result["exchange"].said)
    return f"{said} are exchanged relative to the other places; correct filter_nm"


def _axes(q: Quantities, pairs: Sequence[Pair]) -> None:
    q.axis("step", list(CALIBRATIONS), "Calibration of the band")
    q.axis("point", np.arange(len(pairs[0].shift_arcsec)) + 1, "Point")


own_frames = FramesTest(
    title="Chromatic error",
    layout=FolderLayout(needs=("filter_nm",), same_scene="place"),
    reduce=reduce,
    sections={
        "pairs": Section(
            record=Pair,
            dim="pair",
            along="pair_name",
            axes=_axes,
            table="table1",
            rows="pair axis",
            columns="table1_px",
            caption="Mean shift between filters, halved (ACC18 Table 1, eq. 16).",
            note="One standard deviation, by the stated noise; motion of the target between two series is "
            "not included.",
            figures={"shifts": arrows("place_px", "shift_arcsec", panels="pair", frame="frame_size_px")},
        ),
        "constants": Section(
            record=Constant,
            dim="pair",
            table="wedge",
            rows="pair axis",
            caption="Uniform part of the shift: by a decentred lens (prism), which rotates with the camera, "
            "and by wedges, which rotate with the filters.",
            note="Places of different filter_angle_deg or camera_angle_deg separate them; *the filters*: "
            "difference of the two wedges, at angle 0.",
        ),
        "exchange": Section(
            record=Exchange,
            verdicts=[
                below(
                    "exchanged",
                    0,
                    title="filters exchanged at a place, by the light and width of their spots",
                    advice=_exchange_advice,
                )
            ],
        ),
        "calibration": Section(
            record=Residual,
            dim="pair",
            across="step",
            caption="RMS length of the shift of a point, as measured and with camera parameters for each band.",
            note="Includes centroid noise.",
        ),
        "centroiders": Section(
            record=Centroider,
            dim="method",
            across="pair axis",
            caption="Results of every centroider for the same frames.",
        ),
        "points": Section(record=Points, rows="pair point", across="axis", caption="All points."),
    },
    head={"Mean shift, halved": ("table1_px", {})},
    captions={"shifts": "Shift of every point between two filters."},
)
