"""
Table 1 of ACC18, and what it hides
===================================

The paper ACC18 averages the shift between two filters over a target of 5 x 5 points and divides by two. For a centred
lens this mean is zero by symmetry although every point shifts; a decentre of 117 um gives the published 0.12 px.
"""

import numpy as np
from matplotlib import pyplot as plt

from optics import decentre, load_lens, spot_moments

lens = load_lens("star_camera_206mm")
x, y = (v.ravel() for v in np.meshgrid(np.linspace(-1.0, 1.0, 5), np.linspace(-1.0, 1.0, 5)))  # field [deg]
figure, panels = plt.subplots(1, 2, figsize=(9, 4.6), layout="constrained", sharey=True)
for axes, moved_mm in zip(panels, (0.0, 0.117), strict=True):
    moments = spot_moments(decentre(lens, "L2", x_mm=moved_mm), x, y, [600.0, 800.0])
    x_px, y_px = moments.x_mm / 0.0055, -moments.y_mm / 0.0055  # rows count against y of the lens
    shift_px = np.stack([x_px[:, 1] - x_px[:, 0], y_px[:, 1] - y_px[:, 0]], axis=-1)
    arrows = axes.quiver(x, y, *shift_px.T, angles="xy", scale=4.0)
    axes.quiverkey(arrows, 0.88, 1.04, 0.3, "0.3 px")
    table = np.abs(shift_px.mean(axis=0)) / 2.0
    axes.set(xlabel="field x [deg]", aspect="equal", xlim=(-1.4, 1.4), ylim=(-1.4, 1.4))
    axes.set_title(
        f"L2 moved by {1e3 * moved_mm:.0f} um\ntable: {table[0]:.3f}, {table[1]:.3f} px", loc="left", fontsize=10
    )
panels[0].set_ylabel("field y [deg]")
