"""
Cramer-Rao bound over the detector
==================================

The bound of a centroid follows from PSF and noise alone. It is smallest where the image is sharpest; a decentred
element tilts the map.
"""

import numpy as np
from matplotlib import pyplot as plt

from calib.measure.centroid_error.prediction import predict_centroids
from calib.records import NoiseModel
from optics import TopHat, decentre, load_lens
from render import load_star_sensor, star_light
from render.tracing.psf import epsf_tracer, render_epsf

light = star_light([TopHat(centre_nm=650.0, width_nm=300.0, edge_nm=20.0)], nodes=4)
centred = load_lens("star_camera_206mm")
lenses = {"centred": centred, "L2 moved by 0.2 mm": decentre(centred, "L2", x_mm=0.2)}
figure, panels = plt.subplots(1, 2, figsize=(9, 4), layout="constrained")
for axes, (name, lens) in zip(panels, lenses.items(), strict=True):
    sensor = load_star_sensor(lens, "cmv4000", defocus_mm=0.03)
    place = np.linspace(50.0, 1997.0, 7)
    x, y = (v.ravel() for v in np.meshgrid(place, place))
    stars = light.stars(sensor.camera.nominal_direction(x, y, sensor.focal_length_mm), 6.0, 5800.0)
    psfs = tuple(psf[0] for psf in render_epsf(epsf_tracer(sensor.camera), stars, oversampling=4))
    errors = predict_centroids("epsf", psfs, [5000.0], noise=NoiseModel(read_noise_e=13.0))
    bound = sensor.pixel_arcsec * errors.bound_px[:, 0].reshape(7, 7)
    print(f"{name}: {bound.min():.3f} to {bound.max():.3f} arcsec")
    mesh = axes.pcolormesh(place, place, bound, vmin=0.07, vmax=0.085)
    axes.set(xlabel="column [px]", ylabel="row [px]", aspect="equal", title=name)
    axes.invert_yaxis()
figure.colorbar(mesh, ax=panels, label="bound for 5000 electrons, one axis [arcsec]")
