"""Detector readout against GalSim's CCDNoise, 4096 x 2048 pixels, and frames to disk; medians, megapixels per second.

Run from the repository root: ``python benchmarks/detector.py`` or ``python -m benchmarks.detector``. starbench: every
effect of `render.detector.readout` at once, crosstalk included, from float32 NumPy electrons to a `Frame` with its
uint16 NumPy array and flags, all cores. GalSim (if installed): ``CCDNoise`` (Poisson, gain, read noise) on an ImageF of
the same expectation, then ``quantize`` and conversion to uint16; one core, its generator is sequential. Repetitions of
the two alternate, so that both see the same machine. ``--threads 1`` is the rate of one worker of many. Frames to disk:
`render.fits.files.write_frame` into a temporary folder, without mask, 40 cards of world coordinates.
"""

from __future__ import annotations

import argparse
import dataclasses
import statistics
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from render.detector.readout import expose
from render.detector.spec import Detector, load_detector
from render.engine import Engine
from render.engine.random import Streams
from render.fits.files import write_frame

BACKGROUND_E = 5.0
EXPOSURE_S = 0.1
TEMPERATURE_C = 20.0
STARS = 200


def scene(shape: tuple[int, int]) -> np.ndarray:
    """Uniform background with some Gaussian stars of 20 000 e-."""
    rng = np.random.default_rng(1)
    image = np.full(shape, BACKGROUND_E, np.float32)
    row, column = np.mgrid[-5:6, -5:6]
    star = np.exp(-(row**2 + column**2) / (2 * 0.8**2))
    star *= 20000.0 / star.sum()
    for y, x in rng.integers(10, (shape[0] - 10, shape[1] - 10), (STARS, 2)):
        image[y - 5 : y + 6, x - 5 : x + 6] += star.astype(np.float32)
    return image


def everything_on() -> Detector:
    """The shipped mosaic with crosstalk, which its data file leaves at zero."""
    return dataclasses.replace(
        load_detector("acc18_mosaic"), crosstalk_horizontal=0.004, crosstalk_vertical=0.004, crosstalk_diagonal=0.001
    )


def starbench(image: np.ndarray, detector: Detector) -> Callable[[int], np.ndarray]:
    """One readout, by frame number."""

    def run(frame: int) -> np.ndarray:
        return expose(
            image,
            detector,
            streams=Streams(1),
            frame=frame,
            exposure_s=EXPOSURE_S,
            temperature_c=TEMPERATURE_C,
        ).dn

    return run


def galsim_noise(image: np.ndarray, detector: Detector) -> Callable[[int], np.ndarray] | None:
    """The same with GalSim, or None where it is not installed."""
    try:
        import galsim
    except ImportError:
        return None
    dark = detector.dark_current_e_per_s * detector.dark_factor(TEMPERATURE_C) * EXPOSURE_S

    def run(frame: int) -> np.ndarray:
        noise = galsim.CCDNoise(
            galsim.BaseDeviate(frame + 1), gain=1.0 / detector.gain_dn_per_e, read_noise=detector.read_noise_e
        )
        target = galsim.ImageF((image + np.float32(dark)) * np.float32(detector.gain_dn_per_e))
        target.addNoise(noise)
        target += detector.offset_dn
        target.quantize()
        return np.clip(target.array, 0, detector.largest_dn).astype(np.uint16)

    return run


def written(image: np.ndarray, detector: Detector, repeat: int) -> None:
    """Print the time and size of files."""
    frame = expose(image, detector, streams=Streams(1), exposure_s=EXPOSURE_S, temperature_c=TEMPERATURE_C)
    cards = [(f"A_{i}_{j}", 1.0 / (3 + i + j), "") for i in range(8) for j in range(5)]
    with tempfile.TemporaryDirectory() as folder:
        for compression in (None, "rice", "gzip"):
            taken = []
            for number in range(repeat + 1):
                path = Path(folder) / f"{compression}{number}.fits"
                start = time.perf_counter()
                write_frame(frame, path, compression=compression, cards=cards, mask="never")
                taken.append(time.perf_counter() - start)
                size = path.stat().st_size
                path.unlink()
            middle = statistics.median(taken[1:])
            name, rate = compression or "not compressed", image.size / middle / 1e6
            print(f"  {name:24s} {1e3 * middle:7.1f} ms  {rate:6.1f} Mpx/s  ({size / image.size:.2f} bytes per pixel)")


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--repeat", type=int, default=7, help="timed repetitions (default 7)")
    parser.add_argument("--backend", default="llvm", choices=("auto", "llvm", "cuda"))
    parser.add_argument("--threads", type=int, help="threads of the processor (default: all)")
    arguments = parser.parse_args()
    Engine.start(arguments.backend)
    if arguments.threads is not None:
        import drjit

        drjit.set_thread_count(arguments.threads)
    full = everything_on()
    image = scene(full.shape)
    plain = dataclasses.replace(full, crosstalk_horizontal=0.0, crosstalk_vertical=0.0, crosstalk_diagonal=0.0)
    runs = {
        "starbench, all effects": starbench(image, full),
        "starbench, no crosstalk": starbench(image, plain),
    }
    peer = galsim_noise(image, plain)
    if peer is not None:
        runs["GalSim CCDNoise"] = peer
    times: dict[str, list[float]] = {name: [] for name in runs}
    for repetition in range(arguments.repeat + 2):
        for name, run in runs.items():
            start = time.perf_counter()
            run(repetition)
            if repetition > 1:  # the first two compile and fill the maps
                times[name].append(time.perf_counter() - start)
    print(f"{full.width_px} x {full.height_px} px, background {BACKGROUND_E:g} e-, median of {arguments.repeat}:")
    speed = {name: image.size / statistics.median(taken) / 1e6 for name, taken in times.items()}
    for name, taken in times.items():
        middle, best = 1e3 * statistics.median(taken), 1e3 * min(taken)
        print(f"  {name:24s} {middle:7.1f} ms  {speed[name]:6.1f} Mpx/s  (best {best:.1f} ms)")
    if peer is None:
        print("  GalSim is not installed: pip install 'starbench[reference]'")
    else:
        print(f"  ratio, all effects: {speed['starbench, all effects'] / speed['GalSim CCDNoise']:.1f}")
    print("Frames to disk:")
    written(image, plain, arguments.repeat)


if __name__ == "__main__":
    main()
