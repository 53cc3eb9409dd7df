"""High spatial frequency error predicted without frames: S-curve by PSF sampling, patterns by response to pixels.

A pattern value p of a pixel (variance s^2, independent from pixel to pixel, fixed while the image moves) moves the
centroid at position k by h_k p, h_k being the response to the pixel times the factor of p: the light for PRNU, 1 for
an offset. The statistic of ACC18 (eq. 9-10) contains h_{k+1} - h_k, the error of one position h_k:

    steps:  s^2 sum (h_{k+1} - h_k)^2 (1 - 1/W),        one position:  s^2 sum h_k^2.

The S-curve and masked pixels are known functions of the star's position, which depends on the platform: its errors move
all stars together and cancel in the differences as motion, but not in S-curve and pattern, which longer and shorter
steps sample differently. A prediction is therefore made either for many drawn paths of the platform (before the test),
or for the measured common motion of the images (after it). On a drawn path h_k follows from its derivatives by the
position, as the errors of a step are small against a star image.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calib.accuracy.budget_comparison import next_draw_variance
from calib.accuracy.error_budget import ErrorTerm
from calib.accuracy.high_frequency import position_rms_px, step_rms_px
from calib.measure.centroid_error.expected_windows import (
    ExpectedWindows,
    PixelStatistics,
    drawn_positions,
    noiseless_positions,
    usable_pixels,
    window_response,
)
from calib.measure.centroiding.registry import Centroider
from calib.records import NoiseModel
from optics.arrays import FloatArray

CAUSES = ("s_curve", "prnu", "pattern", "defects")
"""S-curve: what pixels and the centroider's model make of a noiseless image; it is no property of the detector."""
FIT_NOISE_PX = 0.03
"""Noise of a fit from which on its bias is drawn: below, it is less than some (0.03 px)^2 = 1e-3 px."""
FIRST_DRAWS, WELL_KNOWN = 6, 0.2
"""Draws that are made first, and the part of the noise of a mean over frames to which their mean has to be known."""
NEAR_PX = 0.1
"""Step of derivatives of responses by the position: the error of a step is of that size."""


@dataclass(frozen=True, slots=True, kw_only=True)
class StepPrediction:
    """Expected results of the step test for a centroider; m positions, j stars, 1 sigma, (x, y)."""

    s_curve_px: FloatArray  # (m, j, 2) Error of the noiseless centroid
    cause_px: Mapping[str, FloatArray]  # (2,) Each of `CAUSES` in the RMS of steps
    cause_position_px: Mapping[str, FloatArray]  # (2,) Each cause in the error of one position
    # (2,) Averaged temporal noise, noise of the averaged dark frames, and roll of the platform, which the mean over
    # the stars does not take out, in the RMS of steps
    temporal_px: FloatArray
    dark_px: FloatArray
    roll_px: FloatArray
    # (2,) RMS of steps (`calib.accuracy.high_frequency.step_rms_px`), RMS over drawn chips, paths, noise, and sessions
    # that gave the PSF, and its standard deviation over them
    step_rms_px: FloatArray
    step_rms_scatter_px: FloatArray
    # (k, 2) Its square by the S-curve alone, for each session that might have given the PSF; the same session serves
    # all places of a test. Empty where no PSF was built
    session_px2: FloatArray
    position_rms_px: FloatArray  # (2,) Error of one position, and its standard deviation over drawn chips and paths
    position_rms_scatter_px: FloatArray


@dataclass(frozen=True, slots=True, kw_only=True)
class StepModel:
    """A step test of W stars at m positions: windows along the path, pixels, frames, errors of the platform."""

    windows: ExpectedWindows  # (m W) windows, position after position, on the path that is commanded or was measured
    positions: int  # m
    noise: NoiseModel  # Handed to the centroider
    pixel: PixelStatistics  # True noise and patterns of a pixel
    frames: int  # Frames averaged at a position, dark frames averaged once
    dark_frames: int
    # (m, 2) Offsets of drawn paths from the commanded one, and the windows there; none for a platform without errors
    offsets_px: Sequence[FloatArray] = ()
    drawn_windows: Sequence[ExpectedWindows] = ()
    roll_rad: float = 0.0  # Standard deviation of the roll of the platform at a position
    dark_subtracted: bool = True  # Whether the mean dark frame is subtracted; if not, offset patterns stay
    defect: NDArray[np.bool_] | None = None  # Pixels of the detector that are left out
    draws: int = 200  # Drawn chips, paths and noise
    # Fresh generators of the noise by which biases are drawn: the same noise for every path and session
    bias_rng: Callable[[], np.random.Generator] = lambda: np.random.default_rng(0)

    def predict(
        self,
        centroider: Centroider,
        rng: np.random.Generator,
        *,
        sessions: Sequence[Centroider] = (),
        noise_draws: int = 0,
        fit_draws: int = 0,
    ) -> StepPrediction:
        """Expected results of a centroider.

        ``sessions``: the same estimator with the PSFs that several sessions might have given. ``noise_draws``: noisy
        copies of each window whose mean is the centroid, for an estimator that is not linear (a threshold).
        ``fit_draws``: pairs of noisy copies by which the bias of a fit is drawn where its noise is large.
        """
        windows, m = self.windows, self.positions
        response = window_response(centroider, windows, self.noise)
        each = sessions or [centroider]
        # the commanded path is not one of those that a platform with errors takes
        runs = [(each[i % len(each)], path) for i, path in enumerate(self.drawn_windows or [windows] * len(each))]
        masked = [self._masked(*run) for run in runs]
        sigma = response.sigma_px(self.pixel.temporal_e2(windows.light_e, frames=self.frames)).reshape(m, -1, 2)
        curves, errors = map(list, zip(*(self._curve(*run, sigma, noise_draws) for run in runs), strict=True))
        one_frame = response.sigma_px(self.pixel.temporal_e2(windows.light_e))
        if fit_draws and np.sqrt(np.mean(one_frame**2)) >= FIT_NOISE_PX:
            bias, error = self._bias(centroider, windows, fit_draws, sigma)
            curves, errors = [curve + bias for curve in curves], [error] * len(curves)
        prnu, offsets, dark = self._patterns(centroider, response.gain_px_per_e)
        lever, free = self._lever(), 1.0 - 1.0 / sigma.shape[1]
        # a curve has some noise already: that of the draws whose mean it is
        noise_px = [np.sqrt(np.maximum(sigma**2 - error**2, 0.0)) for error in errors]
        deterministic_px = [curve + mask for curve, mask in zip(curves, masked, strict=True)]
        steps, single = self._drawn_rms(deterministic_px, noise_px, (prnu, *offsets, *dark), lever, rng)
        session_curves = [self._curve(session, windows, sigma, noise_draws)[0] for session in sessions]
        return StepPrediction(
            s_curve_px=curves[0],
            cause_px={
                "s_curve": rms_over([step_rms_px(curve) for curve in curves]),
                "prnu": np.sqrt(free * self._steps2([prnu])),
                "pattern": np.sqrt(free * self._steps2(offsets)),
                "defects": rms_over([step_rms_px(mask) for mask in masked]),
            },
            cause_position_px={
                "s_curve": rms_over([position_rms_px(curve) for curve in curves]),
                "prnu": np.sqrt(_mean2([prnu])),
                "pattern": np.sqrt(_mean2(offsets)),
                "defects": rms_over([position_rms_px(mask) for mask in masked]),
            },
            temporal_px=np.sqrt(free * (sigma[1:] ** 2 + sigma[:-1] ** 2).mean((0, 1))),
            dark_px=np.sqrt(free * self._steps2(dark)),
            roll_px=self.roll_rad * np.sqrt(2.0 * (lever**2).mean(0)),
            step_rms_px=rms_over(steps),
            step_rms_scatter_px=np.std(steps, axis=0, ddof=1),
            session_px2=np.reshape([step_rms_px(curve) ** 2 for curve in session_curves], (-1, 2)),
            position_rms_px=rms_over(single),
            position_rms_scatter_px=np.std(single, axis=0, ddof=1),
        )

    def _drawn_rms(
        self,
        known_px: Sequence[FloatArray],
        sigma_px: Sequence[FloatArray],
        patterns: Sequence[FloatArray],
        lever: FloatArray,
        rng: np.random.Generator,
    ) -> tuple[list[FloatArray], list[FloatArray]]:
        """RMS of steps and of positions (2,) of drawn chips on every path, of known errors (m, W, 2) and noise."""
        steps, single, m = [], [], self.positions
        for path, (deterministic, sigma) in enumerate(zip(known_px, sigma_px, strict=True)):
            draws, stars = len(range(path, self.draws, len(known_px))), deterministic.shape[1]
            fixed = np.broadcast_to(deterministic, (draws, *deterministic.shape))
            for part in patterns:
                moved = self._on_path(part, path).reshape(stars, 2 * m, -1)
                shift = moved @ rng.standard_normal((stars, moved.shape[2], draws))
                fixed = fixed + shift.reshape(stars, m, 2, draws).transpose(3, 1, 0, 2)
            rolled = self.roll_rad * rng.standard_normal((draws, m, 1, 1)) * lever
            noisy = fixed + rolled + sigma * rng.standard_normal((draws, *sigma.shape))
            steps += [step_rms_px(drawn) for drawn in noisy]
            single += [position_rms_px(drawn) for drawn in fixed]
        return steps, single

    def _lever(self) -> FloatArray:
        """Motion of the stars (j, 2) per radian of roll, without their mean."""
        position = self.windows.position_px.reshape(self.positions, -1, 2).mean(0)
        from_mean = position - position.mean(0)
        return np.column_stack([-from_mean[:, 1], from_mean[:, 0]])

    def _patterns(
        self, centroider: Centroider, gain: FloatArray
    ) -> tuple[FloatArray, list[FloatArray], list[FloatArray]]:
        """Responses (1 or 3, W, m, 2, y, x) to PRNU, offset patterns left in the data, noise of dark frames.

        With their derivatives by the position where paths are drawn.
        """
        windows, pixel = [self.windows], self.pixel
        if self.offsets_px:
            windows += [self.windows.moved(NEAR_PX * axis) for axis in np.eye(2)]
        gains = [gain, *(window_response(centroider, moved, self.noise).gain_px_per_e for moved in windows[1:])]

        def responses(size: float, gains: Sequence[FloatArray]) -> FloatArray:
            first, *others = (self._fixed(gain, size) for gain in gains)
            return np.stack([first, *((other - first) / NEAR_PX for other in others)])

        prnu = responses(pixel.prnu, [g * of.light_e[:, None] for g, of in zip(gains, windows, strict=True)])
        if not self.dark_subtracted:
            column = responses(pixel.column_e, gains).sum(4, keepdims=True)
            return prnu, [responses(pixel.offset_e, gains), column], []
        return prnu, [], [responses(float(np.sqrt(pixel.floor_e2 / self.dark_frames)), gains)]

    def _on_path(self, response: FloatArray, path: int) -> FloatArray:
        """Response (W, m, 2, y, x) on a drawn path, or on the commanded one where none was drawn."""
        if len(response) == 1:
            return np.asarray(response[0])
        return np.asarray(response[0] + np.einsum("mb,bjmayx->jmayx", self.offsets_px[path], response[1:]))

    def _steps2(self, responses: Sequence[FloatArray]) -> FloatArray:
        """Mean square (2,) of the change from one position to the next, over the drawn paths; sum of the patterns."""
        total = np.zeros(2)
        for response in responses:
            paths = [self._on_path(response, path) for path in range(len(self.offsets_px) or 1)]
            total += np.mean([(np.diff(path, axis=1) ** 2).sum((3, 4)).mean((0, 1)) for path in paths], axis=0)
        return total

    def _bias(
        self, centroider: Centroider, windows: ExpectedWindows, draws: int, sigma_px: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """What noise adds to the mean centroid, of second order in it, and its standard error: (m, W, 2).

        Of pairs of opposite noise; few are enough for a centroider that is nearly linear.
        """
        rng, given = self.bias_rng(), (centroider, windows, self.noise)
        noiseless, pairs = noiseless_positions(*given), np.empty((0, *windows.position_px.shape))
        for count in (min(FIRST_DRAWS, draws), draws - FIRST_DRAWS):
            drawn = drawn_positions(*given, self.pixel, draws=2 * count, rng=rng, mirrored=True)
            new = drawn.reshape(count, 2, *noiseless.shape).mean(1) - noiseless  # NaN where a fit failed
            pairs = np.concatenate([pairs, new])
            mean = np.nanmean(pairs, axis=0).reshape(sigma_px.shape)
            error = (np.nanstd(pairs, axis=0, ddof=1) / np.sqrt(len(pairs))).reshape(sigma_px.shape)
            if len(pairs) == draws or np.nanmean(error**2) < WELL_KNOWN**2 * np.mean(sigma_px**2):
                break
        return mean, error

    def _curve(
        self, centroider: Centroider, windows: ExpectedWindows, sigma_px: FloatArray, noise_draws: int
    ) -> tuple[FloatArray, FloatArray]:
        """Error (m, W, 2) of the noiseless centroids, or of their mean over drawn noise, and its standard error."""
        measured = noiseless_positions(centroider, windows, self.noise)
        curve = np.asarray((measured - windows.position_px).reshape(self.positions, -1, 2))
        if not noise_draws:
            return curve, np.zeros_like(curve)
        bias, error = self._bias(centroider, windows, noise_draws // 2, sigma_px)
        return curve + bias, error

    def _fixed(self, response: FloatArray, size: float) -> FloatArray:
        """Responses (n, 2, h, w) times ``size``, on pixels common to all positions of a star: (W, m, 2, y, x)."""
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
        """What leaving out known bad pixels does to the noiseless centroids (m, W, 2)."""
        moved = np.zeros_like(windows.position_px)
        if self.defect is not None:
            valid = usable_pixels(self.defect, windows.corner_px, windows.light_e.shape[1])
            hit = np.flatnonzero(~valid.all((1, 2)))
            if hit.size:
                masked, unmasked = (windows.select(hit, of) for of in (valid, np.ones_like(valid)))
                with_mask, without = (
                    noiseless_positions(centroider, window, self.noise) for window in (masked, unmasked)
                )
                moved[hit] = with_mask - without
        return moved.reshape(self.positions, -1, 2)


def rms_over(values: Sequence[FloatArray]) -> FloatArray:
    """Root mean square over a sequence of arrays of one shape."""
    return np.asarray(np.sqrt(np.mean(np.square(values), axis=0)))


def _mean2(responses: Sequence[FloatArray]) -> FloatArray:
    """Mean square (2,) at a position of the commanded path; sum of the patterns."""
    return np.asarray(sum(((response[0] ** 2).sum((3, 4)).mean((0, 1)) for response in responses), np.zeros(2)))


def step_term(predictions: Sequence[StepPrediction], *, places: int, pixel_arcsec: float) -> ErrorTerm:
    """High spatial frequency error, 3 sigma, as root mean square over the places of the test.

    The uncertainty is the scatter of the number of a test at ``places``, of which some are predicted: other chips,
    other noise, other paths. A session that gave the PSF serves all places: its effect does not average over them.
    """
    value = rms_over([prediction.step_rms_px for prediction in predictions])
    variance = np.mean(
        [(2.0 * prediction.step_rms_px * prediction.step_rms_scatter_px) ** 2 for prediction in predictions], axis=0
    )
    of_session = common = np.zeros(2)
    if len(predictions[0].session_px2):
        of_session = np.mean([prediction.session_px2.var(0, ddof=1) for prediction in predictions], axis=0)
        common = next_draw_variance(np.mean([prediction.session_px2 for prediction in predictions], axis=0))
    of_square = np.maximum(variance - of_session, 0.0) / places + common
    spread = np.sqrt(of_square) / np.maximum(2.0 * value, 1e-300)
    scale = 3.0 * pixel_arcsec
    return ErrorTerm(arcsec=scale * value, uncertainty_arcsec=scale * spread)
