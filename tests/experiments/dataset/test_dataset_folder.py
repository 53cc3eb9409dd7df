"""A dataset on disk: whole or not there, taken up again, extended, refused; bytes depend on nothing but the number."""

from __future__ import annotations

import errno
import hashlib
import json
import shutil
import socket
import subprocess
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from astropy.io import fits
from astropy.table import Table
from pleiades_frames import digests, run

from experiments.dataset import folder as storage
from experiments.dataset.folder import DatasetFolder, check
from experiments.dataset.job import make_frame, prepare
from experiments.dataset.plan import plan_frame
from experiments.dataset.settings import main
from experiments.dataset.truth_files import read_record, truth_bytes
from experiments.harness.progress import Progress
from optics.errors import ConfigError


def test_everything_is_there(dataset, monkeypatch):
    names = {file.name for file in dataset.iterdir()}
    assert {"README.md", "contact_sheet.png", "dataset.json", "frames", "index.parquet", "truth"} <= names
    assert {"report.html", "summary.json", "provenance.json", "completeness.ecsv", "solver.ecsv"} <= names
    assert not [name for name in names if name.startswith(".")]
    assert sorted(digests(dataset)) == sorted(
        f"frame_00000{k}.{form}" for k in range(3) for form in ("fits", "parquet")
    )
    text = (dataset / "README.md").read_text()
    assert "ESA" in text
    assert "CC BY-SA" in text
    assert str(dataset) not in text
    monkeypatch.chdir(dataset)
    found = {}
    exec(text.partition("```python\n")[2].partition("```")[0], found)  # the card's own lines read the dataset
    assert found["dn"].shape == (128, 192)
    bright = int(np.argmax(found["stars"]["electrons"]))
    row, column = (round(found["stars"][f"photon_{axis}_px"][bright]) for axis in "yx")
    assert found["dn"][row, column] > 0.95 * found["dn"].max()  # it saturates


@pytest.mark.slow
def test_layers_are_files_that_add_up_to_the_light(tmp_path):
    """Sirius, ghosts, halos, a bright sky: layers in a file that is vouched for as the frame is, made again if gone."""
    settings = (
        "files.layers=true background.ghosts=true background.uniform_mag_per_arcsec2=18 scatter.halos=true "
        "scatter.roughness_nm=10 scatter.shoulder=5e-4 scatter.slope=-3 instrument.exposure_s=1000 "
        "instrument.lens=star_tracker_26mm calibration_frames=0 pointing.ra_deg=101.29 pointing.dec_deg=-16.72"
    )
    more = [word for setting in settings.split() for word in ("--set", setting)]
    assert run(tmp_path / "one", *more, frames=1) == 0
    with fits.open(tmp_path / "one" / "layers" / "frame_000000.fits", checksum=True) as content:
        found = {unit.name: np.array(unit.data) for unit in content[1:]}
        assert "QUAT_W" in content[0].header
    assert set(found) == {"STARS", "SCATTER", "GHOSTS", "SKY", "DARK"}
    truth = pq.read_table(tmp_path / "one" / "truth" / "frame_000000.parquet").to_pandas()
    record = read_record(tmp_path / "one" / "truth" / "frame_000000.parquet")
    assert found["STARS"].sum(dtype=float) == pytest.approx(truth["electrons"].sum(), rel=1e-4)
    assert 0.1 < found["SCATTER"].sum(dtype=float) / truth["electrons_scattered"].sum() < 1.0
    ghosts = found["GHOSTS"].sum(dtype=float)
    assert 0.0 < ghosts < 1.01 * sum(ghost.electrons for ghost in record.ghosts)
    assert {ghost.source for ghost in record.ghosts} <= {str(one) for one in truth["star_id"]}
    assert "  layers/frame_000000.fits\n" in (tmp_path / "one" / "SHA256SUMS").read_text()
    assert "`GHOSTS`" in (tmp_path / "one" / "README.md").read_text()


@pytest.mark.parametrize("compression", ["none", "gzip"])
def test_layers_of_a_frame_add_up_to_its_light(compression, job, tmp_path):
    """A file of layers that is damaged is rendered again, with the same bytes if they hold no time."""
    for name in ("frames", "truth"):
        (tmp_path / name).mkdir()
    with_layers = job(tmp_path, files={"layers": True, "compression": compression})
    record = make_frame(with_layers, 1)
    with fits.open(tmp_path / "layers" / "frame_000001.fits", checksum=True) as content:
        layers = {unit.name: np.array(unit.data) for unit in content[1:]}
    scene = prepare(with_layers).renderer.scene
    light = scene.simulator.expected(plan_frame(scene.plan, 1).attitude).electrons
    np.testing.assert_allclose(sum(image for name, image in layers.items() if name != "DARK"), light, rtol=1e-5)
    assert make_frame(with_layers, 1) == record  # it is there
    (tmp_path / "layers" / "frame_000001.fits").write_bytes(b"")
    again = make_frame(with_layers, 1)
    assert again == record if compression == "none" else again.stars == record.stars


def test_a_frame_made_alone_in_another_order_is_the_same(dataset, job, tmp_path):
    for name in ("frames", "truth"):
        (tmp_path / name).mkdir()
    for frame in (2, 0):
        make_frame(job(tmp_path), frame)
    made = digests(tmp_path)
    assert len(made) == 4
    assert made.items() <= digests(dataset).items()


@pytest.mark.slow
def test_what_cannot_fit_is_refused(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(storage.shutil, "disk_usage", lambda path: shutil._ntuple_diskusage(10, 9, 10**5))
    assert run(tmp_path / "large") == 2
    assert "0.000147 GB more, its disk has 0.0001 GB left" in capsys.readouterr().err  # 3 x 2 x 192 x 128 bytes
    assert not (tmp_path / "large").exists()
    monkeypatch.setattr(storage.shutil, "disk_usage", lambda path: shutil._ntuple_diskusage(10, 9, 10**4))
    assert run(tmp_path / "packed", "--set", "files.compression=rice") == 2
    assert "its disk has 1e-05 GB left" in capsys.readouterr().err


def test_a_run_that_made_nothing_leaves_nothing(tmp_path, capsys):
    folder = tmp_path / "none"
    assert run(folder, "--scheduler", "localhost") == 2
    assert "tcp://host:8786" in capsys.readouterr().err
    assert not folder.exists()
    other = DatasetFolder(folder, config={"seed": 1}, frames=3, truth="parquet")
    other.open({"mitsuba": "3"})
    (folder / "frames" / "frame_000007.fits").write_bytes(b"of a run that was killed before it wrote the truth")
    other.close()
    assert (folder / "dataset.json").exists()  # nothing of what lies there is taken away unasked
    with pytest.raises(ConfigError, match="seed = 1, this run has 2"):
        DatasetFolder(folder, config={"seed": 2}, frames=3, truth="parquet")
    (folder / "frames" / "frame_000007.fits").unlink()
    again = DatasetFolder(folder, config={"seed": 2}, frames=3, truth="parquet")  # no frame is of the other seed
    again.open({"mitsuba": "3"})
    assert json.loads((folder / "dataset.json").read_text())["config"] == {"seed": 2}
    again.close()
    assert not folder.exists()


def test_one_writer_at_a_time(dataset, capsys):
    identity = json.loads((dataset / "dataset.json").read_text())
    other = DatasetFolder(dataset, config=identity["config"], frames=3, truth="parquet")
    other.open(identity["software"])
    try:
        assert run(dataset) == 2
    finally:
        other.close()
    assert "another run" in capsys.readouterr().err


def test_a_full_disk_keeps_what_was_made(dataset, tmp_path, monkeypatch, capsys):
    """Every place that writes fails in turn as a full disk does; what was whole before stays, nothing else is taken."""
    folder = tmp_path / "full"
    real = storage.os.replace

    def replace(source, target):
        if str(target).endswith("frame_000001.parquet"):  # its frame is written, its truth is not
            raise OSError(errno.ENOSPC, "No space left on device")
        real(source, target)

    with monkeypatch.context() as patch:
        patch.setattr(storage.os, "replace", replace)
        assert run(folder) == 2
    error = capsys.readouterr().err
    assert "disk is full" in error
    assert "1 of 3 frames are complete and kept" in error
    assert error.count("\n") == 1
    assert not [file for file in folder.rglob(".*") if file.is_file()]
    assert not (folder / "index.parquet").exists()
    whole = {name: digest for name, digest in digests(folder).items() if name != "frame_000001.fits"}
    assert len(whole) == 2
    assert whole.items() <= digests(dataset).items()


def test_ecsv_says_the_same(dataset, tmp_path):
    parquet = dataset / "truth" / "frame_000000.parquet"
    table, record = pq.read_table(parquet), read_record(parquet)
    rows = {name: table.column(name).to_numpy() for name in table.column_names}
    path = tmp_path / "frame_000000.ecsv"
    with np.printoptions(legacy="1.13"):  # as colour-science leaves it
        path.write_bytes(truth_bytes(rows, record, "ecsv", "{}"))
    text = Table.read(path, format="ascii.ecsv")
    assert text.colnames == table.column_names
    for name, values in rows.items():
        np.testing.assert_array_equal(np.asarray(text[name]), values, err_msg=name)
    assert str(text["ra_deg"].unit) == table.schema.field("ra_deg").metadata[b"unit"].decode() == "deg"
    assert read_record(path) == record
    path.write_bytes(path.read_bytes()[:-200])  # cut off
    with pytest.raises(Exception, match="does not match"):
        read_record(path)


def test_a_port_where_something_else_listens_is_no_scheduler(monkeypatch):
    """It takes the connection and says nothing, as a busy port of another service may."""
    from experiments.dataset import workers

    monkeypatch.setattr(workers, "CONNECT_S", 0.3)
    with socket.create_server(("127.0.0.1", 0)) as listener:
        address = f"tcp://127.0.0.1:{listener.getsockname()[1]}"
        with pytest.raises(ConfigError, match=f"{address} does not answer within 0.3 s"):
            workers.make_frames(None, [0], workers=0, scheduler=address, done=lambda _: None)


def flip(path, bit):
    content = bytearray(path.read_bytes())
    content[bit // 8 % len(content)] ^= 1 << bit % 8
    path.write_bytes(content)


@pytest.mark.parametrize("form", ["parquet", "ecsv"])
def test_no_bit_of_a_truth_file_can_change(dataset, tmp_path, form):
    """The digest covers the whole file, itself included."""
    source = dataset / "truth" / "frame_000000.parquet"
    path = tmp_path / f"frame_000000.{form}"
    if form == "parquet":
        shutil.copy(source, path)
    else:
        table = pq.read_table(source)
        rows = {name: table.column(name).to_numpy() for name in table.column_names}
        path.write_bytes(truth_bytes(rows, read_record(source), "ecsv", "{}"))
    record, whole = read_record(path), path.read_bytes()
    assert record.frame == 0
    rng = np.random.default_rng(7)
    for bit in rng.integers(0, 8 * len(whole), 60):
        flip(path, int(bit))
        with pytest.raises(ConfigError):
            read_record(path)
        path.write_bytes(whole)


def test_check_names_what_is_damaged_and_what_is_made_again(dataset, tmp_path, capsys):
    folder = tmp_path / "checked"
    shutil.copytree(dataset, folder)
    assert main(["check", str(folder)]) == 0
    capsys.readouterr()
    done = subprocess.run(["sha256sum", "--check", "--quiet", "SHA256SUMS"], cwd=folder, check=False)
    assert done.returncode == 0  # others can check it too
    flip(folder / "truth" / "frame_000001.parquet", 4000)
    flip(folder / "summary.json", 400)
    (folder / "frames" / "frame_000002.fits").unlink()
    (folder / "notes.txt").write_text("mine")
    assert main(["check", str(folder)]) == 1
    said = capsys.readouterr().out.splitlines()
    assert said[:3] == [
        "damaged: summary.json",
        "damaged: truth/frame_000001.parquet",
        "missing: frames/frame_000002.fits",
    ]
    assert "does not belong to the dataset: notes.txt" in said
    assert "the same command restores: frames 1, 2; the final files of a run" in "\n".join(said)
    partial = [
        folder / name for name in ("frames/.frame_000002.fits.abc_1234", "truth/.frame_000002.parquet.1-2.partial")
    ]
    of_the_user = [folder / name for name in (".report-mine", ".frame_notes", "thesis.partial", ".hidden.partial")]
    for file in (*partial, *of_the_user):
        file.write_bytes(b"half")
    assert run(folder) == 0
    assert [file.exists() for file in (*partial, *of_the_user)] == [False, False, True, True, True, True]
    assert "damaged frames are rendered again: 1, 2" in capsys.readouterr().err
    assert main(["check", str(folder)]) == 0
    assert digests(folder) == digests(dataset)
    assert (folder / "notes.txt").read_text() == "mine"
    assert main(["check", str(tmp_path / "none")]) == 2
    (folder / "SHA256SUMS").unlink()
    assert main(["check", str(folder)]) == 1  # nothing vouches for exports and reports
    assert "missing: SHA256SUMS" in capsys.readouterr().out


@pytest.mark.parametrize(("part", "bit"), [(b"  README.md", 25), (b"  frames", 0), (b"\n", 0), (b"\n", 6), (b"", 1)])
def test_a_bit_of_the_list_costs_no_frame(dataset, tmp_path, part, bit):
    """Digits, names and line ends of SHA256SUMS: noticed, and frames vouch for themselves."""
    folder = tmp_path / "listed"
    shutil.copytree(dataset, folder)
    content = (folder / "SHA256SUMS").read_bytes()
    flip(folder / "SHA256SUMS", 8 * content.index(part) + bit)
    state = check(folder, Progress())
    assert state.damaged or state.missing
    assert state.frames == ()


def test_a_line_of_the_list_that_is_gone_or_was_added_is_told(dataset, tmp_path):
    folder = tmp_path / "listed"
    shutil.copytree(dataset, folder)
    *lines, seal = (folder / "SHA256SUMS").read_text().splitlines(keepends=True)
    (folder / "notes.txt").write_text("mine")
    added = f"{hashlib.sha256(b'mine').hexdigest()}  notes.txt\n"
    for others in (lines[1:], [*lines, added]):
        (folder / "SHA256SUMS").write_text("".join([*others, seal]))
        assert check(folder, Progress()).damaged == ("SHA256SUMS",)


@pytest.mark.slow
def test_dataset_json_is_written_anew_from_the_frames(dataset, tmp_path, capsys):
    folder = tmp_path / "renewed"
    shutil.copytree(dataset, folder)
    for damage in (lambda file: file.write_text("{"), Path.unlink):
        damage(folder / "dataset.json")
        assert main(["check", str(folder)]) == 1
        assert run(folder, "--seed", "2") == 2  # it still knows what it is
    capsys.readouterr()
    assert run(folder) == 0
    assert "dataset.json was gone and is written anew from the truth of the frames" in capsys.readouterr().err
    assert (folder / "dataset.json").read_bytes() == (dataset / "dataset.json").read_bytes()


def test_frames_without_truth_are_not_taken_by_another_dataset(dataset, tmp_path, capsys):
    folder = tmp_path / "orphans"
    shutil.copytree(dataset, folder)
    shutil.move(folder / "truth", tmp_path / "truth")
    before = {file.name: file.read_bytes() for file in (folder / "frames").iterdir()}
    assert run(folder, "--seed", "2") == 2
    assert "seed = 1, this run has 2" in capsys.readouterr().err
    (folder / "dataset.json").unlink()
    assert run(folder, "--seed", "2") == 2
    assert {file.name: file.read_bytes() for file in (folder / "frames").iterdir()} == before
