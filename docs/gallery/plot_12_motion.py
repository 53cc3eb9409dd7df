"""
Trails with a global and a rolling shutter
==========================================

Star trails at one degree per second. With a global shutter all stars are exposed at the same time; with a rolling
shutter every star is exposed at the time of its row, and the field is sheared.
"""

import numpy as np
from matplotlib import pyplot as plt
from scipy.spatial.transform import Rotation

from optics import TopHat
from render import StarRenderer, load_star_sensor, star_light
from render.motion.trajectory import ConstantRate
from render.tracing.motion.exposure import exposure_motion

sensor = load_star_sensor("star_tracker_26mm", "cmv4000", window_px=160, defocus_mm=0.03)
light = star_light([TopHat(centre_nm=600.0, width_nm=200.0, edge_nm=10.0)], nodes=3)
x, y = (v.ravel() for v in np.meshgrid([30.0, 80.0, 130.0], [20.0, 60.0, 100.0, 140.0]))
stars = light.stars(sensor.camera.nominal_direction(x, y, sensor.focal_length_mm), 3.0, 5800.0)
turning = ConstantRate(initial=Rotation.identity(), rate_rad_per_s=np.radians([0.0, 1.0, 0.0]), end_s=1.0)
figure, panels = plt.subplots(1, 2, figsize=(9, 4.6), layout="constrained", sharey=True)
for axes, line_time_s, name in zip(panels, (0.0, 5e-4), ("global shutter", "rolling, 0.5 ms a row"), strict=True):
    motion = exposure_motion(turning, start_s=0.0, exposure_s=0.1, camera=sensor.camera, line_time_s=line_time_s)
    image = StarRenderer(sensor.camera, exposure_s=0.1).render(stars, motion=motion)
    shown = axes.imshow(np.arcsinh(image.electrons[:, :, 0] / 20.0), cmap="magma")
    axes.plot(x, y, "+", color="white", markersize=5, label="at rest")
    axes.set(xlabel="column [px]", title=name)
panels[0].set_ylabel("row [px]")
figure.colorbar(shown, ax=panels, label="arsinh of electrons / 20")
panels[0].legend(loc="lower left", facecolor="black", labelcolor="white")
