"""Table 2 of ACF17: errors of the 14 unknowns, and the pixel size implied by the printed numbers.

Principal point and attitude are nearly degenerate: the printed errors of both must cancel in the image, x0 in pixels
against phi in arcseconds, which they do for one pixel size only. Their likelihood under the covariance of eq. 11
therefore determines the pixel size, which ACF17 does not state, and their magnitude the number of stars per
frame. The angles theta are left out, because their effect depends on the unpublished motion.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from calib.attitude.euler_angles import angle_per_increment, angles_of_rotation, rotation_of_angles
from calib.calibration.linked_design import LinkedDesign, correlated_covariance, free_bound, linked_bound
from calib.fitting.normal_errors import log_likelihood
from experiments.acf.reprojection import root_mean_square, table2_point
from experiments.acf.settings import AcfConfig
from experiments.acf.simulate import build_scene
from experiments.acf.trials import TrialPoint, Trials, gyro_drift, sky_of, table1_gyro
from experiments.harness.sections import Section, col
from experiments.harness.summary import Measured
from optics.arrays import FloatArray
from optics.units import DEG_RAD

UNKNOWNS = ("x0", "y0", "f", "q1", "q2", "q3", "p1", "p2", "phi1", "phi2", "phi3", "theta1", "theta2", "theta3")
UNITS = ("px", "px", "mm", "mm⁻²", "mm⁻⁴", "mm⁻⁶", "mm⁻¹", "mm⁻¹", *("deg",) * 6)
# fmt: off
TRUE = np.array([10, -10, 25.6, 2e-4, -4e-7, 1e-8, 2e-4, 2e-4, 56.9476, -1.0046, -25.3335, 2, 2, 2])
"""ACF17 Table 2, true values."""
PRINTED = np.array([
    9.81, -10.51, 25.6002, 1.96e-4, -1.84e-9, -1.72e-8, 1.99e-4, 1.98e-4,
    56.9550, -1.0084, -25.3325, 2.0019, 1.9950, 2.0001,
])
# fmt: on
"""ACF17 Table 2, calibrated values; the text calls them the mean of 100 runs."""
ROUNDING = np.array([0.01, 0.01, 1e-4, 1e-6, 1e-11, 1e-10, 1e-6, 1e-6, *(1e-4,) * 6])
"""Unit of the last printed digit. The errors of phi and theta are printed too, consistently, in arcsec."""
PINHOLE, DISTORTION, CAMERA = slice(0, 3), slice(3, 8), slice(0, 8)
PHI, THETA = slice(8, 11), slice(11, 14)
"""Parts of the vector of unknowns: x0, y0, f; q1 to p2; both; angles of the first attitude; of the installation."""
NOISE_PX = 0.1
"""Star noise of ACF17 Table 2."""
N_IMPLIED = 11
"""Leading unknowns that the implied pixel is fitted to: camera and first attitude."""
GRID_STARS = 11
"""Stars along each side of the detector, a regular grid, in the design that is scaled to other numbers."""
NAMES = [name.replace("phi", "φ").replace("theta", "θ") for name in UNKNOWNS]
"""Symbols of the unknowns in tables."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Covariances:
    """Predicted covariances at one star noise; angles phi and theta in rad."""

    perfect: FloatArray  # (14, 14) As ACC states it, eq. 11 with an error-free gyro
    acc: FloatArray  # (14, 14) ACC with the gyro's error propagated
    linked: FloatArray  # (14, 14) Cramer-Rao bound with the noise of the gyro
    free: FloatArray  # (8, 8) Cramer-Rao bound with a free attitude in every frame


def covariances(config: AcfConfig, point: TrialPoint) -> Covariances:
    """Covariances of the estimates of a point, with its first gyro."""
    sky = sky_of(config, point, 0)
    design = sky.calibrating
    drift = gyro_drift(sky.scene, point.gyro[0])
    to_angles = np.eye(14)  # From rotation vectors to angles
    for rows, rotation in ((PHI, sky.scene.attitude[0]), (THETA, sky.scene.installation)):
        to_angles[rows, rows] = angle_per_increment(angles_of_rotation(rotation))

    def angles(covariance: FloatArray) -> FloatArray:
        return np.asarray(to_angles @ covariance @ to_angles.T)

    return Covariances(
        perfect=angles(correlated_covariance(design, point.noise_px)),
        acc=angles(correlated_covariance(design, point.noise_px, drift)),
        linked=angles(linked_bound(design, point.noise_px, drift)),
        free=free_bound(design, point.noise_px),
    )


def in_degrees(values: FloatArray) -> FloatArray:
    """Numbers of the 14 unknowns (..., 14) with the angles in deg."""
    out = np.array(values)
    out[..., CAMERA.stop :] = np.degrees(out[..., CAMERA.stop :])
    return out


@dataclass(frozen=True, slots=True, kw_only=True)
class Table2Row:
    """Errors of an unknown: published, measured, bound."""

    unit: str = col("Unit")
    true: float = col("True", "", ".6g")
    published: float = col("Published value", shown=False)
    published_error: float = col("Published error", "", ".3g")
    mean: float = col("Mean", shown=False)
    mean_error: float = col("Mean error", "", ".3g")
    std: float = col("Scatter of a run", "", ".3g")
    bound: float = col("Cramér-Rao bound", "", ".3g")
    bound_with_gyro_error: float = col("Bound with gyro error", "", ".3g")
    n: int = col("Runs", shown=False)


def table2(config: AcfConfig, trials: Mapping[str, Trials], expected: Covariances) -> list[Table2Row]:
    """Table 2: published errors next to the runs' mean error, their scatter, and the bound of one run."""
    all_errors = in_degrees(trials[table2_point(config).name].of("acc", "error"))
    true = np.concatenate([build_scene(config).camera.parameters, config.sky.phi_deg, config.gyro.installation_deg])
    bound, bound_with_gyro_error = (
        in_degrees(np.sqrt(np.diag(covariance))) for covariance in (expected.perfect, expected.acc)
    )
    return [
        Table2Row(
            unit=UNITS[k],
            true=float(true[k]),
            published=float(PRINTED[k]),
            published_error=float((PRINTED - TRUE)[k]),
            mean=float(true[k] + errors.mean()),
            mean_error=float(errors.mean()),
            std=float(errors.std(ddof=1)),
            bound=float(bound[k]),
            bound_with_gyro_error=float(bound_with_gyro_error[k]),
            n=len(errors),
        )
        for k, errors in enumerate(all_errors.T)
    ]


@dataclass(frozen=True, slots=True, kw_only=True)
class Degeneracy:
    """Joint effect of the inseparable coefficients."""

    radial_correlation: Sequence[float] = col("Correlation", "", "+.3f", "coefficients")
    line_of_sight_arcsec: float = col("Line of sight, RMS over the detector", "arcsec", ".1f")


def degeneracy(config: AcfConfig, trials: Mapping[str, Trials], expected: Covariances) -> Degeneracy:
    """Correlations of the radial coefficients, and the error of the line of sight."""
    sigma = np.sqrt(np.diag(expected.perfect))
    correlation = expected.perfect / np.outer(sigma, sigma)
    rms_arcsec, _ = root_mean_square(trials[table2_point(config).name].of("acc", "line_of_sight_arcsec") ** 2, 0)
    return Degeneracy(
        radial_correlation=[correlation[3, 4], correlation[3, 5], correlation[4, 5]],
        line_of_sight_arcsec=float(rms_arcsec),
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class Implied:
    """Pixel and stars from Table 2, taken as a single calibration at 0.1 px."""

    pixel_um: Measured = col("Pixel", "um")
    stars_per_frame: float = col("Stars", "per frame", ".0f")
    # Where the profile log-likelihood is 1/2 below its maximum
    stars_per_frame_range: FloatArray = col("Stars", "per frame", ".0f", "end")
    chi2: float = col("χ² of 11", "", ".1f")
    chi2_at_assumed_pixel: float = col("χ² of 11 at 10 µm", "", ".0f")


def implied(points: int = 29, printed: FloatArray = PRINTED) -> Implied:
    """Pixel and stars per frame from Table 2: mean and sigma of the pixel's profile likelihood, best star count.

    A function of ACF17 alone, not of the configuration.
    """
    config = AcfConfig()
    coarse_um = np.linspace(4.0, 12.0, 161)
    start_um = float(coarse_um[np.argmin([printed_reprojection_px2(config, um, printed) for um in coarse_um])])
    pixel_um = np.linspace(0.86, 1.14, points) * start_um
    stars = np.geomspace(2.0, 200.0, 93)
    chi2, log_likelihood = np.moveaxis(np.stack([_fit(config, um, stars, printed) for um in pixel_um]), 1, 0)
    best = np.unravel_index(np.argmax(log_likelihood), log_likelihood.shape)
    pixel_profile = log_likelihood.max(1)
    stars_profile = log_likelihood.max(0)
    weight = np.exp(pixel_profile - pixel_profile.max())
    mean = float(weight @ pixel_um / weight.sum())
    sigma = float(np.sqrt(weight @ (pixel_um - mean) ** 2 / weight.sum()))
    assumed_chi2, assumed_likelihood = _fit(config, config.camera.pixel_pitch_um, stars, printed)
    return Implied(
        pixel_um=Measured(value=mean, unit="um", uncertainty=sigma, n=N_IMPLIED),
        stars_per_frame=float(stars[best[1]]),
        stars_per_frame_range=stars[stars_profile > stars_profile.max() - 0.5][[0, -1]],
        chi2=float(chi2[best]),
        chi2_at_assumed_pixel=float(assumed_chi2[np.argmax(assumed_likelihood)]),
    )


def printed_reprojection_px2(config: AcfConfig, pixel_um: float, printed: FloatArray) -> float:
    """Mean square distance between printed and true camera and attitude, on the first frame."""
    true = build_scene(config, pixel_um).camera
    direction = true.unproject(true.geometry.grid_px(25))
    attitude, printed_attitude = (rotation_of_angles(DEG_RAD * angles[PHI]) for angles in (TRUE, printed))
    printed_px = true.with_parameters(printed[CAMERA]).project((printed_attitude * attitude.inv()).apply(direction))
    return float(((printed_px - true.project(direction)) ** 2).sum(1).mean())


def _fit(config: AcfConfig, pixel_um: float, stars: FloatArray, printed: FloatArray) -> FloatArray:
    """chi^2 of the printed errors and logarithm of their likelihood (2, s), for numbers of stars per frame (s,)."""
    scene = build_scene(config, pixel_um)
    design = _even_design(config, pixel_um)
    perfect = correlated_covariance(design, NOISE_PX)
    gyro = correlated_covariance(design, NOISE_PX, gyro_drift(scene, table1_gyro(config))) - perfect
    to_degrees = np.eye(N_IMPLIED)  # From rotation vectors to angles
    to_degrees[PHI, PHI] = angle_per_increment(DEG_RAD * TRUE[PHI]) / DEG_RAD
    perfect, gyro = (to_degrees @ part[:N_IMPLIED, :N_IMPLIED] @ to_degrees.T for part in (perfect, gyro))
    error = (printed - TRUE)[:N_IMPLIED]
    rounding = np.diag(ROUNDING[:N_IMPLIED] ** 2 / 12.0)
    return np.transpose([log_likelihood(error, perfect * (GRID_STARS**2 / n) + gyro + rounding) for n in stars])


def _even_design(config: AcfConfig, pixel_um: float) -> LinkedDesign:
    """Stars spread evenly over the detector, in the frames that calibrate."""
    scene = build_scene(config, pixel_um)
    camera, geometry = scene.camera, scene.camera.geometry
    step = (np.arange(GRID_STARS) + 0.5) / GRID_STARS - 0.5
    offset_px = np.stack(np.meshgrid(step * geometry.width_px, step * geometry.height_px), axis=-1).reshape(-1, 2)
    in_cam = camera.unproject(geometry.centre_px + offset_px)
    frames = np.arange(0, config.frames, 2)
    direction = np.concatenate([attitude.inv().apply(in_cam) for attitude in scene.attitude[frames]])
    return LinkedDesign.at(camera, scene.attitude, scene.installation, direction, np.repeat(frames, len(in_cam)))


TABLE2 = {
    "table2": Section(
        record=Table2Row,
        dim="unknown",
        caption="ACF17 Table 2: errors after calibration, published, measured, and the Cramér–Rao bound of one run.",
        note="Odd frames calibrate. Standard error of the mean: standard deviation of a run / √runs. "
        "The bound assumes a perfect gyro, as eq. 11 does; the last column includes the gyro's error.",
    ),
    "degeneracy": Section(record=Degeneracy),
    "implied": Section(record=Implied),
}
