"""The chromatic term (ACC18 eq. 13-16) for the budget: predicted from traced light, measured on frames."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calib.centroid import Centroider
from experiments.budget_combine import Value
from experiments.budget_laboratory import Laboratory
from experiments.chromatic_evaluate import evaluate
from experiments.chromatic_measure import measure
from experiments.chromatic_model import band_pairs, bundle_prediction, rms, shifts, table1
from experiments.laboratory.bench import point_field
from experiments.laboratory.point_frames import centroiders, noiseless_positions
from experiments.laboratory.point_noise import ExpectedWindows, expected_windows, nominal_noise
from experiments.target import corner_directions
from render.psf import epsf_tracer, render_epsf
from render.random import Streams

__all__ = ["ChromaticTerm", "measure_chromatic", "predict_chromatic"]

FloatArray = NDArray[np.float64]

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


def _pairs(lab: Laboratory) -> list[tuple[str, int, int]]:
    return band_pairs([band.centre_nm for band in lab.filtered.filters], lab.filtered.reference)


def predict_chromatic(mi: Any, lab: Laboratory) -> ChromaticTerm:
    """Positions by ray trace; where the centroider does not know the PSF, its bias on noiseless PSFs is added.

    Parameters
    ----------
    mi : module
        Mitsuba with an active variant, for the PSFs.
    lab : Laboratory
        The laboratory.
    """
    bench, instrument = lab.filtered, lab.instrument
    direction = corner_directions(bench.target, instrument)
    place = bundle_prediction(bench, instrument, direction)
    if bench.methods[0] != "epsf":
        place = _as_centroided(mi, lab, direction, place.shape)
    shift = shifts(place, _pairs(lab))
    return ChromaticTerm(
        table1_px={name: table1(v) for name, v in shift.items()},
        sigma_px={name: np.zeros(2) for name in shift},
        rms_px={name: rms(v) for name, v in shift.items()},
        pixel_arcsec=instrument.pixel_arcsec,
        n=0,
    )


def _as_centroided(mi: Any, lab: Laboratory, direction: FloatArray, shape: tuple[int, ...]) -> FloatArray:
    """Positions (p, j, b, 2) that the centroider gives on noiseless windows."""
    bench, instrument, method = lab.filtered, lab.instrument, lab.filtered.methods[0]
    tracer = epsf_tracer(mi, instrument.camera)
    place = np.empty(shape)
    for p, points in enumerate(direction):
        stars = point_field(bench, instrument, points)
        epsf = render_epsf(tracer, stars, half_size_px=bench.window_px // 2 + 2)
        for band in range(shape[2]):
            psf = [row[band] for row in epsf]
            windows = expected_windows(replace(bench, reference=band), instrument, points[None], psf)
            centroider = centroiders((method,), psf)[method]
            place[p, :, band] = _noiseless(centroider, lab, windows)
    return place


def _noiseless(centroider: Centroider, lab: Laboratory, windows: ExpectedWindows) -> FloatArray:
    """Positions (n, 2) of noiseless windows."""
    position, _ = noiseless_positions(
        centroider,
        nominal_noise(lab.instrument),
        light_e=windows.light_e,
        corner_px=windows.corner_px,
        psf_index=windows.psf_index,
    )
    return position


def measure_chromatic(
    mi: Any, lab: Laboratory, streams: Streams, *, backend: str, advance: Callable[[], None] = lambda: None
) -> ChromaticTerm:
    """The target in the four corners behind every filter, rendered, read out, reduced.

    Parameters
    ----------
    mi : module
        Mitsuba with an active variant.
    lab : Laboratory
        The laboratory.
    streams : Streams
        Root of the noise.
    backend : str
        Where the detector runs.
    advance : callable
        Called after each corner.
    """
    measured = measure(mi, lab.filtered, lab.instrument, streams, backend=backend, advance=advance)
    found = evaluate(lab.filtered, lab.instrument, measured, _pairs(lab))
    return ChromaticTerm(
        table1_px=found.table1_px,
        sigma_px=found.table1_sigma_px,
        rms_px={name: rms(v) for name, v in found.shift_px.items()},
        pixel_arcsec=lab.instrument.pixel_arcsec,
        n=lab.filtered.frames * int(np.prod(measured.nominal_px.shape[:2])),
    )
