"""The chromatic term (ACC18 eq. 13-16) for the budget: predicted from traced light, measured on frames."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from calib.accuracy.budget_comparison import next_draw_variance
from calib.accuracy.chromatic import rms_shift_px, shifts, table1
from calib.accuracy.error_budget import ErrorTerm
from calib.measure.centroid_error.expected_windows import drawn_positions, noiseless_positions
from experiments.budget.laboratory import Laboratory
from experiments.harness.sections import Section, col
from experiments.harness.summary import Measured, measured
from experiments.laboratory.bench.centroid_methods import has_own_epsf
from experiments.laboratory.bench.point_bench import centroiders, session_centroiders
from experiments.laboratory.bench.points import filter_scene
from experiments.laboratory.bench.ray_prediction import bundle_prediction, target_windows
from experiments.laboratory.bench.readout.frames import nominal_noise
from experiments.laboratory.chromatic_error import measure_chromatic
from experiments.laboratory.devices.target import corner_directions
from optics.arrays import FloatArray
from render.engine.random import Streams
from render.records import EffectivePsf

ROUNDING_PX = 1e-6
"""Below this a traced mean is rounding, and the statistic is zero."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ChromaticTerm:
    """ACC18's Table 1, and its term of the budget."""

    table1_px: Mapping[str, FloatArray]  # (2,) Eq. 16 per pair of bands, signed
    sigma_px: Mapping[str, FloatArray]  # (2,) Its standard deviation
    rms_px: Mapping[str, FloatArray]  # (2,) RMS shift of the points
    pixel_arcsec: float  # Angle of a pixel
    n: int  # Frames behind each entry; 0 for a prediction

    def largest(self) -> list[str]:
        """The pair with the largest entry, for x and y."""
        return [max((abs(float(v[axis])), name) for name, v in self.table1_px.items())[1] for axis in range(2)]

    def value(self, pairs: list[str] | None = None) -> ErrorTerm:
        """The term: largest entry, divided by three, times three sigma."""
        names = self.largest() if pairs is None else pairs
        size = [abs(float(self.table1_px[name][axis])) for axis, name in enumerate(names)]
        size = [value if value > ROUNDING_PX else 0.0 for value in size]
        spread = [float(self.sigma_px[name][axis]) for axis, name in enumerate(names)]
        return ErrorTerm(
            arcsec=np.array(size) * self.pixel_arcsec,
            uncertainty_arcsec=np.array(spread) * self.pixel_arcsec,
            n=self.n,
        )


@dataclass(frozen=True, slots=True)
class TracedTarget:
    """Target points in the four corners: quantities that depend on the light alone."""

    direction: FloatArray  # (p, j, 3) Points
    place_px: FloatArray  # (p, j, b, 2) Traced bundle means
    psf: list[list[list[EffectivePsf]]]  # PSFs ``[corner][point][band]``; empty where every centroider knows them


def trace_target(lab: Laboratory, *, coarse: bool = False) -> TracedTarget:
    """Trace the target behind every filter; PSFs only if a centroider does not know them, coarse: of middle points."""
    bench, instrument = lab.filtered, lab.instrument
    direction = corner_directions(bench.target, instrument)
    psf: list[list[list[EffectivePsf]]] = []
    if not all(has_own_epsf(method) for method in bench.methods):
        scene, size = filter_scene(bench, instrument, by_grid=not coarse), bench.window_px // 2 + 2
        if coarse:
            psf = [scene.filter_psfs(one[len(one) // 2][None], size) * len(one) for one in direction]
        else:
            psf = [scene.filter_psfs(one, size) for one in direction]
    return TracedTarget(direction, bundle_prediction(bench, instrument, direction), psf)


def predicted_terms(
    lab: Laboratory, traced: TracedTarget, *, draws: int, defect: NDArray[np.bool_] | None = None
) -> dict[str, ChromaticTerm]:
    """By centroider: positions by ray trace, or by the centroider on PSFs with noise."""
    pairs, found = lab.filtered.pairs, {}
    place = dict.fromkeys(lab.filtered.methods, traced.place_px)
    error = {m: np.zeros_like(traced.place_px) for m in lab.filtered.methods}
    built: dict[str, FloatArray] = {}
    others = [m for m in lab.filtered.methods if not has_own_epsf(m)]
    if others:
        drawn = _as_centroided(lab, traced, others, draws, defect)
        place, error, built = place | drawn[0], error | drawn[1], drawn[2]
    for method in lab.filtered.methods:
        shift, sigma = shifts(place[method], pairs), {}
        for name, high, low in pairs:
            square = (error[method][:, :, high] ** 2 + error[method][:, :, low] ** 2).sum((0, 1))
            sigma[name] = np.sqrt(square) / (2.0 * traced.place_px.shape[0] * traced.place_px.shape[1])
            if method in built:  # one PSF for all filters and corners: its noise is in every shift
                each = np.array([table1(shifts(one, [(name, high, low)])[name]) for one in built[method]])
                sigma[name] = np.sqrt(sigma[name] ** 2 + next_draw_variance(each))
        found[method] = ChromaticTerm(
            table1_px={name: table1(v) for name, v in shift.items()},
            sigma_px=sigma,
            rms_px={name: rms_shift_px(v) for name, v in shift.items()},
            pixel_arcsec=lab.instrument.pixel_arcsec,
            n=0,
        )
    return found


def _as_centroided(
    lab: Laboratory, traced: TracedTarget, methods: Sequence[str], draws: int, defect: NDArray[np.bool_] | None
) -> tuple[dict[str, FloatArray], dict[str, FloatArray], dict[str, FloatArray]]:
    """Mean positions (p, j, b, 2) over drawn noise, their standard deviations, and positions (k, p, j, b, 2) by method:
    with the PSFs of drawn sessions where a method builds them, without noise then."""
    bench, instrument = replace(lab.filtered, methods=methods), lab.instrument
    noise, told = instrument.pixel_noise(), nominal_noise(instrument)
    place, error = ({m: np.empty_like(traced.place_px) for m in methods} for _ in range(2))
    built: dict[str, FloatArray] = {}
    rng = {m: Streams(lab.config.seed).generator("chromatic prediction") for m in methods}
    for p, points in enumerate(traced.direction):
        for band in range(traced.place_px.shape[2]):
            psf = [row[band] for row in traced.psf[p]]
            windows = target_windows(
                replace(bench, reference=band),
                instrument,
                points[None],
                psf,
                traced.place_px[p, :, band],
                defect=defect,
            )
            for method, centroider in centroiders(bench, psf).items():
                if sessions := session_centroiders(bench, psf, method):
                    of_all = built.setdefault(method, np.empty((len(sessions), *traced.place_px.shape)))
                    of_all[:, p, :, band] = [noiseless_positions(one, windows, told) for one in sessions]
                    place[method][p, :, band] = of_all[:, p, :, band].mean(0)
                    error[method][p, :, band] = 0.0
                    continue
                drawn = drawn_positions(centroider, windows, told, noise, draws=draws, rng=rng[method])
                place[method][p, :, band] = np.nanmean(drawn, axis=0)
                error[method][p, :, band] = np.nanstd(drawn, axis=0, ddof=1) / np.sqrt(draws)
    return place, error, built


def measured_terms(
    lab: Laboratory, streams: Streams, *, advance: Callable[[], None] = lambda: None
) -> dict[str, ChromaticTerm]:
    """By centroider: the target in the four corners behind every filter, rendered, read out, reduced."""
    bench, found = lab.filtered, {}
    frames = measure_chromatic(bench, lab.instrument, streams, patterns=bench.methods, advance=advance)
    for method in bench.methods:
        shift = shifts(frames.mean_px[method], bench.pairs)
        found[method] = ChromaticTerm(
            table1_px={name: table1(v) for name, v in shift.items()},
            sigma_px=frames.table1_sigma(bench.pairs, method),
            rms_px={name: rms_shift_px(v) for name, v in shift.items()},
            pixel_arcsec=lab.instrument.pixel_arcsec,
            n=bench.frames * int(np.prod(frames.nominal_px.shape[:2])),
        )
    return found


@dataclass(frozen=True, slots=True, kw_only=True)
class Table1:
    """An entry of ACC18's Table 1, main centroider."""

    pair: str = col("Bands", "nm")
    predicted_px: FloatArray = col("Predicted", "px", ".5f", "axis")
    measured_px: Sequence[Measured] = col("Measured", "px", dims="axis")
    rms_px: FloatArray = col("RMS shift of a point", "px", ".4f", "axis")


def table1_of(predicted: ChromaticTerm, seen: ChromaticTerm) -> list[Table1]:
    """Table 1, one record for each pair of bands."""
    return [
        Table1(
            pair=pair,
            predicted_px=predicted.table1_px[pair],
            measured_px=measured(entry, seen.sigma_px[pair], seen.n),
            rms_px=seen.rms_px[pair],
        )
        for pair, entry in seen.table1_px.items()
    ]


TABLE1 = Section(
    record=Table1,
    dim="pair",
    along="pair",
    table="chromatic",
    rows="pair axis",
    caption="Chromatic term: mean shift between filters, halved (ACC18 eq. 16), signed.",
)
