"""Makes docs/pictures/moon_through_the_lens.png: a crescent Moon with earthshine below the Pleiades, read out.

Run from the repository root: ``python docs/make_moon_picture.py`` (about a minute).

The Moon is a body in a Mitsuba scene (`docs/moon_model.py`), imaged by Mitsuba's own ``path`` integrator through
``lens_camera``: backwards through the 206 mm lens, at each wavelength node of the band. The stars go forwards through
the same lens with ``star_tracer``. Both are expectations in photo-electrons; their sum is read out by the detector
model, once for 0.1 s and once for 0.8 ms.

Star positions and magnitudes: Hipparcos, the new reduction (van Leeuwen 2007, A&A 474, 653); the fainter field stars
are drawn at random with star counts that double every 0.65 mag, 0.12 per square degree brighter than 6.5 mag.
Photometry: Sun V = -26.75 (Willmer 2018, ApJS 236, 47); the Moon's phase law is Allen's, see `docs/moon_model.py`.
"""

from __future__ import annotations

import io
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from docs.moon_model import MOON_RADIUS_KM, moon_scene
from optics.glass.coating import QuarterWave
from optics.lens_file import load_lens
from optics.light.band import BandNodes, TopHat, band_nodes
from optics.light.magnitudes import photon_rate
from optics.light.spectrum import Blackbody
from optics.rays.paraxial import axial_paraxial
from render.camera import Camera, build_camera
from render.detector.diffusion import diffuse
from render.detector.readout import expose
from render.detector.spec import Detector, load_detector
from render.engine import Engine
from render.engine.random import Streams
from render.forward import StarRenderer
from render.plugins.camera_properties import lens_camera_properties
from render.records import ExpectedImage, StarField

TARGET = Path(__file__).with_name("pictures") / "moon_through_the_lens.png"
PLEIADES = np.array(  # right ascension, declination [deg, J2000], V
    [
        (56.20084, 24.28958, 5.45), (56.21885, 24.11345, 3.72), (56.29053, 24.83937, 5.66), (56.30201, 24.46738, 4.30),
        (56.45664, 24.36786, 3.87), (56.47693, 24.55462, 5.76), (56.58150, 23.94846, 4.14), (56.87110, 24.10524, 2.85),
        (57.08669, 23.42136, 5.44), (57.29055, 24.05352, 3.62), (57.29668, 24.13683, 5.05),
    ]
)  # fmt: skip
MOON_DEG, BORESIGHT_DEG = (56.74, 23.36), (56.75, 23.95)
DISTANCE_KM = 384400.0
PHASE_DEG, SUN_POSITION_ANGLE_DEG = 125.0, 248.0
EXPOSURE_S, SHORT_S = 0.1, 0.0008
FAINTEST_V = 11.5
SUN = Blackbody(temperature_k=5772.0)
SUN_V = -26.75
WINDOW_PX, SAMPLES = 400, 60


def direction(right_ascension_deg: Any, declination_deg: Any) -> np.ndarray:
    """Unit vectors."""
    a, d = np.radians(right_ascension_deg), np.radians(declination_deg)
    return np.stack([np.cos(d) * np.cos(a), np.cos(d) * np.sin(a), np.sin(d)], axis=-1)


def north_up(right_ascension_deg: float, declination_deg: float) -> np.ndarray:
    """cam from icrs with north up, that is +X west, +Y south."""
    a, d = np.radians(right_ascension_deg), np.radians(declination_deg)
    west = np.array([np.sin(a), -np.cos(a), 0.0])
    south = np.array([np.sin(d) * np.cos(a), np.sin(d) * np.sin(a), -np.cos(d)])
    return np.stack([west, south, direction(right_ascension_deg, declination_deg)])


def make_camera(detector: Detector) -> Camera:
    """Coated lens in front of the mosaic, pointed at the Pleiades."""
    return build_camera(
        load_lens("star_camera_206mm"),
        detector,
        defocus_mm=0.01,
        coating=QuarterWave(design_wavelength_nm=550.0),
        rotation_cam_from_world=north_up(*BORESIGHT_DEG),
    )


def sky(nodes: BandNodes, rng: np.random.Generator) -> StarField:
    """The Pleiades and faint stars around them, those behind the Moon left out."""
    area_deg2 = 7.0 * 4.0
    count = rng.poisson(area_deg2 * 0.12 * 10 ** (0.46 * (FAINTEST_V - 6.5)))
    faint = FAINTEST_V + np.log10(rng.uniform(10 ** (0.46 * (6.5 - FAINTEST_V)), 1.0, count)) / 0.46
    x, y = rng.uniform(-3.5, 3.5, count), rng.uniform(-2.0, 2.0, count)
    v = direction(
        np.concatenate([PLEIADES[:, 0], BORESIGHT_DEG[0] + x / np.cos(np.radians(BORESIGHT_DEG[1]))]),
        np.concatenate([PLEIADES[:, 1], BORESIGHT_DEG[1] + y]),
    )
    magnitude = np.concatenate([PLEIADES[:, 2], faint])
    seen = v @ direction(*MOON_DEG) < np.cos(np.arcsin(MOON_RADIUS_KM / DISTANCE_KM))
    rate = photon_rate(Blackbody(temperature_k=11000.0), magnitude[seen], wavelength_nm=nodes.wavelength_nm)
    return StarField(
        direction=v[seen],
        wavelength_nm=nodes.wavelength_nm,
        photon_rate=rate * nodes.weight_nm * nodes.transmission,
        band=nodes.name,
    )


def moon(camera: Camera, nodes: BandNodes) -> tuple[np.ndarray, tuple[int, int]]:
    """Photo-electrons per second of the Moon's window, and its first column and row."""
    mi = Engine.start("auto").mitsuba
    towards = direction(*MOON_DEG)
    seen = camera.rotation_cam_from_world @ towards
    focal = float(axial_paraxial(camera.lens, camera.lens.design_wavelength_nm).efl_mm)
    middle = camera.centre_px + seen[:2] / seen[2] * focal / camera.pixel_pitch_mm
    column, row = (round(float(v)) - WINDOW_PX // 2 for v in middle)
    window = replace(
        camera, width_px=WINDOW_PX, height_px=WINDOW_PX, centre_px=camera.centre_px - np.array([column, row])
    )
    bodies = moon_scene(towards, north_up(*MOON_DEG), PHASE_DEG, SUN_POSITION_ANGLE_DEG)
    electrons = np.zeros((WINDOW_PX, WINDOW_PX))
    sun = photon_rate(SUN, SUN_V, wavelength_nm=nodes.wavelength_nm) * nodes.weight_nm * nodes.transmission
    for node, (wavelength, rate) in enumerate(zip(nodes.wavelength_nm[0], sun[0], strict=True)):
        sensor = lens_camera_properties(
            window,
            to_world=mi.ScalarTransform4f().translate((-DISTANCE_KM * towards).tolist()),
            scene_unit_mm=1e6,
            wavelength_nm=float(wavelength),
        )
        scene = mi.load_dict({"type": "scene", "sensor": sensor, **bodies})
        image = mi.render(scene, integrator=mi.load_dict({"type": "path", "max_depth": 2}), spp=SAMPLES, seed=node)
        irradiance = np.array(image, dtype=float)[..., 0]  # of a Sun with unit irradiance
        response = float(camera.response_at(np.array(wavelength)))
        electrons += irradiance * rate * response * camera.pixel_pitch_mm**2
    return diffuse(electrons, camera.charge_diffusion_px).astype(float), (column, row)


def frames() -> tuple[np.ndarray, np.ndarray, tuple[int, int], ExpectedImage]:
    """Long and short frame above their offset [DN], corner of the Moon's window, the stars alone."""
    detector = load_detector("acc18_mosaic")
    camera = make_camera(detector)
    nodes = band_nodes([TopHat(centre_nm=675.0, width_nm=350.0, edge_nm=20.0, name="500-850 nm")], 5)
    stars = StarRenderer(camera, exposure_s=EXPOSURE_S).render(sky(nodes, np.random.default_rng(3)))
    rate, (column, row) = moon(camera, nodes)
    allen = -12.73 + 0.026 * PHASE_DEG + 4e-9 * PHASE_DEG**4
    print(f"Moon: {SUN_V - 2.5 * np.log10(rate.sum() / total_sun(camera, nodes)):.2f} mag; Allen V = {allen:.2f}")
    expected = stars.electrons[..., 0].astype(float) / EXPOSURE_S
    expected[row : row + WINDOW_PX, column : column + WINDOW_PX] += rate
    dn = [
        expose(
            (expected * seconds).astype(np.float32),
            detector,
            streams=Streams(7),
            frame=number,
            exposure_s=seconds,
            temperature_c=0.0,
            band="500-850 nm",
        ).dn
        - detector.offset_dn
        for number, seconds in enumerate((EXPOSURE_S, SHORT_S))
    ]
    return dn[0], dn[1], (column, row), stars


def total_sun(camera: Camera, nodes: BandNodes) -> float:
    """Electrons per second that the Sun itself would give through this pupil."""
    rate = photon_rate(SUN, SUN_V, wavelength_nm=nodes.wavelength_nm) * nodes.weight_nm * nodes.transmission
    return float((rate * camera.response_at(nodes.wavelength_nm)).sum() * np.pi * 35.0**2)


def draw(long: np.ndarray, short: np.ndarray, corner: tuple[int, int], stars: ExpectedImage) -> None:
    """Three panels: the long frame pixel by pixel, the crescent in the short one, a star's pixels with its truth."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(12.6, 10.3), dpi=100, facecolor="black")
    wide = figure.add_axes((0.0, 0.0, 760 / 1260, 1000 / 1030))
    crescent = figure.add_axes((785 / 1260, 540 / 1030, 460 / 1260, 460 / 1030))
    pixels = figure.add_axes((785 / 1260, 10 / 1030, 460 / 1260, 480 / 1030))
    column, row = corner
    left, top = column + WINDOW_PX // 2 - 380, row + WINDOW_PX + 10 - 1000
    view = np.clip(long[top : top + 1000, left : left + 760] - 6.0, 0, None)
    wide.imshow(np.arcsinh(view / 25.0), cmap="gray", vmin=0.0, vmax=np.arcsinh(40.0), interpolation="nearest")
    near = np.clip(short[row + 20 : row + WINDOW_PX - 20, column + 20 : column + WINDOW_PX - 20], 0, None)
    crescent.imshow(near**0.55, cmap="gray", vmin=4.0, vmax=np.quantile(near, 0.999) ** 0.55)
    title = draw_star(pixels, long, stars)
    for axes, text in (
        (wide, f"{EXPOSURE_S:g} s: the Pleiades, earthshine on the Moon, the crescent saturated"),
        (crescent, f"the crescent in {1e3 * SHORT_S:g} ms"),
        (pixels, title),
    ):
        axes.set_title(text, color="0.8", fontsize=11.5, pad=8)
        axes.set_xticks([])
        axes.set_yticks([])
        axes.spines[:].set_visible(False)
    save(figure)


def save(figure: Any) -> None:
    """As a PNG with a palette: noise does not compress in full colour."""
    memory = io.BytesIO()
    figure.savefig(memory, facecolor="black")
    TARGET.parent.mkdir(exist_ok=True)
    Image.open(memory).convert("RGB").quantize(128, dither=Image.Dither.NONE).save(TARGET, optimize=True)


def draw_star(axes: Any, long: np.ndarray, stars: ExpectedImage) -> str:
    """Pixels around a star of some 15 000 electrons, and where its light really lies; returns a title."""
    truth = stars.truth
    assert truth is not None
    inside = (np.abs(truth.photon_x_px[:, 0] - 2048) < 1800) & (np.abs(truth.photon_y_px[:, 0] - 700) < 600)
    star = int(np.argmin(np.where(inside, np.abs(truth.electrons_image[:, 0] - 15000), np.inf)))
    x, y = truth.photon_x_px[star, 0], truth.photon_y_px[star, 0]
    column, row, half = round(float(x)), round(float(y)), 5
    stamp = long[row - half : row + half + 1, column - half : column + half + 1]
    axes.imshow(np.clip(stamp, 0, None) ** 0.5, cmap="magma")
    axes.plot([x - column + half], [y - row + half], "+", color="white", ms=22, mew=3.0)
    axes.plot([x - column + half], [y - row + half], "+", color="black", ms=18, mew=1.2)
    return f"a star of {truth.electrons_image[star, 0]:.0f} electrons, in truth at ({x:.3f}, {y:.3f})"


def main() -> None:
    """Render, read out, draw."""
    long, short, corner, stars = frames()
    draw(long, short, corner, stars)
    print(f"wrote {TARGET.relative_to(Path(__file__).resolve().parents[1])}, {TARGET.stat().st_size / 1e3:.0f} kB")


if __name__ == "__main__":
    main()
