"""Frames on disk give the numbers of the same frames in memory; folders that are wrong are refused."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from astropy.io import fits
from target_frames import HEAD, readout, spots, write

from experiments.chromatic.own_frames import filter_frames as chromatic_from_frames
from experiments.chromatic.own_frames import own_frames as chromatic_own_frames
from experiments.chromatic.settings import ChromaticConfig
from experiments.laboratory.bench.points import filter_scene, nominal_px, point_scene
from experiments.laboratory.temporal_error import measure_temporal, star_target_directions
from experiments.reduce.checks import check_frames
from experiments.reduce.folder import read_folder
from experiments.reduce.frames import find_files
from experiments.reduce.frames_toml import FolderLayout
from experiments.temporal.own_frames import reduce as temporal_from_frames
from render.detector.readout import expose
from render.engine.random import Streams
from render.fits.files import write_frame
from render.sensor_file.instrument import build_instrument
from render.sensor_file.tables import InstrumentConfig

METHODS = ("cog", "gaussian")
FRAMES, DARK_FRAMES, WINDOW_PX = 6, 5, 13
PLACE = (142.9, 127.4)  # no point near the middle between two pixels, where windows would hang on the noise


@pytest.fixture(scope="module")
def camera(tmp_path_factory):
    path = tmp_path_factory.mktemp("chip") / "tiny.toml"
    path.write_text('base = "cmv4000"\nname = "tiny"\nchip_width_px = 288\nchip_height_px = 256\n')
    return build_instrument(InstrumentConfig(detector=str(path)))


@pytest.fixture(scope="module")
def scene(engine, bench_of, camera):
    bench = bench_of(
        rows=2, columns=3, methods=METHODS, frames=FRAMES, dark_frames=DARK_FRAMES, window_px=WINDOW_PX, edge_px=40.0
    )
    bench = replace(bench, target=bench.target.model_copy(update={"pitch_px": 45.1}))
    return point_scene(bench, camera)


class Writer:
    """Writes full frames of a target, and the file that describes them."""

    def __init__(self, folder, scene):
        self.folder, self.scene = folder, scene
        folder.mkdir(exist_ok=True)
        chip = scene.instrument.detector
        self.lines = [
            f"gain_dn_per_e = {chip.gain_dn_per_e!r}",
            f"offset_dn = {chip.offset_dn!r}",
            f"read_noise_e = {chip.read_noise_e!r}",
            f"pixel_arcsec = {scene.instrument.pixel_arcsec!r}",
        ]

    def image(self, direction):
        return self.scene.image(direction).electrons[:, :, 0]

    def frames(self, image, streams, band, count, name):
        config = self.scene.instrument.config
        for number in range(count):
            frame = expose(
                image,
                self.scene.instrument.detector,
                streams=streams,
                frame=number,
                exposure_s=config.exposure_s,
                temperature_c=config.chip_temperature_c,
                band=band,
            )
            write_frame(frame, self.folder / f"{name}_{number:03d}.fits")

    def series(self, image, streams, name, **keys):
        self.frames(image, streams, "lamp", self.scene.bench.frames, name)
        self.lines += ["[[series]]", f'name = "{name}"', f'files = ["{name}_*.fits"]']
        self.lines += [f"{key} = {value}" for key, value in keys.items()]

    def dark(self, shape, streams, name="dark"):
        self.frames(np.zeros(shape, np.float32), streams, "dark", self.scene.bench.dark_frames, name)

    def done(self):
        (self.folder / "frames.toml").write_text("\n".join(self.lines) + "\n")
        return self.folder


@pytest.fixture(scope="module")
def still(tmp_path_factory, scene, camera):
    """A folder of one series of six points."""
    writer, streams = Writer(tmp_path_factory.mktemp("still"), scene), Streams(4).child("level", 0)
    image = writer.image(star_target_directions(scene.bench, camera, PLACE))
    places = nominal_px(camera, star_target_directions(scene.bench, camera, PLACE)).tolist()
    writer.lines += ['dark = ["dark_*.fits"]', f"points_px = {places}"]
    writer.dark(image.shape, streams)
    writer.series(image, streams, "still", count=FRAMES)
    return writer.done()


def test_temporal_error_from_disk_is_that_in_memory(still, scene, camera):
    measured = measure_temporal(scene.bench, camera, place_px=PLACE, streams=Streams(4), scene=scene)
    series, sections = temporal_from_frames(read_folder(still, window_px=WINDOW_PX), METHODS)
    for method, pair in zip(METHODS, sections["levels"][0].measured_arcsec, strict=True):
        known = measured.temporal_error(method)
        assert [found.value for found in pair] == pytest.approx(known.arcsec, rel=1e-12)
        assert [found.uncertainty for found in pair] == pytest.approx(known.uncertainty_arcsec, rel=1e-12)
    known = measured.sigma_px["cog"][0]
    np.testing.assert_allclose(series[0].points.sigma_px("cog"), known, rtol=1e-12)


def test_rendered_frames_are_what_their_folder_says(still, camera):
    """A detector with patterns, spread of read noise, non-linearity: gain, rest and noise hold."""
    read = read_folder(still, window_px=WINDOW_PX)
    checks = check_frames(read, temporal_from_frames(read, METHODS)[0], "cog")
    gain = checks.transfer_gain
    assert gain.value == pytest.approx(camera.detector.gain_dn_per_e, abs=4 * gain.uncertainty)
    assert checks.common_motion_px < checks.motion_limit_px
    assert checks.noise_ratio.value == pytest.approx(1.0, abs=4 * checks.noise_ratio.uncertainty)
    assert (checks.copies, checks.step_dn, checks.zero_fraction) == (0, 1, 0.0)
    assert checks.top_count <= checks.top_limit


def blank(folder, name):
    """A frame with one star."""
    light = spots((64, 96), [(40, 30)], 15000.0)
    write(folder / name, readout(light, np.random.default_rng(len(name))), EXPTIME=0.1)


ONE = '[[series]]\nfiles = ["a_*.fits"]\n'


@pytest.fixture
def folder(tmp_path):
    for name in ("a_1.fits", "a_22.fits", "b_1.fits"):
        blank(tmp_path, name)
    return tmp_path


def test_a_link_to_a_frame_is_a_frame_and_files_are_in_the_order_of_their_numbers(folder):
    (folder / "frames.toml").write_text(HEAD + "points = 1\n" + ONE)
    blank(folder, "elsewhere.fits")
    (folder / "a_9.fits").symlink_to("elsewhere.fits")
    names = [one.name for one in find_files(folder, ["a_*.fits"], "a")]
    assert names == ["a_1.fits", "a_9.fits", "a_22.fits"]
    assert len(read_folder(folder, window_px=9).series[0].windows.dn) == 3


def test_frames_without_dark_ones_lose_a_background(folder):
    (folder / "frames.toml").write_text(HEAD + "points = 1\n" + ONE)
    (series,), _ = temporal_from_frames(read_folder(folder, window_px=9), ("cog", "gaussian"))
    assert series.signal_e == pytest.approx(15000.0, rel=0.02)
    np.testing.assert_allclose(series.points.mean_px("gaussian"), [[40, 30]], atol=0.02)


def test_a_target_table_may_hold_tangents(folder):
    tangent = (np.array([40.3, 29.8]) - [47.5, 31.5]) * np.radians(5.5 / 3600)
    (folder / "grid.csv").write_text(f"tan_x,tan_y\n{tangent[0]:.17g},{tangent[1]:.17g}\n")
    (folder / "frames.toml").write_text(HEAD + "target = 'grid.csv'\n" + ONE)
    np.testing.assert_allclose(read_folder(folder, window_px=9).nominal_px, [[40.3, 29.8]], atol=1e-9)


def test_series_are_ordered_by_position(folder):
    blank(folder, "b_2.fits")
    two = ONE + "position = 2\nname = 'later'\n[[series]]\nfiles = ['b_*.fits']\nname = 'first'\n"
    (folder / "frames.toml").write_text(HEAD + "points = 1\n" + two + "position = 1\n")
    assert [one.name for one in read_folder(folder, window_px=9).series] == ["first", "later"]


@pytest.mark.parametrize(("more", "reference"), [("", 0), ("reference_nm = 800", 1)])
def test_filters_in_the_order_of_their_wavelengths(folder, more, reference):
    blank(folder, "b_2.fits")
    rows = "".join(f"[[series]]\nfiles = '{n}_*.fits'\nfilter_nm = {nm}\n" for n, nm in (("b", 800), ("a", 600)))
    (folder / "frames.toml").write_text(f"{HEAD}points = 1\n{more}\n{rows}")
    read = read_folder(folder, window_px=9, layout=FolderLayout(needs=("filter_nm",), same_scene="place"))
    frames = chromatic_from_frames(read, ("cog",), ChromaticConfig())
    assert (frames.filters_nm, frames.reference) == ((600.0, 800.0), reference)


@pytest.mark.slow
def test_wedge_of_a_filter_and_exchanged_filters_are_found_in_rendered_frames(tmp_path, scene, camera, bench_of):
    """A wedge of 0.06 px at 30 degrees behind 800 nm, turned by half a turn at the second place; then files swapped."""
    writer, streams = Writer(tmp_path / "filters", scene), Streams(12)
    bench = bench_of(rows=3, columns=3, edge_px=40.0, signal_e=15000.0)
    bench = replace(bench, target=bench.target.model_copy(update={"pitch_px": 45.0 + 1 / 3}))  # S-curves average out
    light = filter_scene(bench, replace(camera, camera=replace(camera.camera, diffraction="rays")))
    wedge = 0.06 * np.array([np.cos(np.radians(30)), np.sin(np.radians(30))])
    rows = []
    for place, angle, at in (("before", 0, 0.0), ("after", 180, 0.4)):
        for band, nm in enumerate((500, 600, 800)):
            moved = np.array(PLACE) + at + (wedge if nm == 800 else 0.0) * (1 if angle == 0 else -1)
            image = light.image(star_target_directions(bench, camera, moved)).electrons[:, :, band]
            image = image * (1.0, 0.6, 0.8)[band]
            writer.frames(image, streams.child(place, band), f"F{band}", 6, f"{place}_{nm}")
            rows.append(
                f"[[series]]\nfiles = '{place}_{nm}_*.fits'\nname = '{place}{nm}'\nfilter_nm = {nm}\n"
                f"place = '{place}'\nfilter_angle_deg = {angle}\n"
            )
    writer.lines.append("points = 9\nprnu_fraction = 0.01")
    head = "\n".join(writer.lines) + "\n"
    (writer.folder / "frames.toml").write_text(head + "".join(rows))
    layout, config = FolderLayout(needs=("filter_nm",), same_scene="place"), ChromaticConfig()
    read = read_folder(writer.folder, window_px=WINDOW_PX, layout=layout)
    found = chromatic_own_frames.reduce(read, ("cog",), config)[1]
    pair = next(one for one in found["constants"] if one.wedge_px[0].value > 0.02)
    assert pair.separated_text == "yes"
    for one, value in zip(pair.wedge_px, wedge, strict=True):
        assert one.value == pytest.approx(value, abs=4 * one.uncertainty)
        assert one.uncertainty < 0.02
    assert found["exchange"].exchanged == 0
    for number in range(6):  # FILTER in the files goes with them: it would refuse the folder by itself
        low, high = (writer.folder / f"after_{nm}_{number:03d}.fits" for nm in (500, 800))
        for path in (low, high):
            with fits.open(path, mode="update") as content:
                content[0].header["FILTER"] = ""
        low.rename(writer.folder / "between.fits")
        high.rename(low)
        (writer.folder / "between.fits").rename(high)
    read = read_folder(writer.folder, window_px=WINDOW_PX, layout=layout)
    (said,) = chromatic_own_frames.reduce(read, ("cog",), config)[1]["exchange"].descriptions
    assert "the files of 500 and 800 nm at place 'after'" in said
