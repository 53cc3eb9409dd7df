"""Lens trace against batoid and optiland: 12-surface double Gauss, float64, medians, million ray-surfaces per second.

Run from the repository root: ``python benchmarks/trace.py``. One ray-surface is one ray at one surface; the lens has 10
refracting surfaces, the stop and the image plane. Every code starts from rays in arrays and ends with rays in arrays:

* starbench, Dr.Jit (LLVM) on 1 and 2 threads and NumPy: an own wavelength per ray with three-term Sellmeier formulas,
  clear apertures, status and place of loss, optical path.
* starbench, next lens: as above with 2 threads, another perturbed lens each time (the kernel is not compiled again).
* batoid: per-ray three-term Sellmeier, apertures; its own threads set to 1 and 2.
* optiland (NumPy): one wavelength, no apertures. It has no per-ray wavelength.

Repetitions alternate between the codes, so that all have the same machine load. Peers that are not installed are left
out.
"""

from __future__ import annotations

import argparse
import statistics
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))


from optics.frames import field_direction
from optics.lens.perturb import decentre
from optics.lens.shapes.plane import Plane
from optics.lens.system import AMBIENT, LensSystem
from optics.lens_file import load_lens
from optics.rays.entrance_pupil import entrance_pupil, star_rays
from optics.rays.program import compile_lens
from optics.rays.pupil_sampling import sobol_disk
from optics.rays.trace import Rays, trace
from render.engine import Engine

LENS = "double_gauss_50mm"
FIELD_DEG = (3.0, 2.0)
RANGE_NM = (500.0, 700.0)
Run = Callable[[int], Any]


def start_rays(lens: LensSystem, count: int) -> Rays:
    """Rays of one star over the pupil, each with its own wavelength."""
    samples = sobol_disk(count, seed=1)
    rays = star_rays(entrance_pupil(lens), samples, field_direction(*FIELD_DEG), 600.0)
    rays.wavelength_nm[...] = np.random.default_rng(1).uniform(*RANGE_NM, count)
    return rays


def on_drjit(lens: LensSystem, rays: Rays, threads: int, *, perturb: bool = False) -> Run:
    """Trace with Dr.Jit on LLVM; ``perturb``: another lens in every repetition, its numbers uploaded."""
    import drjit as dr

    engine = Engine.start("llvm")
    types, arrays = engine.types, engine.arrays
    kinds = {"status": types.Int32, "failed_at": types.Int32}
    device = Rays(**{k: kinds.get(k, types.Float64)(getattr(rays, k)) for k in Rays.__dataclass_fields__})
    dr.eval(*(getattr(device, name) for name in Rays.__dataclass_fields__))
    program, theta = compile_lens(lens, general=perturb)
    numbers = arrays.parameters(theta.tolist())

    from optics.rays.trace import trace_program

    def run(repetition: int) -> Rays:
        dr.set_thread_count(threads)
        values = numbers
        if perturb:
            moved = decentre(lens, "L45", 1e-3 * repetition, 0.0)
            values = arrays.parameters(compile_lens(moved, general=True)[1].tolist())
        out = trace_program(program, values, device, arrays)
        dr.eval(*(getattr(out, name) for name in Rays.__dataclass_fields__))
        dr.sync_thread()
        return out

    return run


def on_numpy(lens: LensSystem, rays: Rays) -> Run:
    """The same source on NumPy arrays."""
    return lambda repetition: trace(lens, rays)


def on_batoid(lens: LensSystem, rays: Rays, threads: int) -> Run | None:
    """The same lens in batoid, surface by surface, or None where it is not installed."""
    try:
        import batoid
        import batoid.global_vars
    except ImportError:
        return None

    def medium(name: str) -> Any:
        if name == AMBIENT:
            return batoid.ConstMedium(1.0)
        glass = lens.glasses[name]
        return batoid.SellmeierMedium(*glass.dispersion.numbers)

    names = [AMBIENT, *(s.medium for s in lens.surfaces)]
    steps = [
        (
            batoid.Plane() if isinstance(s.shape, Plane) else batoid.Sphere(s.shape.radius_mm),
            medium(names[i]),
            medium(names[i + 1]),
            batoid.CoordSys(s.position_mm, s.rotation),
            batoid.ObscNegation(batoid.ObscCircle(s.semi_diameter_mm)),
        )
        for i, s in enumerate(lens.surfaces)
    ]
    image = batoid.CoordSys(lens.image_position_mm, lens.image_rotation)
    plain = [np.ascontiguousarray(v) for v in (rays.x, rays.y, rays.z, rays.dx, rays.dy, rays.dz)]
    wavelength = rays.wavelength_nm * 1e-9
    prepared: dict[int, Any] = {}

    def prepare(repetition: int) -> None:
        """A fresh bundle, since batoid traces in place; not timed."""
        prepared.clear()
        prepared[repetition] = batoid.RayVector(*plain, t=np.zeros(wavelength.size), wavelength=wavelength)

    def run(repetition: int) -> Any:
        batoid.global_vars._batoid_max_threads = threads
        rv = prepared[repetition]
        for surface, before, after, place, obscuration in steps:
            batoid.refract(surface, rv, before, after, coordSys=place)
            batoid.obscure(obscuration, rv)
        return batoid.intersect(batoid.Plane(), rv, coordSys=image)

    run.prepare = prepare  # type: ignore[attr-defined]
    return run


def on_optiland(lens: LensSystem, count: int) -> Run | None:
    """The same lens in optiland with its NumPy backend, or None where it is not installed."""
    try:
        from optiland.materials import IdealMaterial
        from optiland.optic import Optic
        from optiland.rays import RealRays
    except ImportError:
        return None
    optic = Optic()
    optic.surfaces.add(index=0, radius=np.inf, thickness=np.inf)
    z = [float(s.position_mm[2]) for s in lens.surfaces] + [float(lens.image_position_mm[2])]
    for i, s in enumerate(lens.surfaces):
        index = 1.0 if s.medium == AMBIENT else float(lens.glasses[s.medium].index(600.0))
        optic.surfaces.add(
            index=i + 1,
            radius=np.inf if isinstance(s.shape, Plane) else s.shape.radius_mm,
            thickness=z[i + 1] - z[i],
            material=IdealMaterial(n=index),
            is_stop=s.is_stop,
        )
    optic.surfaces.add(index=len(lens.surfaces) + 1)
    optic.set_aperture(aperture_type="EPD", value=25.0)
    optic.fields.set_type(field_type="angle")
    optic.fields.add(y=0.0)
    optic.wavelengths.add(value=0.6, is_primary=True)
    rays = start_rays(lens, count)
    start = [rays.x, rays.y, rays.z - 30.0, rays.dx, rays.dy, rays.dz]

    def prepare(repetition: int) -> None:
        run.rays = RealRays(*(v.copy() for v in start), np.ones(count), np.full(count, 0.6))  # type: ignore[attr-defined]

    def run(repetition: int) -> Any:
        return optic.surfaces.trace(run.rays)  # type: ignore[attr-defined]

    run.prepare = prepare  # type: ignore[attr-defined]
    return run


def main() -> int:
    """Measure and print; exit status 1 if a target is missed."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rays", type=int, default=1 << 20, help="rays per trace, a power of two (default 2^20)")
    parser.add_argument("--repeat", type=int, default=9, help="timed repetitions (default 9)")
    arguments = parser.parse_args()
    lens = load_lens(LENS)
    surfaces = len(lens.surfaces) + 1
    rays, fewer = start_rays(lens, arguments.rays), max(1 << 14, arguments.rays >> 3)
    small = start_rays(lens, fewer)
    candidates: dict[str, tuple[Run | None, int]] = {
        "starbench, 1 thread": (on_drjit(lens, rays, 1), arguments.rays),
        "starbench, 2 threads": (on_drjit(lens, rays, 2), arguments.rays),
        "starbench, next lens": (on_drjit(lens, rays, 2, perturb=True), arguments.rays),
        "starbench, NumPy": (on_numpy(lens, small), fewer),
        "batoid, 1 thread": (on_batoid(lens, rays, 1), arguments.rays),
        "batoid, 2 threads": (on_batoid(lens, rays, 2), arguments.rays),
        "optiland, NumPy": (on_optiland(lens, fewer), fewer),
    }
    runs = {name: (run, count) for name, (run, count) in candidates.items() if run is not None}
    times: dict[str, list[float]] = {name: [] for name in runs}
    work: dict[str, list[float]] = {name: [] for name in runs}
    for repetition in range(arguments.repeat + 2):
        for name, (run, _) in runs.items():
            if hasattr(run, "prepare"):
                run.prepare(repetition)
            start, start_work = time.perf_counter(), time.process_time()
            run(repetition)
            if repetition > 1:  # the first two compile
                times[name].append(time.perf_counter() - start)
                work[name].append(time.process_time() - start_work)
    print(f"{lens.name}, {surfaces} surfaces, {arguments.rays} rays, median (best) of {arguments.repeat},")
    print("and per second of processor time, independent of other load:")
    speed = {}
    for name, (_, count) in runs.items():
        speed[name] = surfaces * count / statistics.median(times[name]) / 1e6
        best = surfaces * count / min(times[name]) / 1e6
        busy = surfaces * count / statistics.median(work[name]) / 1e6
        print(f"  {name:22s} {speed[name]:7.1f} M ray-surfaces/s  ({best:.1f})   {busy:7.1f} M per processor second")
    met = speed["starbench, 2 threads"] >= 200.0
    if "batoid, 2 threads" in speed:
        ratio = speed["starbench, 2 threads"] / speed["batoid, 2 threads"]
        print(f"  ratio to batoid, 2 threads each: {ratio:.1f}")
        met = met and ratio >= 6.0
    print(f"  target, 200 M ray-surfaces/s on 2 threads and 6 times batoid: {'met' if met else 'MISSED'}")
    return 0 if met else 1


if __name__ == "__main__":
    raise SystemExit(main())
