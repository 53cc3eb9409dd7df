"""Derivatives through `mi.render` against central differences of images of the forward engine, in double precision."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from refusals import refuses

from optics.lens_file import load_lens
from render.camera import Camera
from render.forward import star_scene
from render.records import StarField
from render.tracing.waves.direct_sums import DirectSums
from render.tracing.waves.pixel_kernel import FieldSampling, window_samples

WEIGHTS = {-3: -1 / 60, -2: 9 / 60, -1: -45 / 60, 1: 45 / 60, 2: -9 / 60, 3: 1 / 60}
"""Sixth-order central difference (Fornberg 1988, Math. Comp. 51, 699)."""
# focal length, pixel pitch and focus of the bench; a spot at its best focus has no slope against focus
BENCHES = {"star_camera_206mm": (206.2, 5.5e-3, 0.03), "star_tracker_26mm": (26.0, 10e-3, 0.02)}


def scene_of(mi, lens, stars=2, colours=3, bench=None, **camera):
    """One star or two, of one to three wavelengths, on a small film, some hundred pixels from the axis.

    Diffusion of 0.16 px is spread over 6.2 standard deviations: what is cut there would else be a step in differences.
    """
    focal_mm, pitch_mm, focus_mm = bench or BENCHES[lens]
    settings = {"width_px": 40, "height_px": 36, "defocus_mm": focus_mm, "charge_diffusion_px": 0.16}
    settings |= {"diffraction": "rays"} | camera
    record = Camera(lens=load_lens(lens), pixel_pitch_mm=pitch_mm, centre_px=np.array([-100.0, -80.0]), **settings)
    field = StarField(
        direction=record.nominal_direction(np.array([18.3, 26.8]), np.array([17.7, 12.1]), focal_mm)[:stars],
        wavelength_nm=np.array([[500.0, 600.0, 700.0]])[:, :colours],
        photon_rate=np.array([[[10.0, 12.0, 9.0]], [[5.0, 4.0, 7.0]]])[:stars, :, :colours],
        band=("band",),
    )
    tolerance = 1e-6 if record.diffraction == "rays" else 1e-3  # of the rays, whose images those by waves are not
    return mi.load_dict(star_scene(record, field, exposure_s=0.5, tolerance=tolerance))


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
    """Weights whose sum with the image is smooth in everything: light, place and size of the spots."""
    truth = scene.integrator().traced.truth
    u = np.arange(40) - truth.photon_x_px.mean()
    v = np.arange(36)[:, None] - truth.photon_y_px.mean()
    return (3.0 + 0.3 * u + 0.2 * v + 0.05 * u * u + 0.03 * v * v + 0.02 * u * v)[..., None].astype(np.float32)


def gradients(mi, scene, params, keys):
    """Of the weighted sum of the image, by reverse mode."""
    import drjit as dr

    for key in keys:
        dr.enable_grad(params[key])
    image = mi.render(scene, params)
    weight = moments(scene)
    dr.backward(dr.sum(image * mi.TensorXf(weight), axis=None))
    found = {key: np.array(dr.grad(params[key]).numpy(), float) for key in keys}
    for key in keys:
        dr.disable_grad(params[key])
    return found, weight.astype(float)


def difference(mi, scene, params, weight, key, direction):
    """Central difference of the weighted sum along a direction in a parameter."""
    start = np.array(params[key].numpy(), float)
    total = 0.0
    for times, factor in WEIGHTS.items():
        value = start + times * direction
        params[key] = mi.TensorXf64(value)
        params.update()
        total += factor * float((exact_image(scene) * weight).sum())
    params[key] = mi.TensorXf64(start)
    params.update()
    return total


def check(mi, scene, steps):
    """All kinds in one reverse pass, against differences one by one; the gradients and the weights of the image."""
    params = mi.traverse(scene)
    found, weight = gradients(mi, scene, params, list(dict.fromkeys(key for key, *_ in steps)))
    for key, at, step in steps:
        direction = np.zeros(np.shape(found[key]))
        direction[at] = step
        expected = difference(mi, scene, params, weight, key, direction)
        assert abs(expected) > 1e-3, key  # more than nothing happens
        assert float((found[key] * direction).sum()) == pytest.approx(expected, rel=1e-6), (key, at)
    return found, weight


@pytest.mark.slow
def test_stars_and_attitude(mi):
    """Directions, rates, and attitude of stars and camera; forward mode tells the same."""
    import drjit as dr

    scene = scene_of(mi, "star_camera_206mm")
    steps = [
        ("stars.direction", (0, 0), 3e-7),
        ("stars.direction", (1, 1), 3e-7),
        ("stars.photon_rate", (1, 0, 2), 1.0),
        ("camera.attitude_rad", 0, 3e-7),
        ("camera.attitude_rad", 1, 3e-7),
        ("camera.attitude_rad", 2, 1e-4),
    ]
    check(mi, scene, steps)
    params = mi.traverse(scene)
    turn = params["camera.attitude_rad"]
    dr.enable_grad(turn)
    image = mi.render(scene, params)
    dr.set_grad(turn, mi.TensorXf64(np.array([0.0, 1.0, 0.0])))
    dr.enqueue(dr.ADMode.Forward, turn)
    dr.traverse(dr.ADMode.Forward)
    forward = dr.grad(image).numpy()
    dr.disable_grad(turn)
    weight = moments(scene).astype(float)
    expected = difference(mi, scene, params, weight, "camera.attitude_rad", np.array([0.0, 3e-7, 0.0])) / 3e-7
    assert float((forward * weight).sum()) == pytest.approx(expected, rel=1e-6)


@pytest.mark.slow
def test_lens_with_its_stop_in_front(mi):
    """The stop in front of all glass: the launch disk is the stop. The documentation's lines do the same."""
    import drjit as dr

    text = (Path(__file__).parents[3] / "docs" / "rendering.md").read_text(encoding="utf-8")
    lines = re.search(r"## Derivatives\n\n```python\n(.*?)```", text, flags=re.DOTALL)[1]
    scene = scene_of(mi, "star_camera_206mm")
    mi.render(scene)
    weight = moments(scene)
    names = {"mi": mi, "dr": dr, "scene": scene, "weight": mi.TensorXf(weight)}
    exec(compile(lines, "rendering.md", "exec"), names)
    found = float(dr.grad(names["params"]["camera.defocus_mm"]).numpy()[0])
    step = np.array([1e-4])
    expected = difference(mi, scene, mi.traverse(scene), weight.astype(float), "camera.defocus_mm", step)
    assert found * 1e-4 == pytest.approx(expected, rel=1e-6)
    steps = [
        ("camera.curvature_per_mm", 2, 5e-9),
        ("camera.thickness_mm", 2, 1e-4),
        ("camera.temperature_c", 0, 0.03),
        ("camera.index_offset", 1, 1e-6),
        ("camera.decentre_mm", (1, 0), 3e-5),
        ("camera.tilt_deg", (1, 1), 1e-5),
    ]
    check(mi, scene_of(mi, "star_camera_206mm"), steps)


@pytest.mark.slow
def test_lens_with_its_stop_inside(mi):
    """Aspheres, and outlines of beams that move with the lens."""
    steps = [
        ("camera.curvature_per_mm", 1, 1.5e-6),
        ("camera.conic", 0, 2e-3),
        ("camera.asphere", (10, 0), 5e-7),
        ("camera.decentre_mm", (1, 0), 3e-4),
        ("camera.attitude_rad", 0, 4e-6),
    ]
    check(mi, scene_of(mi, "star_tracker_26mm"), steps)


WAVES = {
    "star_camera_206mm": (
        (206.2, 5.5e-3, 0.03),
        [
            ("camera.curvature_per_mm", 2, 2e-8),
            ("camera.thickness_mm", 2, 3e-4),
            ("camera.tilt_deg", (1, 1), 3e-5),
            ("camera.temperature_c", 0, 0.1),
            ("camera.defocus_mm", 0, 1e-3),
            ("stars.direction", (0, 0), 3e-7),
            ("stars.photon_rate", (0, 0, 0), 1.0),
        ],
    ),
    "star_tracker_26mm": (
        (26.0, 2.5e-3, 0.01),
        [
            ("camera.conic", 0, 2e-3),
            ("camera.asphere", (10, 0), 4e-7),
            ("camera.index_offset", 0, 1e-5),
            ("camera.decentre_mm", (1, 0), 1e-4),
            ("camera.attitude_rad", 0, 1e-6),
        ],
    ),
}
TRAILS = {
    "star_camera_206mm": ((5e-5, -1e-4, 3e-4), [("camera.rate_rad_per_s", 1, 1e-6)]),
    "star_tracker_26mm": ((-3e-4, 5e-4, 0.0), [("camera.rate_rad_per_s", 1, 2e-6)]),
}
"""Angular velocities [rad/s], and what is differentiated besides the last number of the star at rest."""


@pytest.mark.slow
@pytest.mark.parametrize(("lens", "moving"), [("star_camera_206mm", False), ("star_tracker_26mm", True)])
def test_diffraction_images(mi, by_direct_sums, lens, moving):
    """Every kind of parameter by waves, in reverse and in forward mode: a stop in front, and one inside."""
    import drjit as dr

    (bench, steps), (rate, more) = WAVES[lens], TRAILS[lens]
    blur = {"charge_diffusion_px": 0.3}  # leaves less of what ends with the table of a pixel's kernel
    scene = scene_of(mi, lens, stars=1, colours=1, bench=bench, diffraction="exact_waves", **blur)
    if moving:
        params = mi.traverse(scene)
        params["camera.rate_rad_per_s"] = mi.TensorXf64(np.array(rate))
        params.update()
        mi.render(scene)
        assert 1.0 < scene.sensors()[0].star_motion.length_px < 3.5
        steps = [*more, steps[-1]]
    found, weight = check(mi, scene, steps)
    # all of them at once, forwards
    params, rng = mi.traverse(scene), np.random.default_rng(3)
    along = {key: rng.normal(size=value.shape) / np.abs(value).max() for key, value in found.items()}
    for key, direction in along.items():
        dr.enable_grad(params[key])
        dr.set_grad(params[key], mi.TensorXf64(direction))
    changed = dr.forward_to(mi.render(scene, params)).numpy() * weight  # in single precision
    expected = sum(float((found[key] * direction).sum()) for key, direction in along.items())
    assert float(changed.sum()) == pytest.approx(expected, abs=1e-6 * np.abs(changed).sum())


@pytest.mark.slow
def test_trails(mi):
    """Stars that move by some two pixels: rate, focus and attitude; a stop in front, and one inside."""
    cases = {
        "star_camera_206mm": ((5e-5, -1e-4, 3e-4), 3e-7, ("camera.defocus_mm", 0, 2e-5)),
        "star_tracker_26mm": ((-1e-3, 2e-3, 0.0), 4e-6, ("camera.attitude_rad", 1, 4e-6)),
    }
    for lens, (rate, step, other) in cases.items():
        scene = scene_of(mi, lens)
        params = mi.traverse(scene)
        params["camera.rate_rad_per_s"] = mi.TensorXf64(np.array(rate))
        params.update()
        mi.render(scene)
        assert 1.0 < scene.sensors()[0].star_motion.length_px < 3.5
        check(mi, scene, [("camera.rate_rad_per_s", 0, step), other])


@pytest.mark.slow
def test_what_has_no_derivative_is_refused(mi):
    """OutlineSearch by Sobol points (no diffusion, a stop inside), and bodies in the same image."""
    import drjit as dr

    scene = scene_of(mi, "star_tracker_26mm", charge_diffusion_px=0.0)
    params = mi.traverse(scene)
    dr.enable_grad(params["stars.photon_rate"])
    image = mi.render(scene, params)
    with pytest.raises(Exception, match=r"star 0 has no derivative: its beam is sampled by sobol"):
        dr.backward(dr.sum(image, axis=None))


def test_numbers_that_a_surface_has_not(mi):
    """A plane has no curvature, a sphere no conic constant; a stop that stands alone is not tilted."""
    scene = scene_of(mi, "star_camera_206mm")
    params = mi.traverse(scene)
    for key, at, message in (
        ("camera.conic", 1, "is a sphere; it has no conic"),
        ("camera.tilt_deg", (0, 0), "is a separate stop"),
    ):
        value = np.array(params[key].numpy(), float)
        kept = value.copy()
        value[at] = 0.1
        params[key] = mi.TensorXf64(value)
        refuses(Exception, message, params.update)
        params[key] = mi.TensorXf64(kept)
