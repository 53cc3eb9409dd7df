"""
Orion in colour
===============

Gaia's stars through the 26 mm star tracker in three bands; the colour of a star comes from its temperature and from
nothing else. A band is one frame with its own noise.
"""

import numpy as np
from matplotlib import pyplot as plt
from scipy.ndimage import gaussian_filter

from optics import TopHat, attitude_from_angles
from render import SkySimulator, load_star_sensor

sensor = load_star_sensor("star_tracker_26mm", "cmv4000", window_px=1400, defocus_mm=0.05)
pointing = attitude_from_angles(ra_deg=83.6, dec_deg=0.0, roll_deg=0.0)
channels = []
for centre_nm, gain in ((620.0, 1.0), (540.0, 0.85), (460.0, 1.15)):
    band = TopHat(centre_nm=centre_nm, width_nm=70.0, edge_nm=10.0)
    simulator = SkySimulator(sensor, exposure_s=4.0, passband=band, nodes=3, seed=1)
    light = simulator.observe(pointing).frame.dn - simulator.dark_dn(frames=2)
    channels.append(gain * gaussian_filter(np.clip(light - 4.0, 0, None), 2.5))
brightness = np.max(channels, axis=0)
scale = np.arcsinh(brightness / 1.0) / (np.arcsinh(brightness.max() / 1.0) * np.maximum(brightness, 1e-9))
figure, axes = plt.subplots(figsize=(7, 7), layout="constrained")
axes.imshow(np.clip(1.4 * np.stack(channels, axis=-1) * scale[..., None], 0, 1), interpolation="antialiased")
axes.set(xlabel="column [px]", ylabel="row [px]", title="620, 540 and 460 nm as red, green and blue")
