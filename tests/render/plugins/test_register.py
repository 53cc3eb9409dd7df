"""The plugins in scenes that this project did not write, through ``mi.load_dict`` and ``mi.render``."""

import re
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from star_emitters import film, star_emitter

from render.camera import Camera
from render.forward import StarRenderer
from render.motion.trajectory import ConstantRate
from render.tracing.motion.exposure import exposure_motion

ROOT = Path(__file__).parents[3]
FILM = film(300, 200)
CAMERA = {"type": "lens_camera", "lens": "star_camera_206mm", "pixel_pitch_um": 5.5, "charge_diffusion_um": 1.0}
WAVELENGTH = np.array([[500.0, 520.0], [600.0, 620.0]])


def foreign_scene(mi, direction, **sensor):
    """Somebody's scene: a lamp, a constant sky, a floor and a glass ball, and our sensor among other things."""
    return {
        "type": "scene",
        "integrator": {"type": "star_tracer"},
        "sensor": {**CAMERA, "shutter_close": 0.5, "film": FILM, **sensor},
        "stars": star_emitter(direction, WAVELENGTH, np.full((len(direction), 2, 2), 100.0), band="green,red"),
        "sky": {"type": "constant", "radiance": 0.1},
        "lamp": {"type": "point", "position": [0, 3, 0], "intensity": 10.0},
        "floor": {"type": "rectangle", "bsdf": {"type": "diffuse"}},
        "ball": {"type": "sphere", "center": [0, 900, 5000], "radius": 100, "bsdf": {"type": "dielectric"}},
    }


def unit(x, y):
    v = np.stack(np.broadcast_arrays(x, y, 1.0), axis=-1)
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


def test_plugin_scene_equals_the_library_path(mi):
    """The scene's lights add nothing to the star image, and bodies beside the beam take nothing from it."""
    from optics.lens_file import load_lens
    from render.records import StarField

    direction = unit([0.0, 0.002], [0.0, -0.001])
    rotation = {"rotation": mi.TensorXf64(np.eye(3)[None])}
    scene = mi.load_dict(foreign_scene(mi, direction, **rotation))
    camera = Camera(
        lens=load_lens("star_camera_206mm"),
        width_px=300,
        height_px=200,
        pixel_pitch_mm=5.5e-3,
        charge_diffusion_px=1.0 / 5.5,
    )
    stars = StarField(
        direction=direction, wavelength_nm=WAVELENGTH, photon_rate=np.full((2, 2, 2), 100.0), band=("green", "red")
    )
    assert np.array_equal(StarRenderer(camera, exposure_s=0.5).render(stars).electrons, np.array(mi.render(scene)))


def test_to_world_like_any_mitsuba_sensor(mi):
    """Looking along world -X with +Z up: up is up in the image (smaller row), right is right."""
    ahead, up, right = np.array([-1.0, 0, 0]), np.array([0, 0, 1.0]), np.array([0, 1.0, 0])
    v = np.array([ahead, ahead + 0.001 * up, ahead + 0.001 * right])
    view = mi.ScalarTransform4f().look_at(origin=[7, 8, 9], target=[6, 8, 9], up=[0, 0, 1])
    scene = mi.load_dict(foreign_scene(mi, v / np.linalg.norm(v, axis=1, keepdims=True), to_world=view))
    mi.render(scene)
    truth = scene.integrator().traced.truth
    offset = 0.001 * 206.2 / 5.5e-3
    assert truth.bundle_x_px[:, 0] == pytest.approx([149.5, 149.5, 149.5 + offset], abs=0.5)
    assert truth.bundle_y_px[:, 0] == pytest.approx([99.5, 99.5 - offset, 99.5], abs=0.5)


@pytest.mark.slow
@pytest.mark.parametrize("suffix", ["ad_rgb", "ad_spectral_polarized"])
def test_other_variants(mi, suffix):
    """Stars do not depend on the variant; a body in colour has a grey image under a grey light."""
    from render.engine import Engine
    from render.plugins.register import register_plugins

    original = mi.variant()
    backend, first = original.split("_")[0], register_plugins()
    direction = unit([0.0, 0.002], [0.0, -0.001])
    expected = np.array(mi.render(mi.load_dict(foreign_scene(mi, direction))))
    try:
        Engine.start(backend, suffix=suffix)
        assert register_plugins()[0] is not first[0]
        assert np.array_equal(np.array(mi.render(mi.load_dict(foreign_scene(mi, direction)))), expected)
        film = {**FILM, "width": 12, "height": 12, "pixel_format": "rgb"}
        sky = {
            "type": "scene",
            "sensor": {**CAMERA, "film": film},
            "sky": {"type": "constant", "radiance": {"type": "d65", "scale": 2.0}},
        }
        image = np.array(mi.render(mi.load_dict(sky), spp=512, integrator=mi.load_dict({"type": "path"})))
        assert image.mean((0, 1)) == pytest.approx(np.full(3, 2.0 * np.pi * 0.1695**2), rel=0.02)
    finally:
        Engine.start(backend)
        assert mi.variant() == original
        assert register_plugins() is first


def test_stock_integrators_do_not_see_the_stars(mi):
    scene = {k: v for k, v in foreign_scene(mi, unit([0.0], [0.0])).items() if k in ("type", "sensor", "stars")}
    image = np.array(mi.render(mi.load_dict(scene), integrator=mi.load_dict({"type": "path"}), spp=4))
    assert np.count_nonzero(image) == 0


@pytest.mark.slow
def test_code_of_the_documentation(engine, bench):
    """docs/rendering.md is run as it stands: the scene, and the lines about motion with a camera of ours.

    (The lines about derivatives are run where these are tested.)
    """
    text = (ROOT / "docs" / "rendering.md").read_text(encoding="utf-8")
    code, _, moving = re.findall(r"```python\n(.*?)```", text, flags=re.DOTALL)
    assert len([line for line in code.splitlines() if line.strip()]) <= 20
    names = {}
    exec(compile(code, "rendering.md", "exec"), names)
    electrons, irradiance = np.array(names["electrons"]), np.array(names["irradiance"])
    assert electrons.shape == (480, 640, 1)
    assert electrons.sum() == pytest.approx(names["truth"].electrons_image.sum(), rel=1e-6)
    assert np.unravel_index(electrons.argmax(), (480, 640)) in {(239, 319), (239, 320), (240, 319), (240, 320)}
    column = (irradiance[..., 0].sum(0) @ np.arange(640)) / irradiance.sum()
    assert column == pytest.approx(319.5 - 8 / 2000 * 206.2 / 5.5e-3, abs=2.0)  # +X is to the left, as in Mitsuba
    camera = bench.window(bench.camera_of(), 60, 2000, 1000)
    names = {
        "camera": camera,
        "stars": bench.stars_at(camera, 29.5, 29.5, nodes=1),
        "trajectory": ConstantRate(initial=Rotation.identity(), rate_rad_per_s=np.full(3, 1e-5), end_s=1.0),
        "exposure_motion": exposure_motion,
        "StarRenderer": StarRenderer,
    }
    exec(compile(moving, "rendering.md", "exec"), names)
    assert names["image"].electrons.sum() == pytest.approx(names["image"].truth.electrons_image.sum(), rel=1e-6)
