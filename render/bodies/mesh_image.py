r"""Image of a mesh in sunlight: Mitsuba's ``path`` integrator, backwards through ``lens_camera``.

Single scattering, the Sun a point. The image is the irradiance E on each pixel for a Sun of unit irradiance and a
surface of unit albedo; at every wavelength node of the band

.. math:: N = E\, a(\lambda)\, F_\odot(\lambda) r^{-2}\, w\, A_{pixel}\, t

with the albedo a, the Sun's photons at 1 au, its distance r in au, the weights w of filter, quadrature and the camera's
response, pixel area and exposure. Passes with independent random numbers are averaged until the standard error of the
mean is below the requested share of the photon noise, or the largest number of passes is reached.

Interreflections, a penumbra, and the gradient of sunlight over the body are neglected.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from optics.arrays import FloatArray
from optics.light.band import BandNodes
from render.bodies.sunlit_body import SunlitBody
from render.camera import Camera
from render.engine import Engine
from render.plugins.camera_properties import lens_camera_properties
from render.plugins.register import register_plugins

PASS_SAMPLES, PASSES, MOST_PASSES = 64, 8, 128
"""Rays per pixel, node and pass; passes that are made in any case; most of them."""


def mesh_image(
    camera: Camera,
    body: SunlitBody,
    rule: BandNodes,
    light: FloatArray,
    exposure_s: float,
    motion: tuple[FloatArray, float, float] | None,
    first_row: int,
    *,
    noise_share: float,
    ceiling_e: float,
    sequence: np.random.SeedSequence,
) -> tuple[FloatArray, FloatArray]:
    """Electrons (h, w, b) of a window before charge diffusion, and their standard error."""
    # light (b, k), motion (m, 3, 3)
    register_plugins()
    mi = Engine.active().mitsuba
    sensor = mi.load_dict(_sensor(camera, body, exposure_s, motion, first_row))
    scene = mi.load_dict({"type": "scene", **_scene(body)})
    integrator = mi.load_dict({"type": "path", "max_depth": 2})
    scale = light * (camera.pixel_pitch_mm**2 * exposure_s)
    total = np.zeros((camera.height_px, camera.width_px, len(rule.name)))
    square = np.zeros_like(total)
    seeds = sequence.generate_state(MOST_PASSES * light.size).reshape(MOST_PASSES, *light.shape)
    for passes in range(1, MOST_PASSES + 1):
        image = np.zeros_like(total)
        for band, node in np.ndindex(*light.shape):
            sensor.wavelength_nm = float(rule.wavelength_nm[band, node])
            seed = int(seeds[passes - 1, band, node])
            taken = mi.render(scene, sensor=sensor, integrator=integrator, spp=PASS_SAMPLES, seed=seed)
            image[..., band] += np.array(taken, dtype=float)[..., 0] * scale[band, node]
        total += image
        square += image**2
        if passes >= PASSES:
            mean = total / passes
            variance = np.maximum(square / passes - mean**2, 0.0) / (passes - 1)
            loud = (variance > noise_share * np.clip(mean, 1e-12, ceiling_e)) & (mean < 2.0 * ceiling_e)
            if not loud.any():
                break
    return mean, np.sqrt(variance)


def _sensor(
    camera: Camera, body: SunlitBody, exposure_s: float, motion: tuple[FloatArray, float, float] | None, first_row: int
) -> dict[str, Any]:
    """The camera in a scene whose origin is the body and whose unit is the body's radius."""
    mi = Engine.active().mitsuba
    position = -body.distance_km / body.radius_km * body.direction
    sensor = lens_camera_properties(
        camera,
        to_world=mi.ScalarTransform4f().translate(position.tolist()),
        scene_unit_mm=body.radius_km * 1e6,
        shutter_close=exposure_s,
    )
    if motion is not None:
        attitudes, duration_s, line_time_s = motion
        sensor |= {
            "motion_rotation": mi.TensorXf64(attitudes[None]),
            "motion_duration_s": duration_s,
            "line_time_s": line_time_s,
            "first_row": first_row,
        }
    return sensor


def _scene(body: SunlitBody) -> dict[str, Any]:
    """The body of unit albedo around the origin, and a Sun of unit irradiance."""
    mi = Engine.active().mitsuba
    assert body.mesh is not None
    kind = "diffuse" if body.law == "lambert" else "lunar_surface"
    bsdf = {"type": kind, "reflectance" if kind == "diffuse" else "albedo": {"type": "uniform", "value": 1.0}}
    matrix = np.eye(4)
    matrix[:3, :3] = body.rotation_icrs_from_body * (body.mesh_unit_km / body.radius_km)
    shape = {
        "type": Path(body.mesh).suffix.lower()[1:],
        "filename": str(body.mesh),
        "to_world": mi.ScalarTransform4f(matrix),
    }
    lights: dict[str, Any] = {"sun": {"type": "directional", "direction": (-body.to_sun).tolist(), "irradiance": 1.0}}
    if body.second_light is not None:
        towards, irradiance = body.second_light.towards, body.second_light.irradiance
        lights["second"] = {"type": "directional", "direction": (-towards).tolist(), "irradiance": irradiance}
    return {"body": {**shape, "bsdf": bsdf}, **lights}
