"""Diffraction: its effect on a star of the 206 mm lens, and its cost, compared with other codes in the same run.

python benchmarks/waves.py               # tables of docs/diffraction.md
python benchmarks/waves.py --operations  # time of the operations of an image
python benchmarks/waves.py --cost        # measured and estimated cost of images and grids
python benchmarks/waves.py --gradient    # cost of a gradient in forward renders
python benchmarks/waves.py --transform   # sum of plane waves, compared with FINUFFT
python benchmarks/waves.py --speed       # frames and terms per second, beside batoid, optiland, prysm, GalSim
"""

from __future__ import annotations

import argparse
import math
import time
from dataclasses import replace
from functools import partial

import numpy as np
from scipy.optimize import nnls
from threadpoolctl import threadpool_limits

from optics.frames import field_direction
from optics.lens.perturb import decentre
from optics.lens_file import load_lens
from optics.rays.paraxial import axial_paraxial
from optics.waves.pupil_field import trace_pupil
from render.camera import Camera
from render.records import StarField
from render.tracing.motion.paths import at_rest
from render.tracing.psf import render_epsf
from render.tracing.pupil.quadrature_order import staggered
from render.tracing.tracer import Tracer
from render.tracing.waves.field_grid_build import build_grid, plan_grid
from render.tracing.waves.frequency_grid import IMAGE_PRODUCTS, PRODUCT_S, RAY_PRODUCTS, image_products, window_light
from render.tracing.waves.pixel_kernel import FieldSampling, window_samples
from render.tracing.waves.plane_waves import trace_waves

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


def windows():
    """Light and centroid in windows about the mean of all light, of all positions within a pixel."""
    plain = camera_of(diffraction="exact_waves")
    cases = {
        "206 mm, 3.5 deg": (plain, 3.5, 9),
        "206 mm, L2 decentred, axis": (replace(plain, lens=decentre(plain.lens, "L2", 0.1164, 0.0)), 0.0, 9),
        "26 mm, 8 deg": (replace(plain, lens=load_lens("star_tracker_26mm")), 8.0, 8),
    }
    print("\n| lens | window [px] | light | centroid from the mean of all light [mpx] |\n|---|---|---|---|")
    for name, (camera, field_deg, radius_px) in cases.items():
        stars = star(np.linspace(600.0, 700.0, 3), field_deg)
        cells = Tracer(camera).centred_cells(stars, half_size_px=24, cells_per_px=4)[0, 0]
        at = (np.arange(len(cells)) + 0.5) / 4.0 - 24.5
        seen = {f"{n} x {n}": np.maximum(np.abs(at), np.abs(at)[:, None]) < 0.5 * n for n in (5, 9, 13, 21, 41)}
        seen[f"disk, radius {radius_px}"] = np.hypot(at, at[:, None]) <= radius_px
        for window, inside in seen.items():
            light = cells * inside
            print(f"| {name} | {window} | {light.sum():.4f} | {1e3 * (light.sum(0) @ at) / light.sum():.1f} |")


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


def sums():
    """Time of one image of one wavelength by several codes, and terms (samples of pupil x image) per second.

    Each code does what it does by itself: ours, batoid's and optiland's trace a lens; prysm is handed a pupil's field
    on a regular grid, whose sum is two matrix products; GalSim transforms an analytic pupil. Numbers of rays and
    samples are each code's own: terms per second compare, where a code has them, and times where samples are alike.
    """
    rows = []

    def add(name, terms, call, repeat=3):
        wall, used = timed(call, repeat)
        rows.append((name, terms, wall, used))

    pupil = trace_pupil(load_lens(LENS), 3.0, 0.0, 600.0, order=(40, 144))
    x, y = (float(v[0, 0]) for v in pupil.mean_mm)
    grid = (np.arange(200) - 99.5) * PITCH_MM / 10
    add("starbench, matrix product", 40 * 144 * 200**2, lambda: pupil.intensity(x + grid, y + grid, dtype=np.complex64))
    waves, field = _plane_waves()
    side = len(window_samples(field, 19.0, 1.5))
    corner = waves.mean[0, 0, 0] - 9.5
    add("starbench, grid of frequencies", waves.x.size * side**2,
        lambda: window_light(partial(waves.rays, (0, 0)), np.ones(1), corner, 19.0, field, pad_px=1.5))  # fmt: skip
    for peer in (_batoid, _optiland, _prysm, _galsim):
        try:
            add(*peer())
        except ImportError:
            rows.append((peer.__name__[1:], None, math.nan, math.nan))
    print("\n| code | terms | time of an image [ms] | terms/s of a core | of ours |\n|---|---|---|---|---|")
    best = rows[1][1] / rows[1][3]
    for name, terms, _, used in rows:
        if math.isnan(used):
            print(f"| {name} | not installed | | | |")
            continue
        rate = "" if terms is None else f"{terms / used / 1e9:.3f}e9"
        ratio = "" if terms is None else f"1/{best * used / terms:.0f}"
        print(f"| {name} | {'' if terms is None else f'{terms / 1e6:.0f}e6'} | {1e3 * used:.1f} | {rate} | {ratio} |")


def _plane_waves():
    """Traced waves of one star at 3 deg, and how its image is sampled."""
    kernel_of = Tracer(camera_of(64, diffraction="exact_waves")).planner
    exposure = kernel_of.exposure(at_rest(field_direction(3.0, 0.0)[None]), np.array([[600.0]]))
    index = np.asarray(kernel_of.camera.focused_lens.indices(np.array([[600.0]]))[-1])
    waves = trace_waves(exposure.mid, staggered((36, 140), 1), np.array([[600.0]]), index, np.zeros(1, np.uint32))
    return waves, FieldSampling(3.85)


def _batoid():
    import batoid

    optic = batoid.Optic.fromYaml("LSST_r.yaml")
    return ("batoid huygensPSF", round(np.pi / 4 * 0.63 * 128**2) * 64**2,
            lambda: batoid.huygensPSF(optic, np.deg2rad(1.0), 0.0, 620e-9, nx=128, nxOut=64))  # fmt: skip


def _optiland():
    from optiland.psf import HuygensPSF
    from optiland.samples.objectives import CookeTriplet

    lens = CookeTriplet()
    return ("optiland HuygensPSF", round(np.pi / 4 * 64**2) * 64**2,
            lambda: HuygensPSF(lens, (0.0, 0.7), 0.55, num_rays=64, image_size=64), 1)  # fmt: skip


def _prysm():
    from prysm.fttools import mdft

    pupil = np.ones((256, 256), np.complex64)
    return "prysm, matrix DFT of a pupil", None, lambda: np.abs(mdft.dft2(pupil, 8.0, 200)) ** 2


def _galsim():
    import galsim

    def image():
        psf = galsim.OpticalPSF(lam=600.0, diam=0.07, aberrations=[0.0] * 4 + [0.1, 0.05, 0.0, 0.05], oversampling=2.0)
        psf.drawImage(nx=200, ny=200, scale=0.2, method="no_pixel")

    return "GalSim OpticalPSF, FFT", None, image


def frames():
    """Grids over the field, frames of stars, one star."""
    rng = np.random.default_rng(1)
    wave = np.linspace(500.0, 800.0, 8)[None]
    for name, width, height, count in (("240 stars", 1024, 1024, 240), ("100 stars", 4096, 2048, 100)):
        camera = replace(camera_of(1024, diffraction="waves"), width_px=width, height_px=height)
        camera = replace(camera, centre_px=np.array([0.5 * (width - 1), 0.5 * (height - 1)]))
        place = rng.uniform(0.0, 1.0, (2, count)) * np.array([[width - 1.0], [height - 1.0]])
        stars = StarField(direction=camera.nominal_direction(*place, FOCAL_MM), wavelength_nm=wave,
                          photon_rate=rng.uniform(0.2, 1.0, (count, 1, 8)), band=("b",))  # fmt: skip
        for state, lens in (("as designed", camera.lens), ("L2 decentred", decentre(camera.lens, "L2", 0.1, 0.05))):
            tracer = Tracer(replace(camera, lens=lens))
            start = time.perf_counter(), time.process_time()
            grid = build_grid(tracer.planner, wave)
            wall, used = time.perf_counter() - start[0], time.process_time() - start[1]
            error = "none is good enough"
            if grid is not None:
                places = f"{len(grid.points)}" + ("^2 places" if grid.order is None else " places along a diameter")
                error = f"{places}, errors {grid.error:.1e} of the light, {grid.error_px:.1e} px"
            print(f"grid over {width} x {height} px, {state}: {wall:.1f} s, {used:.1f} s of a core; {error}")
        for how in ("waves", "rays"):
            one = Tracer(replace(camera, diffraction=how))
            wall, used = timed(lambda t=one, s=stars: t.render(s, exposure_s=1.0))
            print(f"{name}, {width} x {height} px, by {how}: {1.0 / wall:.1f} frames/s, {1e3 * used:.0f} ms of a core")
    exact = Tracer(camera_of(64, diffraction="exact_waves"))
    wall, used = timed(lambda: exact.render(star(wave[0]), exposure_s=1.0))
    print(f"one star by itself, 8 wavelengths: {1e3 * wall:.0f} ms, {1e3 * used:.0f} ms of a core")


def costs():
    """Processor time of an image and of a grid, measured and as the renderer estimates it to decide for a grid."""
    print("| lens | pixel [um] | image [ms] | estimated | grid [s] | estimated | pays from (stars) |")
    print("|---|---|---|---|---|---|---|")
    wave = np.linspace(560.0, 640.0, 5)[None]
    for lens, pitch_um in ((LENS, 5.5), (LENS, 22.0), (LENS, 44.0), ("star_tracker_26mm", 5.5), ("petzval_100mm", 5.5)):
        size = round(1024 * 5.5 / pitch_um)
        camera = Camera(lens=load_lens(lens), width_px=size, height_px=size, pixel_pitch_mm=1e-3 * pitch_um,
                        charge_diffusion_px=SIGMA_PX)  # fmt: skip
        place = np.random.default_rng(1).uniform(0.0, size - 1.0, (2, 4))
        focal_mm = float(axial_paraxial(camera.lens, camera.lens.design_wavelength_nm).efl_mm)
        stars = StarField(direction=camera.nominal_direction(*place, focal_mm), wavelength_nm=wave,
                          photon_rate=np.ones((4, 1, 5)), band=("b",))  # fmt: skip
        tracer = Tracer(camera)
        plan = plan_grid(tracer.planner, wave)
        image_s = timed(lambda t=tracer, s=stars: t.render(s, exposure_s=1.0), 1)[1] / 20.0
        before = time.process_time()
        build_grid(tracer.planner, wave)
        grid_s = time.process_time() - before
        pays = next((n for n in range(2, 1000) if plan.pays(n)), "-")
        cells = lens, f"{pitch_um:g}", f"{1e3 * image_s:.1f}", f"{1e3 * plan.image_products * PRODUCT_S:.1f}"
        print("| " + " | ".join((*cells, f"{grid_s:.1f}", f"{plan.grid_products * PRODUCT_S:.1f}", str(pays))) + " |")


def _random_waves(rng, waves, highest, window_px):
    """Plane waves of random directions, and the sampling of their window."""
    field = FieldSampling(highest)
    pad = field.pixel(1.0, SIGMA_PX).reach_px
    f = rng.uniform(-0.35 * highest, 0.35 * highest, (2, waves))
    landing, turns, amplitude = rng.uniform(0.0, 1.0, (3, waves))
    return (landing, landing, *f, turns, amplitude), field, pad


def operations():
    """Time of a product, and products as long as a ray and as an image: a fit to images of many sizes, one thread.

    The constants of `render.tracing.waves.frequency_grid`; rays are spread here, and not interpolated first.
    """
    rng, design, seconds = np.random.default_rng(1), [], []
    for waves in (200, 2000, 8000, 20000):
        for window_px, highest in ((9, 1.0), (19, 3.85), (41, 3.85), (61, 6.0), (101, 6.0)):
            rays, field, pad = _random_waves(rng, waves, highest, window_px)
            products = image_products(0.0, field, window_px, pad) - IMAGE_PRODUCTS
            design.append([1.0, waves, products])
            with threadpool_limits(1, "blas"):
                seconds.append(timed(lambda r=rays, s=field, w=window_px, p=pad: window_light(
                    lambda _: r, np.ones(1), np.zeros(2), w, s, pad_px=p), 5)[1])  # fmt: skip
    weight = 1.0 / np.array(seconds)
    (image_s, ray_s, product_s), _ = nnls(np.array(design) * weight[:, None], np.ones(len(weight)))
    print(f"product of complex numbers {product_s:.2e} s (code: {PRODUCT_S:.2e} s)")
    print(f"ray {ray_s / product_s:.0f} products (code: {RAY_PRODUCTS:.0f})")
    print(f"image {image_s / product_s:.2e} products (code: {IMAGE_PRODUCTS:.2e})")


def gradients():
    """Processor time of a frame of two stars, and of its gradient by some hundred numbers."""
    from render.engine import Engine
    from render.engine.jit import dr
    from render.forward import star_scene
    from render.plugins.register import register_plugins

    mi = Engine.start("llvm").mitsuba
    register_plugins()
    dr.set_thread_count(1)
    camera = camera_of(64, defocus_mm=0.03, centre_px=np.array([-100.0, -80.0]))
    stars = StarField(direction=camera.nominal_direction(np.array([18.3, 36.8]), np.array([17.7, 22.1]), FOCAL_MM),
                      wavelength_nm=np.array([[500.0, 600.0, 700.0]]), photon_rate=np.full((2, 1, 3), 10.0),
                      band=("b",))  # fmt: skip
    scene = mi.load_dict(star_scene(camera, stars))
    params = mi.traverse(scene)
    names = ["camera.curvature_per_mm", "camera.thickness_mm", "camera.defocus_mm", "stars.direction"]

    def gradient():
        dr.enable_grad(*(params[name] for name in names))
        image = mi.render(scene, params)
        dr.backward(dr.sum(image * image, axis=None))
        found = [dr.grad(params[name]).numpy() for name in names]
        dr.disable_grad(*(params[name] for name in names))
        return found

    forward = timed(lambda: mi.render(scene).numpy(), 5)[1]
    backward = timed(gradient, 5)[1]
    print(f"image {1e3 * forward:.0f} ms, gradient {1e3 * backward:.0f} ms of a core: {backward / forward:.1f} images")


def transforms():
    """Processor time of the sum of plane waves over a window, and FINUFFT's for the same sum, one thread each."""
    import finufft

    rng = np.random.default_rng(1)
    print("| waves | samples | sum here [ms] | FINUFFT, 1e-6 | ratio |")
    print("|---|---|---|---|---|")
    for waves, window_px, highest in ((400, 13, 1.0), (1500, 21, 1.2), (4000, 31, 2.0), (12000, 61, 2.0)):
        rays, field, pad = _random_waves(rng, waves, highest, window_px)
        count, sample = len(window_samples(field, window_px, pad)), field.light_step
        f, turns, amplitude = np.stack(rays[2:4]), *rays[4:]

        def here(rays=rays, field=field, window_px=window_px, pad=pad):
            return window_light(lambda _: rays, np.ones(1), np.zeros(2), window_px, field, pad_px=pad)

        def theirs(x=2.0 * np.pi * sample * f, count=count, turns=turns, amplitude=amplitude):
            coefficient = amplitude * np.exp(2j * np.pi * turns)
            u = finufft.nufft2d1(x[1], x[0], coefficient, (count, count), eps=1e-6, isign=1, nthreads=1)
            return u.real**2 + u.imag**2

        ours, other = (timed(run, 15)[1] * 1e3 for run in (here, theirs))
        print(f"| {waves} | {count} | {ours:.2f} | {other:.2f} | {ours / other:.2f} |")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--speed", action="store_true", help="time it instead")
    parser.add_argument("--cost", action="store_true", help="measure the cost of images and grids")
    parser.add_argument("--operations", action="store_true", help="measure the operations of an image")
    parser.add_argument("--gradient", action="store_true", help="measure the cost of a gradient")
    parser.add_argument("--transform", action="store_true", help="measure the sum of plane waves beside FINUFFT")
    arguments = parser.parse_args()
    if arguments.transform:
        transforms()
    elif arguments.operations:
        operations()
    elif arguments.gradient:
        gradients()
    elif arguments.cost:
        costs()
    elif arguments.speed:
        frames()
        sums()
    else:
        changes()
        colour()
        windows()
