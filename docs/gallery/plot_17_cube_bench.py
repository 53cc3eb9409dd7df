"""
Sun sensor and cube mirror
==========================

The bench of the paper CUBE09, path traced: sunlight passes an aperture, is reflected by a face of the cube mirror and
returns to the screen around the aperture. The spot's displacement measures the tilt of the face. Brightness: arsinh of
the electrons per pixel.
"""

import numpy as np
from matplotlib import pyplot as plt

from calib.calibration.cube_mirror import concentric_angles
from experiments.cube.bench import CubeCase, build_laboratory, build_table, draw_truths, face_start_rad, put_cube
from experiments.cube.settings import CubeMirrorConfig
from experiments.cube.trim import take_spot
from render import Engine

Engine.start("auto")
laboratory = build_laboratory(CubeMirrorConfig())
truth = draw_truths(laboratory.config, laboratory.streams)[0]
table = build_table(laboratory.config, truth, CubeCase(name="shown", label="shown"))
trimmed = concentric_angles(table, truth.normal_in_table("+Z"), face_start_rad("+Z"))
figure, panels = plt.subplots(1, 2, figsize=(9, 4.4), layout="constrained")
for axes, turned_arcsec in zip(panels, (0.0, 60.0), strict=True):
    angle = trimmed + np.radians([0.0, turned_arcsec / 3600.0])
    put_cube(laboratory, truth, table.rotation(angle[None])[0].as_matrix())
    picture = take_spot(laboratory, laboratory.streams, sensor=laboratory.sensor, log2_particles=17)
    axes.imshow(np.arcsinh(picture.electrons / 50.0), cmap="inferno")
    axes.set(xlabel="column [px]", ylabel="row [px]", title=f"inner axis off by {turned_arcsec:.0f} arcsec")
