"""
S-curves of centroiders
=======================

Error of each centroider (centroid minus centroid of all light) for noiseless stars at different places in a pixel. On
stars this sharp the windowed centroid is biased most, towards the pixel's centre, and the Gaussian fit least.
"""

import numpy as np
from matplotlib import pyplot as plt

from calib import find_stars, sensor_image
from optics import TopHat
from render import StarRenderer, load_star_sensor, star_light

sensor = load_star_sensor("star_camera_206mm", "cmv4000", window_px=160)
light = star_light([TopHat(centre_nm=650.0, width_nm=200.0, edge_nm=10.0)], nodes=8)
across, down = np.tile(np.arange(5), 5), np.repeat(np.arange(5), 5)
column, row = 20.0 + 30.0 * across + np.linspace(-0.6, 0.6, 25), 20.0 + 30.0 * down
direction = sensor.camera.nominal_direction(column, row, sensor.focal_length_mm)
expected = StarRenderer(sensor.camera, exposure_s=1.0).render(light.stars(direction, 8.0, 5800.0))
image = sensor_image(expected.electrons[:, :, 0], gain_dn_per_e=1.0, offset_dn=0.0, read_noise_e=13.0)
true_x, true_y = expected.truth.photon_x_px[:, 0], expected.truth.photon_y_px[:, 0]
figure, axes = plt.subplots(figsize=(7, 4), layout="constrained")
for name in ("cog", "windowed", "gaussian"):
    table = find_stars(image, name, size_px=9)
    nearest = np.hypot(table.x_px - true_x[:, None], table.y_px - true_y[:, None]).argmin(axis=1)
    axes.plot((true_x + 0.5) % 1 - 0.5, table.x_px[nearest] - true_x, "o", markersize=4, label=name)
axes.set(xlabel="place of the star in its pixel [px]", ylabel="error in x [px]")
axes.legend()
axes.grid(color="0.9")
