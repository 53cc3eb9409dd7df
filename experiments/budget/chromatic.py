"""The chromatic term (ACC18 eq. 13-16) for the budget: predicted from traced light, measured on frames."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from experiments.budget.combine import Value
from experiments.budget.laboratory import Laboratory
from experiments.laboratory.bench import point_field
from experiments.laboratory.centroid_methods import needs_epsf
from experiments.laboratory.chromatic_error import measure_chromatic, reduce_chromatic, rms, shifts, table1
from experiments.laboratory.point_noise import drawn_positions, expected_windows
from experiments.laboratory.ray_prediction import bundle_prediction
from experiments.laboratory.readout.centroids import centroiders
from experiments.laboratory.target import corner_directions
from optics.arrays import FloatArray
from render.engine.random import Streams
from render.records import EffectivePsf
from render.tracing.psf import epsf_tracer, render_epsf

__all__ = ["ChromaticTerm", "TracedTarget", "measured_term", "predicted_term", "trace_target"]


ROUNDING_PX = 1e-6
"""Below this a traced mean is rounding, and the statistic is zero."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ChromaticTerm:
    """ACC18's Table 1, and what becomes of it in the budget.

    Attributes
    ----------
    table1_px, sigma_px : dict of str to (2,)
        Eq. 16 per pair of bands, signed, and its standard deviation.
    rms_px : dict of str to (2,)
        RMS shift of the points.
    pixel_arcsec : float
        Angle of a pixel.
    n : int
        Frames behind each entry; 0 for a prediction.
    """

    table1_px: Mapping[str, FloatArray]
    sigma_px: Mapping[str, FloatArray]
    rms_px: Mapping[str, FloatArray]
    pixel_arcsec: float
    n: int

    def largest(self) -> list[str]:
        """The pair with the largest entry, for x and y."""
        return [max((abs(float(v[axis])), name) for name, v in self.table1_px.items())[1] for axis in range(2)]

    def value(self, pairs: list[str] | None = None) -> Value:
        """The term: largest entry, divided by three, times three sigma.

        Parameters
        ----------
        pairs : list of str, optional
            Pair to take for x and y; the largest if left out.
        """
        names = self.largest() if pairs is None else pairs
        size = [abs(float(self.table1_px[name][axis])) for axis, name in enumerate(names)]
        size = [value if value > ROUNDING_PX else 0.0 for value in size]
        spread = [float(self.sigma_px[name][axis]) for axis, name in enumerate(names)]
        return Value(
            arcsec=np.array(size) * self.pixel_arcsec,
            uncertainty_arcsec=np.array(spread) * self.pixel_arcsec,
            n=self.n,
        )


@dataclass(frozen=True, slots=True)
class TracedTarget:
    """Target points in the four corners: what depends on the light alone.

    Attributes
    ----------
    direction : (p, j, 3)
        Points.
    place_px : (p, j, b, 2)
        Traced bundle means.
    psf : list
        PSFs ``[corner][point][band]``; empty where the centroider knows them.
    """

    direction: FloatArray
    place_px: FloatArray
    psf: list[list[list[EffectivePsf]]]


def trace_target(lab: Laboratory) -> TracedTarget:
    """Trace the target behind every filter; PSFs only if the centroider does not know them.

    Parameters
    ----------
    lab : Laboratory
        The laboratory.
    """
    bench, instrument = lab.filtered, lab.instrument
    direction = corner_directions(bench.target, instrument)
    psf: list[list[list[EffectivePsf]]] = []
    if not needs_epsf(bench.methods[0]):
        tracer, half = epsf_tracer(instrument.camera), bench.window_px // 2 + 2
        psf = [render_epsf(tracer, point_field(bench, instrument, one), half_size_px=half) for one in direction]
    return TracedTarget(direction, bundle_prediction(bench, instrument, direction), psf)


def predicted_term(lab: Laboratory, traced: TracedTarget, *, draws: int) -> ChromaticTerm:
    """Positions by ray trace, or where the centroider puts them on PSFs with noise.

    Parameters
    ----------
    lab : Laboratory
        The laboratory.
    traced : TracedTarget
        Of this lens, focus, light and window (`trace_target`).
    draws : int
        Noisy copies of each window; a threshold makes the mean centroid depend on the noise.
    """
    place, error = traced.place_px, np.zeros_like(traced.place_px)
    if traced.psf:
        place, error = _as_centroided(lab, traced, draws)
    pairs = lab.filtered.pairs
    shift, sigma = shifts(place, pairs), {}
    for name, high, low in pairs:
        square = (error[:, :, high] ** 2 + error[:, :, low] ** 2).sum((0, 1))
        sigma[name] = np.sqrt(square) / (2.0 * error.shape[0] * error.shape[1])
    return ChromaticTerm(
        table1_px={name: table1(v) for name, v in shift.items()},
        sigma_px=sigma,
        rms_px={name: rms(v) for name, v in shift.items()},
        pixel_arcsec=lab.instrument.pixel_arcsec,
        n=0,
    )


def _as_centroided(lab: Laboratory, traced: TracedTarget, draws: int) -> tuple[FloatArray, FloatArray]:
    """Mean positions (p, j, b, 2) of the centroider over drawn noise, and their standard deviations."""
    bench, instrument, method = lab.filtered, lab.instrument, lab.filtered.methods[0]
    noise, rng = instrument.pixel_noise(), Streams(lab.config.seed).generator("chromatic prediction")
    place, error = np.empty_like(traced.place_px), np.empty_like(traced.place_px)
    for p, points in enumerate(traced.direction):
        for band in range(place.shape[2]):
            psf = [row[band] for row in traced.psf[p]]
            windows = expected_windows(replace(bench, reference=band), instrument, points[None], psf)
            centroider = centroiders((method,), psf)[method]
            drawn = drawn_positions(centroider, instrument, windows, noise, draws=draws, rng=rng)
            place[p, :, band] = np.nanmean(drawn, axis=0)
            error[p, :, band] = np.nanstd(drawn, axis=0, ddof=1) / np.sqrt(draws)
    return place, error


def measured_term(lab: Laboratory, streams: Streams, *, advance: Callable[[], None] = lambda: None) -> ChromaticTerm:
    """The target in the four corners behind every filter, rendered, read out, reduced.

    Parameters
    ----------
    lab : Laboratory
        The laboratory.
    streams : Streams
        Root of the noise.
    advance : callable
        Called after each corner.
    """
    measured = measure_chromatic(lab.filtered, lab.instrument, streams, advance=advance)
    found = reduce_chromatic(lab.filtered, lab.instrument, measured)
    return ChromaticTerm(
        table1_px=found.table1_px,
        sigma_px=found.table1_sigma_px,
        rms_px={name: rms(v) for name, v in found.shift_px.items()},
        pixel_arcsec=lab.instrument.pixel_arcsec,
        n=lab.filtered.frames * int(np.prod(measured.nominal_px.shape[:2])),
    )
