"""
A camera on a turntable
=======================

A collimated star and a two-axis table calibrate a camera: a grid of poses moves the star over the detector. The
residuals are noise. The star's direction is determined much less accurately than the line of sight, on which its
error has no effect.
"""

import numpy as np
from matplotlib import pyplot as plt
from scipy.spatial.transform import Rotation

from calib import BrownConrady, Observations, SensorGeometry, TurntableAttitudes, calibrate, star_direction

rng = np.random.default_rng(2)
chip = SensorGeometry(width_px=1024, height_px=1024, pixel_pitch_mm=0.02)
camera = BrownConrady.create(chip, focal_length_mm=40.0, q1_per_mm2=1e-4)
angles = np.array([(outer, inner) for outer in np.linspace(-12, 12, 11) for inner in np.linspace(-12, 12, 11)])
table = Rotation.from_euler("XY", angles, degrees=True)  # laboratory from table top
installation = Rotation.from_euler("xyz", [0.3, -0.2, 0.5], degrees=True)  # camera from table top
star = np.array([0.002, -0.001, 1.0]) / np.linalg.norm([0.002, -0.001, 1.0])
pixel = camera.project((installation * table.inv()).apply(star)) + rng.normal(0.0, 0.03, (len(angles), 2))
nominal = np.tile([0.0, 0.0, 1.0], (len(angles), 1))
seen = Observations.isotropic(pixel_px=pixel, direction=nominal, frame=np.arange(len(angles)), sigma_px=0.03)
start = BrownConrady.create(chip, focal_length_mm=39.0)
calibration = calibrate(seen, start, TurntableAttitudes(table_rotation=table), free=("focal_length_mm", "q1_per_mm2"))
print(calibration.solution.status, {name: calibration.model.value(name) for name in ("focal_length_mm", "q1_per_mm2")})
off = 206265 * (star_direction(calibration) - star)[:2]
known = dict(zip(calibration.solution.names, 206265 * np.sqrt(np.diag(calibration.solution.covariance)), strict=True))
print(f"star off by {off.round(0)} arcsec, sigma of its azimuth {known['star_azimuth_rad']:.0f} arcsec")
left = pixel - calibration.model.project((calibration.installation * table.inv()).apply(star_direction(calibration)))
figure, axes = plt.subplots(figsize=(5.6, 5.2), layout="constrained")
arrows = axes.quiver(*pixel.T, *left.T, angles="xy")
axes.quiverkey(arrows, 0.85, 1.03, 0.1, "0.1 px", labelpos="W")
axes.set(xlabel="column [px]", ylabel="row [px]", aspect="equal", xlim=(0, 1023), ylim=(1023, 0), title="residuals")
