"""Makes the pictures of docs/diffraction.md: images by rays and by waves, and where rays are good enough.

Run from the repository root: ``python docs/make_diffraction_pictures.py`` (some two minutes; NumPy alone).
"""

from __future__ import annotations

import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.colors import BoundaryNorm, LogNorm

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from experiments.harness.plotting import figure_png, house_style
from optics.lens.perturb import refocus
from optics.lens_file import load_lens
from optics.rays.paraxial import stopped_down
from optics.rays.spots import trace_spots
from render.tracing.psf import ray_epsf, wave_images

FOLDER = Path(__file__).with_name("pictures")
LENS, PITCH_MM, WAVE_NM = "star_camera_206mm", 5.5e-3, 650.0
SIGMA_PX, CELLS, HALF_PX = 0.18, 8, 8
LEVELS = (-50, -20, -10, -5, -2, 2, 5, 10, 20, 50)


def wave_psf(lens, pitch_mm=PITCH_MM, field_deg=0.0, half_px=HALF_PX):
    """Light of pixels at 1/8 px steps from the centroid, by waves."""
    images = wave_images(
        lens,
        np.array([field_deg]),
        np.array([WAVE_NM]),
        pitch_mm=pitch_mm,
        diffusion_px=SIGMA_PX,
        oversampling=CELLS,
        half_size_px=half_px,
    )
    return images.psfs(np.ones(1))[0].values


def ray_psf(lens, pitch_mm=PITCH_MM, field_deg=0.0, half_px=HALF_PX):
    """The same by rays."""
    spots = trace_spots(lens, [field_deg], [0.0], [WAVE_NM], order=(64, 192))
    x, y = (v[0, 0] / pitch_mm for v in (spots.rays.x, -spots.rays.y))
    psf = ray_epsf(x, y, spots.area_mm2[0, 0], diffusion_px=SIGMA_PX, oversampling=CELLS, half_size_px=half_px)
    return psf.values


def s_curve(psf, window=5):
    """RMS error [px] of the centre of gravity in a window over all positions within a pixel."""
    middle, reach, grid = len(psf) // 2, window // 2 * CELLS, np.arange(window) - window // 2
    rows = slice(middle - reach, middle + reach + 1, CELLS)
    errors = []
    for shift in range(-CELLS // 2, CELLS // 2):
        image = psf[rows, middle - shift - reach : middle - shift + reach + 1 : CELLS]
        errors.append((image.sum(0) @ grid) / image.sum() - shift / CELLS)
    return float(np.sqrt(np.mean(np.square(errors))))


def images():
    """Images of a star on the axis and at 3.5 deg, in and out of focus, before pixels add their light up."""
    lens = load_lens(LENS)
    cases = [("on the axis", 0.0, 0.0), ("+10 µm", 0.0, 0.01), ("+40 µm", 0.0, 0.04), ("3.5°", 3.5, 0.0)]
    figure, axes = plt.subplots(2, len(cases), figsize=(8.6, 4.6), sharex=True, sharey=True, layout="constrained")
    for column, (words, field_deg, defocus_mm) in zip(axes.T, cases, strict=True):
        moved = refocus(lens, defocus_mm)
        for panel, psf_of in zip(column, (ray_psf, wave_psf), strict=True):
            psf = psf_of(moved, field_deg=field_deg)
            drawn = panel.imshow(
                np.maximum(psf, 1e-6), norm=LogNorm(1e-5, 1.0), extent=(-8.06, 8.06, 8.06, -8.06), cmap="magma"
            )
            panel.set(xlim=(-6, 6), ylim=(6, -6), xticks=(-5, 0, 5), yticks=(-5, 0, 5))
            panel.grid(False)
            panel.text(0.04, 0.04, f"peak {psf.max():.2f}", color="w", fontsize=7.5, transform=panel.transAxes)
        column[0].set_title(words, fontsize=9)
        column[1].set_xlabel("px")
    for panel, words in zip(axes[:, 0], ("rays", "waves"), strict=True):
        panel.set_ylabel(words)
    figure.colorbar(drawn, ax=axes, shrink=0.8, label="light in a pixel centred there")
    return figure


def where_rays_serve():
    """Brightest pixel and S-curve by waves over those by rays, against defocus, F-number and pixel."""
    pitches_um, numbers = (3.5, 5.5, 9.0), np.geomspace(2.95, 11.0, 9)
    defocus_um = np.concatenate([[0.0], np.geomspace(2.5, 120.0, 11)])
    bright = np.full((3, len(numbers), len(defocus_um)), np.nan)
    curve = np.full_like(bright, np.nan)
    lens = load_lens(LENS)
    for j, number in enumerate(numbers):
        stopped = lens if number < 3.0 else stopped_down(lens, float(number))
        for k, defocus in enumerate(defocus_um):
            moved = refocus(stopped, 1e-3 * float(defocus))
            for i, pitch_um in enumerate(pitches_um):
                half = 8 if defocus / number / pitch_um < 6 else 16
                rays, waves = (f(moved, pitch_mm=1e-3 * pitch_um, half_px=half) for f in (ray_psf, wave_psf))
                bright[i, j, k] = waves.max() / rays.max() - 1.0
                curve[i, j, k] = s_curve(waves) - s_curve(rays)
    figure, axes = plt.subplots(2, 3, figsize=(8.6, 5.2), sharex=True, sharey=True, layout="constrained")
    at = np.arange(len(defocus_um))
    for row, values, words in (
        (axes[0], 100.0 * bright, "brightest pixel,\nwaves over rays − 1 [%]"),
        (axes[1], 1e3 * curve, "S-curve RMS, CoG 5 × 5,\nwaves − rays [mpx]"),
    ):
        norm = BoundaryNorm(LEVELS, 256, extend="both")
        for panel, one in zip(row, values, strict=True):
            drawn = panel.pcolormesh(at, numbers, one, norm=norm, cmap="RdBu_r", shading="nearest")
            panel.set(yscale="log", yticks=(3, 4, 5.6, 8, 11), yticklabels=("3", "4", "5.6", "8", "11"))
            panel.set_xticks(at[::2], [f"{v:.3g}" for v in defocus_um[::2]])
            panel.minorticks_off()
            panel.grid(False)
        figure.colorbar(drawn, ax=row, label=words)
        row[0].set_ylabel("F-number")
    for panel, pitch_um in zip(axes[0], pitches_um, strict=True):
        panel.set_title(f"{pitch_um:g} µm pixels", fontsize=9)
    for panel in axes[1]:
        panel.set_xlabel("defocus [µm]")
    return figure


def main() -> None:
    """Draw both."""
    with house_style():
        for name, draw in (("rays_and_waves.png", images), ("where_rays_serve.png", where_rays_serve)):
            target = FOLDER / name
            target.write_bytes(figure_png(draw()))
            print(target.name, target.stat().st_size, "bytes")


if __name__ == "__main__":
    main()
