"""``--own-frames FOLDER`` of temporal, hsfe and distortion: reports of frames from elsewhere, bad folders in a line."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from target_frames import HEAD, readout, spots, write

from experiments.__main__ import main as starbench
from experiments.reduce.command import METHODS
from experiments.reduce.command import main as reduce_command

ROOT = Path(__file__).parents[3]
PLACES = [(30.0 + 25.3 * i, 30.0 + 25.2 * j) for j in range(4) for i in range(4)]


def frame(path, rng, shift_px=0.0, places=PLACES):
    """A plain FITS file as any camera program writes it."""
    write(path, readout(spots((140, 140), np.add(places, [shift_px, 0.0]), 6000.0), rng))


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    path, rng = tmp_path_factory.mktemp("frames"), np.random.default_rng(5)
    for series in "abc":
        for number in range(4):
            frame(path / f"{series}{number}.fits", rng, shift_px=0.2 * "abc".index(series))
    return path


def run(name, folder, text, capsys, *arguments, out):
    (folder / "frames.toml").write_text(HEAD + text)
    status = starbench([name, "--own-frames", str(folder), "--out", str(out), *arguments])
    return status, capsys.readouterr().err.strip()


def series(letter, extra=""):
    return f"[[series]]\nfiles = ['{letter}*.fits']\n{extra}\n"


def reported(out):
    """Results of a report on the folder's frames."""
    results = json.loads((out / "summary.json").read_text(encoding="utf-8"))["results"]
    assert [results["folder"][field]["value"] for field in ("source", "points")] == ["frames", 16]
    assert (out / "report.html").stat().st_size > 20_000
    assert list(out.glob("*.ecsv"))
    return results


def test_one_command_for_all_methods(folder, capsys, tmp_path, engine):
    (folder / "frames.toml").write_text(HEAD + "points = 16\n" + series("a"))
    words = ["--frames", str(folder), "--out", str(tmp_path)]
    assert reduce_command(["--method", "temporal", *words, "--force"]) == 0
    reported(tmp_path)
    assert set(METHODS) == {path.parent.name for path in ROOT.glob("experiments/*/own_frames.py")}


def test_steps_of_a_folder_become_a_report(folder, capsys, tmp_path, engine):
    """48 differences of means of 4 x 16 centroids of some 0.05 px."""
    text = "points = 16\n" + "".join(series(s, f"shift_px = [{0.2 * n}, 0.0]") for n, s in enumerate("abc"))
    status, said = run("hsfe", folder, text, capsys, out=tmp_path / "out")
    assert status == 0, said
    shifts = [shift["x"] for shift in reported(tmp_path / "out")["positions"]["measured_px"]["value"]]
    np.testing.assert_allclose(shifts, [0.0, 0.2, 0.4], atol=0.05)


def test_a_known_polynomial_is_found_and_removed(capsys, tmp_path, engine):
    """Points of a target are displaced by a polynomial of order 2: found is its own scatter, left is noise.

    The second session is calibrated by the first.
    """
    folder, rng, frames = tmp_path / "grid", np.random.default_rng(8), 6
    folder.mkdir()
    u, v = (np.array(PLACES).T - 69.5) / 70.0
    moved = np.column_stack([0.8 * u**2 + 0.5 * u * v, 0.6 * v**2 - 0.7 * u])
    for name in (f"{session}{number}.fits" for session in "ab" for number in range(frames)):
        frame(folder / name, rng, places=np.array(PLACES) + moved)
    text = f"points_px = {[list(p) for p in PLACES]}\n" + series("a", "session = 'earlier'") + series("b")
    status, said = run("distortion", folder, text, capsys, "--set", "order=2", out=tmp_path / "out")
    assert status == 0, said
    grid = reported(tmp_path / "out")["grid"]
    assert set(grid["sigma_d_arcsec"]["value"]["cog"]) == {"nominal", "aligned", "calibrated"}
    sigma = {name: grid[f"sigma_{name}_arcsec"]["value"]["gaussian"]["nominal"] for name in ("d", "c1", "dd")}
    noise = 3.0 * 5.5 * 0.025 / np.sqrt(frames)  # some 0.02 px a frame, and the fit's own error within a pixel
    for axis, injected in zip("xy", 3.0 * 5.5 * moved.std(axis=0, ddof=1), strict=True):
        for name in ("d", "c1"):
            assert sigma[name][axis] == pytest.approx(injected, abs=4.0 * noise / np.sqrt(len(PLACES)))
        assert sigma["dd"][axis] < 2.0 * noise
