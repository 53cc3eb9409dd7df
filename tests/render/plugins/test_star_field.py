"""`star_field` as a light of stock integrators: radiance of a plane that it lights, noise, files, variants."""

import math

import numpy as np
import pytest
from star_emitters import film, star_emitter

from render.plugins.star_field import save_star_field
from render.records import StarField

ALBEDO = 0.4
WAVELENGTH = np.array([[500.0, 520.0], [600.0, 620.0]])
DIRECTION = np.array([[0.0, 0.0, 1.0], [0.6, 0.0, 0.8], [0.0, -0.8, 0.6]])
RATE = np.array([3.0, 5.0, 2.0])
PHOTONS = RATE[:, None, None] * np.array([[0.1, 0.2], [0.3, 0.4]])


def stars(**properties):
    return star_emitter(DIRECTION, WAVELENGTH, PHOTONS) | properties


def lit_plane(**more):
    """A Lambertian plane z = 0, seen from above."""
    import mitsuba as mi

    return {
        "type": "scene",
        "sensor": {
            "type": "perspective",
            "fov": 10.0,
            "to_world": mi.ScalarTransform4f().look_at(origin=[0, 0, 5], target=[0, 0, 0], up=[0, 1, 0]),
            "film": film(8, 8),
        },
        "plane": {
            "type": "rectangle",
            "to_world": mi.ScalarTransform4f().scale([3.0, 3.0, 1.0]),
            "bsdf": {"type": "diffuse", "reflectance": {"type": "uniform", "value": ALBEDO}},
        },
    } | more


RADIANCE = ALBEDO / math.pi * float(RATE @ DIRECTION[:, 2])
"""Lambert: what comes down per area, times albedo, over pi."""


@pytest.mark.parametrize("integrator", ["path", pytest.param("ptracer", marks=pytest.mark.slow)])
def test_lambertian_plane_under_stars(mi, integrator):
    """The light tracer's error is 0.64 % (standard deviation over six seeds); the default seed is 0."""
    field = stars(scene_radius=5.0)  # holds the corners of the plane, at 4.2
    scene = mi.load_dict(lit_plane(stars=field, integrator={"type": integrator}))
    samples = 60000 if integrator == "ptracer" else 400
    image = np.array(mi.render(scene, spp=samples))[..., 0]
    assert image.mean() == pytest.approx(RADIANCE, rel=5e-3 if integrator != "ptracer" else 2e-2)


def test_one_star_is_free_of_noise(mi):
    one = {"direction": mi.TensorXf64(DIRECTION[None, 1:2]), "photon_rate": mi.TensorXf64(np.full((1, 1, 2, 2), 1.25))}
    scene = mi.load_dict(lit_plane(stars=stars(**one), integrator={"type": "path"}))
    image = np.array(mi.render(scene, spp=1))[..., 0]
    assert image == pytest.approx(np.full((8, 8), ALBEDO / math.pi * 5.0 * 0.8), rel=1e-5)


def test_stars_cast_shadows(mi):
    """A plate over the plane takes the light of the two stars beside which it stands, and leaves the third."""
    plate = {"type": "rectangle", "to_world": mi.ScalarTransform4f().translate([1.5, 0, 2.0]).scale([1.0, 1.0, 1.0])}
    scene = mi.load_dict(lit_plane(stars=stars(), plate=plate, integrator={"type": "path"}))
    image = np.array(mi.render(scene, spp=400))[..., 0]
    left = RATE.copy()
    left[1] = 0.0  # 2 m up and 1.5 m aside: where (0.6, 0, 0.8) comes from
    assert image.mean() == pytest.approx(ALBEDO / math.pi * float(left @ DIRECTION[:, 2]), rel=2e-2)


def test_stars_add_no_noise_to_what_other_lights_do(mi):
    """Never picked beside another light, bit for bit; picked as often as one with sampling_weight 1."""
    lights = {
        "sun": {"type": "directional", "direction": [0, 0, -1], "irradiance": 2.0},
        "integrator": {"type": "path"},
    }
    images = [
        np.array(mi.render(mi.load_dict(lit_plane(**lights, **more)), spp=16))[..., 0]
        for more in ({}, {"stars": stars()}, {"stars": stars(sampling_weight=1.0)})
    ]
    assert np.array_equal(images[0], images[1])
    assert images[2].mean() == pytest.approx(RADIANCE + ALBEDO / math.pi * 2.0, rel=0.05)


def test_ptracer_needs_to_know_how_large_the_scene_is(mi):
    """Without a radius stars give it no light, which a warning says; light of another scene is not touched by that.

    Dr.Jit traces the methods of all emitters that are alive, in whatever scene: one that raises stops others, and
    fields that other tests left alive warn as well.
    """
    said = []

    class Listener(mi.Appender):
        def append(self, level, text):
            said.append(text)

    listener = Listener()
    mi.logger().add_appender(listener)
    try:
        unknown = mi.load_dict(lit_plane(unplaced=stars(sampling_weight=1.0), integrator={"type": "ptracer"}))
        sun = {"type": "directional", "direction": [0, 0, -1], "irradiance": 2.0}
        other = mi.load_dict(lit_plane(sun=sun, integrator={"type": "ptracer"}))
        lit = np.array(mi.render(other, spp=20000))[..., 0]
        dark = np.array(mi.render(unknown, spp=1))
    finally:
        mi.logger().remove_appender(listener)
    assert lit.mean() == pytest.approx(ALBEDO / math.pi * 2.0, rel=4e-2)
    assert not dark.any()
    of_it = [text for text in said if "'unplaced' adds no light" in text]
    assert len(of_it) == 1
    assert "give scene_centre and scene_radius" in of_it[0]


def test_field_from_files(mi, tmp_path):
    """XML, dictionary and tensors light alike."""
    save_star_field(
        tmp_path / "stars.npz",
        StarField(direction=DIRECTION, wavelength_nm=WAVELENGTH, photon_rate=PHOTONS, band=("one, wide", "two")),
    )
    xml = tmp_path / "scene.xml"
    xml.write_text('<scene version="3.0.0"><emitter type="star_field"><string name="filename" value="stars.npz"/>'
                   '<string name="rotation" value="0 1 0 1 0 0 0 0 -1"/></emitter></scene>')  # fmt: skip
    (field,) = mi.load_file(str(xml)).emitters()
    assert str(field) == "StarField[stars=3, bands=one, wide, two]"
    assert np.array_equal(field.stars.photon_rate, PHOTONS)
    assert np.array_equal(field.world_from_stars @ DIRECTION[1], [0.0, 0.6, -0.8])
    named = mi.load_dict({"type": "star_field", "filename": str(tmp_path / "stars.npz")})
    assert np.array_equal(named.stars.direction, DIRECTION)


@pytest.mark.slow
@pytest.mark.parametrize("suffix", ["ad_rgb", "ad_spectral_polarized"])
def test_light_in_other_variants(mi, suffix):
    """Grey in colour; in spectral variants the density integrates to the photons of the bands."""
    from render.engine import Engine
    from render.plugins.register import register_plugins

    backend = mi.variant().split("_")[0]
    try:
        Engine.start(backend, suffix=suffix)
        register_plugins()
        scene = mi.load_dict({"type": "scene", "stars": stars()})
        it = dr_interaction(mi, np.arange(470.0, 650.0, 0.25) if "spectral" in suffix else None)
        ds, _ = scene.emitters()[0].sample_direction(it, mi.Point2f(0.0, 0.5))
        value = scene.emitters()[0].eval_direction(it, ds)
        value = np.array(value[0][0][0] if "polarized" in suffix else value[0], float)
        total = value.sum() * 0.25 if "spectral" in suffix else value[0]
        assert total == pytest.approx(RATE[0], rel=2e-2 if "spectral" in suffix else 1e-6)
    finally:
        Engine.start(backend)


def dr_interaction(mi, wavelength_nm):
    import drjit as dr

    it = dr.zeros(mi.SurfaceInteraction3f, 1 if wavelength_nm is None else len(wavelength_nm))
    if wavelength_nm is not None:
        it.wavelengths = mi.Color0f() if not mi.is_spectral else mi.UnpolarizedSpectrum(mi.Float(wavelength_nm))
    return it
