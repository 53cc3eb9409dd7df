"""
A frame to zoom into
====================

One HTML file that needs neither server nor network: wheel or two fingers zoom, a click tells all of a star, the true
and the measured places are layers. ``starbench frame show FILE.fits`` makes the same of any FITS image.
"""

from pathlib import Path
from tempfile import mkdtemp

from calib import camera_model, find_stars, identify_stars, solve_attitude, star_marks
from optics import attitude_from_angles
from render import load_star_sensor, observe

sensor = load_star_sensor("star_tracker_26mm", "cmv4000", window_px=400)
pointing = attitude_from_angles(ra_deg=56.8, dec_deg=24.1, roll_deg=70.0)
observation = observe(sensor, pointing, exposure_s=0.2, seed=5)
model = camera_model(sensor)
stars = find_stars(observation.frame, "gaussian")
identified = identify_stars(stars, model, observation.sky, near=pointing)
solution = solve_attitude(stars, identified, model, observation.sky)
page = observation.save_page(Path(mkdtemp()) / "pleiades.html", star_marks(stars, solution))
print(f"{page.name}: {page.stat().st_size / 1e3:.0f} kB")
picture = observation.show()
