"""
The Moon behind the limb of the Earth
=====================================

From geostationary orbit the Moon sets behind the Earth among stars to G = 10. Both bodies are sunlit spheres of
measured brightness, rendered through the same lens; the Earth hides the Moon, and both hide stars.
"""

import numpy as np
from matplotlib import pyplot as plt

from optics import attitude_from_angles
from render import earth_observer, load_sky, load_star_sensor, observe
from render.bodies.solar_system import solar_system

epoch = 2026.157
moon = solar_system(epoch, bodies=["moon"]).direction[0]
aside = np.cross(moon, [0.0, 0.0, 1.0]) / np.linalg.norm(np.cross(moon, [0.0, 0.0, 1.0]))
above = earth_observer(epoch).moved(position_km=-41670.0 * moon + 7080.0 * aside, velocity_km_per_s=(0.0, 0.0, 0.0))
sky = load_sky(faintest_mag=10.0, epoch_year=epoch, observer=above)
direction = solar_system(epoch, observer=above, bodies=["moon"]).direction[0]
ra, dec = np.degrees(np.arctan2(direction[1], direction[0])), np.degrees(np.arcsin(direction[2]))
sensor = load_star_sensor("star_tracker_26mm", "cmv4000", window_px=200, defocus_mm=0.05)
observation = observe(sensor, attitude_from_angles(ra, dec), sky, exposure_s=0.2, bodies=["moon", "earth"])
light = observation.expected.electrons[:, :, 0]
figure, axes = plt.subplots(figsize=(6.4, 5.2), layout="constrained")
shown = axes.imshow(np.log10(light + 3.0), cmap="afmhot", vmax=8.5)
axes.set(xlabel="column [px]", ylabel="row [px]", title="expected electrons in 0.2 s")
figure.colorbar(shown, ax=axes, label="log10 (electrons + 3)")
