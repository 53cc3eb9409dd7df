"""
Point-spread function by rays and by waves
==========================================

Density of the rays and diffraction image of the traced wavefront, for two fields and two colours. Both are effective
PSFs: integrated over pixels of 5.5 um, with charge diffusion. Titles: fraction of the light in the brightest pixel.
"""

import numpy as np
from matplotlib import pyplot as plt

from optics import TopHat
from render import load_star_sensor, star_light
from render.tracing.psf import epsf_tracer, render_epsf

light = star_light([TopHat(centre_nm=c, width_nm=40.0, edge_nm=8.0) for c in (500.0, 800.0)], nodes=3)
places = np.array([[0.0, 0.0, 1.0], [np.tan(np.radians(3.0)), 0.0, 1.0]])
stars = light.stars(places / np.linalg.norm(places, axis=1, keepdims=True), magnitude=6.0, temperature_k=5800.0)
figure, panels = plt.subplots(2, 4, figsize=(9.5, 5.0), layout="constrained", sharex=True, sharey=True)
for axes_row, method in zip(panels, ("rays", "waves"), strict=True):
    sensor = load_star_sensor("star_camera_206mm", "cmv4000", diffraction=method)
    psfs = render_epsf(epsf_tracer(sensor.camera), stars)
    for k, axes in enumerate(axes_row):
        psf = psfs[k % 2][k // 2]
        image = axes.imshow(np.log10(np.maximum(psf.values, 1e-6)), vmin=-5, vmax=0, extent=(-7, 7, 7, -7))
        axes.set_title(
            f"{method}, {(0, 3)[k % 2]} deg, {(500, 800)[k // 2]} nm\npeak {psf.values.max():.2f}", fontsize=9
        )
        axes.set(xlabel="x [px]", xlim=(-5, 5), ylim=(5, -5))
    axes_row[0].set_ylabel("y [px]")
bar = figure.colorbar(image, ax=panels, label="log10 of the light in a pixel centred there")
