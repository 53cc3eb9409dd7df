"""Folders of frames that GalSim drew: what was put in comes out of chromatic shifts and mean centroids."""

from __future__ import annotations

import json

import numpy as np
import pytest
from astropy.io import fits
from astropy.table import Table

from experiments.__main__ import main as starbench
from experiments.reduce.folder import read_folder
from experiments.reduce.series import reduce_series

galsim = pytest.importorskip("galsim")
pytestmark = pytest.mark.reference

GAIN, OFFSET, READ = 0.4, 100.0, 8.0  # DN/e-, DN, e-
HEAD = f"gain_dn_per_e = {GAIN}\noffset_dn = {OFFSET}\nread_noise_e = {READ}\n"


class Camera:
    """A camera of GalSim's: response pattern, dark charge that differs from pixel to pixel, noise."""

    def __init__(self, width, height, seed, *, prnu=0.02):
        rng = np.random.default_rng(seed)
        self.size, self.random = (width, height), galsim.BaseDeviate(seed)
        self.response = 1.0 + prnu * rng.standard_normal((height, width))
        self.dark_e = rng.gamma(2.0, 20.0, (height, width))
        self.dead = rng.random((height, width)) < 1e-3
        self.hot = rng.random((height, width)) < 1e-3

    def light(self, places_px, flux_e, sigma_px=1.0):
        """Spots integrated over the pixels; (0, 0) is the middle of the first pixel."""
        image = galsim.ImageF(*self.size, scale=1.0, xmin=0, ymin=0)
        for x, y in np.atleast_2d(places_px):
            box = galsim.BoundsI(int(x) - 14, int(x) + 15, int(y) - 14, int(y) + 15) & image.bounds
            part = galsim.ImageF(box, scale=1.0)
            spot = galsim.Gaussian(sigma=sigma_px, flux=flux_e) + galsim.Gaussian(sigma=2 * sigma_px, flux=0.1 * flux_e)
            spot.drawImage(image=part, center=galsim.PositionD(x, y))
            image[box] += part
        return image.array.astype(float)

    def frame(self, light_e):
        """One raw frame [DN]."""
        expected = np.where(self.dead, 0.0, light_e * self.response) + self.dark_e
        image = galsim.ImageF(np.maximum(expected, 0.0).astype(np.float32))
        image.addNoise(galsim.PoissonNoise(self.random))
        image.addNoise(galsim.GaussianNoise(self.random, sigma=READ))
        image.array[self.hot] += 3000.0
        return np.rint(OFFSET + GAIN * image.array).clip(0, 65535).astype(np.uint16)

    def cube(self, path, light_e, frames, **cards):
        header = fits.Header(list(cards.items()))
        fits.PrimaryHDU(np.stack([self.frame(light_e) for _ in range(frames)]), header).writeto(path)

    def masters(self, folder, frames=40):
        """Dark frames, flats of 20000 e- and the list of bad pixels, as a laboratory takes them."""
        self.cube(folder / "dark.fits", np.zeros(self.response.shape), frames, EXPTIME=0.1)
        self.cube(folder / "flat.fits", np.full(self.response.shape, 20000.0), frames, EXPTIME=0.1)
        fits.PrimaryHDU((self.dead | self.hot).astype(np.uint8)).writeto(folder / "bad.fits")
        return 'dark = "dark.fits"\nflat = "flat.fits"\nbad_pixels = "bad.fits"\n'


def run(name, folder, out, *arguments):
    status = starbench([name, "--own-frames", str(folder), "--out", str(out), *arguments])
    content = json.loads((out / "summary.json").read_text(encoding="utf-8"))
    assert status == 0, [one for one in content["criteria"] if one["passed"] is False]
    assert "truth" not in (out / "report.html").read_text(encoding="utf-8").lower().replace("no truth", "")
    return content["results"], content["criteria"]


@pytest.mark.slow
def test_chromatic_shifts_that_galsim_put_in_come_out(tmp_path, engine):
    """Lateral colour about a centre, and a mean shift in x, behind three filters at two places; flats matter here."""
    camera, frames = Camera(170, 150, 5), 8
    text = HEAD + "pixel_arcsec = 10\npoints = 9\n" + camera.masters(tmp_path, 25)
    grid = np.stack(np.meshgrid([-24.2, 0.3, 24.6], [-23.7, 0.4, 24.1]), -1).reshape(-1, 2)
    centre, injected = np.array([84.5, 74.5]), {}
    colour = {500: (-1e-3, -0.02), 600: (0.0, 0.0), 800: (2e-3, 0.11)}
    for place, middle in {"left": (48.0, 60.0), "right": (120.0, 88.0)}.items():
        for nm, (scale, shift) in colour.items():
            at = grid + middle
            moved = at + scale * (at - centre) + [shift, 0.0]
            injected.setdefault(nm, []).append(moved)
            camera.cube(
                tmp_path / f"{place}_{nm}.fits", camera.light(moved, 20000.0), frames, EXPTIME=0.1, FILTER=f"F{nm}"
            )
            text += f'[[series]]\nfiles = "{place}_{nm}.fits"\nfilter_nm = {nm}\nplace = "{place}"\n'
    (tmp_path / "frames.toml").write_text(text)
    results, _ = run("chromatic", tmp_path, tmp_path / "out")
    points, pulls = Table.read(tmp_path / "out" / "points.ecsv"), []
    for pair, high, low in (("600-500", 600, 500), ("800-600", 800, 600)):
        here = points[points["pair"] == pair]
        place = np.column_stack([here["position_px_x"], here["position_px_y"]])
        which = np.linalg.norm(place[:, None] - np.concatenate(injected[600]), axis=2).argmin(1)
        true = (np.concatenate(injected[high]) - np.concatenate(injected[low]))[which]
        for a, axis in enumerate("xy"):
            pulls.append((here[f"shift_px_{axis}"] - true[:, a]) / here[f"shift_px_{axis}_error"])
        mean = (np.concatenate(injected[high]) - np.concatenate(injected[low])).mean(0) / 2
        for axis, value in zip("xy", mean, strict=True):
            table1, error = (results["pairs"]["table1_px"][part][pair][axis] for part in ("value", "uncertainty"))
            assert table1 == pytest.approx(value, abs=4 * error)
            assert error < 1e-3
        left = results["calibration"]["residual_px"]["value"][pair]
        assert left["as found"] > 2 * left["both"]
    assert np.mean(np.square(pulls)) == pytest.approx(1.0, abs=4 * np.sqrt(2.5 / np.size(pulls)))  # a band is shared


@pytest.mark.slow
def test_flats_and_their_noise_are_in_positions_and_covariance(tmp_path):
    """Mean centroids of six cameras lie off the truth as their covariance says, with few flats and few dark frames."""
    pulls, places = [], np.array([[24.3 + 26 * i, 24.1 + 26 * j] for j in range(3) for i in range(3)])
    for seed in range(6):
        camera, folder = Camera(104, 104, 20 + seed, prnu=0.06), tmp_path / str(seed)
        folder.mkdir()
        text = camera.masters(folder, frames=3)
        camera.cube(folder / "still.fits", camera.light(places, 40000.0), 8)
        more = f"points_px = {places.tolist()}\n[[series]]\nfiles = 'still.fits'\n"
        (folder / "frames.toml").write_text(f"{HEAD}pixel_arcsec = 10\n{text}{more}")
        read = read_folder(folder, window_px=13)
        one = reduce_series(read, read.series[0], ("gaussian",))
        apart = one.points.mean_px("gaussian") - places
        sigma = np.sqrt(np.diagonal(one.mean_covariance_px2("gaussian"), axis1=1, axis2=2))
        alone = one.predicted_px("gaussian") / np.sqrt(one.frames)
        assert (sigma > 1.2 * alone).all()
        pulls.append(apart / sigma)
    assert np.mean(np.square(pulls)) == pytest.approx(1.0, abs=4 * np.sqrt(2.0 / np.size(pulls)))
