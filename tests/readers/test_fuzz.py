"""Damaged and hostile files: whatever is done to one, its reader returns what can be, or says in a line what is wrong.

Files that every reader takes are mutated by seeded random numbers: bits, bytes, numbers replaced by nasty ones, parts
cut out, doubled or put in, the end cut off. Allowed is a value that is physical, or a `StarbenchError` of one line; not
a traceback, not a second, not a gigabyte.
"""

import gzip
import re
import resource
import shutil
import signal
import time
import warnings
from pathlib import Path

import numpy as np
import pytest
from astropy import units as u
from astropy.io import fits
from astropy.table import Table
from refusals import refuses

from calib.measure.images.sensor_image import read_image
from experiments.dataset.plan import read_attitudes, read_motion
from experiments.dataset.settings import DatasetConfig
from experiments.dataset.truth import COLUMNS, FrameRecord
from experiments.dataset.truth_files import index_bytes, read_record, read_table, truth_bytes
from experiments.harness.config import load_config
from experiments.reduce import frames_toml as own_frames
from optics import LensFile, StarbenchError, load_lens, read_lens_file
from optics.export.write import write_lens
from optics.glass.agf import read_agf
from optics.glass.index_database import read_material
from optics.lens.prescription import lens_from_table
from optics.light.band_file import load_band
from render import Frame, load_detector, read_catalog
from render.fits.files import read_frame, read_frames, write_frame

ROOT = Path(__file__).parents[2]
INPUTS = 3000
LONGEST_S = 1.0
MOST_BYTES = 600e6
NASTY = b"-1 0 1 -0.0 1e309 nan inf 2147483648 9223372036854775808 -32768 99999 1e-300 '' T F [] {} ../../x".split()


MATERIAL = """DATA:
  - type: formula 2
    wavelength_range: 0.3 2.5
    coefficients: 0 1.03961212 0.00600069867 0.231792344 0.0200179144 1.01046945 103.560653
  - type: tabulated k
    data: |
        0.300 2.8607E-06
        0.310 1.3679E-06
        0.320 6.6608E-07
SPECS:
    nd: 1.5168
    Vd: 64.17
"""


GLASSES = """CC A catalogue of one glass
NM N-BK7 2 517642.251 1.5168 64.17 0 1
ED 7.1 8.3 2.51 -0.0009 0
CD 1.03961212E+00 6.00069867E-03 2.31792344E-01 2.00179144E-02 1.01046945E+00 1.03560653E+02
TD 1.86E-06 1.31E-08 -1.37E-11 4.34E-07 6.27E-10 1.70E-01 2.0E+01
LD 3.1E-01 2.5
IT 3.1E-01 0.574 25.0
IT 5.0E-01 0.998 25.0
"""


def frame(side=9):
    rng = np.random.default_rng(1)
    dn = rng.integers(0, 4096, (side, side + 2))
    flags = rng.random(dn.shape) < 0.2
    given = {"gain_dn_per_e": 0.3, "offset_dn": 40.0, "read_noise_e": 13.0, "exposure_s": 0.1, "band": "b", "index": 3}
    return Frame(dn=dn, saturated=flags, defect=~flags, **given)


def stars():
    rng = np.random.default_rng(2)
    count = 30
    return Table(
        {
            "id": np.arange(count),
            "ra": rng.uniform(0, 360, count) * u.deg,
            "dec": rng.uniform(-80, 80, count) * u.deg,
            "magnitude": rng.uniform(1, 6, count) * u.mag,
            "radial_velocity": rng.normal(0, 20, count) * u.km / u.s,
            "b_v": rng.uniform(0, 1, count) * u.mag,
            "pm_ra": rng.normal(0, 5, count) * u.mas / u.yr,
            "pm_dec": rng.normal(0, 5, count) * u.mas / u.yr,
        }
    )


def attitudes():
    rng = np.random.default_rng(3)
    turn = rng.standard_normal((12, 4))
    turn /= np.linalg.norm(turn, axis=1, keepdims=True)
    return Table({"time_s": np.arange(12.0), **{f"quat_{axis}": turn[:, k] for k, axis in enumerate("xyzw")}})


def truth(form):
    rng = np.random.default_rng(4)
    numbers = {"frame": 0, "stars": 8, "saturated": 0, "saturated_px": 0, "frame_bytes": 2880, "epoch_year": 2016.0}
    numbers |= {"ra_deg": 1.0, "dec_deg": 2.0, "roll_deg": 3.0, "exposure_s": 0.1, "background_e": 0.1}
    text = {"split": "train", "file": "frames/frame_000000.fits", "truth": f"truth/frame_000000.{form}"}
    turn = {"quat_xyzw": (0.0, 0.0, 0.0, 1.0), "rate_deg_per_s": (0.0, 0.0, 0.0)}
    record = FrameRecord(**numbers, **text, **turn, sha256="ab" * 32)
    kinds = {"float64": lambda: rng.random(8), "str": lambda: "band"}
    rows = {c.name: kinds.get(c.type, lambda: rng.integers(0, 9, 8))() for c in COLUMNS}
    return truth_bytes(rows, record, form, "{}"), index_bytes([record], form, {text["truth"]: "cd" * 32})


def folded():
    """A lens of several kinds of surface with a mirror in a bent axis."""
    moving = {"kind": "coordinate_break", "tilt_deg": [45.0, 0.0], "axes": "moving"}
    surfaces = [
        {"kind": "plane", "thickness_mm": 5.0, "medium": "air", "stop": True, "semi_diameter_mm": 6.0},
        {"kind": "conic", "radius_mm": 50.0, "conic": -0.5, "thickness_mm": 5.0, "medium": "N-BK7"},
        {"kind": "even_asphere", "radius_mm": -80.0, "asphere": [1e-6, 1e-9], "thickness_mm": 30.0, "medium": "air"},
        moving,
        {"kind": "plane", "thickness_mm": 0.0, "medium": "mirror", "semi_diameter_mm": 12.0},
        {**moving, "thickness_mm": -40.0},
    ]
    table = {"name": "seed", "source": "made up", "design_wavelength_nm": 587.6, "max_field_deg": 3.0}
    table["surface"] = surfaces
    return LensFile(lens=lens_from_table(table, where="seed"), tables=table)


def seeds(folder):
    """Name of a file -> its readers; every reader takes its file as it is."""
    made = {}

    def add(name, *readers):
        made[folder / name] = readers

    one = frame()
    for name, options in {
        "a.fits": {},
        "rice.fits": {"compression": "rice"},
        "gz.fits": {"compression": "gzip"},
    }.items():
        write_frame(one, folder / name, **options)
        add(name, frame_of, image_of, frames_of)
    (folder / "packed.fits.gz").write_bytes(gzip.compress((folder / "a.fits").read_bytes(), mtime=0))
    add("packed.fits.gz", frame_of, image_of)
    for name, form in {"s.fits": "fits", "s.vot": "votable", "s.ecsv": "ascii.ecsv", "s.csv": "ascii.csv"}.items():
        stars().write(folder / name, format=form)
        add(name, catalogue_of)
    for name, form in {"q.ecsv": "ascii.ecsv", "q.csv": "ascii.csv"}.items():
        attitudes().write(folder / name, format=form)
        add(name, attitudes_of, motion_of, own_frames.read_table)
    for form in ("parquet", "ecsv"):
        for name, content in zip(("truth", "index"), truth(form), strict=True):
            (folder / f"{name}.{form}").write_bytes(content)
            add(f"{name}.{form}", *((read_record, read_table) if name == "truth" else (read_table,)))
    shutil.copy(ROOT / "optics/data/lenses/star_tracker_26mm.toml", folder / "lens.toml")
    add("lens.toml", load_lens)
    for name in ("lens.zmx", "lens.seq"):
        write_lens(folded(), folder / name)
        add(name, read_lens_file)
    (folder / "glass.agf").write_text(GLASSES)
    add("glass.agf", glasses_of)
    (folder / "glass.yml").write_text(MATERIAL)
    add("glass.yml", read_material)
    shutil.copy(ROOT / "render/data/detectors/cmv4000.toml", folder / "detector.toml")
    add("detector.toml", load_detector)
    (folder / "run.toml").write_text(
        'frames = 3\n[instrument]\nexposure_s = 0.2\n[pointing]\nkind = "cone"\nra_deg = 3.0\n'
    )
    add("run.toml", settings_of)
    (folder / "band.csv").write_text(
        "wavelength_nm,transmission\n" + "".join(f"{w},0.{w % 9}\n" for w in range(400, 460))
    )
    add("band.csv", load_band)
    return made


def glasses_of(path):
    catalogue = read_agf(path)
    for name in catalogue.names:
        catalogue.glass(name)


def frame_of(path):
    check_frame(read_frame(path))


def frames_of(path):
    for one in read_frames(path, gain_dn_per_e=0.3, offset_dn=40.0, read_noise_e=13.0):
        check_frame(one)


def check_frame(one):
    assert one.dn.size
    assert 0.0 < one.gain_dn_per_e < np.inf
    assert 0.0 <= one.offset_dn <= 65535.0
    assert 0.0 <= one.read_noise_e < np.inf
    assert not one.exposure_s < 0.0


def image_of(path):
    image = read_image(path)
    assert 0.0 < image.noise.gain_dn_per_e < np.inf
    assert 0.0 <= image.noise.read_noise_e < np.inf


def catalogue_of(path):
    held = read_catalog(path, "plain", epoch_year=2016.0, magnitude_system="V")
    assert not (np.abs(held.radial_velocity_km_per_s) > 299_792.458).any()  # NaN is none
    assert not (np.abs(held.b_v_mag) > 15.0).any()
    assert not (np.abs(held.magnitude + 0.0) > 40.0).any()
    assert not (held.magnitude < -28.0).any()
    np.testing.assert_allclose(np.linalg.norm(held.direction, axis=1), 1.0, atol=1e-9)


def attitudes_of(path):
    assert np.isfinite(read_attitudes(str(path)).as_quat()).all()


def motion_of(path):
    times, turns = read_motion(str(path))
    assert (np.diff(times) > 0).all()
    assert len(turns) == len(times)


def settings_of(path):
    held = load_config(DatasetConfig, file=path)
    assert held.frames >= 1
    assert held.instrument.exposure_s > 0


def mutated(content, rng):
    """The content with one to four faults."""
    held = bytearray(content)
    for _ in range(rng.integers(1, 5)):
        at = int(rng.integers(0, max(len(held), 1)))
        if rng.random() < 0.5:
            at = min(at, int(rng.integers(0, 3000)))  # headers are where it hurts
        length = int(2 ** rng.uniform(0, 12))
        kind = rng.integers(0, 8)
        if not held:
            return b""
        if kind == 0:
            held[at % len(held)] ^= 1 << int(rng.integers(0, 8))
        elif kind == 1:
            held[at % len(held)] = int(rng.integers(0, 256))
        elif kind == 2:
            del held[at:]
        elif kind == 3:
            del held[at : at + length]
        elif kind == 4:
            held[at:at] = held[at : at + length]
        elif kind == 5:
            held[at:at] = rng.bytes(length)
        else:
            numbers = list(re.finditer(rb"[-+]?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?", bytes(held[: 1 << 15])))
            if numbers:
                start, end = numbers[int(rng.integers(0, len(numbers)))].span()
                nasty = NASTY[int(rng.integers(0, len(NASTY)))]
                pad = b" " * max(0, end - start - len(nasty))
                taken = (
                    end if kind == 6 else min(len(held), start + len(nasty) + len(pad))
                )  # or over what follows: FITS
                held[start:taken] = pad + nasty
    return bytes(held)


def outcome(reader, path):
    """What a reader makes of a file: "", what it says, or why that is not allowed."""
    begun = time.process_time()
    try:
        reader(path)
    except StarbenchError as error:
        lines = str(error).strip().split("\n")
        if path.suffix not in (".toml", ".zmx", ".seq") and len(lines) > 1:  # these have a line for every fault
            return f"more than a line: {error}"
        named = str(path.with_suffix(""))  # or a catalogue of this name beside it
        if path.suffix in (".zmx", ".seq") and not all(len(line) < 600 and named in line for line in lines):
            return f"no short lines with the name of the file: {error}"
    except Exception as error:
        return f"{type(error).__name__}: {error}"
    took = time.process_time() - begun
    return f"took {took:.1f} s" if took > LONGEST_S else ""


@pytest.fixture
def bounded():
    """No test of this file hangs for ever."""

    def stop(number, where):
        raise TimeoutError("more than 5 s")

    before = signal.signal(signal.SIGALRM, stop)
    yield lambda: signal.alarm(5)
    signal.alarm(0)
    signal.signal(signal.SIGALRM, before)


def one_quick_line(reader, path, seconds=LONGEST_S, most_bytes=MOST_BYTES):
    """What a reader says of a file that it refuses, without much time or memory."""
    before, begun = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss, time.process_time()
    said = refuses(StarbenchError, ".", reader, path)
    assert "\n" not in said
    assert time.process_time() - begun < seconds
    assert 1024 * (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) < most_bytes
    return said


@pytest.mark.slow
def test_damaged_files(tmp_path, bounded):
    rng = np.random.default_rng(20)
    made = seeds(tmp_path)
    for path, readers in made.items():
        for reader in readers:
            reader(path)  # as it is
    content = {path: path.read_bytes() for path in made}
    bad, names = [], list(made)
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    for k in range(INPUTS):
        source = names[k % len(names)]
        damaged = source.with_name("damaged" + "".join(source.suffixes))
        damaged.write_bytes(mutated(content[source], rng))
        reader = made[source][k // len(names) % len(made[source])]
        bounded()
        with warnings.catch_warnings():
            warnings.simplefilter("error")  # nor may a warning come out
            said = outcome(reader, damaged)
        if said:
            bad.append(f"{k} {source.name} {reader.__name__}: {said[:300]}")
    assert not bad, f"{len(bad)} of {INPUTS}:\n" + "\n".join(bad[:40])
    assert 1024 * (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - memory) < MOST_BYTES


HOSTILE = {
    "NAXIS": 2147483648,
    "NAXIS1": 0,
    "NAXIS2": 99999999999,
    "BITPIX": 7,
    "GCOUNT": -1,
    "PCOUNT": 1 << 40,
    "TFIELDS": 2147483648,
}


@pytest.mark.parametrize("card", HOSTILE)
def test_headers_that_ask_for_too_much(tmp_path, bounded, card):
    """What took a minute or gigabytes: within a second, before anything is allocated."""
    path = tmp_path / "a.fits"
    if card == "TFIELDS":
        stars().write(path, format="fits")
    else:
        write_frame(frame(), path)
    content = path.read_bytes()
    text = f"{card:8}= {HOSTILE[card]:>20}".ljust(80).encode()
    at = next((at for at in range(0, len(content), 80) if content[at : at + 8] == text[:8]), None)
    at = content.index(b"BZERO") if at is None else at
    path.write_bytes(content[:at] + text + content[at + 80 :])
    bounded()
    for reader in (catalogue_of,) if card == "TFIELDS" else (frame_of, image_of):
        assert str(path) in one_quick_line(reader, path)


@pytest.mark.slow
def test_bombs(tmp_path, bounded):
    """Gzip that unpacks to gigabytes, an image of terabytes from nothing, brackets without end."""
    size = 1 << 30
    bomb = tmp_path / "bomb.fits.gz"
    header = fits.Header([("SIMPLE", True), ("BITPIX", 8), ("NAXIS", 2), ("NAXIS1", 1 << 15), ("NAXIS2", size >> 15)])
    start = header.tostring().encode()
    with bomb.open("wb") as stream:
        stream.write(gzip.compress(start, mtime=0))
        part = gzip.compress(bytes(1 << 24), mtime=0)  # members of a gzip file follow each other
        for _ in range(size >> 24):
            stream.write(part)
    tiles = tmp_path / "tiles.fits"
    write_frame(frame(), tiles, compression="rice")
    content = tiles.read_bytes()
    at = content.index(b"ZNAXIS2 ")
    tiles.write_bytes(content[:at] + f"ZNAXIS2 = {10**12:>20}".ljust(80).encode() + content[at + 80 :])
    deep = tmp_path / "deep.toml"
    deep.write_text("a = " + "[" * 100_000)
    bounded()
    for reader, path in ((frame_of, bomb), (image_of, tiles), (load_lens, deep), (load_detector, deep)):
        unpacking_s = 5.0 if path == bomb else 0.0  # the 268 MB that may be unpacked: 0.6 to 1.8 s with the processor
        one_quick_line(reader, path, LONGEST_S + unpacking_s, 1.2 * 2**30)


@pytest.mark.parametrize("members", [pytest.param(1, marks=pytest.mark.slow), 2])
def test_a_bomb_within_a_tile(tmp_path, members):
    """Rationale: the header of the image is honest, one tile of it is not. Expected: a line, before it is unpacked."""
    table = fits.CompImageHDU(np.zeros((64, 64), np.int16), compression_type="GZIP_1", tile_shape=(64, 64))
    fits.HDUList([fits.PrimaryHDU(), table]).writeto(tmp_path / "honest.fits")
    image_of(tmp_path / "honest.fits")
    with fits.open(tmp_path / "honest.fits", disable_image_compression=True) as content:
        cards = [(card, content[1].header[card]) for card in content[1].header if card.startswith("Z")]
    bomb = gzip.compress(b"", mtime=0) * (members - 1) + gzip.compress(bytes(1 << 27), mtime=0)
    tile = fits.Column(
        name="COMPRESSED_DATA", format="1PB()", array=np.array([np.frombuffer(bomb, np.uint8), 0], object)[:1]
    )
    made = fits.BinTableHDU.from_columns([tile])
    made.header.update(dict(cards))
    fits.HDUList([fits.PrimaryHDU(), made]).writeto(tmp_path / "bomb.fits")
    said = one_quick_line(image_of, tmp_path / "bomb.fits", most_bytes=2**26)
    assert "unpacks to more than its 4096 pixels" in said


def test_a_votable_whose_data_are_elsewhere(tmp_path):
    path = tmp_path / "remote.vot"
    stars().write(path, format="votable")
    text = path.read_text()
    elsewhere = '<BINARY><STREAM href="file:///etc/passwd" encoding="base64"/></BINARY>'
    path.write_text(re.sub(r"<TABLEDATA>.*</TABLEDATA>", elsewhere, text, flags=re.S))
    refuses(StarbenchError, "data are in another file", catalogue_of, path)
    path.write_text(text.replace("<VOTABLE", '<!DOCTYPE a [<!ENTITY b "c">]>\n<VOTABLE', 1))
    refuses(StarbenchError, "entities", catalogue_of, path)


@pytest.mark.parametrize(("card", "value"), [("RDNOISE", -3.0), ("OFFSET", -40.0), ("EXPTIME", -1.0), ("GAIN", -2.0)])
def test_numbers_that_cannot_be(tmp_path, card, value):
    path = write_frame(frame(), tmp_path / "a.fits")
    fits.setval(path, card, value=value)
    refuses(StarbenchError, f"{card} = {value:g}", read_frame, path)
