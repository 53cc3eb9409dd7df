"""What the experiments refuse: kind of error, and the names, values or ranges that its message of one line holds.

A row: name of the case, call (with a folder of the files below), error, words of the message.
"""

import json
import os
from collections.abc import Callable
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import click
import numpy as np
import pytest
from astropy import units
from astropy.table import Table
from calibration_refusals import CALIBRATIONS
from lens_texts import ZMX_DOUBLET
from PIL import Image
from pydantic import ValidationError
from small_sensors import RAYS, sensor
from target_frames import HEAD, readout, spots, write

from experiments.budget.settings import BudgetConfig
from experiments.camera.settings import CameraReportConfig
from experiments.camera.settings import experiment as camera_experiment
from experiments.chromatic.own_frames import filter_frames
from experiments.chromatic.settings import ChromaticConfig
from experiments.dataset import workers
from experiments.dataset.folder import DatasetFolder, check, file_digest
from experiments.dataset.job import Job
from experiments.dataset.plan import build_plan
from experiments.dataset.remote import RemoteDataset, Store, dataset_at, working_copy
from experiments.dataset.scene import build_scene
from experiments.dataset.settings import DatasetConfig
from experiments.dataset.truth_files import read_origin, read_record
from experiments.distortion.own_frames import reduce as distortion
from experiments.distortion.settings import DistortionConfig
from experiments.flight.prediction import heated
from experiments.flight.scenario import build_flight
from experiments.flight.settings import FlightConfig
from experiments.harness.config import load_config
from experiments.harness.outputs import OutputFolder
from experiments.harness.plotting import equation_svg, wavelength_colour
from experiments.harness.progress import Progress
from experiments.harness.range import parse_sweep
from experiments.harness.registry import declared
from experiments.harness.tables import Table as OutputTable
from experiments.harness.what_if import run_sweep
from experiments.hsfe.own_frames import reduce as hsfe
from experiments.laboratory.devices.collimator import build_collimator
from experiments.laboratory.devices.turntable import build_turntable
from experiments.laboratory.sensor_prediction import predict_camera
from experiments.laboratory.settings.collimator import CollimatorConfig, FilteredCollimatorConfig
from experiments.laboratory.settings.tables import SignalConfig
from experiments.laboratory.single_star.settings import SingleStarConfig, TurntableConfig
from experiments.laboratory.single_star.setup import check_table, grid_px
from experiments.lens.command import lens
from experiments.reduce.command import reduce as reduce_command
from experiments.reduce.folder import read_folder
from experiments.reduce.frames_toml import FolderLayout
from experiments.statement.study import read_flight
from experiments.straylight.experiment import run as run_straylight
from experiments.straylight.settings import StraylightConfig
from experiments.temporal.own_frames import own_frames as temporal_test
from experiments.temporal.own_frames import reduce as temporal
from experiments.temporal.settings import TemporalConfig
from experiments.twin.folder import night_frames
from experiments.twin.pipeline import measure_night
from experiments.twin.settings import TwinConfig
from optics.errors import BackendError, ConfigError, DomainError, StarbenchError
from optics.glass.absolute_index import Environment
from optics.lens_file import lens_path
from optics.settings import flat
from render.sensor_file.file import read_sensor
from render.sensor_file.instrument import build_instrument

Call = Callable[[Path], Any]

# --- Datasets: settings, attitudes, scene, folder, URL, workers

PLEIADES = {"kind": "cone", "ra_deg": 56.75, "dec_deg": 24.12, "radius_deg": 0.1}
SMALL = {"detector": "cmv4000", "exposure_s": 0.2, "width_px": 256, "height_px": 192}
FIELD = {"instrument": SMALL, "nodes": 3, "catalogue": {"faintest_mag": 9.0}, "pointing": PLEIADES}
NEAR_SUN = {"kind": "cone", "ra_deg": 27.0, "dec_deg": 11.0, "radius_deg": 1.0}
SPRING = {"faintest_mag": 9.0, "epoch_year": 2025.3}
TURNING = {"kind": "fixed", "rate_deg_per_s": (0.0, 1.0, 0.0)}
JOB = Job(config="{}", folder="", backend="llvm")
FREQUENCIES = "jitter.frequency_hz=[1, 100]"


def settings(*texts: str) -> Call:
    return lambda _: load_config(DatasetConfig, settings=list(texts))


def plan(*, diagonal_deg: float = 0.0, **changes: Any) -> Call:
    return lambda _: build_plan(DatasetConfig(**{"frames": 2, **changes}), diagonal_deg=diagonal_deg)


def attitudes(name: str = "list.ecsv", kind: str = "list", **columns: Any) -> Call:
    """The plan of a list of attitudes, or of a scan, in a file."""

    def call(folder: Path) -> Any:
        if columns:
            Table(columns).write(folder / name)
        return build_plan(DatasetConfig(frames=1, pointing={"kind": kind, "file": str(folder / name)}))

    return call


def scene(**changes: Any) -> Call:
    dark = {"background": {"extra_e_per_s": 0.0}, "frames": 2}
    return lambda _: build_scene(DatasetConfig.model_validate(dark | FIELD | changes))


def no_magnitudes(folder: Path) -> Any:
    stars = {"source_id": [1, 2], "ra": [10.0, 20.0], "dec": [1.0, 2.0], "phot_g_mean_mag": [np.nan, np.nan]}
    Table(stars).write(folder / "stars.ecsv")
    return scene(catalogue={"source": str(folder / "stars.ecsv"), "preset": "gaia"})(folder)


def dataset(*files: str, frames: int = 3, seed: int = 1, software: str = "3") -> Call:
    """A dataset in a folder with files, begun with seed 1 and version 3 if ``dataset.json`` is among them."""

    def call(folder: Path) -> Any:
        folder = folder / "sky"
        for name in files:
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            (folder / name).write_text('{"format": 2, "software": {"mitsuba": "3"}, "config": {"seed": 1}}')
        DatasetFolder(folder, config={"seed": seed}, frames=frames, truth="parquet").open({"mitsuba": software})

    return call


def linked(folder: Path) -> Any:
    (folder / "sky").mkdir()
    (folder / "sky" / "frames").symlink_to(folder)
    return dataset()(folder)


def foreign_url(_: Path) -> Any:
    Store("memory://letters").write("letters.txt", b"mine")
    return RemoteDataset("memory://letters", config={}, frames=1, truth="parquet")


def on_cluster(result: Any) -> Call:
    """The check of a cluster whose worker gives a result or raises an error."""

    def answer(timeout: float | None = None) -> Any:
        if timeout is None or isinstance(result, TimeoutError):
            raise result

    client = SimpleNamespace(submit=lambda *work, pure: SimpleNamespace(result=answer))
    return lambda folder: workers._check_cluster(client, JOB, "tcp://head:1")


def no_workers(folder: Path) -> Any:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(workers, "local_cluster", lambda count: (_ for _ in ()).throw(OSError("no pipes")))
        return workers.make_frames(JOB, [0, 1], workers=2, scheduler="", done=id)


def truth_file(text: str, read: Callable[[Path], Any] = read_record) -> Call:
    def call(folder: Path) -> Any:
        (folder / "frame_000000.ecsv").write_text(text)
        return read(folder / "frame_000000.ecsv")

    return call


DATASETS = [
    ("frames", settings("frames=0"), ConfigError, "frames", "1"),
    ("window", settings("window_px=8"), ConfigError, "window_px", "8 px is even"),
    ("rates", settings("rate.kind=random", "rate.lowest_deg_per_s=1"), ConfigError, "highest_deg_per_s is below"),
    ("log rates", settings("rate.kind=random", "rate.distribution=log_uniform"), ConfigError,
     "lowest_deg_per_s above 0"),
    ("one frequency", settings("jitter.frequency_hz=[1]"), ConfigError, "frequency_hz = [1.0]", "at least two"),
    ("no density", settings(FREQUENCIES), ConfigError, "psd_x_arcsec2_per_hz, _y or _z"),
    ("densities", settings(FREQUENCIES, "jitter.psd_y_arcsec2_per_hz=[1, 2, 3]"), ConfigError, "has 3 values for 2"),
    ("splits", settings("splits.train_fraction=0.9"), ConfigError, "add up to 1.1"),
    ("export twice", settings('exports=["coco", "coco"]'), ConfigError, "an export is named twice"),
    ("list empty", plan(pointing={"kind": "list"}), ConfigError, "pointing.file is empty"),
    ("list missing", plan(pointing={"kind": "list", "file": "no.csv"}), ConfigError, "no.csv", "no such file"),
    ("list suffix", attitudes(name="chip.toml"), ConfigError, "chip.toml", ".csv or .ecsv"),
    ("list no rows", attitudes(ra_deg=[], dec_deg=[], roll_deg=[]), ConfigError, "holds no rows"),
    ("list short",
     lambda folder: build_plan(DatasetConfig(frames=9, pointing={"kind": "list", "file": f"{folder}/list.csv"})),
     ConfigError, "holds 1 attitudes, 9 frames"),
    ("quaternion", attitudes(quat_x=[0.0], quat_y=[0.0], quat_z=[0.1], quat_w=[0.9]), DomainError,
     "row 0 has length 0.905", "normalised"),
    ("radians", attitudes(ra=np.linspace(0, 6, 30), dec=np.linspace(-1, 1, 30), roll=np.zeros(30)), DomainError,
     "radians"),
    ("declination", attitudes(ra_deg=[1.0], dec_deg=[95.0], roll_deg=[0.0]), DomainError,
     "declination of row 0 is 95 deg", "-90 to 90"),
    ("roll", attitudes(ra_deg=[1.0], dec_deg=[5.0], roll_deg=[400.0]), DomainError, "roll of row 0 is 400 deg",
     "-360 to 360"),
    ("NaN", attitudes(ra_deg=[1.0], dec_deg=[np.nan], roll_deg=[0.0]), DomainError, "dec_deg of row 0", "not finite"),
    ("text", attitudes(ra_deg=["a"], dec_deg=[5.0], roll_deg=[0.0]), ConfigError, "ra_deg", "not a number"),
    ("columns", attitudes(ra_deg=[1.0], dec_deg=[5.0]), ConfigError, "ra_deg, dec_deg", "roll_deg"),
    ("unit", attitudes(ra_deg=[1.0] * units.m, dec_deg=[5.0], roll_deg=[0.0]), ConfigError, "is in m", "deg"),
    ("scan times", attitudes(kind="scan", time_s=[0.0, 1.0, 1.0]), DomainError, "time_s of row 2 is 1 s"),
    ("scan times missing", attitudes(kind="scan", ra_deg=[0.0]), ConfigError, "column time_s is missing"),
    ("scan short",
     attitudes(kind="scan", time_s=[0.0, 0.1], ra_deg=[0.0, 1.0], dec_deg=[0.0, 1.0], roll_deg=[0.0, 0.0]),
     DomainError, "lasts 0.1 s", "at most 0"),
    ("rate of a scan", plan(pointing={"kind": "scan"}, rate=TURNING), ConfigError, "leave rate out"),
    ("arcs", plan(splits={"by": "arc"}), DomainError, "splits.by = arc", "constant rate"),
    ("arcs too narrow",
     plan(pointing={"kind": "scan", "rate_deg_per_s": (0.0, 0.1, 0.5)}, splits={"by": "arc"}, diagonal_deg=60.0),
     DomainError, "splits.", "no room"),
    ("gap", plan(splits={"by": "sky", "gap_deg": 100.0}), DomainError, "splits.gap_deg = 100", "less than 90 deg"),
    ("cone in gaps", plan(pointing={"kind": "cone"}, splits={"by": "sky"}, diagonal_deg=17.7), DomainError,
     "less than half"),
    ("cone at the Sun", plan(pointing=NEAR_SUN | {"sun_exclusion_deg": 30.0}, catalogue=SPRING), DomainError,
     "whole cone lies within", "sun_exclusion_deg = 30"),
    ("planets", scene(background={"moon_planets": True}), ConfigError, "background.moon_planets",
     "catalogue.observer = earth"),
    ("stray light", scene(background={"stray_light": "pst.csv"}), ConfigError, "background.stray_light",
     "catalogue.observer = earth"),
    ("zodiacal sky", scene(pointing={"kind": "sky"}, catalogue=SPRING, background={"zodiacal": True}), DomainError,
     "sun_exclusion_deg to at least 16"),
    ("zodiacal cone", scene(pointing=NEAR_SUN, catalogue=SPRING, background={"zodiacal": True}), DomainError,
     "frame 0", "deg from it"),
    ("faintest", scene(catalogue={"faintest_mag": -2.0}), DomainError, "faintest_mag = -2", "brightest star"),
    ("no star", scene(catalogue={"faintest_mag": 1.0}), DomainError, "no frame contains a star", "1 mag"),
    ("no magnitudes", no_magnitudes, DomainError, "no magnitude for any of its 2 stars"),
    ("no catalogue", scene(catalogue={"source": "no.fits", "preset": "gaia"}), ConfigError, "no.fits", "no such file"),
    ("trail", scene(rate=TURNING | {"rate_deg_per_s": (0.0, 5.0, 0.0)}), DomainError, "5 deg/s", "leave the frame"),
    ("drift", scene(rate=TURNING | {"rate_deg_per_s": (0.0, 0.7, 0.0)}, instrument=SMALL | {"line_time_us": 1e4}),
     DomainError, "0.7 deg/s", "while rows are read"),
    ("jitter", scene(jitter={"frequency_hz": (1.0, 100.0), "psd_x_arcsec2_per_hz": (1e9, 1e9)}), DomainError,
     "jitter of", "px RMS"),
    ("width", scene(instrument={"detector": "cmv4000", "width_px": 4096}), DomainError, "set it to at most that"),
    ("field", scene(instrument={"detector": "cmv4000", "lens": "star_tracker_26mm"}), DomainError, "made for 16.5 deg"),
    ("band", scene(passband={"range_nm": (300.0, 700.0)}), DomainError, "has data for 400"),
    ("other files", dataset("thesis.tex"), ConfigError, "holds thesis.tex", "dataset.json"),
    ("other seed", dataset("dataset.json", "frames/frame_000007.fits", seed=2), ConfigError, "seed = 1",
     "this run has 2"),
    ("other software", dataset("dataset.json", "frames/frame_000007.fits", software="4"), ConfigError,
     'software.mitsuba = "3"', 'this run has "4"'),
    ("fewer frames", dataset("dataset.json", "truth/frame_000004.parquet"), ConfigError, "number 4, frames = 3",
     "at least 5"),
    ("no identity", dataset("truth/frame_000001.parquet"), ConfigError, "neither dataset.json nor a truth file"),
    ("a file", lambda folder: DatasetFolder(folder / "list.csv", config={}, frames=1, truth="ecsv"), ConfigError,
     "is a file"),
    ("a link", linked, ConfigError, "frames is a link"),
    ("check nothing", lambda folder: check(folder / "no", Progress()), ConfigError, "no such folder"),
    ("check no dataset", lambda folder: check(folder, Progress()), ConfigError, "is not a dataset", "SHA256SUMS"),
    ("digest", lambda folder: file_digest(folder / "no"), ConfigError, "no", "cannot be read"),
    ("no truth", truth_file("text"), ConfigError, "is not a truth file"),
    ("damaged truth", truth_file("starbench_sha256: " + "1" * 64), ConfigError, "digest does not match"),
    ("no file of truth", lambda folder: read_origin(folder / "no.parquet"), ConfigError, "no.parquet",
     "cannot be read"),
    ("protocol", lambda _: dataset_at("nosuch://bucket/sky", DatasetConfig()), ConfigError, "nosuch", "not known"),
    ("memory", lambda _: dataset_at("memory://else/sky", DatasetConfig(workers=2)), ConfigError, "memory://else/sky",
     "workers = 1"),
    ("nothing at a URL", lambda _: working_copy("memory://nothing").__enter__(), ConfigError, "memory://nothing",
     "does not exist"),
    ("foreign URL", foreign_url, ConfigError, "letters.txt", "is no dataset"),
    ("address", lambda _: workers.make_frames(None, [0], workers=0, scheduler="localhost", done=id), ConfigError,
     "scheduler = 'localhost'", "tcp://host:8786"),
    ("no workers", on_cluster(TimeoutError()), ConfigError, "tcp://head:1", "has no workers"),
    ("worker refuses", on_cluster(ConfigError("worker a does not see it")), ConfigError, "tcp://head:1: worker a"),
    ("worker without starbench", on_cluster(ImportError("no module")), ConfigError, "cannot run starbench (no module)"),
    ("workers do not start", no_workers, BackendError, "2 workers cannot be started (no pipes)"),
]  # fmt: skip

# --- Own frames: a folder and its frames.toml

POINT = HEAD + "points = 1\n"
ONE = "[[series]]\nfiles = ['a_*.fits']\n"
FILTERS = FolderLayout(needs=("filter_nm",), same_scene="place")


def image(folder: Path, name: str, shape: tuple[int, int] = (64, 96), **cards: Any) -> Any:
    """A frame with a star, in a file."""
    dn = readout(spots(shape, [(40, 30)], 15000.0), np.random.default_rng(len(name)))
    write(folder / name, dn, **{"EXPTIME": 0.1, **cards})
    return dn


def own(text: str, reduce: Callable[..., Any] | None = None, *config: Any, **options: Any) -> Call:
    """Frames of a folder with the settings, and their reduction by a method."""

    def call(folder: Path) -> Any:
        for name in ("a_1.fits", "a_22.fits", "b_1.fits", "b_22.fits"):
            dn = image(folder, name)
        image(folder, "small.fits", (64, 80))
        image(folder, "slow.fits", EXPTIME=0.3)
        write(folder / "nan.fits", np.where(np.eye(*dn.shape) > 0, np.nan, dn))
        write(folder / "sum.fits", 200 * dn.astype(np.int32))
        for name in ("c_1.fits", "c_2.fits", "d_1.fits", "d_2.fits"):
            image(folder, name, FILTER="R")
        (folder / "frames.toml").write_text(text)
        read = read_folder(folder, **{"window_px": 9, **options})
        return reduce and reduce(read, ("cog",), *config)

    return call


def pattern(make: Callable[[Path], Any]) -> Call:
    def call(folder: Path) -> Any:
        make(folder / "a_9.fits")
        return own(POINT + ONE)(folder)

    return call


def chromatic(*series: tuple[str, int, str]) -> Call:
    rows = "".join(f"[[series]]\nfiles = '{n}_*.fits'\nfilter_nm = {nm}\nplace = '{p}'\n" for n, nm, p in series)
    return own(POINT + rows, filter_frames, ChromaticConfig(), layout=FILTERS)


def temporal_run(**changes: Any) -> Call:
    def call(folder: Path) -> Any:
        own(POINT + ONE)(folder)
        return temporal_test.run(TemporalConfig(own_frames=str(folder), **changes), progress=Progress())

    return call


FRAMES = [
    ("no folder", lambda folder: read_folder(folder / "no", window_px=9), ConfigError, "no such folder"),
    ("no frames.toml", lambda folder: read_folder(folder, window_px=9), ConfigError, "holds no frames.toml"),
    ("key missing", own(HEAD.replace("offset_dn = 60.0\n", "") + ONE), ConfigError, "offset_dn"),
    ("key unknown", own(HEAD + "point = 1\n" + ONE), ConfigError, "point"),
    ("no series", own(POINT), ConfigError, "series_table is needed"),
    ("no points", own(HEAD + ONE), ConfigError, "exactly one of points, points_px and target"),
    ("moving target", own(HEAD + "points_px = [[40, 30]]\n" + ONE, layout=FolderLayout(same_scene="none", points=1)),
     ConfigError, "moves it"),
    ("key of the method", own(POINT + ONE, layout=FolderLayout(needs=("outer_deg",))), ConfigError,
     "series 1: outer_deg is missing"),
    ("one frame", own(POINT + "[[series]]\nfiles = ['b_1.fits']"), DomainError, "1 frame", "at least 2"),
    ("no file", own(POINT + "[[series]]\nfiles = ['a_1.fits', 'e_1.fits']"), ConfigError, "no file 'e_1.fits'"),
    ("outside", own(POINT + "[[series]]\nfiles = ['../a.fits']"), ConfigError, "'../a.fits'", "not within the folder"),
    ("link", pattern(lambda path: path.symlink_to("gone.fits")), ConfigError, "a_9.fits", "a link to gone.fits"),
    ("pipe", pattern(os.mkfifo), ConfigError, "a_9.fits", "a device, pipe"),
    ("folder", pattern(Path.mkdir), ConfigError, "a_9.fits", "is a folder"),
    ("count", own(POINT + ONE + "count = 5"), ConfigError, "2 frames in the folder, count = 5"),
    ("size", own(POINT + "[[series]]\nfiles = ['a_1.fits', 'small.fits']"), DomainError, "small.fits has 80 x 64 px",
     "one size"),
    ("shared", own(POINT + "dark = ['a_1.fits']\n" + ONE), ConfigError, "a_1.fits", "dark and to series 1"),
    ("off the detector", own(HEAD + "points_px = [[40, 30], [400, 30]]\n" + ONE), DomainError, "1 of 2 target points",
     "column 400.0"),
    ("undetected", own(HEAD + "points_px = [[40, 30], [70, 30]]\n" + ONE), DomainError, "1 points detected of 2"),
    ("target missing", own(HEAD + "target = 'a.csv'\n" + ONE), ConfigError, "no file 'a.csv'"),
    ("target columns", own(HEAD + "target = 'list.csv'\n" + ONE), ConfigError, "x_px and y_px, or tan_x and tan_y"),
    ("target values", own(HEAD + "target = 'words.csv'\n" + ONE), ConfigError, "words.csv: finite coordinates"),
    ("window", own(POINT + ONE, window_px=71), DomainError, "1 of 1 windows of 71 px leave the detector"),
    ("positions", own(POINT + ONE + "position = 1\n[[series]]\nfiles = 'b_*.fits'"), ConfigError,
     "position must be given"),
    ("exposures", own(POINT + "[[series]]\nfiles = ['a_1.fits', 'slow.fits']"), DomainError, "exposure time 0.3 s",
     "0.1 s"),
    ("dark", own(POINT + "dark = 'slow.fits'\n" + ONE), DomainError, "exposed 0.1 s, its dark frames 0.3 s"),
    ("flat", own(POINT + "flat = 'slow.fits'\ndark = 'b_1.fits'\n" + ONE), DomainError,
     "flat: exposed 0.3 s, its dark frames"),
    ("dark flat", own(POINT + "flat = 'b_1.fits'\n" + ONE), DomainError, "brighter flats are needed"),
    ("saturated flat", own(POINT + "saturation_dn = 61\nflat = 'b_1.fits'\n" + ONE), DomainError, "flat:", "saturated"),
    ("bad pixels", own(POINT + "bad_pixels = 'small.fits'\n" + ONE), DomainError, "one value for every pixel"),
    ("bad pixels broken", own(POINT + "bad_pixels = 'list.csv'\n" + ONE), ConfigError,
     "list.csv: not a readable FITS image"),
    ("table of another kind", own(POINT + "series_table = 'outer.csv'\n"), ConfigError, "outer.csv, row 1", "'outer'"),
    ("table empty", own(POINT + "series_table = 'heads.csv'\n"), ConfigError, "heads.csv: no rows"),
    ("NaN", own(POINT + "[[series]]\nfiles = 'nan.fits'"), ConfigError, "NaN or infinite"),
    ("sum", own(POINT + "[[series]]\nfiles = 'sum.fits'"), ConfigError, "above the 16-bit range"),
    ("saturated", own(POINT + "saturation_dn = 500\n" + ONE, temporal), DomainError, "saturated at 1 of 1 places"),
    ("steps", own(POINT + ONE, hsfe), DomainError, "at least 2 [[series]]"),
    ("coordinates", own(POINT + ONE, distortion, DistortionConfig()), DomainError, "coordinates of the target"),
    ("no PSF", temporal_run(centroid="epsf", compare=()), ConfigError, "own frames have no PSF"),
    ("filter missing", chromatic(("a", 600, "left"), ("b", 800, "left"), ("c", 600, "right")), ConfigError,
     "no series of 800 nm at place 'right'"),
    ("filter twice", chromatic(("a", 600, "left"), ("b", 800, "left"), ("c", 800, "left")), ConfigError,
     "both have filter 800 nm and place 'left'"),
    ("reference filter", chromatic(("a", 500, "left"), ("b", 800, "left")), ConfigError,
     "reference filter, 600 nm, does not occur"),
    ("only filter", chromatic(("a", 600, "left")), ConfigError, "only filter 600 nm"),
    ("FILTER", chromatic(("c", 600, "left"), ("d", 800, "left")), ConfigError, "FILTER = 'R'", "600 and 800"),
    ("method", lambda _: reduce_command.main(["--frames", ".", "--method", "temporl"], standalone_mode=False),
     click.UsageError, "'temporl'", "'temporal'"),
]  # fmt: skip

# --- The command lens


def lens_command(*arguments: str) -> Call:
    """``starbench lens`` in the folder of the files."""

    def call(folder: Path) -> Any:
        with pytest.MonkeyPatch.context() as patch:
            patch.chdir(folder)
            return lens.main(list(arguments), standalone_mode=False)

    return call


TRACKER = "star_tracker_26mm"
LENSES = [
    ("file", lens_command("show", "none.zmx"), ConfigError, "none.zmx", "no such file"),
    ("glass", lens_command("show", "doublet.zmx", "--glass", "SSK5"), ConfigError, "--glass SSK5", "OLD=NEW"),
    ("unknown glass", lens_command("show", "doublet.zmx", "--glass", "SSK5=N-BK77"), ConfigError, "'N-BK77'"),
    ("page", lens_command("show", "doublet.zmx", "--out", "no/page.html"), ConfigError, "no/page.html",
     "does not exist"),
    ("format", lens_command("convert", "doublet.zmx", "lens.xyz"), ConfigError, ".toml, .zmx or .seq"),
    ("overwrite", lens_command("convert", "doublet.zmx", "doublet.zmx"), ConfigError, "doublet.zmx exists", "--force"),
    ("command", lens_command("explode"), click.UsageError, "explode"),
    ("no file", lens_command("show"), click.UsageError, "FILE"),
    ("window", lens_command("ghosts", TRACKER, "--window", "N-BK7"), ConfigError, "--window N-BK7", "GLASS:MM:GAP"),
    ("pixel", lens_command("ghosts", TRACKER, "--pixel-um", "0"), ConfigError, "--pixel-um 0", "positive"),
    ("spacer", lens_command("thermal", TRACKER, "--spacer", "L99=invar_36"), ConfigError, "'L99'", "known: L1"),
    ("spacer form", lens_command("thermal", TRACKER, "--spacer", "L1"), ConfigError, "--spacer L1", "NAME=VALUE"),
    ("second", lens_command("thermal", TRACKER, "--second", "unobtainium"), ConfigError, "--second unobtainium"),
]  # fmt: skip

# --- Laboratory: settings of the tests, targets, collimator, turntable, lens table of a sensor file


def run_of(name: str, *settings: str) -> Call:
    """A run of an experiment that ends before anything is rendered."""

    def call(_: Path) -> Any:
        experiment = declared(name)
        return experiment.part(experiment.run)(
            load_config(experiment.config, settings=["compare=[]", *settings]), progress=Progress()
        )

    return call


def collimator(**changes: Any) -> Call:
    return lambda _: build_collimator(FilteredCollimatorConfig(**changes), BAND).light(BAND, D_LINE, Environment())


def grid(*texts: str) -> Call:
    config = partial(load_config, SingleStarConfig, settings=texts)
    return lambda _: grid_px(config(), build_instrument(config().instrument))


def axes(**changes: Any) -> Call:
    table = {"axes": "xy", "reading_noise_arcsec": (0.3,), "non_orthogonality_arcsec": (5.0,)} | changes
    return lambda _: check_table("two_axis", TurntableConfig(**table), 2)


def turntable(letters: Any, **changes: Any) -> Call:
    return lambda _: build_turntable(letters, **changes)


def lens_table(*lines: str) -> Call:
    def call(folder: Path) -> Any:
        keys = {"kind": '"ideal"', "focal_length_mm": "50.0", "f_number": "8.0"}
        keys |= dict(line.split(" = ") for line in lines)
        text = "\n".join(f"{key} = {value}" for key, value in keys.items())
        (folder / "sensor.toml").write_text(f'[instrument]\ndetector = "cmv4000"\n[instrument.lens]\n{text}')
        return read_sensor(folder / "sensor.toml")

    return call


def tilted_lens(folder: Path) -> Any:
    head, part, tail = lens_path("star_camera_206mm").read_text(encoding="utf-8").rpartition("[[surface]]")
    (folder / "tilted.toml").write_text(f"{head}{part}\ntilt_deg = [0.1, 0.0]{tail}", encoding="utf-8")
    return run_of("chromatic", f"instrument.lens={folder}/tilted.toml")(folder)


BAND, D_LINE = [SimpleNamespace(name="d")], np.array([[587.5618]])
LABORATORY = [
    ("levels", run_of("temporal", "brightness.lowest_e=30000"), ConfigError, "first must be the lower one"),
    ("target off", run_of("temporal", "place_px=[20, 20]"), DomainError, "off the detector"),
    ("passband", run_of("temporal", "passband.range_nm=[300, 900]"), DomainError, "passband.range_nm", "290 ... 910 nm",
     "400 ... 1000 nm"),
    ("defocus", run_of("temporal", "instrument.defocus_mm=0.5"), DomainError, "RMS radius", "window_px = 13",
     "instrument.defocus_mm"),
    ("step", run_of("hsfe", "steps.step_px=7"), DomainError, "not smaller than half the window"),
    ("positions", run_of("hsfe", "steps.positions=1"), ConfigError, "positions"),
    ("order", run_of("distortion", "order=5"), ConfigError, "more rows and columns than the order"),
    ("grid edge", run_of("distortion", "target.edge_px=2000"), DomainError, "does not fit"),
    ("reference", run_of("distortion", "reference=ideal"), ConfigError, "reference"),
    ("jitter of a grid", run_of("distortion", "target.jitter_px=-1"), ConfigError, "jitter_px"),
    ("lens", run_of("chromatic", "instrument.lens=star_camera_206"), ConfigError, "'star_camera_206'",
     "did you mean star_camera_206mm"),
    ("detector", run_of("chromatic", "instrument.detector=absent.toml"), ConfigError, "absent.toml: no such file"),
    ("element", run_of("chromatic", "decentre.element=L9"), ConfigError, "unknown element 'L9'; did you mean L"),
    ("pair", run_of("chromatic", "decentre.pair=800-500"), ConfigError, "'800-500'; did you mean 800-600"),
    ("centroider", run_of("chromatic", 'compare=["cogg"]'), ConfigError, "compare.0 = 'cogg'", "did you mean cog"),
    ("filter", run_of("chromatic", "filters.centres_nm=[350,600,800]"), DomainError,
     "'350 nm' passes 295 ... 405 nm", "400 ... 1000 nm"),
    ("filter below 0", run_of("chromatic", "filters.centres_nm=[0,600,800]"), DomainError, "reaches below 0 nm"),
    ("single filter", run_of("chromatic", "filters.centres_nm=[600]"), ConfigError, "at least 2 values"),
    ("filter twice", run_of("chromatic", "filters.centres_nm=[600,600,800]"), ConfigError, "a centre is given twice"),
    ("filter of reference", run_of("chromatic", "filters.reference_nm=700"), ConfigError,
     "filters.reference_nm = 700", "500.0, 600.0, 800.0"),
    ("filter edge", run_of("chromatic", "filters.width_nm=4"), DomainError, "edge 10 nm is outside 0 ... 4 nm"),
    ("dark frames", run_of("chromatic", "dark_frames=1"), ConfigError, "dark_frames = 1", "at least 2"),
    ("window", run_of("chromatic", "window_px=5"), ConfigError, "window_px = 5", "at least 7 and at most 63"),
    ("even window", run_of("chromatic", "window_px=14"), ConfigError, "window_px = 14: an odd number"),
    ("pitch", run_of("chromatic", "target.pitch_px=3"), ConfigError, "target.pitch_px = 3 px: at least window_px = 13"),
    ("target size", run_of("chromatic", "target.pitch_px=1500"), DomainError, "1500 px apart",
     "does not fit on 4096 x 2048 px"),
    ("target edge", run_of("chromatic", "target.edge_px=5"), ConfigError, "target.edge_px = 5 px: at least 7 px"),
    ("coating", run_of("chromatic", "instrument.coating_nm=1"), DomainError, "MgF2: wavelength 1 nm",
     "200 ... 7000 nm"),
    ("temperature", run_of("chromatic", "stars.temperatures_k=[-5,3000]"), ConfigError, "stars.temperatures_k", "-5",
     "at least 1000"),
    ("pass band file", run_of("chromatic", "passband.file=absent.csv"), ConfigError, "absent.csv: no such file"),
    ("tilted lens", tilted_lens, DomainError, "paraxial quantities exist for centred lenses only"),
    ("field of the lens", run_of("chromatic", "instrument.lens=star_tracker_26mm", "decentre.element=auto"),
     DomainError, "deg from the axis", "field of 16.5 deg"),
    ("moved element", run_of("budget", "moved.element=L9"), ConfigError, "unknown element 'L9'"),
    ("detector name", run_of("budget", "instrument.detector=acc19_mosaic"), ConfigError, "acc18_mosaic"),
    ("star counts", run_of("budget", "attitude.counts=[1, 5]"), ConfigError, "at least 2"),
    ("saturation", run_of("budget", "source.signal_e=1e6"), DomainError, "source: a point of 1e+06 e- saturates"),
    ("signal", lambda _: SignalConfig(signal_e=3000.0, magnitude_mag=7.0), ValidationError, "give one of them"),
    ("collimator", collimator(focal_length_mm=1.0), ValidationError, "greater than or equal to 10"),
    ("focus curve", collimator(focus_um=(1.0, 2.0)), ValidationError, "2 values for 0 of focus_wavelength_nm"),
    ("focus nodes", collimator(focus_um=(1.0, 2.0), focus_wavelength_nm=(600.0, 500.0)), ValidationError,
     "[600.0, 500.0]: at least two increasing"),
    ("one frequency", collimator(vibration_hz=(1.0,), vibration_arcsec2_per_hz=(1.0,)), ValidationError,
     "at least two increasing"),
    ("no power", collimator(vibration_hz=(1.0, 2.0), vibration_arcsec2_per_hz=(1.0, 0.0)), ValidationError,
     "0 is not above 0"),
    ("offset", collimator(offset_mm=(0.0, 2e3)), ValidationError, "offset_mm: 2000 is outside -1000 ... 1000"),
    ("wedge", collimator(wedge_arcsec=(1e4,)), ValidationError, "wedge_arcsec: 10000 is outside -3600 ... 3600"),
    ("azimuths", collimator(wedge_arcsec=(1.0,), wedge_direction_deg=(1.0, 2.0)), ValidationError,
     "2 values for 1 of wedge_arcsec"),
    ("filter distance", collimator(filter_distance_mm=2000.0), ValidationError, "2000: at most focal_length_mm = 1000"),
    ("wedges", collimator(wedge_arcsec=(1.0, 2.0)), DomainError, "wedge_arcsec has 2 values for 1 filters"),
    ("wedge glass", collimator(wedge_arcsec=(1.0,), wedge_glass="N-BK8"), ConfigError, "N-BK8"),
    ("focus range", collimator(focus_wavelength_nm=(400.0, 500.0), focus_um=(0.0, 1.0)), DomainError,
     "focus_wavelength_nm = 400 ... 500 nm", "588 ... 588 nm"),
    ("vacuum", lambda _: build_collimator(CollimatorConfig(air_gradient_k_per_m=(0.0, 1.0))).light(
        BAND, D_LINE, Environment(pressure_hpa=0.0)), DomainError, "in a vacuum"),
    ("columns", grid("grid.columns=1"), DomainError, "cover 0% of the detector's width"),
    ("coverage", grid("grid.edge_px=900"), DomainError, "at least 50% of both"),
    ("edge", grid("grid.edge_px=3000"), DomainError, "leaves no area"),
    ("search windows", grid("grid.columns=150"), DomainError, "places lie 27 px apart"),
    ("axis twice", axes(axes="xx"), ConfigError, "two_axis.axes = 'xx': neighbouring axes are the same"),
    ("axis reversed", axes(axes="x-x"), ConfigError, "two_axis.axes = 'x-x': neighbouring axes are the same"),
    ("letter", axes(axes="xq"), ConfigError, "two_axis.axes: ", "'xq'; letters x, y, z"),
    ("number of axes", axes(axes="x"), ConfigError, "2 axes are needed, 1 given"),
    ("noise of axes", axes(reading_noise_arcsec=(1, 2, 3)), ConfigError, "3 values where 2 are needed"),
    ("angles of axes", axes(non_orthogonality_arcsec=(1, 2)), ConfigError, "2 values where 1"),
    ("axis length", turntable([[1, 0, 0], [0, 2, 0]]), DomainError, "length 2"),
    ("negative noise", turntable("xy", setting_noise_arcsec=-0.3), DomainError, "must not be negative"),
    ("noise shape", turntable("xy", reading_noise_arcsec=(0.3, 0.3, 0.3)), DomainError, "shape"),
    ("encoder", turntable("xy", encoder_cycles=np.nan), DomainError, "finite"),
    ("lens key", lens_table("f_numbr = 2"), ConfigError, "instrument.lens.f_numbr", "did you mean 'f_number'"),
    ("f-number", lens_table("f_number = -1"), ConfigError, "instrument.lens.f_number = -1"),
    ("lens kind", lens_table('kind = "measured"'), ConfigError, "instrument.lens.kind = 'measured'"),
    ("two spots", lens_table("spot_um = 3", "psf_fwhm_px = 2"), ConfigError, "give one of them"),
]  # fmt: skip

# --- The harness: sweeps, output folders, tables, equations

SWEEPS = [
    ("defocs_mm=-0.2:0.2:9", "did you mean defocus_mm"),
    ("defocus_mm=-0.1:0.1:9:log", "a logarithmic"),
    ("defocus_mm=0.1,0.1", "1 different values"),
    ("edge_nm=10:20:3", "passband.edge_nm or filters.edge_nm"),
    ("defocus_mm=0.1:0.1:3", "empty"),
    ("defocus_mm=0:inf:3", "finite"),
    ("defocus_mm=a:0.1:3", "numbers"),
    ("defocus_mm=0:0.1:1", "2 to 200"),
    ("defocus_mm=0:0.1", "KEY=LOW:HIGH:POINTS"),
    ("defocus_mm=-30:30:3", "at least -10"),
    ("frames=10.1:10.3:5", "whole numbers"),
    ("lens=1:2:3", "instrument.lens cannot be swept"),
    ("attitude.stars=2:4:3", "does not depend on attitude.stars"),
    (f"frames={','.join(map(str, range(201)))}", "201 different values; 2 to 200"),
]


def in_current_folder(folder: Path) -> Any:
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        return OutputFolder(".")


HARNESS = [
    *((f"sweep {text:.30}", lambda _, text=text: parse_sweep(text, BudgetConfig, ["attitude"]), ConfigError,
       f"--sweep {text}: ", words) for text, words in SWEEPS),
    ("output is a file", lambda folder: OutputFolder(folder / "chip.toml"), ConfigError, "chip.toml: is a file"),
    ("output below a file", lambda folder: OutputFolder(folder / "chip.toml" / "below"), ConfigError,
     "below: cannot be written"),
    ("output on a mount point", lambda _: OutputFolder("/"), ConfigError, "/: is a mount point"),
    ("output in the current folder", in_current_folder, ConfigError, ".: is the current folder"),
    ("cells of a row", lambda _: OutputTable(columns=["a", "b"], rows=[(1, 2), (3,)]), DomainError,
     "row 1 has 1 cells where 2 are needed"),
    ("equation", lambda _: equation_svg(r"\nosuchcommand{"), DomainError, "nosuchcommand", "cannot be set"),
    ("wavelength", lambda _: wavelength_colour(-1.0), DomainError, "-1.0 nm", "positive"),
]  # fmt: skip

# --- Camera: predictions and sweeps


TRACKER = flat({**sensor(**RAYS), "sky": {"attitudes": 20}})


def camera(predict: bool = False, **changes: Any) -> Call:
    """The settings of a camera; ``predict``: its prediction, or its sweep."""

    def call(_: Path) -> Any:
        texts = {**TRACKER, **{key.replace("__", "."): value for key, value in changes.items()}}
        config = load_config(CameraReportConfig, settings=[f"{key}={json.dumps(v)}" for key, v in texts.items()])
        if predict:
            return run_sweep(camera_experiment, config, progress=Progress()) if config.sweep else predict_camera(config)
        return config

    return call


CAMERA = [
    ("noise level", camera(True, centroid="tcog"), ConfigError, "threshold is at the noise level"),
    ("no star", camera(True, instrument__exposure_s=1e-5, throughput_fraction=0.001), DomainError,
     "the signal of every star is below the noise"),
    ("focus", camera(True, instrument__defocus_mm=5.0), DomainError, "stars are far out of focus",
     "with instrument.defocus_mm = "),
    ("window", camera(True, instrument__width_px=0, instrument__height_px=0), DomainError, "read at most"),
    ("rolling shutter", camera(slew__rate_deg_per_s=1.0, instrument__line_time_us=5.0), ConfigError, "global shutter"),
    ("life", camera(life__years=1.0, life__displacement_dose_tev_per_g=1.0), ConfigError,
     "depleted_volume_um3 is needed"),
    ("sweep name", camera(sweep=["exposre_s=0.1:0.2:3"]), ConfigError, "did you mean exposure_s"),
    ("sweep of frames", camera(sweep=["frames.readouts=3:9:3"]), ConfigError, "does not depend on frames.readouts"),
    ("sweep range", camera(sweep=["exposure_s=-1:0.2:3"]), ConfigError, "above 0"),
    ("swept twice", camera(sweep=["exposure_s=0.1:0.2:3", "instrument.exposure_s=0.1:0.3:2"]), ConfigError,
     "swept twice"),
    ("sweep size", camera(sweep=["exposure_s=0.1:0.2:100", "threshold_sigma=4:8:5"]), ConfigError, "at most 400"),
    ("sweep without prediction", camera(True, sweep=["f_number=0.9:1.1:2"]), DomainError, "no value of the sweep"),
    ("trail", camera(True, sweep=["slew.rate_deg_per_s=0.8:1.2:2"], window_px=19, centroid="cog"), DomainError,
     "centroid = cog with a window of 7 px"),
]  # fmt: skip

# --- Flight: orbits, laws, tables


def flight_plan(**tables: Any) -> Call:
    return lambda _: build_flight(FlightConfig(**tables))


def temperatures(text: str) -> Call:
    """The flight with a table of temperatures."""

    def call(folder: Path) -> Any:
        (folder / "t.csv").write_text(text)
        return flight_plan(temperature={"file": str(folder / "t.csv")})(folder)

    return call


def elements(folder: Path) -> Any:
    """Two-line elements with a wrong checksum."""
    pytest.importorskip("sgp4")
    return flight_plan(orbit={"tle": ("1 25544U" + " " * 60 + "5", "2 25544" + " " * 61 + "5")})(folder)


FLIGHT = [
    ("perigee", lambda _: load_config(FlightConfig, settings=["orbit.perigee_km=-5"]), ConfigError, "perigee_km",
     "100"),
    ("law", lambda _: load_config(FlightConfig, settings=["attitude.law=table"]), ConfigError, "attitude.file",
     "give both, or neither"),
    ("elements", elements, DomainError, "orbit.tle: two-line elements: ", "checksum"),
    ("time backwards", temperatures("time_s,mean_k\n0,1\n3000,2\n2000,1\n9000,0\n"), DomainError,
     "2000 in row 3 is not above 3000"),
    ("time gap", temperatures("time_s,mean_k\n0,1\n9000,2\n"), DomainError, "a gap of 9000 s"),
    ("time range", temperatures("time_s,mean_k\n10,1\n200,2\n"), DomainError, "runs from 10 to 200 s; the orbit lasts"),
    ("column", temperatures("time_s,mean_c\n0,1\n9000,2\n"), DomainError, "no column mean_k"),
    ("row", temperatures("time_s,mean_k\n0,1\n9000\n"), DomainError, "every row needs 2 numbers"),
    ("temperature",
     lambda _: heated(FlightConfig(), np.array([500.0, 0.0, 0.0, 0.0, 0.0])), DomainError, "temperature: "),
]  # fmt: skip

# --- Stray light: baffle, lens, table


def straylight(*settings: str) -> Call:
    """A run of the experiment."""

    def call(folder: Path) -> Any:
        with pytest.MonkeyPatch.context() as patch:
            patch.chdir(folder)
            return run_straylight(load_config(StraylightConfig, settings=list(settings)), progress=Progress())

    return call


STRAYLIGHT = [
    ("coating", straylight("baffle.coating=own", "baffle.diffuse=-0.1"), ConfigError, "diffuse", "-0.1"),
    ("shade", straylight("baffle.shade_deg=5"), DomainError, "shade_deg = 5", "outside the field"),
    ("clearance", straylight("baffle.clearance_mm=-2"), StarbenchError, "cuts the beam of the field"),
    ("mesh", straylight("baffle.mesh=none.ply"), StarbenchError, "none.ply", "no such file"),
    ("ideal lens", straylight("instrument.lens={focal_length_mm=30.0, f_number=2.0}"), StarbenchError, "surfaces"),
    ("table", straylight("pst.file=none.csv"), StarbenchError, "none.csv"),
]  # fmt: skip

# --- Statement: the folder of a flight


def flown(summary: str = "", **config: Any) -> Call:
    """The results of a flight in a folder with a summary."""

    def call(folder: Path) -> Any:
        if summary:
            (folder / "summary.json").write_text(summary.replace("CONFIG", json.dumps(config)))
        return read_flight(folder, CameraReportConfig())

    return call


STATEMENT = [
    ("no summary", flown(), ConfigError, "summary.json", "--flight takes the folder"),
    ("no JSON", flown("["), ConfigError, "not a run's summary"),
    ("another experiment", flown('{"experiment": "camera", "results": {}}'), ConfigError, "is of 'camera'"),
    ("another sensor", flown('{"experiment": "flight", "config": CONFIG}', window_px=9), ConfigError,
     "another sensor: window_px = 9 there, 13 here"),
]  # fmt: skip

# --- Twin: folders of frames


def night_folder(level: float | None = None) -> Call:
    """The frames of a folder, without stars on a background [DN], measured."""

    def call(folder: Path) -> Any:
        rng = np.random.default_rng(1)
        for number in range(2 if level else 0):
            Image.fromarray(rng.poisson(level, (256, 256)).astype(np.uint16)).save(folder / f"{number}.tiff")
        frames, _ = night_frames(folder)
        return measure_night(frames, TwinConfig(camera={"field_deg": 11.0}), Progress())

    return call


TWIN = [
    ("no folder", lambda folder: night_frames(folder / "none"), ConfigError, "none", "no such folder"),
    ("no frame", night_folder(), ConfigError, "no readable frame"),
    ("no stars", night_folder(300.0), DomainError, "no stars", "fewer than 4"),
    ("daylight", night_folder(5e4), DomainError, "daylight", "background 5e+04 DN"),
    ("order twice", lambda _: load_config(TwinConfig, settings=['orders=["radial_1", "radial_1"]']), ConfigError,
     "a camera model is named twice"),
]  # fmt: skip

FILES = {
    "list.csv": "ra_deg,dec_deg,roll_deg\n1,2,3\n",
    "words.csv": "x_px,y_px\nfar,away\n",
    "heads.csv": "files,name\n",
    "outer.csv": "files,outer\na_1.fits,3\n",
    "empty.ecsv": "",
    "chip.toml": "",
    "doublet.zmx": ZMX_DOUBLET,
}
SECTIONS = {
    "dataset": DATASETS,
    "own frames": FRAMES,
    "lens": LENSES,
    "camera": CAMERA,
    "flight": FLIGHT,
    "straylight": STRAYLIGHT,
    "statement": STATEMENT,
    "laboratory": LABORATORY,
    "twin": TWIN,
    "harness": HARNESS,
    "calibrations": CALIBRATIONS,
}


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
def test_refusals(call: Call, kind: type[Exception], words: list[str], folder: Path, engine: Any) -> None:
    with pytest.raises(kind) as error:
        call(folder)
    message = error.value.format_message() if isinstance(error.value, click.UsageError) else str(error.value)
    assert kind is ValidationError or "\n" not in message
    assert [word for word in words if word not in message] == []
