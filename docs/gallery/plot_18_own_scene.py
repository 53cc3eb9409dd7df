"""
Stars in your own Mitsuba scene
===============================

Any scene dictionary may contain three plugins: a camera with a real lens, a star field, and the integrator that traces
the stars. Mitsuba's path tracer renders a lamp of the scene through the same lens.
"""

import numpy as np
from matplotlib import pyplot as plt

from render import Engine
from render.plugins.register import register_plugins

mi = Engine.start("auto").mitsuba
register_plugins()
rng = np.random.default_rng(5)
v = np.column_stack([rng.uniform(-0.008, 0.008, 40), rng.uniform(-0.006, 0.006, 40), np.ones(40)])
rate = 10.0 ** rng.uniform(-0.5, 1.5, (40, 1, 1)) * np.ones((1, 1, 3))  # photons/s/mm^2 per node
film = {"type": "hdrfilm", "width": 640, "height": 480, "rfilter": {"type": "box"}, "pixel_format": "luminance"}
camera = {"type": "lens_camera", "lens": "star_camera_206mm", "pixel_pitch_um": 5.5, "charge_diffusion_um": 2.0,
          "defocus_mm": 0.1, "scene_unit_mm": 1e3, "film": film}  # fmt: skip
stars = {
    "type": "star_field",
    "direction": mi.TensorXf64(v / np.linalg.norm(v, axis=1, keepdims=True)),
    "wavelength_nm": mi.TensorXf64(np.array([[500.0, 600.0, 700.0]])),
    "photon_rate": mi.TensorXf64(rate),
}
lamp = {"type": "sphere", "center": [3.0, 1.0, 2000.0], "radius": 2.0, "light": {"type": "area", "radiance": 1e7}}
scene = mi.load_dict({"type": "scene", "sensor": camera, "stars": stars, "lamp": lamp})
tracer = mi.load_dict({"type": "star_tracer", "bodies": {"type": "path"}})
image = np.array(mi.render(scene, integrator=tracer, spp=32))[:, :, 0]
figure, axes = plt.subplots(figsize=(7, 5), layout="constrained")
shown = axes.imshow(np.arcsinh(image / 2.0), cmap="magma")
axes.set(xlabel="column [px]", ylabel="row [px]", title="stars and a lamp: asinh of the electrons")
