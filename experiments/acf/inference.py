"""What the document's own numbers say about what it leaves out: the pixel, and the stars in a frame.

Table 2 prints a calibrated camera and attitude beside the true ones. Principal point and attitude are nearly
degenerate: their errors must cancel in the image, x0 in pixels against phi in arcseconds, and they do so for one size
of the pixel only. So the printed values, reprojected on the first frame, tell the pixel by where their RMS is least;
and their likelihood under the covariance of eq. 11 tells the size of the errors, hence the number of stars. The angles
theta are left out, because what they do depends on a motion that is not given.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib.attitude.link import increment_per_angle, rotation_of_angles
from experiments.acf.linear_model import Design, correlated
from experiments.acf.published import TABLE2_CALIBRATED, TABLE2_ROUNDING, TABLE2_TRUE
from experiments.acf.settings import CameraConfig, Config
from experiments.acf.simulate import build_scene
from experiments.acf.trials import gyro_error
from optics.arrays import FloatArray
from optics.records import freeze
from optics.units import DEG_RAD

__all__ = ["Inference", "infer"]


CAMERA, FIRST = 8, 11
"""Unknowns of the camera; those and the angles of the first frame."""
PLACES = 11
"""Stars along each side of the detector, a regular grid, in the design that is scaled to other numbers."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Inference:
    """Pixel and stars from Table 2, read as one calibration at 0.1 px."""

    pixel_um: FloatArray  # (m,) Pixels tried, for the reprojection
    # (m, 2) RMS difference, x and y, between the printed and the true camera and attitude over the detector
    reprojected_px: FloatArray
    tried_um: FloatArray  # (k,) Pixels tried, for the likelihood
    tried_stars: FloatArray  # (s,) Stars per frame tried
    likelihood: FloatArray  # (k, s) Logarithm, 0 at its greatest
    best_um: float  # Most likely pixel, and its standard deviation
    sigma_um: float  # Most likely pixel, and its standard deviation
    # Most likely number of stars per frame, and where the likelihood (the pixel at its best) has fallen by 1/2
    best_stars: float
    # Most likely number of stars per frame, and where the likelihood (the pixel at its best) has fallen by 1/2
    low_stars: float
    # Most likely number of stars per frame, and where the likelihood (the pixel at its best) has fallen by 1/2
    high_stars: float
    chi2: float  # Of the 11 printed errors at the best place
    chi2_assumed: float  # The same at the pixel that the experiment assumes, with the most likely number of stars there

    def __post_init__(self) -> None:
        sizes: dict[str, int] = {}
        freeze(self, "pixel_um", shape=("m",), sizes=sizes)
        freeze(self, "reprojected_px", shape=("m", 2), sizes=sizes)
        freeze(self, "tried_um", shape=("k",), sizes=sizes)
        freeze(self, "tried_stars", shape=("s",), sizes=sizes)
        freeze(self, "likelihood", shape=("k", "s"), sizes=sizes)

    @property
    def least_um(self) -> float:
        """Pixel of the least reprojection error of the printed values."""
        return float(self.pixel_um[np.argmin((self.reprojected_px**2).sum(1))])

    @property
    def field_deg(self) -> float:
        """Width of the document's field with the most likely pixel."""
        return CameraConfig(pixel_um=self.best_um).width_deg

    def reprojected_at(self, pixel_um: float) -> FloatArray:
        """Reprojection (2,) [px] at the tried pixel that is nearest."""
        return np.asarray(self.reprojected_px[np.argmin(np.abs(self.pixel_um - pixel_um))])


def printed_reprojection(config: Config, pixel_um: float, printed: FloatArray = TABLE2_CALIBRATED) -> FloatArray:
    """RMS difference (2,) [px] between printed and true camera and attitude, on the first frame."""
    true = build_scene(config, pixel_um).camera
    direction = true.unproject(true.geometry.grid_px(25))
    turn = rotation_of_angles(DEG_RAD * printed[8:11]) * rotation_of_angles(DEG_RAD * TABLE2_TRUE[8:11]).inv()
    moved = true.with_parameters(printed[:CAMERA]).project(turn.apply(direction))
    return np.asarray(np.sqrt(((moved - true.project(direction)) ** 2).mean(0)))


def infer(points: int = 29, printed: FloatArray = TABLE2_CALIBRATED) -> Inference:
    """Pixel and stars per frame from Table 2; a function of the document alone, not of the configuration."""
    config = Config()
    pixel = np.linspace(4.0, 12.0, 161)
    reprojected = np.stack([printed_reprojection(config, um, printed) for um in pixel])
    least = float(pixel[np.argmin((reprojected**2).sum(1))])
    tried, stars = np.linspace(0.86, 1.14, points) * least, np.geomspace(2.0, 200.0, 93)
    chi2, log_likelihood = np.moveaxis(np.stack([_fit(config, um, stars, printed) for um in tried]), 1, 0)
    place = np.unravel_index(np.argmax(log_likelihood), log_likelihood.shape)
    over_pixel, over_stars = log_likelihood.max(1), log_likelihood.max(0)
    weight = np.exp(over_pixel - over_pixel.max())
    mean = float(weight @ tried / weight.sum())
    near = stars[over_stars > over_stars.max() - 0.5]
    assumed_chi2, assumed = _fit(config, config.camera.pixel_um, stars, printed)
    return Inference(
        pixel_um=pixel,
        reprojected_px=reprojected,
        tried_um=tried,
        tried_stars=stars,
        likelihood=log_likelihood - log_likelihood.max(),
        best_um=mean,
        sigma_um=float(np.sqrt(weight @ (tried - mean) ** 2 / weight.sum())),
        best_stars=float(stars[place[1]]),
        low_stars=float(near[0]),
        high_stars=float(near[-1]),
        chi2=float(chi2[place]),
        chi2_assumed=float(assumed_chi2[np.argmax(assumed)]),
    )


def _fit(config: Config, pixel_um: float, stars: FloatArray, printed: FloatArray) -> FloatArray:
    """chi^2 of the printed errors and logarithm of their likelihood (2, s), for numbers of stars per frame (s,)."""
    scene, design = build_scene(config, pixel_um), _even_design(config, pixel_um)
    noise = (config.gyro.bias_deg_per_h, config.gyro.angle_random_walk_deg_per_sqrt_h)
    perfect, drift = correlated(design, 0.1), gyro_error(scene, noise)
    gyro = correlated(design, 0.1, drift) - perfect
    unit = np.eye(FIRST)
    unit[CAMERA:, CAMERA:] = np.linalg.inv(increment_per_angle(DEG_RAD * TABLE2_TRUE[8:11])) / DEG_RAD
    perfect, gyro = (unit @ part[:FIRST, :FIRST] @ unit.T for part in (perfect, gyro))
    error = (printed - TABLE2_TRUE)[:FIRST]
    rounding = np.diag(TABLE2_ROUNDING[:FIRST] ** 2 / 12.0)
    found = np.empty((2, len(stars)))
    for k, count in enumerate(stars):
        covariance = perfect * (PLACES**2 / count) + gyro + rounding
        scale = np.sqrt(np.diag(covariance))
        correlation, pull = covariance / np.outer(scale, scale), error / scale
        chi2 = float(pull @ np.linalg.solve(correlation, pull))
        determinant = float(np.linalg.slogdet(correlation)[1] + 2.0 * np.log(scale).sum())
        found[:, k] = chi2, -0.5 * (chi2 + determinant)
    return found


def _even_design(config: Config, pixel_um: float) -> Design:
    """Stars spread evenly over the detector, in the frames that calibrate."""
    scene = build_scene(config, pixel_um)
    camera, geometry = scene.camera, scene.camera.geometry
    step = (np.arange(PLACES) + 0.5) / PLACES - 0.5
    place = np.stack(np.meshgrid(step * geometry.width_px, step * geometry.height_px), axis=-1).reshape(-1, 2)
    seen = camera.unproject(geometry.centre_px + place)
    frames = np.arange(0, config.frames, 2)
    direction = np.concatenate([rotation.inv().apply(seen) for rotation in scene.attitude[frames]])
    return Design.at(camera, scene.attitude, scene.installation, direction, np.repeat(frames, len(seen)))
