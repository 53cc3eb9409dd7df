"""Noiseless star frames of 4096 x 2048 pixels: time against stars, memory against rays, compared with GalSim.

Run from the repository root: ``python benchmarks/frame.py`` (about two minutes); ``--figure`` also draws
docs/pictures/frame_cost.png, ``--only tracker`` leaves all but the star tracker's lens out.

starbench: `StarRenderer.render`, from a `StarField` to an `ExpectedImage` with its truth, through ``mi.load_dict`` and
``mi.render``: the built-in 206 mm lens, one 100 nm band with 5 wavelength nodes, diffusion of the shipped detector, all
cores; median after two warm-up frames of each size. GalSim (if installed): the same number of stars of 10^5 photons of
one Airy disk, the same everywhere in the field and in one colour, shot photon by photon, or drawn with its Fourier
method, into the same image; one core, as it works. The two alternate, so that both see the same machine.

Star tracker: the built-in 26 mm lens, whose stop lies inside, on 1024 x 1024 pixels of 5.5 um (12 deg), on one thread;
at rest, smeared over this many pixels with a global and a rolling shutter, and by 2^16 Sobol rays per star without beam
outlines, compared with the 206 mm lens on as many pixels; errors of image and truth of each method against 2^20 Sobol
rays.
"""

from __future__ import annotations

import argparse
import statistics
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from optics.lens_file import load_lens
from optics.light.band import TopHat, band_nodes
from optics.rays.paraxial import axial_paraxial
from render.camera import Camera, build_camera
from render.detector.spec import load_detector
from render.records import StarField

ROOT = Path(__file__).resolve().parents[1]
COUNTS = (1, 10, 30, 100, 300, 1000, 2000, 5000)
TARGETS_S = {100: 0.1, 5000: 2.0}
RAYS_LOG2 = (12, 15, 18, 21)
MEMORY_STARS = 20
PHOTONS = 1e5
GALSIM_STARS = {"photon shooting": 100, "Fourier": 300}
NOTHING_MEETS = 1e-300
"""Tolerance that leaves Sobol points."""
TRACKER_STARS = 200
TRACKER_TARGET_S = 0.04
TRAILS_PX = (0.2, 1.0, 2.0, 5.0, 10.0)
EXPOSURE_S = 0.2
FIGURE = ROOT / "docs" / "pictures" / "frame_cost.png"


def make_camera(lens: str = "star_camera_206mm") -> Camera:
    """Lens in front of the shipped mosaic, a little out of focus as star sensors are."""
    return build_camera(load_lens(lens), load_detector("acc18_mosaic"), defocus_mm=0.01)


def positions(camera: Camera, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Random columns and rows."""
    rng = np.random.default_rng(count)
    return rng.uniform(20, camera.width_px - 21, count), rng.uniform(20, camera.height_px - 21, count)


def make_stars(camera: Camera, count: int) -> StarField:
    """Stars all over the detector in one band, 10^5 electrons or so each."""
    nodes = band_nodes([TopHat(centre_nm=600.0, width_nm=100.0, edge_nm=5.0)], 5)
    focal = float(axial_paraxial(camera.lens, camera.lens.design_wavelength_nm).efl_mm)
    rate = np.broadcast_to(nodes.weight_nm * nodes.transmission, (count, *nodes.weight_nm.shape))
    return StarField(
        direction=camera.nominal_direction(*positions(camera, count), focal),
        wavelength_nm=nodes.wavelength_nm,
        photon_rate=rate * 0.5,
        band=nodes.name,
    )


def galsim_frame(camera: Camera, method: str) -> Callable[[int], Any] | None:
    """Draws a frame of a number of stars with GalSim, or None where it is not installed."""
    try:
        import galsim
    except ImportError:
        return None
    focal = float(axial_paraxial(camera.lens, camera.lens.design_wavelength_nm).efl_mm)
    scale = float(np.degrees(camera.pixel_pitch_mm / focal)) * 3600.0
    star = galsim.Airy(lam=600.0, diam=0.070, flux=PHOTONS, scale_unit=galsim.arcsec)
    how = {"method": "phot", "poisson_flux": False} if method == "photon shooting" else {"method": "auto"}

    def run(count: int) -> Any:
        image = galsim.ImageF(camera.width_px, camera.height_px, scale=scale)
        generator = galsim.BaseDeviate(1)
        extra = {"rng": generator} if method == "photon shooting" else {}
        for x, y in zip(*positions(camera, count), strict=True):
            column, row = round(x), round(y)
            stamp = image[galsim.BoundsI(column - 7, column + 8, row - 7, row + 8)]
            star.drawImage(stamp, center=galsim.PositionD(x + 1, y + 1), add_to_image=True, **how, **extra)
        return image

    return run


def timed(run: Callable[[], Any]) -> tuple[float, float]:
    """Wall and processor time [s]."""
    wall, processor = time.perf_counter(), time.process_time()
    run()
    return time.perf_counter() - wall, time.process_time() - processor


def cost(renderer: Any, camera: Camera, repeat: int) -> dict[int, tuple[float, float, float]]:
    """Median wall, median processor and best wall time [s] against number of stars."""
    result = {}
    for count in COUNTS:
        stars = make_stars(camera, count)
        for _ in range(2):
            renderer.render(stars)
        times = [timed(lambda stars=stars: renderer.render(stars)) for _ in range(repeat)]
        wall, processor = zip(*times, strict=True)
        result[count] = (statistics.median(wall), statistics.median(processor), min(wall))
    return result


def small_camera(lens: str) -> Camera:
    """Lens in front of the middle of a 5.5 um detector."""
    detector = replace(load_detector("cmv4000"), chip_width_px=1024, chip_height_px=1024)
    return build_camera(load_lens(lens), detector, absorption=False)


def trail(camera: Camera, length_px: float, line_time_s: float = 0.0) -> Any:
    """Uniform motion along a trail of that length about the attitude at rest."""
    from scipy.spatial.transform import Rotation

    from render.motion.trajectory import ConstantRate
    from render.tracing.motion.exposure import exposure_motion

    focal = float(axial_paraxial(camera.lens, camera.lens.design_wavelength_nm).efl_mm)
    rate = np.array([0.6, 0.8, 0.0]) * length_px * camera.pixel_pitch_mm / focal / EXPOSURE_S
    path = ConstantRate(initial=Rotation.from_rotvec(0.5 * EXPOSURE_S * rate), rate_rad_per_s=rate, end_s=1.0)
    return exposure_motion(path, start_s=0.0, exposure_s=EXPOSURE_S, camera=camera, line_time_s=line_time_s)


def best(run: Callable[[], Any], repeat: int) -> tuple[float, float]:
    """Median and best wall time [s] after two for warming up."""
    for _ in range(2):
        run()
    wall = [timed(run)[0] for _ in range(repeat)]
    return statistics.median(wall), min(wall)


def difference(traced: Any, reference: Any) -> str:
    """Difference of an image and its truth from another."""
    light = float(reference.truth.electrons_in.min())
    worst = {"pixel": np.abs(traced.electrons - reference.electrons).max() / light}
    for label, name in (("bundle [px]", "bundle_x_px"), ("variance [px2]", "variance_x_px2")):
        worst[label] = np.abs(getattr(traced.truth, name) - getattr(reference.truth, name)).max()
    worst["vignetted"] = np.abs(traced.truth.electrons_vignetted - reference.truth.electrons_vignetted).max() / light
    return ", ".join(f"{label} {value:.1e}" for label, value in worst.items())


def tracker(repeat: int) -> None:
    """Measure and print the star tracker's lens."""
    import drjit as dr

    from render.tracing.tracer import Tracer

    threads = dr.thread_count()
    dr.set_thread_count(1)
    print(f"1024 x 1024 px, {TRACKER_STARS} stars, one thread; median and best of {repeat}")

    def line(label: str, run: Callable[[], Any], note: str = "") -> None:
        median, least = best(run, repeat)
        sampling = ", ".join(f"{mode}: {n} stars, {rays} rays each" for mode, (n, rays) in run().sampling.items())
        print(f"{label:44s} {1e3 * median:7.1f} ms {1e3 * least:7.1f} ms   {sampling}{note}")

    try:
        for lens in ("star_tracker_26mm", "star_camera_206mm"):
            camera = small_camera(lens)
            tracer, stars = Tracer(camera), make_stars(camera, TRACKER_STARS)
            demand = f"   demanded {1e3 * TRACKER_TARGET_S:.0f} ms" if lens == "star_tracker_26mm" else ""
            line(f"{lens} at rest", lambda t=tracer, s=stars: t.render(s, exposure_s=EXPOSURE_S), demand)
            for length in TRAILS_PX:
                for shutter, line_time_s in (("", 0.0), (", rolling shutter", 1e-5)):
                    motion = trail(camera, length, line_time_s)
                    line(
                        f"{lens}, {length:g} px{shutter}",
                        lambda t=tracer, s=stars, m=motion: t.render(s, exposure_s=EXPOSURE_S, motion=m),
                        f"   {len(motion.weight)} times",
                    )
        camera = small_camera("star_tracker_26mm")
        stars = make_stars(camera, TRACKER_STARS)
        few = replace(stars, direction=stars.direction[:20], photon_rate=stars.photon_rate[:20])
        at_rest = Tracer(camera).render(few, exposure_s=EXPOSURE_S)
        sobol = {n: Tracer(camera, sobol_log2_rays=n, tolerance=NOTHING_MEETS) for n in (16, 20)}
        line("star_tracker_26mm by 2^16 Sobol rays", lambda: sobol[16].render(stars, exposure_s=EXPOSURE_S))
        dense, usual = (sobol[n].render(few, exposure_s=EXPOSURE_S) for n in (20, 16))
        print(f"from 2^20 Sobol rays, 20 stars: outlines   {difference(at_rest, dense)}")
        print(f"                                2^16 Sobol {difference(usual, dense)}")
    finally:
        dr.set_thread_count(threads)


def peak_memory_mb(backend: str, log2_rays: int) -> float:
    """Peak memory of a process of its own that renders `MEMORY_STARS` stars with 2^log2_rays rays each."""
    program = f"""
import dataclasses, resource, sys
sys.path.insert(0, {str(ROOT)!r})
from benchmarks.frame import make_camera, make_stars
from render.forward import StarRenderer
from render.engine import Engine
Engine.start({backend!r})
camera = make_camera("star_tracker_26mm")
camera = dataclasses.replace(camera, charge_diffusion_px=0.0)  # which leaves Sobol points
StarRenderer(camera, sobol_log2_rays={log2_rays}).render(make_stars(camera, {MEMORY_STARS}))
print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True, cwd=ROOT)
    return float(done.stdout.split()[-1])


def figure(measured: dict[int, tuple[float, float, float]], memory: dict[int, float]) -> None:
    """Draw cost against stars and memory against rays."""
    from matplotlib.figure import Figure

    chart = Figure(figsize=(9.0, 3.4), layout="constrained", dpi=120)
    left, right = chart.subplots(1, 2)
    counts = np.array(list(measured))
    wall = np.array([measured[n][2] for n in counts])
    slope, offset = np.polyfit(counts, wall, 1, w=1 / wall)
    left.loglog(counts, 1e3 * (offset + slope * counts), color="0.6", lw=1)
    left.loglog(counts, 1e3 * wall, "o", color="C0")
    for n, limit in TARGETS_S.items():
        left.plot([n], [1e3 * limit], "v", color="C3")
    left.text(3600, 2000, "demanded", fontsize=8, color="C3", ha="right", va="center")
    left.set(
        xlabel="stars",
        ylabel="best time per frame [ms]",
        title=f"{1e3 * offset:.0f} ms + {1e6 * slope:.0f} µs per star",
    )
    rays = np.array(list(memory))
    right.semilogx(2.0**rays, list(memory.values()), "o-", base=2, color="C0")
    right.set(xlabel="rays per star", ylabel="peak memory [MB]", title=f"{MEMORY_STARS} stars, Sobol rays")
    right.set_ylim(0, 1.25 * max(memory.values()))
    for axes in (left, right):
        axes.spines[["top", "right"]].set_visible(False)
        axes.grid(alpha=0.25)
    FIGURE.parent.mkdir(parents=True, exist_ok=True)
    chart.savefig(FIGURE)


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--repeat", type=int, default=7, help="timed repetitions (default 7)")
    parser.add_argument("--backend", default="auto", choices=("auto", "llvm", "cuda"))
    parser.add_argument("--only", choices=("tracker",), help="measure this part alone")
    parser.add_argument("--figure", action="store_true", help=f"draw {FIGURE.relative_to(ROOT)}")
    arguments = parser.parse_args()
    from render.engine import Engine
    from render.forward import StarRenderer

    variant = Engine.start(arguments.backend).variant
    tracker(arguments.repeat)
    if arguments.only == "tracker":
        return
    print(f"{variant}, 4096 x 2048 px, one band, median of {arguments.repeat} after warm-up")
    camera = make_camera()
    renderer = StarRenderer(camera, exposure_s=0.1)
    measured = cost(renderer, camera, arguments.repeat)
    truth = renderer.render(make_stars(camera, 100)).truth
    offset = np.hypot(truth.photon_x_px - truth.bundle_x_px, truth.photon_y_px - truth.bundle_y_px).max()
    print(f"{'stars':>6s} {'wall':>9s} {'processor':>10s} {'best':>9s}   demanded")
    for count, (wall, processor, best) in measured.items():
        limit = f"{1e3 * TARGETS_S[count]:.0f} ms" if count in TARGETS_S else ""
        print(f"{count:6d} {1e3 * wall:6.1f} ms {1e3 * processor:7.1f} ms {1e3 * best:6.1f} ms   {limit}")
    counts = np.array(COUNTS)
    slope, start = np.polyfit(counts, [measured[n][0] for n in COUNTS], 1, w=[1 / measured[n][0] for n in COUNTS])
    per_star = (measured[5000][0] - measured[1000][0]) / 4000
    print(f"cost {1e3 * start:.1f} ms + {1e6 * slope:.1f} us a star; 1000 to 5000 stars {1e6 * per_star:.1f} us each")
    print(f"sampling {renderer.traced.sampling}; photon centroid against bundle mean: {offset:.1e} px at most")
    for method, count in GALSIM_STARS.items():
        peer = galsim_frame(camera, method)
        if peer is None:
            print("GalSim is not installed: pip install 'starbench[reference]'")
            break
        stars = make_stars(camera, count)
        ours, theirs = [], []
        for _ in range(3):
            ours.append(timed(lambda stars=stars: renderer.render(stars))[0])
            theirs.append(timed(lambda peer=peer, count=count: peer(count))[0])
        a, b = statistics.median(ours[1:]), statistics.median(theirs[1:])
        print(
            f"GalSim Airy, {method:15s} {count:3d} stars: {1e3 * b:6.0f} ms, starbench {1e3 * a:4.0f} ms, {b / a:.0f} x"
        )
    memory = {n: peak_memory_mb(arguments.backend, n) for n in RAYS_LOG2}
    for log2_rays, megabytes in memory.items():
        print(f"{MEMORY_STARS} stars x 2^{log2_rays} rays: peak memory {megabytes:6.0f} MB")
    if arguments.figure:
        figure(measured, memory)
        print(f"wrote {FIGURE.relative_to(ROOT)}")


if __name__ == "__main__":
    main()
