"""
Orion in colour
===============

Gaia's stars through the 26 mm star tracker in three bands; colours follow from the stars' temperatures alone. Each band
is a long exposure, replaced by a short exposure where it saturates. Rays suffice, because the image is defocused and
smoothed.
"""

import numpy as np
from matplotlib import pyplot as plt
from scipy.ndimage import gaussian_filter

from optics import TopHat, attitude_from_angles
from render import SkySimulator, load_star_sensor

sensor = load_star_sensor("star_tracker_26mm", "cmv4000", window_px=1400, defocus_mm=0.05, diffraction="rays")
pointing = attitude_from_angles(ra_deg=83.6, dec_deg=0.0, roll_deg=0.0)
channels = []
for centre_nm, gain in ((620.0, 1.0), (540.0, 0.85), (460.0, 1.15)):
    band, dn = TopHat(centre_nm=centre_nm, width_nm=70.0, edge_nm=10.0), []
    for exposure_s in (4.0, 0.1):
        simulator = SkySimulator(sensor, exposure_s=exposure_s, passband=band, nodes=3, seed=1)
        dn.append(simulator.observe(pointing).frame.dn - simulator.dark_dn(frames=4))
    light = np.where(dn[0] > 2000.0, 40.0 * dn[1], dn[0])
    channels.append(gain * np.clip(gaussian_filter(light, 2.5) - 1.6, 0, None))
brightness = np.max(channels, axis=0)
scale = np.arcsinh(brightness / 1.0) / (np.arcsinh(brightness.max() / 1.0) * np.maximum(brightness, 1e-9))
figure, axes = plt.subplots(figsize=(7, 7), layout="constrained")
axes.imshow(np.clip(1.4 * np.stack(channels, axis=-1) * scale[..., None], 0, 1), interpolation="antialiased")
axes.set(xlabel="column [px]", ylabel="row [px]", title="620, 540 and 460 nm as red, green and blue")
