"""
A gradient through lens and image
=================================

Star images are differentiable with respect to focus, decentre, curvature, attitude and star parameters. Example: the
exact derivative of every pixel with respect to a tilt of the camera, by forward mode.
"""

import drjit as dr
import numpy as np
from matplotlib import pyplot as plt

from optics import load_lens
from render import Camera, Engine, StarField
from render.forward import star_scene

mi = Engine.start("auto").mitsuba
camera = Camera(lens=load_lens("star_camera_206mm"), pixel_pitch_mm=5.5e-3, width_px=36, height_px=28,
                centre_px=np.array([-400.0, -300.0]), defocus_mm=0.08, charge_diffusion_px=0.3)  # fmt: skip
direction = camera.nominal_direction(np.array([11.3, 25.8]), np.array([12.1, 16.6]), 206.2)
stars = StarField(direction=direction, wavelength_nm=np.array([[550.0, 650.0]]),
                  photon_rate=np.array([[[9.0, 9.0]], [[5.0, 5.0]]]), band=("band",))  # fmt: skip
params = mi.traverse(scene := mi.load_dict(star_scene(camera, stars, exposure_s=0.5)))
turn = params["camera.attitude_rad"]
dr.enable_grad(turn)
image = mi.render(scene, params)
dr.set_grad(turn, mi.TensorXf64(np.radians([0.0, 1.0 / 3600.0, 0.0])))  # one arcsec about the column axis
dr.enqueue(dr.ADMode.Forward, turn)
dr.traverse(dr.ADMode.Forward)
change = np.array(dr.grad(image))[:, :, 0]
figure, panels = plt.subplots(1, 2, figsize=(9, 3.8), layout="constrained")
for axes, values, name in zip(
    panels, (np.array(image)[:, :, 0], change), ("electrons", "change of electrons per arcsec"), strict=True
):
    signed = name != "electrons"
    shown = axes.imshow(values, cmap="RdBu" if signed else "magma", vmin=-values.max() if signed else 0.0)
    axes.set(xlabel="column [px]", ylabel="row [px]", title=name)
    figure.colorbar(shown, ax=axes)
