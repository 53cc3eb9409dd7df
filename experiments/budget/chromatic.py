"""LSFE-S, the chromatic low-spatial-frequency error (ACC18 eq. 13-16): predicted by ray trace, measured on frames.

A centroider whose PSF is built from frames is predicted with several Monte-Carlo realisations of that PSF: the noise of
one realisation is common to all filters and corners, so that it does not average out in Table 1.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from calib.accuracy.budget_comparison import next_draw_variance
from calib.accuracy.chromatic import chromatic_error, rms_shift_px, shifts, table1
from calib.accuracy.error_budget import ErrorTerm
from calib.measure.centroid_error.expected_windows import ExpectedWindows, drawn_positions, noiseless_positions
from experiments.budget.laboratory import BudgetLaboratory
from experiments.harness.sections import Section, col
from experiments.harness.summary import Measured, measured
from experiments.laboratory.bench.centroid_methods import has_matched_epsf, needs_measured_epsf
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
"""Entries of Table 1 below this are rounding errors of the trace; their term is zero."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ChromaticTerm:
    """ACC18's Table 1 for b pairs of bands, and its term of the budget."""

    pairs: Sequence[str]  # Names of the pairs
    table1_px: FloatArray  # (b, 2) Eq. 16, signed
    sigma_px: FloatArray  # (b, 2) Standard deviation of `table1_px`
    rms_px: FloatArray  # (b, 2) RMS shift of the points
    pixel_arcsec: float  # Angle of a pixel
    n: int  # Number of frames of each entry; 0 for a prediction

    def error_term(self) -> ErrorTerm:
        """LSFE-S, 3 sigma (`calib.accuracy.chromatic.chromatic_error`)."""
        term = chromatic_error(self.table1_px, self.sigma_px, self.pixel_arcsec, self.n)
        significant = term.arcsec > ROUNDING_PX * self.pixel_arcsec
        return replace(term, arcsec=np.where(significant, term.arcsec, 0.0))


def _build_term(
    lab: BudgetLaboratory, position_px: FloatArray, sigma_px: Sequence[FloatArray], n: int
) -> ChromaticTerm:
    """Table 1 (eq. 15-16) of positions (p, j, b, 2); ``sigma_px``: standard deviation (2,) of each entry."""
    shift_px = shifts(position_px, lab.filtered.pairs)
    return ChromaticTerm(
        pairs=list(shift_px),
        table1_px=np.array([table1(shift) for shift in shift_px.values()]),
        sigma_px=np.array(sigma_px),
        rms_px=np.array([rms_shift_px(shift) for shift in shift_px.values()]),
        pixel_arcsec=lab.instrument.pixel_arcsec,
        n=n,
    )


@dataclass(frozen=True, slots=True)
class TracedTarget:
    """Target points in the four corners, traced: independent of noise and centroider."""

    direction: FloatArray  # (p, j, 3) Unit vectors of the points
    position_px: FloatArray  # (p, j, b, 2) Traced bundle means
    psf: list[list[list[EffectivePsf]]]  # ``psf[corner][point][band]``; empty if no centroider depends on PSFs


def trace_target(lab: BudgetLaboratory, *, coarse: bool = False) -> TracedTarget:
    """Trace the target behind every filter; coarse: all points of a corner with the PSF of its central point."""
    bench = lab.filtered
    instrument = lab.instrument
    direction = corner_directions(bench.target, instrument)
    psf: list[list[list[EffectivePsf]]] = []
    if not all(has_matched_epsf(method) for method in bench.methods):
        scene = filter_scene(bench, instrument, by_grid=not coarse)
        half_size_px = bench.window_px // 2 + 2
        for points in direction:
            central = points[len(points) // 2][None]
            psf.append(
                scene.filter_psfs(central, half_size_px) * len(points)
                if coarse
                else scene.filter_psfs(points, half_size_px)
            )
    return TracedTarget(direction, bundle_prediction(bench, instrument, direction), psf)


def predicted_terms(
    lab: BudgetLaboratory, traced: TracedTarget, *, draws: int, defect: NDArray[np.bool_] | None = None
) -> dict[str, ChromaticTerm]:
    """By centroider: traced positions if its PSF is matched to the filter, else its centroids of noisy windows."""
    corners, points, *_ = traced.position_px.shape
    unbiased = CentroidedTarget(traced.position_px, np.zeros_like(traced.position_px), None)
    biased_methods = [method for method in lab.filtered.methods if not has_matched_epsf(method)]
    windows = _expect_corner_windows(lab, traced, defect) if biased_methods else []
    terms = {}
    for method in lab.filtered.methods:
        target = _centroid_target(lab, traced, windows, method, draws) if method in biased_methods else unbiased
        sigma_px = []
        for name, high, low in lab.filtered.pairs:
            # eq. 16 propagated: half the mean of p x j independent differences
            variance_px2 = (target.sigma_px[:, :, [high, low]] ** 2).sum((0, 1, 2)) / (2.0 * corners * points) ** 2
            if target.realisation_px is not None:  # the noise of one PSF is common to all filters and corners
                entries = table1(shifts(target.realisation_px, lab.filtered.pairs)[name])
                variance_px2 = variance_px2 + next_draw_variance(entries)
            sigma_px.append(np.sqrt(variance_px2))
        terms[method] = _build_term(lab, target.mean_px, sigma_px, 0)
    return terms


class CentroidedTarget(NamedTuple):
    """Predicted centroids of the target by one method."""

    mean_px: FloatArray  # (p, j, b, 2) Mean over noise samples, or over realisations of the PSF
    sigma_px: FloatArray  # (p, j, b, 2) Standard deviation of that mean over noise samples
    realisation_px: FloatArray | None  # (k, p, j, b, 2) Noiseless centroids with each of k realisations of the PSF


class CornerWindows(NamedTuple):
    """Expected windows of the points of one corner behind one filter."""

    corner: int
    band: int
    psf: Sequence[EffectivePsf]  # PSF of each point
    windows: ExpectedWindows


def _expect_corner_windows(
    lab: BudgetLaboratory, traced: TracedTarget, defect: NDArray[np.bool_] | None
) -> Sequence[CornerWindows]:
    """Noiseless expected windows in every corner behind every filter."""
    corner_windows: list[CornerWindows] = []
    for corner, direction in enumerate(traced.direction):
        for band in range(len(lab.filtered.filters)):
            psf = [point[band] for point in traced.psf[corner]]
            bench = replace(lab.filtered, reference=band)
            position_px = traced.position_px[corner, :, band]
            windows = target_windows(bench, lab.instrument, direction[None], psf, position_px, defect=defect)
            corner_windows.append(CornerWindows(corner, band, psf, windows))
    return corner_windows


def _centroid_target(
    lab: BudgetLaboratory, traced: TracedTarget, corner_windows: Sequence[CornerWindows], method: str, draws: int
) -> CentroidedTarget:
    """Centroids of windows with sampled noise; with a PSF built from frames: noiseless, for each realisation."""
    bench = replace(lab.filtered, methods=(method,))
    noise_model = nominal_noise(lab.instrument)
    rng = Streams(lab.config.seed).generator("chromatic prediction")
    shape = traced.position_px.shape
    mean_px = np.empty(shape)
    sigma_px = np.zeros(shape)
    realisation_px = np.empty((len(bench.sessions), *shape))
    psf_from_frames = needs_measured_epsf(method)
    for corner, band, psf, windows in corner_windows:
        if psf_from_frames:
            noiseless_px = [
                noiseless_positions(centroider, windows, noise_model)
                for centroider in session_centroiders(bench, psf, method)
            ]
            realisation_px[:, corner, :, band] = noiseless_px
            mean_px[corner, :, band] = np.mean(noiseless_px, axis=0)
        else:
            sampled_px = drawn_positions(
                centroiders(bench, psf)[method],
                windows,
                noise_model,
                lab.instrument.pixel_noise(),
                draws=draws,
                rng=rng,
            )
            mean_px[corner, :, band] = np.nanmean(sampled_px, axis=0)
            sigma_px[corner, :, band] = np.nanstd(sampled_px, axis=0, ddof=1) / np.sqrt(draws)
    return CentroidedTarget(mean_px, sigma_px, realisation_px if psf_from_frames else None)


def measured_terms(
    lab: BudgetLaboratory, streams: Streams, *, advance: Callable[[], None] = lambda: None
) -> dict[str, ChromaticTerm]:
    """By centroider: the target in the four corners behind every filter, rendered, read out, reduced."""
    bench = lab.filtered
    frames = measure_chromatic(bench, lab.instrument, streams, patterns=bench.methods, advance=advance)
    frames_per_entry = bench.frames * int(np.prod(frames.nominal_px.shape[:2]))
    return {
        method: _build_term(
            lab, frames.mean_px[method], list(frames.table1_sigma(bench.pairs, method).values()), frames_per_entry
        )
        for method in bench.methods
    }


@dataclass(frozen=True, slots=True, kw_only=True)
class Table1:
    """An entry of ACC18's Table 1, main centroider."""

    pair: str = col("Bands", "nm")
    predicted_px: FloatArray = col("Predicted", "px", ".5f", "axis")
    measured_px: Sequence[Measured] = col("Measured", "px", dims="axis")
    rms_px: FloatArray = col("RMS shift of a point", "px", ".4f", "axis")


def tabulate_table1(predicted: ChromaticTerm, frames: ChromaticTerm) -> list[Table1]:
    """Table 1, one record for each pair of bands."""
    return [
        Table1(
            pair=pair,
            predicted_px=predicted.table1_px[row],
            measured_px=measured(frames.table1_px[row], frames.sigma_px[row], frames.n),
            rms_px=frames.rms_px[row],
        )
        for row, pair in enumerate(frames.pairs)
    ]


TABLE1 = Section(
    record=Table1,
    dim="pair",
    along="pair",
    table="chromatic",
    rows="pair axis",
    caption="Chromatic term: mean shift between filters, halved (ACC18 eq. 16), signed.",
)
