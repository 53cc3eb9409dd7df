"""
A zoomable page of a frame
==========================

A single HTML file that needs neither server nor network: zoom by wheel or two fingers, click a star for its data,
switch true and measured positions on and off. ``starbench frame show FILE.fits`` writes such a page of any FITS image.
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
