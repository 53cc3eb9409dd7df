"""
Frames of your laboratory
=========================

The experiment ``temporal`` checks and reduces FITS files that ``frames.toml`` describes. Here the frames are rendered;
the reduction receives the files only.
"""

from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from calib import find_stars, mark_stars, show_image
from experiments import run_experiment
from optics import TopHat
from render import StarRenderer, Streams, expose, load_star_sensor, read_frame, star_light, write_frame

sensor = load_star_sensor("star_camera_206mm", "cmv4000", window_px=256, defocus_mm=0.05)
light = star_light([TopHat(centre_nm=650.0, width_nm=200.0, edge_nm=10.0)], nodes=4)
x, y = (v.ravel() for v in np.meshgrid([60.3, 128.1, 200.8], [55.7, 127.4, 190.2]))
grid = light.stars(sensor.camera.nominal_direction(x, y, sensor.focal_length_mm), 5.5, 3000.0)
still = StarRenderer(sensor.camera, exposure_s=0.1).render(grid)
with TemporaryDirectory() as folder:
    for name, image, count in (("still", still, 12), ("dark", still.electrons[:, :, 0] * 0, 12)):
        for k in range(count):
            frame = expose(image, sensor.detector, streams=Streams(8).child(name), frame=k, exposure_s=0.1, band=None)
            write_frame(frame, f"{folder}/{name}_{k:02d}.fits")
    text = (
        'gain_dn_per_e = 0.3\noffset_dn = 40\nread_noise_e = 13\npixel_arcsec = 5.5\ndark = "dark_*.fits"\npoints = 9\n'
    )
    Path(folder, "frames.toml").write_text(text + '[[series]]\nfiles = "still_*.fits"\n')
    first = read_frame(f"{folder}/still_00.fits")
    axes = mark_stars(show_image(first), find_stars(first, "gaussian", threshold_sigma=12, size_px=9))
    reduced = run_experiment("temporal", {"own_frames": folder})
for criterion in reduced.criteria:
    print({True: "holds", False: "FAILS", None: "not judged"}[criterion.passed], criterion.name)
reduced.table("temporal_error").pprint(max_width=-1)
