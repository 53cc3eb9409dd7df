"""Every experiment with every lens: processor time of the --quick run, against the built-in lens on the same detector.

A lens whose stop lies inside has beams whose outlines must be found, one whose apertures cut the light has outlines
with kinks: neither may cost much. The detector is the same for all (cmv4000).

    python benchmarks/any_lens.py [--names hsfe budget] [--lenses star_tracker_26mm my.toml]

With ``--sensors`` whole sensor files instead, unlike the built-in one in every respect: a triplet, a fisheye of 100
deg, a fast lens, a mirror telescope, an ideal lens; for every experiment that takes a sensor: whether its criteria
hold, its error message otherwise, and the seconds.

    python benchmarks/any_lens.py --sensors [--names camera skycal] [--lenses ideal fisheye]
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterable
from pathlib import Path

ROOT = Path(__file__).parents[1]
REFERENCE = "star_camera_206mm"
NAMES = ("chromatic", "temporal", "hsfe", "distortion", "budget", "turntable", "fisher")
SETTINGS = (  # a window that all these lenses fill
    "instrument.detector=cmv4000",
    "instrument.width_px=1024",
    "instrument.height_px=1024",
    "instrument.defocus_mm=0",
    "instrument.absorption=false",
)
LENSES = ("star_tracker_26mm", "double_gauss_50mm", str(ROOT / "docs/examples/triplet_50mm/lens.toml"))
OWN = {
    "double_gauss_50mm": ("instrument.defocus_mm=0.07", "instrument.f_number=4")
}  # a photographic lens, stopped down


TAKE_SENSOR = (
    "camera", "chromatic", "temporal", "hsfe", "distortion", "fisher", "turntable", "budget", "acf", "skycal", "dataset"
)  # fmt: skip
COMMON = """name = "{name}"
window_px = {window_px}
[instrument]
lens = {lens}
detector = "cmv4000"
width_px = {size}
height_px = {size}
exposure_s = {exposure_s}
absorption = false
{more}
[passband]
range_nm = {range_nm}
[filters]
centres_nm = {filters}
reference_nm = {middle}
"""
RAYS = 'diffraction = "rays"'  # spots of many radii of the Airy disk
FISHEYE = """name = "fisheye"
source = "two menisci and a singlet, tests/optics/rays/test_ray_aiming.py, with glasses of Schott"
design_wavelength_nm = 600.0
max_field_deg = 55.0
"""
FISHEYE_SURFACES = (  # radius, thickness, medium behind, semi-diameter
    (60.0, 2.0, "N-K5", 45.0),
    (13.0, 11.0, "air", 12.9),
    (90.0, 2.0, "N-K5", 14.0),
    (9.0, 14.0, "air", 8.9),
    (30.0, 6.0, "N-K5", 9.0),
    (-16.0, 3.0, "air", 9.0),
    ("inf", 3.0, "air", 1.0),
    (15.0, 4.0, "N-K5", 6.0),
    (-14.0, 18.0, "air", 6.0),
)


def write_sensors(folder: Path) -> dict[str, Path]:
    """Sensor files by name."""
    lens = FISHEYE
    for number, (radius, thickness, medium, semi) in enumerate(FISHEYE_SURFACES):
        lens += f'[[surface]]\nthickness_mm = {thickness}\nmedium = "{medium}"\nsemi_diameter_mm = {semi}\n'
        lens += f"radius_mm = {radius}\n" * (radius != "inf") + "stop = true\n" * (number == 6)
    (folder / "fisheye_lens.toml").write_text(lens, encoding="utf-8")
    visible = {"window_px": 13, "range_nm": [500, 800], "filters": [550, 650, 750], "middle": 650}
    ideal = '{ kind = "ideal", focal_length_mm = 35.0, f_number = 1.8, spot_um = 4.0, transmission = 0.8 }'
    cases = {
        "fisheye": {"lens": '"fisheye_lens.toml"', "size": 1024, "exposure_s": 0.5, "more": RAYS, "window_px": 31},
        "fast": {
            "lens": '"werfel_40mm"', "size": 1024, "exposure_s": 0.1, "more": "f_number = 1.4\n" + RAYS
        },
        "mirror": {"lens": '"maksutov_1300mm"', "size": 1024, "exposure_s": 1.0, "more": ""},
        "ideal": {"lens": ideal, "size": 1200, "exposure_s": 0.1, "more": ""},
    }  # fmt: skip
    files = {"triplet": ROOT / "docs/examples/triplet_50mm/sensor.toml"}
    for name, case in cases.items():
        files[name] = folder / f"{name}.toml"
        files[name].write_text(COMMON.format(name=name, **visible | case), encoding="utf-8")
    return files


def processor_seconds(name: str, arguments: Iterable[str], folder: Path) -> tuple[float, str, Path]:
    """Processor time of a quick run [s], its error if it has no result, and its output."""
    out = Path(tempfile.mkdtemp(dir=folder)) / "out"
    command = [sys.executable, "-m", f"experiments.{name}", "--quick", "--out", str(out), *arguments]
    before = os.times()
    try:
        done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=LONGEST_S)
    except subprocess.TimeoutExpired:
        return LONGEST_S, f"**no end** in {LONGEST_S} s", out
    after = os.times()
    used = after.children_user + after.children_system - before.children_user - before.children_system
    told = "" if done.returncode in (0, 1) else (done.stderr.strip().splitlines() or ["no result"])[-1]
    return used, "**fault**: " * ("Traceback" in done.stderr) + told.removeprefix("error: "), out


def verdict(name: str, sensor: Path, folder: Path) -> str:
    """Outcome of a run with a sensor file, with its processor time."""
    used, told, out = processor_seconds(name, ["--sensor", str(sensor)], folder)
    if told:
        return told
    criteria = json.loads((out / "summary.json").read_text(encoding="utf-8"))["criteria"]
    failed = [one["name"] for one in criteria if one["passed"] is False]
    return f"{used:.0f} s" + f", **not consistent**: {'; '.join(failed)}" * bool(failed)


LONGEST_S = 600


def main() -> None:
    """Measure and print a table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--names", nargs="+")
    parser.add_argument("--lenses", nargs="+")
    parser.add_argument("--sensors", action="store_true")
    options = parser.parse_args()
    if options.sensors:
        with tempfile.TemporaryDirectory() as folder:
            files = write_sensors(Path(folder))
            files = {name: files[name] for name in options.lenses or files}
            for name in options.names or TAKE_SENSOR:
                for sensor, file in files.items():
                    print(f"| {name} | {sensor} | {verdict(name, file, Path(folder))} |", flush=True)
        return
    lenses = [REFERENCE, *(options.lenses or LENSES)]
    print("| experiment | " + " | ".join(lens if "/" not in lens else Path(lens).parent.name for lens in lenses) + " |")
    print("|---" * (len(lenses) + 1) + "|")
    reference = 1.0
    with tempfile.TemporaryDirectory() as folder:
        for name in options.names or NAMES:
            cells: list[str] = []
            for lens in lenses:
                settings = (f"instrument.lens={lens}", *SETTINGS, *OWN.get(lens, ()))
                used, told, _ = processor_seconds(name, [w for one in settings for w in ("--set", one)], Path(folder))
                reference = reference if cells else used
                cells.append(told or f"{used:.1f} s" + f", {used / reference:.2f} x" * bool(cells))
            print(f"| {name} | " + " | ".join(cells) + " |", flush=True)


if __name__ == "__main__":
    main()
