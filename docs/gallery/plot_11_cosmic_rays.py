"""
Cosmic rays
===========

Particle tracks in silicon during three seconds of a solar flare, with published fluxes and spectra, energy-loss
straggling, knock-on electrons and charge diffusion.
"""

import numpy as np
from matplotlib import pyplot as plt

from render import Streams, expose, load_detector
from render.detector.cosmic_rays import cosmic_ray_hits

chip = load_detector("cmv4000")
streams = Streams(3)
hits = cosmic_ray_hits(chip, "solar_flare", streams=streams, frame=0, exposure_s=3.0)
dark = np.zeros(chip.shape, np.float32)
frame = expose(dark, chip, streams=streams, exposure_s=0.2, temperature_c=-20.0, band="dark", hits=hits)
figure, (left, right) = plt.subplots(1, 2, figsize=(9.5, 4.4), layout="constrained")
image = left.imshow(frame.dn[:250, :250], vmin=30, vmax=400, cmap="magma")
left.set(xlabel="column [px]", ylabel="row [px]", title=f"{len(hits.freed_e)} tracks on {chip.name}")
figure.colorbar(image, ax=left, label="DN")
right.hist(hits.freed_e, bins=np.geomspace(30, 3e5, 50), color="#b5367a")
right.set(xscale="log", xlabel="electrons freed by a track", ylabel="tracks")
