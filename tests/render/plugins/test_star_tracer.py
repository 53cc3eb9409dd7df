"""`star_tracer` as a citizen of Mitsuba: film, crop, sensors, scene files, and bodies that hide stars."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from star_emitters import film, star_emitter

from render.forward import StarRenderer, star_scene
from render.motion.trajectory import ConstantRate
from render.plugins.scene_files import save_scene
from render.tracing.motion.exposure import exposure_motion

RADIUS_MM = 35.0
"""Of the stop of the 206 mm lens, which stands in front of all glass at z = 0."""


@pytest.fixture
def camera(engine, bench):
    """A small film in the middle of the detector; world is cam."""
    return bench.window(bench.camera_of(), 80, 2047.5, 1023.5)


def unit(x, y):
    v = np.stack(np.broadcast_arrays(x, y, 1.0), axis=-1).reshape(-1, 3)
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


def stars_of(bench, camera, direction):
    """Stars in these directions in cam."""
    few = bench.stars_at(camera, np.full(len(direction), 40.0), np.full(len(direction), 40.0), nodes=1)
    return replace(few, direction=direction)


def test_crop_is_a_part_of_the_image(mi, bench, camera):
    scene = star_scene(camera, bench.stars_at(camera, [31.2, 47.9], [40.1, 44.3], bands=((500.0, 50.0), (800.0, 50.0))))
    whole = mi.render(mi.load_dict(scene)).numpy()
    part = {"crop_offset_x": 20, "crop_offset_y": 35, "crop_width": 40, "crop_height": 15}
    scene["camera"]["film"] |= part
    loaded = mi.load_dict(scene)
    image = mi.render(loaded)
    assert np.array_equal(image.numpy(), whole[35:50, 20:60])
    assert whole[35:50, 20:60].sum() > 0.5 * whole.sum()
    bitmap = loaded.sensors()[0].film().bitmap()
    assert [field.name for field in bitmap.struct_()] == ["Y", "500", "800"]
    on_film = np.array(bitmap)
    assert np.array_equal(on_film[..., 1:], image.numpy())
    assert on_film[..., 0] == pytest.approx(image.numpy().sum(-1), rel=1e-6)


@pytest.mark.slow
def test_every_sensor_has_its_image_and_truth(mi, bench, camera):
    """Two cameras see one field, each under its own attitude."""
    stars = bench.stars_at(camera, [40.0], [40.0], nodes=1)
    turned = replace(camera, rotation_cam_from_world=Rotation.from_rotvec([0.0, 2e-4, 0.0]).as_matrix())
    scene = star_scene(camera, stars)
    scene["second"] = star_scene(turned, stars)["camera"]
    loaded = mi.load_dict(scene)
    images = [mi.render(loaded, sensor=number).numpy() for number in (0, 1)]
    for image, sensor, own in zip(images, loaded.sensors(), (camera, turned), strict=True):
        expected = StarRenderer(own).render(stars)
        assert np.array_equal(image, expected.electrons)
        truth = loaded.integrator().traced_by(sensor).truth
        assert np.array_equal(truth.photon_x_px, expected.truth.photon_x_px)
    assert not np.array_equal(*images)


@pytest.mark.slow
def test_saved_scene_renders_to_the_same_bytes(mi, bench, camera, tmp_path):
    """Frames of one renderer, whose scene is kept up to date, against scenes that Mitsuba reads from files."""
    renderer = StarRenderer(camera, exposure_s=0.3, contents={"vane": vane(0.0)})
    path = ConstantRate(initial=Rotation.identity(), rate_rad_per_s=np.array([1e-4, 2e-4, 0.0]), end_s=1.0)
    motion = exposure_motion(path, start_s=0.0, exposure_s=0.3, camera=camera, line_time_s=1e-5)
    frames = (
        (
            bench.stars_at(camera, [52.0], [40.1]),
            {"rotation_cam_from_world": Rotation.from_rotvec([1e-4, 0, 0.1]).as_matrix()},
        ),
        (bench.stars_at(camera, [38.0], [40.1], bands=((500.0, 0.0), (800.0, 0.0))), {"motion": motion}),
    )
    for number, (stars, attitude) in enumerate(frames):
        expected = renderer.render(stars, **attitude).electrons
        files = renderer.save(tmp_path / f"frame_{number}.xml")
        assert {file.suffix for file in files} == {".xml", ".json", ".npz"}
        again = mi.render(mi.load_file(str(files[0]))).numpy()
        assert expected.sum() > 0
        assert again.tobytes() == expected.tobytes()


@pytest.mark.slow
def test_scenes_of_all_images_are_kept_on_request(mi, bench, camera, tmp_path, monkeypatch):
    """By an environment variable, so that any experiment does it; named by whoever knows the frame."""
    monkeypatch.setenv("STARBENCH_SCENES", str(tmp_path / "scenes"))
    renderer = StarRenderer(camera)
    renderer.label = "frame_000007"
    expected = renderer.render(bench.stars_at(camera, [40.2], [39.1], nodes=1)).electrons
    again = mi.render(mi.load_file(str(tmp_path / "scenes" / "frame_000007.xml"))).numpy()
    assert again.tobytes() == expected.tobytes()


def test_scene_of_properties_comes_back_from_a_file(mi, tmp_path):
    scene = {
        "type": "scene",
        "integrator": {"type": "star_tracer"},
        "sensor": {
            "type": "lens_camera", "lens": "star_camera_206mm", "pixel_pitch_um": 5.5, "charge_diffusion_um": 1.0,
            "rotation": mi.TensorXf64(np.eye(3)[None]), "film": film(30, 20),
        },
        "stars": star_emitter(unit(0.0, 0.0), [[500.0, 600.0]], [[[3.0, 4.0]]]),
    }  # fmt: skip
    expected = mi.render(mi.load_dict(scene)).numpy()
    files = save_scene(tmp_path / "own.xml", scene)
    assert [file.name for file in files] == ["own.xml", "own.stars.npz"]
    assert mi.render(mi.load_file(str(files[0]))).numpy().tobytes() == expected.tobytes()
    assert expected.sum() > 0


def vane(edge_mm, distance_mm=300.0):
    """A plate in front of the lens that covers x < edge in cam."""
    return {
        "type": "cube",
        "to_world": __import__("mitsuba")
        .ScalarTransform4f()
        .translate([edge_mm - 500.0, 0.0, distance_mm])
        .scale([500.0, 500.0, 1.0]),
    }


def below(edge_mm):
    """Share of the stop's disk at x < edge: a circular segment."""
    c = edge_mm / RADIUS_MM
    return 0.5 + (math.asin(c) + c * math.sqrt(1.0 - c * c)) / math.pi


@pytest.mark.parametrize("edge_mm", [-20.0, 0.0, 30.0])
def test_vane_takes_its_segment_of_the_pupil(mi, bench, camera, edge_mm):
    """On the axis and beside it, where the beam meets the vane (301 mm away) elsewhere."""
    slope = 0.0009
    stars = stars_of(bench, camera, unit(np.array([0.0, slope]), 0.0))
    clear = StarRenderer(camera).render(stars).truth
    truth = StarRenderer(camera, contents={"vane": vane(edge_mm)}).render(stars).truth
    # on the axis the near side of the plate counts, beside it the far side: the beam comes from there
    reach = np.array([edge_mm, edge_mm - slope * 299.0])
    expected = np.array([below(edge) for edge in reach])
    assert truth.electrons_hidden[:, 0] / clear.electrons_in[:, 0] == pytest.approx(expected, abs=2e-4)
    balance = truth.electrons_image + truth.electrons_vignetted + truth.electrons_off_edge + truth.electrons_hidden
    assert balance == pytest.approx(truth.electrons_in, rel=1e-9)


@pytest.mark.slow
def test_wire_is_found_between_the_points_of_a_quadrature(mi, bench, camera):
    """A wire of 1 mm across the aperture takes 4 w / (pi D) of the light."""
    wire = {"type": "cube", "to_world": mi.ScalarTransform4f().translate([3.3, 0, 50]).scale([0.5, 500.0, 0.5])}
    stars = bench.stars_at(camera, [39.5], [39.5], nodes=1)
    truth = StarRenderer(camera, contents={"wire": wire}).render(stars).truth
    share = truth.electrons_hidden[0, 0] / truth.electrons_in[0, 0]
    assert share == pytest.approx(below(3.8) - below(2.8), rel=3e-3)


def test_body_hides_what_is_behind_its_disk(mi, bench, camera):
    """A sphere of a known angular radius, a thousand kilometres away: stars beside it keep every bit of their light."""
    radius, far = 6e-4, 1e9
    ball = {"type": "sphere", "center": [0.0, 0.0, far], "radius": far * math.sin(radius)}
    angle = np.array([0.0, 5.9e-4, 6.1e-4, 8e-4])
    stars = stars_of(bench, camera, unit(np.tan(angle), 0.0))
    clear, image = StarRenderer(camera).render(stars), StarRenderer(camera, contents={"ball": ball}).render(stars)
    shown = image.truth.electrons_image / clear.truth.electrons_image
    assert shown[:, 0].tolist() == [0.0, 0.0, 1.0, 1.0]
    lone = StarRenderer(camera).render(replace(stars, direction=stars.direction[2:], photon_rate=stars.photon_rate[2:]))
    assert np.array_equal(image.electrons, lone.electrons)
    assert np.isnan(image.truth.photon_x_px[:2]).all()
    assert np.isfinite(image.truth.chief_x_px).all()


@pytest.mark.slow
def test_body_stands_still_in_the_sky_while_the_camera_turns(mi, bench, camera):
    """Under a motion of 40 px the sphere hides the star that is behind it from any attitude, and no other."""
    far, turn = 1e9, 40 * camera.pixel_pitch_mm / 206.2
    path = ConstantRate(initial=Rotation.identity(), rate_rad_per_s=np.array([0.0, turn, 0.0]), end_s=1.0)
    motion = exposure_motion(path, start_s=0.0, exposure_s=1.0, camera=camera)
    stars = stars_of(bench, camera, unit(np.array([0.0, 2.5e-4]), 0.0))
    ball = {"type": "sphere", "center": [0.0, 0.0, far], "radius": far * 1e-4}
    truth = StarRenderer(camera, contents={"ball": ball}).render(stars, motion=motion).truth
    clear = StarRenderer(camera).render(stars, motion=motion).truth
    assert truth.electrons_image[0, 0] == 0.0
    assert truth.electrons_image[1, 0] == pytest.approx(clear.electrons_image[1, 0], rel=1e-9)


def test_spacecraft_turns_under_the_sky_with_its_boom(mi, bench, camera):
    """`rotation` of a star field turns the stars against camera and bodies, which stay together."""
    turn = Rotation.from_rotvec([0.3, -0.2, 0.1]).as_matrix()
    stars = stars_of(bench, camera, unit(np.array([0.0, 0.0009]), 0.0))
    scene = star_scene(camera, stars, contents={"vane": vane(-10.0)})
    expected = mi.render(mi.load_dict(scene)).numpy()
    scene["stars"] |= {
        "direction": mi.TensorXf64((stars.direction @ turn)[None]),
        "rotation": mi.TensorXf64(turn[None]),
    }
    assert mi.render(mi.load_dict(scene)).numpy() == pytest.approx(expected, abs=1e-4 * float(expected.max()))


def test_bodies_and_stars_in_one_call(mi, bench, camera):
    """A glowing ball in front of a star, by `path`, and a star beside it: electrons of both on one film.

    The ball's light is radiance times the stop's area times its solid angle times the exposure, whatever the lens does
    with it, as long as it all lands on the film.
    """
    radius, far, radiance = 3e-4, 1e6, 7.0
    ball = {
        "type": "sphere", "center": [0.0, 0.0, far], "radius": far * math.sin(radius),
        "emitter": {"type": "area", "radiance": radiance},
    }  # fmt: skip
    stars = stars_of(bench, camera, unit(np.array([0.0, 0.0008]), 0.0))
    scene = star_scene(camera, stars, exposure_s=0.5, contents={"ball": ball})
    scene["integrator"]["bodies"] = {"type": "path", "max_depth": 2}
    both = mi.render(mi.load_dict(scene), spp=64).numpy().astype(float)
    alone = StarRenderer(camera, exposure_s=0.5, contents={"ball": ball}).render(stars)
    body = (both - alone.electrons).sum()
    etendue = math.pi * RADIUS_MM**2 * math.pi * math.sin(radius) ** 2
    assert alone.truth.electrons_image[0, 0] == 0.0
    assert body == pytest.approx(radiance * etendue * 0.5 * camera.response_at(stars.wavelength_nm)[0, 0], rel=5e-3)
