"""What the renderer is checked against: the same lenses by dense NumPy bundles and error functions, ray by ray."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.special import erf

from optics.lens_file import load_lens
from optics.light.band import TopHat, band_nodes
from optics.rays.paraxial import axial_paraxial
from optics.rays.trace import Rays, trace
from render.camera import Camera, launch_disk
from render.plugins.camera_properties import lens_camera_properties
from render.records import StarField

# columns, rows, pixel pitch [mm], part of the half-diagonal that gets light at all
GEOMETRY = {
    "star_camera_206mm": (4096, 2048, 5.5e-3, 0.98),
    "star_tracker_26mm": (1024, 1024, 10e-3, 0.96),
    "double_gauss_50mm": (2048, 2048, 10e-3, 0.85),
}


def camera_of(name="star_camera_206mm", *, fine=1, film=True, **changes):
    """Camera of a built-in lens, by rays; ``fine`` times smaller pixels. Diffusion is given in unrefined pixels.

    ``film=False`` leaves 8 x 8 px in the corner of the detector: truth does not need an image, and a test its memory.
    """
    lens = load_lens(name) if isinstance(name, str) else name
    width, height, pitch, _ = GEOMETRY[lens.name]
    settings = {
        "width_px": width * fine,
        "height_px": height * fine,
        "charge_diffusion_px": 0.18,
        "diffraction": "rays",
    }
    settings |= changes
    settings["charge_diffusion_px"] *= fine
    if not film:
        centre = np.array([settings["width_px"] - 1, settings["height_px"] - 1]) / 2
        settings |= {"width_px": 8, "height_px": 8, "centre_px": centre}
    return Camera(lens=lens, pixel_pitch_mm=pitch / fine, **settings)


def window(camera, size, x_px, y_px):
    """The same camera with a film of ``size`` px around a pixel of the old one."""
    centre = camera.centre_px - np.round([x_px - (size - 1) / 2, y_px - (size - 1) / 2])
    return replace(camera, width_px=size, height_px=size, centre_px=centre)


def focal_length_mm(camera):
    return float(axial_paraxial(camera.lens, camera.lens.design_wavelength_nm).efl_mm)


def stars_at(camera, x_px, y_px, *, bands=((600.0, 100.0),), nodes=3, rate=100.0, direction=None):
    """Stars near given pixels, with a flat spectrum through top-hat bands (centre, width) or as lines (centre, 0)."""
    if direction is None:
        x_px, y_px = np.broadcast_arrays(np.atleast_1d(x_px), np.atleast_1d(y_px))
        direction = camera.nominal_direction(x_px, y_px, focal_length_mm(camera))
        direction = direction @ camera.rotation_cam_from_world
    names = tuple(f"{centre:g}" for centre, _ in bands)
    if all(width == 0 for _, width in bands):
        wavelength, share = np.array([[centre] for centre, _ in bands]), np.ones((len(bands), 1))
    else:
        rule = band_nodes([TopHat(centre_nm=c, width_nm=w, edge_nm=0.05 * w, name=f"{c:g}") for c, w in bands], nodes)
        wavelength, share = rule.wavelength_nm, rule.weight_nm * rule.transmission
        share = share / share.sum(1, keepdims=True)
    flux = np.broadcast_to(np.asarray(rate, float), (len(direction),))
    return StarField(direction=direction, wavelength_nm=wavelength, photon_rate=flux[:, None, None] * share, band=names)


def bundle(camera, stars, star, band, *, rings=150, arms=240, stagger=False):
    """Landing points [px] and weights (share of the launched light) on a dense midpoint grid in (r^2, phi).

    Equal rings converge fast on a round clear pupil; where an edge cuts the bundle, ``stagger`` shifts every arm along
    the radius by a fraction of its own, so that no edge runs along a ring.
    """
    pupil, lens = launch_disk(camera), camera.focused_lens
    arm, ring = np.arange(arms), np.arange(rings)[:, None]
    shift = (arm * 0.7548776662466927) % 1.0 if stagger else 0.5
    radius = np.sqrt((ring + shift) / rings) * np.ones(arms)
    phi = 2 * np.pi * (arm + (ring * 0.6180339887498949) % 1.0) / arms
    d = camera.rotation_cam_from_world @ stars.direction[star]
    share = stars.photon_rate[star, band] * camera.response_at(stars.wavelength_nm[band])
    parts = []
    for wavelength, weight in zip(stars.wavelength_nm[band], share / share.sum(), strict=True):
        rays = Rays.create(
            x_mm=pupil.x_mm + pupil.radius_mm * (radius * np.cos(phi)).ravel(),
            y_mm=pupil.y_mm + pupil.radius_mm * (radius * np.sin(phi)).ravel(),
            z_mm=pupil.z_mm,
            direction=[d[0], -d[1], d[2]],
            wavelength_nm=wavelength,
        )
        out = trace(lens, rays)
        ok = out.status == 0
        x, y = out.x[ok] / camera.pixel_pitch_mm, out.y[ok] / camera.pixel_pitch_mm
        parts.append((camera.centre_px[0] + x, camera.centre_px[1] - y, np.full(ok.sum(), weight / radius.size)))
    return tuple(np.concatenate(column) for column in zip(*parts, strict=True))


def launched(camera, stars):
    """Light (n, b) of the launch disk that `bundle` counts in, in electrons of one second."""
    rate = (stars.photon_rate * camera.response_at(stars.wavelength_nm)).sum(2)
    towards = stars.direction @ camera.rotation_cam_from_world.T
    return rate * launch_disk(camera).area_mm2 * towards[:, 2:]


def pixel_integrals(x, y, weight, diffusion_px, first_column, first_row, size):
    """Light of Gaussians around the points, integrated over ``size`` x ``size`` pixels."""

    def along(points, first):
        edge = first - 0.5 + np.arange(size + 1)
        if diffusion_px == 0:
            return np.diff(points[:, None] < edge[None, :], axis=1).astype(float)
        return np.diff(0.5 * (1 + erf((edge[None, :] - points[:, None]) / (np.sqrt(2) * diffusion_px))), axis=1)

    return (along(y, first_row) * weight[:, None]).T @ along(x, first_column)


def path_image(mi, camera, contents, *, spp, seed=0, **sensor):
    """Irradiance (h, w) of a scene through the lens, by Mitsuba's own path integrator from the detector."""
    scene = {"type": "scene", "integrator": {"type": "path", "max_depth": 2}, **contents}
    scene["sensor"] = lens_camera_properties(camera, **sensor)
    return np.array(mi.render(mi.load_dict(scene), spp=spp, seed=seed), dtype=float)[..., 0]


def distant_ball(direction, angle_rad, distance_m=1e6):
    """A ball of unit radiance and an angular radius, far away."""
    light = {"type": "area", "radiance": {"type": "uniform", "value": 1.0}}
    return {
        "type": "sphere",
        "center": (direction * distance_m).tolist(),
        "radius": distance_m * angle_rad,
        "light": light,
    }


def mean_of(x, y, weight):
    return np.array([weight @ x, weight @ y]) / weight.sum()


@pytest.fixture(scope="session")
def bench():
    """The functions above."""
    functions = (
        bundle,
        camera_of,
        distant_ball,
        focal_length_mm,
        launched,
        mean_of,
        path_image,
        pixel_integrals,
        stars_at,
        window,
    )
    return SimpleNamespace(geometry=GEOMETRY, **{function.__name__: function for function in functions})


@pytest.fixture(scope="session", params=["llvm", pytest.param("cuda", marks=pytest.mark.cuda)])
def engine(request):
    """The processor, and a GPU where there is one."""
    from optics.errors import BackendError
    from render.engine import Engine

    try:
        return Engine.start(request.param)
    except BackendError as error:
        if request.param == "cuda":
            pytest.skip(str(error))
        raise


@pytest.fixture(scope="session")
def mi(engine):
    """Mitsuba with the plugins, on the engine."""
    from render.plugins.register import register_plugins

    register_plugins()
    return engine.mitsuba
