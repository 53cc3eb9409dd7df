"""
Lost in space
=============

Stars of a frame of the real sky are detected and identified without a priori attitude (by tetra3rs; if it is not
installed, from a rough attitude), and the solved attitude is compared with the truth.
"""

from importlib.util import find_spec

from calib import camera_model, draw_residuals, find_stars, identify_stars, mark_stars, solve_attitude
from optics import attitude_from_angles
from render import load_star_sensor, observe

sensor = load_star_sensor("star_tracker_26mm", "cmv4000", window_px=1024)
pointing = attitude_from_angles(ra_deg=56.8, dec_deg=24.1, roll_deg=70.0)
observation = observe(sensor, pointing, exposure_s=0.2, seed=5)
model = camera_model(sensor)
stars = find_stars(observation.frame, "gaussian")
hint = None if find_spec("tetra3rs") else attitude_from_angles(56.7, 24.0, 70.2)
identified = identify_stars(stars, model, observation.sky, near=hint)
solution = solve_attitude(stars, identified, model, observation.sky)
print("error about x, y, roll:", solution.error_arcsec(pointing).round(2), "arcsec")
print("predicted:             ", solution.sigma_arcsec.round(2))
marked = mark_stars(observation.show(brightest=6), stars, solution)

# %%
# Residuals of the stars, enlarged.
residuals = draw_residuals(solution, stars)
