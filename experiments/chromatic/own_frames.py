"""Chromatic error of a laboratory's own frames (ACC18 eq. 13-16): every series is a filter at a field position."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
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
class PairShift:
    """Shift between two filters, first centroider."""

    pair_name: str = col("Pair")
    table1_px: Sequence[Measured] = col("Mean shift, halved", "px", dims="axis")
    shift_arcsec: FloatArray = col("Shift", "arcsec", ".3f", "point axis", shown=False)


@dataclass(frozen=True, slots=True, kw_only=True)
class PairResidual:
    """RMS length of the shifts of a pair, as measured and with parameters of the camera model per filter."""

    residual_px: FloatArray = col("RMS length", "px", ".4f", "step")


@dataclass(frozen=True, slots=True, kw_only=True)
class UniformShift:
    """Field-independent part of a pair's shift, first centroider, and its parts by the lens and by the filters."""

    uniform_px: Sequence[Measured] = col("Field-independent", "px", dims="axis")
    lens_px: Sequence[Measured] = col("by the lens", "px", dims="axis")
    wedge_px: Sequence[Measured] = col("by the filters", "px", dims="axis")
    separated_text: str = col("Separated")


@dataclass(frozen=True, slots=True, kw_only=True)
class FilterExchange:
    """Series whose filters are interchanged (mislabelled)."""

    descriptions: Sequence[str]
    exchanged: int = col("Interchanged filters")


@dataclass(frozen=True, slots=True, kw_only=True)
class CentroiderTable1:
    """Results of a centroider on the same frames."""

    table1_px: FloatArray = col("Mean shift, halved", "px", ".4f", "pair axis")


@dataclass(frozen=True, slots=True, kw_only=True)
class FieldShifts:
    """Points of all field positions, first centroider."""

    filters_nm: Sequence[float] = col("Filters", "nm", dims="filter", shown=False)
    position_px: FloatArray = col("Position", "px", ".4f", "point axis")
    shift_px: Sequence[Sequence[Sequence[Measured]]] = col("Shift", "px", ".4f", "pair point axis")


@dataclass(frozen=True, slots=True, kw_only=True)
class FilterFrames:
    """Images of j points at p field positions behind b filters."""

    filters_nm: tuple[float, ...]  # Central wavelengths, increasing
    reference: int  # Index of the filter with which the others are compared
    grid: tuple[tuple[SeriesFrames, ...], ...]  # ``grid[field position][filter]``

    @property
    def pairs(self) -> list[tuple[str, int, int]]:
        """Differences between the filters (`band_pairs`)."""
        return band_pairs(self.filters_nm, self.reference)

    def mean_px(self, method: str) -> FloatArray:
        """Mean centroids (p, j, b, 2)."""
        return np.stack([np.stack([series.points.mean_px(method) for series in row], axis=1) for row in self.grid])

    def shift_px(self, method: str) -> dict[str, FloatArray]:
        """Shifts (p, j, 2) of every pair (eq. 15)."""
        return shifts(self.mean_px(method), self.pairs)

    def shift_sigma_px(self, method: str) -> dict[str, FloatArray]:
        """Standard deviations (p, j, 2) of the shifts by the noise model; a pattern common to both filters cancels."""
        sigma_px = {}
        for name, high, low in self.pairs:
            rows = []
            for row in self.grid:
                temporal = sum(row[b].predicted_px(method) ** 2 / row[b].frames for b in (high, low))
                fixed = ((row[high].pattern_px - row[low].pattern_px) ** 2).sum((2, 3))
                rows.append(np.sqrt(temporal + fixed))
            sigma_px[name] = np.stack(rows)
        return sigma_px


def filter_frames(folder: FrameFolder, methods: Sequence[str], config: Any) -> FilterFrames:
    """Series by field position and filter; every field position needs one series behind every filter."""
    by_filter: dict[tuple[str, float], SeriesFrames] = {}
    for series in folder.series:
        key = (series.settings.place, float(series.settings.filter_nm or 0.0))
        if key in by_filter:
            raise ConfigError(
                f"{SETTINGS_FILE}: {by_filter[key].name} and {series.name} both have filter {key[1]:g} nm and place "
                f"{key[0]!r}; a single series per filter and place is needed, with all its files"
            )
        by_filter[key] = reduce_series(folder, series, methods)
    places, filters = list(dict.fromkeys(place for place, _ in by_filter)), sorted({nm for _, nm in by_filter})
    missing = [(place, nm) for place in places for nm in filters if (place, nm) not in by_filter]
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
        grid=tuple(tuple(by_filter[place, nm] for nm in filters) for place in places),
    )


def reduce_filters(folder: FrameFolder, methods: Sequence[str], config: Any) -> Reduced:
    """Chromatic error of a folder (eq. 15-16) with the settings ``filters`` of ``config``; uncertainties by the stated
    noise."""
    frames = filter_frames(folder, methods, config)
    method = methods[0]
    shift_px = frames.shift_px(method)
    sigma_px = frames.shift_sigma_px(method)
    position_px = frames.mean_px(method)[:, :, frames.reference]
    from_centre_px = position_px - folder.centre_px
    pairs = [name for name, _, _ in frames.pairs]
    interchanged = describe_interchanged(frames)
    return [series for row in frames.grid for series in row], {
        "pairs": [_pair_shift(pair, shift_px[pair], sigma_px[pair], folder.settings.pixel_arcsec) for pair in pairs],
        "constants": _uniform_shifts(frames, shift_px, sigma_px, from_centre_px),
        "exchange": FilterExchange(descriptions=interchanged, exchanged=len(interchanged))
        if len(frames.grid) > 1
        else None,
        "calibration": [_pair_residual(shift_px[pair], from_centre_px) for pair in pairs],
        "centroiders": [
            CentroiderTable1(table1_px=np.array([table1(pair_shift) for pair_shift in by_pair.values()]))
            for by_pair in map(frames.shift_px, methods)
        ],
        "points": FieldShifts(
            filters_nm=frames.filters_nm,
            position_px=position_px.reshape(-1, 2),
            shift_px=measured(
                np.stack([shift_px[pair].reshape(-1, 2) for pair in pairs]),
                np.stack([sigma_px[pair].reshape(-1, 2) for pair in pairs]),
            ),
        ),
    }


def _pair_shift(pair: str, shift_px: FloatArray, sigma_px: FloatArray, pixel_arcsec: float) -> PairShift:
    """Eq. 16 of one pair: half the mean of n independent shifts, hence half the standard error of the mean."""
    count = sigma_px[..., 0].size
    table1_sigma_px = np.sqrt((sigma_px**2).sum((0, 1))) / (2 * count)
    return PairShift(
        pair_name=pair,
        table1_px=measured(table1(shift_px), table1_sigma_px, n=count),
        shift_arcsec=pixel_arcsec * shift_px.reshape(-1, 2),
    )


def _uniform_shifts(
    frames: FilterFrames,
    shift_px: Mapping[str, FloatArray],
    sigma_px: Mapping[str, FloatArray],
    from_centre_px: FloatArray,
) -> list[UniformShift]:
    """Field-independent shift of every pair, separated by the angles of filters and camera (`separate_wedge`)."""
    angles_deg = np.array([[series.settings.angle_deg for series in row] for row in frames.grid])
    turned = bool(np.ptp(angles_deg) > 0)
    shifts_of_pairs = []
    for pair, high, low in frames.pairs:
        uniform = separate_wedge(
            shift_px[pair], sigma_px[pair], from_centre_px, angles_deg[:, high], angles_deg[:, low]
        )
        shifts_of_pairs.append(
            UniformShift(
                uniform_px=measured(uniform.constant_px, uniform.constant_sigma_px),
                lens_px=measured(uniform.lens_px, uniform.lens_sigma_px),
                wedge_px=measured(uniform.wedge_px, uniform.wedge_sigma_px),
                separated_text=_separated(bool(np.isfinite(uniform.wedge_px).all()), turned),
            )
        )
    return shifts_of_pairs


def _pair_residual(shift_px: FloatArray, from_centre_px: FloatArray) -> PairResidual:
    """RMS length of the shifts after each of `CALIBRATIONS`."""
    residuals_px = after_calibration(shift_px, from_centre_px).values()
    return PairResidual(residual_px=np.array([np.hypot(*rms_shift_px(residual_px)) for residual_px in residuals_px]))


def describe_interchanged(frames: FilterFrames) -> list[str]:
    """Interchanged series by field position and filter, in words."""
    rate = np.array([[series.light_per_s for series in row] for row in frames.grid])
    radius_px = np.array([[spot_radius_px(series.mean_e) for series in row] for row in frames.grid])
    texts = []
    for place, first, second in exchanged_filters(rate, radius_px):
        ratios = rate[:, second] / rate[:, first]
        low, high = f"{frames.filters_nm[first]:g}", f"{frames.filters_nm[second]:g}"
        texts.append(
            f"the files of {low} and {high} nm at place {frames.grid[place][first].settings.place!r} (light of {high} "
            f"over {low} nm is {ratios[place]:.3g} there, {np.delete(ratios, place).mean():.3g} elsewhere)"
        )
    return [" or ".join(texts)] if texts else []


def _separated(separated: bool, turned: bool) -> str:
    if separated:
        return "yes"
    if turned:
        return "no: turn every filter, the reference too, or the camera"
    return "no: neither the filters nor the camera were turned"


def _exchange_advice(outcome: Outcome) -> str:
    descriptions = "; ".join(outcome.result["exchange"].descriptions)
    return f"{descriptions} are interchanged relative to the other field positions; correct filter_nm"


def _axes(quantities: Quantities, pairs: Sequence[PairShift]) -> None:
    quantities.axis("step", list(CALIBRATIONS), "Calibration of the band")
    quantities.axis("point", np.arange(len(pairs[0].shift_arcsec)) + 1, "Point")


own_frames = FramesTest(
    title="Chromatic error",
    layout=FolderLayout(needs=("filter_nm",), same_scene="place"),
    reduce=reduce_filters,
    sections={
        "pairs": Section(
            record=PairShift,
            dim="pair",
            along="pair_name",
            axes=_axes,
            table="table1",
            rows="pair axis",
            columns="table1_px",
            caption="Mean shift between filters, halved (ACC18 Table 1, eq. 16).",
            note="One standard deviation, by the stated noise; motion of the target between two series is "
            "not included.",
            figures={"shifts": arrows("position_px", "shift_arcsec", panels="pair", frame="frame_size_px")},
        ),
        "constants": Section(
            record=UniformShift,
            dim="pair",
            table="wedge",
            rows="pair axis",
            caption="Field-independent part of the shift: by a decentred lens (prism), which rotates with the camera, "
            "and by wedges, which rotate with the filters.",
            note="Field positions of different filter_angle_deg or camera_angle_deg separate them; *the filters*: "
            "difference of the two wedges, at angle 0.",
        ),
        "exchange": Section(
            record=FilterExchange,
            verdicts=[
                below(
                    "exchanged",
                    0,
                    title="filters interchanged at a field position, by flux and width of their spots",
                    advice=_exchange_advice,
                )
            ],
        ),
        "calibration": Section(
            record=PairResidual,
            dim="pair",
            across="step",
            caption="RMS length of the shift of a point, as measured and with camera parameters for each band.",
            note="Includes centroid noise.",
        ),
        "centroiders": Section(
            record=CentroiderTable1,
            dim="method",
            across="pair axis",
            caption="Results of every centroider for the same frames.",
        ),
        "points": Section(record=FieldShifts, rows="pair point", across="axis", caption="All points."),
    },
    head={"Mean shift, halved": ("pairs.table1_px", {})},
    captions={"shifts": "Shift of every point between two filters."},
)
