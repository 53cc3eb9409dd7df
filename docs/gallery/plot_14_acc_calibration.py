"""
Calibration with attitude-correlated frames
===========================================

A hundred frames linked by a gyro (method ACC of the paper ACF17): one star per frame is enough. Without the gyro a
single star per frame gives no calibration; with many stars per frame the gyro brings no gain.
"""

import numpy as np
from matplotlib import pyplot as plt
from scipy.spatial.transform import Rotation

from calib import AttitudeCorrelated, BrownConrady, FreeAttitudes, Observations, SensorGeometry, bound, calibrate

rng = np.random.default_rng(4)
chip = SensorGeometry(width_px=1024, height_px=1024, pixel_pitch_mm=0.01)
camera = BrownConrady.create(chip, focal_length_mm=25.6, x0_px=10.0, y0_px=-10.0, q1_per_mm2=2e-4)
turn = Rotation.from_rotvec(np.radians(np.cumsum(rng.normal(0.0, 2.0, (100, 3)), axis=0)))
gyro = turn * turn[0].inv()
free = ("focal_length_mm", "x0_px", "y0_px", "q1_per_mm2")
with_gyro, without = [], []
counts = (1, 2, 3, 5, 10, 20)
for stars in counts:
    frame, pixel = np.repeat(np.arange(100), stars), rng.uniform(0.0, 1023.0, (100 * stars, 2))
    sky = turn[frame].inv().apply(camera.unproject(pixel))
    noisy = pixel + rng.normal(0.0, 0.05, pixel.shape)
    seen = Observations.isotropic(pixel_px=noisy, direction=sky, frame=frame, sigma_px=0.05)
    calibration = calibrate(
        seen, BrownConrady.create(chip, focal_length_mm=25.0), AttitudeCorrelated(gyro_rotation=gyro), free=free
    )
    with_gyro.append(bound(seen, calibration.model, AttitudeCorrelated(gyro_rotation=gyro), free=free).sigma[0] * 1e3)
    without.append(bound(seen, camera, FreeAttitudes(attitude=turn), free=free).sigma[0] * 1e3)
print("focal length with 20 stars a frame:", calibration.model.value("focal_length_mm"), "mm, truth 25.6 mm")
figure, axes = plt.subplots(figsize=(6.5, 4.0), layout="constrained")
axes.loglog(counts, with_gyro, "o-", label="frames linked by a gyro")
axes.loglog(counts, without, "s--", label="independent frames")
axes.set(xlabel="stars in a frame", ylabel="bound of the focal length [um]", title="100 frames, 0.05 px")
axes.set_xticks(counts, counts)
axes.legend()
