"""Noise of pictures and sun sensor, predicted from detector, light and geometry without pictures or fits.

Pictures. A circle fitted to a contour through points at every angle moves by the sum over the light of g times its
noise. With the window W(x) of the lines, ``3 (1 - x^2 / h^2) / (4 h)``, the contour's radius R and the slope s of the
brightness there,

    g = W(r - R) cos(theta) / (pi R |s|)           per unit area, for x; sin(theta) for y.

For pixel noise of variance v, sampled along n rays with pixels left out between them, bilinear interpolation leaves 2/3
of the variance across a ray, and 3 / (5 h) of it along:  var = (2 / n) (2/3) 3 v / (5 h s^2). A spoke of the hole's
edge takes half of the brightness next to the edge as its level, whose noise is added. The particles of the rendering
add noise that a laboratory does not have: to first order the sum of g over the landing points of a Sobol net, scrambled
anew each time. It is about a quarter of the noise of independent particles, so that the effect of particles on the
slopes, without such cancellation, is as large. The rim and its slope follow from the overlap of two circles
(`experiments.cube.bench.spot_profile`).

Sun sensor. The centre of light of a window moves by ``(x - x_c) / F`` times the noise of a pixel, F its electrons. The
noise of spots and readings at each position is propagated through the least squares of a pinhole on a table by finite
differences.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from scipy.stats import qmc

from experiments.cube.bench import Laboratory, spot_profile
from experiments.cube.sensor import EXPOSURE_S, field_angles
from experiments.cube.trim import BESIDE_PX, EDGE_HALF_WIDTH_PX, RAYS, RIM_LEVEL, SPOKES
from experiments.laboratory.devices.turntable import build_turntable
from optics.arrays import FloatArray
from optics.units import ARCSEC_RAD, RAD_ARCSEC
from render.bench.trace import OVERSCAN
from render.detector.noise import PixelNoise
from render.detector.spec import Detector

NETS = 48
"""Scrambled nets whose sums give the particles' part: its standard deviation is known to 1 / sqrt(4 NETS) = 7 %."""
SPOT_NETS = 4
"""The same for the spots of the sun sensor, which has many in each net."""
ACROSS, ALONG = 2.0 / 3.0, 3.0 / 5.0
"""Of white pixel noise: what bilinear interpolation leaves across a ray, and the integral of h W^2 along it."""
NOMINAL = np.diag([-1.0, 1.0, -1.0])
"""Table from cube as designed."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PictureNoise:
    """Standard deviation per axis of a measured offset [px of the screen]."""

    two_px: float  # Aperture and spot from two pictures
    own_px: float  # Both from the picture of the spot
    two_detector_px: float  # Part of detector and shot noise in the first: all that a laboratory has
    own_detector_px: float  # The same in the second


@dataclass(frozen=True, slots=True, kw_only=True)
class SensorNoise:
    """Scatter of the calibration of the sun sensor."""

    spot_px: float  # Standard deviation of a spot per axis, RMS over the positions
    # (3, 3) Of what R_sr, and the fitted squareness, do to R_sp: rotation vector in the cube frame
    covariance_rad2: FloatArray


def _pixel_noise(detector: Detector, exposure_s: float) -> PixelNoise:
    return PixelNoise.of(detector, temperature_c=detector.dark_reference_c, exposure_s=exposure_s)


def _window(offset: FloatArray, half_px: float) -> FloatArray:
    """Weights of the line fits, integral 1."""
    return np.asarray(np.where(np.abs(offset) < half_px, 0.75 / half_px * (1.0 - (offset / half_px) ** 2), 0.0))


def _slope(value: FloatArray, offset: FloatArray, half_px: float) -> float:
    """Slope of the weighted line through a profile about offset 0."""
    weight = _window(offset, half_px)
    return float((weight * offset * value).sum() / (weight * offset**2).sum())


@dataclass(frozen=True, slots=True, kw_only=True)
class _Edge:
    """A contour."""

    radius: float  # [px]
    slope: float  # Parts of full brightness per px
    brightness: float  # At the contour
    half: float  # Half width of the window [px]
    beside: float = 0.0  # Rim whose half, carried to the edge by a line, is the level; 0 for one level of all


def _spot_edge(laboratory: Laboratory) -> _Edge:
    """The contour low on the rim of the spot, on the closed form of its brightness."""
    geometry, pitch = laboratory.geometry, laboratory.pitch_mm
    hole, half = geometry.aperture_mm / 2 / pitch, EDGE_HALF_WIDTH_PX["spot"]
    radius = np.arange(0.5 * hole, hole + geometry.blur_mm(geometry.path_mm) / pitch + 25.0, 0.25)
    bright = np.where(radius > hole, spot_profile(geometry, radius * pitch), 0.0)
    size = round(half / 0.25)
    rim = np.convolve(bright, np.ones(size) / size, mode="same").max()
    outside = radius > hole + half
    at = float(np.interp(-RIM_LEVEL * rim, -bright[outside], radius[outside]))
    slope = _slope(np.asarray(spot_profile(geometry, radius * pitch)), radius - at, half)
    return _Edge(radius=at, slope=slope, brightness=RIM_LEVEL * rim, half=half)


def _blurred_step(laboratory: Laboratory, half_px: float) -> float:
    """Slope of the line through a step of height 1, blurred by diffusion, pixel and interpolation [1/px]."""
    sigma = _blur_px(laboratory)
    offset = np.linspace(-half_px, half_px, 401)
    fine = np.linspace(-6.0, 6.0, 4801)
    profile = np.array([np.exp(-0.5 * ((x - fine[fine > 0]) / sigma) ** 2).sum() for x in offset])
    return _slope(profile * (fine[1] - fine[0]) / (np.sqrt(2 * np.pi) * sigma), offset, half_px)


def _of_detector_px2(laboratory: Laboratory, edge: _Edge, full_e: float) -> float:
    """Variance of a centre by the detector."""
    noise = _pixel_noise(laboratory.detector, laboratory.config.camera.exposure_s)

    def pixel_e2(light_e: float) -> float:
        return float(noise.temporal_e2(light_e) + noise.response_e2(light_e)) + noise.offset_e**2

    along = ALONG / edge.half * pixel_e2(edge.brightness * full_e)
    if edge.beside:
        near, far = BESIDE_PX
        middle, length = (near + far) / 2, far - near
        along += 0.25 * (1.0 / length + 12.0 * middle**2 / length**3) * pixel_e2(edge.beside * full_e)
    return 2.0 / (SPOKES * RAYS) * ACROSS * along / (edge.slope * full_e) ** 2


def picture_noise(laboratory: Laboratory) -> PictureNoise:
    """Noise of spot minus aperture for a concentric, trimmed face."""
    config, pitch = laboratory.config, laboratory.pitch_mm
    hole = laboratory.geometry.aperture_mm / 2 / pitch
    spot = _spot_edge(laboratory)
    step = _blurred_step(laboratory, EDGE_HALF_WIDTH_PX["hole"])
    beside = float(spot_profile(laboratory.geometry, [(hole + 1.0) * pitch])[0])
    own = _Edge(radius=hole, slope=step * beside, brightness=beside / 2, half=EDGE_HALF_WIDTH_PX["hole"], beside=beside)
    glow = float(np.percentile(laboratory.aperture_e, 99.0))
    aperture = _Edge(radius=hole, slope=step, brightness=0.5, half=EDGE_HALF_WIDTH_PX["aperture"])
    full = config.camera.plateau_e
    of_spot, of_hole = (_of_detector_px2(laboratory, edge, full) for edge in (spot, own))
    two2, own2 = of_spot + _of_detector_px2(laboratory, aperture, glow), of_spot + of_hole
    sums = np.array([_of_particles_px(laboratory, spot, own, seed) for seed in range(NETS)])
    spots2, owns2 = np.mean(sums**2, axis=(0, 2))
    return PictureNoise(
        two_px=float(np.sqrt(two2 + spots2)),
        own_px=float(np.sqrt(own2 + owns2)),
        two_detector_px=float(np.sqrt(two2)),
        own_detector_px=float(np.sqrt(own2)),
    )


def _of_particles_px(laboratory: Laboratory, spot: _Edge, own: _Edge, seed: int) -> FloatArray:
    """Centres of spot, and of spot less hole, (2, 2) that the particles of one net make of a concentric spot."""
    geometry, pitch = laboratory.geometry, laboratory.pitch_mm
    hole = geometry.aperture_mm / 2 / pitch
    u = _shifted(_net(laboratory.config.benches.log2_particles), seed)
    place = OVERSCAN * hole * np.sqrt(u[:, 0]), 2 * np.pi * u[:, 1]
    lean = geometry.blur_mm(geometry.path_mm) / pitch * np.sqrt(u[:, 2]), 2 * np.pi * u[:, 3]
    passed = place[0] < hole
    x, y = (f(place[1]) * place[0] + f(lean[1]) * lean[0] for f in (np.cos, np.sin))
    r = np.hypot(x, y)
    seen = passed & (r > hole)
    angle, r = np.arctan2(y[seen], x[seen]), r[seen]
    per_px = len(u) / (np.pi * (OVERSCAN * hole) ** 2)
    rays = _rays(angle, r, _blur_px(laboratory))
    outward = _window(r - spot.radius, spot.half) / abs(spot.slope)
    inward = -_hole_response(laboratory, r - hole, own.half) / own.slope
    return np.array([2.0 * (weight * rays).sum(1) / per_px for weight in (outward, outward - inward)])


@lru_cache(maxsize=2)
def _net(log2_points: int) -> NDArray[np.uint32]:
    """The net that the particles of a rendering start from, (n, 4) as 32-bit fractions."""
    points = qmc.Sobol(4, scramble=True, rng=np.random.default_rng(log2_points)).random_base2(log2_points)
    return np.asarray((points * 2.0**32).astype(np.uint32))


def _shifted(net: NDArray[np.uint32], seed: int) -> FloatArray:
    """The net under another random digital shift, (n, 4) in 0 to 1."""
    shift = np.random.default_rng(seed).integers(0, 2**32, 4, dtype=np.uint32)
    return np.asarray(((net ^ shift) + 0.5) / 2.0**32)


def _rays(angle_rad: FloatArray, radius_px: FloatArray, blur_px: float) -> FloatArray:
    """How much light at an angle counts in the mean over all rays of cos and sin (2, n), per px of arc: rays stand
    farther apart than the light of a particle is wide."""
    apart = 2 * np.pi / (SPOKES * RAYS)
    nearest = np.floor(angle_rad / apart)
    total = np.zeros((2, len(angle_rad)))
    for step in (-1.0, 0.0, 1.0):
        at = (nearest + step + 0.5) * apart
        weight = np.exp(-0.5 * (radius_px * (angle_rad - at) / blur_px) ** 2) / (np.sqrt(2 * np.pi) * blur_px)
        total += weight * np.stack([np.cos(at), np.sin(at)])
    return np.asarray(total / (SPOKES * RAYS))


def _blur_px(laboratory: Laboratory) -> float:
    """Width of a point's light in the interpolated picture: diffusion, pixel and interpolation."""
    return float(np.sqrt(laboratory.detector.diffusion_sigma_px**2 + 1.0 / 12.0 + 1.0 / 6.0))


def _hole_response(laboratory: Laboratory, offset: FloatArray, half_px: float) -> FloatArray:
    """Change of brightness at the hole's edge per px of radius, less half of the same of the line fitted to the rim
    (2.5 to 7 px); the light of a particle is as wide as diffusion, pixel and interpolation."""
    sigma = _blur_px(laboratory)
    near, far = BESIDE_PX
    middle, length = (near + far) / 2, far - near
    fine = np.linspace(-12.0, 16.0, 2801)
    line = np.where((fine > near) & (fine < far), 1 / length - middle * (fine - middle) / (length**3 / 12), 0.0)
    kernel = np.exp(-0.5 * (np.linspace(-4.0, 4.0, 801) / sigma) ** 2)
    table = np.convolve(_window(fine, half_px) - 0.5 * line, kernel / kernel.sum(), mode="same")
    return np.asarray(np.interp(offset, fine, table, left=0.0, right=0.0))


def _beam(angle_rad: FloatArray, lean_arcsec: float = 0.0) -> FloatArray:
    """Direction (n, 3) of the light in the frame of a table at angles (n, 2)."""
    table = build_turntable("xy", non_orthogonality_arcsec=lean_arcsec)
    return np.asarray(table.rotation(angle_rad).inv().apply([0.0, 0.0, 1.0]))


def _sun_spots_px(values: FloatArray, angle_rad: FloatArray, per_rad_px: float) -> FloatArray:
    """Spots (n, 2) of a sun sensor on a table, from the middle of the detector [px]."""
    x0, y0, scale, *turn, lean = values
    v = Rotation.from_rotvec(turn).apply(_beam(angle_rad, lean * RAD_ARCSEC))
    return np.asarray([x0, y0] + per_rad_px * (1.0 + scale) * v[:, :2] / v[:, 2:])


def sensor_noise(laboratory: Laboratory, *, reading: bool, lean: bool) -> SensorNoise:
    """Noise of the calibration of the sun sensor at all positions of the field."""
    config, angle = laboratory.config, field_angles(laboratory.config)
    per_rad = config.sensor.gap_mm / laboratory.sensor_detector.pixel_pitch_mm
    start, step = np.zeros(7), 1e-5
    by_value = [
        (_sun_spots_px(start + step * one, angle, per_rad) - _sun_spots_px(start - step * one, angle, per_rad))
        / (2 * step)
        for one in np.eye(7)[: 7 if lean else 6]
    ]
    jacobian = np.stack(by_value, axis=-1).reshape(2 * len(angle), -1)
    to_value = np.linalg.pinv(jacobian)
    spot2 = _spot_variance_px2(laboratory, _beam(angle)[:, 2])
    noise = np.diag(np.repeat(spot2, 2))
    if reading:
        sigma = np.array([config.table.outer_reading_arcsec, config.table.inner_reading_arcsec]) * ARCSEC_RAD
        for axis in np.eye(2):
            moved = (_sun_spots_px(start, angle + step * axis, per_rad) - _sun_spots_px(start, angle, per_rad)) / step
            block = moved * (sigma @ axis)
            for k, pair in enumerate(block):
                noise[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] += np.outer(pair, pair)
    found = to_value @ noise @ to_value.T
    # a squareness that is assumed too large turns R_pr about z: the second face takes all of it
    effect = np.column_stack([-NOMINAL, [0.0, 0.0, -1.0]]) if lean else -NOMINAL
    part = found[3:, 3:]
    return SensorNoise(spot_px=float(np.sqrt(spot2.mean())), covariance_rad2=effect @ part @ effect.T)


def _spot_variance_px2(laboratory: Laboratory, cosine: FloatArray) -> FloatArray:
    """Variance (n,) of a spot's centre of light per axis, at cosines of the angle from the sensor's axis."""
    config, detector = laboratory.config.sensor, laboratory.sensor_detector
    noise = _pixel_noise(detector, EXPOSURE_S)
    radius, side = config.hole_um * 1e-3 / 2 / detector.pixel_pitch_mm, config.window_px
    level = config.plateau_e * cosine
    light = level * np.pi * radius**2
    place = np.arange(side) - (side - 1) / 2
    of_disk, of_window = np.pi * radius**4 / 4, side * (place**2).sum()  # integrals of x^2
    border = side**2 * np.sqrt(1.0 / 12.0)  # a wrong border pulls towards the window's middle, some 0.3 px off
    fixed2 = noise.offset_e**2 + noise.floor_e2 / config.frames
    variance = (
        (level / config.frames + (noise.prnu * level) ** 2) * of_disk
        + fixed2 * of_window
        + noise.column_e**2 * side**2 * (place**2).sum() / 2  # columns move x alone, half of it per axis
        + (border**2) * fixed2 / (4 * side - 4)
    ) / light**2
    return np.asarray(variance + _spot_particles_px2(laboratory, radius, cosine))


def _spot_particles_px2(laboratory: Laboratory, radius_px: float, cosine: FloatArray) -> float:
    """Variance by the number of particles of a spot, each in the pixel that it falls into; the Sun's width, wider by 1
    / cos^2 along the slant and 1 / cos across, halves what the net's evenness saves."""
    config = laboratory.config
    suns, log2 = len(cosine), config.sensor.log2_particles
    net = _net(log2 + int(np.ceil(np.log2(suns))))[: suns << log2]
    half_px = np.tan(laboratory.geometry.half_angle_rad) * config.sensor.gap_mm
    half_px /= laboratory.sensor_detector.pixel_pitch_mm
    rng, means = np.random.default_rng(1), []
    for seed in range(SPOT_NETS):
        u = _shifted(net, seed).reshape(suns, -1, 4)
        place, lean = OVERSCAN * radius_px * np.sqrt(u[..., 0]), half_px * np.sqrt(u[..., 2])
        passed = place < radius_px
        for turn, wide in ((np.cos, 1.0 / cosine**2), (np.sin, 1.0 / cosine)):
            at = rng.uniform(-0.5, 0.5, (suns, 1))  # true centre in its pixel
            landed = place * turn(2 * np.pi * u[..., 1]) + lean * wide[:, None] * turn(2 * np.pi * u[..., 3])
            means.append((np.rint(landed + at) * passed).sum(1) / passed.sum(1) - at[:, 0])
    return float(np.mean(np.square(means)))
