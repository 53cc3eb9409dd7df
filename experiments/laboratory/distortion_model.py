"""Distortion error predicted without frames: traced bundles, noise, response pattern, S-curve and marking error.

The document's squares are quadratic forms of centroids and coordinates. With H the projector onto the polynomials and J
that onto constants, residuals d at W points have

    (W - 1) sigma_d^2 = |(1 - J) d|^2,    (W - 1) sigma_D^2 = |(1 - H) d|^2,    (W - 1) sigma_C1^2 = |(H - J) d|^2,

and with P the projector onto the terms of the camera behind the coordinates, s and t the errors of the earlier and of
the test session, c their common error (response pattern), m the marking error and u the deterministic part (distortion,
S-curve),

    d = (1 - P) (u + c - m) + t - P s   (camera of an earlier session),    d = (1 - P) (u + c + t - m)   (of the same).

Mean and variance of |Q d|^2 for normal d = u + noise of covariance C are u'Qu + tr(QC) and 2 tr(QCQC) + 4 u'QCQu.
Nothing is drawn, and no code of the reduction takes part: projectors are made by QR of other bases of the same
polynomials.

The chip and the frames of a run are the same for all its surveys: the RMS over surveys keeps a *frozen* scatter (from
chip to chip and from run to run) for any number of surveys.

Map error over the field: with B the polynomial terms at the target points and A those at the field points, an error e
of the residuals becomes A (B^T B)^-1 B^T e in the map.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from calib.cameras.field_map import polynomial_basis
from calib.measure.centroid import Centroider
from calib.measure.expected_windows import ExpectedWindows, drawn_positions, noiseless_positions, window_response
from calib.records import NoiseModel
from experiments.laboratory.bench.centroid_methods import needs_epsf
from experiments.laboratory.bench.point_bench import Bench, centroiders, session_centroiders
from experiments.laboratory.bench.point_scene import one_filter
from experiments.laboratory.bench.ray_prediction import target_windows
from experiments.laboratory.bench.readout.noise_model import nominal_noise
from experiments.laboratory.devices.targets import GridTarget, grid_directions
from experiments.laboratory.distortion_error import camera_place, dense_grid, traced_bundles
from experiments.laboratory.distortion_statistics import REFERENCES, Reference, without_pointing
from optics.arrays import FloatArray
from optics.units import ARCSEC_RAD
from render.engine.random import Streams
from render.records import EffectivePsf
from render.sensor_file.instrument import Instrument


class Numbers(NamedTuple):
    """Expected values of the document's numbers (3, 2) [px]: sigma_d, sigma_Dd, sigma_C1 by axis.

    Root mean square; standard deviation of the number of one survey, and of the RMS over infinitely many surveys of one
    chip and one run.
    """

    rms_px: FloatArray
    scatter_px: FloatArray
    frozen_px: FloatArray


@dataclass(frozen=True, slots=True, kw_only=True)
class GridErrors:
    """Errors in the residuals of n points [px]."""

    place: FloatArray  # (n, 2) Points from the middle of the detector, in units of order 1
    offset_px: FloatArray  # (n, 2) Mean centroids minus nominal coordinates, without noise: distortion and S-curve
    # (n, 2, 2) Covariance of the mean centroid of each point by what is frozen into a chip, and by the noise of one
    # session
    chip_px2: FloatArray
    session_px2: FloatArray
    mean_px2: FloatArray  # (n, 2, 2) Covariance with which ``offset_px`` is known; it is not that of the frames
    marking_px: float  # Standard deviation per axis of a surveyed coordinate


@dataclass(frozen=True, slots=True, kw_only=True)
class DistortionPrediction:
    """Expected values of the document's numbers; [px], 1 sigma, by method and reference."""

    pixel_arcsec: float  # Angle of a pixel
    # (3, 2) sigma_d, sigma_Dd, sigma_C1: root mean square over chips, runs and surveys; standard deviation of the
    # numbers of one survey; standard deviation, from chip to chip and run to run, of the RMS over many surveys
    mean_px: Mapping[str, Mapping[Reference, FloatArray]]
    scatter_px: Mapping[str, Mapping[Reference, FloatArray]]
    frozen_px: Mapping[str, Mapping[Reference, FloatArray]]
    bundle_px: FloatArray  # (n, 2) Traced positions of the points
    position_px: Mapping[str, FloatArray]  # (n, 2) Expected mean centroids: traced light as the centroider sees it
    point_px: Mapping[str, FloatArray]  # (n, 2) Predicted error of a mean centroid by noise and response pattern
    marking_px: float  # Standard deviation per axis of a surveyed coordinate

    def of_surveys_px(self, method: str, reference: Reference, surveys: int) -> FloatArray:
        """Standard deviation (3, 2) of the RMS over a number of surveys of one chip and one run."""
        one, frozen = self.scatter_px[method][reference], self.frozen_px[method][reference]
        return np.sqrt(frozen**2 + np.maximum(one**2 - frozen**2, 0.0) / surveys)


def camera_projector(place: FloatArray, reference: Reference) -> FloatArray:
    """Projector (2 n, 2 n), x and y of point after point, onto the terms of a camera model.

    With z = x + iy: shift 1 and i, scale z, roll iz; of Brown and Conrady |z|^2 z, |z|^4 z, z^2 + 2 |z|^2 and
    i (2 |z|^2 - z^2).
    """
    z = place[:, 0] + 1j * place[:, 1]
    r2 = np.abs(z) ** 2
    terms = [] if reference == "nominal" else [1.0 + 0.0 * z, 1j + 0.0 * z, z, 1j * z]
    if reference == "calibrated":
        terms += [z * r2, z * r2**2, z**2 + 2.0 * r2, 1j * (2.0 * r2 - z**2)]
    columns = np.array([np.column_stack([v.real, v.imag]).ravel() for v in terms]).reshape(len(terms), 2 * len(z))
    basis = np.linalg.qr(columns.T)[0]
    return np.asarray(basis @ basis.T)


def _blocks(covariance: FloatArray) -> FloatArray:
    """Block-diagonal (2 n, 2 n) of (n, 2, 2)."""
    n = len(covariance)
    out = np.zeros((n, 2, n, 2))
    out[np.arange(n), :, np.arange(n), :] = covariance
    return out.reshape(2 * n, 2 * n)


def predicted_numbers(errors: GridErrors, order: int, reference: Reference) -> Numbers:
    """The document's numbers from the errors in the residuals (see the module)."""
    points, one = len(errors.place), np.eye(2 * len(errors.place))
    camera = one - camera_projector(errors.place, reference)
    chip, session, known = (_blocks(v) for v in (errors.chip_px2, errors.session_px2, errors.mean_px2))
    if reference == "calibrated":
        frames = camera @ chip @ camera + session + (one - camera) @ session @ (one - camera)
    else:
        frames = camera @ (chip + session) @ camera
    mean = camera @ errors.offset_px.reshape(-1)
    marked = errors.marking_px**2 * camera
    basis = np.linalg.qr(polynomial_basis(errors.place, order))[0]
    hat, constant = basis @ basis.T, np.full((points, points), 1.0 / points)
    out = np.empty((3, 3, 2))
    for axis in range(2):
        u, frozen, survey, own = (v[axis::2] for v in (mean, frames, marked, camera @ known @ camera))
        frozen, survey, own = (v[:, axis::2] for v in (frozen, survey, own))
        for row, q in enumerate((np.eye(points) - constant, np.eye(points) - hat, hat - constant)):
            square = u @ q @ u + np.trace(q @ (frozen + survey - own))  # the mean's own noise is in u'Qu
            every = _variance(q, u, frozen + survey + own)
            fixed = _variance(q, u, frozen + own)
            root = np.sqrt(max(square, 0.0) / (points - 1))
            spread = np.array([every, fixed]) / (4.0 * max(square, 1e-300) * (points - 1))
            out[:, row, axis] = root, *np.sqrt(spread)
    return Numbers(*out)


def _variance(q: FloatArray, u: FloatArray, covariance: FloatArray) -> float:
    """Variance of the squared length of a normal vector of mean u and this covariance, projected by q."""
    inside = q @ covariance @ q
    return float(2.0 * (inside * inside.T).sum() + 4.0 * u @ inside @ u)


def marking_errors(target: GridTarget, instrument: Instrument, direction: FloatArray) -> GridErrors:
    """Residuals of a target (n, 3) through a perfect camera without noise: marking errors alone."""
    _, place = camera_place(instrument, direction)
    # an error of the surveyed tangent is one of the nominal coordinate, the same at every place
    scale_px = instrument.focal_length_mm / instrument.camera.pixel_pitch_mm
    none = np.zeros((len(place), 2, 2))
    return GridErrors(
        place=place,
        offset_px=np.zeros_like(place),
        chip_px2=none,
        session_px2=none,
        mean_px2=none,
        marking_px=target.marking_error_arcsec * ARCSEC_RAD * scale_px,
    )


def predict_distortion(
    bench: Bench,
    instrument: Instrument,
    target: GridTarget,
    direction: FloatArray,
    *,
    psf: Sequence[EffectivePsf],
    order: int = 3,
    references: Sequence[Reference] = tuple(REFERENCES),
    noise_draws: int = 0,
    defect: NDArray[np.bool_] | None = None,
    seed: int = 0,
) -> DistortionPrediction:
    """Prediction for every centroider of the bench."""
    bench = one_filter(bench)
    noise, told = instrument.pixel_noise(), nominal_noise(instrument)
    windows = target_windows(bench, instrument, direction[None], psf, defect=defect)
    nominal, _ = camera_place(instrument, direction)
    marked = marking_errors(target, instrument, direction)
    found: dict[str, dict[Reference, Numbers]] = {}
    point: dict[str, FloatArray] = {}
    expected: dict[str, FloatArray] = {}
    for name, centroider in centroiders(bench, psf).items():
        response = window_response(centroider, windows, told)
        chip = response.covariance_px2(noise.response_e2(windows.light_e))
        position, single = response.position_px, response.covariance_px2(noise.temporal_e2(windows.light_e))
        own = np.zeros_like(chip)
        if noise_draws and not needs_epsf(name):
            lots = Streams(seed).generator("distortion noise")
            drawn = drawn_positions(centroider, windows, told, noise, draws=noise_draws, rng=lots)
            position, single = np.nanmean(drawn, axis=0), _covariance(drawn)
            own = single / noise_draws
        if sessions := session_centroiders(bench, psf, name):
            position, built = _over_sessions(sessions, windows, told)
            chip, own = chip + built, own + built / len(sessions)
        dark = response.covariance_px2(np.full_like(windows.light_e, noise.floor_e2 / bench.dark_frames))
        session = single / bench.frames + dark
        expected[name] = position
        point[name] = np.sqrt(np.diagonal(chip + session, axis1=1, axis2=2))
        offset = position - nominal
        errors = replace(marked, offset_px=offset, chip_px2=chip, session_px2=session, mean_px2=own)
        found[name] = {reference: predicted_numbers(errors, order, reference) for reference in references}
    return DistortionPrediction(
        pixel_arcsec=instrument.pixel_arcsec,
        mean_px={m: {r: v.rms_px for r, v in of.items()} for m, of in found.items()},
        scatter_px={m: {r: v.scatter_px for r, v in of.items()} for m, of in found.items()},
        frozen_px={m: {r: v.frozen_px for r, v in of.items()} for m, of in found.items()},
        bundle_px=windows.position_px,
        position_px=expected,
        point_px=point,
        marking_px=marked.marking_px,
    )


def _over_sessions(
    sessions: Sequence[Centroider], windows: ExpectedWindows, told: NoiseModel
) -> tuple[FloatArray, FloatArray]:
    """Mean position (n, 2) over the PSFs that sessions might give, and the covariance (n, 2, 2) of what they do apart;
    what a PSF does to all points alike is a shift of the camera."""
    position = np.stack([noiseless_positions(one, windows, told) for one in sessions])
    return position.mean(0), _covariance(position - position.mean(1, keepdims=True))


def _covariance(drawn_px: FloatArray) -> FloatArray:
    """Covariance (n, 2, 2) of positions (draws, n, 2); draws without a position are left out."""
    apart = drawn_px - np.nanmean(drawn_px, axis=0)
    count = np.isfinite(apart[..., 0]).sum(0)[:, None, None]
    filled = np.nan_to_num(apart)
    return np.asarray(np.einsum("dna,dnb->nab", filled, filled) / (count - 1))


class MapForecast(NamedTuple):
    """Error of a polynomial map over the whole detector, shift and roll taken out; [px], RMS per axis."""

    bias_px: FloatArray  # (2,) Distortion that the polynomial cannot follow
    noise_px: FloatArray  # (2,) Marking and centroid errors carried into the map


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
) -> MapForecast:
    """Expected map error of a target of this kind."""
    direction = grid_directions(target, instrument, Streams(seed).generator("forecast"))
    nominal, place = camera_place(instrument, direction)
    dense_nominal, dense_place = camera_place(instrument, dense_grid(instrument, *grid))
    carry = polynomial_basis(dense_place, order) @ np.linalg.pinv(polynomial_basis(place, order))
    found = traced_bundles(bench, instrument, direction) - nominal
    bias = without_pointing(dense_place, traced_px - dense_nominal - carry @ found)
    error = np.hypot(point_error_px, target.marking_error_arcsec / instrument.pixel_arcsec)
    parts = []
    for axis in range(2):  # columns of ``carry`` are the maps that a unit error of one point's one axis makes
        unit = np.zeros((*carry.shape, 2))
        unit[:, :, axis] = carry
        parts.append(np.stack([without_pointing(dense_place, unit[:, j]) for j in range(unit.shape[1])]))
    noise2 = sum((part**2).mean(1).sum(0) for part in parts)
    return MapForecast(np.sqrt((bias**2).mean(0)), np.asarray(error * np.sqrt(noise2)))
