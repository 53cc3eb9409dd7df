"""Every built-in lens: focal length, spots, lateral colour, and results of `chromatic` and `dataset`, as a table.

Focal length, F-number, half field, RMS spots and lateral colour are of the lens alone (light from 500 to 800 nm at 0,
0.7 and 1 of the half field, about its own mean; shift of the mean from 500 to 800 nm at 0.7 of the field, outwards).
The chromatic LSFE is that of `experiments.chromatic` on 1024 x 1024 pixels of 5.5 um, without absorption in the
glass: the shift between stars of 3000 and 30000 K, RMS over the window, times 3. ``--run`` adds the exit status of
`python -m experiments.chromatic --quick` and of `python -m experiments.dataset --quick` with the same settings.

    python benchmarks/lenses.py [--lenses petzval_100mm ...] [--run]
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))

WAVELENGTHS_NM = np.linspace(500.0, 800.0, 7)
SETTINGS = (
    "instrument.detector=cmv4000",
    "instrument.width_px=1024",
    "instrument.height_px=1024",
    "instrument.absorption=false",
)
WIDE = ("instrument.defocus_mm=0", "window_px=25")
OWN = {  # spots that a window of the centroider holds
    "double_gauss_50mm": ("instrument.f_number=4", "instrument.defocus_mm=0.07"),
    "maksutov_1300mm": WIDE,
    "petzval_100mm": WIDE,
    "star_camera_206mm": ("instrument.defocus_mm=0.01",),
    "werfel_40mm": (*WIDE, "instrument.diffraction=rays"),  # too wide for waves; spots are 17 Airy radii and more
}
LARGE = ("instrument.width_px=2048", "instrument.height_px=2048")
PLEIADES = ("pointing.kind=cone", "pointing.ra_deg=56.75", "pointing.dec_deg=24.12", "pointing.radius_deg=0.1")
CHROMATIC = {  # no decentre gives ACC18's shift: mirrors have no colour, a weak meniscus hardly any
    "hubble_57m": ("decentre.wanted_px=0",),
    "maksutov_1300mm": ("decentre.wanted_px=0",),
}
DATASET = {  # enough stars
    "catadioptric_425mm": (*LARGE, *PLEIADES),
    "maksutov_1300mm": PLEIADES,
    "star_camera_206mm": LARGE,
}
LIMIT_S = 900


def of_the_lens(name: str) -> list[str]:
    """Columns that rays of the lens alone give."""
    from optics.lens_file import load_lens
    from optics.rays.paraxial import paraxial
    from optics.rays.spots import spot_moments

    lens = load_lens(name)
    p = paraxial(lens)
    field = lens.max_field_deg * np.array([0.0, 0.7, 1.0])
    spots = spot_moments(lens, field, np.zeros(3), WAVELENGTHS_NM, order=(12, 32))
    light = spots.transmitted_mm2 / spots.transmitted_mm2.sum(1, keepdims=True)
    mean = (light * spots.x_mm).sum(1, keepdims=True)
    variance = (light * (spots.rms_radius_mm**2 + (spots.x_mm - mean) ** 2)).sum(1)
    colour_mm = (spots.x_mm[1, -1] - spots.x_mm[1, 0]) * np.sign(spots.x_mm[1, 0])
    arcsec = np.degrees(colour_mm / p.efl_mm) * 3600.0
    numbers = (p.efl_mm, p.f_number, lens.max_field_deg, *(1e3 * np.sqrt(variance)))
    return [f"{v:.5g}" if k == 0 else f"{v:.3g}" for k, v in enumerate(numbers)] + [
        f"{1e3 * colour_mm:+.2g}",
        f"{arcsec:+.2g}",
    ]


def settings_of(name: str) -> list[str]:
    """Settings of the experiments for a lens."""
    return [f"instrument.lens={name}", *SETTINGS, *OWN.get(name, ("instrument.defocus_mm=0",))]


def chromatic_lsfe_arcsec(name: str) -> float:
    """Shift between the coolest and the hottest star, RMS over the window, times 3."""
    from experiments.chromatic.settings import ChromaticConfig
    from experiments.chromatic.stars import max_pairwise_rms_px, stellar_shift
    from experiments.harness.config import load_config
    from render.engine import Engine
    from render.sensor_file.filters import open_band
    from render.sensor_file.instrument import build_instrument

    Engine.start("llvm")
    config = load_config(ChromaticConfig, settings=settings_of(name))
    instrument = build_instrument(config.instrument)
    _, shift_px = stellar_shift(config.stars, open_band(config.passband, instrument, "full pass band"), instrument)
    pixel_rad = instrument.camera.pixel_pitch_mm / instrument.focal_length_mm
    return float(3.0 * np.degrees(max_pairwise_rms_px(shift_px) * pixel_rad) * 3600.0)


def run(experiment: str, name: str, folder: Path) -> tuple[int, str]:
    """Exit status and last line of what went wrong of a quick run."""
    out = folder / f"{experiment}_{name}"
    more = {"chromatic": CHROMATIC, "dataset": DATASET}[experiment].get(name, ())
    words = [word for one in (*settings_of(name), *more) for word in ("--set", one)]
    command = [sys.executable, "-m", f"experiments.{experiment}", "--quick", "--out", str(out), *words]
    try:
        done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False, timeout=LIMIT_S)
    except subprocess.TimeoutExpired:
        return 124, f"not done within {LIMIT_S} s"
    return done.returncode, (done.stderr.strip().splitlines() or [""])[-1]


def main() -> None:
    """Print the table as Markdown, and below it what stopped a run."""
    from optics.lens_file import list_lenses

    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--lenses", nargs="+", default=list(list_lenses()))
    parser.add_argument("--run", action="store_true", help="run both experiments too")
    options = parser.parse_args()
    head = ["lens", "focal length [mm]", "F/", "half field [deg]", "RMS spot 0 [um]", "0.7", "1", "lateral colour [um]"]
    head += ["[arcsec]", "chromatic LSFE [arcsec]", *(["chromatic", "dataset"] if options.run else [])]
    print("| " + " | ".join(head) + " |")
    print("|---" * len(head) + "|", flush=True)
    stopped = []
    with tempfile.TemporaryDirectory() as folder:
        for name in options.lenses:
            row = [f"`{name}`", *of_the_lens(name), f"{chromatic_lsfe_arcsec(name):.2g}"]
            for experiment in ("chromatic", "dataset") if options.run else ():
                status, last = run(experiment, name, Path(folder))
                row.append(str(status))
                stopped += [f"{name}, {experiment} ({status}): {last}"] if status else []
            print("| " + " | ".join(row) + " |", flush=True)
    print(*stopped, sep="\n")


if __name__ == "__main__":
    main()
