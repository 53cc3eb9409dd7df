"""High spatial frequency error predicted without frames: S-curve by PSF sampling, patterns by the influence function.

A pattern value p of a pixel (variance s^2, independent from pixel to pixel, fixed while the image moves) moves the
centroid at position k by h_k p, h_k being the influence of the pixel times the factor of p: the light for PRNU, 1 for
an offset. The document's number contains h_{k+1} - h_k, the error of one position h_k:

    document:  s^2 sum (h_{k+1} - h_k)^2 (1 - 1/W),        one position:  s^2 sum h_k^2.

The S-curve and masked pixels are known functions of the star's position, which depends on the hexapod: its errors move
all stars together and cancel in the differences as motion, but not in S-curve and pattern, which longer and shorter
steps sample differently. A prediction is therefore made either for many drawn paths of the hexapod (before the test),
or for the measured common motion of the images (after it). On a drawn path h_k follows from its derivatives by the
position, as the errors of a step are small against a star image.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from calib.accuracy.high_frequency import position_rms_px, step_rms_px
from calib.measure.centroid import Centroider
from calib.measure.expected_windows import (
    ExpectedWindows,
    drawn_positions,
    noiseless_positions,
    usable_pixels,
    window_response,
)
from calib.records import NoiseModel
from experiments.laboratory.bench.centroid_methods import needs_epsf
from experiments.laboratory.bench.point_bench import Bench, centroiders, session_centroiders
from experiments.laboratory.bench.point_frames import Subtraction
from experiments.laboratory.bench.point_scene import one_filter
from experiments.laboratory.bench.ray_prediction import bundle_prediction, target_windows
from experiments.laboratory.bench.readout.noise_model import nominal_noise
from experiments.laboratory.devices.hexapod import Hexapod, turned
from experiments.laboratory.high_frequency import CAUSES, StepPlan
from experiments.laboratory.temporal_error import target_place
from optics.arrays import FloatArray
from optics.units import ARCSEC_RAD
from render.detector.noise import PixelNoise
from render.engine.random import Streams
from render.records import EffectivePsf
from render.sensor_file.instrument import Instrument

FIT_NOISE_PX = 0.03
"""Noise of a fit from which on its bias is drawn: below, it is less than some (0.03 px)^2 = 1e-3 px."""

PATHS = 24
"""Drawn paths of a hexapod with errors; roll is too small to change S-curve and pattern."""

FIRST_DRAWS, WELL_KNOWN = 6, 0.2
"""Draws that are made first, and the noise of a mean over frames in whose share their mean has to be known."""

NEAR_PX = 0.1
"""Over which derivatives of influences by the place are taken: the error of a step is of that size."""


@dataclass(frozen=True, slots=True, kw_only=True)
class MethodPrediction:
    """Expected results of one centroider; all pixels, 1 sigma, (x, y)."""

    s_curve_px: FloatArray  # (m, j, 2) Error of the noiseless centroid
    cause_px: Mapping[str, FloatArray]  # (2,) Each cause in the document's number
    cause_single_px: Mapping[str, FloatArray]  # (2,) Each cause in the error of one position
    # (2,) Averaged temporal noise, noise of the averaged dark frames, and roll of the hexapod, which the mean over
    # the stars does not take out, in the document's number
    temporal_px: FloatArray
    dark_px: FloatArray
    roll_px: FloatArray
    # (2,) The document's number, RMS over drawn chips, paths, noise, and sessions that gave the PSF
    document_px: FloatArray
    scatter_px: FloatArray  # (2,) Standard deviation of the document's number over them
    # (k, 2) Square of the document's number by the S-curve alone, for each session that might have given the PSF; the
    # same session serves all places. Empty where no PSF was built
    session_px2: FloatArray
    single_px: FloatArray  # (2,) Error of one position
    single_scatter_px: FloatArray  # (2,) Its standard deviation over drawn chips and paths


@dataclass(frozen=True, slots=True, kw_only=True)
class HighFrequencyPrediction:
    """Predictions by centroider."""

    pixel_arcsec: float  # Angle of a pixel
    place_px: FloatArray  # (m, j, 2) Traced positions of an ideal hexapod, or as shifted
    method: Mapping[str, MethodPrediction]  # By name

    def document_arcsec(self, method: str) -> FloatArray:
        """HSFE as printed (2,), 3 sigma."""
        return 3.0 * self.pixel_arcsec * self.method[method].document_px


def predict_high_frequency(
    bench: Bench,
    instrument: Instrument,
    plan: StepPlan,
    *,
    psf: Sequence[EffectivePsf],
    hexapod: Hexapod | None = None,
    shift_px: FloatArray | None = None,
    corner_px: NDArray[np.int64] | None = None,
    place_px: Sequence[float] | None = None,
    subtraction: Subtraction = "dark",
    defect: NDArray[np.bool_] | None = None,
    draws: int = 200,
    noise_draws: int = 0,
    seed: int = 0,
) -> HighFrequencyPrediction:
    """Prediction for every centroider; ``corner_px`` (m, j, 2): windows of a test that was made."""
    bench = one_filter(bench)
    rng = Streams(seed).generator("high-frequency prediction")
    ideal = Hexapod(step_error_arcsec=0.0, roll_error_arcsec=0.0, reading_error_arcsec=0.0)
    path = plan.path(instrument, ideal, rng)
    direction = turned(target_place(bench, instrument, place_px), path.commanded_rad)
    shift = np.zeros((plan.positions, 2)) if shift_px is None else np.asarray(shift_px, float)
    place = bundle_prediction(bench, instrument, direction)[:, :, bench.reference]
    windows = target_windows(bench, instrument, direction, psf, place + shift[:, None], corner_px=corner_px)
    error_px = hexapod.step_error_arcsec / instrument.pixel_arcsec if hexapod is not None and shift_px is None else 0.0
    drawn = [error_px * rng.standard_normal(shift.shape) for _ in range(PATHS if error_px > 0 else 0)]
    model = _Model(
        told=nominal_noise(instrument),
        frames=bench.frames,
        dark_frames=bench.dark_frames,
        windows=windows,
        others=[target_windows(bench, instrument, direction, psf, place + one[:, None]) for one in drawn],
        offsets_px=drawn,
        positions=plan.positions,
        noise=instrument.pixel_noise(),
        subtraction=subtraction,
        defect=defect,
        draws=draws,
        noise_draws=noise_draws,
        seed=seed,
        roll_rad=0.0 if hexapod is None else hexapod.roll_error_arcsec * ARCSEC_RAD,
    )
    return HighFrequencyPrediction(
        pixel_arcsec=instrument.pixel_arcsec,
        place_px=windows.position_px.reshape(plan.positions, -1, 2),
        method={
            name: replace(model, noise_draws=0 if needs_epsf(name) else noise_draws).method(
                one, session_centroiders(bench, psf, name), rng, fit_draws=noise_draws if needs_epsf(name) else 0
            )
            for name, one in centroiders(bench, psf).items()
        },
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class _Model:
    told: NoiseModel
    frames: int
    dark_frames: int
    windows: ExpectedWindows
    others: Sequence[ExpectedWindows]  # On drawn paths, which stand so far (m, 2) beside
    offsets_px: Sequence[FloatArray]
    positions: int
    noise: PixelNoise
    subtraction: Subtraction
    defect: NDArray[np.bool_] | None
    draws: int
    noise_draws: int
    seed: int
    roll_rad: float

    def method(
        self, centroider: Centroider, sessions: Sequence[Centroider], rng: np.random.Generator, *, fit_draws: int
    ) -> MethodPrediction:
        """Everything about one centroider, and the same with the PSF of each session."""
        windows, m = self.windows, self.positions
        gain = window_response(centroider, windows, self.told)
        each = sessions or [centroider]
        # the ideal path is not one of those that an erring hexapod takes
        runs = [(each[i % len(each)], one) for i, one in enumerate(self.others or [windows] * len(each))]
        masked = [self._masked(*one) for one in runs]
        sigma = gain.sigma_px(self.noise.temporal_e2(windows.light_e, frames=self.frames)).reshape(m, -1, 2)
        curves, scatters = map(list, zip(*(self._curve(*one, sigma) for one in runs), strict=True))
        one_frame = gain.sigma_px(self.noise.temporal_e2(windows.light_e))
        if fit_draws and np.sqrt(np.mean(one_frame**2)) >= FIT_NOISE_PX:
            bias, scatter = self._bias(centroider, windows, fit_draws, sigma)
            curves, scatters = [one + bias for one in curves], [scatter] * len(curves)
        prnu, offsets, dark = self._patterns(centroider, gain.gain_px_per_e)
        stars = curves[0].shape[1]
        share = 1.0 - 1.0 / stars
        cause = {
            "s_curve": _rms([step_rms_px(one) for one in curves]),
            "prnu": np.sqrt(share * self._steps2(prnu)),
            "pattern": np.sqrt(share * sum((self._steps2(part) for part in offsets), np.zeros(2))),
            "defects": _rms([step_rms_px(one) for one in masked]),
        }
        single = {
            "s_curve": _rms([position_rms_px(one) for one in curves]),
            "prnu": np.sqrt(_mean2(prnu[0])),
            "pattern": np.sqrt(sum((_mean2(part[0]) for part in offsets), np.zeros(2))),
            "defects": _rms([position_rms_px(one) for one in masked]),
        }
        document, error, lever = [], [], self._lever()
        for path, (curve, scatter) in enumerate(zip(curves, scatters, strict=True)):
            draws = len(range(path, self.draws, len(curves)))
            fixed = np.broadcast_to(curve + masked[path], (draws, *curve.shape))
            for part in (prnu, *offsets, *dark):
                moved = self._on_path(part, path).reshape(stars, 2 * m, -1)
                shift = moved @ rng.standard_normal((stars, moved.shape[2], draws))
                fixed = fixed + shift.reshape(stars, m, 2, draws).transpose(3, 1, 0, 2)
            rolled = self.roll_rad * rng.standard_normal((draws, m, 1, 1)) * lever
            # the curve has some noise already: that of the draws whose mean it is
            left = np.sqrt(np.maximum(sigma**2 - scatter**2, 0.0))
            noisy = fixed + rolled + left * rng.standard_normal((draws, *left.shape))
            document += [step_rms_px(one) for one in noisy]
            error += [position_rms_px(one) for one in fixed]
        return MethodPrediction(
            s_curve_px=curves[0],
            cause_px={name: np.asarray(cause[name]) for name in CAUSES},
            cause_single_px={name: np.asarray(single[name]) for name in CAUSES},
            temporal_px=np.sqrt(share * (sigma[1:] ** 2 + sigma[:-1] ** 2).mean((0, 1))),
            dark_px=np.sqrt(share * sum((self._steps2(part) for part in dark), np.zeros(2))),
            roll_px=self.roll_rad * np.sqrt(2.0 * (lever**2).mean(0)),
            document_px=_rms(document),
            scatter_px=np.std(document, axis=0, ddof=1),
            session_px2=np.reshape(
                [step_rms_px(self._curve(one, windows, sigma)[0]) ** 2 for one in sessions], (-1, 2)
            ),
            single_px=_rms(error),
            single_scatter_px=np.std(error, axis=0, ddof=1),
        )

    def _lever(self) -> FloatArray:
        """Motion of the stars (j, 2) per radian of roll, without their mean."""
        place = self.windows.position_px.reshape(self.positions, -1, 2).mean(0)
        from_mean = place - place.mean(0)
        return np.column_stack([-from_mean[:, 1], from_mean[:, 0]])

    def _patterns(
        self, centroider: Centroider, gain: FloatArray
    ) -> tuple[FloatArray, list[FloatArray], list[FloatArray]]:
        """Responses (1 or 3, j, m, 2, y, x) to PRNU, offset patterns left in the data, noise of dark frames; of a
        hexapod that errs with their derivatives by the place."""
        windows, noise = [self.windows], self.noise
        if self.offsets_px:
            windows += [self.windows.moved(NEAR_PX * along) for along in np.eye(2)]
        gains = [gain, *(window_response(centroider, one, self.told).gain_px_per_e for one in windows[1:])]

        def responses(size: float, of: Sequence[FloatArray]) -> FloatArray:
            first, *others = (self._fixed(one, size) for one in of)
            return np.stack([first, *((one - first) / NEAR_PX for one in others)])

        prnu = responses(noise.prnu, [g * one.light_e[:, None] for g, one in zip(gains, windows, strict=True)])
        if self.subtraction == "raw":
            column = responses(noise.column_e, gains).sum(4, keepdims=True)
            return prnu, [responses(noise.offset_e, gains), column], []
        return prnu, [], [responses(float(np.sqrt(noise.floor_e2 / self.dark_frames)), gains)]

    def _on_path(self, response: FloatArray, path: int) -> FloatArray:
        """Response (j, m, 2, y, x) on a drawn path, or on the ideal one where none was drawn."""
        if len(response) == 1:
            return np.asarray(response[0])
        return np.asarray(response[0] + np.einsum("mb,bjmayx->jmayx", self.offsets_px[path], response[1:]))

    def _steps2(self, response: FloatArray) -> FloatArray:
        """Mean square (2,) of the change from one position to the next, over the drawn paths."""
        parts = [self._on_path(response, path) for path in range(len(self.offsets_px) or 1)]
        return np.mean([(np.diff(part, axis=1) ** 2).sum((3, 4)).mean((0, 1)) for part in parts], axis=0)

    def _bias(
        self, centroider: Centroider, windows: ExpectedWindows, draws: int, sigma_px: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """What noise adds to the mean centroid, of second order in it, and its standard error: (m, j, 2).

        Of pairs of opposite noise; few are enough for a centroider that is nearly linear.
        """
        rng = Streams(self.seed).generator("high-frequency bias")
        given = (centroider, windows, self.told)
        noiseless, pairs = noiseless_positions(*given), np.empty((0, *windows.position_px.shape))
        for count in (min(FIRST_DRAWS, draws), draws - FIRST_DRAWS):
            drawn = drawn_positions(*given, self.noise, draws=2 * count, rng=rng, mirrored=True)
            new = drawn.reshape(count, 2, *noiseless.shape).mean(1) - noiseless  # NaN where a fit failed
            pairs = np.concatenate([pairs, new])
            mean, scatter = (of.reshape(sigma_px.shape) for of in _mean_and_error(pairs))
            if len(pairs) == draws or np.nanmean(scatter**2) < WELL_KNOWN**2 * np.mean(sigma_px**2):
                break
        return mean, scatter

    def _curve(
        self, centroider: Centroider, windows: ExpectedWindows, sigma_px: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Error (m, j, 2) of the noiseless centroids, or of their mean over drawn noise, and its standard error."""
        found = noiseless_positions(centroider, windows, self.told)
        error = np.asarray((found - windows.position_px).reshape(self.positions, -1, 2))
        if not self.noise_draws:
            return error, np.zeros_like(error)
        bias, scatter = self._bias(centroider, windows, self.noise_draws // 2, sigma_px)
        return error + bias, scatter

    def _fixed(self, response: FloatArray, size: float) -> FloatArray:
        """Responses (n, 2, h, w) times ``size``, on pixels common to all positions of a star: (j, m, 2, y, x)."""
        m = self.positions
        _, _, height, width = response.shape
        corner = self.windows.corner_px.reshape(m, -1, 2)
        first = corner.min(0)
        extent = (corner - first).max((0, 1))
        stars = corner.shape[1]
        out = np.zeros((stars, m, 2, height + int(extent[1]), width + int(extent[0])))
        parts = size * response.reshape(m, stars, 2, height, width)
        for k in range(m):
            for j in range(stars):
                x, y = (int(v) for v in corner[k, j] - first[j])
                out[j, k, :, y : y + height, x : x + width] = parts[k, j]
        return out

    def _masked(self, centroider: Centroider, windows: ExpectedWindows) -> FloatArray:
        """What leaving out known bad pixels does to the noiseless centroids (m, j, 2)."""
        moved = np.zeros_like(windows.position_px)
        if self.defect is not None:
            valid = usable_pixels(self.defect, windows.corner_px, windows.light_e.shape[1])
            hit = np.flatnonzero(~valid.all((1, 2)))
            if hit.size:
                masked, whole = (windows.select(hit, of) for of in (valid, np.ones_like(valid)))
                with_mask, without = (noiseless_positions(centroider, one, self.told) for one in (masked, whole))
                moved[hit] = with_mask - without
        return moved.reshape(self.positions, -1, 2)


def _mean_and_error(drawn: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Mean (n, 2) of positions (d, n, 2), and its standard error."""
    return np.nanmean(drawn, axis=0), np.nanstd(drawn, axis=0, ddof=1) / np.sqrt(len(drawn))


def _rms(values: Sequence[FloatArray]) -> FloatArray:
    """Root mean square over a list."""
    return np.asarray(np.sqrt(np.mean(np.square(values), axis=0)))


def _mean2(part: FloatArray) -> FloatArray:
    """Mean square (2,) at a position."""
    return np.asarray((part**2).sum((3, 4)).mean((0, 1)))
