"""Derivatives through `mi.render` against central differences of images of the forward engine, in double precision."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from made_lens import made_lens

from optics.lens.shapes.plane import Plane
from optics.lens.shapes.sphere import Sphere
from optics.lens_file import load_lens
from optics.rays.paraxial import axial_paraxial
from render.camera import Camera
from render.engine.jit import dr
from render.forward import star_scene
from render.records import StarField
from render.tracing.waves.direct_sums import DirectSums
from render.tracing.waves.pixel_kernel import FieldSampling, window_samples

WEIGHTS = {-3: -1 / 60, -2: 9 / 60, -1: -45 / 60, 1: 45 / 60, 2: -9 / 60, 3: 1 / 60}
"""Sixth-order central difference (Fornberg 1988, Math. Comp. 51, 699)."""
BENCHES = {"star_camera_206mm": (5.5e-3, 0.03), "star_tracker_26mm": (10e-3, 0.02)}
"""Pixel pitch and focus; a spot at its best focus has no slope against focus."""


def singlet(stop):
    """A biconvex lens of 30 mm, F/10, with its stop in front or behind, where rays must be aimed."""
    front, back, hole = Sphere(radius_mm=20.0), Sphere(radius_mm=-60.0), (Plane(), 2.0, "air", 1.5)
    if stop == "in front":
        return made_lens(hole, (front, 3.0, "n15", 6.0), (back, 28.7, "air", 6.0))
    behind = (Plane(), 26.7, "air", 1.5)
    return made_lens((front, 3.0, "n15", 6.0), (back, 2.0, "air", 6.0), behind, stop=2)


def scene_of(mi, lens, stars=2, colours=3, rate=None, **camera):
    """One star or two, of one to three wavelengths, on a small film, some hundred pixels from the axis.

    Diffusion of 0.16 px is spread over 6.2 standard deviations: what is cut there would else be a step in differences.
    """
    lens, (pitch_mm, focus_mm) = (load_lens(lens), BENCHES[lens]) if isinstance(lens, str) else (lens, (5e-3, 0.0))
    settings = {"width_px": 40, "height_px": 36, "pixel_pitch_mm": pitch_mm, "defocus_mm": focus_mm}
    settings |= {"charge_diffusion_px": 0.16, "diffraction": "rays"} | camera
    record = Camera(lens=lens, centre_px=np.array([-100.0, -80.0]), **settings)
    focal_mm = float(axial_paraxial(lens, lens.design_wavelength_nm).efl_mm)
    field = StarField(
        direction=record.nominal_direction(np.array([18.3, 26.8]), np.array([17.7, 12.1]), focal_mm)[:stars],
        wavelength_nm=np.array([[500.0, 600.0, 700.0]])[:, :colours],
        photon_rate=np.array([[[10.0, 12.0, 9.0]], [[5.0, 4.0, 7.0]]])[:stars, :, :colours],
        band=("band",),
    )
    tolerance = 1e-6 if record.diffraction == "rays" else 1e-3  # of the rays, whose images those by waves are not
    scene = mi.load_dict(star_scene(record, field, exposure_s=0.5, tolerance=tolerance))
    if rate is not None:
        params = mi.traverse(scene)
        params["camera.rate_rad_per_s"] = mi.TensorXf64(np.array(rate))
        params.update()
        mi.render(scene)
        assert 1.0 < scene.sensors()[0].star_motion.length_px < 3.5
    return scene


def direct_sum(rays, shares, corner_px, window_px, field, *, pad_px):
    """Light of plane waves in a window, in double precision, for `render.tracing.waves.frequency_grid.window_light`."""
    at = window_samples(field, window_px, pad_px)
    light = np.zeros((len(at), len(at)))
    for colour, share in enumerate(shares):
        x, y, fx, fy, turns, amplitude = rays(colour)
        columns = np.exp(2j * np.pi * fx[:, None] * (corner_px[0] + at - x[:, None]))
        rows = np.exp(2j * np.pi * (turns[:, None] + fy[:, None] * (corner_px[1] + at - y[:, None])))
        light += share * np.pi * np.abs((rows * amplitude[:, None]).T @ columns) ** 2
    return light


def farther(pixel):
    """The kernel of a pixel, ended later."""

    def made(field, box_px, sigma_px):
        kernel = pixel(field, box_px, sigma_px)
        return replace(kernel, reach_px=kernel.reach_px + 3.0)

    return made


def held(method):
    """A method that goes on giving its first answer."""
    first = []

    def known(*args):
        if not first:
            first.append(method(*args))
        return first[0]

    return known


@pytest.fixture
def by_direct_sums(monkeypatch):
    """Diffraction images of the forward engine ray by ray in double precision, none interpolated, without steps.

    Stamps, sampling and numbers of rays follow from the rays. Each is right to the tolerance of the engine, which a
    change from one to the next shows in differences (5e-5 of a derivative): all stay as they are at first. Pixels draw
    on samples 3 px farther away: where the kernel of a pixel ends images that move would make steps too.
    """
    monkeypatch.setattr(FieldSampling, "pixel", farther(FieldSampling.pixel))
    monkeypatch.setattr("render.tracing.waves.direct_sums.window_light", direct_sum)
    monkeypatch.setattr("render.tracing.waves.plane_waves.TAIL", 0.0)
    for name in ("needs", "means"):
        monkeypatch.setattr(DirectSums, name, held(getattr(DirectSums, name)))


def exact_image(scene):
    """Image in double precision as the forward engine makes it."""
    camera, field = scene.sensors()[0], scene.emitters()[0]
    tracer = scene.integrator().tracer(camera, 0)
    motion = camera.star_motion
    if motion is None:
        paths = tracer._in_cam(field.stars, camera.camera.rotation_cam_from_world)
    else:
        paths = tracer._moving(field.stars, motion, camera.exposure_s)
    light = tracer.light(field.stars, paths, camera.exposure_s)
    image = np.zeros((camera.optics.height_px, camera.optics.width_px, 1))
    tracer._add(light, paths, image, 0.0 if motion is None else motion.length_px)
    return image


def moments(scene):
    """Weights whose sum with the image is smooth in everything: light, position and size of the spots."""
    truth = scene.integrator().traced.truth
    u = np.arange(40) - truth.photon_x_px.mean()
    v = np.arange(36)[:, None] - truth.photon_y_px.mean()
    return (3.0 + 0.3 * u + 0.2 * v + 0.05 * u * u + 0.03 * v * v + 0.02 * u * v)[..., None].astype(np.float32)


def gradients(mi, scene, params, keys):
    """Of the weighted sum of the image, by reverse mode."""
    dr.enable_grad(*(params[key] for key in keys))
    image = mi.render(scene, params)
    weight = moments(scene)
    dr.backward(dr.sum(image * mi.TensorXf(weight), axis=None))
    gradient = {key: np.array(dr.grad(params[key]).numpy(), float) for key in keys}
    dr.disable_grad(*(params[key] for key in keys))
    return gradient, weight.astype(float)


def forward(mi, scene, params, direction):
    """Derivative of the image along directions in parameters."""
    for key, change in direction.items():
        dr.enable_grad(params[key])
        dr.set_grad(params[key], mi.TensorXf64(change))
    derivative = dr.forward_to(mi.render(scene, params)).numpy()
    dr.disable_grad(*(params[key] for key in direction))
    return derivative


def difference(mi, scene, params, weight, direction):
    """Central difference of the weighted sum along directions in parameters."""
    start = {key: np.array(params[key].numpy(), float) for key in direction}
    total = 0.0
    for times, factor in (WEIGHTS | {0: 0.0}).items():  # the last leaves the parameters as they were
        for key, change in direction.items():
            params[key] = mi.TensorXf64(start[key] + times * change)
        params.update()
        total += factor * float((exact_image(scene) * weight).sum()) if factor else 0.0
    return total


def along(gradient, key, at, step):
    """Direction in one number of a parameter."""
    direction = np.zeros(np.shape(gradient[key]))
    direction[at] = step
    return direction


def check(mi, scene, steps):
    """All kinds in one reverse pass, against differences one by one; then all at once in forward mode."""
    params, rng = mi.traverse(scene), np.random.default_rng(3)
    gradient, weight = gradients(mi, scene, params, list(dict.fromkeys(key for key, *_ in steps)))
    for key, at, step in steps:
        direction = along(gradient, key, at, step)
        expected = difference(mi, scene, params, weight, {key: direction})
        assert abs(expected) > 1e-3, key  # more than nothing happens
        assert float((gradient[key] * direction).sum()) == pytest.approx(expected, rel=1e-6), (key, at)
    every = {key: rng.normal(size=value.shape) / np.abs(value).max() for key, value in gradient.items()}
    changed = forward(mi, scene, params, every) * weight  # in single precision
    expected = sum(float((gradient[key] * direction).sum()) for key, direction in every.items())
    assert float(changed.sum()) == pytest.approx(expected, abs=1e-6 * np.abs(changed).sum())


QUICK = {
    "in front": [("defocus_mm", 0, 1e-3), ("curvature_per_mm", 1, 1e-5), ("index_offset", 1, 1e-5)],
    "behind": [("attitude_rad", 1, 3e-6), ("decentre_mm", (1, 0), 1e-3), ("rate_rad_per_s", 0, 4e-6)],
}


@pytest.mark.parametrize(("stop", "diffraction"), [("in front", "rays"), ("behind", "exact_waves")])
def test_derivative_along_a_direction(mi, request, stop, diffraction):
    """A singlet at rest (stop in front) or on a trail (behind), several parameters at once, reverse and forward."""
    if diffraction != "rays":
        request.getfixturevalue("by_direct_sums")
    rate = None if stop == "in front" else (-3e-4, 6e-4, 0.0)
    blur = {"charge_diffusion_px": 0.3}
    scene = scene_of(mi, singlet(stop), stars=1, colours=1, rate=rate, diffraction=diffraction, **blur)
    params = mi.traverse(scene)
    gradient, weight = gradients(mi, scene, params, [f"camera.{key}" for key, *_ in QUICK[stop]])
    direction = {f"camera.{key}": along(gradient, f"camera.{key}", at, step) for key, at, step in QUICK[stop]}
    expected = difference(mi, scene, params, weight, direction)
    assert abs(expected) > 0.01
    assert sum(float((gradient[key] * v).sum()) for key, v in direction.items()) == pytest.approx(expected, rel=1e-5)
    assert float((forward(mi, scene, params, direction) * weight).sum()) == pytest.approx(expected, rel=1e-5)


CASES = {
    "stars and attitude": ("star_camera_206mm", {}, [
        ("stars.direction", (0, 0), 3e-7), ("stars.direction", (1, 1), 3e-7), ("stars.photon_rate", (1, 0, 2), 1.0),
        ("camera.attitude_rad", 0, 3e-7), ("camera.attitude_rad", 1, 3e-7), ("camera.attitude_rad", 2, 1e-4),
    ]),
    "stop in front": ("star_camera_206mm", {}, [
        ("camera.curvature_per_mm", 2, 5e-9), ("camera.thickness_mm", 2, 1e-4), ("camera.temperature_c", 0, 0.03),
        ("camera.index_offset", 1, 1e-6), ("camera.decentre_mm", (1, 0), 3e-5), ("camera.tilt_deg", (1, 1), 1e-5),
    ]),
    "stop inside": ("star_tracker_26mm", {}, [  # aspheres, and outlines of beams that move with the lens
        ("camera.curvature_per_mm", 1, 1.5e-6), ("camera.conic", 0, 2e-3), ("camera.asphere", (10, 0), 5e-7),
        ("camera.decentre_mm", (1, 0), 3e-4), ("camera.attitude_rad", 0, 4e-6),
    ]),
    "trail, stop in front": ("star_camera_206mm", {"rate": (5e-5, -1e-4, 3e-4)}, [
        ("camera.rate_rad_per_s", 0, 3e-7), ("camera.defocus_mm", 0, 2e-5),
    ]),
    "trail, stop inside": ("star_tracker_26mm", {"rate": (-1e-3, 2e-3, 0.0)}, [
        ("camera.rate_rad_per_s", 0, 4e-6), ("camera.attitude_rad", 1, 4e-6),
    ]),
    "waves, stop in front": ("star_camera_206mm", {"diffraction": "exact_waves"}, [
        ("camera.curvature_per_mm", 2, 2e-8), ("camera.thickness_mm", 2, 3e-4), ("camera.tilt_deg", (1, 1), 3e-5),
        ("camera.temperature_c", 0, 0.1), ("camera.defocus_mm", 0, 1e-3), ("stars.direction", (0, 0), 3e-7),
        ("stars.photon_rate", (0, 0, 0), 1.0),
    ]),
    "waves, trail, stop inside": (
        "star_tracker_26mm",
        {"diffraction": "exact_waves", "rate": (-3e-4, 5e-4, 0.0), "pixel_pitch_mm": 2.5e-3, "defocus_mm": 0.01},
        [("camera.rate_rad_per_s", 1, 2e-6), ("camera.attitude_rad", 0, 1e-6)],
    ),
}  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES)
def test_every_parameter(mi, request, case):
    lens, settings, steps = CASES[case]
    if "diffraction" in settings:
        request.getfixturevalue("by_direct_sums")
        settings = settings | {"stars": 1, "colours": 1, "charge_diffusion_px": 0.3}  # less ends with the pixel's table
    check(mi, scene_of(mi, lens, **settings), steps)


@pytest.mark.slow
def test_lines_of_the_documentation(mi):
    text = (Path(__file__).parents[3] / "docs" / "rendering.md").read_text(encoding="utf-8")
    lines = re.search(r"## Derivatives\n\n```python\n(.*?)```", text, flags=re.DOTALL)[1]
    scene = scene_of(mi, "star_camera_206mm")
    mi.render(scene)
    weight = moments(scene)
    names = {"mi": mi, "dr": dr, "scene": scene, "weight": mi.TensorXf(weight)}
    exec(compile(lines, "rendering.md", "exec"), names)
    gradient = float(dr.grad(names["params"]["camera.defocus_mm"]).numpy()[0])
    step = {"camera.defocus_mm": np.array([1e-4])}
    expected = difference(mi, scene, mi.traverse(scene), weight.astype(float), step)
    assert gradient * 1e-4 == pytest.approx(expected, rel=1e-6)
