"""One sensor three times: the camera report, a calculation by hand, and GalSim's images measured by photutils.

    python benchmarks/sensor_by_hand.py

An ideal lens of 35 mm, F/1.8 on a CMV4000. By hand: published zero point and pass band, black body, Gaussian spots, the
formula of Thompson et al. 2002. GalSim draws Airy disk, spot and charge diffusion with noise; photutils fits the PSF
and finds peaks of the filtered image. Electrons and noise of GalSim's stars are those by hand.
"""

from __future__ import annotations

import math
import sys
import warnings
from pathlib import Path

import galsim
import numpy as np
from astropy.table import Table
from photutils.detection import find_peaks
from photutils.psf import ImagePSF, PSFPhotometry
from scipy import constants
from scipy.ndimage import gaussian_filter

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from experiments.camera.settings import CameraReportConfig
from experiments.laboratory.sensor_prediction import predict_camera
from render.detector.spec import load_detector

FOCAL_MM, STOP, SPOT_UM, TRANSMISSION, EXPOSURE_S, STRAY_E_PER_S = 35.0, 1.8, 4.0, 0.8, 0.1, 500.0
MAG, KELVIN, LOW_NM, HIGH_NM, THRESHOLD, DARK_FRAMES, CHIP_C = 6.0, 5800.0, 500.0, 800.0, 5.0, 20, 0.0
G_ZERO_W_M2_NM, G_BAND = 2.50386e-11, Path(__file__).parents[1] / "optics/data/bands/gaia_g_dr3.csv"
"""Photon-weighted mean flux of G = 0 and its pass band: Gaia EDR3 (Riello et al. 2021), SVO Filter Profile Service."""
SIDE, STAMP, OVERSAMPLING, SEED = 30, 31, 5, 1
STAR, PIXEL = "electrons of a star of 6 mag", "noise of a pixel [e-]"


def by_camera() -> dict[str, float]:
    """Numbers of the camera report."""
    lens = {"kind": "ideal", "focal_length_mm": FOCAL_MM, "f_number": STOP, "spot_um": SPOT_UM}
    chip = {"detector": "cmv4000", "width_px": 1024, "height_px": 1024, "exposure_s": EXPOSURE_S}
    found = predict_camera(
        CameraReportConfig(
            instrument={"lens": {**lens, "transmission": TRANSMISSION}, **chip, "chip_temperature_c": CHIP_C},
            passband={"range_nm": [LOW_NM, HIGH_NM]},
            background_e_per_s=STRAY_E_PER_S,
            threshold_sigma=THRESHOLD,
            dark_frames=DARK_FRAMES,
            star={"magnitude_mag": MAG, "temperature_k": KELVIN},
            sky={"attitudes": 10},
        )
    )
    noise, pixel = found.processing.frame, found.pixel
    return {
        STAR: found.value("electrons_e"),
        "light and dark charge in a pixel [e-]": noise.background_e + pixel.dark_e,
        PIXEL: math.sqrt(noise.empty_e2),
        "signal-to-noise ratio": found.value("snr"),
        "NEA [arcsec]": found.value("nea_arcsec"),
        "limiting magnitude [mag]": found.value("limiting_magnitude_mag"),
    }


def planck(wave_nm: np.ndarray) -> np.ndarray:
    """Black body per wavelength, up to a factor."""
    return wave_nm**-5 / np.expm1(constants.h * constants.c / (wave_nm * 1e-9 * constants.k * KELVIN))


def by_hand() -> dict[str, float]:
    """The same with pencil and paper: `by_camera`, and what GalSim draws with."""
    chip = load_detector("cmv4000")
    table = np.genfromtxt(G_BAND, delimiter=",", comments="#")
    every, through = table[np.isfinite(table).all(axis=1)].T
    mean = np.trapezoid(planck(every) * every * through, every) / np.trapezoid(every * through, every)  # of photons
    wave = np.linspace(LOW_NM, HIGH_NM, 301)
    flux = G_ZERO_W_M2_NM * 10.0 ** (-0.4 * MAG) * planck(wave) / mean  # W/(m^2 nm)
    photons = flux * wave * 1e-9 / (constants.h * constants.c)
    efficiency = np.interp(wave, chip.quantum_efficiency.wavelength_nm, chip.quantum_efficiency.value)
    pupil_m2 = 0.25 * math.pi * (1e-3 * FOCAL_MM / STOP) ** 2
    electrons = float(np.trapezoid(photons * efficiency, wave)) * TRANSMISSION * pupil_m2 * EXPOSURE_S
    dark = chip.dark_current_e_per_s * 2.0 ** ((CHIP_C - chip.dark_reference_c) / chip.dark_doubling_c) * EXPOSURE_S
    read2 = chip.read_noise_e**2 * (1.0 + chip.read_noise_spread**2)
    light = STRAY_E_PER_S * EXPOSURE_S
    pixel2 = light + (dark + read2 + 1.0 / (12.0 * chip.gain_dn_per_e**2)) * (1.0 + 1.0 / DARK_FRAMES)
    pitch_um, airy_um = 1e3 * chip.pixel_pitch_mm, 0.42 * 0.62 * STOP  # Gaussian nearest to an Airy disk at 620 nm
    blur_um = math.hypot(SPOT_UM / math.sqrt(2.0), 1e3 * chip.diffusion_sigma_mm, airy_um, pitch_um / math.sqrt(12.0))
    sigma = blur_um / pitch_um
    arcsec = math.degrees(chip.pixel_pitch_mm / FOCAL_MM) * 3600.0
    lit = 4.0 * math.pi * sigma**2 * pixel2
    across = math.sqrt(sigma**2 / electrons + 8.0 * math.pi * sigma**4 * pixel2 / electrons**2)
    return {
        STAR: electrons,
        "light and dark charge in a pixel [e-]": light + dark,
        PIXEL: math.sqrt(pixel2),
        "signal-to-noise ratio": electrons / math.sqrt(electrons + lit),
        "NEA [arcsec]": across * arcsec,
        "limiting magnitude [mag]": MAG + 2.5 * math.log10(electrons / (THRESHOLD * math.sqrt(lit))),
        "arcsec": arcsec,
        "sigma": sigma,
    }


def by_images(hand: dict[str, float]) -> dict[str, float]:
    """GalSim's stars on GalSim's noise: PSF fits and detections of photutils."""
    side, chip = SIDE, load_detector("cmv4000")
    pitch_um, light, rng = 1e3 * chip.pixel_pitch_mm, STRAY_E_PER_S * EXPOSURE_S, np.random.default_rng(SEED)
    airy = galsim.Airy(lam_over_diam=0.62 * STOP / pitch_um)
    spot = galsim.Gaussian(sigma=SPOT_UM / math.sqrt(2.0) / pitch_um)
    optics = galsim.Convolve(airy, spot, galsim.Gaussian(sigma=1e3 * chip.diffusion_sigma_mm / pitch_um))
    seen = galsim.Convolve(optics, galsim.Pixel(1.0))
    fine = seen.drawImage(nx=STAMP * OVERSAMPLING, ny=STAMP * OVERSAMPLING, scale=1.0 / OVERSAMPLING, method="no_pixel")
    psf = ImagePSF(fine.array * OVERSAMPLING**2, oversampling=OVERSAMPLING)
    middle = (np.arange(side) + 0.5) * STAMP - 0.5
    x, y = (v.ravel() + rng.uniform(-0.5, 0.5, side**2) for v in np.meshgrid(middle, middle))

    def frame(electrons: float, number: int) -> np.ndarray:
        image = galsim.ImageD(side * STAMP, side * STAMP, xmin=0, ymin=0)
        for at in zip(x, y, strict=True):
            stamp = optics.withFlux(electrons).drawImage(nx=STAMP, ny=STAMP, scale=1.0, center=galsim.PositionD(*at))
            image[stamp.bounds & image.bounds] += stamp[stamp.bounds & image.bounds]
        dice = galsim.BaseDeviate(SEED + number)
        image.addNoise(galsim.PoissonNoise(dice, sky_level=light))
        image.addNoise(galsim.GaussianNoise(dice, math.sqrt(hand[PIXEL] ** 2 - light)))
        return np.asarray(image.array)

    bright = frame(hand[STAR], 1)
    start = Table({"x_0": x, "y_0": y, "flux_0": np.full(side**2, hand[STAR])})
    fitted = PSFPhotometry(psf, (13, 13))(bright, error=np.sqrt(np.maximum(bright, 0.0) + 14.0**2), init_params=start)
    off = np.stack([fitted["x_fit"] - x, fitted["y_fit"] - y])
    empty = frame(1e-9, 2)
    limit = THRESHOLD * gaussian_filter(empty, hand["sigma"]).std()
    magnitude, share = hand["limiting magnitude [mag]"] + np.linspace(-0.8, 0.8, 9), []
    for number, mag in enumerate(magnitude):
        faint = frame(hand[STAR] * 10.0 ** (-0.4 * (mag - MAG)), 3 + number)
        found = find_peaks(gaussian_filter(faint, hand["sigma"]), limit, box_size=3)
        near = np.hypot(x[:, None] - found["x_peak"], y[:, None] - found["y_peak"]).min(axis=1) < 2.0
        share.append(near.mean())
    return {
        PIXEL: float(empty.std()),
        "signal-to-noise ratio": float(np.mean(fitted["flux_fit"]) / np.std(fitted["flux_fit"])),
        "NEA [arcsec]": float(np.std(off)) * hand["arcsec"],
        "limiting magnitude [mag]": float(np.interp(-0.5, -np.array(share), magnitude)),
    }


if __name__ == "__main__":
    warnings.simplefilter("ignore")  # of fits near the edge of a frame
    camera, hand = by_camera(), by_hand()
    images = by_images(hand)
    print("| quantity | camera report | by hand | GalSim and photutils |\n|---|---|---|---|")
    for name, value in camera.items():
        print(f"| {name} | {value:.4g} | {hand[name]:.4g} | {f'{images[name]:.4g}' if name in images else '–'} |")
