"""Distortion error predicted without frames: traced bundles, noise, response pattern, S-curve and marking error.

The document's numbers are functions of the mean centroids and the surveyed coordinates; both are drawn many times
around the ray trace, and the same reduction is made of each draw. How good a map is over the whole field follows
without draws: with B the polynomial terms at the target points and A those at the field points, an error e of the
residuals becomes A (B^T B)^-1 B^T e in the map.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from experiments.laboratory.bench import Bench
from experiments.laboratory.distortion_error import (
    camera_place,
    dense_grid,
    residual_px,
    traced_bundles,
)
from experiments.laboratory.distortion_statistics import (
    REFERENCES,
    Reference,
    distortion_statistics,
    polynomial_terms,
    without_pointing,
)
from experiments.laboratory.instrument import Instrument
from experiments.laboratory.point_noise import drawn_positions, expected_windows, influence
from experiments.laboratory.point_scene import one_filter
from experiments.laboratory.readout.centroids import centroiders
from experiments.laboratory.targets import GridTarget, grid_directions, survey
from optics.arrays import FloatArray
from render.engine.random import Streams
from render.records import EffectivePsf

__all__ = ["DistortionPrediction", "MapForecast", "forecast_map", "predict_distortion"]


@dataclass(frozen=True, slots=True, kw_only=True)
class DistortionPrediction:
    """What the document's numbers should be; [px], 1 sigma.

    Attributes
    ----------
    pixel_arcsec : float
        Angle of a pixel.
    mean_px, scatter_px : dict of str to dict of Reference to (3, 2)
        RMS and standard deviation over draws of sigma_d, sigma_Dd, sigma_C1, by method and reference.
    bundle_px : (n, 2)
        Traced positions of the points.
    point_px : dict of str to (n, 2)
        Predicted error of a mean centroid by noise and response pattern.
    """

    pixel_arcsec: float
    mean_px: Mapping[str, Mapping[Reference, FloatArray]]
    scatter_px: Mapping[str, Mapping[Reference, FloatArray]]
    bundle_px: FloatArray
    point_px: Mapping[str, FloatArray]


def predict_distortion(
    bench: Bench,
    instrument: Instrument,
    target: GridTarget,
    direction: FloatArray,
    *,
    psf: Sequence[EffectivePsf],
    order: int = 3,
    references: Sequence[Reference] = tuple(REFERENCES),
    draws: int = 200,
    noise_draws: int = 0,
    seed: int = 0,
) -> DistortionPrediction:
    """Prediction for every centroider of the bench.

    Parameters
    ----------
    bench, instrument, target
        The laboratory.
    direction : (n, 3)
        Where the points are (`targets.grid_directions`).
    psf : sequence of EffectivePsf
        Of the points (`PointScene.psfs`).
    order : int
        Of the polynomial.
    references : sequence of str
        How target coordinates become pixels.
    draws : int
        Drawn targets, chips and sessions.
    noise_draws : int
        Noisy copies of each window from which the mean centroid is taken; 0 takes the noiseless window's, which is the
        same but for methods with a threshold at little light.
    seed : int
        Of the draws; they have nothing in common with the frames.
    """
    bench = one_filter(bench)
    rng = Streams(seed).generator("distortion prediction")
    noise = instrument.pixel_noise()
    windows = expected_windows(bench, instrument, direction[None], psf)
    mean: dict[str, dict[Reference, FloatArray]] = {}
    scatter: dict[str, dict[Reference, FloatArray]] = {}
    point: dict[str, FloatArray] = {}
    for name, centroider in centroiders(bench.methods, psf).items():
        gain = influence(centroider, instrument, windows)
        session_e2 = noise.temporal_e2(windows.light_e, frames=bench.frames, dark_frames=bench.dark_frames)
        sessions, fixed = gain.sigma_px(session_e2), gain.sigma_px(noise.response_e2(windows.light_e))
        point[name] = np.hypot(sessions, fixed)
        expected = gain.position_px
        if noise_draws:
            lots = Streams(seed).generator("distortion noise")
            drawn = drawn_positions(centroider, instrument, windows, noise, draws=noise_draws, rng=lots)
            expected = np.nanmean(drawn, axis=0)
        found: dict[Reference, list[FloatArray]] = {r: [] for r in references}
        for surveyed in survey(target, direction, rng, copies=draws):
            chip = expected + fixed * rng.standard_normal(fixed.shape)
            earlier, test = chip + sessions * rng.standard_normal((2, *fixed.shape))
            for reference in references:
                place, d, _ = residual_px(instrument, surveyed, earlier, test, reference)
                s = distortion_statistics(place, d, order)
                found[reference].append(np.stack([s.sigma_d_px, s.sigma_left_px, s.sigma_c1_px]))
        mean[name] = {r: np.sqrt(np.mean(np.square(v), axis=0)) for r, v in found.items()}
        scatter[name] = {r: np.std(v, axis=0, ddof=1) for r, v in found.items()}
    return DistortionPrediction(
        pixel_arcsec=instrument.pixel_arcsec,
        mean_px=mean,
        scatter_px=scatter,
        bundle_px=windows.place_px,
        point_px=point,
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class MapForecast:
    """Error of a polynomial map over the whole detector, shift and roll taken out; [px], RMS per axis.

    Attributes
    ----------
    points : int
        Target points.
    order : int
        Of the polynomial.
    bias_px : (2,)
        Distortion that the polynomial cannot follow.
    noise_px : (2,)
        Marking and centroid errors carried into the map.
    """

    points: int
    order: int
    bias_px: FloatArray
    noise_px: FloatArray

    @property
    def rms_px(self) -> FloatArray:
        """Both (2,)."""
        return np.asarray(np.hypot(self.bias_px, self.noise_px))


def forecast_map(
    bench: Bench,
    instrument: Instrument,
    target: GridTarget,
    *,
    order: int,
    point_error_px: float,
    traced_px: FloatArray,
    grid: tuple[int, int],
    seed: int = 0,
) -> MapForecast | None:
    """Expected map error of a target; None where it has too few points for the polynomial.

    Parameters
    ----------
    bench, instrument, target
        The laboratory.
    order : int
        Of the polynomial.
    point_error_px : float
        Standard deviation per axis of a point's mean centroid.
    traced_px : (rows * columns, 2)
        Traced positions of the dense grid.
    grid : tuple of int
        Rows and columns of that grid.
    seed : int
        Of the target's individual.
    """
    direction = grid_directions(target, instrument, Streams(seed).generator("forecast"))
    nominal, place = camera_place(instrument, direction)
    dense_nominal, dense_place = camera_place(instrument, dense_grid(instrument, *grid))
    terms, dense = polynomial_terms(place, order), polynomial_terms(dense_place, order)
    if len(place) <= terms.shape[1] or order >= min(target.rows, target.columns):  # a row per power, and one more
        return None
    carry = dense @ np.linalg.pinv(terms)
    found = traced_bundles(bench, instrument, direction) - nominal
    bias = without_pointing(dense_place, traced_px - dense_nominal - carry @ found)
    error = np.hypot(point_error_px, target.marking_error_arcsec / instrument.pixel_arcsec)
    parts = []
    for axis in range(2):  # columns of ``carry`` are the maps that a unit error of one point's one axis makes
        unit = np.zeros((*carry.shape, 2))
        unit[:, :, axis] = carry
        parts.append(np.stack([without_pointing(dense_place, unit[:, j]) for j in range(unit.shape[1])]))
    noise2 = sum((part**2).mean(1).sum(0) for part in parts)
    return MapForecast(
        points=len(place),
        order=order,
        bias_px=np.sqrt((bias**2).mean(0)),
        noise_px=np.asarray(error * np.sqrt(noise2)),
    )
