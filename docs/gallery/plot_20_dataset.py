"""
A dataset in five lines
=======================

Frames of the real sky with the truth of every star, in a folder that can be extended, checked and cited. The world
coordinates (WCS) in the FITS headers reproduce the true positions.
"""

from tempfile import TemporaryDirectory

import pyarrow.parquet as pq
from astropy.io import fits
from astropy.wcs import WCS

from calib import show_image
from experiments import run_experiment

settings = {"frames": 2, "instrument.width_px": 512, "instrument.height_px": 512}
settings |= {"calibration_frames": 0, "verify.frames": 0}
with TemporaryDirectory() as folder:
    run_experiment("dataset", settings, out=f"{folder}/sky")
    one = pq.read_table(f"{folder}/sky/index.parquet").to_pylist()[0]
    stars = pq.read_table(f"{folder}/sky/{one['truth']}").to_pandas()
    with fits.open(f"{folder}/sky/{one['file']}") as frame:
        x, y = WCS(frame[0].header).all_world2pix(stars.ra_deg, stars.dec_deg, 0)
        axes = show_image(frame[0].data.astype(float))
axes.scatter(x, y, s=60, facecolors="none", edgecolors="#59d98e", label="world coordinates of the header")
axes.plot(stars.photon_x_px, stars.photon_y_px, ".", markersize=2, color="#f4d35e", label="truth")
axes.set_title(f"{len(stars)} stars, {one['ra_deg']:.1f} deg, {one['dec_deg']:.1f} deg", fontsize=9)
axes.legend(loc="upper left", fontsize=8, facecolor="black", labelcolor="white")
