"""
Photon transfer
===============

Variance of the difference of two flat frames against their mean (EMVA 1288): the slope gives the gain, the intercept
the read noise, the maximum the full well. The lines follow from the data sheet.
"""

from dataclasses import replace

import numpy as np
from matplotlib import pyplot as plt

from render import Streams, expose, load_detector

chip = replace(load_detector("cmv4000"), chip_width_px=256, chip_height_px=256, nonlinearity=(), dark_current_e_per_s=0)
levels_e = np.geomspace(3.0, 30000.0, 25)
mean_dn, variance_dn2 = [], []
for k, level in enumerate(levels_e):
    flat = np.full(chip.shape, level, np.float32)
    pair = [expose(flat, chip, streams=Streams(1), frame=2 * k + i, exposure_s=0.01, band="flat").dn for i in (0, 1)]
    good = np.stack(pair).astype(float)
    mean_dn.append(np.mean(good) - chip.offset_dn)
    variance_dn2.append(np.var(good[0] - good[1]) / 2.0)
gain, noise_dn = chip.gain_dn_per_e, chip.gain_dn_per_e * chip.read_noise_e
figure, axes = plt.subplots(figsize=(6.5, 4.2), layout="constrained")
axes.loglog(mean_dn, variance_dn2, "o", label="pairs of rendered frames")
axes.loglog(
    mean_dn, gain * np.array(mean_dn) + noise_dn**2 + 1 / 12, label=f"K = {gain} DN/e-, {chip.read_noise_e:g} e-"
)
axes.axvline(gain * chip.full_well_e, color="0.6", linestyle=":", label="full well")
axes.set(xlabel="mean above offset [DN]", ylabel="temporal variance [DN^2]")
axes.legend()
