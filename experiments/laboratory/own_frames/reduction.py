"""Frames from outside reduced as ACC18 does: temporal error, high spatial frequency error, distortion error.

The same statistics as of rendered frames, without truth. Centroiders that need a PSF cannot be used: there is none.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from calib.measure.centroid import get_centroider
from calib.measure.linear_response import centroid_variance, linear_response
from calib.records import NoiseModel, Stamps
from experiments.harness.summary import Measured
from experiments.laboratory.distortion_error import grid_residual_px
from experiments.laboratory.distortion_statistics import DistortionStatistics, Reference, distortion_statistics
from experiments.laboratory.own_frames.folder import FrameFolder, FrameSeries
from experiments.laboratory.point_frames import PointFrames
from experiments.laboratory.readout.centroids import measured_positions, refuse_few_frames
from experiments.laboratory.readout.stamps import dark_subtracted, refuse_saturated, ring_subtracted
from experiments.laboratory.step_statistics import document_rms_px, halved_px, jackknife_px
from experiments.laboratory.temporal_error import temporal_error_arcsec
from optics.arrays import FloatArray
from optics.errors import DomainError

__all__ = [
    "GridFrames",
    "SeriesFrames",
    "StepFrames",
    "TemporalFrames",
    "distortion_from_frames",
    "hsfe_from_frames",
    "temporal_from_frames",
]


@dataclass(frozen=True, slots=True, kw_only=True)
class SeriesFrames:
    """Centroids of a series.

    Attributes
    ----------
    name : str
        Of the series.
    frames : int
        N.
    signal_e : float
        Mean electrons in a window, background taken away.
    points : PointFrames
        Centroids by method, and the windows.
    mean_e : (j, h, w)
        Mean windows as centroided, background included where no dark frames were given.
    """

    name: str
    frames: int
    signal_e: float
    points: PointFrames
    mean_e: FloatArray

    @property
    def usable_fraction(self) -> float:
        """Smallest share over points and methods of frames that gave a position."""
        return float(min(np.isfinite(p[..., 0]).mean(0).min() for p in self.points.position_px.values()))


@dataclass(frozen=True, slots=True, kw_only=True)
class TemporalFrames:
    """Temporal error (eq. 1-2) of l series.

    Attributes
    ----------
    pixel_arcsec : float
        Angle of a pixel.
    series : tuple of SeriesFrames
        Levels.
    predicted_px : dict of str to (l, j, 2)
        Standard deviation of a frame's centroid that photons, read noise, rounding and the dark charge seen in the
        frames with the lamp off would give, through the influence of each pixel of the mean windows.
    """

    pixel_arcsec: float
    series: tuple[SeriesFrames, ...]
    predicted_px: Mapping[str, FloatArray]

    def te_arcsec(self, method: str, level: int = 0) -> tuple[Measured, Measured]:
        """Temporal error of a series, x and y, 3 sigma."""
        one = self.series[level]
        return temporal_error_arcsec(one.points.sigma_px(method), self.pixel_arcsec, one.frames)

    def predicted_te_arcsec(self, method: str, level: int = 0) -> FloatArray:
        """The same from the noise model (2,), without the small-sample factor."""
        return np.asarray(3.0 * self.pixel_arcsec * self.predicted_px[method][level].mean(0))


@dataclass(frozen=True, slots=True, kw_only=True)
class StepFrames:
    """High spatial frequency error (eq. 3-12) of m positions.

    Attributes
    ----------
    pixel_arcsec : float
        Angle of a pixel.
    series : tuple of SeriesFrames
        Positions, in the order of the steps.
    shift_px : (m, 2)
        Commanded shift since the start; NaN where not stated.
    """

    pixel_arcsec: float
    series: tuple[SeriesFrames, ...]
    shift_px: FloatArray

    def mean_px(self, method: str) -> FloatArray:
        """Mean centroids (m, j, 2)."""
        return np.stack([one.points.mean_px(method) for one in self.series])

    def document_arcsec(self, method: str) -> tuple[Measured, Measured]:
        """HSFE as printed, 3 sigma, x and y; uncertainty by the jackknife over the stars (none for two stars)."""
        mean, scale = self.mean_px(method), 3.0 * self.pixel_arcsec
        value, error = document_rms_px(mean), jackknife_px(mean)
        count = mean.shape[1] * (mean.shape[0] - 1)
        x, y = (
            Measured(
                value=float(value[a] * scale),
                unit="arcsec",
                uncertainty=float(error[a] * scale) if np.isfinite(error[a]) else None,
                n=count,
            )
            for a in range(2)
        )
        return x, y

    def halved_arcsec(self, method: str) -> FloatArray:
        """Error of one position (2,), 3 sigma, as if neighbours were independent; temporal noise taken away."""
        first = self.series[0].frames
        # positions with other numbers of frames: scaled so that sigma^2 / N is theirs
        sigma = np.stack([one.points.sigma_px(method) * np.sqrt(first / one.frames) for one in self.series])
        return np.asarray(3.0 * self.pixel_arcsec * halved_px(document_rms_px(self.mean_px(method)), sigma, first))

    def common_px(self, method: str) -> FloatArray:
        """Shift of the whole image since the first position (m, 2), as measured."""
        mean = self.mean_px(method)
        return np.asarray((mean - mean[0]).mean(1))


@dataclass(frozen=True, slots=True, kw_only=True)
class GridFrames:
    """Distortion error (eq. 17-30) of n target points.

    Attributes
    ----------
    pixel_arcsec : float
        Angle of a pixel.
    order : int
        Of the polynomial.
    nominal_px : (n, 2)
        Target coordinates.
    place : (n, 2)
        The same from the middle, in units of half the diagonal of the frames.
    earlier, test : SeriesFrames
        Sessions; without an earlier one there is no reference "calibrated".
    """

    pixel_arcsec: float
    order: int
    nominal_px: FloatArray
    place: FloatArray
    earlier: SeriesFrames | None
    test: SeriesFrames

    @property
    def references(self) -> tuple[Reference, ...]:
        """How the coordinates can become pixels."""
        return ("nominal", "aligned") if self.earlier is None else ("nominal", "aligned", "calibrated")

    @property
    def series(self) -> tuple[SeriesFrames, ...]:
        """Sessions in order."""
        return (self.test,) if self.earlier is None else (self.earlier, self.test)

    def statistics(self, method: str, reference: Reference) -> DistortionStatistics:
        """sigma_d, sigma_Dd and sigma_C1 [px].

        Raises
        ------
        DomainError
            On "calibrated" without an earlier session, or too few points.
        """
        if reference not in self.references:
            raise DomainError(f"reference {reference!r} needs a series with session = 'earlier'")
        test = self.test.points.mean_px(method)
        earlier = test if self.earlier is None else self.earlier.points.mean_px(method)
        d, _ = grid_residual_px(self.nominal_px, self.place, earlier, test, reference)
        return distortion_statistics(self.place, d, self.order)


def _stamps(series: FrameSeries) -> tuple[Stamps, NoiseModel]:
    if series.dark_e is None:
        return ring_subtracted(series.windows, series.found_px)
    return dark_subtracted(series.windows, series.dark_e)


def _reduce(series: FrameSeries, methods: Sequence[str]) -> SeriesFrames:
    """Centroids of a series."""
    stamps, noise = _stamps(series)
    frames = len(series.windows.dn)
    advice = "lower the lamp or the exposure"
    refuse_saturated(stamps, len(series.found_px), where=f"{series.name}, target points", advice=advice)
    position = {m: measured_positions(get_centroider(m), stamps, noise, frames) for m in methods}
    for method, values in position.items():
        refuse_few_frames(values, method, where=series.name)
    mean = stamps.electrons.reshape(frames, *series.windows.defect.shape).mean(0)
    light = mean - stamps.background_e[: len(mean), None, None]
    return SeriesFrames(
        name=series.name,
        frames=frames,
        signal_e=float(np.where(series.windows.defect, 0.0, light).sum((1, 2)).mean()),
        points=PointFrames(position_px=position, windows=series.windows),
        mean_e=mean,
    )


def _noise_model_px(series: FrameSeries, reduced: SeriesFrames, method: str) -> FloatArray:
    """Standard deviation (j, 2) of a frame's centroid by the noise of its pixels."""
    stamps, noise = _stamps(series)
    centroider = get_centroider(method)
    if hasattr(centroider, "tolerance"):
        centroider = replace(centroider, tolerance=1e-6)  # type: ignore[type-var]  # differences need more digits
    one = stamps.select(slice(0, len(reduced.mean_e)))
    gain = linear_response(centroider, one, noise, reduced.mean_e)
    variance = np.maximum(reduced.mean_e, 0.0) + noise.floor_e2
    if series.dark_e is not None:  # the charge that was subtracted still makes noise
        variance = variance + (series.dark_e - noise.offset_dn / noise.gain_dn_per_e)
    return np.sqrt(centroid_variance(gain, np.maximum(variance, 0.0)))


def temporal_from_frames(folder: FrameFolder, methods: Sequence[str]) -> TemporalFrames:
    """Temporal error of every series of a folder.

    Parameters
    ----------
    folder : FrameFolder
        From `read_folder`.
    methods : sequence of str
        Centroiders that need no ePSF.

    Raises
    ------
    DomainError
        On saturated points or fewer than two usable frames of a point.
    """
    reduced = tuple(_reduce(one, methods) for one in folder.series)
    pairs = list(zip(folder.series, reduced, strict=True))
    return TemporalFrames(
        pixel_arcsec=folder.settings.pixel_arcsec,
        series=reduced,
        predicted_px={m: np.stack([_noise_model_px(one, done, m) for one, done in pairs]) for m in methods},
    )


def hsfe_from_frames(folder: FrameFolder, methods: Sequence[str]) -> StepFrames:
    """High spatial frequency error; every series is a position.

    Parameters and errors as of `temporal_from_frames`; also fewer than two positions or two points.
    """
    if len(folder.series) < 2:
        raise DomainError(f"frames of {len(folder.series)} position; at least 2 [[series]] are needed for steps")
    if len(folder.series[0].found_px) < 2:
        raise DomainError("1 target point; at least 2 are needed, the mean over them is taken away")
    missing = (float("nan"), float("nan"))
    return StepFrames(
        pixel_arcsec=folder.settings.pixel_arcsec,
        series=tuple(_reduce(one, methods) for one in folder.series),
        shift_px=np.array([one.settings.shift_px or missing for one in folder.series], float),
    )


def distortion_from_frames(folder: FrameFolder, methods: Sequence[str], *, order: int = 3) -> GridFrames:
    """Distortion error of a target with stated coordinates.

    Parameters
    ----------
    folder, methods
        As of `temporal_from_frames`; one series with ``session = "test"`` and at most one with "earlier".
    order : int
        Of the polynomial.

    Raises
    ------
    DomainError
        As `temporal_from_frames`; also no coordinates, other sessions than these, or too few points for the polynomial.
    """
    if folder.nominal_px is None:
        raise DomainError("distortion needs the coordinates of the target: points_px or target in place of points")
    by_session = {s: [one for one in folder.series if one.settings.session == s] for s in ("earlier", "test")}
    if len(by_session["test"]) != 1 or len(by_session["earlier"]) > 1:
        raise DomainError(
            f"{len(by_session['test'])} series with session 'test' and {len(by_session['earlier'])} with 'earlier'; "
            "distortion needs one, and at most one"
        )
    earlier = [_reduce(one, methods) for one in by_session["earlier"]]
    half = 0.5 * np.hypot(folder.width_px, folder.height_px)
    result = GridFrames(
        pixel_arcsec=folder.settings.pixel_arcsec,
        order=order,
        nominal_px=folder.nominal_px,
        place=(folder.nominal_px - folder.centre_px) / half,
        earlier=earlier[0] if earlier else None,
        test=_reduce(by_session["test"][0], methods),
    )
    for reference in result.references:
        result.statistics(methods[0], reference)  # too few points are refused here
    return result
