"""
A star tracker in a control loop
================================

The sensor is a function of attitude, rate and time that returns quaternion and covariance. Here its errors are drawn
from the predicted budget, fast enough for a loop of 1 kHz; ``by_frames`` renders every exposure instead. A rigid body
turns by half a degree with rate damping and holds its attitude.
"""

import numpy as np
from matplotlib import pyplot as plt
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from experiments.flight.loop import by_budget
from experiments.flight.settings import FlightConfig
from optics import attitude_error_arcsec, attitude_from_angles

lens = {"lens": "star_tracker_26mm", "detector": "cmv4000", "width_px": 1024, "height_px": 1024}
sensor = by_budget(FlightConfig(instrument=lens, temperature={"mean_k": 0.0, "offset_k": 0.0, "eclipse_k": 0.0}))
inertia, step_s = np.array([40.0, 50.0, 30.0]), 0.1  # kg m^2
aim = attitude_from_angles(160.0, -5.0)  # near the pole of the orbit
truth, rate, errors, left = Rotation.from_rotvec([0.0087, 0.0, 0.0]) * aim, np.zeros(3), [], []
for n in range(900):
    found = sensor(truth, rate, n * step_s)
    off = (found.attitude * aim.inv()).as_rotvec()  # of the stars in cam, which pass the body the other way round
    torque = inertia * (0.16 * off - 0.8 * rate)
    turning = solve_ivp(lambda _, w, t=torque: (t - np.cross(w, inertia * w)) / inertia, (0.0, step_s), rate)
    truth = Rotation.from_rotvec(-0.5 * (rate + turning.y[:, -1]) * step_s) * truth
    rate = turning.y[:, -1]
    errors.append(attitude_error_arcsec(found.attitude, truth))
    left.append(attitude_error_arcsec(truth, aim))
figure, axes = plt.subplots(1, 2, figsize=(9, 3.6), layout="constrained")
axes[0].plot(np.arange(len(left)) * step_s, left)
axes[0].set(xlabel="time [s]", ylabel="pointing error [arcsec]", yscale="symlog")
axes[1].plot(np.array(errors)[600:, :2], ".", markersize=2)
axes[1].set(xlabel="frame", ylabel="error of the quaternion across [arcsec]")
