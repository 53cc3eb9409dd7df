"""What calib refuses: kind of error, and the name, value or range that its message of one line holds."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from calibration_scene import CAMERA, DISTORTION, GEOMETRY, START, Scene, make_scene
from scipy.spatial.transform import Rotation
from star_images import NOISE, frame_of, gaussian_epsf, gaussian_stars, image_of, stamps_of

from calib import Calibration, Observations, Polynomial, SensorGeometry, StarFlag, bound, calibrate, detect, solve_wahba
from calib.accuracy import distortion, ecss_metrics
from calib.accuracy.high_frequency import step_residual_px
from calib.attitude import association, attitude_solution, euler_angles, gyro_attitude, triad
from calib.attitude.identify import build_database, identify, load_database
from calib.attitude.star_vectors import initial_frame_vectors
from calib.attitude.tracker import StarTracker, guide_catalogue
from calib.calibration import camera_order, interstar_angles, table_bound
from calib.calibration.attitude_correlated import AttitudeCorrelated
from calib.calibration.cube_mirror import cube_from_table
from calib.calibration.frame_attitudes import frame_attitude
from calib.calibration.free_attitudes import FreeAttitudes
from calib.calibration.gyro_linked import GyroLinked, GyroNoise
from calib.calibration.star_bench import StarBench, aiming_angles
from calib.calibration.table_axes import TableAxes
from calib.calibration.table_reduction import PoseData, calibrate_on_table, check_count, check_fit, check_parity
from calib.calibration.turntable import TableErrors, TurntableAttitudes, star_direction
from calib.cameras.brown_conrady import BrownConrady
from calib.cameras.fit import fit_to_map
from calib.cameras.line_of_sight import line_of_sight_map
from calib.cameras.per_band import PerBand
from calib.detector.fixed_pattern import fixed_pattern
from calib.detector.hot_pixels import find_hot_pixels, without_pixels
from calib.detector.mean_frame import mean_frame
from calib.detector.photon_transfer import PhotonTransfer, flat_photon_transfer
from calib.detector.sky_photon_transfer import sky_blocks, sky_photon_transfer
from calib.detector.window_photon_transfer import window_photon_transfer
from calib.directional.fisher import concentration_from_deficit, fit_fisher, sample_fisher
from calib.directional.fisher_checks import exponential_check, fisher_outliers, isotropy_check
from calib.fitting.least_squares import DenseProblem, solve
from calib.fitting.robust_loss import get_loss
from calib.fitting.solution import Solution
from calib.measure.background import estimate_background
from calib.measure.centroid_error.cramer_rao_bound import cramer_rao, flux_for_snr
from calib.measure.centroid_error.prediction import predict_centroids
from calib.measure.centroiders.epsf import EpsfCentroider
from calib.measure.centroiding.registry import get_centroider, register_centroider
from calib.measure.detection.false_alarms import threshold_for_false_alarms
from calib.measure.epsf.build import build_epsf
from calib.measure.find import find_stars
from calib.measure.images.sensor_image import sensor_image, subtract_dark
from calib.measure.reduced_windows import refuse_saturated
from calib.measure.stamps import extract_stamps
from calib.measure.statistics.separability import separability
from calib.measure.targets.circle_edge import sample_spokes
from calib.measure.targets.circle_fit import fit_circle
from calib.measure.targets.screen_circles import ScreenPicture, fit_spot
from calib.measure.targets.target_points import match_points
from calib.photometry.zero_point import fit_photometry
from calib.psf.focus_tilt import fit_detector_pose
from calib.psf.gaussian_mixture import StarWindows, fit_psf
from calib.records import NoiseModel
from optics.errors import ConfigError, ConvergenceError, DomainError

Row = tuple[str, Callable[[], Any], type[Exception], list[str]]
NAN, ONE = np.nan, Rotation.identity()
AHEAD = np.array([0.0, 0.0, 1.0])
STARS = np.array([[0.1, 0.0, 1.0], [0.0, 0.1, 1.0], [-0.1, 0.0, 1.0], [0.0, -0.1, 1.0]]) / np.sqrt(1.01)
TURNS = Rotation.from_rotvec(np.linspace([0.0, 0.0, 0.0], [0.1, 0.2, 0.0], 3))
PIXELS = GEOMETRY.grid_px(9)
RAYS = CAMERA.unproject(PIXELS)
MODELS = {
    "BrownConrady": CAMERA,
    "PerBand": PerBand.create(GEOMETRY, focal_length_mm=[25.6, 25.61], **DISTORTION),
    "Polynomial": Polynomial.create(GEOMETRY, focal_length_mm=25.6, degree=3),
}


def domain(row: str, call: Callable[[], Any], *words: str) -> Row:
    return row, call, DomainError, list(words)


def config(row: str, call: Callable[[], Any], *words: str) -> Row:
    return row, call, ConfigError, list(words)


# --- attitude


def wahba(**change: Any) -> Callable[[], Any]:
    given = {"v_cam": STARS, "v_ref": STARS, "frame": np.zeros(4, int), "sigma_rad": 5e-6} | change
    return lambda: attitude_solution.solve_wahba_many(**given)


def match(**change: Any) -> Callable[[], Any]:
    given = {"pixel_px": np.zeros((3, 2)), "catalogue_direction": np.eye(3), "attitude": ONE, "radius_px": 5.0}
    return lambda: association.match_stars(model=CAMERA, **given | {"tolerance_px": 1.0} | change)


def rates(time: Any, rate: Any, at: Any = None) -> Callable[[], Any]:
    return lambda: gyro_attitude.integrate_rates(time, rate, at)


def vectors(count: int, installation: Rotation = ONE, columns: int = 2) -> Callable[[], Any]:
    pixel = np.zeros((3, columns))
    return lambda: initial_frame_vectors(CAMERA, pixel, installation=installation, table_rotation=TURNS[:count])


def identified(pixel: Any, **options: Any) -> Callable[[], Any]:
    def call() -> Any:
        pytest.importorskip("tetra3rs")
        return identify(pixel, CAMERA, None, **options)

    return call


def guides(faintest_mag: float = 5.0) -> Any:
    return guide_catalogue(np.arange(4), STARS, np.full(4, 4.0), faintest_mag=faintest_mag, apart_rad=1e-3)


def frame_out_of_order() -> None:
    """The time is refused before the frame is read."""
    tracker = StarTracker(CAMERA, guides(), centroid="cog")
    tracker.begin(1.0, ONE)
    tracker(None, 1.0)


ATTITUDE = [
    domain("wahba: NaN", wahba(v_cam=np.full((4, 3), NAN)), "v_cam: row 0 is not finite (4 such rows)"),
    domain("wahba: length", wahba(v_ref=np.full((4, 3), 30.0)), "v_ref: row 0 has length 51.9"),
    domain("wahba: columns", wahba(v_cam=np.ones((4, 2))), "v_cam has shape (4, 2)"),
    domain("wahba: counts", wahba(v_ref=np.eye(3)), "4 directions v_cam and 3 directions v_ref"),
    domain("wahba: frames", wahba(frame=np.zeros(3, int)), "frame has shape (3,)"),
    domain("wahba: type of frames", wahba(frame=np.zeros(4)), "type float64"),
    domain("wahba: frame", wahba(frame=np.arange(4), frames=3), "0 to 2 is allowed for 3 frames"),
    domain("wahba: sigma", wahba(sigma_rad=0.0), "sigma_rad = 0.0; it must be finite and positive"),
    domain("wahba: sigmas", wahba(sigma_rad=np.ones(3)), "sigma_rad has shape (3,)"),
    domain("wahba: weight", wahba(sigma_rad=None, weight=np.array([1, 1, -2.0, 1])), "weight = -2.0"),
    config("wahba: method", lambda: solve_wahba(STARS, STARS, method="triad"), "'svd' or 'quest'"),
    config("wahba: weights", lambda: solve_wahba(STARS, STARS, sigma_rad=1.0, weight=np.ones(4)), "both given"),
    domain("match: pixels", match(pixel_px=np.zeros((3, 3))), "pixel_px has shape (3, 3)"),
    domain("match: length", match(catalogue_direction=np.full((4, 3), 100.0)), "unit vectors are needed"),
    domain("match: columns", match(catalogue_direction=np.zeros((4, 2))), "catalogue_direction has shape (4, 2)"),
    domain("match: attitudes", match(attitude=Rotation.identity(2)), "single scipy Rotation"),
    domain("match: radius", match(radius_px=0.0), "radius_px = 0.0 px"),
    domain("match: tolerance", match(tolerance_px=9.0), "at most radius_px = 5.0 px"),
    domain("rates: times", rates([0, 1], np.zeros((2, 3))), "the 3 ends of the intervals are needed"),
    domain("rates: order", rates([0, 1, 1], np.zeros((2, 3))), "increasing"),
    domain("rates: gap", rates([0, 1, 2], np.full((2, 3), NAN)), "fill gaps"),
    domain("rates: degrees", rates([0, 1, 2], np.full((2, 3), 30.0)), "rates are in rad/s"),
    domain("rates: columns", rates([0, 1, 2], np.zeros((2, 2))), "shape (2, 2)"),
    domain("rates: outside", rates([0, 1, 2], np.zeros((2, 3)), [2.5]), "at_s = 2.5 s lies outside"),
    domain("rates: at", rates([0, 1, 2], np.zeros((2, 3)), 1.0), "times of shape (f,)"),
    domain("angles: two", lambda: euler_angles.rotation_of_angles([0.0, 1.0]), "three finite angles"),
    domain("star vectors: columns", vectors(3, columns=3), "shape (3, 3)"),
    domain("star vectors: attitudes", vectors(2), "2 table attitudes for 3 images"),
    domain("star vectors: installation", vectors(3, TURNS), "3 rotations; a single rotation"),
    domain("triad: parallel", lambda: triad.triad(*[[[0, 0, 1], [0, 1e-3, -1]]] * 2), "not parallel"),
    domain("triad: one", lambda: triad.triad([[0, 0, 1]], [[0, 0, 1]]), "two directions"),
    domain("identify: pixels", identified(np.zeros((3, 3))), "pixel_px has shape (3, 3)"),
    domain("identify: flux", identified(np.zeros((3, 2)), flux=[1, 2]), "flux has shape (2,)"),
    domain("identify: tolerance", identified(np.zeros((3, 2)), tolerance_px=-1), "tolerance_px = -1"),
    domain("database: fields", lambda: build_database(min_fov_deg=13, max_fov_deg=11), "from 13 to 11 deg"),
    config("database: file", lambda: load_database("missing.bin"), "missing.bin", "create it by build_database"),
    domain("tracker: order of time", frame_out_of_order, "time_s = 1 s", "order of time"),
    domain("tracker: stars", lambda: StarTracker(CAMERA, guides(), centroid="cog", fewest=2), "fewest = 2"),
    domain("guides: none", lambda: guides(1.0), "no guide star from -2 to 1 mag"),
]

# --- cameras


def geometry(**change: Any) -> Callable[[], Any]:
    return lambda: SensorGeometry(**{"width_px": 5, "height_px": 5, "pixel_pitch_mm": 0.01} | change)


def camera(family: Any, **options: Any) -> Callable[[], Any]:
    return lambda: family.create(GEOMETRY, **{"focal_length_mm": 10.0} | options)


def line_of_sight(**change: Any) -> Callable[[], Any]:
    return lambda: line_of_sight_map(CAMERA, **{"reference_direction": RAYS, "pixel_px": PIXELS} | change)


def opencv(matrix: Any = ((2500, 0, 0), (0, 2500, 0), (0, 0, 1)), coefficients: Any = (0,) * 5) -> Callable[[], Any]:
    return lambda: BrownConrady.from_opencv(GEOMETRY, matrix, coefficients)


CAMERAS = [
    *(
        domain(f"{name}.{verb}: {bad}", lambda m=model, v=verb, b=bad: getattr(m, v)(b), "direction")
        for name, model in MODELS.items()
        for verb in ("project", "project_jacobian")
        for bad in ([[NAN, 0.0, 1.0]], [0.0, 0.0, 1.0], [["a", "b", "c"]])
    ),
    *(
        domain(f"{name}.unproject", lambda m=model: m.unproject([[1.0, 2.0], [NAN, 3.0]]), "pixel_px: row 1")
        for name, model in MODELS.items()
    ),
    *(
        domain(f"band {band}", lambda b=band: MODELS["PerBand"].project(RAYS[:16], b), "band")
        for band in (2, -1, [0, 1], NAN)
    ),
    domain("of_band", lambda: MODELS["PerBand"].of_band(2), "band 2", "2 bands"),
    domain("width", geometry(width_px=0), "width_px = 0"),
    domain("part of a pixel", geometry(width_px=5.5), "width_px = 5.5"),
    domain("pitch", geometry(pixel_pitch_mm=-1.0), "pixel_pitch_mm = -1.0 mm"),
    domain("grid", lambda: GEOMETRY.grid_px(1), "count = 1", "at least 2"),
    domain("BrownConrady: f = 0", camera(BrownConrady, focal_length_mm=0.0), "focal_length_mm = 0.0 mm"),
    domain("BrownConrady: q1", camera(BrownConrady, q1_per_mm2=np.inf), "parameters", "finite"),
    domain("PerBand: f", camera(PerBand, focal_length_mm=[10.0, -1.0]), "[10.0, -1.0] mm"),
    domain("PerBand: x0", camera(PerBand, focal_length_mm=[10.0, 10.0], x0_px=np.ones(3)), "x0_px of shape (3,)"),
    domain("Polynomial: degree 0", camera(Polynomial, degree=0), "degree = 0", "1 to 15"),
    domain("Polynomial: f", camera(Polynomial, focal_length_mm=-10.0), "focal_length_mm = -10.0 mm"),
    domain("Polynomial: nominal f", camera(Polynomial, nominal_focal_length_mm=0.0), "nominal_focal_length_mm = 0.0"),
    domain("Polynomial: anchor", camera(Polynomial, anchor_px=(1.0, 2.0, 3.0)), "anchor_px"),
    domain("parameters", lambda: CAMERA.with_parameters([1.0, 2.0]), "parameters"),
    domain("parameters NaN", lambda: CAMERA.with_parameters(np.full(8, NAN)), "finite"),
    config("name of a parameter", lambda: CAMERA.value("focal_lenght_mm"), "did you mean focal_length_mm"),
    domain("OpenCV: two f", opencv(np.diag([2500.0, 2600.0, 1.0])), "one focal length"),
    domain("OpenCV: skew", opencv([[2500.0, 3.0, 0.0], [0.0, 2500.0, 0.0], [0.0, 0.0, 1.0]]), "skew 3 px"),
    domain("OpenCV: matrix", opencv(np.eye(2)), "(2, 2)", "4 or 5"),
    domain("OpenCV: rational", opencv(coefficients=[0.0] * 5 + [0.1, 0.0, 0.0]), "beyond k3"),
    domain("fit: few", lambda: fit_to_map(CAMERA, RAYS[:5], PIXELS[:5]), "5 directions", "11 unknowns"),
    domain("fit: counts", lambda: fit_to_map(CAMERA, RAYS, PIXELS[:4]), "81 directions and 4 pixels"),
    domain("fit: NaN", lambda: fit_to_map(CAMERA, RAYS * NAN, PIXELS), "finite"),
    config("fit: name", lambda: fit_to_map(CAMERA, RAYS, PIXELS, free=("focal_length",)), "did you mean"),
    domain("line of sight: counts", line_of_sight(reference_direction=np.zeros((3, 3))), "3 reference directions"),
    domain("line of sight: length", line_of_sight(reference_direction=np.full((81, 3), 20.0)), "unit vector"),
    domain("line of sight: covariance", line_of_sight(covariance=np.eye(3)), "(3, 3)", "8 parameters"),
    domain("line of sight: one", line_of_sight(reference_direction=[AHEAD], pixel_px=[[1.0, 2.0]]), "two or more"),
]

# --- fitting


def dense(start: Any = (1.0, 1.0), free: Any = None, loss: str = "linear") -> Callable[[], Any]:
    def call() -> Any:
        problem = DenseProblem(lambda b: b, lambda b: np.eye(2), ("b1", "b2"), start, free=free)
        return solve(problem, problem.start, loss=loss)

    return call


def solution(**change: Any) -> Solution:
    fields: dict[str, Any] = {"value": np.ones(3), "names": ("a_px", "b_px", "c_mm"), "covariance": np.eye(3)}
    fields |= {"status": "converged", "message": "", "iterations": 4, "chi2": 12.0, "degrees_of_freedom": 6}
    return Solution(**fields | {"condition": 10.0, "residual_pulls": np.zeros(9), "robust_weight": np.ones(9)} | change)


def calibration(covariance: Any) -> Calibration:
    fields = {"method": "", "model": CAMERA, "solution": solution(), "attitude": None, "installation": None}
    return Calibration(covariance=covariance, used=np.ones(3, bool), **fields)


FITTING = [
    config("free parameter", dense(free=("b3",)), "unknown parameter 'b3'"),
    domain("start", dense(start=(1.0,)), "start of shape (1,)", "2 parameters"),
    config("loss", dense(loss="l2"), "unknown loss 'l2'"),
    config("name of a loss", lambda: get_loss("hubert"), "did you mean huber"),
    domain("tuning", lambda: get_loss("tukey", tuning=-1), "tuning = -1"),
    domain("truth", lambda: solution().pulls([1.0]), "shape (1,)", "3 unknowns"),
    config("status", lambda: solution(status="convergd"), "did you mean converged"),
    config("unknown", lambda: solution().index("a_mm"), "a_px"),
    domain("values", lambda: solution(value=[1.0]), "shape"),
    domain("covariance", lambda: solution(covariance=np.eye(2)), "shape"),
    domain("residuals", lambda: solution(residual_pulls=np.zeros((3, 3))), "shape"),
    domain("covariance of a calibration", lambda: calibration(np.zeros((3, 3))), "(8, 8)"),
]

# --- directional


def fisher(concentration: float = 1e6, count: int = 6) -> Any:
    return sample_fisher(AHEAD, concentration, count, np.random.default_rng(4))


DIRECTIONAL = [
    domain("columns", lambda: fit_fisher(np.ones((4, 2))), "(4, 2)", "(n, 3) unit vectors"),
    domain("one direction", lambda: fit_fisher([AHEAD]), "1 direction(s)", "at least 2"),
    domain("length", lambda: fit_fisher([AHEAD, 2.0 * AHEAD]), "length 2"),
    domain("equal", lambda: fit_fisher([AHEAD, AHEAD]), "all 2 directions are the same"),
    domain("opposite", lambda: fit_fisher([AHEAD, -AHEAD]), "cancel"),
    domain("degrees of freedom", lambda: fit_fisher(fisher(), degrees_of_freedom=-2), "degrees_of_freedom = -2"),
    domain("level", lambda: fit_fisher(fisher()).sigma_interval_rad(1.5), "level = 1.5"),
    domain("effective", lambda: fit_fisher(fisher()).sigma_interval_rad(effective=-1.0), "effective = -1"),
    domain("low", lambda: fit_fisher(fisher(1.0, 50)).sigma_interval_rad(), "high concentration"),
    domain("concentration", lambda: fisher(-1.0), "concentration = -1"),
    domain("deficit", lambda: concentration_from_deficit(1.0), "1 - R = 1"),
    *(
        domain(check.__name__, lambda c=check: c(fisher(count=3)), "3 directions; at least 4")
        for check in (isotropy_check, exponential_check, fisher_outliers)
    ),
    domain("level of outliers", lambda: fisher_outliers(fisher(), level=0.0), "level = 0"),
]

# --- calibration


@cache
def scene() -> Scene:
    return make_scene(frames=6, stars=5)


def fit(family: Callable[[], Any], **options: Any) -> Callable[[], Any]:
    return lambda: calibrate(scene().observations, START, family(), **options)


def linked(count: int = 6, time: Any = range(6)) -> Any:
    noise = GyroNoise(angle_random_walk_rad_per_sqrt_s=1e-6)
    return GyroLinked(gyro_rotation=scene().gyro[:count], time_s=time, noise=noise)


def few_turns() -> AttitudeCorrelated:
    return AttitudeCorrelated(gyro_rotation=TURNS)


def no_order() -> Any:
    lost = camera_order.OrderValidation(order="pinhole", parameters=3, chi2=np.array([NAN, 1.0]), residual_px=0.1)
    return camera_order.simplest_adequate([lost])


def crowded() -> Any:
    return calibrate(make_scene(frames=1, stars=6000).observations, START, interstar_angles.NoAttitude())


def behind() -> Any:
    away = Rotation.from_rotvec([np.pi, 0.0, 0.0]) * scene().attitude
    return bound(scene().observations, CAMERA, FreeAttitudes(attitude=away))


def observed(covariance_px2: Any = None, **change: Any) -> Callable[[], Any]:
    direction = np.repeat(STARS, 2, axis=0)[:6]
    given = {"pixel_px": np.ones((6, 2)), "direction": direction, "frame": [0, 0, 1, 1, 3, 3], "sigma_px": 0.1} | change
    if covariance_px2 is None:
        return lambda: Observations.isotropic(**given)
    covariance = np.tile(covariance_px2, (6, 1, 1))
    return lambda: replace(Observations.isotropic(**given), covariance_px2=covariance)


def cube(normals: Any, table: Any = None) -> Callable[[], Any]:
    return lambda: cube_from_table(normals, normals if table is None else table, covariance_rad2=np.zeros((2, 3, 3)))


def table(axes: str = "xy", **options: Any) -> Callable[[], Any]:
    return lambda: TableAxes.create(axes, **options)


def poses(**change: Any) -> PoseData:
    """Nine poses of a camera square on a table with the axes x and y."""
    angle = 0.05 * np.stack(np.meshgrid([-1.0, 0.0, 1.0], [-1.0, 0.0, 1.0]), axis=-1).reshape(-1, 2)
    pixel = CAMERA.project(TableAxes.create("xy").rotation(angle).inv().apply(AHEAD))
    data = PoseData(pixel_px=pixel, covariance_px2=np.tile(1e-4 * np.eye(2), (9, 1, 1)), reading_rad=angle)
    return replace(data, **change)


def parity(axes: str = "xy", **change: Any) -> Callable[[], Any]:
    return lambda: check_parity(poses(**change), TableAxes.create(axes), START, AHEAD)


def wrong_fit() -> None:
    wrong = poses(pixel_px=np.roll(poses().pixel_px, 1, axis=0))
    check_fit(calibrate_on_table(wrong, TableAxes.create("xy"), START, leans=True), "wrong", "check order and signs")


def bench_bound(angle: Any) -> Callable[[], Any]:
    bench = StarBench(table=TableAxes.create("xy"), star=AHEAD, installation=ONE)
    covariance = np.tile(np.eye(2), (len(angle), 1, 1))
    return lambda: table_bound.table_bound(CAMERA, bench, angle, covariance, RAYS, leans=True)


def along_the_outer_axis() -> Any:
    return aiming_angles(StarBench(table=TableAxes.create("zx"), star=AHEAD, installation=ONE), STARS, np.zeros(4))


def turntable(count: int = 6, **options: Any) -> Any:
    return TurntableAttitudes(table_rotation=Rotation.identity(count), **options)


def leaning(frames: int, names: tuple[str, ...] = ("lean_rad",)) -> TableErrors:
    return TableErrors(axis_rate=np.zeros((frames, 1, 3)), axis_names=names)


def coarse_readings() -> TableErrors:
    return TableErrors(reading_rate=np.zeros((6, 2, 3)), reading_sigma_rad=np.zeros(2))


def no_single_star() -> Any:
    return star_direction(calibrate(scene().observations, START, FreeAttitudes()))


DEGREES = np.column_stack([np.linspace(10, 350, 6), np.linspace(-80, 80, 6), np.zeros(6)])
CALIBRATION = [
    domain("observations: degrees", observed(direction=DEGREES), "degrees or hours"),
    domain("observations: two angles", observed(direction=DEGREES[:, :2]), "right ascension, declination"),
    domain("observations: length", observed(direction=np.tile(1.001 * AHEAD, (6, 1))), "row 0 has length 1.001"),
    domain("observations: directions", observed(direction=STARS), "shape"),
    domain("observations: direction NaN", observed(direction=np.full((6, 3), NAN)), "finite"),
    domain("observations: pixel NaN", observed(pixel_px=np.full((6, 2), NAN)), "finite"),
    domain("observations: columns", observed(pixel_px=np.zeros((6, 3))), "shape"),
    domain("observations: frames", observed(frame=[0, 0, 1, 1, 3]), "shape"),
    domain("observations: frame", observed(frame=[0, 0, 1, 1, 3, 4], frames=4), "0 .. 3"),
    domain("observations: part of a frame", observed(frame=[0.5, 0, 1, 1, 3, 3]), "whole numbers"),
    domain("observations: number of frames", observed(frames=-1), "frames = -1"),
    domain("observations: band", observed(band=[-1, 0, 0, 0, 0, 0]), "band: value -1"),
    domain("observations: star", observed(star=[-2, 0, 0, 0, 0, 0]), "star: value -2"),
    domain("observations: sigma", observed(sigma_px=0.0), "sigma_px = 0.0 px", "positive"),
    domain("observations: sigmas", observed(sigma_px=[0.1, 0.2]), "sigma_px of shape (2,)"),
    domain("observations: singular", observed([[0.01, 0.0], [0.0, 0.0]]), "row 0", "positive definite"),
    domain("observations: asymmetric", observed([[0.01, 0.001], [0.0, 0.01]]), "row 0", "positive definite"),
    domain("observations: mask", lambda: scene().observations.select([True, False]), "mask of shape (2,)"),
    domain("free: attitudes", fit(lambda: FreeAttitudes(attitude=TURNS)), "3 attitudes for 6 frames"),
    config("free: parameter", fit(FreeAttitudes, free=("focal_length_px",)), "camera parameter 'focal_length_px'"),
    domain("ACC", fit(few_turns), "3 gyro rotations for 6 frames"),
    domain("gyro: times", lambda: linked(5), "5 gyro rotations and 6 times; one of each per frame"),
    domain("gyro: order", lambda: linked(time=range(6, 0, -1)), "must be finite and increase"),
    domain("gyro: noise", lambda: GyroNoise(angle_random_walk_rad_per_sqrt_s=-1e-6), "= -1e-06", "not negative"),
    config("angles: weighting", lambda: interstar_angles.NoAttitude(weighting="some"), "weighting 'some'"),
    domain("angles: crowded", crowded, "keep the brightest 5477 stars"),
    domain("bound: behind", behind, "lie behind the camera"),
    domain("order: none", no_order, "no camera model converges"),
    domain("a frame", lambda: frame_attitude(scene().observations.select([0]), CAMERA), "attitude of 1 stars"),
    domain("cube: parallel", cube([[0, 0, 1], [0, 0, -1]]), "not parallel"),
    domain("cube: one face", cube([[0, 0, 1], [0, 0, 1]]), "a single face"),
    domain("cube: shapes", cube([[0, 0, 1]], [[0, 0, 1], [1, 0, 0]]), "are needed"),
    domain("table: one axis", table("x"), "1 axes; a table of 2 or 3"),
    domain("table: parallel", table("xx"), "enclose 0.000000 deg"),
    domain("table: noise", table(reading_noise_arcsec=-0.3), "must not be negative"),
    domain("table: lean", table(non_orthogonality_arcsec=40000.0), "at most 36000 arcsec"),
    *(config(f"table: {axes!r}", table(axes), "letters x, y, z") for axes in ("", "xq")),
    *(
        domain(f"table: angles {angle}", lambda a=angle: TableAxes.create("xy").rotation(a), "angle")
        for angle in ([0.0, 0.0], [[0.0]], [[0.0, NAN]])
    ),
    domain("bench: aim", along_the_outer_axis, "cannot turn the camera"),
    domain("bench: few", bench_bound(np.zeros((6, 2))), "6 places give 12 measurements for 14 unknowns"),
    domain("bench: one pose", bench_bound(np.zeros((81, 2))), "do not determine"),
    *(domain(f"poses: {axes}", parity(axes), "mirrored") for axes in ("x-y", "yx")),
    domain("poses: behind", parity(reading_rad=np.linspace([-2.5, 0.0], [2.5, 0.0], 9)), "behind the camera"),
    domain("poses: few", lambda: check_count(7, TableAxes.create("xy")), "7 places give 14 measurements"),
    domain("poses: fit", wrong_fit, "times their noise", "check order and signs"),
    domain("turntable: frames", fit(lambda: turntable(3)), "3 table rotations for 6 frames"),
    domain("turntable: leans", lambda: turntable(errors=leaning(3)), "axis_rate: shape (3, 1, 3)"),
    domain("turntable: names", lambda: leaning(6, ()), "axis_rate: shape"),
    domain("turntable: sigma", coarse_readings, "2 positive values"),
    domain("turntable: star", lambda: turntable(star=[0.0, 1.0, 1.0]), "unit vector"),
    domain("turntable: several stars", no_single_star, "not a single-star calibration"),
]

# --- accuracy

ACCURACY = [
    domain("level", lambda: ecss_metrics.normal_factor(1.5), "level = 1.5"),
    domain("window", lambda: ecss_metrics.ecss_metrics(np.zeros((2, 40)), 50, 0.9), "window of 50"),
    domain("no error", lambda: ecss_metrics.ecss_metrics(np.full((2, 40), NAN), 10, 0.9), "no finite error"),
    domain("successes", lambda: ecss_metrics.success_limit(6, 5, 0.9), "6 successes in 5 runs"),
    domain("failures", lambda: ecss_metrics.runs_needed(0.9, 0.9, -1), "failures = -1"),
    domain("grid", lambda: distortion.distortion_statistics(PIXELS[:10], np.zeros((10, 2)), 3), "10 points", "order 3"),
    domain("camera", lambda: distortion.fit_camera_terms(PIXELS[:4], np.zeros((4, 2)), "calibrated"), "8 terms"),
    *(
        domain(f"steps {shape}", lambda s=shape: step_residual_px(np.zeros(s)), "at least 2 positions of 2 stars")
        for shape in ((1, 5, 2), (4, 1, 2), (4, 2))
    ),
]

# --- records and measure


def stars_of(name: str, **options: Any) -> Callable[[], Any]:
    if name == "epsf":
        options["epsf"] = gaussian_epsf(0.7)
    return lambda: get_centroider(name, **options)


class Undecorated:
    name, label, needs_epsf, measure = "u", "u", False, None


def centroider(**change: Any) -> Callable[[], Any]:
    """A class of a user with one fault."""
    given = {"name": "user", "label": "user", "needs_epsf": False, "measure": None} | change
    members = {key: value for key, value in given.items() if key not in change or value is not None}
    return lambda: register_centroider(dataclass(frozen=True)(type("User", (), members)))


def epsf(psf: Any, index: int = 0) -> Callable[[], Any]:
    return lambda: EpsfCentroider(epsf=psf).measure(replace(WINDOWS.select([0]), psf_index=[index]), NOISE)


def built(**options: Any) -> Callable[[], Any]:
    return lambda: build_epsf(WINDOWS, NOISE, **options)


def matched(rows: Any) -> Callable[[], Any]:
    nominal = 40.0 * np.indices((3, 4)).reshape(2, -1).T
    words = {"match_px": 4.0, "where": "here", "unseen": "expose longer", "merged": "move apart"}
    return lambda: match_points(nominal[rows], nominal, **words)


def dark_screen() -> None:
    camera = SimpleNamespace(
        pitch_mm=0.01, to_pixel=lambda mm: mm / 0.01 + 100.0, to_screen=lambda px: 0.01 * (px - 100.0)
    )
    aperture = fit_circle(0.4 * np.column_stack([np.cos([0, 1, 3, 5]), np.sin([0, 1, 3, 5])]))
    fit_spot(ScreenPicture(electrons=np.zeros((201, 201)), camera=camera), aperture, 0.7, advice="more light")


GAIN = {"gain_dn_per_e": 1.0, "offset_dn": 0.0, "read_noise_e": 1.0}
IMAGE = image_of(np.random.default_rng(1).normal(100.0, 3.0, (64, 64)))
WINDOWS = stamps_of(1e4 * gaussian_stars(np.full(12, 5.0), np.full(12, 5.0), 0.7), np.full(12, 5.0), np.full(12, 5.0))
FULL = replace(WINDOWS, flags=np.array([int(StarFlag.SATURATED)] + [0] * 11, np.uint32))
LINE = np.column_stack([np.arange(10.0), 2 * np.arange(10.0)])
RECORDS = [
    domain("read noise", lambda: NoiseModel(read_noise_e=-1.0), "read_noise_e = -1.0 e-"),
    domain("gain", lambda: NoiseModel(read_noise_e=1.0, gain_dn_per_e=0.0), "gain_dn_per_e = 0.0 DN/e-"),
    domain("offset", lambda: NoiseModel(read_noise_e=1.0, offset_dn=np.inf), "offset_dn = inf"),
    domain("windows", lambda: stamps_of(np.zeros((1, 2, 2)), [1.0], [1.0]), "(2, 2) px", "at least 3 x 3"),
]
MEASURE = [
    domain("background: nothing", lambda: estimate_background(image_of(np.full((32, 32), NAN))), "no usable pixel"),
    domain("background: box", lambda: estimate_background(IMAGE, box_px=2), "box_px = 2 px", "at least 8 px"),
    domain("background: clipping", lambda: estimate_background(IMAGE, clip_sigma=1.0), "clip_sigma = 1.0"),
    domain("background: mask", lambda: estimate_background(IMAGE, exclude=np.zeros((3, 3), bool)), "exclude has shape"),
    domain("background: step", lambda: estimate_background(IMAGE, step_px=0), "step_px = 0"),
    domain("background: cell", lambda: estimate_background(IMAGE, step_px=16), "box_px = 64 px", "so 128 px"),
    domain("detection: limit", lambda: detect(IMAGE, threshold_sigma=0.0), "threshold_sigma = 0.0"),
    domain("detection: filter", lambda: detect(IMAGE, fwhm_px=0.1), "fwhm_px = 0.1 px", "0.5 to 20 px"),
    domain("detection: number", lambda: detect(IMAGE, max_stars=-1), "max_stars = -1"),
    domain("detection: background", lambda: detect(IMAGE, estimate_background(image_of(np.ones((9, 9))))), "(9, 9) px"),
    domain("alarms", lambda: threshold_for_false_alarms(1e9, 10_000), "1e+09 false alarms", "between 0 and"),
    config("find: centroider", lambda: find_stars(IMAGE, "window"), "did you mean windowed"),
    domain("find: dimensions", lambda: find_stars(np.zeros(64)), "shape (64,)", "two dimensions"),
    *(
        domain(f"window of {size} px", lambda s=size: find_stars(IMAGE, size_px=s), f"size_px = {size}", words)
        for size, words in ((4, "odd"), (1, "at least 3"), (65, "larger than the image"))
    ),
    domain("stamps: NaN", lambda: extract_stamps(IMAGE, [9.0, NAN], [9.0, 9.0], background=0.0), "star 1 is (nan"),
    domain("stamps: counts", lambda: extract_stamps(IMAGE, [9.0, 8.0], [9.0], background=0.0), "equal length"),
    domain("image: nothing", lambda: sensor_image(np.full((10, 10), NAN)), "no finite number"),
    domain("image: noise", lambda: sensor_image(np.zeros((10, 10)), read_noise_e=-2.0), "read_noise_e = -2"),
    domain("image: defects", lambda: sensor_image(np.zeros((9, 9)), defect=np.zeros((3, 3), bool)), "defect has shape"),
    domain("dark", lambda: subtract_dark(frame_of(np.zeros((9, 9)), **GAIN), np.zeros((3, 3))), "shape (3, 3)"),
    config("centroider", stars_of("gausian"), "did you mean gaussian"),
    config("centroider: option", stars_of("cog", half_width=3), "did you mean half_width_px"),
    config("centroider: PSF", lambda: get_centroider("epsf"), "needs epsf=", "build_epsf"),
    domain("centroider: width", stars_of("tcog", half_width_px=0), "half_width_px = 0 px; it must be at least 1"),
    domain("centroider: threshold", stars_of("tcog", threshold_sigma=-1.0), "threshold_sigma = -1.0"),
    domain("centroider: window", stars_of("windowed", sigma_px=0.0), "sigma_px = 0.0 px; it must be above 0 px"),
    *(
        domain(f"{name}: {option}", stars_of(name, **{option: value}), f"{option} = {value}")
        for name in ("gaussian", "epsf")
        for option, value in (("max_iterations", 0), ("tolerance", NAN), ("max_shift_px", -1.0))
    ),
    config("new centroider: name", centroider(name="cog"), "belongs to CentreOfGravity"),
    config("new centroider: members", centroider(label=None, measure=None), "no label and no measure"),
    config("new centroider: PSF", centroider(needs_epsf=True), "no field epsf"),
    config("new centroider: class", lambda: register_centroider(Undecorated), "must be a dataclass"),
    domain("ePSF: index", epsf(gaussian_epsf(0.7), 3), "psf_index spans 3 to 3"),
    domain("ePSF: sampling", epsf([gaussian_epsf(0.7, 4), gaussian_epsf(0.7, 5)]), "oversamplings [4, 5] differ"),
    domain("ePSF: none", epsf([]), "no EffectivePsf"),
    domain("build: stars", built(), "12 usable stars", "at least 16"),
    domain("build: half an index", built(star_index=np.arange(12)), "belong together"),
    domain("build: index", built(oversampling=2, star_index=[0, 1], frame_index=[0, 1]), "12 integers"),
    domain("build: sampling", built(oversampling=0), "oversampling = 0", "1 to 16"),
    domain("build: roughness", built(roughness=0.0), "roughness = 0.0"),
    domain("build: positions", built(position_px=np.zeros((3, 2))), "position_px has shape (3, 2)"),
    domain("build: both", built(position_px=np.zeros((12, 2)), star_index=[0], frame_index=[0]), "give either"),
    domain("bound", lambda: cramer_rao(lambda p: np.full(9, p[0] + p[1]), [1.0, 2.0], NOISE), "do not determine"),
    domain("SNR", lambda: flux_for_snr(np.ones((3, 3)) / 9, -1.0, 0.0, NOISE), "snr = -1"),
    config("threshold", lambda: predict_centroids("tcog", (gaussian_epsf(0.8),), [300.0], noise=NOISE), "noise level"),
    domain("spokes", lambda: sample_spokes(np.zeros((9, 9)), [4, 4], np.arange(9.0), spokes=3), "at least 8 spokes"),
    domain("radii", lambda: sample_spokes(np.zeros((9, 9)), [4, 4], [1.0, 2.0, 2.0, 3.0, 4.0]), "increasing radii"),
    domain("circle: few", lambda: fit_circle(np.zeros((3, 2))), "shape (3, 2)", "at least 4 points"),
    domain("circle: a line", lambda: fit_circle(LINE), "on a line"),
    domain("circle: NaN", lambda: fit_circle(np.full((10, 2), NAN)), "not finite"),
    domain("circle: sigma", lambda: fit_circle(LINE**2, sigma=0.0), "sigma of an edge point is 0", "positive"),
    ("dark screen", dark_screen, ConvergenceError, ["the spot shows only", "more light"]),
    domain("target: dark", matched(slice(0)), "here: no target point", "expose longer"),
    domain("target: a point", matched(slice(1, None)), "1 of 12", "column 0.0, row 0.0"),
    domain(
        "saturated windows",
        lambda: refuse_saturated(FULL, 6, where="readout", advice="expose shorter"),
        *("readout: saturated at 1 of 6 places", "column 5, row 5", "expose shorter"),
    ),
    domain("separability", lambda: separability(np.zeros((5, 4)), np.zeros(5, int), np.zeros(5, int)), "both kinds"),
]

# --- photometry, psf, detector


def photometry(count: int) -> Any:
    row = {key: np.ones(count) for key in ("magnitude", "colour", "u2", "flux_e")}
    return fit_photometry(**row, frame=np.zeros(count, int), frames=1, flux_error_e=0.01 * np.ones(count))


def mixture(count: int) -> Any:
    column, index = np.zeros((count, 2)), np.zeros(count, int)
    pixels = {"dn": np.zeros((count, 9, 9)), "valid": np.ones((count, 9, 9), bool), "level_dn": np.zeros(count)}
    windows = StarWindows(offset_px=column, position_px=column, colour=index, frame=index, star=index, **pixels)
    return fit_psf(windows, (99, 99), noise_dn2=(0.1, 1.0), width_px=0.65)


def focus(count: int) -> Any:
    grid = {"grid_px": np.zeros((4, 2)), "grid_width_px": np.ones((3, 4)), "centre_px": np.zeros(2), "pitch_mm": 5e-3}
    return fit_detector_pose(np.zeros((count, 2)), np.ones(count), shift_mm=np.arange(3.0), **grid)


def sky(*masks: Any) -> Callable[[], Any]:
    noise = np.random.default_rng(1).standard_normal((len(masks), 128, 128))
    blocks = [sky_blocks(100.0 + dn, mask) for dn, mask in zip(noise, masks, strict=True)]
    return lambda: sky_photon_transfer(blocks, lowest_dn=100.0)


LEFT, ALL = np.indices((128, 128))[1] < 64, np.ones((128, 128), bool)
FRAMES = 100.0 + np.random.default_rng(2).standard_normal((4, 8, 8))
MEAN, SINGLE, ONE_PIXEL = mean_frame(FRAMES), mean_frame(FRAMES[:1]), np.eye(1, 64).reshape(8, 8)
TRANSFER = PhotonTransfer(
    gain_dn_per_e=1.0, gain_error_dn_per_e=0.1, read_noise_e=1.0, read_noise_error_e=0.1, pixels=64
)
DETECTOR = [
    domain("no frame", lambda: mean_frame([]), "no frame", "at least one"),
    domain("frames of two sizes", lambda: mean_frame([FRAMES[0], FRAMES[0, 1:]]), "frame 1 has the shape (7, 8)"),
    *(
        domain(f"transfer of {name}", lambda f=flats, d=dark: flat_photon_transfer(f, d), "two frames", "two darks")
        for name, flats, dark in (("no flat", [], MEAN), ("a flat", [SINGLE], MEAN), ("a dark", [MEAN], SINGLE))
    ),
    domain("transfer of a pixel", lambda: flat_photon_transfer([MEAN], MEAN, usable=ONE_PIXEL), "1 p"),
    domain("pattern", lambda: fixed_pattern(MEAN, SINGLE, TRANSFER), "4 flats and 1 darks", "two of each"),
    domain("hot pixels", lambda: find_hot_pixels([]), "no frames", "at least one"),
    domain("hot pixels: sizes", lambda: find_hot_pixels([IMAGE, image_of(np.ones((20, 30)))]), "(20, 30) px"),
    domain("hot pixels: mask", lambda: without_pixels(IMAGE, np.zeros((3, 3), bool)), "mask has shape (3, 3)"),
    domain("sky: size", lambda: sky_blocks(np.zeros((32, 64)), np.zeros((32, 64))), "64 x 32 px", "64 x 64"),
    domain("sky: one level", sky(~ALL, ~ALL), "the gain is not determined"),
    domain("sky: stars everywhere", sky(ALL, ALL), "free of stars"),
    domain("sky: no common block", sky(LEFT, ~LEFT), "fewer than two blocks"),
    domain("windows", lambda: window_photon_transfer([np.ones((3, 1, 2, 2))], [ALL[None, :2, :2]]), "4 pixels", "30"),
]
STARS_OF_FRAMES = [
    domain("photometry", lambda: photometry(12), "12 stars with a flux", "needs 20"),
    domain("PSF", lambda: mixture(20), "20 bright", "the PSF needs 25"),
    domain("focus and tilt", lambda: focus(9), "9 bright stars", "need 30"),
]

ROOMS = {
    "records": RECORDS, "measure": MEASURE, "detector": DETECTOR, "photometry, psf": STARS_OF_FRAMES,
    "attitude": ATTITUDE, "cameras": CAMERAS, "fitting": FITTING, "directional": DIRECTIONAL,
    "calibration": CALIBRATION, "accuracy": ACCURACY,
}  # fmt: skip


@pytest.mark.parametrize(
    ("call", "kind", "words"),
    [pytest.param(*row[1:], id=f"{room}: {row[0]}") for room, rows in ROOMS.items() for row in rows],
)
def test_refusals(call: Callable[[], Any], kind: type[Exception], words: list[str]) -> None:
    with pytest.raises(kind) as error:
        call()
    message = str(error.value)
    assert "\n" not in message
    assert [word for word in words if word not in message] == []
