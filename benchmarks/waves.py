"""Diffraction: what it changes for a star of the 206 mm lens, and what it costs, beside other codes in the same run.

python benchmarks/waves.py             # tables of docs/diffraction.md
python benchmarks/waves.py --speed     # terms per second, frames per second; batoid if it is there
"""

from __future__ import annotations

import argparse
import time
from dataclasses import replace

import numpy as np

from optics.frames import field_direction
from optics.lens_file import load_lens
from optics.waves.pupil_field import trace_pupil
from render.camera import Camera
from render.records import StarField
from render.tracing.psf import render_epsf
from render.tracing.tracer import Tracer
from render.tracing.wave_grid_build import build_grid

LENS, PITCH_MM, SIGMA_PX = "star_camera_206mm", 5.5e-3, 0.18
FOCAL_MM = 206.237


def camera_of(size=64, **changes):
    """Camera of the 206 mm lens."""
    lens = load_lens(LENS)
    return Camera(lens=lens, width_px=size, height_px=size, pixel_pitch_mm=PITCH_MM,
                  charge_diffusion_px=SIGMA_PX, **changes)  # fmt: skip


def star(wavelength_nm, field_deg=0.0):
    """One star at a field angle, of one wavelength or of several alike."""
    waves = np.atleast_1d(np.asarray(wavelength_nm, float))[None]
    return StarField(direction=field_direction(field_deg, 0.0)[None], wavelength_nm=waves,
                     photon_rate=np.ones((1, *waves.shape)), band=("b",))  # fmt: skip


def epsf(camera, stars):
    """Light of a pixel at 1/8 px steps from the centroid."""
    return render_epsf(Tracer(camera), stars, half_size_px=9)[0][0].values


def phases(psf, count):
    """Images (64, count, count) of a star at 8 x 8 positions within a pixel; where it stands in each."""
    middle, reach = psf.shape[0] // 2, count // 2 * 8
    for dy in range(-4, 4):
        for dx in range(-4, 4):
            rows, columns = (slice(middle - d - reach, middle - d + reach + 1, 8) for d in (dy, dx))
            yield dx / 8.0, psf[rows, columns]


def s_curve(psf, count=5):
    """RMS error [px] of the centre of gravity in a window over all positions within a pixel."""
    grid = np.arange(count) - count // 2
    errors = [(image.sum(0) @ grid) / image.sum() - x for x, image in phases(psf, count)]
    return float(np.sqrt(np.mean(np.square(errors))))


def changes():
    """Brightest pixel, light in windows and S-curve on the axis, by rays and by waves."""
    print(
        "| defocus | brightest pixel | | light in 5 x 5 px | | light in 17 x 17 px | | S-curve, CoG 5 x 5, RMS [px] | |"
    )
    print("|---|---|---|---|---|---|---|---|---|")
    print("| [um] | rays | waves | rays | waves | rays | waves | rays | waves |")
    for defocus_um in (0.0, 3.2, 10.0, 20.0, 40.0, 80.0):
        cells = []
        for how in ("rays", "waves"):
            camera = camera_of(defocus_mm=1e-3 * defocus_um, diffraction=how)
            psf = epsf(camera, star(np.linspace(600.0, 700.0, 5)))
            middle = psf.shape[0] // 2
            boxes = [psf[middle - r : middle + r + 1 : 8, middle - r : middle + r + 1 : 8].sum() for r in (16, 64)]
            cells.append([f"{psf.max():.3f}", *(f"{box:.4f}" for box in boxes), f"{s_curve(psf):.4f}"])
        print(f"| {defocus_um:g} |" + "|".join(f" {a} | {b} " for a, b in zip(*cells, strict=True)) + "|")


def colour():
    """Shift of a star at 3.5 deg from 600 to 800 nm: mean of the rays, and as a window sees it."""
    print("\n| 600 -> 800 nm at 3.5 deg [px] | rays | waves |\n|---|---|---|")
    shift = {}
    for how in ("rays", "waves"):
        camera = camera_of(diffraction=how)
        tracer = Tracer(camera)
        mean, seen = [], []
        for wave in (600.0, 800.0):
            mean.append(tracer.bundle_means(star(wave, 3.5))[0, 0, 0])
            psf = render_epsf(tracer, star(wave, 3.5), half_size_px=9)[0][0].values
            grid = np.arange(5) - 2.0
            biases = [(image.sum(0) @ grid) / image.sum() - x for x, image in phases(psf, 5)]
            seen.append(mean[-1] + np.mean(biases))
        shift[how] = (mean[1] - mean[0], seen[1] - seen[0])
    for i, name in enumerate(("mean of all light", "centre of gravity in 5 x 5 px, all phases")):
        print(f"| {name} | {shift['rays'][i]:.4f} | {shift['waves'][i]:.4f} |")


def timed(call, repeat=3):
    """Shortest of some runs on the clock, and of its processor time [s], after one that does not count."""
    call()
    wall, used = [], []
    for _ in range(repeat):
        start = time.perf_counter(), time.process_time()
        call()
        wall.append(time.perf_counter() - start[0])
        used.append(time.process_time() - start[1])
    return min(wall), min(used)


def speed():
    """Terms per second of the sum; a frame of 240 stars; the same sum by batoid."""
    pupil = trace_pupil(load_lens(LENS), 3.0, 0.0, 600.0, order=(40, 144))
    x, y = (float(v[0, 0]) for v in pupil.mean_mm)
    grid = (np.arange(200) - 99.5) * PITCH_MM / 10
    wall, used = timed(lambda: pupil.intensity(x + grid, y + grid, dtype=np.complex64))
    terms = 40 * 144 * 200**2 / 1e9
    print(f"sum of plane waves, complex64: {terms / wall:.2f}e9 terms/s, {terms / used:.2f}e9 per second of a core")
    camera = camera_of(1024, diffraction="waves")
    rng = np.random.default_rng(1)
    wave = np.linspace(500.0, 800.0, 8)[None]
    direction = camera.nominal_direction(*rng.uniform(0.0, 1023.0, (2, 240)), FOCAL_MM)
    rate = rng.uniform(0.2, 1.0, (240, 1, 8))
    stars = StarField(direction=direction, wavelength_nm=wave, photon_rate=rate, band=("b",))
    tracer = Tracer(camera)
    start = time.perf_counter(), time.process_time()
    grid_of = build_grid(tracer.planner, wave)
    error = "none" if grid_of is None else f"errors {grid_of.error:.1e} of the light, {grid_of.error_px:.1e} px"
    wall, used = time.perf_counter() - start[0], time.process_time() - start[1]
    print(f"grid over the field: {wall:.1f} s, {used:.1f} s of a core; {error}")
    for how in ("waves", "rays"):
        one = Tracer(replace(camera, diffraction=how))
        wall, used = timed(lambda t=one: t.render(stars, exposure_s=1.0))
        print(f"240 stars, 1024 x 1024 px, by {how}: {1.0 / wall:.1f} frames/s, {1e3 * used:.0f} ms of a core each")
    exact = Tracer(camera_of(64, diffraction="exact_waves"))
    wall, used = timed(lambda: exact.render(star(wave[0]), exposure_s=1.0))
    print(f"one star by itself, 8 wavelengths: {1e3 * wall:.0f} ms, {1e3 * used:.0f} ms of a core")
    try:
        import batoid
    except ImportError:
        print("batoid: not installed")
        return
    place, slope = rng.uniform(-1e-4, 1e-4, (3, 5760)), 0.05 * rng.uniform(-1, 1, (2, 5760))
    rays = batoid.RayVector(*place, *slope, np.ones(5760), t=np.zeros(5760), wavelength=np.full(5760, 6e-7))
    points = rng.uniform(-1e-5, 1e-5, (200, 3))
    wall, used = timed(lambda: [rays.sumAmplitude(p, 0.0) for p in points])
    print(f"batoid sumAmplitude: {5760 * 200 / wall / 1e9:.3f}e9 terms/s, {5760 * 200 / used / 1e9:.3f}e9 per core")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--speed", action="store_true", help="time it instead")
    if parser.parse_args().speed:
        speed()
    else:
        changes()
        colour()
