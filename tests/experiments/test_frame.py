"""``starbench frame show``: any FITS file, with truth, catalogue, or nothing but pixels."""

from __future__ import annotations

import json
import re

import numpy as np
import pytest
from astropy.io import fits
from astropy.table import Table
from astropy.wcs import WCS

from experiments.__main__ import main
from optics.attitude import attitude_from_angles
from render.fits.wcs import lens_wcs, sky_grid
from render.sensor_file.load import load_star_sensor

STARS = np.array([[20.3, 40.6, 5e4], [70.8, 15.2, 2e4]])


def image(seed=1):
    row, column = np.indices((64, 96))
    sky = np.random.default_rng(seed).normal(100.0, 3.0, row.shape)
    for x, y, light in STARS:
        sky += light / (2 * np.pi * 1.2**2) * np.exp(-0.5 * ((column - x) ** 2 + (row - y) ** 2) / 1.2**2)
    return sky


def content(page):
    return json.loads(re.search(r'id="meta">(.*?)</script>', page.read_text(encoding="utf-8"), re.DOTALL)[1])


def test_stars_are_found_and_compared_with_a_table(tmp_path, capsys):
    fits.writeto(tmp_path / "a.fits", np.rint(image()).astype(np.uint16))
    Table({"x_px": STARS[:, 0], "y_px": STARS[:, 1], "flux": STARS[:, 2]}).write(tmp_path / "t.ecsv")
    arguments = [str(tmp_path / "a.fits"), "--out", str(tmp_path / "a.html"), "--truth", str(tmp_path / "t.ecsv")]
    assert main(["frame", "show", *arguments]) == 0
    assert "2 true stars" in capsys.readouterr().out
    layers = {layer["name"]: layer for layer in content(tmp_path / "a.html")["layers"]}
    assert layers["true stars"]["x"] == [20.3, 70.8]
    found = layers["measured stars"]
    assert np.allclose(sorted(found["x"]), [20.3, 70.8], atol=0.05)
    errors = layers["errors against true stars"]
    assert len(errors["dx"]) == 2
    assert np.abs(errors["dx"] + errors["dy"]).max() < 0.05


def test_a_frame_of_a_dataset_has_its_truth_beside_it(tmp_path):
    (tmp_path / "frames").mkdir()
    (tmp_path / "truth").mkdir()
    cards = fits.Header([("EXPTIME", 0.2), ("GAIN", 10.0 / 3.0, "[e-/DN] of the system"), ("FILTER", "", "none")])
    fits.writeto(tmp_path / "frames" / "frame_000003.fits", image().astype(np.float32), cards)
    truth = {"photon_x_px": [20.3, 5.0], "photon_y_px": [40.6, 5.0], "electrons": [5e4, 0.0], "magnitude": [4.0, 9.0]}
    Table(truth).write(tmp_path / "truth" / "frame_000003.ecsv")
    page = tmp_path / "b.html"
    assert (
        main(["frame", "show", str(tmp_path / "frames" / "frame_000003.fits"), "--out", str(page), "--no-stars"]) == 0
    )
    (layer,) = content(page)["layers"]
    assert (layer["x"], layer["label"]) == ([20.3], ["4.0"])  # what gives no light is nowhere
    assert "EXPTIME 0.2 s · GAIN 3.33333 e-/DN" in page.read_text(encoding="utf-8")


def test_catalogue_and_directions_by_the_coordinates_of_the_file(tmp_path):
    sensor = load_star_sensor("star_tracker_26mm", "cmv4000", window_px=256)
    attitude = attitude_from_angles(ra_deg=83.8, dec_deg=-1.2, roll_deg=30.0)
    header = fits.Header(list(lens_wcs(sensor.camera).header(attitude.as_matrix())))
    fits.writeto(tmp_path / "orion.fits", np.random.default_rng(2).normal(50, 2, (256, 256)), header)
    arguments = ["--out", str(tmp_path / "orion.html"), "--catalogue", "5", "--no-stars"]
    assert main(["frame", "show", str(tmp_path / "orion.fits"), *arguments]) == 0
    told = content(tmp_path / "orion.html")
    (layer,) = told["layers"]
    stars = dict(zip(layer["columns"][0]["values"], zip(layer["x"], layer["y"], strict=True), strict=True))
    x, y = stars[-26311]  # Alnilam, Hipparcos: 84.0534 deg, -1.2019 deg
    there = WCS(header).pixel_to_world(x, y)
    assert (there.ra.deg, there.dec.deg) == (pytest.approx(84.0534, abs=2e-3), pytest.approx(-1.2019, abs=2e-3))
    vectors = np.reshape(told["sky"]["vectors"], (65, 65, 3))
    assert np.allclose(vectors, sky_grid(header, (256, 256)), atol=1e-8)
    middle = WCS(header).pixel_to_world(127.5, 127.5).cartesian.xyz.value  # node 32 of 65 is the middle of the frame
    assert np.allclose(vectors[32, 32], middle, atol=1e-8)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["absent.fits"], "no such file"),
        (["a.fits", "--catalogue", "6"], "no world coordinates"),
        (["a.fits", "--truth", "a.fits"], "no table that can be read"),
        (["a.fits", "--truth", "t.csv"], "columns x_px and y_px are needed"),
        (["a.fits", "--out", "nowhere/a.html"], "does not exist"),
        (["a.fits", "--hdu", "7"], "no extension 7"),
        (["cube.fits"], "plane"),
    ],
)
def test_bad_input_is_a_line(tmp_path, monkeypatch, capsys, arguments, said):
    monkeypatch.chdir(tmp_path)
    fits.writeto(tmp_path / "a.fits", image())
    fits.writeto(tmp_path / "cube.fits", np.ones((3, 8, 8)))
    (tmp_path / "t.csv").write_text("a,b\n1,2\n")
    assert main(["frame", "show", *arguments]) == 2
    error = capsys.readouterr().err
    assert said in error
    assert error.count("\n") == 1
    assert not list(tmp_path.glob("*.html"))
