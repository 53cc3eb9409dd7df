"""
The Moon behind the limb of the Earth
=====================================

From geostationary orbit the Moon sets behind the Earth. Both are spheres lit by the Sun, with their published
brightness; the nearer hides the farther, and both go through the lens.
"""

import numpy as np
from astropy import constants
from matplotlib import pyplot as plt

from optics import TopHat, attitude_from_angles
from render import Observer, earth_observer, load_star_sensor
from render.bodies.body_image import render_body
from render.bodies.solar_system import solar_system
from render.bodies.sunlit_body import planet_body

epoch, au_km = 2026.157, constants.au.to("km").value
geocentre = earth_observer(epoch)
moon = solar_system(epoch, bodies=["moon"]).direction[0]
aside = np.cross(moon, [0.0, 0.0, 1.0]) / np.linalg.norm(np.cross(moon, [0.0, 0.0, 1.0]))
place = geocentre.position_au + (-41670.0 * moon + 7080.0 * aside) / au_km
observer = Observer(position_au=place, velocity_km_per_s=geocentre.velocity_km_per_s)
system = solar_system(epoch, observer=observer, bodies=["moon", "earth"])
far, near = planet_body(system, "moon"), planet_body(system, "earth")
ra, dec = np.degrees(np.arctan2(far.direction[1], far.direction[0])), np.degrees(np.arcsin(far.direction[2]))
sensor = load_star_sensor("star_tracker_26mm", "cmv4000", window_px=128)
camera, band = sensor.camera, [TopHat(centre_nm=600.0, width_nm=100.0, edge_nm=10.0)]
attitude = {"rotation_cam_from_icrs": attitude_from_angles(ra, dec).as_matrix(), "exposure_s": 1e-5}
image = render_body(camera, far, band, in_front=[near], **attitude).image.electrons[:, :, 0]
image = image + render_body(camera, near, band, **attitude).image.electrons[:, :, 0]
figure, axes = plt.subplots(figsize=(6.4, 5.2), layout="constrained")
shown = axes.imshow(np.arcsinh(image / 30.0), cmap="gray")
axes.set(xlabel="column [px]", ylabel="row [px]", title="asinh of the electrons in 10 us")
