"""What the calibrations refuse: night and gyro, sky, turntable, cube mirror, star vectors.

Rows as in ``tests/experiments/test_refusals.py``.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any

from experiments.acf.experiment import check_design
from experiments.acf.settings import AcfConfig
from experiments.cube.experiment import run as run_cube
from experiments.cube.settings import CubeMirrorConfig
from experiments.fisher.accuracy import check_config as check_fisher
from experiments.fisher.settings import FisherConfig
from experiments.harness.config import load_config
from experiments.harness.progress import Progress
from experiments.skycal.scene import build_scene as build_sky_scene
from experiments.skycal.settings import SkycalConfig
from experiments.turntable.experiment import prepare as prepare_turntable
from experiments.turntable.settings import TurntableCalibrationConfig
from optics.errors import ConfigError, ConvergenceError, DomainError
from render.engine.random import Streams


def calibration(name: str, *texts: str) -> Callable[[Path], Any]:
    """The checks of a calibration; the run, for the cube mirror."""
    config_class, check = {
        "acf": (AcfConfig, check_design),
        "skycal": (SkycalConfig, lambda c: [build_sky_scene(camera, c, Streams(1)) for camera in c.cameras]),
        "turntable": (TurntableCalibrationConfig, prepare_turntable),
        "cube": (CubeMirrorConfig, lambda c: run_cube(c, progress=Progress())),
        "fisher": (FisherConfig, check_fisher),
    }[name]
    particles = ["benches.shown_log2_particles=16", "benches.log2_particles=16", "benches.count=2", "sensor.grid=7"]
    return lambda _: check(load_config(config_class, settings=[*(particles if name == "cube" else ()), *texts]))


CALIBRATIONS = [
    ("frames", calibration("acf", "frames=0"), ConfigError, "frames = 0", "at least 4"),
    ("runs", calibration("acf", "runs=1"), ConfigError, "runs = 1", "at least 4"),
    ("stars", calibration("acf", "sky.stars_per_frame=1"), ConfigError, "sky.stars_per_frame = 1", "at least 2"),
    ("equations", calibration("acf", "frames=6", "sky.stars_per_frame=3"), ConfigError,
     "3 frames calibrate and give 18 equations for 14 unknowns"),
    ("equations of the counts", calibration("acf", "frames=10", "counts=[2,4]"), ConfigError,
     "counts = 2, frames = 10", "20 equations for 14 unknowns"),
    ("equations of the sweep", calibration("acf", "frames=14", "sweep.stars=[2,4]"), ConfigError,
     "sweep.stars = 2, frames = 14: 56 measurements for 50 unknowns"),
    ("stars of the sweep", calibration("acf", "sweep.stars=[1,4]"), ConfigError, "sweep.stars", "= 1", "at least 2"),
    ("order", calibration("acf", "sweep.stars=[8,4]"), ConfigError, "increasing values"),
    ("gyro factor", calibration("acf", "sweep.gyro_factor=[-1,1]"), ConfigError, "sweep.gyro_factor", "at least 0"),
    ("NaN", calibration("acf", "noise_px=[nan]"), ConfigError, "nan: a finite number is needed"),
    ("one noise", calibration("acf", "noise_px=[0.2]"), ConfigError, "1 given; at least 2"),
    ("no bias", calibration("acf", "bias_deg_per_h=[]"), ConfigError, "0 given; at least 1"),
    ("zero noise", calibration("acf", "noise_px=[0,0.2]"), ConfigError, "noise_px", "= 0", "above 0"),
    ("bias", calibration("acf", "bias_deg_per_h=[-1]"), ConfigError, "bias_deg_per_h", "= -1", "at least 0"),
    ("gyro rate", calibration("acf", "gyro.rate_hz=0.5"), ConfigError,
     "gyro.rate_hz = 0.5 Hz: at least frame_rate_hz = 1 Hz"),
    ("installation", calibration("acf", "gyro.installation_deg=[2,2]"), ConfigError, "gyro.installation_deg"),
    ("focal length", calibration("acf", "camera.focal_length_mm=1"), ConfigError, "164 deg", "at most 120 deg"),
    ("principal point", calibration("acf", "camera.x0_px=900"), ConfigError, "(900, -10) px: at most a quarter"),
    ("fixed axis", calibration("acf", "gyro.motion=fixed_axis"), DomainError, "13 of the 14 unknowns"),
    ("slow rotation", calibration("acf", "gyro.angular_speed_deg_per_s=0.001"), DomainError,
     "the installation would be determined to 3.", "the body turns by 0.034 deg"),
    ("start", calibration("acf", "sky.phi_deg=[150,0,0]"), DomainError, "stars are behind the camera",
     "start.phi_from_stars=true"),
    ("strong distortion", calibration("acf", "camera.q1_per_mm2=1"), DomainError, "at most 30 %"),
    ("folded image", calibration("acf", "camera.q1_per_mm2=-0.02"), DomainError, "folds the image over 2",
     "mm from the principal point"),
    ("lens of another field",
     calibration("skycal", 'wide.instrument={lens="star_tracker_26mm",detector="cmv4000"}'), DomainError,
     "wide: the corners of 2048 x 2048 px see 17.1 deg"),
    ("size of the detector", calibration("skycal", "wide.instrument.width_px=4096"), DomainError,
     "wide.instrument.width_px = 4096 px; detector 'CMV4000' has 2048 px"),
    ("window", calibration("skycal", "narrow.instrument.width_px=1000"), DomainError, "must lie on a single chip"),
    ("lens", calibration("skycal", "narrow.instrument.lens=nothing"), ConfigError, "unknown lens 'nothing'"),
    ("absorption", calibration("skycal", "narrow.instrument.lens=double_gauss_50mm"), DomainError,
     "absorption = false"),
    ("pass band", calibration("skycal", "passband.range_nm=[300, 900]"), DomainError,
     "passband.range_nm: 'full pass band' passes 290 ... 910 nm"),
    ("faintest star", calibration("skycal", "narrow.faintest_mag=12"), ConfigError, "at least 0 and at most 10"),
    ("unknown model", calibration("skycal", "wide.models=['cubic']"), ConfigError, "'cubic': a camera model is"),
    ("model", calibration("skycal", "narrow.model=polynomial_9"), ConfigError, "polynomial_9", "is none of models"),
    ("gyro rate of the sky", calibration("skycal", "gyro.rate_hz=0.5"), ConfigError,
     "at least motion.frame_rate_hz = 1 Hz"),
    ("frames of the sky", calibration("skycal", "frames=3"), ConfigError, "frames = 3", "at least 4"),
    ("reading noise", calibration("turntable", "two_axis.reading_noise_arcsec=[-0.3]"), ConfigError, "at least 0"),
    ("edge", calibration("turntable", "grid.edge_px=5"), ConfigError, "windows leave the detector"),
    ("installation of the camera", calibration("turntable", "installation_deg=[40,0,0]"), ConfigError,
     "at most 30 deg"),
    ("direction of the star", calibration("turntable", "reduction.star_deg=[90,0]"), ConfigError, "at most 60"),
    ("field", calibration("turntable", "study.field_deg=[0,3]"), ConfigError, "0.5"),
    ("swept reading noise", calibration("turntable", "study.reading_noise_arcsec=[-1,3]"), ConfigError, "at least 0"),
    ("axes", calibration("turntable", "two_axis.axes=x"), ConfigError, "2 axes are needed"),
    ("positions", calibration("turntable", "grid.columns=2", "grid.rows=2", "grid.edge_px=400"), DomainError,
     "4 places give 8 measurements"),
    ("spot beyond the screen", calibration("cube", "trim.start_px=10000"), DomainError, "off the screen: it reaches"),
    ("spot beyond the picture", calibration("cube", "trim.start_px=100"), DomainError,
     "is not wholly in the picture of 400 x 400 px"),
    ("beam beside the face", calibration("cube", "cube.offset_mm=[30,0,0]"), DomainError, "the beam misses face +Z"),
    ("beam cut", calibration("cube", "cube.offset_mm=[0,9,0]"), DomainError, "is cut by the edge of face +Z"),
    ("small cube", calibration("cube", "cube.side_mm=3.2"), DomainError, "aperture of 2.5 mm is larger than the spot"),
    ("point source", calibration("cube", "simulator.source_arcmin=0"), DomainError,
     "the aperture of 2.5 mm is as large as the spot of 2.5 mm"),
    ("narrow rim", calibration("cube", "simulator.source_arcmin=0.3"), DomainError, "a rim of", "px shows around it"),
    ("large aperture", calibration("cube", "screen.aperture_mm=18.8"), DomainError, "mm wide at the cube",
     "its face only 19 mm"),
    ("narrow simulator", calibration("cube", "simulator.diameter_mm=2"), DomainError, "must be smaller than the beam"),
    ("trims", calibration("cube", "trim.allowed=1"), ConvergenceError,
     "not concentric after trim.allowed = 1 settings: offsets"),
    ("dim pictures", calibration("cube", "camera.plateau_e=30"), ConvergenceError, "camera.plateau_e"),
    ("parallel faces", calibration("cube", 'cube.faces=["+X","-X"]'), ConfigError, "the faces are parallel"),
    ("Y face", calibration("cube", 'cube.faces=["+Z","+Y"]'), ConfigError, "the inner axis is parallel to the light"),
    ("glued face", calibration("cube", 'cube.faces=["+Z","-Z"]'), ConfigError, "-Z is glued to the sensor"),
    ("TRIAD", calibration("cube", 'cube.faces=["+Z","+X","-X"]'), ConfigError, "cube.method=wahba"),
    ("first face", calibration("cube", 'cube.faces=["+X","+Z"]'), ConfigError, "the first face must be +Z"),
    ("field of the sun sensor", calibration("cube", "sensor.field_deg=50"), DomainError,
     "a spot of the sun sensor leaves its detector"),
    ("detector file", calibration("cube", "camera.detector=absent.toml"), ConfigError, "absent.toml: no such file"),
    ("saturated camera", calibration("cube", "camera.plateau_e=2e5"), DomainError, "saturates 'CCD, 15 um'"),
    ("saturated sun sensor", calibration("cube", "sensor.plateau_e=15000"), DomainError,
     "sensor.plateau_e = 15000 e- saturates"),
    ("number of axes", calibration("fisher", "table.axes=x"), DomainError, "2 or 3"),
    ("parallel axes", calibration("fisher", "table.axes=xx"), DomainError, "orthogonal"),
    ("name of an axis", calibration("fisher", "table.axes=q"), ConfigError, "letters"),
    ("rolls", calibration("fisher", "table.axes=xyz"), ConfigError, "table.rolls_deg = [0.0]"),
    ("noises of the table", calibration("fisher", "table.reading_noise_arcsec=[0.1,0.1,0.1]"), DomainError,
     "reading_noise_arcsec", "(2,)"),
    ("large grid", calibration("fisher", "evaluation.columns=100"), DomainError, "lower evaluation.columns"),
    ("few vectors", calibration("fisher", "evaluation.columns=2", "evaluation.rows=2"), DomainError,
     "evaluation.columns or evaluation.rows"),
    ("edge of the evaluation", calibration("fisher", "evaluation.edge_px=5"), ConfigError, "evaluation.edge_px = 5 px"),
    ("no evaluation", calibration("fisher", "evaluation.edge_px=900"), DomainError, "evaluation.edge_px"),
    ("no grid", calibration("fisher", "grid.edge_px=900"), DomainError, "grid.edge_px"),
    ("smear", calibration("fisher", "dynamic.rate_deg_per_s=5"), ConfigError, "smears the image"),
    ("samples", calibration("fisher", "dynamic.samples=2"), ConfigError, "dynamic.samples = 2"),
    ("field of view", calibration("fisher", "field.field_deg=[3.0,150.0]"), ConfigError, "field_deg"),
    ("band", calibration("fisher", "passband.range_nm=[100,200]"), DomainError, "nm"),
]  # fmt: skip
